"""Measurements by themselves: their errors and derivatives, and rows that a trial machine cannot have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from error_fields import with_fields
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.calibration import Inclinations, MeasurementError
from spm_pin.calibration.frames import Frames
from spm_pin.calibration.measurements import Measurements

STAGE = spm.Stage(0.7, 0.46, limits=(0.95, 1.25))
STATES = spm.forward_physical(STAGE, np.random.default_rng(2).uniform(0.95, 1.25, (4, 3)))


def with_gaps() -> Measurements:
    roll, pitch, height = STATES.roll.copy(), STATES.pitch.copy(), STATES.height.copy()
    roll[1] = pitch[1] = height[::2] = np.nan
    return Measurements.check(STAGE, Inclinations(roll, pitch, height), STATES.readings, frames=False)


def test_slopes_are_differences_of_errors_and_zero_where_nothing_was_measured() -> None:
    measured, here = with_gaps(), STAGE.parameters
    slopes = measured.slopes(STAGE, Frames.as_defined())
    for k in range(0, len(here), 4):
        step = 1e-6 * (np.arange(len(here)) == k)
        ends = [measured.errors(STAGE.from_parameters(here + s)) for s in (step, -step)]
        np.testing.assert_allclose(slopes[..., k], (ends[0] - ends[1]) / 2e-6, rtol=0, atol=1e-6)
    assert (~measured.present).sum() == 4
    assert (slopes[~measured.present] == 0.0).all()


def test_a_reading_below_the_offset_of_a_trial_machine_has_no_state() -> None:
    is_offset = np.array([name == "r_1.offset" for name in STAGE.parameter_names])
    machine = STAGE.from_parameters(STAGE.parameters + 1.3 * is_offset)
    measured = with_gaps()
    assert not measured.states(machine).exists.any()
    assert np.isnan(measured.errors(machine)[measured.present]).all()


def test_heights_in_another_unit_are_called_heights() -> None:
    levels = Inclinations(STATES.roll, STATES.pitch, 1e3 * STATES.height)
    received = f"values of {1e3 * np.median(STATES.height):g} for height"
    with pytest.raises(MeasurementError, check=with_fields(argument="poses", received=received)):
        Measurements.check(STAGE, levels, STATES.readings, frames=False)


PAPER = spm.Manipulator.paper()
ROBOT = spm.forward_physical(PAPER, np.random.default_rng(3).uniform(1.1, 1.5, (12, 6)))


def test_a_mirrored_height_is_named() -> None:
    poses = ROBOT.pose.as_matrix() * [[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, -1.0], [1.0] * 4]
    with pytest.raises(MeasurementError) as caught:
        Measurements.check(PAPER, poses, ROBOT.readings, frames=False)
    assert caught.value.argument == "poses"
    assert caught.value.cause.startswith("As x, y, -z they agree")


def test_only_what_a_tracker_sees_elsewhere_is_in_other_frames() -> None:
    tracker = RigidTransform.from_components([3.0, 1.0, 0.5], Rotation.from_rotvec([0.1, 0.4, 2.0]))
    measured = Measurements.check(PAPER, ROBOT.translation, ROBOT.readings, frames=False)
    elsewhere = replace(measured, poses=(tracker * ROBOT.pose).as_matrix())
    assert not measured.are_in_other_frames(PAPER)
    assert elsewhere.are_in_other_frames(PAPER)
