"""Chains of machines as built: loops, readings, files and states."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import problems
import pytest
from multibody.chains import EPS, PAPER, Array, chain

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.errors import ArgumentError, DescriptionError, GeometryError

pinocchio = pytest.importorskip("pinocchio")

from spm_pin.multibody.chain import ClosedChain  # noqa: E402


@cache
def built(name: str, size: float) -> Any:
    return ClosedChain.from_urdf(geometry=problems.as_built(problems.GEOMETRIES[name], size)) if size else chain(name)


def states(robot: Any, count: int, seed: int) -> spm.Configuration:
    """Physical states of a machine, about where its nominal one has its random branches without torsion."""
    nominal = robot.geometry.nominal
    start = problems.random_branches(nominal, "TT", 40 * count, seed).configuration
    if nominal.limits is not None:
        start = problems.in_leg_space(nominal, 4 * count, seed).configuration
    # Away from inverse singularities and from legs of no length: readings of machines near them are no test.
    far = (np.abs(spm.singularities(start).sigma[:, 2]) > 1e-2) & (
        start.leg_lengths.min(axis=-1) > 0.1 * nominal.middle_side
    )
    found = spm.forward_physical(robot.geometry, start.leg_lengths[far] + robot.geometry.legs.offsets)
    found = found[found.exists][:count]
    assert len(found) >= count // 2
    return found


def rounding(robot: Any, q: Array) -> float:
    """Closure gap that rounding explains: some eps times the length of a loop."""
    lengths = np.abs(robot.leg_lengths(q)).sum(axis=-1).max()
    return float(64.0 * EPS * (sum(robot.geometry.nominal.dimensions) + lengths))


@pytest.mark.parametrize("size", [0.0, 1e-3, 5e-2])
@pytest.mark.parametrize("name", problems.GEOMETRIES)
def test_states_have_joint_values_to_which_their_readings_and_poses_lead(name: str, size: float) -> None:
    robot = built(name, size)
    state, side = states(robot, 20, seed=4), robot.geometry.nominal.middle_side
    q = robot.joint_values(state)
    assert np.abs(robot.closure_gap(q)).max() <= rounding(robot, q)
    np.testing.assert_allclose(robot.leg_lengths(q), state.leg_lengths, atol=1e-14 * side)
    np.testing.assert_allclose(robot.readings(q), state.readings, atol=1e-14 * side)
    back = robot.configuration(q)
    assert back.geometry == robot.geometry
    np.testing.assert_allclose(back.pose.as_matrix(), state.pose.as_matrix(), atol=1e-13 * max(side, 1.0))
    np.testing.assert_allclose(back.middle_joints, state.middle_joints, atol=1e-13 * side)
    np.testing.assert_allclose(back.leg_lengths, state.leg_lengths, atol=1e-13 * side)
    found = robot.forward_kinematics(state.readings)
    assert np.abs(robot.closure_gap(found)).max() <= rounding(robot, found)
    np.testing.assert_allclose(found, q, atol=1e-9)
    np.testing.assert_allclose(robot.leg_lengths(found), state.leg_lengths, atol=1e-13 * side)
    # Readings a little away, from the joint values nearby, and back by the pose that they give.
    change = 1e-3 * side * np.random.default_rng(5).uniform(-1.0, 1.0, 6)
    for k in range(5):
        moved = robot.forward_kinematics(state.readings[k] + change, near=q[k])
        np.testing.assert_allclose(robot.readings(moved), state.readings[k] + change, atol=1e-13 * side)
        assert np.abs(robot.closure_gap(moved)).max() <= rounding(robot, moved)
        np.testing.assert_allclose(moved, robot.forward_kinematics(state.readings[k] + change), atol=1e-9)
        back_there = robot.inverse_kinematics(state[k].pose, near=moved)
        np.testing.assert_allclose(back_there, q[k], atol=1e-9)
        changed = robot.with_readings(q[k], state.readings[k] + 1e-2 * change)
        np.testing.assert_allclose(robot.leg_lengths(changed), state.leg_lengths[k] + 1e-2 * change, atol=1e-13 * side)


def test_offsets_change_readings_and_nothing_else() -> None:
    plain = built("paper", 1e-3)
    geometry = plain.geometry
    shift = np.array([0.5, -0.05, 0.02, 0.0, 0.03, 0.01])
    shifted = ClosedChain.from_urdf(
        geometry=replace(geometry, legs=replace(geometry.legs, offsets=geometry.legs.offsets + shift))
    )
    q = plain.joint_values(states(plain, 3, seed=16))
    np.testing.assert_allclose(shifted.readings(q) - plain.readings(q), np.broadcast_to(shift, (3, 6)), atol=1e-15)
    np.testing.assert_array_equal(shifted.leg_lengths(q), plain.leg_lengths(q))
    np.testing.assert_allclose(shifted.forward_kinematics(plain.readings(q) + shift), q, atol=1e-12)
    np.testing.assert_allclose(shifted.with_readings(q, plain.readings(q) + shift), q, atol=1e-15)
    with pytest.raises(ArgumentError, match=r"readings: expected legs of no negative length, got -0\.4\d+ m in r_b1"):
        shifted.forward_kinematics([0.05, 1.3, 1.3, 1.3, 1.3, 1.3], near=q[0])


def test_files_and_geometries_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    geometry = problems.as_built(PAPER, 1e-3)
    limited = spm.LegLimits(1.2, 1.5)
    larger = [replace(PAPER, **{name: 1.01 * getattr(PAPER, name)}) for name in ("base_radius", "middle_side")]
    moved = problems.as_built(PAPER, 1e-3, seed=4), geometry.from_parameters(geometry.parameters + 1e-8)
    others = {
        geometry: (None, PAPER, *moved, replace(geometry, limits=limited)),
        PAPER: (geometry, *larger, replace(PAPER, limits=limited)),
    }
    file, message = tmp_path / "robot.urdf", "The arguments geometry and prefix are those the file was written for"
    for written, machines in others.items():
        file.write_text(urdf_text(written), encoding="utf-8")
        for machine in machines:
            with pytest.raises(DescriptionError, match=message):
                ClosedChain.from_urdf(file, machine)


def test_states_of_other_machines_are_refused() -> None:
    robot = built("paper", 1e-3)
    state = states(robot, 2, seed=18)
    nominal = chain().configuration(chain().joint_values(states(chain(), 1, seed=18)))
    with pytest.raises(GeometryError, match=r"the axes of the chain, got a machine that differs by .* rad in r_"):
        robot.joint_values(nominal)
    with pytest.raises(GeometryError, match="the axes of the chain, got a machine that differs"):
        chain().joint_values(state)
    other = problems.as_built(PAPER, 1e-3)
    moved = replace(other, legs=replace(other.legs, offsets=other.legs.offsets + 2e-6 * (np.arange(6) == 4)))
    with pytest.raises(GeometryError, match=r"the offsets of the chain, .* differs by 2\.0e-06 m in r_c2"):
        robot.joint_values(spm.Configuration(moved, state.pose, state.middle_joints))
    # Limits of the legs play no part.
    same = spm.Configuration(replace(other, limits=None), state.pose, state.middle_joints)
    np.testing.assert_array_equal(robot.joint_values(same), robot.joint_values(state))
    torn = spm.Configuration(robot.geometry, state.pose, state.middle_joints + 1e-6 * PAPER.middle_side)
    with pytest.raises(ArgumentError, match="a closed mechanism"):
        robot.joint_values(torn)
