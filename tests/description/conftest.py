from __future__ import annotations

import importlib.util

# PyBullet has wheels for Linux on x86-64 and Python up to 3.11 alone; the extra `engines` brings it there.
collect_ignore = [] if importlib.util.find_spec("pybullet") else ["test_pybullet.py"]
