"""Import of the package: heavy libraries on first use only, public types, and no modules that import each other."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

import spm_pin as spm

HEAVY = "pinocchio casadi numba llvmlite matplotlib trimesh yourdfpy mujoco gymnasium xacro flint scipy.optimize "
HEAVY += "scipy.stats"


SOLVE = """
import spm_pin as spm, numpy as np
machine = spm.Manipulator.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
assert spm.forward_physical(machine, spm.inverse_displacement(machine, pose).physical().leg_lengths).exists
"""

PLAN = """
import spm_pin as spm
machine = spm.Manipulator.paper()
start, goal = spm.forward_physical(machine, [[1.2, 1.3, 1.25, 1.4, 1.3, 1.2], [1.25, 1.25, 1.3, 1.35, 1.3, 1.25]])
assert isinstance(spm.plan(machine, start, goal).path, spm.PlatformPath | spm.motion.LegPath)
"""

FOLLOW = """
import numpy as np, pinocchio as pin
from spm_pin.loops import Anchor, ClosedChain, Closure
model = pin.Model()
for parent, name, x in ((0, "crank", 0.0), (1, "coupler", 0.1), (0, "rocker", 0.3)):
    model.addJointFrame(model.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name))
ends = [Anchor(name, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))) for name, x in (("coupler", 0.35), ("rocker", 0.25))]
chain = ClosedChain(model, [Closure("planar", *ends)], ["crank"], q0=[0.6, 0.4, 1.2])
chain.forward([0.7])
"""

COMMAND = """
import sys
from spm_pin.cli import main
sys.argv = {}
try:
    main()
except SystemExit as end:
    assert not end.code
"""


def command(text: str) -> str:
    return COMMAND.format(["spm-pin", *text.split()])


@pytest.mark.parametrize(
    "steps",
    [
        [
            (command("--help"), "numpy scipy yaml spm_pin.cli.options spm_pin.machine"),
            (command("stage --help"), "numpy scipy yaml spm_pin.cli.options spm_pin.machine"),
            (command("export c-stage --base 0.5 --platform 0.3 --out board"), "casadi numba pinocchio"),
        ],
        [
            ("import spm_pin", HEAVY),
            ("import spm_pin.cli.application", HEAVY),
            (SOLVE, "pinocchio casadi matplotlib scipy.optimize flint trimesh xacro"),
            ("import spm_pin.display.plots", "matplotlib trimesh"),
            ("import spm_pin.description.tree", "pinocchio"),
            ("import spm_pin.crosscheck", "casadi pinocchio"),
            (PLAN, "pinocchio"),
        ],
        [(FOLLOW, "numba casadi")],
    ],
    ids=["commands", "functions", "loops"],
)
def test_steps_in_one_process_load_nothing_that_they_do_not_need(steps: list[tuple[str, str]], tmp_path: Path) -> None:
    program = "import sys\n"
    for step, absent in steps:
        program += f"{step}\nloaded = {set(absent.split())} & sys.modules.keys()\nassert not loaded, loaded\n"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


WATCH = """
import os, sys, numpy as np
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes, os.PathLike)):
        writes = arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        assert not writes or os.path.dirname(os.path.abspath(os.fsdecode(arguments[0]))) != os.getcwd(), arguments
    if event in ("os.mkdir", "os.rename", "os.symlink"):
        assert os.path.dirname(os.path.abspath(os.fsdecode(arguments[0]))) != os.getcwd(), arguments
sys.addaudithook(watch)
import spm_pin as spm
from spm_pin.cli import main
machine = spm.Manipulator.paper()
state = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.5])
spm.ClosedChain.from_urdf().joint_values(state)
sys.argv = ["spm-pin", "draw", "--out", sys.argv[1]]
main()
"""


def test_nothing_is_written_into_the_working_folder(tmp_path: Path) -> None:
    """So that it may be read-only; permissions do not hold for root, hence by watching."""
    (tmp_path / "here").mkdir()
    command = [sys.executable, "-c", WATCH, str(tmp_path / "picture.png")]
    done = subprocess.run(command, cwd=tmp_path / "here", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "picture.png").exists()
    assert not list((tmp_path / "here").iterdir())


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


def test_the_former_name_of_a_manipulator_works_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="Manipulator"):
        assert spm.Geometry is spm.Manipulator
