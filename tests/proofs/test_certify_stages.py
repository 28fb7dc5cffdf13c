"""Certificates of stages alone: against all assembly modes, machines within the errors, and a robot of two of them."""

from __future__ import annotations

import numpy as np
import pytest
from balancers import STAGES, forward_determinants
from error_fields import with_fields
from proofs.machines_within_errors import machine_within, readings_within

import spm_pin as spm

LIMITS = {
    "RPS": (1.07, 1.18),
    "PRS": (0.09, 0.17),
    "PRS inclined": (0.08, 0.17),
    "PRS radial": (0.12, 0.20),
    "PRS hanging": (0.83, 0.91),
    "RRS": (0.1, 0.6),
    "RRS inwards": (2.4, 2.9),
}


KINDS = ("RPS", "PRS", "RRS")


@pytest.mark.parametrize(("name", "error"), [*((name, 1e-4) for name in STAGES), *((name, 0.0) for name in KINDS)])
def test_readings_within_certified_limits_have_one_regular_state(name: str, error: float) -> None:
    nominal, rng = STAGES[name], np.random.default_rng(3)
    certificate = spm.certify(nominal, LIMITS[name], length_error=error, angle_error=error)
    assert certificate.holds, certificate.explain()
    (bound,), up = certificate.bounds, nominal.kind.up
    for _ in range(10 if error else 1):
        stage = machine_within(nominal, 0.999 * error, 0.999 * error, rng)
        readings = readings_within(stage.check_limits(LIMITS[name]), 60, rng)
        states = spm.forward_physical(stage, readings)
        assert certificate.covers(states).all()
        values = forward_determinants(states)
        assert (values >= bound).all()
        np.testing.assert_allclose(spm.determinants(states)[:, 0] / nominal.ball_side**3, up * values, rtol=1e-9)
        assert (states.slopes * stage.legs.slope_signs > 0.0).all()
        modes = spm.forward_displacement(stage, readings[::6])
        covered = certificate.covers(modes.configurations) & modes.exists
        np.testing.assert_array_equal(covered.sum(axis=-1), 1)


@pytest.mark.parametrize("name", KINDS)
def test_a_robot_of_two_such_stages_has_the_bounds_of_one(name: str) -> None:
    kept = STAGES[name]
    stage = spm.Stage(kept.base_radius, kept.platform_radius, kept.kind, LIMITS[name])
    alone, robot = spm.certify(stage), spm.certify(spm.Manipulator.of_stages(stage, stage))
    assert alone.stages[0].boxes == robot.stages[0].boxes
    np.testing.assert_allclose(robot.bounds, alone.bounds * 2, rtol=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_a_calibrated_stage_is_proved_with_its_own_errors(name: str) -> None:
    nominal = STAGES[name]
    stage = nominal.perturbed(2, length=2e-5, angle=2e-5)
    certificate = spm.certify(stage, LIMITS[name])
    assert certificate.holds
    assert 0.0 < max(certificate.errors) < 2e-4
    assert certificate.covers(spm.forward_physical(stage, np.full(3, sum(LIMITS[name]) / 2.0)))
    assert certificate.concerns(nominal)
    assert not certificate.concerns(nominal.perturbed(3, length=1e-3, angle=1e-3))


def test_limits_around_a_singularity_do_not_certify() -> None:
    tripod = spm.Stage(0.7, 0.46)
    certificate = spm.certify(tripod, (0.3, 1.5), boxes=100_000)
    assert certificate.verdict == "not proved"
    witness = certificate.witness
    assert isinstance(witness, spm.Configuration)
    assert abs(forward_determinants(witness)) < 1e-9
    assert ((witness.readings >= 0.3) & (witness.readings <= 1.5)).all()
    assert spm.singularities(witness, tolerance=1e-6).kind & spm.kinematics.SingularityKind.FORWARD


@pytest.mark.parametrize("name", ["RPS", "PRS"])
def test_the_widest_limits_end_just_before_the_first_singularity(name: str) -> None:
    nominal, centre = STAGES[name], sum(LIMITS[name]) / 2.0
    found = spm.largest_certified_limits(nominal, centre, tolerance=0.2, boxes=30_000)
    assert found.holds
    half = found.limits.maximum[0] - centre
    # No wider limits certify: somewhere between these and half as much again a state ends or is singular.
    corners = centre + 0.999 * half * np.random.default_rng(1).choice([-1.0, 1.0], (200, 3))
    assert spm.forward_physical(nominal, corners).exists.all()
    assert not spm.certify(nominal, (centre - 1.5 * half, centre + 1.5 * half), boxes=30_000).holds


def test_wrong_arguments_are_named() -> None:
    stage, paper = STAGES["RRS"], spm.Manipulator.paper()
    certificate = spm.certify(stage, LIMITS["RRS"])
    for argument, call in (
        ("limits", lambda: spm.certify(stage)),
        ("limits", lambda: spm.certify(stage, spm.LegLimits.stages((0.1, 0.6), (0.1, 0.7)))),
        ("machine", lambda: spm.certify(spm.RPS())),  # type: ignore[arg-type]
        ("centre", lambda: spm.largest_certified_limits(stage, [0.1, 0.2])),
        ("configuration", lambda: certificate.covers(spm.forward_physical(STAGES["PRS"], [0.12] * 3))),
        ("configuration", lambda: certificate.covers(spm.forward_physical(paper, [1.3] * 6))),
    ):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
            call()
