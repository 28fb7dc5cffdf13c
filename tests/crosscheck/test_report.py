from __future__ import annotations

import shlex
from dataclasses import replace

import numpy as np
import pytest
from crosscheck.broken_methods import Forgetful, Inaccurate, flipped_sign

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
from spm_pin.paper.jacobian import Table5Mistakes

GEOMETRY = spm.Geometry.paper()


@pytest.fixture(scope="module")
def report() -> Report:
    return compare_methods(GEOMETRY, poses=20, seed=2)


def test_all_methods_agree(report: Report) -> None:
    assert report.agrees
    assert report.outliers == ()
    assert report.verdict == f"All {len(METHODS)} methods agree."
    assert replace(report, scores=report.scores[:2]).verdict == "Both methods agree."
    assert 15 < report.reached <= 20
    assert report.states > 80
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
    first, again = (compare_methods(GEOMETRY, poses=10, seed=5, methods=names) for _ in range(2))
    assert first.differences == again.differences
    assert first.scores == again.scores
    other = compare_methods(GEOMETRY, poses=10, seed=6, methods=names)
    assert (other.translation != first.translation).any()


def test_command_of_a_report_solves_its_pose(report: Report) -> None:
    worst = report.worst
    words = shlex.split(report.command(worst.pose))
    numbers = np.array([float(word) for word in words if word[-1].isdigit()])
    np.testing.assert_array_equal(numbers, [*report.translation[worst.pose], *report.xyx[worst.pose]])
    again = spm.inverse_displacement(GEOMETRY, spm.pose(numbers[:3], xyx=np.deg2rad(numbers[3:])))
    assert again[worst.branch].exists


def test_a_flipped_sign_in_one_loop_equation_is_found() -> None:
    with flipped_sign():
        methods: list[Method] = [ClosedForm(GEOMETRY), Paper(GEOMETRY), Pinocchio(GEOMETRY), Nlp(GEOMETRY)]
        found = compare_methods(GEOMETRY, poses=8, methods=methods)
    assert not found.agrees
    assert found.outliers == ("nlp",)
    assert found.verdict == "nlp is wrong: the others agree."
    (score,) = (score for score in found.scores if score.name == "nlp")
    assert score.invented > 0
    assert score.misses_too_often
    assert not any(score.invented or score.misses_too_often for score in found.scores if score.name != "nlp")
    # And with the sign mended nothing is left of it.
    assert compare_methods(GEOMETRY, poses=4, methods=["closed-form", "nlp"]).agrees


def test_the_printed_lever_arm_is_found() -> None:
    wrong = Paper(GEOMETRY, mistakes=Table5Mistakes(printed_lever_arm=True))
    found = compare_methods(GEOMETRY, poses=10, methods=["closed-form", "pinocchio", "nlp", wrong])
    assert found.outliers == ("paper",)
    for pair in found.differences:
        wrong_pair = "paper" in (pair.first, pair.second) and pair.quantity in (Quantity.JACOBIAN, Quantity.FORCES)
        assert (pair.disagreements > 0) == wrong_pair, pair


@pytest.mark.parametrize("geometry", [GEOMETRY, GEOMETRY.perturbed(1, length=1e-3, angle=1e-3)])
def test_lost_branches_are_found(geometry: spm.Geometry) -> None:
    # Of the machine as built `nlp`, which comes first, knows no labels: the others are put into its order.
    found = compare_methods(geometry, poses=12, methods=["nlp", "closed-form", Forgetful(geometry)])
    assert found.outliers == ("forgetful",)
    (score,) = (score for score in found.scores if score.name == "forgetful")
    assert score.missed >= 3
    assert score.invented == 0
    lost = spm.inverse_displacement(
        geometry, spm.pose(found.translation[score.pose], xyx=np.deg2rad(found.xyx[score.pose]))
    )
    assert lost.count > 0


def test_misses_within_the_stated_rate_are_no_fault() -> None:
    careful = Forgetful(GEOMETRY, name="modest", miss_rate=0.4)
    found = compare_methods(GEOMETRY, poses=12, methods=["closed-form", careful])
    assert found.agrees
    (score,) = (score for score in found.scores if score.name == "modest")
    assert score.missed >= 3


def test_an_answer_with_half_the_digits_is_an_outlier() -> None:
    found = compare_methods(GEOMETRY, poses=20, methods=["closed-form", "nlp", "paper", Inaccurate(GEOMETRY)])
    assert found.outliers == ("inaccurate",)


def test_two_methods_that_contradict_each_other_are_both_outliers() -> None:
    wrong = Paper(GEOMETRY, mistakes=Table5Mistakes(printed_lever_arm=True))
    found = compare_methods(GEOMETRY, poses=5, methods=["closed-form", wrong])
    assert set(found.outliers) == {"closed form", "paper"}
    assert "a third method can decide" in found.verdict


@pytest.mark.parametrize(
    ("methods", "words"),
    [
        (["pinocchio"], "one at least that solves the inverse displacement"),
        (["delphi"], "methods: expected names among closed-form"),
        (["paper", "paper"], "a name of its own for each"),
    ],
)
def test_bad_methods_are_refused(methods: list[str], words: str) -> None:
    with pytest.raises(spm.ArgumentError, match=words):
        compare_methods(GEOMETRY, poses=2, methods=methods)


def test_progress_names_the_method_and_counts_poses() -> None:
    steps: list[tuple[str, int, int]] = []
    compare_methods(GEOMETRY, poses=13, methods=["closed-form", "paper"], progress=lambda *step: steps.append(step))
    assert steps[0] == ("closed form: branches", 0, 13)
    assert ("paper: branches", 10, 13) in steps
    assert ("closed form: Jacobians and forces", 10, 13) in steps
    assert steps[-1] == ("compared", 13, 13)


def test_each_batch_reports_all_poses_so_far() -> None:
    geometry, names = spm.Geometry(0.06, 0.04, 0.05), ["closed-form", "paper", "nlp"]
    partial, whole = list(compare_in_batches(geometry, poses=16, seed=4, methods=names))
    assert whole.agrees
    assert (len(partial.xyx), len(whole.xyx), partial.requested) == (10, 16, 16)
    np.testing.assert_array_equal(partial.xyx, whole.xyx[:10])
    assert [score.solved for score in partial.scores] == [10, 10, 10]
    assert [score.solved for score in whole.scores] == [16, 16, 16]
    # Counts add up, and the largest share of the tolerance never shrinks.
    assert whole.states > partial.states
    for before, after in zip(partial.differences, whole.differences, strict=True):
        assert after.compared > before.compared
        assert after.ratio >= before.ratio
    branches = spm.inverse_displacement(geometry, spm.pose(whole.translation, xyx=np.deg2rad(whole.xyx)))
    assert whole.states == branches.count.sum()
    assert whole.scores[0].branches == branches.count.sum()


def test_a_slow_method_gets_its_share_spread_over_all_poses() -> None:
    sparse = ClosedForm(GEOMETRY, name="sparse", share=0.25)
    partial, whole = compare_in_batches(GEOMETRY, poses=20, methods=["closed-form", sparse])
    assert (partial.scores[1].solved, whole.scores[1].solved) == (3, 5)
    assert whole.scores[1].missed == 0
