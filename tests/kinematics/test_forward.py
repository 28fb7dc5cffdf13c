"""Forward displacement: all assembly modes are found; lengths with none or with a family are reported."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from problems import MANIPULATORS, PAPER, Problem, distance, random_branches
from stage_oracle import certified_modes

import spm_pin as spm
from spm_pin.kinematics.forward_displacement import ASSEMBLY_MODES, forward_displacement, forward_physical

EPS = np.finfo(float).eps
LEGS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])


def sensitivity(state: spm.Configuration) -> np.ndarray:
    """Platform motion [m] per change of a leg [m]; infinite where it is singular."""
    gain = np.full(state.shape, np.inf)
    for k in np.ndindex(state.shape):
        try:
            matrix = spm.kinematics.platform_jacobian(state[k])
        except spm.SingularConfigurationError:
            continue
        matrix[3:] *= state.machine.middle_side + state.machine.platform_radius
        gain[k] = np.linalg.norm(matrix)
    return gain


def assert_modes(solutions: spm.SolutionSet, lengths: np.ndarray) -> None:
    """Every mode closes, has the lengths, and no two of a problem are the same."""
    exists = solutions.exists
    size = solutions.machine.middle_side + lengths.max(axis=-1)[..., None]
    assert (np.where(exists, solutions.residual, 0.0) <= 64 * EPS * size).all()
    error = np.abs(solutions.leg_lengths - lengths[..., None, :]).max(axis=-1)
    # A leg much shorter than the machine is known as well as the machine's coordinates are.
    assert (np.where(exists, error, 0.0) <= 64 * EPS * size**2 / lengths.min(axis=-1)[..., None]).all()


def assert_found(problem: Problem) -> None:
    known = problem.configuration
    lengths = known.leg_lengths
    solutions = forward_displacement(problem.machine, lengths)
    assert (solutions.status == spm.Status.OK).all()
    assert_modes(solutions, lengths)
    error = distance(solutions.nearest(known), known)
    size = problem.machine.middle_side + lengths.max(axis=-1)
    doubtful = error > 64 * EPS * size
    assert doubtful.mean() < 0.5
    assert (error[doubtful] <= 64 * EPS * size[doubtful] * (1.0 + sensitivity(known[doubtful]))).all()


def test_the_papers_example() -> None:
    solutions = forward_displacement(PAPER, LEGS)
    assert solutions.count == 144
    assert solutions.labels == ASSEMBLY_MODES
    assert_modes(solutions, LEGS)
    lower = {label.split("/")[0] for label, real in zip(solutions.labels, solutions.exists, strict=True) if real}
    upper = {label.split("/")[1] for label, real in zip(solutions.labels, solutions.exists, strict=True) if real}
    assert sorted({name[:2] for name in lower}) == ["F1", "F2", "T1", "T2", "T3", "T4"]
    assert sorted({name[:2] for name in upper}) == ["F1", "F2", "F3", "F4", "T1", "T2"]
    state = forward_physical(PAPER, LEGS)
    for found in (state, solutions["T1+/T1+"], solutions.physical()):
        np.testing.assert_allclose(found.translation, [0.688872, 0.496307, 2.253025], atol=6e-7)
        angles = found.pose.rotation.as_euler("XYX", degrees=True)
        np.testing.assert_allclose(angles, [-11.0818, 32.9691, -12.8831], atol=6e-5)
    # The pose the paper prints, to its digits.
    np.testing.assert_allclose(100 * state.translation, [68.89, 49.63, 225.3], atol=0.05)
    np.testing.assert_array_equal(np.flatnonzero(solutions.is_physical), [0])


def test_the_number_of_modes_is_the_product_of_certified_ones() -> None:
    rng = np.random.default_rng(1)
    for machine in MANIPULATORS.values():
        size = machine.middle_radius + np.repeat([machine.base_radius, machine.platform_radius], 3)
        lengths = size * rng.uniform(0.5, 1.5, (12, 1)) * (1.0 + 0.1 * rng.normal(size=(12, 6)))
        solutions = forward_displacement(machine, lengths)
        d = machine.middle_side
        certified = []
        for legs in lengths:
            lower = certified_modes(legs[:3], machine.base_radius, d)
            upper = certified_modes(legs[3:], machine.platform_radius, d)
            certified.append(lower * upper)
        np.testing.assert_array_equal(solutions.count, certified)
        assert (solutions.status == np.where(solutions.count > 0, spm.Status.OK, spm.Status.UNREACHABLE)).all()


def test_some_lengths_have_all_256_modes() -> None:
    solutions = forward_displacement(PAPER, [1.20, 1.21, 1.22, 1.23, 1.24, 1.25])
    assert solutions.exists.all()
    assert certified_modes([1.20, 1.21, 1.22], PAPER.base_radius, PAPER.middle_side) == 16
    assert certified_modes([1.23, 1.24, 1.25], PAPER.platform_radius, PAPER.middle_side) == 16
    points = np.concatenate([solutions.middle_joints, solutions.configurations.platform_joints], axis=1)
    apart = np.abs(points[:, None] - points[None]).max(axis=(-1, -2))
    assert apart[~np.eye(256, dtype=bool)].min() > 1e-3


@pytest.mark.parametrize("name", MANIPULATORS)
@pytest.mark.parametrize("modes", spm.machine.FAMILIES)
def test_a_known_configuration_is_found_from_its_lengths(name: str, modes: str) -> None:
    problem = random_branches(MANIPULATORS[name], modes, 100, seed=2)
    assert_found(problem)
    solutions = forward_displacement(problem.machine, problem.configuration.leg_lengths[:50])
    state = solutions.nearest(problem.configuration[:50])
    apart = distance(solutions.configurations, state[:, None])
    labels = [solutions.labels[k] for k in np.nanargmin(apart, axis=-1)]
    assert {label[0] + label.split("/")[1][0] for label in labels} == {modes}
    lower, upper = problem.configuration, problem.configuration.translation
    below = ((lower.middle_joints.mean(axis=-2) - upper) * lower.rotation[..., 2]).sum(axis=-1)[:50]
    assert ["+" if z > 0 else "-" for z in lower.middle_joints[:50, :, 2].mean(axis=-1)] == [x[2] for x in labels]
    assert ["+" if z < 0 else "-" for z in below] == [x[-1] for x in labels]


def test_a_short_leg_keeps_its_digits() -> None:
    problem = random_branches(PAPER, "TF", 1_000, seed=100)
    assert problem.configuration.leg_lengths.min() < 0.005
    assert_found(problem)


# --- What has no solution, a family of them, or no meaning --------------------------------------------------------


@pytest.mark.parametrize(
    "legs", [LEGS * 100, [0.1] * 6, [1.2, 1.2, 3.5, 1.2, 1.2, 1.2], [1.2, 1.2, 1.2, 1.2, 3.5, 1.2]]
)
def test_a_triangle_that_cannot_close_is_unreachable(legs: list[float]) -> None:
    solutions = forward_displacement(PAPER, legs)
    assert solutions.status is spm.Status.UNREACHABLE
    assert not solutions.exists.any()
    assert np.isnan(solutions.rotation).all()
    state = forward_physical(PAPER, legs)
    assert not state.exists
    assert np.isnan(state.translation).all()


def test_stages_that_move_with_their_legs_locked_are_degenerate() -> None:
    machine = spm.Manipulator(0.3, 0.4, 0.9)
    r, lower, upper = machine.middle_radius, [0.9], [1.2]
    lower += [float(np.sqrt(3 * (r**2 - 0.3**2)))] * 2
    upper += [float(np.sqrt(3 * (r**2 - 0.4**2)))] * 2
    solutions = forward_displacement(machine, [[*lower, 0.7, 0.75, 0.8], [0.7, 0.75, 0.8, *upper], [*lower, *upper]])
    assert (solutions.status == spm.Status.DEGENERATE).all()
    np.testing.assert_array_equal(solutions.degeneracy.dimension, [1, 1, 2])
    kept = spm.inverse_displacement(machine, solutions[0].configurations[0].pose)
    assert kept.status is spm.Status.OK
    shut = forward_displacement(machine, [*lower, 0.7, 0.75, 9.0])
    assert shut.status is spm.Status.UNREACHABLE
    assert int(shut.degeneracy.dimension) == 0


@pytest.mark.parametrize(
    ("legs", "received"),
    [
        ([1.2] * 5 + [0.0], "0 for r_c3"),
        ([[1.2] * 6, [1.2, -0.1] + [1.2] * 4], "-0.1 for r_b2 at index (1,)"),
        ([1.2e9] * 6, "1.2e+09"),
    ],
)
def test_invalid_lengths_are_refused(legs: list[float], received: str) -> None:
    for function in (forward_displacement, forward_physical):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="readings")) as caught:
            function(PAPER, legs)
        assert caught.value.received.startswith(received)


# --- Beside continuous families and with very short legs -----------------------------------------------------------

R = PAPER.middle_radius
REGULAR = [1.2, 1.3, 1.4]


def assert_counted_or_unsolved(machine: spm.Manipulator, legs: np.ndarray) -> spm.Status:
    """Lower legs have the certified number of modes, or none at all and the status says so."""
    solutions = spm.forward_displacement(machine, [*legs, *REGULAR])
    counted = solutions.exists.reshape(16, 16).any(axis=-1).sum()
    if solutions.status is spm.Status.UNSOLVED:
        assert counted == 0
    else:
        assert counted == certified_modes(legs, machine.base_radius, machine.middle_side)
    return solutions.status


@pytest.mark.parametrize("ratio", [0.4, 0.75, 0.99, 0.5])
def test_beside_a_continuous_family_modes_are_counted_or_unsolved(ratio: float) -> None:
    rng = np.random.default_rng(5)
    machine = spm.Manipulator(ratio * R, PAPER.platform_radius, PAPER.middle_side)
    family = np.full(3, 1.2) if ratio == 0.5 else R * np.array([3 * ratio, *np.sqrt([3 - 3 * ratio**2] * 2)])
    for away in (1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-13):
        legs = np.roll(family * (1.0 + away * rng.normal(size=3)), rng.integers(3))
        status = assert_counted_or_unsolved(machine, legs)
        assert status is spm.Status.OK if away > 1e-4 else status in (spm.Status.OK, spm.Status.UNSOLVED)
        assert status is spm.Status.UNSOLVED or away > 1e-6


def test_very_short_legs_are_unsolved() -> None:
    """Hips as far out as the corners."""
    machine = spm.Manipulator(R, PAPER.platform_radius, PAPER.middle_side)
    for size in (1e-2, 1e-4, 1e-8):
        assert assert_counted_or_unsolved(machine, size * np.array([1.0, 1.2, 1.3])) is (
            spm.Status.OK if size > 1e-3 else spm.Status.UNSOLVED
        )
