"""`spm-pin export`: every format, and options that contradict each other."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio
import pytest
import yaml
from cli.running import run

import spm_pin as spm
from spm_pin.description import CLOSURES_PATH, PACKAGE_PATH, URDF_PATH, mjcf_text, sdf_text, urdf_text


def test_every_format_is_what_the_writers_write(tmp_path: Path) -> None:
    for arguments, expected in (
        (["urdf", "--ros-constraints"], urdf_text(ros_constraints=True)),
        (["mjcf", "--collisions", "simple"], mjcf_text(collisions="simple")),
        (["sdf", "--loops", "drake"], sdf_text(loops="drake")),
    ):
        done = run("export", *arguments)
        assert done.returncode == 0, done.message
        assert done.stdout == expected
    target = tmp_path / "robot.yaml"
    assert run("export", "extended-urdf", "--out", str(target)).returncode == 0
    kept = yaml.safe_load(Path(CLOSURES_PATH).read_text(encoding="utf-8"))
    assert yaml.safe_load(target.read_text(encoding="utf-8")) == kept


@pytest.mark.parametrize(
    ("command", "name", "named"),
    [
        (["export", "mjcf"], "robot.xml", 'file="meshes/tube.obj"'),
        (["export", "sdf"], "robot.sdf", "<uri>meshes/tube.obj</uri>"),
        (["export", "urdf"], "robot.urdf", 'filename="meshes/tube.obj"'),
    ],
)
def test_meshes_are_put_beside_the_file(command: list[str], name: str, named: str, tmp_path: Path) -> None:
    target, shipped = tmp_path / name, Path(URDF_PATH).parent / "meshes"
    for _ in range(2):  # they may be there already
        done = run(*command, "--out", str(target))
        assert done.returncode == 0, done.message
    assert named in target.read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {name, "meshes"}
    for mesh in shipped.iterdir():
        assert (tmp_path / "meshes" / mesh.name).read_bytes() == mesh.read_bytes()
    advice = re.search(r"pinocchio\.buildModelsFromUrdf\(.*?\)", done.stderr)
    assert (advice is not None) == name.endswith(".urdf")
    if advice is not None:
        _, _, visual = eval(advice[0], {"pinocchio": pinocchio})
        assert visual.ngeoms == pinocchio.buildModelsFromUrdf(URDF_PATH, package_dirs=PACKAGE_PATH)[2].ngeoms
    (tmp_path / "meshes/tube.obj").write_text("mine", encoding="utf-8")  # another of the same name is kept
    refused = run(*command, "--out", str(target))
    assert (refused.returncode, "no other meshes beside the file" in refused.message) == (2, True)
    assert (tmp_path / "meshes/tube.obj").read_text(encoding="utf-8") == "mine"


def test_a_stage_in_every_format(tmp_path: Path) -> None:
    stage, file = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2)), tmp_path / "stage.yaml"
    stage.to_yaml(file)
    ball = spm.description.Ball()
    for arguments, expected in (
        (["urdf"], urdf_text(stage)),
        (["mjcf"], mjcf_text(stage)),
        (["mjcf", "--ball", "--actuators", "motors"], mjcf_text(stage, ball=ball, actuators="motors")),
        (["sdf", "--prefix", "left_"], sdf_text(stage, prefix="left_")),
        (["srdf"], spm.description.srdf_text(machine=stage)),
        (["extended-urdf"], spm.description.extended_urdf_text(stage)),
    ):
        done = run("export", *arguments, "--stage", file)
        assert done.returncode == 0, done.message
        assert done.stdout == expected
    sizes = ["--base", "80", "--platform", "90", "--crank", "50", "--rod", "110", "--unit", "mm"]
    sizes += ["--limits", *map(str, np.degrees([-0.6, 1.2]))]
    assert run("export", "urdf", *sizes).stdout == urdf_text(stage)
    done = run("export", "mjcf", "--stage", file, "--out", tmp_path / "balancer.xml")
    assert done.returncode == 0, done.message
    assert (tmp_path / "meshes" / "servo.obj").is_file()


def test_what_does_not_go_with_a_stage(tmp_path: Path) -> None:
    file = tmp_path / "stage.yaml"
    spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)).to_yaml(file)
    for arguments, message in (
        (["mjcf", "--ball"], "--ball: expected a single stage"),
        (["sdf", "--stage", file, "--ball"], "error: --ball cannot be used with sdf"),
        (["c", "--stage", file], "--machine: expected a manipulator, for c, got a stage"),
        (["ros2", "--machine", file], "--out: expected the directory to write into, got none"),
        (["c-stage"], "--machine: expected a stage: its file, or --base, --platform and so on, for c-stage"),
        (["c-stage", "--base", "80"], "--platform: expected a radius, or --machine with a file"),
    ):
        done = run("export", *arguments)
        assert done.returncode == 2
        assert message in done.message
