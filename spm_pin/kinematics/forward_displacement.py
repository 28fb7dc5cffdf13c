"""Forward displacement: every assembly mode of a machine's readings, the physical one, and the one near a state.

The upper stage in {m} is a 3RPS stage like the lower one, so the two are solved independently, and every
solution of one is combined with every solution of the other. The physical state is the one to which Newton's method
leads from the level stages. From a state, one mode is followed while the leg lengths change, in steps so short that
Newton's method provably does not leave it. See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.batches import flat_batch, run_kernel, with_batch_shape
from spm_pin.kinematics.readings import read_readings
from spm_pin.kinematics.stage_balls import STAGE_MODES, Modes, all_modes, followed_balls, physical_balls
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.joint_angles import homes
from spm_pin.machine.machine import Machine, unit_hint
from spm_pin.machine.manipulator import Manipulator, check_same_machine
from spm_pin.machine.solutions import Degeneracy, SolutionSet, Status
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, broadcastable

ASSEMBLY_MODES = tuple(f"{lower}/{upper}" for lower in STAGE_MODES for upper in STAGE_MODES)
"""Canonical order of the 256 assembly modes of the manipulator: the lower stage's, then the upper stage's."""

_OPEN = 1e-6
"""Largest closure residual of a configuration, relative to the side of the balls' triangle."""
_START = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50]) / 1.30
"""Leg lengths of the paper's solution 3, over its home lengths."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 12


def forward_displacement(machine: Manipulator | Stage, readings: npt.ArrayLike) -> SolutionSet:
    """Find all configurations with given readings: the assembly modes.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine. Its limits are not applied.
    readings : array_like, shape (..., 6); for a stage (..., 3)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m] ([rad] for RRS legs), in a nominal machine with RPS legs from revolute
        joint to ball joint centre.

    Returns
    -------
    SolutionSet
        The assembly modes of `ASSEMBLY_MODES`, for a stage `STAGE_MODES`, along the last axis, so `.rotation` is
        (..., 256, 3, 3) or (..., 16, 3, 3), NaN where a mode is not real or a leg is in another working mode. `.status`
        (...) is `Status.OK`; `UNREACHABLE` if a stage cannot be closed; `DEGENERATE` if a stage of a nominal machine
        with RPS legs moves with locked legs: the continuous family is omitted, and `.degeneracy` of a manipulator says
        to which families of modes it belongs; or `UNSOLVED`, all missing, if modes could not be separated: beside such
        a family, with legs shorter than a thousandth of the middle platform, and in a calibrated machine beside a
        forward singularity or with legs of fifty times its sides.

    Notes
    -----
    A stage's modes are named T (no torsion) or F (turned by half a turn) and numbered by decreasing mean radius of the
    middle joints about the stage's own axis, so T1 is tilted least; + is the sheet on which the middle platform
    is above the base, or below the terminal platform, - its mirror image. In machines that are not nominal or have
    other legs than RPS a fifth one of a mode and sheet takes a label that is left. Two modes that coincide to rounding,
    at a forward singularity, count once. A problem takes 43 kB: divide large batches.

    Examples
    --------
    >>> import spm_pin as spm
    >>> modes = spm.forward_displacement(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> int(modes.count), modes["T1+/T1+"].translation.round(4)
    (144, array([0.6889, 0.4963, 2.253 ]))
    >>> spm.forward_displacement(spm.Stage(base_radius=0.7, platform_radius=0.46), [1.2, 1.2, 1.4])
    <SolutionSet: ok, 12 of 16 real: T1+, T1-, T2+, T2-, T3+, T3-, T4+, T4-, …>
    """
    read = read_readings(machine, readings)
    shape, stages = read.shape[:-1], all_modes(machine, read.reshape(-1, read.shape[-1]))
    statuses = np.stack([stage.status for stage in stages])
    # If one stage cannot be closed there is no solution.
    is_absent = (statuses == Status.UNREACHABLE).any(axis=0)
    status = np.where(is_absent, Status.UNREACHABLE, statuses.max(axis=0)).astype(np.int8)
    if machine.is_stage:
        labels, families = STAGE_MODES, stages[0].continuous
        states = _joined(machine, (*shape, len(labels)), stages[0].balls, read[..., None, :])
    else:
        (below, above), is_solved = stages, status == Status.OK
        labels, families = ASSEMBLY_MODES, _continuous_families(below, above) * is_solved[:, None]
        states = _pairs_of_modes(machine, shape, below, above, is_solved)
    free = families.max(axis=-1)
    status[(status == Status.OK) & (free == 0) & ~states.exists.any(axis=-1).ravel()] = Status.UNREACHABLE
    status[(status == Status.OK) & (free > 0)] = Status.DEGENERATE
    free, families, status = with_batch_shape((free, families, status), shape)
    if not shape and status == Status.UNREACHABLE:
        states.missing_reason = unit_hint(machine, _lengths(machine, read))
    legs = np.zeros((*shape, 3), dtype=np.bool_)
    degeneracy = None if machine.is_stage else Degeneracy(np.asarray(free), families > 0, legs)
    return SolutionSet(states, labels, status, degeneracy=degeneracy)


def _pairs_of_modes(
    machine: Machine, shape: tuple[int, ...], below: Modes, above: Modes, is_solved: BoolArray
) -> Configuration:
    """Return the states (..., 256) of each lower mode with each upper one, NaN where it is not `is_solved` (N,)."""
    from spm_pin.kinematics.kernels.circle_modes import join_modes

    upper, n = np.where(is_solved[:, None, None, None], above.balls, np.nan), len(ASSEMBLY_MODES)
    results = ((n, 3, 3), np.float64), ((n, 3), np.float64), ((n, 3, 3), np.float64)
    solved = run_kernel(join_modes, (below.balls, upper), (machine.legs.balls,), results, _MIN_BATCH_PER_THREAD)
    return Configuration.from_arrays(machine, *with_batch_shape(solved, shape))


def forward_physical(
    machine: Manipulator | Stage, readings: npt.ArrayLike, near: Configuration | None = None
) -> Configuration:
    """Find the physical configuration with these readings, in which an assembled machine is.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine. Its limits are not applied.
    readings : array_like, shape (..., 6); for a stage (..., 3)
        Readings of the encoders of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m] ([rad] for RRS legs): in a nominal machine
        with RPS legs the leg lengths.
    near : Configuration, optional
        A state of the machine before. Its leading axes broadcast with those of `readings`.

    Returns
    -------
    Configuration
        Of shape (...). Without `near` the configuration in the home assembly region: all stages without
        torsion, on the sheet +, and reached from equal legs without a forward singularity. With `near` the end of the
        path on which its readings change to the given ones in a straight line, whatever its mode. `.exists` is
        False, and everything NaN, if there is no such configuration, if that path meets a forward singularity or takes
        more than 250,000 steps of a stage, or if a leg with a rod ends in another working mode than the machine's.

    Raises
    ------
    ArgumentError
        If a length is too large for the machine to be resolved, or for a stage out of proportion to it, or `near` does
        not close or belongs to another machine.

    Notes
    -----
    Nominal RPS legs have at most one configuration in the home assembly region; `docs/theory/uniqueness.md` proves
    it. It was T1+/T1+ in all cases with E and C at least a twentieth of d. Other legs may have two: give `near`.
    Newton's method finds it from the level stages; if that leads to another state, or fails with a leg shorter than a
    tenth of another, it is searched among all modes. Where it fails with other legs no state exists: this held for a
    million sets of leg lengths, but is not proved. The state `near` may be far: each step of the path is so short that
    Newton's method provably stays on it.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> state.pose.rotation.as_euler("XYX", degrees=True).round(4)
    array([-11.0818,  32.9691, -12.8831])
    """
    read = read_readings(machine, readings)
    legs = machine.legs
    if near is None:
        shape, balls = read.shape[:-1], physical_balls(legs, read.reshape(-1, read.shape[-1]))
    else:
        _check_near(machine, near)
        shape = broadcastable("near", near.shape, "readings", read.shape[:-1])
        parts = (near.balls_of_stages, 3), (near.readings, 1), (read, 1)
        balls = followed_balls(legs, *(flat_batch(array, shape, inner) for array, inner in parts))
    state = _joined(machine, shape, balls, read)
    if not state.shape and not state.exists:
        origin = "the home" if near is None else "`near` in a straight line"
        kinds = "forward" if legs.are_rps else "forward or leg"
        reason = f"with these readings no configuration is reached from {origin} without a {kinds} singularity"
        state.missing_reason = (
            f"{reason}. {unit_hint(machine, _lengths(machine, read)) if near is None else ''}".rstrip(". ")
        )
    return state


def _lengths(machine: Machine, readings: FloatArray) -> FloatArray:
    """Return readings that are lengths [m], zero in place of angles."""
    return np.where(np.array(machine.legs.units) == "m", readings, 0.0)


def states_of_stages(machine: Manipulator, readings: FloatArray) -> tuple[Configuration, tuple[int, int]]:
    """Return the physical states of lower and of upper stages with readings (N, 6), put together in any pairs.

    Where only one stage has a state it counts too. Returned are states (n,), and how many differ in each stage: the
    first n of the lower and m of the upper stage, after which they repeat; no states if a stage has none.
    """
    balls = physical_balls(machine.legs, readings)
    halves = [balls[np.isfinite(balls[:, k, 0, 0]), k] for k in range(2)]
    first, second = map(len, halves)
    pairs = np.arange(max(first, second) if first and second else 0)
    joined = np.stack([half[pairs % max(len(half), 1)] for half in halves], axis=1)
    state = _joined(machine, pairs.shape, joined)
    return state, (first, second)


def starting_configuration(machine: Manipulator) -> Configuration:
    """Return a regular configuration of the manipulator: the paper's solution 3, in proportion to the home lengths."""
    _, places = homes(machine)
    for share in (1.0, 0.5, 0.2, 0.05):
        # With the balls moved along the lines from their pivots, as far as the legs reach.
        moved = places * (1.0 + share * (_START - 1.0))[:, None]
        readings = machine.legs.readings(moved, machine.crank_middles)
        if np.isfinite(readings).all() and (state := forward_physical(machine, readings)).exists:
            return state
    raise ArgumentError("machine", "a manipulator that stands near its home", machine, "Give a pose instead")


