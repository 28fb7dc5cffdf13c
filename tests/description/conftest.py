from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ENGINES = {engine.name: engine.marker for engine in map(Requirement, PROJECT["optional-dependencies"]["engines"])}

# Where PyBullet has no wheel, by the marker of the extra `engines`, there is nothing to test, and nothing is skipped.
HAS_WHEEL = ENGINES["pybullet"] is None or ENGINES["pybullet"].evaluate()
collect_ignore = [] if HAS_WHEEL or importlib.util.find_spec("pybullet") else ["test_pybullet.py"]
