from __future__ import annotations

import numpy as np
from problems import PAPER, at_discriminant, random_branches

import spm_pin as spm
from spm_pin.crosscheck import nlp
from spm_pin.crosscheck.tolerances import ROWS, Conditioning


def states(count: int = 40) -> spm.Configuration:
    parts = [random_branches(PAPER, family, count, 11).configuration for family in spm.machine.FAMILIES]
    return spm.Configuration(
        PAPER,
        np.concatenate([part.pose.as_matrix() for part in parts]),
        np.concatenate([part.middle_joints for part in parts]),
    )


def test_sigma_agrees_with_the_jacobian_of_casadi() -> None:
    sample = states(5)
    closure = nlp.closure(PAPER)
    expected = [
        np.linalg.svd(np.asarray(closure(s.middle_joints.ravel(), s.rotation, s.translation)[1]), compute_uv=False)[-1]
        for s in sample
    ]
    np.testing.assert_allclose(Conditioning.from_configuration(sample).sigma, expected, rtol=1e-10, atol=1e-14)


def test_norm_of_the_inverse_agrees_with_the_inverse_jacobian() -> None:
    built = PAPER.perturbed(1, length=1e-2, angle=1e-2)
    for sample in (states(5), spm.forward_physical(built, np.random.default_rng(0).uniform(1.15, 1.45, (20, 6)))):
        rates = spm.inverse_jacobian(sample) / np.repeat([1.0, PAPER.middle_side], 3)
        expected = 1.0 / np.linalg.svd(rates, compute_uv=False)[..., -1]
        rtol = 1e-6 if sample.machine.is_nominal else 1e-9
        np.testing.assert_allclose(Conditioning.from_configuration(sample).inverse, expected, rtol=rtol)


def test_position_bound_holds_for_perturbed_closures() -> None:
    """The equations are shifted by a residual as large as stated, and solved again by Newton's method."""
    sample, size = states(), 1e-7
    conditioning = Conditioning.from_configuration(sample)
    rounding = np.full(len(sample), size)
    sharp = conditioning.resolves(rounding)
    assert sharp.mean() > 0.5
    closure = nlp.closure(PAPER)
    rng = np.random.default_rng(0)
    ratios = []
    for k in np.flatnonzero(sharp):
        state = sample[int(k)]
        shift = size * rng.choice([-1.0, 1.0], 9)
        b = state.middle_joints.ravel()
        for _ in range(12):
            residual, jacobian = (np.asarray(part) for part in closure(b, state.rotation, state.translation))
            b = b - np.linalg.solve(jacobian, residual.ravel() - shift)
        ratios.append(np.linalg.norm(b - state.middle_joints.ravel()) / conditioning.position(rounding)[k])
    assert max(ratios) <= 1.0
    # The bound is not idle: some configurations come near it.
    assert max(ratios) > 0.1


def test_rate_bound_holds_for_perturbed_entries() -> None:
    sample = states(20)
    conditioning = Conditioning.from_configuration(sample)
    size = 1e-10
    rng = np.random.default_rng(1)
    derivatives = nlp.leg_jacobian(PAPER)
    scale = np.repeat([1.0, PAPER.middle_side], 3)
    ratios = []
    for k, state in enumerate(sample):
        if conditioning.sigma[k] < 1e-4:
            continue
        parts = [np.asarray(p) for p in derivatives(state.middle_joints.ravel(), state.rotation, state.translation)]
        parts[1], parts[3] = parts[1] / scale, parts[3] / scale
        length = min(float(state.leg_lengths.min()), PAPER.middle_side)
        noisy = [part + size / length * rng.uniform(-1.0, 1.0, part.shape) for part in parts]
        rates = [p[3] - p[2] @ np.linalg.solve(p[0], p[1]) for p in (parts, noisy)]
        ratios.append(np.linalg.norm(rates[0] - rates[1]) / float(conditioning.rates(np.array(size))[k]))
    assert len(ratios) > 40
    assert max(ratios) <= 1.0
    assert max(ratios) > 1e-3


def test_two_branches_near_a_fold_are_not_resolved() -> None:
    pose = at_discriminant(random_branches(PAPER, "TT", 1, 2).pose[0], 0, 1e-13, PAPER)
    pair = spm.inverse_displacement(PAPER, pose)
    plus, minus = pair["TT+"], pair["TT-"]
    both = spm.Configuration(PAPER, pose.as_matrix(), np.stack([plus.middle_joints, minus.middle_joints]))
    conditioning = Conditioning.from_configuration(both)
    rounding = np.full(2, 1e-13)
    assert not conditioning.resolves(rounding).any()
    apart = np.linalg.norm(plus.middle_joints - minus.middle_joints)
    assert apart <= conditioning.position(rounding).sum() * ROWS
