"""Legs of a calibrated machine: the derivatives of their axes, and that they are not taken for nominal ones."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import spm_pin as spm
from spm_pin.machine.legs import Legs

PAPER = spm.Manipulator.paper()


def test_only_a_machine_makes_nominal_legs() -> None:
    legs = PAPER.legs
    assert legs.is_nominal
    assert not Legs(*legs.arrays, legs.kinds).is_nominal
    with pytest.raises(TypeError):
        Legs(*legs.arrays, legs.kinds, True)  # type: ignore[call-arg]


@pytest.mark.parametrize("size", [3e-4, 0.2])
def test_axes_have_their_derivatives_by_the_two_coordinates_of_their_direction(size: float) -> None:
    """Small angles have a series of their own."""
    turns = size * np.random.default_rng(1).uniform(0.5, 1.0, (6, 2))
    parameters = PAPER.parameters.reshape(6, 9).copy()
    parameters[:, :2] = turns
    found = PAPER.from_parameters(parameters.ravel()).legs.axis_derivatives
    drawn, across = PAPER.legs.axes, PAPER.legs.axis_derivatives
    for leg, coordinate in np.ndindex(6, 3):

        def component(*t: mpmath.mpf, leg: int = leg, coordinate: int = coordinate) -> mpmath.mpf:
            angle = mpmath.sqrt(t[0] ** 2 + t[1] ** 2)
            along = sum(x * a for x, a in zip(t, across[leg, coordinate].tolist(), strict=True))
            return mpmath.cos(angle) * drawn[leg, coordinate] + mpmath.sin(angle) / angle * along

        exact = [mpmath.diff(component, tuple(turns[leg].tolist()), order) for order in ((1, 0), (0, 1))]
        np.testing.assert_allclose(found[leg, coordinate], [float(x) for x in exact], rtol=0, atol=1e-12)
