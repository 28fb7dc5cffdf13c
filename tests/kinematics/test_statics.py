"""Leg forces: symmetries, the equilibrium of every body, and the digits kept at an inverse singularity."""

from __future__ import annotations

import mpmath
import numpy as np
import problems
import pytest

import spm_pin as spm
from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics.rates_and_forces import inverse_jacobian, leg_forces
from spm_pin.paper import jacobian as paper

EPS = np.finfo(float).eps
PAPER = spm.Geometry.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


def stage_conditions(state: spm.Configuration) -> np.ndarray:
    """Condition number of J_b or J_c, the larger; moments at o, lengths in units of d."""
    return np.linalg.cond(problems.wrench_matrices(state, state.translation)[..., :2, :, :]).max(axis=-1)


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


def test_every_body_is_in_equilibrium():
    rng = np.random.default_rng(53)
    for geometry in problems.GEOMETRIES.values():
        for family in spm.mechanism.FAMILIES:
            for state in problems.random_branches(geometry, family, 3, seed=54).configuration:
                wrench = rng.normal(size=6) * [1, 1, 1, *[geometry.middle_side] * 3]
                expected, condition = newton_euler(state, wrench)
                size = np.linalg.norm(expected) + np.linalg.norm(wrench)
                bound = 8 * EPS * (condition + stage_conditions(state)) * size
                assert np.linalg.norm(leg_forces(state, wrench) - expected) <= bound


def reference(state: spm.Configuration, wrench: np.ndarray) -> np.ndarray:
    """-Gᵀ w in fifty digits, of the state's own numbers."""
    with mpmath.workdps(50):
        stages = problems.exact_wrench_matrices(state, state.translation)[:2]
        forces = [mpmath.lu_solve(stage.T, -mpmath.matrix(wrench.tolist()))[:3] for stage in stages]
    return np.array([float(force) for stage in forces for force in stage])


def fold(h: float) -> spm.Configuration:
    """The branches TT+ and TT- at `h` [m] from where they meet, near the example."""
    return spm.inverse_displacement(PAPER, problems.at_discriminant(POSE, 0, h, PAPER)).configurations[:2]


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


@pytest.mark.parametrize("h", [1e-2, 1e-6, 1e-10, 1e-14])
def test_digits_kept_towards_a_fold(h):
    """The error of -Gᵀ w does not depend on the distance; that of J_f's inverse grows with its inverse root."""
    branches = fold(h)
    errors = np.array([losses(state) for state in branches])
    assert (errors[:, 0] <= 8 * EPS * stage_conditions(branches)).all()
    assert errors[:, 0].max() <= 1e-12
    if h == 1e-14:
        assert errors[:, 1:].max(axis=0).min() > 1e4 * errors[:, 0].max()


def halfway() -> spm.Configuration:
    """The state halfway between the branches that `fold` brings together.

    The closure equations are quadratic in b, so halfway their derivative along b(TT+) - b(TT-) is the difference
    of their values at the two ends, zero: det K vanishes there to the last bit. Closure is violated only to second
    order in the branches' distance.
    """
    plus, minus = fold(1e-14)
    return spm.Configuration(PAPER, plus.pose, (plus.middle_joints + minus.middle_joints) / 2)


# Level and on the axis, K has rank three; J_f does not exist, the forces do.
LEVEL = problems.without_torsion(PAPER, (0.0, 0.0, 1.3), (0.0, 0.0, -1.2))


@pytest.mark.parametrize("make", [halfway, lambda: LEVEL], ids=["halfway between two branches", "level"])
def test_forces_at_an_inverse_singularity(make):
    state = make()
    with pytest.raises(SingularConfigurationError, match=r"^inverse singularity: "):
        inverse_jacobian(state)
    for wrench in WRENCHES:
        true = reference(state, wrench)
        error = np.linalg.norm(leg_forces(state, wrench) - true) / np.linalg.norm(true)
        assert error <= min(1e-12, 8 * EPS * stage_conditions(state))
