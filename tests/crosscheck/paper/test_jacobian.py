"""The paper's 9 x 9 system: against the motion itself, and against the wrench form."""

from __future__ import annotations

import numpy as np
import problems
import pytest
from error_fields import with_fields
from finite_differences import extrapolated
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.crosscheck.paper import jacobian
from spm_pin.crosscheck.paper.jacobian import f_r
from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics.rates_and_forces import inverse_jacobian

EPS = np.finfo(float).eps
PAPER = spm.Manipulator.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


@pytest.fixture(scope="module")
def six() -> spm.Configuration:
    branches = spm.inverse_displacement(PAPER, POSE)
    assert branches.count == 6
    return branches.configurations[branches.exists]


def norm(matrices: np.ndarray) -> np.ndarray:
    return np.linalg.norm(matrices, axis=(-1, -2))


def condition_bound(configuration: spm.Configuration) -> tuple[np.ndarray, np.ndarray]:
    """Return (scales, bound): how far two evaluations of J_f may differ, in the Frobenius norm of J_f * scales.

    Entries are products of unit vectors and arms off by a few eps; a change δA of a system A x = B moves x by
    A⁻¹ δA x. For the 9 x 9 system that is eps κ(J_α) |J|; for the wrench form X = K⁻¹ [0; K_c], with K_c of
    order one, eps κ(K) / σ_min(K). Lengths in units of d; moments at the middle platform's centre, and that
    moved to o, which magnifies by the distance.
    """
    d = configuration.machine.middle_side
    sigma_k = np.linalg.svd(problems.wrench_matrices(configuration)[..., 2, :, :], compute_uv=False)
    size = d + np.linalg.norm(configuration.translation - configuration.middle_joints.mean(axis=-2), axis=-1)
    scales = np.ones((*configuration.shape, 1, 6))
    scales[..., 0, 3:] /= size[..., None]
    nine = jacobian.J(configuration)[..., :6] * scales
    nine[..., 6:, :] *= d
    J_α = jacobian.J_alpha(configuration)
    J_α[..., 6:] /= d
    few = 8 * EPS
    return scales, few * (np.linalg.cond(J_α) * norm(nine) + sigma_k[..., 0] / sigma_k[..., -1] ** 2)


@pytest.mark.parametrize("family", ["in leg space", *spm.machine.FAMILIES])
def test_paper_and_closed_form_agree_at_random(family):
    if family == "in leg space":
        problem = problems.in_leg_space(PAPER, 1_000, seed=31)
    else:
        problem = problems.random_branches(problems.MANIPULATORS["wide base"], family, 500, seed=32)
    state = problem.configuration
    scales, bound = condition_bound(state)
    assert (norm((jacobian.J_f(state) - inverse_jacobian(state)) * scales) <= bound).all()


@pytest.mark.parametrize("label", ["TT+", "TF-"])
def test_all_nine_rows_are_derivatives(label):
    """Rates of the legs and of the lower legs' angles about R_i1, by finite differences of the displacement."""
    exact = jacobian.J(spm.inverse_displacement(PAPER, POSE)[label])[:, :6]
    radial = PAPER.radial_directions
    upright = np.cross(PAPER.revolute_axes, radial)

    def nine(steps: np.ndarray) -> np.ndarray:
        """Lengths and angles after twists (6, 6), one per row, times one second."""
        turned = Rotation.from_rotvec(steps[:, 3:]) * POSE.rotation
        state = spm.inverse_displacement(PAPER, spm.pose(POSE.translation + steps[:, :3], rotation=turned))[label]
        legs = state.leg_vectors[:, :3]
        angles = np.arctan2((legs * upright).sum(-1), (legs * radial).sum(-1))
        return np.concatenate([state.leg_lengths, angles], axis=-1)

    def central(h: float) -> np.ndarray:
        return ((nine(h * np.eye(6)) - nine(-h * np.eye(6))) / (2 * h)).T

    # Two branches meet at a fold as square roots do, so its distance goes with 1/|J|²: stay well inside.
    size = np.linalg.norm(exact)
    h = 0.03 / size**2
    coarse, fine = extrapolated(central, 2 * h), extrapolated(central, h)
    # Truncation is O(h⁶), so `fine` is off by about a 64th of its change; rounding of an inverse displacement is
    # that of the pose, whose coordinates go up to 3, times the Jacobian, over the smallest step.
    tolerance = np.abs(fine - coarse) + 4 * EPS * 3.0 * size / (h / 4)
    assert (tolerance < 1e-5 * size).all(), "too coarse to tell"
    assert (np.abs(fine - exact) <= tolerance).all()


def test_singular_states_are_refused(six):
    level = problems.without_torsion(PAPER, (np.zeros(1), 0.0, 1.0), (np.zeros(1), 0.0, -1.0))
    joints = np.concatenate([six.middle_joints, level.middle_joints])
    rotation = np.concatenate([six.rotation, level.rotation])
    mixed = spm.Configuration(
        PAPER, spm.pose(np.concatenate([six.translation, level.translation]), rotation=rotation), joints
    )
    singular = np.arange(len(joints)) == 6
    assert np.array_equal(np.isnan(jacobian.J_f(mixed)).all(axis=(-1, -2)), singular)
    assert np.array_equal(np.isnan(f_r(mixed, np.ones(3), np.ones(3))).all(axis=-1), singular)
    np.testing.assert_allclose(jacobian.J_f(mixed)[:6], jacobian.J_f(six), rtol=1e-9, atol=1e-11)
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")) as caught:
        jacobian.J_f(mixed[6])
    assert (caught.value.kind, caught.value.index) == ("inverse", ())
    assert caught.value.sigma_min <= 1e-14
    on_the_base = spm.Configuration(
        PAPER, POSE, np.where(np.eye(3)[0][:, None] > 0, PAPER.base_joints, six[0].middle_joints)
    )
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="forward")):
        jacobian.J_alpha(on_the_base)
    alone = np.stack([on_the_base.middle_joints, six[0].middle_joints])
    both = jacobian.J_f(spm.Configuration(PAPER, spm.pose([POSE.translation] * 2, rotation=POSE.rotation), alone))
    assert np.array_equal(np.isnan(both).any(axis=(-1, -2)), [True, False])
