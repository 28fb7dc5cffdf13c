"""Leg forces: the digits kept towards an inverse singularity. Those of other states are compared with Pinocchio's."""

from __future__ import annotations

import mpmath
import numpy as np
import problems
import pytest
from error_fields import with_fields

import spm_pin as spm
from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics.rates_and_forces import inverse_jacobian, leg_forces

EPS = np.finfo(float).eps
PAPER = spm.Manipulator.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


def stage_conditions(state: spm.Configuration) -> np.ndarray:
    """Condition number of J_b or J_c, the larger; moments at o, lengths in units of d."""
    return np.linalg.cond(problems.wrench_matrices(state, state.translation)[..., :2, :, :]).max(axis=-1)


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


def error(state: spm.Configuration) -> float:
    """Return the worst relative error of -Gᵀ w over some wrenches."""
    pairs = [(leg_forces(state, wrench), reference(state, wrench)) for wrench in WRENCHES]
    return max(float(np.linalg.norm(found - true) / np.linalg.norm(true)) for found, true in pairs)


@pytest.mark.parametrize("h", [1e-2, 1e-6, 1e-14])
def test_digits_kept_towards_a_fold(h: float) -> None:
    """The error of -Gᵀ w does not depend on the distance."""
    branches = fold(h)
    errors = np.array([error(state) for state in branches])
    assert (errors <= np.minimum(1e-12, 8 * EPS * stage_conditions(branches))).all()


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
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")):
        inverse_jacobian(state)
    assert error(state) <= min(1e-12, 8 * EPS * stage_conditions(state))
