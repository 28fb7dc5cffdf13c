"""Leg rates and the platform's twist: finite differences of the displacement, singular states."""

from __future__ import annotations

import functools

import numpy as np
import problems
import pytest
from error_fields import with_fields
from finite_differences import extrapolated
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics import SingularityKind
from spm_pin.kinematics.rates_and_forces import inverse_jacobian, leg_forces, leg_rates, platform_jacobian
from spm_pin.kinematics.singularity_analysis import determinant_gradients

EPS = np.finfo(float).eps
PAPER = spm.Manipulator.paper()
FAMILIES = [*(("paper", family) for family in spm.machine.FAMILIES), ("wide base", "TF"), ("millimetres", "FF")]


def norm(matrices: np.ndarray) -> np.ndarray:
    return np.linalg.norm(matrices, axis=(-1, -2))


def finite_differences(state: spm.Configuration, labels: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J_f from the displacement alone, and the error to expect; `size` is about the norm of J_f, for the steps.

    Two branches meet at a fold as square roots do, so its distance goes with 1/|J|², and the steps as well.
    """
    d = state.machine.middle_side
    unit = np.concatenate([np.eye(6), -np.eye(6)]) * np.array([1, 1, 1, *[1 / d] * 3])

    def central(h: np.ndarray) -> np.ndarray:
        step = h[:, None, None] * unit
        turn = Rotation.from_rotvec(step[..., 3:].reshape(-1, 3)).as_matrix().reshape(*step.shape[:2], 3, 3)
        pose = spm.pose(state.translation[:, None] + step[..., :3], rotation=turn @ state.rotation[:, None])
        lengths = spm.inverse_displacement(state.machine, pose).leg_lengths
        lengths = np.take_along_axis(lengths, labels[:, None, None, None], axis=-2)[..., 0, :]
        difference = lengths[:, :6] - lengths[:, 6:]
        return np.swapaxes(difference / (2 * h[:, None, None] * unit[:6].sum(axis=-1)[:, None]), -1, -2)

    h = 0.03 * d / size**2
    coarse, fine = extrapolated(central, 2 * h), extrapolated(central, h)
    # The pose's coordinates are rounded, and J_f magnifies that, over the smallest step.
    reach = np.linalg.norm(state.translation, axis=-1) + d
    rounding = 4 * EPS * reach * size / (h / 4)
    return fine, norm(fine - coarse) + rounding


@pytest.mark.parametrize(("name", "family"), [*FAMILIES, ("paper", "in leg space")])
def test_finite_differences(name, family):
    """Nearly all members must tell to four digits; so close to a fold that none is left, some may not."""
    if family == "in leg space":
        problem = problems.in_leg_space(PAPER, 500, seed=44)
    else:
        problem = problems.random_branches(problems.MANIPULATORS[name], family, 100, seed=43)
    state = problem.configuration
    solved = spm.inverse_displacement(problem.machine, problem.pose)
    distance = np.abs(solved.middle_joints - problem.middle_joints[:, None]).max(axis=(-1, -2))
    exact = inverse_jacobian(state)
    columns = np.array([1, 1, 1, *[state.machine.middle_side] * 3])
    size = norm(exact / columns)
    approximate, tolerance = finite_differences(state, np.nanargmin(distance, axis=-1), size)
    error = norm((approximate - exact) / columns)
    telling = tolerance < 1e-4 * size
    assert telling.mean() >= 0.9
    assert (error <= tolerance)[telling].all()


PATHS = {"inverse": 2, "forward": 0}
"""Which determinant vanishes."""
# Tilt axis, sine of half the tilt and height of both stages. Level at the height of the base, all forces of the lower
# stage are in one plane; tilted half round, its three revolute axes do not constrain it.
REGULAR, FLAT, TURNED_OVER = (
    problems.without_torsion(PAPER, lower, (2.0, 0.15, -1.1))
    for lower in ((0.3, 0.2, 1.2), (0.3, 0.0, 0.0), (0.3, 1.0, 1.2))
)


def test_singular_states() -> None:
    inverse, forward = (problems.singular_state(which, *problems.PAPER_TILTS[which]) for which in PATHS.values())
    constraint = TURNED_OVER
    expected = [
        (inverse, inverse_jacobian, "inverse"),
        (forward, platform_jacobian, "forward"),
        (forward, functools.partial(leg_forces, wrench=np.eye(6)[2]), "forward"),
        (constraint, inverse_jacobian, "constraint"),
        (constraint, platform_jacobian, "constraint"),
        (constraint, functools.partial(spm.kinematics.compliance, legs=1e7), "constraint"),
    ]
    for state, function, kind in expected:
        with pytest.raises(SingularConfigurationError, check=with_fields(kind=kind, index=())) as caught:
            function(state)
        assert caught.value.sigma_min <= 64 * EPS * 8**0.5  # |J|² <= 8: six unit forces with arms of d/√3
    with pytest.raises(SingularConfigurationError):
        leg_rates(inverse, np.zeros(6))
    # The other map is finite, and of rank five.
    for matrix in (platform_jacobian(inverse), inverse_jacobian(forward)):
        values = np.linalg.svd(matrix / np.abs(matrix).max(axis=0), compute_uv=False)
        assert values[-1] < 1e-12 < 1e-6 < values[-2]


def test_singular_members_of_a_batch_are_marked_and_the_others_computed():
    good, bad = REGULAR, FLAT
    absent = np.full((3, 3), np.nan)
    joints = np.array([[good.middle_joints, absent], [bad.middle_joints, bad.middle_joints]])
    pose = np.array([[good.pose.as_matrix()] * 2, [bad.pose.as_matrix()] * 2])
    joints[1, 1, 0] = PAPER.base_joints[0]  # a leg of no length
    states = spm.Configuration(PAPER, pose, joints)
    alone = [[True, False], [False, False]]
    functions = {
        platform_jacobian: (),
        leg_forces: (np.ones(6),),
        determinant_gradients: (),
        spm.kinematics.compliance: (1e7, 1e8),
        spm.calibration.error_jacobian: (),
    }
    for function, arguments in functions.items():
        result = function(states, *arguments)
        assert np.array_equal(np.isfinite(result).reshape(2, 2, -1).all(axis=-1), alone), function
        assert np.array_equal(np.isnan(result).reshape(2, 2, -1).all(axis=-1), np.logical_not(alone)), function
        np.testing.assert_allclose(result[0, 0], function(good, *arguments), rtol=1e-12)
    kinds = spm.singularities(states).kind
    assert np.array_equal((kinds & SingularityKind.FORWARD) > 0, [[False, False], [True, True]])
    # The leg rates of the flat stage exist; with a leg of no length nothing does.
    assert np.array_equal(np.isfinite(leg_rates(states, np.ones(6))).all(axis=-1), [[True, False], [True, False]])
    for function in (inverse_jacobian, platform_jacobian):
        with pytest.raises(SingularConfigurationError, check=with_fields(kind="forward")):
            function(states[1, 1])
    level = spm.forward_physical(PAPER, [[1.3] * 6, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40]])
    assert np.array_equal(np.isnan(inverse_jacobian(level)).any(axis=(-1, -2)), [True, False])
    assert list(spm.singularities(level).kind) == [SingularityKind.INVERSE, SingularityKind.REGULAR]


@pytest.mark.parametrize("path", PATHS)
def test_singular_means_singular_to_rounding(path):
    matrix, function = PATHS[path], inverse_jacobian if path == "inverse" else platform_jacobian
    make, value = problems.singular_path(matrix, *problems.PAPER_TILTS[matrix])
    decisions = []
    for offset in np.logspace(-16, -10, 61):
        state = make(value + offset)
        sigma = np.linalg.svd(problems.wrench_matrices(state)[matrix], compute_uv=False)
        relative = sigma[-1] / (64 * EPS * sigma[0])
        if abs(relative - 1) < 0.1:  # as good as on the line
            continue
        decisions.append(relative > 1)
        if relative > 1:
            assert np.isfinite(function(state)).all()
        else:
            with pytest.raises(SingularConfigurationError) as caught:
                function(state)
            assert caught.value.sigma_min == pytest.approx(sigma[-1], abs=8 * EPS)
    assert set(decisions) == {False, True}
