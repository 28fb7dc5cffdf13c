"""The package beside its peers, in one run: `python benchmarks/run.py --help`."""

import sys
from pathlib import Path

# The tests' generators of problems and their certified oracles serve here too.
_TESTS = str(Path(__file__).resolve().parents[1] / "tests")
if _TESTS not in sys.path:
    sys.path.append(_TESTS)
