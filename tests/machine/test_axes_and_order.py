"""Legs of a calibrated machine: the sense of hinges' axes, the order of legs, and what its text says of them."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from balancers import HEIGHTS, STAGES
from error_fields import with_fields
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.machine.legs import Legs


@pytest.mark.parametrize("machine", STAGES)
def test_either_sense_of_an_axis_is_the_same_machine(machine: str) -> None:
    legs = STAGES[machine].perturbed(3).legs
    for senses in itertools.product((1.0, -1.0), repeat=3):
        assert Legs(legs.axes * np.array(senses)[:, None], *legs.arrays[1:], legs.kinds) == legs


@pytest.mark.parametrize("machine", STAGES)
def test_legs_listed_clockwise_are_refused(machine: str) -> None:
    legs = STAGES[machine].legs
    arrays = (array[::-1] for array in legs.arrays)
    with pytest.raises(spm.GeometryError) as error:
        Legs(*arrays, legs.kinds)
    assert "opposite order" in error.value.cause


@pytest.mark.parametrize("machine", STAGES)
def test_legs_turned_beyond_a_quarter_turn_are_refused_and_others_are_the_same_machine(machine: str) -> None:
    stage = STAGES[machine]
    height = HEIGHTS.get(machine, 0.5)

    def turned(degrees: float) -> spm.Stage:
        turn, legs = Rotation.from_euler("z", degrees, degrees=True), stage.legs
        vectors = (x @ turn.as_matrix().T for x in legs.arrays[:3])
        return spm.Stage(stage.base_radius, stage.platform_radius, Legs(*vectors, legs.offsets, legs.kinds))

    expected = spm.inverse_physical(stage, height, tilt=0.1, azimuth=0.3)
    for degrees in (-85.0, -60.0, 45.0, 85.0):
        azimuth = 0.3 + np.radians(degrees)
        state = spm.inverse_physical(turned(degrees), height, tilt=0.1, azimuth=azimuth)
        np.testing.assert_allclose(state.readings, expected.readings, rtol=0, atol=1e-12)
        assert spm.forward_physical(turned(degrees), expected.readings).tilt == pytest.approx(0.1)
    for degrees in (-95.0, 95.0, 120.0, 180.0, 240.0):
        with pytest.raises(spm.GeometryError, check=with_fields(argument="pivots")):
            turned(degrees)


@pytest.mark.parametrize("machine", STAGES)
def test_a_stage_of_other_azimuths_is_the_drawn_one_turned(machine: str) -> None:
    stage, height, turn = STAGES[machine], HEIGHTS.get(machine, 0.5), np.radians(30.0)
    other = spm.Stage(stage.base_radius, stage.platform_radius, stage.kind, azimuths=np.radians([0.0, 120.0, 240.0]))
    state = spm.inverse_physical(stage, height, tilt=0.2, azimuth=0.7)
    same = spm.inverse_physical(other, height, tilt=0.2, azimuth=0.7 + turn)
    np.testing.assert_allclose(same.readings, state.readings, rtol=0, atol=1e-12)
    np.testing.assert_allclose(same.balls, state.balls @ Rotation.from_euler("z", turn).as_matrix().T, atol=1e-12)
    back = spm.forward_physical(other, state.readings)
    np.testing.assert_allclose(back.pose.as_matrix(), same.pose.as_matrix(), rtol=0, atol=1e-11)
    assert spm.Stage.from_data(other.as_data()) == other
    drawn = spm.Stage(stage.base_radius, stage.platform_radius, stage.kind, azimuths=np.radians([-30.0, 90.0, 210.0]))
    assert drawn.is_nominal


def test_legs_need_not_stand_at_equal_angles() -> None:
    """An RPS leg's length, from the place of its ball and pivot."""
    azimuths = np.radians([-40.0, 80.0, 215.0])
    stage = spm.Stage(0.7, 0.46, azimuths=azimuths)
    state = spm.inverse_physical(stage, 1.1, roll=0.05, pitch=-0.1)
    around = np.stack([np.cos(azimuths), np.sin(azimuths), 0.0 * azimuths], axis=-1)
    balls = state.pose.apply(0.46 * around)
    np.testing.assert_allclose(np.linalg.norm(balls - 0.7 * around, axis=-1), state.readings, atol=1e-14)
    assert state.closure_residual < 1e-14
    assert np.cross(around, balls)[:, 2] == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_allclose(spm.forward_physical(stage, state.readings).balls, balls, atol=1e-12)


def test_azimuths_that_are_degrees_or_stand_beside_legs_are_refused() -> None:
    stage = STAGES["RPS"]
    for legs, azimuths in ((stage.legs, np.zeros(3)), (spm.RPS(), [0.0, 120.0, 240.0]), (spm.RPS(), [0.0, 2.0])):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="azimuths")):
            spm.Stage(0.7, 0.46, legs, azimuths=azimuths)


@pytest.mark.parametrize(
    ("azimuths", "accepted"),
    [([0.0, -2.0, -4.0], "[ 0. -4. -2.]"), ([2.0, 4.1, 6.2], "[6.2 2.  4.1]"), ([0.0, 0.0, 0.0], "")],
)
def test_azimuths_in_another_order_are_named_in_theirs(azimuths: list[float], accepted: str) -> None:
    with pytest.raises(spm.GeometryError, check=with_fields(argument="azimuths")) as error:
        spm.Stage(0.7, 0.46, azimuths=azimuths)
    assert accepted in error.value.cause
    assert bool(accepted) == bool(error.value.cause)


def test_offsets_of_cranks_are_angles_in_the_text() -> None:
    stage = next(x for x in STAGES.values() if x.unit == "rad")
    legs = stage.legs
    built = spm.Stage(stage.base_radius, stage.platform_radius, Legs(*legs.arrays[:3], [0.02, 0.0, 0.0], legs.kinds))
    length, angle = re.findall(r"([0-9.e+-]+) (?:m|rad)\b", repr(built).split("legs differ from nominal by up to")[1])
    assert float(length) < 1e-12
    assert float(angle) == 0.02


@pytest.mark.parametrize("kind", ["[1]", "{a: 1}"])
def test_a_kind_that_is_no_text_is_refused(kind: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "stage.yaml"
    file.write_text(f"base_radius: 0.4\nplatform_radius: 0.3\nlegs: {{kind: {kind}}}\n")
    with pytest.raises(spm.GeometryError):
        spm.Stage.from_yaml(file)
