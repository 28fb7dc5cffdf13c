from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from error_fields import with_fields
from problems import PAPER
from scipy.spatial.transform import RigidTransform

import spm_pin as spm
from spm_pin.crosscheck import (
    METHODS,
    ClosedForm,
    Method,
    Nlp,
    Paper,
    Pinocchio,
    Quantity,
    Report,
    compare_in_batches,
    compare_methods,
)
from spm_pin.crosscheck.nlp import branch_search, loop_equations
from spm_pin.crosscheck.paper.jacobian import Table5Mistakes
from spm_pin.crosscheck.random_poses import in_leg_space, on_all_rotations


@pytest.fixture(scope="module")
def report() -> Report:
    return compare_methods(PAPER, poses=6, seed=2)


def test_all_methods_agree(report: Report) -> None:
    assert report.agrees
    assert report.outliers == ()
    assert report.verdict == f"All {len(METHODS)} methods agree."
    assert 4 <= report.reached <= 6
    assert report.states > 20
    assert all(pair.disagreements == 0 and pair.ratio < 1.0 for pair in report.differences)


def test_every_pair_that_can_be_compared_is(report: Report) -> None:
    pairs: dict[Quantity, set[frozenset[str]]] = {quantity: set() for quantity in Quantity}
    for pair in report.differences:
        pairs[pair.quantity].add(frozenset({pair.first, pair.second}))
        assert pair.compared > 0
    assert len(pairs[Quantity.POSITIONS]) == 6
    assert len(pairs[Quantity.JACOBIAN]) == len(pairs[Quantity.FORCES]) == 6
    assert pairs[Quantity.ASSEMBLY] == {frozenset({"given state", "pinocchio"})}


def test_a_seed_makes_the_same_report(report: Report) -> None:
    names = ["closed-form", "paper"]
    first, again = (compare_methods(PAPER, poses=10, seed=5, methods=names) for _ in range(2))
    assert first.differences == again.differences
    assert first.scores == again.scores
    other = compare_methods(PAPER, poses=10, seed=6, methods=names)
    assert (other.requests["translation"] != first.requests["translation"]).any()


@contextmanager
def flipped_sign() -> Iterator[None]:
    """Change one sign in one of CasADi's loop equations: b_2 + c_2 where it says b_2 - c_2."""
    true = loop_equations.equations

    def flipped(machine: spm.Manipulator, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
        rows = ca.vertsplit(true(machine, b, rotation, translation))
        axis, vector = loop_equations.legs(machine, b, rotation, translation)[4]
        rows[4] = ca.dot(axis, 2.0 * b[3:6] - vector)
        return ca.vertcat(*rows)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_equations, "equations", flipped)
        branch_search.loop_equations_of.cache_clear()
        yield
    branch_search.loop_equations_of.cache_clear()


@dataclass
class Forgetful(ClosedForm):
    """Loses one branch of every third pose."""

    name: str = "forgetful"

    def inverse(self, pose: RigidTransform) -> spm.SolutionSet:
        solutions = spm.inverse_displacement(self.machine, pose)
        keep = solutions.exists.copy()
        for n in range(0, len(keep), 3):
            keep[n, np.flatnonzero(keep[n])[:1]] = False
        return solutions.where(keep)


def test_a_flipped_sign_in_one_loop_equation_is_found() -> None:
    with flipped_sign():
        methods: list[Method] = [ClosedForm(PAPER), Paper(PAPER), Pinocchio(PAPER), Nlp(PAPER)]
        # Among the poses of this seed is one at which the wrong equations have solutions.
        found = compare_methods(PAPER, poses=8, seed=3, methods=methods)
    assert not found.agrees
    assert found.outliers == ("nlp",)
    assert found.verdict == "nlp is wrong: the others agree."
    (score,) = (score for score in found.scores if score.name == "nlp")
    assert score.invented > 0
    assert score.misses_too_often
    assert not any(score.invented or score.misses_too_often for score in found.scores if score.name != "nlp")
    # And with the sign mended nothing is left of it.
    assert compare_methods(PAPER, poses=4, methods=["closed-form", "nlp"]).agrees


