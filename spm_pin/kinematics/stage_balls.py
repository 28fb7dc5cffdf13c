"""The balls of a machine's stages with given readings: all modes, the physical state, and one near another state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.formulas import circles as formulas
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.formulas.planar_legs import LONGEST_CHORD
from spm_pin.kinematics.batches import run_kernel
from spm_pin.machine.leg_kinds import RPS
from spm_pin.machine.legs import Legs, PlacedLegs
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import BoolArray, FloatArray

_is_home_state = on_arrays(formulas.is_home_state)

_BALLS = ((3, 3), np.float64)
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_FOLLOWED, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 10, 1 << 12

STAGE_MODES = tuple(f"{mode}{place + 1}{sheet}" for mode in "TF" for place in range(4) for sheet in "+-")
"""Canonical order of the sixteen assembly modes of a stage: T1+, T1-, T2+ … F4-."""
CentresAndRadii = tuple[FloatArray, FloatArray]
"""Centres (N, 3, 3) and radii (N, 3) [m]."""


class Modes(NamedTuple):
    """All modes of N stages."""

    balls: FloatArray
    """(N, 16, 3, 3) [m], NaN where a mode is not real."""
    continuous: BoolArray
    """True for the modes T, F of a nominal stage with RPS legs that are continuous families, (N, 2)."""
    status: npt.NDArray[np.int8]
    """`Status` (N,), without regard to continuous families."""


def all_modes(machine: Machine, readings: FloatArray) -> list[Modes]:
    """Return all modes of each stage of a machine with readings (N, legs)."""
    legs, every = machine.legs, []
    for k, (stage, (radius, ball_radius)) in enumerate(zip(legs.stages, machine.stage_radii, strict=True)):
        own = readings[:, 3 * k : 3 * k + 3]
        is_nominal_rps = machine.is_nominal and legs.are_rps
        modes = _modes(stage, _stage_circles(stage, own), (is_nominal_rps, ball_radius, radius))
        every.append(modes._replace(balls=_in_working_mode(stage, modes.balls, own[:, None])))
    return every


def physical_balls(legs: Legs, readings: FloatArray) -> FloatArray:
    """Return the balls (N, m, 3, 3) [m] of m stages in the home assembly region with readings (N, 3m), or NaN."""
    from spm_pin.kinematics.kernels.ball_circles import home_states

    locked, count = _circles(legs, readings), len(legs.kinds)
    constants, results = (legs.axes, legs.balls, legs.stage_ups), (((count, 3, 3), np.float64), ((count,), np.bool_))
    balls: FloatArray
    balls, is_elsewhere = run_kernel(home_states, locked, constants, results, _MIN_BATCH_PER_THREAD_PHYSICAL)
    # From the level stage Newton's method leads to every state of cylinders none of which is short, and wanders for
    # 1 in 500 of other legs, a few into another working mode.
    if not legs.are_rps:
        balls = _in_working_modes(legs, balls, readings)
        for k, kind in enumerate(legs.kinds):
            if not isinstance(kind, RPS):
                is_elsewhere[:, k] = np.isnan(balls[:, k, 0, 0])
    if np.count_nonzero(is_elsewhere):
        for k, stage in enumerate(legs.stages):
            elsewhere, own = np.flatnonzero(is_elsewhere[:, k]), slice(3 * k, 3 * k + 3)
            centres, radii = (x[elsewhere, own] for x in locked)
            balls[elsewhere, k] = _home_modes(stage, (centres, radii), readings[elsewhere, own])
    return balls


def followed_balls(legs: Legs, balls: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return balls (N, m, 3, 3) [m] tracked from readings (N, 3m) to others, NaN if a singularity is on the path."""
    from spm_pin.kinematics.kernels.ball_circles import follow_states

    parts, here = 1, _circles(legs, start)
    if "rad" in legs.units:
        # The end of each crank moves along chords of its arc.
        turns = np.nan_to_num(np.abs(end - start))[:, np.array(legs.units) == "rad"].max(initial=0.0)
        parts += int(turns / LONGEST_CHORD)
    for part in range(1, parts + 1):
        there = _circles(legs, end if part == parts else start + part / parts * (end - start))
        constants, results = (legs.axes, legs.balls), [(balls.shape[1:], np.float64)]
        inputs = balls, *here, *there
        (balls,) = run_kernel(follow_states, inputs, constants, results, _MIN_BATCH_PER_THREAD_FOLLOWED)
        here = there
    return _in_working_modes(legs, balls, end)


