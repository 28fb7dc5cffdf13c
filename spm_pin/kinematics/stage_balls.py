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
from spm_pin.mechanism.leg_kinds import KINDS, RPS, LegKind
from spm_pin.mechanism.legs import Legs

_is_home_state = on_arrays(formulas.is_home_state)

_BALLS = ((3, 3), np.float64)
_CHORD = 0.1
"""Turn of a crank [rad] over which the arc of its end is replaced by the chord."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_FOLLOWED, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 10, 1 << 12


class StageHalf(NamedTuple):
    """The legs of one stage, a lower or an upper one, in the frame of the plate that carries them."""

    axes: FloatArray
    """Of the legs (3, 3)."""
    balls: FloatArray
    """In the platform's frame (3, 3) [m]."""
    up: float
    """-1 where the platform is below the circles' centres at home."""
    pivots: FloatArray
    planes: FloatArray
    """Directions of x and z of the legs' planes (2, 3, 3)."""
    kind: LegKind
    offsets: FloatArray


def halves(legs: Legs) -> list[StageHalf]:
    """Return the stages of a robot, or the only one."""
    planes, stages = np.stack(legs.planes), []
    for k, kind in enumerate(legs.kinds):
        own = slice(3 * k, 3 * k + 3)
        arrays = legs.axes[own], legs.balls[own], 1.0 - 2.0 * k, legs.pivots[own], planes[:, own]
        stages.append(StageHalf(*arrays, kind, legs.offsets[own]))
    return stages


Circles = tuple[FloatArray, FloatArray]
"""Centres (N, 3, 3) and radii (N, 3) [m]."""


def circles(stage: StageHalf, readings: FloatArray) -> Circles:
    """Return the circles that readings (N, 3) leave to the balls."""
    from spm_pin.kinematics.kernels.ball_circles import circle_centres

    own = readings - stage.offsets
    if isinstance(stage.kind, RPS):
        return np.broadcast_to(stage.pivots, (*own.shape, 3)), own
    x, z, radii = (np.broadcast_to(x, own.shape) for x in stage.kind.on_arrays.circle(own, tuple(stage.kind.numbers.T)))
    constants = stage.pivots, stage.planes
    (centres,) = run_kernel(circle_centres, (x, z), constants, [_BALLS], _MIN_BATCH_PER_THREAD_PHYSICAL)
    return centres, radii


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


def all_modes(stage: StageHalf, locked: Circles, drawing: Drawing | None = None) -> Modes:
    """Return all modes of stages, under the labels of the drawn one if that is given."""
    from spm_pin.kinematics.kernels.circle_modes import modes_of_stages

    axes, balls, up = stage[:3]
    place, is_rps, is_drawn, *radii = drawing or (np.stack([axes, balls, balls]), False, False, 1.0, 1.0)
    constants = axes, balls, place, is_rps, is_drawn, *radii, up
    results = ((16, 3, 3), np.float64), ((16,), np.bool_), ((2,), np.bool_), ((), np.int8)
    return Modes(*run_kernel(modes_of_stages, locked, constants, results, _MIN_BATCH_PER_THREAD))


def physical_balls(stage: StageHalf, locked: Circles) -> FloatArray:
    """Return the balls (N, 3, 3) [m] of a stage in its home's aspect, NaN where there is no such state."""
    from spm_pin.kinematics.kernels.ball_circles import ELSEWHERE, home_states

    results = _BALLS, ((), np.int8)
    balls, aspect = run_kernel(home_states, locked, stage[:3], results, _MIN_BATCH_PER_THREAD_PHYSICAL)
    elsewhere = np.flatnonzero(aspect == ELSEWHERE)
    if len(elsewhere):
        # Newton's method led elsewhere: the state is looked for among all modes.
        centres, radii = (x[elsewhere] for x in locked)
        modes, none = all_modes(stage, (centres, radii)).balls, np.zeros(3)
        three: Any = formulas.Circles(rows_of(stage.axes), rows_of(centres[:, None]), none, none)  # type: ignore[arg-type]
        is_home = _is_home_state(three, rows_of(modes - centres[:, None]), rows_of(modes), stage.up)
        found = modes[np.arange(len(modes)), is_home.argmax(axis=-1)]
        balls[elsewhere] = np.where(is_home.any(axis=-1)[:, None, None], found, np.nan)
    return np.asarray(balls)


def followed_balls(stage: StageHalf, balls: FloatArray, start: Circles, end: Circles) -> FloatArray:
    """Return where balls (N, 3, 3) [m] are led from circles to others, NaN where they meet a singularity."""
    from spm_pin.kinematics.kernels.ball_circles import follow_states

    inputs, constants = (balls, *start, *end), stage[:2]
    (led,) = run_kernel(follow_states, inputs, constants, [_BALLS], _MIN_BATCH_PER_THREAD_FOLLOWED)
    return np.asarray(led)


def in_working_mode(stage: StageHalf, balls: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the balls (..., 3, 3) of states with readings (..., 3), NaN where a leg is in another working mode."""
    if isinstance(stage.kind, RPS):
        return balls
    from spm_pin.kinematics.kernels.one_stage import working_modes

    inputs = balls.reshape(-1, 3, 3), np.broadcast_to(readings - stage.offsets, balls.shape[:-1]).reshape(-1, 3)
    constants = stage.pivots, stage.planes, list(KINDS).index(stage.kind.name), stage.kind.numbers
    (is_own,) = run_kernel(working_modes, inputs, constants, [((), np.bool_)], _MIN_BATCH_PER_THREAD_PHYSICAL)
    return balls if is_own.all() else np.where(is_own.reshape(*balls.shape[:-2], 1, 1), balls, np.nan)


def parts_of_turns(turns: FloatArray) -> int:
    """Return in how many parts cranks are to be led through these turns [rad], each along the chord of its arc."""
    return 1 + int(np.nan_to_num(np.abs(turns)).max(initial=0.0) / _CHORD)