def test_the_printed_lever_arm_is_found() -> None:
    wrong = Paper(PAPER, mistakes=Table5Mistakes(printed_lever_arm=True))
    found = compare_methods(PAPER, poses=10, methods=["closed-form", "pinocchio", wrong])
    assert found.outliers == ("paper",)
    for pair in found.differences:
        wrong_pair = "paper" in (pair.first, pair.second) and pair.quantity in (Quantity.JACOBIAN, Quantity.FORCES)
        assert (pair.disagreements > 0) == wrong_pair, pair


@pytest.mark.parametrize("machine", [PAPER, PAPER.perturbed(1, length=1e-3, angle=1e-3)])
def test_lost_branches_are_found(machine: spm.Manipulator) -> None:
    # Of the machine as built `nlp`, which comes first, knows no labels: the others are put into its order.
    found = compare_methods(machine, poses=12, methods=["nlp", "closed-form", Forgetful(machine)])
    assert found.outliers == ("forgetful",)
    (score,) = (score for score in found.scores if score.name == "forgetful")
    assert score.missed >= 3
    assert score.invented == 0
    lost = spm.inverse_displacement(
        machine,
        spm.pose(found.requests["translation"][score.pose], xyx=np.deg2rad(found.requests["xyx"][score.pose])),
    )
    assert lost.count > 0


def test_misses_within_the_stated_rate_are_no_fault() -> None:
    careful = Forgetful(PAPER, name="modest", miss_rate=0.4)
    found = compare_methods(PAPER, poses=12, methods=["closed-form", careful])
    assert found.agrees
    (score,) = (score for score in found.scores if score.name == "modest")
    assert score.missed >= 3


@pytest.mark.parametrize(
    "methods",
    [["pinocchio"], ["delphi"], ["paper", "paper"]],
)
def test_bad_methods_are_refused(methods: list[str]) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="methods")):
        compare_methods(PAPER, poses=2, methods=methods)


def test_each_batch_reports_all_poses_so_far() -> None:
    machine, names = spm.Manipulator(0.06, 0.04, 0.05), ["closed-form", "paper", "nlp"]
    partial, whole = list(compare_in_batches(machine, poses=16, seed=4, methods=names))
    assert whole.agrees
    assert (partial.poses, whole.poses, partial.requested) == (10, 16, 16)
    np.testing.assert_array_equal(partial.requests["xyx"], whole.requests["xyx"][:10])
    assert [score.solved for score in partial.scores] == [10, 10, 10]
    assert [score.solved for score in whole.scores] == [16, 16, 16]
    # Counts add up, and the largest share of the tolerance never shrinks.
    assert whole.states > partial.states
    for before, after in zip(partial.differences, whole.differences, strict=True):
        assert after.compared > before.compared
        assert after.ratio >= before.ratio
    branches = spm.inverse_displacement(
        machine, spm.pose(whole.requests["translation"], xyx=np.deg2rad(whole.requests["xyx"]))
    )
    assert whole.states == branches.count.sum()
    assert whole.scores[0].branches == branches.count.sum()


def test_a_slow_method_gets_its_share_spread_over_all_poses() -> None:
    sparse = ClosedForm(PAPER, name="sparse", share=0.25)
    partial, whole = compare_in_batches(PAPER, poses=20, methods=["closed-form", sparse])
    assert (partial.scores[1].solved, whole.scores[1].solved) == (3, 5)
    assert whole.scores[1].missed == 0


def test_poses_in_leg_space_have_a_branch_there() -> None:
    machine = PAPER
    poses = in_leg_space(machine, 60, np.random.default_rng(0))
    assert poses.shape == (60,)
    branches = spm.inverse_displacement(machine, poses)
    inside = branches.within()
    assert inside.count.min() >= 1
    # Drawn uniformly: the legs of those branches fill their range.
    legs = inside.leg_lengths[inside.exists]
    width = np.array(machine.limits.maximum) - machine.limits.minimum
    assert (np.ptp(legs, axis=0) > 0.8 * width).all()


def test_rotations_are_uniform_and_some_poses_out_of_reach() -> None:
    poses = on_all_rotations(PAPER, 4000, np.random.default_rng(1))
    # Of a uniform rotation matrix every entry has mean zero and variance 1/3.
    matrices = poses.rotation.as_matrix()
    assert np.abs(matrices.mean(axis=0)).max() < 5.0 * np.sqrt(1 / 3 / 4000)
    assert np.abs((matrices**2).mean(axis=0) - 1 / 3).max() < 0.05
    share = spm.inverse_displacement(PAPER, poses).exists.any(axis=-1).mean()
    assert 0.3 < share < 0.95
