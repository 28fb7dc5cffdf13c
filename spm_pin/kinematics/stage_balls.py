"""The balls of one stage with given readings, physical or near others, on circles of any legs: arrays in and out.

A robot's two stages are solved one after the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spm_pin.kinematics.batches import run_kernel
from spm_pin.mechanism.arguments import FloatArray

_BALLS = ((3, 3), np.float64)
_CHORD = 0.1
"""Turn of a crank [rad] over which the arc of its end is replaced by the chord."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_FOLLOWED, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 10, 1 << 12


class Triangle(NamedTuple):
    """What a stage is besides its circles."""

    axes: FloatArray
    """Of the legs (3, 3)."""
    balls: FloatArray
    """In the platform's frame (3, 3) [m]."""
    up: float
    """-1 where the platform is below the circles' centres at home."""


Circles = tuple[FloatArray, FloatArray]
"""Centres (N, 3, 3) and radii (N, 3) [m]."""


def physical_balls(triangle: Triangle, circles: Circles) -> FloatArray:
    """Return the balls (N, 3, 3) [m] of a stage in its home's aspect, NaN where there is no such state."""
    from spm_pin.kinematics.kernels.ball_circles import ELSEWHERE, home_states
    from spm_pin.kinematics.kernels.circle_modes import searched_states

    results = _BALLS, ((), np.int8)
    balls, aspect = run_kernel(home_states, circles, triangle, results, _MIN_BATCH_PER_THREAD_PHYSICAL)
    elsewhere = np.flatnonzero(aspect == ELSEWHERE)
    if len(elsewhere):
        some = [x[elsewhere] for x in circles]
        (balls[elsewhere],) = run_kernel(searched_states, some, triangle, [_BALLS], _MIN_BATCH_PER_THREAD)
    return np.asarray(balls)


def followed_balls(triangle: Triangle, balls: FloatArray, start: Circles, end: Circles) -> FloatArray:
    """Return where balls (N, 3, 3) [m] are led from circles to others, NaN where they meet a singularity."""
    from spm_pin.kinematics.kernels.ball_circles import follow_states

    inputs, constants = (balls, *start, *end), triangle[:2]
    (led,) = run_kernel(follow_states, inputs, constants, [_BALLS], _MIN_BATCH_PER_THREAD_FOLLOWED)
    return np.asarray(led)


def parts_of_turns(turns: FloatArray) -> int:
    """Return in how many parts cranks are to be led through these turns [rad], each along the chord of its arc."""
    return 1 + int(np.nan_to_num(np.abs(turns)).max(initial=0.0) / _CHORD)
