"""Leg forces: symmetries, the equilibrium of every body, and the digits kept at an inverse singularity."""

from __future__ import annotations

import functools

import mpmath
import numpy as np
import problems
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import spm_pin as spm
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.rates_and_forces import inverse_jacobian, leg_forces, platform_jacobian
from spm_pin.paper import jacobian as paper

EPS = np.finfo(float).eps
PAPER = spm.Geometry.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
POOL = problems.in_leg_space(PAPER, 400, seed=51).configuration

batches = st.sampled_from([(), (1,), (3, 1, 2), (0,)])
seeds = st.integers(0, 2**32 - 1)


members = functools.partial(problems.members, POOL)


def six_branches() -> spm.Configuration:
    branches = spm.inverse_displacement(PAPER, POSE)
    return branches.configurations[branches.exists]


def stage_conditions(state: spm.Configuration) -> np.ndarray:
    """Condition number of J_b or J_c, the larger; moments at o, lengths in units of d."""
    b = state.middle_joints
    arms = (b - state.translation[..., None, :]) / state.geometry.middle_side
    legs = (state.leg_vectors / state.leg_lengths[..., None]).reshape(*b.shape[:-2], 2, 3, 3)
    axes = np.stack([np.broadcast_to(state.geometry.revolute_axes, b.shape), state.platform_axes], axis=-3)
    rows = [np.concatenate([f, np.cross(arms[..., None, :, :], f)], axis=-1) for f in (legs, axes)]
    return np.linalg.cond(np.concatenate(rows, axis=-2)).max(axis=-1)


@settings(max_examples=60)
@given(batches, seeds)
def test_a_batch_is_its_members(shape, seed):
    rng = np.random.default_rng(seed)
    state, wrench = members(shape, rng, absent=0.2), rng.normal(size=(*shape, 6))
    forces = leg_forces(state, wrench)
    assert forces.shape == (*shape, 6)
    assert np.array_equal(np.isfinite(forces), np.broadcast_to(state.exists[..., None], forces.shape))
    for index in np.ndindex(shape):
        member = state[index] if shape else state
        assert np.array_equal(forces[index], leg_forces(member, wrench[index]), equal_nan=True)


@settings(max_examples=30)
@given(batches, seeds)
def test_forces_are_the_transposed_platform_jacobian(shape, seed):
    rng = np.random.default_rng(seed)
    state, wrench = members(shape, rng), rng.normal(size=(*shape, 6))
    velocities = platform_jacobian(state)
    expected = -(np.swapaxes(velocities, -1, -2) @ wrench[..., None])[..., 0]
    size = np.linalg.norm(velocities, axis=(-1, -2)) * np.linalg.norm(wrench, axis=-1)
    error = np.linalg.norm(leg_forces(state, wrench) - expected, axis=-1)
    assert (error <= 8 * EPS * stage_conditions(state) * size).all()


def cross(v: np.ndarray) -> np.ndarray:
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def newton_euler(state: spm.Configuration, wrench: np.ndarray) -> tuple[np.ndarray, float]:
    """Actuator forces from the equilibrium of all fourteen bodies, each with its own joint reactions.

    Bodies: the terminal and the middle platform, and per leg a tube on its revolute joint and a rod at its ball
    joint. Unknown per leg: force and two moments of the revolute joint; the ball joint's force; and between tube
    and rod the actuator's push along the leg, two forces across it and three moments. 84 equations in 84
    unknowns; only joint positions and revolute axes are used. Also returned: the system's condition number.
    """
    a, b, c = state.geometry.base_joints, state.middle_joints, state.platform_joints
    axes = np.concatenate([state.geometry.revolute_axes, state.platform_axes])
    terminal, middle = 0, 1
    system, load = np.zeros((14, 6, 84)), np.zeros((14, 6))
    column = 0

    def act(body: int, point: np.ndarray, forces: np.ndarray, moments: np.ndarray, sign: float) -> None:
        """Put unknown forces at `point` and unknown moments, as columns, onto `body`; moments about o."""
        nonlocal column
        arm = cross((point - state.translation) / state.geometry.middle_side)
        n, m = forces.shape[1], moments.shape[1]
        system[body, :3, column : column + n] += sign * forces
        system[body, 3:, column : column + n] += sign * arm @ forces
        system[body, 3:, column + n : column + n + m] += sign * moments

    none = np.zeros((3, 0))
    actuators = []
    for leg in range(6):
        tube, rod = 2 + 2 * leg, 3 + 2 * leg
        i = leg % 3
        hinge = a[i] if leg < 3 else c[i]
        along = (b[i] - hinge) / np.linalg.norm(b[i] - hinge)
        frame = np.linalg.svd(along[None])[2]
        across = frame[1:].T
        not_free = np.linalg.svd(axes[leg][None])[2][1:].T
        act(tube, hinge, np.eye(3), not_free, 1.0)  # from the base, which needs no equilibrium, or from m
        if leg >= 3:
            act(terminal, hinge, np.eye(3), not_free, -1.0)
        column += 5
        act(rod, b[i], along[:, None], none, 1.0)  # the push of the actuator drives the rod away from the tube
        act(tube, b[i], along[:, None], none, -1.0)
        actuators.append(column)
        column += 1
        act(rod, hinge, across, np.eye(3), 1.0)
        act(tube, hinge, across, np.eye(3), -1.0)
        column += 5
        act(middle, b[i], np.eye(3), none, 1.0)
        act(rod, b[i], np.eye(3), none, -1.0)
        column += 3
    assert column == 84
    load[terminal] = np.concatenate([wrench[:3], wrench[3:] / state.geometry.middle_side])
    square = system.reshape(84, 84)
    return np.linalg.solve(square, -load.reshape(84))[actuators], float(np.linalg.cond(square))