def _check_near(machine: Machine, near: Any) -> None:
    """Raise an ArgumentError if `near` is not a closed state of this machine."""
    check_configuration(near, "near", existing=True)
    check_same_machine(near.machine, machine, "near", "`machine`")
    residual = float(near.closure_residual.max(initial=0.0))
    if not residual <= _OPEN * machine.ball_side:
        raise ArgumentError("near", "a configuration that closes", f"a closure residual of {residual:.1e} m")


def _continuous_families(below: Modes, above: Modes) -> IntArray:
    """Return the dimensions of the continuous families in TT, TF, FT, FF, (N, 4)."""
    free = below.continuous[:, :, None].astype(np.intp) + above.continuous[:, None]
    # The first place of a mode, T or F, is filled first.
    exists = [stage.continuous | np.isfinite(stage.balls[:, ::8, 0, 0]) for stage in (below, above)]
    return np.asarray((free * (exists[0][:, :, None] & exists[1][:, None])).reshape(-1, 4))


def _joined(
    machine: Machine, shape: tuple[int, ...], balls: FloatArray, readings: npt.ArrayLike = np.nan
) -> Configuration:
    """Return the states (...) with the balls (N, m, 3, 3) of all stages, in the frames of their bases.

    The readings (..., legs) of a stage broadcast with them; those of a manipulator follow from the balls.
    """
    from spm_pin.kinematics.kernels.ball_circles import join_stages

    rotation, place = ((3, 3), np.float64), ((3,), np.float64)
    joints: Any = np.empty((0, 3, 3)) if machine.is_stage else rotation
    stages, constants = balls.reshape(-1, len(machine.legs.kinds), 3, 3), [machine.legs.balls]
    solved = run_kernel(join_stages, [stages], constants, [rotation, place, joints], _MIN_BATCH_PER_THREAD_PHYSICAL)
    if not machine.is_stage:
        return Configuration.from_arrays(machine, *with_batch_shape(solved, shape))
    shown = np.array(np.broadcast_to(readings, (*shape, 3)))
    states = Configuration.from_arrays(machine, *with_batch_shape(solved[:2], shape), shown)
    return states if states.exists.all() else states.where(states.exists)
