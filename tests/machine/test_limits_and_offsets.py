"""Limits are readings: a leg's encoder offset decides which of them are lengths."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from error_fields import with_fields

import spm_pin as spm


def with_offset(offset: float) -> spm.Stage:
    stage = spm.Stage(0.3, 0.4)
    return dataclasses.replace(stage, legs=dataclasses.replace(stage.legs, offsets=np.full(3, offset)))


@pytest.mark.parametrize(
    ("offset", "limits"), [(-0.5, (-0.2, 0.3)), (-0.5, (-0.5, 0.3)), (1e-4, (0.0, 0.7)), (0.5, (0.2, 0.9))]
)
def test_readings_of_some_lengths_are_limits(offset: float, limits: tuple[float, float]) -> None:
    machine = dataclasses.replace(with_offset(offset), limits=limits)
    readings = np.full(3, 0.5 + offset)
    state = spm.forward_physical(machine, readings)
    np.testing.assert_allclose(state.leg_lengths, 0.5, rtol=1e-12)
    assert machine.limits is not None
    assert machine.limits.contains(readings) == (limits[0] <= 0.5 + offset <= limits[1])


@pytest.mark.parametrize(("offset", "limits"), [(-0.5, (-0.6, 0.3)), (0.0, (-0.1, 0.3)), (0.5, (-0.2, 0.9))])
def test_readings_of_no_length_are_refused(offset: float, limits: tuple[float, float]) -> None:
    with pytest.raises(spm.GeometryError, check=with_fields(argument="limits")):
        dataclasses.replace(with_offset(offset), limits=limits)
