from __future__ import annotations

import shlex

import numpy as np
import pytest
from crosscheck.broken import Forgetful, Inaccurate, flipped_sign

import spm_pin as spm
from spm_pin.crosscheck.html import page
from spm_pin.crosscheck.methods import ClosedForm, Nlp, Paper, Pinocchio, Witness
from spm_pin.crosscheck.report import Report, crosscheck
from spm_pin.crosscheck.verdicts import Quantity
from spm_pin.paper.jacobian import Table5Mistakes

GEOMETRY = spm.Geometry.paper()


@pytest.fixture(scope="module")
def report() -> Report:
    return crosscheck(GEOMETRY, poses=20, seed=2)


def test_all_witnesses_agree(report: Report) -> None:
    assert report.agrees
    assert report.culprits == ()
    assert report.verdict == "All 5 witnesses agree."
    assert 15 < report.reached <= 20
    assert report.states > 80
    assert all(one.disagreements == 0 and one.ratio < 1.0 for one in report.comparisons)


def test_every_pair_that_can_be_compared_is(report: Report) -> None:
    pairs: dict[Quantity, set[frozenset[str]]] = {quantity: set() for quantity in Quantity}
    for one in report.comparisons:
        pairs[one.quantity].add(frozenset({one.first, one.second}))
        assert one.compared > 0
    assert len(pairs[Quantity.POSITIONS]) == 6
    assert len(pairs[Quantity.JACOBIAN]) == len(pairs[Quantity.FORCES]) == 6
    assert pairs[Quantity.ASSEMBLY] == {frozenset({"asked for", "pinocchio"})}


def test_a_seed_makes_the_same_report(report: Report) -> None:
    names = ["closed-form", "paper"]
    first, again = (crosscheck(GEOMETRY, poses=10, seed=5, witnesses=names) for _ in range(2))
    assert first.comparisons == again.comparisons
    assert first.standings == again.standings
    other = crosscheck(GEOMETRY, poses=10, seed=6, witnesses=names)
    assert (other.translation != first.translation).any()


def test_a_pose_of_the_report_can_be_asked_again(report: Report) -> None:
    worst = report.worst
    assert worst is not None
    words = shlex.split(report.command(worst.pose))
    numbers = np.array([float(word) for word in words if word[-1].isdigit()])
    np.testing.assert_array_equal(numbers, [*report.translation[worst.pose], *report.xyx[worst.pose]])
    again = spm.inverse_displacement(GEOMETRY, spm.pose(numbers[:3], xyx=np.deg2rad(numbers[3:])))
    assert again[worst.branch].exists


def test_a_flipped_sign_in_one_loop_equation_is_found() -> None:
    with flipped_sign():
        witnesses: list[Witness] = [ClosedForm(GEOMETRY), Paper(GEOMETRY), Pinocchio(GEOMETRY), Nlp(GEOMETRY)]
        found = crosscheck(GEOMETRY, poses=8, witnesses=witnesses)
    assert not found.agrees
    assert found.culprits == ("nlp",)
    assert found.verdict == "nlp is wrong: the others agree."
    (standing,) = (one for one in found.standings if one.name == "nlp")
    assert standing.invented > 0
    assert standing.misses_too_often
    assert not any(one.invented or one.misses_too_often for one in found.standings if one.name != "nlp")
    # And with the sign mended nothing is left of it.
    assert crosscheck(GEOMETRY, poses=4, witnesses=["closed-form", "nlp"]).agrees


def test_the_printed_lever_arm_is_found() -> None:
    wrong = Paper(GEOMETRY, Table5Mistakes(printed_lever_arm=True))
    found = crosscheck(GEOMETRY, poses=10, witnesses=["closed-form", "pinocchio", "nlp", wrong])
    assert found.culprits == ("paper",)
    for one in found.comparisons:
        wrong_pair = "paper" in (one.first, one.second) and one.quantity in (Quantity.JACOBIAN, Quantity.FORCES)
        assert (one.disagreements > 0) == wrong_pair, one


def test_lost_branches_are_found() -> None:
    found = crosscheck(GEOMETRY, poses=12, witnesses=["closed-form", "paper", Forgetful(GEOMETRY)])
    assert found.culprits == ("forgetful",)
    (standing,) = (one for one in found.standings if one.name == "forgetful")
    assert standing.missed >= 3
    assert standing.invented == 0
    lost = spm.inverse_displacement(
        GEOMETRY, spm.pose(found.translation[standing.pose], xyx=np.deg2rad(found.xyx[standing.pose]))
    )
    assert lost.count > 0


def test_a_witness_may_miss_as_often_as_it_states() -> None:
    careful = Forgetful(GEOMETRY, name="modest", miss_rate=0.4)
    found = crosscheck(GEOMETRY, poses=12, witnesses=["closed-form", careful])
    assert found.agrees
    (standing,) = (one for one in found.standings if one.name == "modest")
    assert standing.missed >= 3


def test_half_the_digits_are_not_enough() -> None:
    found = crosscheck(GEOMETRY, poses=20, witnesses=["closed-form", "nlp", "paper", Inaccurate(GEOMETRY)])
    assert found.culprits == ("inaccurate",)


def test_two_who_contradict_each_other_are_both_named() -> None:
    wrong = Paper(GEOMETRY, Table5Mistakes(printed_lever_arm=True))
    found = crosscheck(GEOMETRY, poses=5, witnesses=["closed-form", wrong])
    assert set(found.culprits) == {"closed form", "paper"}
    assert "ask a third witness" in found.verdict


def test_another_geometry() -> None:
    geometry = spm.Geometry(0.06, 0.04, 0.05)
    assert crosscheck(geometry, poses=10, witnesses=["closed-form", "paper", "pinocchio", "nlp"]).agrees


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"poses": 0}, "poses: expected a positive whole number"),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"witnesses": ["pinocchio"]}, "one at least that solves the inverse displacement"),
        ({"witnesses": ["delphi"]}, "witnesses: expected of closed-form"),
        ({"witnesses": ["paper", "paper"]}, "a name of its own for each"),
    ],
)
def test_bad_arguments_are_clear(keywords: dict[str, object], words: str) -> None:
    with pytest.raises(spm.ArgumentError, match=words):
        crosscheck(GEOMETRY, **{"poses": 2, **keywords})  # type: ignore[arg-type]


def test_the_page_needs_nothing_else_and_says_it_all(report: Report) -> None:
    text = page(report)
    assert "All 5 witnesses agree." in text
    assert "prefers-color-scheme: dark" in text
    assert 'name="viewport"' in text
    assert not any(word in text for word in ("http:", "https:", "<script", "<link", "src="))
    worst = report.worst
    assert worst is not None
    assert report.command(worst.pose) in text
    for one in report.comparisons:
        assert f"{one.first} – {one.second}" in text
    wrong = Paper(GEOMETRY, Table5Mistakes(printed_lever_arm=True), name="<paper>")
    text = page(crosscheck(GEOMETRY, poses=5, witnesses=["closed-form", "nlp", wrong]))
    assert "&lt;paper&gt; is wrong" in text
    assert 'class="verdict bad"' in text
    assert "<paper>" not in text


def test_progress_is_told() -> None:
    told: list[tuple[str, int, int]] = []
    crosscheck(GEOMETRY, poses=9, witnesses=["closed-form", "paper"], progress=lambda *step: told.append(step))
    assert ("paper: branches", 8, 9) in told
    assert ("paper: branches", 9, 9) in told
    assert all(0 <= done <= total for _, done, total in told)
    assert any(what == "closed form: Jacobians and forces" for what, _, _ in told)
