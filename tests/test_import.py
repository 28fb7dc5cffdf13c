"""Import of the package: heavy libraries are imported on first use only."""

from __future__ import annotations

import subprocess
import sys

import pytest

import spm_pin as spm


@pytest.mark.parametrize("module", ["spm_pin", "spm_pin.cli.application"])
def test_import_loads_no_heavy_package(module: str) -> None:
    heavy = ("pinocchio", "casadi", "numba", "llvmlite", "matplotlib", "trimesh", "yourdfpy", "mujoco", "xacro")
    program = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there_and_documented() -> None:
    for name in spm.__all__:
        member = getattr(spm, name)
        if callable(member):
            assert member.__doc__, name