def _home_modes(stage: PlacedLegs, locked: CentresAndRadii, readings: FloatArray) -> FloatArray:
    """Return the balls (N, 3, 3) [m] of the first mode that is in the home assembly region, NaN where no mode is."""
    modes = _in_working_mode(stage, _modes(stage, locked).balls, readings[:, None])
    is_home = _is_home_state(rows_of(modes), rows_of(locked[0][:, None]), rows_of(stage.axes), stage.up)
    first = modes[np.arange(len(modes)), is_home.argmax(axis=-1)]
    return np.where(is_home.any(axis=-1)[:, None, None], first, np.nan)


def _circles(legs: Legs, readings: FloatArray) -> CentresAndRadii:
    """Return the circles that readings (N, 3m) of m stages leave to the balls."""
    if legs.are_rps:
        return _rps_circles(legs, readings)
    circles = [_stage_circles(stage, readings[:, 3 * k : 3 * k + 3]) for k, stage in enumerate(legs.stages)]
    centres, radii = (np.concatenate(x, axis=1) for x in zip(*circles, strict=True))
    return centres, radii


def _rps_circles(legs: Legs | PlacedLegs, readings: FloatArray) -> CentresAndRadii:
    own, pivots = readings - legs.offsets, legs.pivots[None]
    return (pivots if len(own) == 1 else np.broadcast_to(pivots, (*own.shape, 3))), own


def _stage_circles(stage: PlacedLegs, readings: FloatArray) -> CentresAndRadii:
    """Return the circles that readings (N, 3) leave to the balls of a stage."""
    from spm_pin.kinematics.kernels.ball_circles import circle_centres

    if isinstance(stage.kind, RPS):
        return _rps_circles(stage, readings)
    own = readings - stage.offsets
    x, z, radii = (np.broadcast_to(x, own.shape) for x in stage.kind.on_arrays.circle(own, tuple(stage.kind.numbers.T)))
    constants = stage.pivots, stage.planes
    (centres,) = run_kernel(circle_centres, (x, z), constants, [_BALLS], _MIN_BATCH_PER_THREAD_PHYSICAL)
    return centres, radii


def _modes(stage: PlacedLegs, locked: CentresAndRadii, nominal: tuple[bool, float, float] = (False, 1.0, 1.0)) -> Modes:
    """Return all modes; `nominal` are whether the stage is nominal with RPS legs, and its radii of balls and base."""
    from spm_pin.kinematics.kernels.circle_modes import modes_of_stages

    constants = stage.axes, stage.balls, *nominal, stage.up
    results = ((16, 3, 3), np.float64), ((2,), np.bool_), ((), np.int8)
    return Modes(*run_kernel(modes_of_stages, locked, constants, results, _MIN_BATCH_PER_THREAD))


def _in_working_modes(legs: Legs, balls: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the balls (N, m, 3, 3) of m stages with readings (N, 3m), NaN where one has a leg in another mode."""
    if not legs.are_rps:
        for k, stage in enumerate(legs.stages):
            balls[:, k] = _in_working_mode(stage, balls[:, k], readings[:, 3 * k : 3 * k + 3])
    return balls


def _in_working_mode(stage: PlacedLegs, balls: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the balls (..., 3, 3) of states with readings (..., 3), NaN if a leg is in another working mode."""
    if isinstance(stage.kind, RPS):
        return balls
    from spm_pin.kinematics.kernels.one_stage import working_modes

    inputs = balls.reshape(-1, 3, 3), np.broadcast_to(readings - stage.offsets, balls.shape[:-1]).reshape(-1, 3)
    constants = stage.pivots, stage.planes, stage.kind.number, stage.kind.numbers
    (is_own,) = run_kernel(working_modes, inputs, constants, [((), np.bool_)], _MIN_BATCH_PER_THREAD_PHYSICAL)
    return balls if is_own.all() else np.where(is_own.reshape(*balls.shape[:-2], 1, 1), balls, np.nan)
