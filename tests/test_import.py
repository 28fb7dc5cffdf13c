"""Import of the package: heavy libraries on first use only, and no modules that import each other."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

import spm_pin as spm


@pytest.mark.parametrize("module", ["spm_pin", "spm_pin.cli.application"])
def test_import_loads_no_heavy_package(module: str) -> None:
    heavy = ("pinocchio", "casadi", "numba", "llvmlite", "matplotlib", "trimesh", "yourdfpy", "mujoco", "xacro")
    heavy += ("mpmath", "scipy.optimize", "scipy.stats")
    program = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


SOLVE = """
import sys, numpy as np, spm_pin as spm
geometry = spm.Geometry.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
assert spm.inverse_displacement(geometry, pose).exists.sum() == 6
assert spm.forward_physical(geometry, spm.inverse_physical(geometry, pose).leg_lengths).exists
print(*(name for name in sys.argv[1:] if name in sys.modules))
"""


def test_a_solve_loads_nothing_that_it_does_not_need() -> None:
    others = ("pinocchio", "casadi", "matplotlib", "scipy.optimize", "mpmath", "trimesh", "xacro")
    done = subprocess.run([sys.executable, "-c", SOLVE, *others], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_every_public_name_is_there_and_documented() -> None:
    for name in spm.__all__:
        member = getattr(spm, name)
        if callable(member):
            assert member.__doc__, name


def test_no_modules_import_each_other() -> None:
    """Imports within functions and for types alone count too."""
    package = Path(spm.__file__).parent
    names = {path: ".".join(path.relative_to(package.parent).with_suffix("").parts) for path in package.rglob("*.py")}
    names = {path: name.removesuffix(".__init__") for path, name in names.items()}
    graph: dict[str, set[str]] = {}
    for path, name in names.items():
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        found = {
            f"{node.module}.{alias.name}" if f"{node.module}.{alias.name}" in names.values() else str(node.module)
            for node in nodes
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        graph[name] = found & set(names.values()) - {name}
    assert len(graph) > 100
    graphlib.TopologicalSorter(graph).prepare()