@pytest.mark.parametrize("branch", range(6))
def test_every_body_is_in_equilibrium(branch):
    state = six_branches()[branch]
    for wrench in (*np.eye(6), np.concatenate(paper.load())):
        expected, condition = newton_euler(state, wrench)
        error = np.linalg.norm(leg_forces(state, wrench) - expected)
        size = np.linalg.norm(expected) + np.linalg.norm(wrench)
        assert condition < 1e6
        assert error <= 8 * EPS * (condition + stage_conditions(state)) * size


def test_every_body_is_in_equilibrium_in_every_family():
    rng = np.random.default_rng(53)
    for geometry in problems.GEOMETRIES.values():
        for family in spm.mechanism.FAMILIES:
            for state in problems.random_branches(geometry, family, 3, seed=54).configuration:
                wrench = rng.normal(size=6) * [1, 1, 1, *[geometry.middle_side] * 3]
                expected, condition = newton_euler(state, wrench)
                size = np.linalg.norm(expected) + np.linalg.norm(wrench)
                bound = 8 * EPS * (condition + stage_conditions(state)) * size
                assert np.linalg.norm(leg_forces(state, wrench) - expected) <= bound


def test_positive_forces_push():
    """A weight on a platform that stands nearly level on all legs is carried by every leg, pushing."""
    legs = 1.3 + 0.02 * np.random.default_rng(55).uniform(-1, 1, size=(50, 6))
    state = problems.in_leg_space(PAPER, 50, seed=0, legs=legs).configuration
    weight = 100.0
    forces = leg_forces(state, [0, 0, -weight, 0, 0, 0])
    assert (forces > 0).all()


def reference(state: spm.Configuration, wrench: np.ndarray) -> np.ndarray:
    """-Gᵀ w in fifty digits, of the state's own numbers."""
    with mpmath.workdps(50):
        mp, root = mpmath.mpf, mpmath.sqrt(3)
        radial = [[root / 2, -mp(1) / 2, 0], [0, 1, 0], [-root / 2, -mp(1) / 2, 0]]
        axes = [[mp(1) / 2, root / 2, 0], [1, 0, 0], [-mp(1) / 2, root / 2, 0]]
        R, o, b = (mpmath.matrix(array.tolist()) for array in (state.rotation, state.translation, state.middle_joints))
        E, C = mp(state.geometry.base_radius), mp(state.geometry.platform_radius)
        forces = []
        for upper in (False, True):
            rows = []
            for i in range(3):
                point = b[i, :].T
                u = mpmath.matrix(radial[i])
                leg = R * u * C + o - point if upper else point - u * E
                rows.append((point - o, leg / mpmath.norm(leg)))
            for i in range(3):
                axis = mpmath.matrix(axes[i])
                rows.append((b[i, :].T - o, R * axis if upper else axis))
            system = mpmath.matrix(6, 6)
            for k, (arm, f) in enumerate(rows):
                moment = [arm[(j + 1) % 3] * f[(j + 2) % 3] - arm[(j + 2) % 3] * f[(j + 1) % 3] for j in range(3)]
                for j in range(3):
                    system[j, k], system[3 + j, k] = f[j], moment[j]
            forces += list(mpmath.lu_solve(system, -mpmath.matrix(wrench.tolist()))[:3])
        return np.array([float(value) for value in forces])


def fold(target: float) -> spm.Configuration:
    """The branches TT+ and TT- where the discriminant of their family is about `target`, near the example."""
    direction = np.array([1.0, -0.5, 0.3])

    def solved(t: float) -> spm.SolutionSet:
        return spm.inverse_displacement(PAPER, spm.pose(POSE.translation + t * direction, rotation=POSE.rotation))

    far = next(t for t in np.linspace(0.0, 1.0, 101) if solved(t).discriminants[0] < 0.0)
    low, high = 0.0, far
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if solved(middle).discriminants[0] >= target else (low, middle)
    return solved(low).configurations[:2]


