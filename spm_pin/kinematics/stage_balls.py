"""The balls of one stage for given readings, in its physical state or near another one, for legs of any kind.

The two stages of a manipulator are solved one after the other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.formulas import circles as formulas
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.formulas.planar_legs import LONGEST_CHORD
from spm_pin.kinematics.batches import run_kernel
from spm_pin.machine.leg_kinds import RPS
from spm_pin.machine.legs import PlacedLegs
from spm_pin.support.arguments import BoolArray, FloatArray

_is_home_state = on_arrays(formulas.is_home_state)

_BALLS = ((3, 3), np.float64)
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_FOLLOWED, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 10, 1 << 12

STAGE_MODES = tuple(f"{mode}{place + 1}{sheet}" for mode in "TF" for place in range(4) for sheet in "+-")
"""Canonical order of the sixteen assembly modes of a stage: T1+, T1-, T2+ … F4-."""
CentresAndRadii = tuple[FloatArray, FloatArray]
"""Centres (N, 3, 3) and radii (N, 3) [m]."""


class Drawing(NamedTuple):
    """The nominal stage, whose modes have labels."""

    legs: FloatArray
    """Axes, pivots and balls [m] (3, 3, 3)."""
    is_rps: bool
    is_drawn: bool
    """True if the stage itself is nominal, with RPS legs."""
    radius: float
    """Radius of the platform, on which the balls are [m]."""
    base_radius: float
    """Radius of the base, on which the pivots are [m]."""


class Modes(NamedTuple):
    """All modes of N stages."""

    balls: FloatArray
    """(N, 16, 3, 3) [m], NaN where a mode is not real."""
    merged: BoolArray
    """True for labels (N, 16) whose mode has met another one, and for remaining ones."""
    continuous: BoolArray
    """True for the modes T, F of a nominal stage with RPS legs that are continuous families, (N, 2)."""
    status: npt.NDArray[np.int8]
    """`Status` (N,), without regard to continuous families."""


def all_modes(stage: PlacedLegs, readings: FloatArray, drawing: Drawing) -> Modes:
    """Return all modes with readings (N, 3), under the labels of the nominal stage."""
    modes = _modes(stage, _circles(stage, readings), drawing)
    return modes._replace(balls=_in_working_mode(stage, modes.balls, readings[:, None]))


def physical_balls(stage: PlacedLegs, readings: FloatArray) -> FloatArray:
    """Return the balls (N, 3, 3) [m] in the home assembly region with readings (N, 3), NaN if missing."""
    from spm_pin.kinematics.kernels.ball_circles import home_states

    locked, results = _circles(stage, readings), (_BALLS, ((), np.bool_))
    balls, is_elsewhere = run_kernel(home_states, locked, stage[:3], results, _MIN_BATCH_PER_THREAD_PHYSICAL)
    # From the level stage Newton's method leads to every state of cylinders, but fails for 1 in 500 of other legs,
    # a few of which end in another working mode.
    balls = _in_working_mode(stage, balls, readings)
    is_elsewhere = is_elsewhere if isinstance(stage.kind, RPS) else np.isnan(balls[:, 0, 0])
    if np.count_nonzero(is_elsewhere):
        elsewhere = np.flatnonzero(is_elsewhere)
        # The state is searched among all modes.
        centres, radii = (x[elsewhere] for x in locked)
        unlabelled = Drawing(np.stack([stage.axes, stage.pivots, stage.balls]), False, False, 1.0, 1.0)
        modes, none = _modes(stage, (centres, radii), unlabelled).balls, np.zeros(3)
        modes = _in_working_mode(stage, modes, readings[elsewhere, None])
        three: Any = formulas.Circles(rows_of(stage.axes), rows_of(centres[:, None]), none, none)  # type: ignore[arg-type]
        is_home = _is_home_state(three, rows_of(modes - centres[:, None]), rows_of(modes), stage.up)
        found = modes[np.arange(len(modes)), is_home.argmax(axis=-1)]
        balls[elsewhere] = np.where(is_home.any(axis=-1)[:, None, None], found, np.nan)
    return balls


def followed_balls(stage: PlacedLegs, balls: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the balls (N, 3, 3) [m] after their readings (N, 3) change to others, NaN if they meet a singularity."""
    from spm_pin.kinematics.kernels.ball_circles import follow_states

    # The end of each crank moves along chords of its arc.
    turns = np.nan_to_num(np.abs(end - start)).max(initial=0.0) if stage.kind.unit == "rad" else 0.0
    parts, here = 1 + int(turns / LONGEST_CHORD), _circles(stage, start)
    for part in range(1, parts + 1):
        there = _circles(stage, end if part == parts else start + part / parts * (end - start))
        inputs = balls, *here, *there
        (balls,) = run_kernel(follow_states, inputs, stage[:2], [_BALLS], _MIN_BATCH_PER_THREAD_FOLLOWED)
        here = there
    return _in_working_mode(stage, balls, end)


def _circles(stage: PlacedLegs, readings: FloatArray) -> CentresAndRadii:
    """Return the circles of the balls for readings (N, 3)."""
    from spm_pin.kinematics.kernels.ball_circles import circle_centres

    own = readings - stage.offsets
    if isinstance(stage.kind, RPS):
        return (stage.pivots[None] if len(own) == 1 else np.broadcast_to(stage.pivots, (*own.shape, 3))), own
    x, z, radii = (np.broadcast_to(x, own.shape) for x in stage.kind.on_arrays.circle(own, tuple(stage.kind.numbers.T)))
    constants = stage.pivots, stage.planes
    (centres,) = run_kernel(circle_centres, (x, z), constants, [_BALLS], _MIN_BATCH_PER_THREAD_PHYSICAL)
    return centres, radii


def _modes(stage: PlacedLegs, locked: CentresAndRadii, drawing: Drawing) -> Modes:
    from spm_pin.kinematics.kernels.circle_modes import modes_of_stages

    constants = stage.axes, stage.balls, *drawing, stage.up
    results = ((16, 3, 3), np.float64), ((16,), np.bool_), ((2,), np.bool_), ((), np.int8)
    return Modes(*run_kernel(modes_of_stages, locked, constants, results, _MIN_BATCH_PER_THREAD))


def _in_working_mode(stage: PlacedLegs, balls: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the balls (..., 3, 3) of states with readings (..., 3), NaN if a leg is in another working mode."""
    if isinstance(stage.kind, RPS):
        return balls
    from spm_pin.kinematics.kernels.one_stage import working_modes

    inputs = balls.reshape(-1, 3, 3), np.broadcast_to(readings - stage.offsets, balls.shape[:-1]).reshape(-1, 3)
    constants = stage.pivots, stage.planes, stage.kind.number, stage.kind.numbers
    (is_own,) = run_kernel(working_modes, inputs, constants, [((), np.bool_)], _MIN_BATCH_PER_THREAD_PHYSICAL)
    return balls if is_own.all() else np.where(is_own.reshape(*balls.shape[:-2], 1, 1), balls, np.nan)
