"""Singularities: found where the mechanism is singular, of the right kind, with the right screws."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from problems import (
    MANIPULATORS,
    PAPER,
    PAPER_TILTS,
    as_built,
    exact_wrench_matrices,
    in_leg_space,
    random_branches,
    singular_state,
    without_torsion,
    wrench_matrices,
)
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics.singularity_analysis import (
    SingularityKind,
    determinant_gradients,
    singular_values,
    singularities,
)

EPS = np.finfo(float).eps
LOWER, UPPER, STRUCTURE = range(3)


@pytest.fixture(scope="module")
def inverse() -> spm.Configuration:
    return singular_state(STRUCTURE, *PAPER_TILTS[STRUCTURE])


INVERSE, FORWARD, CONSTRAINT = SingularityKind.INVERSE, SingularityKind.FORWARD, SingularityKind.CONSTRAINT
# Tilt axis, sine of half the tilt and height of both stages; ranks of J_b, J_c and K, mobility and kind. Both stages
# tilted about the revolute axis of one leg are mirror symmetric and lose one freedom, level ones three; half a turn
# leaves a stage to its revolute joints.
KINDS = [
    ((0.4, 0.2, 1.1), (1.0, 0.2, -1.1), (6, 6, 6), 6, SingularityKind.REGULAR, "regular"),
    ((0.0, 0.0, 1.1), (0.0, 0.0, -1.1), (6, 6, 3), 3, INVERSE, "inverse"),
    *(
        ((azimuth, 0.2, 1.1), (azimuth, -0.1, -1.2), (6, 6, 5), 5, INVERSE, "inverse")
        for azimuth in np.arctan2(*PAPER.revolute_axes[:, 1::-1].T)
    ),
    ((0.4, 1.0, 0.8), (1.0, 0.2, -1.1), None, -1, CONSTRAINT | FORWARD | INVERSE, "inverse and forward and constraint"),
]


@pytest.mark.parametrize(("lower", "upper", "ranks", "mobility", "kind", "name"), KINDS)
def test_kind_rank_and_mobility(
    lower: tuple[float, ...], upper: tuple[float, ...], ranks: object, mobility: int, kind: SingularityKind, name: str
) -> None:
    state = without_torsion(PAPER, lower, upper)
    found = singularities(state)
    assert SingularityKind(int(found.kind)) == kind
    assert str(SingularityKind(int(found.kind))) == name
    assert found.mobility == mobility
    if ranks:
        np.testing.assert_array_equal(found.rank, ranks)
        assert np.linalg.matrix_rank(spm.kinematics.platform_jacobian(state), tol=1e-12) == mobility


def test_singularities_are_shown_by_kind_and_distance() -> None:
    pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    branches = spm.inverse_displacement(PAPER, pose)
    pair = spm.forward_physical(PAPER, [[1.3] * 6, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40]])
    for states, text in (
        (pair[0], "inverse; "),
        (branches["FT+"], "does not exist; "),
        (branches.configurations, "(8,) states, 6 exist, all regular; "),
        (pair, "(2,) states, 2 exist, 1 inverse; "),
    ):
        assert repr(spm.singularities(states)).startswith(f"<Singularities: {text}")


def moved(state: spm.Configuration, twist: np.ndarray, step: float) -> np.ndarray:
    """Move the middle joints by a finite screw: `step` seconds of a twist (v, ω) at o."""
    turn = Rotation.from_rotvec(step * twist[3:])
    offsets = state.middle_joints - state.translation
    return np.asarray(turn.apply(offsets) + state.translation + step * twist[:3])


def test_inner_twist_moves_the_middle_platform_between_two_fixed_ends(inverse: spm.Configuration) -> None:
    found = singularities(inverse, tolerance=1e-9)
    assert SingularityKind(int(found.kind)) is SingularityKind.INVERSE
    assert found.mobility == 5

    def gap(twist: np.ndarray, step: float) -> float:
        joints = moved(inverse, twist, step)
        return float(spm.Configuration(PAPER, inverse.pose, joints).closure_residual)

    # The closure opens with the square of the step along the inner twist, and in proportion along any other.
    free = [gap(found.inner_twist, step) for step in (1e-2, 1e-3, 1e-4)]
    assert 50 < free[0] / free[1] < 200
    assert 50 < free[1] / free[2] < 200
    other = np.random.default_rng(0).normal(size=6)
    bound = [gap(other, step) for step in (1e-3, 1e-4)]
    assert 8 < bound[0] / bound[1] < 12
    # Its legs have to give way, though: it is no idle freedom.
    arms = inverse.middle_joints - inverse.translation
    joint_velocities = found.inner_twist[:3] + np.cross(found.inner_twist[3:], arms)
    assert np.abs((joint_velocities * inverse.leg_vectors[:3]).sum(axis=-1)).max() > 1e-2


def test_lost_wrench_is_carried_without_the_legs(inverse: spm.Configuration) -> None:
    found = singularities(inverse, tolerance=1e-9)
    assert np.linalg.norm(found.lost_wrench[:3]) == pytest.approx(1.0)
    assert np.abs(spm.leg_forces(inverse, found.lost_wrench)).max() < 1e-11
    assert np.abs(spm.leg_forces(inverse, np.eye(6)[2])).max() > 0.1
    # No motion of the platform does work on it.
    assert np.abs(found.lost_wrench @ spm.kinematics.platform_jacobian(inverse)).max() < 1e-11


def test_gained_twist_leaves_the_leg_lengths() -> None:
    forward = singular_state(LOWER, *PAPER_TILTS[LOWER])
    found = singularities(forward, tolerance=1e-9)
    assert SingularityKind(int(found.kind)) is SingularityKind.FORWARD
    assert found.rank[LOWER] == 5
    assert found.mobility == -1
    a = PAPER.base_joints

    def change(step: float) -> float:
        joints = moved(forward, found.gained_twist[LOWER], step)
        planes = np.abs((joints * PAPER.revolute_axes).sum(axis=-1))
        lengths = np.linalg.norm(joints - a, axis=-1) - forward.leg_lengths[:3]
        return float(max(planes.max(), np.abs(lengths).max()))

    changes = [change(step) for step in (1e-2, 1e-3, 1e-4)]
    assert 50 < changes[0] / changes[1] < 200
    assert 50 < changes[1] / changes[2] < 200


@pytest.mark.parametrize("name", ["paper", "as built"])
@pytest.mark.parametrize("modes", spm.machine.FAMILIES)
def test_determinants_are_those_of_the_matrices_and_of_the_jacobian(name: str, modes: str) -> None:
    if name == "as built":
        branches = spm.inverse_displacement(as_built(PAPER, 5e-3), in_leg_space(PAPER, 60, seed=1).pose)
        state = branches[f"{modes}+"]
        state = state[state.exists]
    else:
        state = random_branches(MANIPULATORS[name], modes, 200, seed=1).configuration
    found, expected = singularities(state), np.linalg.det(wrench_matrices(state))
    np.testing.assert_allclose(found.scaled_determinants, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.determinants, expected * state.machine.middle_side**3, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.determinants, spm.determinants(state), rtol=1e-15)
    regular = state[found.sigma.min(axis=-1) > 5e-3]
    lower, upper, structure = np.moveaxis(spm.determinants(regular), -1, 0)
    np.testing.assert_allclose(np.linalg.det(spm.inverse_jacobian(regular)), lower * upper / structure, rtol=1e-9)


def test_gradients_are_finite_at_an_inverse_singularity(inverse: spm.Configuration) -> None:
    assert np.isfinite(determinant_gradients(inverse)).all()


def test_singular_values_are_those_of_forty_digits() -> None:
    """Small ones included: states up to 1e-14 from inverse and from forward singularities."""
    regular = in_leg_space(PAPER, 5, seed=8).configuration
    states = [regular[i] for i in range(5)]
    for which in PAPER_TILTS:
        singular = singular_state(which, *PAPER_TILTS[which])
        for away in (0.0, 1e-13, 1e-10, 1e-6):
            joints = singular.middle_joints + away * np.array([[1.0, 0.5, 0.2], [0.0, 0.3, 1.0], [0.4, 0.0, 0.1]])
            states.append(spm.Configuration(PAPER, singular.pose, joints))
    for state in states:
        found = singularities(state)
        with mpmath.workdps(40):
            matrices = exact_wrench_matrices(state, state.middle_joints.mean(axis=0), PAPER.middle_side)
            values = [mpmath.svd(matrix, compute_uv=False) for matrix in matrices]
        truth = np.array([[float(x) for x in row] for row in values])
        np.testing.assert_allclose(found.sigma, truth[:, -1], rtol=0, atol=16 * EPS)
        np.testing.assert_allclose(found.sigma * found.condition, truth[:, 0], rtol=16 * EPS)


@pytest.mark.parametrize(("size", "shape"), [((6, 6), (17, 2)), ((3, 6), ()), ((6, 3), (0,)), ((1, 5), (3,))])
def test_singular_values_of_any_matrices(size: tuple[int, int], shape: tuple[int, ...]) -> None:
    matrices = np.random.default_rng(3).normal(size=(*shape, *size)) * np.geomspace(1.0, 1e-9, size[1])
    found = singular_values(matrices)
    truth = np.linalg.svd(matrices, compute_uv=False)
    np.testing.assert_allclose(found, truth, rtol=0, atol=64 * EPS * truth.max(initial=0.0))
