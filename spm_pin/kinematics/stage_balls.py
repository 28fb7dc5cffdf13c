"""The balls of one stage with given readings, physical or near others, on circles of any legs: arrays in and out.

A robot's two stages are solved one after the other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.formulas import circles as formulas
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.kinematics.batches import run_kernel
from spm_pin.mechanism.arguments import BoolArray, FloatArray

_is_home_state = on_arrays(formulas.is_home_state)

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


class Drawing(NamedTuple):
    """The drawn stage, whose modes have labels."""

    legs: FloatArray
    """Axes, pivots and balls [m] (3, 3, 3)."""
    is_rps: bool
    is_drawn: bool
    """Whether the stage itself is the drawn one, of RPS legs."""
    radius: float
    """Of the platform [m]."""
    base_radius: float


class Modes(NamedTuple):
    """All modes of N stages."""

    balls: FloatArray
    """(N, 16, 3, 3) [m], NaN where a mode is not real."""
    merged: BoolArray
    """Labels (N, 16) whose mode has met another one, and those left over."""
    continuous: BoolArray
    """Which of the modes T, F of a drawn stage of RPS legs are continuous families, (N, 2)."""
    status: npt.NDArray[np.int8]
    """`Status` (N,) but for continuous families."""


def all_modes(triangle: Triangle, circles: Circles, drawing: Drawing | None = None) -> Modes:
    """Return all modes of stages, under the labels of the drawn one if that is given."""
    from spm_pin.kinematics.kernels.circle_modes import modes_of_stages

    axes, balls, up = triangle
    place, is_rps, is_drawn, *radii = drawing or (np.stack([axes, balls, balls]), False, False, 1.0, 1.0)
    constants = axes, balls, place, is_rps, is_drawn, *radii, up
    results = ((16, 3, 3), np.float64), ((16,), np.bool_), ((2,), np.bool_), ((), np.int8)
    return Modes(*run_kernel(modes_of_stages, circles, constants, results, _MIN_BATCH_PER_THREAD))


def physical_balls(triangle: Triangle, circles: Circles) -> FloatArray:
    """Return the balls (N, 3, 3) [m] of a stage in its home's aspect, NaN where there is no such state."""
    from spm_pin.kinematics.kernels.ball_circles import ELSEWHERE, home_states

    results = _BALLS, ((), np.int8)
    balls, aspect = run_kernel(home_states, circles, triangle, results, _MIN_BATCH_PER_THREAD_PHYSICAL)
    elsewhere = np.flatnonzero(aspect == ELSEWHERE)
    if len(elsewhere):
        # Newton's method led elsewhere: the state is looked for among all modes.
        centres, radii = (x[elsewhere] for x in circles)
        modes, none = all_modes(triangle, (centres, radii)).balls, np.zeros(3)
        stage: Any = formulas.Circles(rows_of(triangle.axes), rows_of(centres[:, None]), none, none)  # type: ignore[arg-type]
        is_home = _is_home_state(stage, rows_of(modes - centres[:, None]), rows_of(modes), triangle.up)
        found = modes[np.arange(len(modes)), is_home.argmax(axis=-1)]
        balls[elsewhere] = np.where(is_home.any(axis=-1)[:, None, None], found, np.nan)
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
