"""What a stage holds and how fast it moves, by linear programmes whose equilibrium is that of forces at the balls."""

from __future__ import annotations

import numpy as np
import pytest
from balancers import MACHINES, STEP, equilibrium, existing_states, stage_and_height
from error_fields import with_fields
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.capability import acceleration_polytope, joint_reactions, velocity_polytope, wrench_polytope
from spm_pin.kinematics import MOTION

LIMITS = np.array([[-3.0, -4.0, -5.0], [6.0, 5.0, 7.0]])
LOAD = np.array([0.5, -0.2, -3.0, 0.02, -0.03, 0.01])


def states_of(machine: str) -> spm.Configuration:
    stage, height = stage_and_height(machine)
    states = existing_states(stage, height, 40)
    singular = spm.singularities(states)
    return states[(singular.forward > 0.1) & (singular.leg.min(axis=-1) > 0.2)][:6]


def extent(state: spm.Configuration, direction: np.ndarray, axial: float) -> float:
    """Return the largest multiple of a wrench that efforts and axial forces balance, LOAD besides; inf without end."""
    matrix = np.column_stack([equilibrium(state), direction])
    scale = np.abs(matrix).max(axis=-1)
    bounds = [*LIMITS.T, *[(-axial, axial)] * 3, (0.0, None)]
    found = linprog([0.0] * 6 + [-1.0], A_eq=matrix / scale[:, None], b_eq=-LOAD / scale, bounds=bounds)
    return {0: lambda: float(found.x[-1]), 2: lambda: 0.0, 3: lambda: np.inf}[found.status]()


@pytest.mark.parametrize("machine", MACHINES)
def test_the_wrenches_held_are_those_of_linear_programmes(machine: str) -> None:
    states = states_of(machine)
    directions = np.random.default_rng(1).normal(size=(len(states), 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
    held = wrench_polytope(states, LIMITS, load=LOAD)
    bearing = held.within(joint_reactions(states).axial, 4.0, load=LOAD)
    for polytope, axial in ((held, np.inf), (bearing, 4.0)):
        expected = [extent(state, direction, axial) for state, direction in zip(states, directions, strict=True)]
        np.testing.assert_allclose(polytope.extent(directions), expected, rtol=1e-6)
        expected = [extent(state, np.array([0, 0, -1.0, 0, 0, 0]), axial) for state in states]
        np.testing.assert_allclose(polytope.extent([0, 0, -1, 0, 0, 0]), expected, rtol=1e-6)


@pytest.mark.parametrize("machine", MACHINES)
def test_reactions_are_what_the_joints_carry(machine: str) -> None:
    states = states_of(machine)
    reactions, loads = joint_reactions(states), spm.kinematics.joint_loads(states, LOAD)
    np.testing.assert_allclose(reactions.axial @ LOAD, loads.across, atol=1e-9)
    sizes = np.abs((reactions.ball @ LOAD).reshape(len(states), 3, 8)).max(axis=-1)
    forces = np.linalg.norm(loads.balls, axis=-1)
    assert (sizes >= forces * (1.0 - 1e-9)).all()
    assert (sizes <= forces * 1.02 + 1e-9).all()


def after(states: spm.Configuration, twists: np.ndarray) -> spm.Configuration:
    """Return the states displaced and turned by twists (N, 6) times a short time."""
    poses = states.pose.as_matrix().copy()
    poses[:, :3, :3] = Rotation.from_rotvec(STEP * twists[:, 3:]).as_matrix() @ poses[:, :3, :3]
    poses[:, :3, 3] += STEP * twists[:, :3]
    return spm.Configuration(states.machine, poses)


@pytest.mark.parametrize("machine", MACHINES)
def test_at_the_corners_of_the_motions_differences_of_readings_are_at_their_limits(machine: str) -> None:
    states = states_of(machine)
    corners = velocity_polytope(states, LIMITS).vertices
    assert corners.shape == (len(states), 8, 3)
    for number in range(8):
        twists = (spm.kinematics.parasitic_jacobian(states) @ corners[:, number, :, None])[..., 0]
        rates = (after(states, twists).readings - after(states, -twists).readings) / (2.0 * STEP)
        expected = LIMITS[[number >> leg & 1 for leg in range(3)], range(3)]
        np.testing.assert_allclose(rates, np.tile(expected, (len(states), 1)), atol=1e-5)


def test_balls_of_motions_are_the_slowest_directions() -> None:
    states = states_of("RRS as built")
    fast = velocity_polytope(states, 2.0)
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    directions = np.stack([np.zeros_like(angles), np.cos(angles), np.sin(angles)], axis=-1)
    around = fast.extent(directions[:, None]).min(axis=0)
    np.testing.assert_allclose(fast.ball("angular"), around, rtol=1e-4)
    up = np.minimum(fast.extent([1.0, 0, 0]), fast.extent([-1.0, 0, 0]))
    np.testing.assert_allclose(fast.ball("linear"), up)
    body = velocity_polytope(states[0], 2.0).section("motion").vertices
    found, expected = (x[np.lexsort(x.round(9).T)] for x in (body, fast.vertices[0]))
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("machine", ["RPS", "PRS as built", "RRS as built"])
def test_accelerations_take_the_efforts_of_newton_s_second_law(machine: str) -> None:
    states = states_of(machine)
    plate = np.diag([2.0, 2.0, 2.0, 0.01, 0.012, 0.02])
    weight = np.array([0.0, 0.0, -2.0 * 9.81, 0.0, 0.0, 0.0])
    parasitic = spm.kinematics.parasitic_jacobian(states)
    mass, load = parasitic.mT @ plate @ parasitic, (parasitic.mT @ weight[:, None])[..., 0]
    quick = acceleration_polytope(states, 40.0 * LIMITS, mass, load)
    for number, accelerations in ((0, quick.vertices[:, 0]), (7, quick.vertices[:, 7])):
        # The plate's own force and moment from rest, which the joints and efforts balance.
        inertia = weight - ((plate @ parasitic) @ accelerations[..., None])[..., 0]
        for state, wrench in zip(states, inertia, strict=True):
            efforts = np.linalg.solve(equilibrium(state), -wrench)[:3]
            np.testing.assert_allclose(efforts, 40.0 * LIMITS[int(number > 0)], rtol=1e-6)
    assert parasitic.shape[-2:] == (6, 3)
    assert np.allclose(parasitic[..., MOTION, :], np.eye(3))


def test_a_level_tripod_lifts_three_times_what_a_leg_pushes() -> None:
    level = spm.inverse_physical(spm.Stage(0.2, 0.2), 0.5)
    held = wrench_polytope(level, 100.0)
    assert held.extent([0, 0, -1, 0, 0, 0]) == pytest.approx(300.0)
    assert held.ball("linear") == pytest.approx(300.0)
    # The leg at 90° pushes 100 N at 0.2 m from the axis x, and the others pull 50 N each at 0.1 m.
    assert held.extent([0, 0, 0, 1, 0, 0]) == pytest.approx(30.0)
    assert held.extent([1, 0, 0, 0, 0, 0]) == np.inf
    assert np.isnan(held.ellipsoid().semi_axes).all()
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="vertices")):
        _ = held.vertices
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="polytope")):
        held.section()
    closed = held.within(joint_reactions(level).axial, 50.0).section()
    assert np.abs(closed.vertices[:, 2]).max() == pytest.approx(300.0)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="force_limits")):
        wrench_polytope(level, np.ones(6))
