from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest
from error_fields import with_fields
from kinds_of_legs import machine_of_kinds
from problems import PAPER, in_leg_space

import spm_pin as spm
from spm_pin.crosscheck import METHODS, compare_methods, make_methods
from spm_pin.crosscheck import methods as methods_module

SAMPLE = in_leg_space(PAPER, 3, 1)
OFFERS = {
    "closed-form": {"inverse", "inverse_jacobian", "leg_forces"},
    "paper": {"inverse", "inverse_jacobian", "leg_forces"},
    "pinocchio": {"inverse_jacobian", "leg_forces", "assembled"},
    "nlp": {"inverse", "inverse_jacobian", "leg_forces"},
    "ipopt": {"inverse"},
}


@pytest.mark.parametrize("name", METHODS)
def test_each_method_answers_what_it_can_in_the_same_shapes(name: str) -> None:
    method = METHODS[name](PAPER)
    states = SAMPLE.configuration
    wrench = np.tile([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], (3, 1))
    # One pose, for IPOPT takes seconds.
    solutions = method.inverse(SAMPLE.pose[:1])
    assert solutions is None or solutions.shape == (1,)
    jacobian, forces = method.inverse_jacobian(states), method.leg_forces(states, wrench)
    assembled = method.assembled(states)
    answers = {"inverse": solutions, "inverse_jacobian": jacobian, "leg_forces": forces, "assembled": assembled}
    assert {what for what, answer in answers.items() if answer is not None} == OFFERS[name]
    if jacobian is not None and forces is not None:
        np.testing.assert_allclose(jacobian, spm.inverse_jacobian(states), rtol=0, atol=1e-9)
        np.testing.assert_allclose(forces, spm.leg_forces(states, wrench), rtol=0, atol=1e-8)
    if assembled is not None:
        np.testing.assert_allclose(assembled.middle_joints, states.middle_joints, rtol=0, atol=1e-13)
    assert (method.rounding(states) < 1e-9).all()
    assert (method.rounding(states) > 0.0).all()


@pytest.mark.parametrize("name", ["closed-form", "paper", "nlp"])
def test_closure_residuals_stay_within_the_stated_rounding(name: str) -> None:
    method = METHODS[name](PAPER)
    solutions = method.inverse(in_leg_space(PAPER, 20, 4).pose)
    states = solutions.configurations[solutions.exists]
    assert len(states) > 70
    assert (states.closure_residual <= method.rounding(states)).all()


def test_legs_of_any_kind_are_compared_with_the_tolerances_of_cylinders() -> None:
    machine = machine_of_kinds("RRS", "PRS", built=True)
    report = compare_methods(machine, poses=6, seed=3, methods=["closed-form", "nlp"])
    assert report.agrees, report.verdict
    assert report.scores[0].branches == report.scores[1].branches == report.states > 8
    # Rounding is far below what conditioning would allow, as of cylinders.
    assert max(pair.ratio for pair in report.differences) < 0.1
    with pytest.raises(spm.GeometryError):
        METHODS["paper"](machine)


def test_calibrated_machines_are_compared_by_all_methods_but_the_paper() -> None:
    built = PAPER.perturbed(2, length=3e-3, angle=3e-3)
    report = compare_methods(built, poses=4)
    assert report.agrees, report.verdict
    assert [score.name for score in report.scores] == ["closed form", "pinocchio", "nlp", "ipopt"]
    assert report.scores[2].branches == report.scores[0].branches == report.states
    with pytest.raises(spm.GeometryError):
        compare_methods(built, methods=["paper"])


def test_a_singular_member_is_nan_and_the_others_are_solved() -> None:
    level = spm.pose([0.0, 0.0, 2.2], rotation=np.eye(3))
    flat = PAPER.middle_radius * PAPER.radial_directions + [0.0, 0.0, 1.1]
    states = SAMPLE.configuration
    both = spm.Configuration(
        PAPER,
        np.concatenate([level.as_matrix()[None], states.pose.as_matrix()]),
        np.concatenate([flat[None], states.middle_joints]),
    )
    for name in ("closed-form", "paper", "pinocchio"):
        found = METHODS[name](PAPER).inverse_jacobian(both)
        assert np.isnan(found[0]).all()
        np.testing.assert_allclose(found[1:], spm.inverse_jacobian(states), rtol=0, atol=1e-9)


def test_a_method_that_cannot_be_imported_is_left_out_unless_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        if name.startswith("spm_pin.multibody"):
            raise ImportError(name)
        return import_module(name)

    monkeypatch.setattr(methods_module, "import_module", missing)
    assert "pinocchio" not in [m.name for m in make_methods(None, PAPER)]
    with pytest.raises(ImportError):
        make_methods(["pinocchio"], PAPER)


@pytest.mark.parametrize("methods", ["paper", [spm.crosscheck.ClosedForm], ["delphi"]])
def test_what_is_no_method_is_refused(methods: Any) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="methods")):
        compare_methods(PAPER, poses=1, methods=methods)
