"""Events along a followed solution: singularities and leg limits, where functions of the solution change sign.

The zeros of these functions are found by root finding on the solutions themselves.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS

_ROUNDING = 1e-12
"""Share of d by which rounding may move the length of a leg."""


class EventKind(enum.StrEnum):
    """Kinds of events along a path."""

    INVERSE_SINGULARITY = "inverse singularity"
    FORWARD_SINGULARITY = "forward singularity"
    LIMIT = "leg limit"
    SWITCH = "label changes"
    END = "solution ends"


@dataclass(frozen=True)
class Event:
    """Something that happens at one parameter."""

    kind: EventKind
    """Kind of the event: a singularity, a limit, a new label, the end."""
    parameter: float
    """Parameter of the path at which it happens, from 0 to 1."""
    detail: str
    """The stage, the leg and which limit, or the labels before and after."""


def find_events(
    geometry: Geometry, parameters: list[float], states: Configuration, state_at: Callable[[float], Configuration]
) -> list[Event]:
    """Find the singularities and leg limits that a followed solution meets.

    `states` (n,) are the solution at the n parameters, `state_at` finds it at any parameter in between.
    """
    values = _monitored(geometry, states)
    # A leg that is as long as its limit, to rounding, is within it.
    values[:, 3:][np.abs(values[:, 3:]) <= _ROUNDING * geometry.middle_side] = 0.0
    events = []
    for which in range(values.shape[-1]):
        column = values[:, which]

        def value(s: float, which: int = which) -> float:
            return float(_monitored(geometry, state_at(s))[which])

        for k in range(len(parameters) - 1):
            low, high = parameters[k], parameters[k + 1]
            before, after = column[k : k + 2]
            if which >= 3 and min(before, after) < 0.0 == max(before, after):
                events.append(_event(geometry, which, high if before < 0.0 else low, after - before))
            brackets = [(low, high)] if column[k] * column[k + 1] < 0.0 else _dip(value, parameters, column, k)
            for left, right in brackets:
                root = float(scipy.optimize.brentq(value, left, right, xtol=1e-13, rtol=8.9e-16))
                events.append(_event(geometry, which, root, value(right)))
    return events


def _monitored(geometry: Geometry, states: Configuration) -> FloatArray:
    """Return the functions whose zeros are events, shape (..., 3) or with limits (..., 15)."""
    scaled = determinants(states) / geometry.middle_side**3
    if geometry.limits is None:
        return scaled
    lengths = states.readings
    return np.concatenate([scaled, lengths - geometry.limits.minimum, geometry.limits.maximum - lengths], axis=-1)


def _event(geometry: Geometry, which: int, parameter: float, after: float) -> Event:
    if which < 2:
        return Event(EventKind.FORWARD_SINGULARITY, parameter, ("lower stage", "upper stage")[which])
    if which == 2:
        return Event(EventKind.INVERSE_SINGULARITY, parameter, "det K changes sign")
    assert geometry.limits is not None
    bound, values = ("minimum", geometry.limits.minimum) if which < 9 else ("maximum", geometry.limits.maximum)
    leg = (which - 3) % 6
    verb = "comes back within" if after > 0.0 else "goes beyond"
    return Event(EventKind.LIMIT, parameter, f"{LEGS[leg]} {verb} its {bound}, {values[leg]:g} m")


def _dip(
    value: Callable[[float], float], parameters: list[float], column: FloatArray, k: int
) -> list[tuple[float, float]]:
    """Return two brackets where a function of one sign at both ends crosses zero twice in between."""
    if not 0 < k < len(parameters) - 2 or column[k] == 0.0 or column[k + 1] == 0.0:
        return []
    sign = float(np.sign(column[k]))
    slopes = np.diff(sign * column[k - 1 : k + 3]) / np.diff(parameters[k - 1 : k + 3])
    low, high = parameters[k], parameters[k + 1]
    # Tangents from both sides meet below zero only where a dip may reach it.
    deepest = min(sign * column[k] + slopes[0] * (high - low), sign * column[k + 1] - slopes[2] * (high - low))
    if not (slopes[0] < 0.0 < slopes[2] and deepest < 0.0):
        return []
    lowest = scipy.optimize.minimize_scalar(
        lambda s: sign * value(s), bounds=(low, high), method="bounded", options={"xatol": 1e-12}
    )
    return [(low, float(lowest.x)), (float(lowest.x), high)] if lowest.fun < 0.0 else []
