"""A state of a stage followed along tilts and heights, or readings."""

from __future__ import annotations

import numpy as np
import pytest
from balancers import STAGES, stage_and_height
from error_fields import with_fields

import spm_pin as spm
from spm_pin.kinematics import EventKind, follow

BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))


def tilt_at(parameter: float, last: float) -> float:
    """Return the tilt on the way from level, along which the normal's tip goes straight."""
    return float(np.arctan2(parameter * np.sin(last), 1.0 - parameter + parameter * np.cos(last)))


def test_a_tilt_meets_the_limit_and_the_leg_s_end_where_the_reach_has_them() -> None:
    path = follow(BALANCER, height=0.12, tilt=[0.0, 1.0], azimuth=-np.pi)
    limited, free = (
        spm.workspace.reach(stage, 0.12, directions=1) for stage in (BALANCER, spm.Stage(0.08, 0.09, BALANCER.kind))
    )
    limit, end = path.events
    assert limit.kind is EventKind.LIMIT
    # A reading beyond its limit by 1e-8 of it is within, and the reach goes so far.
    assert tilt_at(limit.parameter, 1.0) == pytest.approx(float(limited.tilts[0, 0]), abs=2e-8)
    state = spm.inverse_physical(BALANCER, 0.12, tilt=tilt_at(limit.parameter, 1.0), azimuth=-np.pi)
    leg = BALANCER.legs.names.index(limit.detail[:3])
    assert state.readings[leg] == pytest.approx(-0.6 if "minimum" in limit.detail else 1.2, abs=1e-9)
    assert end.kind is EventKind.END
    assert "whose actuator no longer moves its ball" in end.detail
    assert tilt_at(end.parameter, 1.0) == pytest.approx(float(free.tilts[0, 0]), abs=1e-6)
    assert set(path.labels) == {"T"}
    np.testing.assert_allclose(path.configurations.height, 0.12, atol=1e-15)


@pytest.mark.parametrize("machine", ["RPS", "RPS as built", "RRS", "RRS as built"])
def test_readings_lead_as_far_as_the_physical_state_lasts(machine: str) -> None:
    stage, height = stage_and_height(machine)
    first = spm.inverse_physical(stage, height).readings
    last = first + 2.0 * (1.0 if stage.unit == "rad" else stage.size) * np.array([-0.3, 0.9, -0.4])
    path = follow(stage, [first, last], samples=20)
    end = path.events[-1]
    assert end.kind is EventKind.END
    assert 0.0 < end.parameter < 1.0
    at, beyond = (first + (end.parameter + x) * (last - first) for x in (-1e-6, 1e-6))
    assert spm.forward_physical(stage, at, near=path.configurations[len(path.parameters) // 2]).exists
    assert not spm.forward_physical(stage, beyond).exists
    points = first + path.parameters[:, None] * (last - first)
    np.testing.assert_allclose(path.configurations.readings, points, atol=1e-12)
    expected = spm.forward_physical(stage, points[:-20])
    np.testing.assert_allclose(path.configurations[:-20].balls, expected.balls, atol=1e-9)


def test_the_turned_mode_is_followed_when_it_is_named() -> None:
    path = follow(STAGES["RPS"], start="F", height=[1.1, 1.2, 1.1], roll=[0.0, 0.2, 0.3], samples=10)
    assert path.complete
    assert not path.events
    np.testing.assert_allclose(path.configurations.torsion, np.pi, atol=1e-12)
    assert path.configurations.height.max() == pytest.approx(1.2)
    again = follow(STAGES["RPS"], start=path.configurations[0], height=[1.1, 1.2], roll=[0.0, 0.2], samples=10)
    assert set(again.labels) == {"F"}


@pytest.mark.parametrize(
    ("arguments", "argument"),
    [
        ({}, "path"),
        ({"path": [[0.1] * 3] * 2, "height": 0.1}, "height"),
        ({"path": [0.1] * 3}, "path"),
        ({"path": [np.eye(4)] * 2}, "path"),
        ({"tilt": [0.1, 0.2], "azimuth": 0.0}, "height"),
        ({"height": 0.12, "tilt": 0.1, "azimuth": 0.0}, "height"),
        ({"height": [0.12, 0.13], "start": "X"}, "start"),
        ({"height": [0.12, 0.13], "start": 3}, "start"),
    ],
)
def test_what_is_no_path_of_a_stage(arguments: dict[str, object], argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        follow(BALANCER, **arguments)  # type: ignore[arg-type]