WRENCHES = np.random.default_rng(56).normal(size=(4, 6))


def losses(state: spm.Configuration) -> tuple[float, float, float]:
    """Worst relative errors of -Gᵀ w, of -J_f⁻ᵀ w and of the paper's Eq. (33) over some wrenches."""
    errors = []
    for wrench in WRENCHES:
        true = reference(state, wrench)
        inverted = -np.linalg.solve(inverse_jacobian(state).T, wrench)
        routes = leg_forces(state, wrench), inverted, paper.f_r(state, wrench[:3], wrench[3:])
        errors.append([np.linalg.norm(route - true) / np.linalg.norm(true) for route in routes])
    return tuple(np.max(errors, axis=0))


@pytest.mark.parametrize("target", [1e-2, 1e-6, 1e-10, 1e-14])
def test_digits_kept_towards_a_fold(target):
    """The error of -Gᵀ w does not depend on the discriminant; that of J_f's inverse grows with its inverse root."""
    branches = fold(target)
    errors = np.array([losses(state) for state in branches])
    assert (errors[:, 0] <= 8 * EPS * stage_conditions(branches)).all()
    assert errors[:, 0].max() <= 1e-12
    if target == 1e-14:
        assert errors[:, 1:].max(axis=0).min() > 1e4 * errors[:, 0].max()


def between(share: float) -> spm.Configuration:
    """A state between the branches that `fold` brings together: TT+ at 1, singular at 0.

    The closure equations are quadratic in b, so halfway their derivative along b(TT+) - b(TT-) is the difference
    of their values at the two ends, zero: det K vanishes there to the last bit, and grows linearly with the share.
    Closure is violated only to second order in the branches' distance.
    """
    plus, minus = fold(1e-14)
    middle, half = (plus.middle_joints + minus.middle_joints) / 2, (plus.middle_joints - minus.middle_joints) / 2
    return spm.Configuration(PAPER, plus.pose, middle + share * half)


def test_forces_halfway_between_two_branches():
    state = between(0.0)
    with pytest.raises(SingularConfigurationError, match=r"^inverse singularity: "):
        inverse_jacobian(state)
    for wrench in WRENCHES:
        true = reference(state, wrench)
        error = np.linalg.norm(leg_forces(state, wrench) - true) / np.linalg.norm(true)
        assert error <= min(1e-12, 8 * EPS * stage_conditions(state))


def test_forces_on_a_level_platform():
    """Level and on the axis, K has rank three; J_f does not exist, the forces do."""
    level = problems.without_torsion(PAPER, (0.0, 0.0, 1.3), (0.0, 0.0, -1.2))
    with pytest.raises(SingularConfigurationError, match=r"^inverse singularity: "):
        inverse_jacobian(level)
    for wrench in WRENCHES:
        true = reference(level, wrench)
        error = np.linalg.norm(leg_forces(level, wrench) - true) / np.linalg.norm(true)
        assert error <= 8 * EPS * stage_conditions(level)
    # By symmetry a weight is shared equally: each leg carries a third of it along its own slope.
    forces = leg_forces(level, [0, 0, -6.0, 0, 0, 0])
    slope = level.leg_vectors[:, 2] / level.leg_lengths
    assert np.allclose(forces * slope, 2.0, rtol=64 * EPS)


def test_singular_stages_are_refused():
    flat = problems.without_torsion(PAPER, (np.zeros(1), 0.0, 0.0), (np.ones(1), 0.2, -1.0))
    for wrench in (np.zeros(6), np.ones((3, 1, 6))):
        with pytest.raises(SingularConfigurationError, match=r"^forward singularity at batch index \(0,\)"):
            leg_forces(flat, wrench)


def test_leading_axes_broadcast():
    wrenches = np.random.default_rng(57).normal(size=(4, 1, 6))
    forces = leg_forces(POOL[:3], wrenches)
    assert forces.shape == (4, 3, 6)
    assert np.array_equal(forces[2, 1], leg_forces(POOL[1], wrenches[2, 0]))
    branches = spm.inverse_displacement(PAPER, POSE)
    assert np.array_equal(np.isfinite(leg_forces(branches.configurations, wrenches)[0]).all(axis=-1), branches.exists)


def test_wrenches_that_do_not_broadcast_are_refused():
    with pytest.raises(ArgumentError, match=r"wrench: expected leading axes that broadcast .* \(3,\)"):
        leg_forces(POOL[:3], np.zeros((2, 6)))
