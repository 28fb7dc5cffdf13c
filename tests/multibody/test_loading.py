"""Chains from the description and from URDF files, and the files that are refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from error_fields import with_fields
from multibody.chains import MACHINES, NAMES, chain, placed, six_branches

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.description.source_files import ENTRY, URDF, description_file
from spm_pin.errors import DescriptionError

pinocchio = pytest.importorskip("pinocchio")

from spm_pin.multibody.chain import ClosedChain  # noqa: E402

SHIPPED = description_file(URDF)


@pytest.mark.parametrize(("name", "prefix"), [*((name, "") for name in NAMES), ("as built", "left_")])
def test_a_file_gives_the_chain_of_its_geometry(name: str, prefix: str, tmp_path: Path) -> None:
    machine = MACHINES[name]
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_text(machine, prefix=prefix), encoding="utf-8")
    robot = ClosedChain.from_urdf(path, machine, prefix=prefix)
    expected = ClosedChain.from_urdf(machine=machine, prefix=prefix) if prefix else chain(name)
    assert robot.machine == machine
    assert all(name.startswith(prefix) for name in robot.joint_names)
    assert robot.joint_indices(f"{prefix}leg_b2_hip") == chain(name).joint_indices("leg_b2_hip")
    ((state, q),) = placed(name, 1, seed=91)[:1]
    assert np.abs(robot.state(q).closure_gap()).max() <= 1e-13
    assert np.allclose(robot.state(q).configuration().middle_joints, state.middle_joints, atol=1e-13)
    assert np.array_equal(q, expected.joint_values(state))
    # The description of this package and its expanded xacro are one robot.
    for mine, other in zip(robot.model.inertias, expected.model.inertias, strict=True):
        assert np.allclose(mine.toDynamicParameters(), other.toDynamicParameters(), rtol=1e-12, atol=1e-12)
    for limit in ("lowerPositionLimit", "upperPositionLimit", "upperVelocityLimit", "upperEffortLimit"):
        assert np.allclose(getattr(robot.model, limit), getattr(expected.model, limit), rtol=1e-14)
    for shapes in ("visual_model", "collision_model"):
        assert getattr(robot, shapes).ngeoms == getattr(expected, shapes).ngeoms
    assert len(robot.collision_model.collisionPairs) == len(chain(name).collision_model.collisionPairs)


def test_inertias_and_limits_may_differ(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    text = SHIPPED.read_text(encoding="utf-8")
    path.write_text(text.replace('<mass value="', '<mass value="1'), encoding="utf-8")
    assert ClosedChain.from_urdf(path).model.inertias[1].mass != chain().model.inertias[1].mass
    path.write_text(text.replace('upper="0.19999999999999996"', 'upper="0.1"'), encoding="utf-8")
    assert path.read_text(encoding="utf-8") != text
    robot = ClosedChain.from_urdf(path)
    assert robot.model.upperPositionLimit[robot.leg_indices].max() == 0.1
    state = six_branches()[0]
    assert np.array_equal(robot.joint_values(state), chain().joint_values(state))


@pytest.mark.parametrize(
    ("old", "new", "received"),
    [
        ('name="leg_b2_hip"', 'name="hip_b2"', "leg_b2_hip missing, hip_b2 foreign"),
        ('<joint name="leg_b2_hip" type="revolute">', '<joint name="leg_b2_hip" type="fixed">', "leg_b2_hip missing"),
        ('<joint name="leg_b2_hip" type="revolute">', '<joint name="leg_b2_hip" type="continuous">', "nq = 19"),
        ('"middle_b3"', '"corner_b3"', "middle_b3 missing"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', "m off where all joints are turned"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>', "m off where all joints are turned"),
    ],
    ids=["renamed joint", "locked joint", "continuous joint", "renamed link", "turned axis", "reversed slide"],
)
def test_other_trees_are_refused(old: str, new: str, received: str, tmp_path: Path) -> None:
    text = SHIPPED.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "robot.urdf"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        ClosedChain.from_urdf(path)
    assert received in caught.value.received


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        *((r'<mass value="[^"]*"', f'<mass value="{mass}"', "a mass from 0") for mass in ("-5", "1e300", "nan", "inf")),
        ('ixx="', 'ixx="-', "moments of inertia of which none is negative"),
        ('<joint name="base_a1_mount"', '<joint name="base"', "names of joints that no link has"),
    ],
)
def test_impossible_inertias_and_names(old: str, new: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    text, count = re.subn(old, new, SHIPPED.read_text(encoding="utf-8"), count=1)
    assert count == 1
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        ClosedChain.from_urdf(path)
    assert caught.value.argument.startswith(str(path))
    assert caught.value.expected.startswith(expected)


def test_files_that_are_no_urdf(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="expected a readable URDF file"):
        ClosedChain.from_urdf(tmp_path / "missing.urdf")
    with pytest.raises(DescriptionError, match=r"expected a URDF, .* Not expanded yet"):
        ClosedChain.from_urdf(description_file(ENTRY))
    with pytest.raises(
        DescriptionError, match=r"got left_ball_b1_x, left_ball_b1_y, left_ball_b1_z, … missing, ball_b1_x, .* foreign"
    ):
        ClosedChain.from_urdf(SHIPPED, prefix="left_")


def test_shapes_and_the_wrapper() -> None:
    pytest.importorskip("coal")
    robot = chain()
    assert robot.visual_model.ngeoms > robot.collision_model.ngeoms > 0
    assert robot.visual_model is robot.visual_model
    pairs = len(robot.collision_model.collisionPairs)
    assert 0 < pairs < robot.collision_model.ngeoms * (robot.collision_model.ngeoms - 1) // 2
    wrapper = robot.robot_wrapper()
    assert wrapper.model is not None
    assert wrapper.nq == 18
    assert wrapper.visual_model.ngeoms == robot.visual_model.ngeoms
    data, results = robot.model.createData(), robot.collision_model.createData()
    assert not pinocchio.computeCollisions(
        robot.model, data, robot.collision_model, results, pinocchio.neutral(robot.model), False
    )


def test_a_machine_in_place_of_a_file_is_sent_to_its_argument() -> None:
    for machine in (spm.Manipulator.paper(), spm.Stage(0.7, 0.46)):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="path")) as error:
            ClosedChain.from_urdf(machine)  # type: ignore[arg-type]
        assert "machine=" in error.value.cause
