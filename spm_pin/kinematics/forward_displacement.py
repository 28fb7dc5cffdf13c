"""Forward displacement: every assembly mode of six leg lengths, the physical one, and the one near a state.

The upper stage seen from {m} is a 3RPS stage like the lower one, so the two are solved independently, and every
solution of one goes with every solution of the other. The physical state is where Newton's method leads from the level
stages. From a state, one mode is followed while the leg lengths change, in steps so short that Newton's method provably
does not leave it. See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.kinematics.batches import flat_batch, radii, run_kernel, with_batch_shape
from spm_pin.kinematics.stage_balls import Drawing, Modes, all_modes, followed_balls, physical_balls
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.joint_angles import homes
from spm_pin.machine.legs import Legs
from spm_pin.machine.machine import unit_hint
from spm_pin.machine.manipulator import Manipulator, check_same_machine
from spm_pin.machine.solution_axis import Status
from spm_pin.machine.solutions import Degeneracy, SolutionSet
from spm_pin.support.arguments import (
    LARGEST_RATIO,
    FloatArray,
    IntArray,
    broadcastable,
    check_instance,
    first_offender,
    real_array,
)

STAGE_MODES = tuple(f"{mode}{place + 1}{sheet}" for mode in "TF" for place in range(4) for sheet in "+-")
"""Canonical order of the sixteen assembly modes of a stage: T1+, T1-, T2+ … F4-."""
ASSEMBLY_MODES = tuple(f"{lower}/{upper}" for lower in STAGE_MODES for upper in STAGE_MODES)
"""Canonical order of the 256 assembly modes of the manipulator: the lower stage's, then the upper stage's."""

_OPEN = 1e-6
"""Closure residual of a state, relative to d, from which on it is no configuration."""
_START = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50]) / 1.30
"""Leg lengths of the paper's solution 3, over its home lengths."""
_STATE = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64)
"""Results of kernels: R, o and the b_i."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 12


def forward_displacement(machine: Manipulator, readings: npt.ArrayLike) -> SolutionSet:
    """Find all configurations that six leg lengths allow.

    Parameters
    ----------
    machine : Manipulator
        The manipulator. Its leg limits are not applied.
    readings : array_like, shape (..., 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], in a drawn machine from revolute joint to ball joint centre.

    Returns
    -------
    SolutionSet
        The assembly modes of `ASSEMBLY_MODES` along the last axis, so `.rotation` is (..., 256, 3, 3), `.translation`
        (..., 256, 3) and `.middle_joints` (..., 256, 3, 3), NaN where a mode is not real. `.status` (...) is
        `Status.OK`; `UNREACHABLE` where a stage cannot be closed; `DEGENERATE` where a stage of a drawn machine moves
        with its legs locked: the continuous family is left out, and `.degeneracy` says in which families of modes it
        is; or `UNSOLVED`, and nothing exists, where not all modes could be told apart: beside such a family, with legs
        shorter than a thousandth of the middle platform, and in a machine as built beside a forward singularity or
        with legs of fifty times its sides.

        Of a machine as built labels are carried from the drawn machine with the same leg lengths while the errors
        grow. `.merged` (..., 256) marks those whose mode has met another one, and those that were left over.

    Notes
    -----
    A stage's modes are named T (no torsion) or F (turned half round) and numbered by falling mean radius of the
    middle joints about the stage's own axis, hence T1 is tilted least; + is the sheet on which the middle platform
    stands above the base, or hangs below the terminal platform, - its mirror image. Two modes that are to rounding
    the same, at a forward singularity, count once. A problem takes 43 kB: give large batches in parts.

    Examples
    --------
    >>> import spm_pin as spm
    >>> modes = spm.forward_displacement(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> int(modes.count), modes["T1+/T1+"].translation.round(4)
    (144, array([0.6889, 0.4963, 2.253 ]))
    """
    from spm_pin.kinematics.kernels.circle_modes import join_modes

    legs = check_instance(machine, Manipulator, "machine").legs
    checked = read_readings(legs, sum(machine.dimensions), readings)
    shape, readings, n = checked.shape[:-1], checked.reshape(-1, 6), len(ASSEMBLY_MODES)
    is_drawn = machine.is_nominal and legs.are_rps
    stages = zip(legs.stages, _of_stages(readings), _drawings(machine), strict=True)
    below, above = (all_modes(*stage) for stage in stages)
    # A stage that cannot be closed is enough to know that there is none.
    is_absent = (below.status == Status.UNREACHABLE) | (above.status == Status.UNREACHABLE)
    status = np.where(is_absent, Status.UNREACHABLE, np.maximum(below.status, above.status)).astype(np.int8)
    is_solved = status == Status.OK
    upper = np.where(is_solved[:, None, None, None], above.balls, np.nan)
    results = ((n, 3, 3), np.float64), ((n, 3), np.float64), ((n, 3, 3), np.float64)
    solved = run_kernel(join_modes, (below.balls, upper), (legs.balls,), results, _MIN_BATCH_PER_THREAD)
    merged = (below.merged[:, :, None] | above.merged[:, None]).reshape(-1, n) & (status != Status.UNSOLVED)[:, None]
    families = _continuous_families(below, above) * is_solved[:, None]
    if not legs.are_rps:
        status[(status == Status.OK) & np.isnan(solved[2][..., 0, 0]).all(axis=-1)] = Status.UNREACHABLE
    *state, merged, families, status = with_batch_shape((*solved, merged, families, status), shape)
    largest = np.asarray(families.max(axis=-1))
    modes = Configuration.from_arrays(machine, *state)
    if not shape and status == Status.UNREACHABLE:
        modes.missing_reason = unit_hint(machine, checked)
    return SolutionSet(
        modes,
        ASSEMBLY_MODES,
        np.where(largest > 0, Status.DEGENERATE, status),
        degeneracy=Degeneracy(largest, families > 0, np.zeros((*shape, 3), dtype=np.bool_)),
        merged=None if is_drawn else merged,
    )


def forward_physical(machine: Manipulator, readings: npt.ArrayLike, near: Configuration | None = None) -> Configuration:
    """Find the physical configuration with these readings: the one that the machine is in.

    Parameters
    ----------
    machine : Manipulator
        The manipulator. Its leg limits are not applied.
    readings : array_like, shape (..., 6)
        What the encoders of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 show [m]: in a drawn machine the leg lengths.
    near : Configuration, optional
        Where the machine was. Its leading axes broadcast with those of `readings`.

    Returns
    -------
    Configuration
        Of shape (...). Without `near` the configuration in the aspect of the symmetric home: both stages without
        torsion, on the sheet +, and reached from equal legs without a forward singularity. With `near` the end of the
        path on which its leg lengths change to the given ones in a straight line, whatever its mode. `.exists` is
        False, and everything NaN, where there is no such configuration, or where that path meets a forward
        singularity or takes more than 250,000 steps of a stage.

    Raises
    ------
    ArgumentError
        If a length is too large for the machine to be resolved beside it, or `near` does not close or belongs to
        another machine.

    Notes
    -----
    Of RPS legs as drawn the home's aspect holds one configuration at most; `docs/theory/uniqueness.md` proves it. It
    has been T1+/T1+ wherever E and C are a twentieth of d or more. Other legs may have two: give `near`.
    Newton's method finds it from the level stages, or it is looked for among all modes where that leads to another one.
    Where that leads nowhere there is none: so it was in a million sets of leg lengths, but it is not proved. The state
    `near` may be far, for each step of the path is so short that Newton's method provably stays on it.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> state.pose.rotation.as_euler("XYX", degrees=True).round(4)
    array([-11.0818,  32.9691, -12.8831])
    """
    legs = check_instance(machine, Manipulator, "machine").legs
    checked = read_readings(legs, sum(machine.dimensions), readings)
    if near is not None:
        _check_near(machine, checked, near)
        shape = np.broadcast_shapes(checked.shape[:-1], near.shape)
        upper = (near.balls[..., 3:, :] - near.translation[..., None, :]) @ near.rotation
        balls = np.stack([near.middle_joints, upper], axis=-3)
        flat = [flat_batch(x, shape, inner) for x, inner in ((balls, 3), (near.readings, 1), (checked, 1))]
        return _joined(machine, shape, followed_balls(legs, *flat))
    state = _joined(machine, checked.shape[:-1], physical_balls(legs, checked.reshape(-1, 6)))
    if not state.shape and not state.exists:
        reason = "with these readings no configuration is reached from the home without a forward singularity"
        state.missing_reason = f"{reason}. {unit_hint(machine, checked)}".rstrip(". ")
    return state


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
    return _joined(machine, pairs.shape, joined), (first, second)


def starting_configuration(machine: Manipulator) -> Configuration:
    """Return a regular configuration of the manipulator: the paper's solution 3, in proportion to the home lengths."""
    _, places = homes(machine)
    for share in (1.0, 0.5, 0.2, 0.05):
        # With the balls moved along the lines from their pivots, as far as the legs reach.
        readings = machine.legs.readings(places * (1.0 + share * (_START - 1.0))[:, None])
        if np.isfinite(readings).all() and (state := forward_physical(machine, readings)).exists:
            return state
    raise ArgumentError("machine", "a manipulator that stands near its home", machine, "Give a pose instead")


def set_of_one(state: Configuration, label: str) -> SolutionSet:
    """Return the set of one solution, which may not exist."""
    arrays = (array[None] for array in (state.rotation, state.translation, state.middle_joints))
    states = Configuration.from_arrays(state.machine, *arrays)
    return SolutionSet(states, (label,), Status.OK if state.exists else Status.UNREACHABLE)


def read_readings(legs: Legs, size: float, readings: npt.ArrayLike) -> FloatArray:
    """Read readings (..., n) of these legs, none so large that a machine of this size [m] is lost in its rounding."""
    meaning = f"in {legs.unit_text()}"
    read = real_array(readings, "readings", (len(legs.names),), f"{', '.join(legs.names)} {meaning}")
    own, farthest = np.asarray(read - legs.offsets), _farthest(legs.units, size)
    short, is_far = own <= legs.least_readings, np.abs(own) > farthest
    if not np.count_nonzero(short | is_far):
        return read
    if short.any():
        index = first_offender(short)
        where = f" for {legs.names[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        if legs.offsets[index[-1]]:
            expected = f"readings that exceed their offset, {legs.offsets[index[-1]]:g} m{where}"
            raise ArgumentError("readings", expected, f"{read[index]:g}")
        cause = "Strokes of the actuators instead of distances between joint centres?"
        expected = f"positive lengths {', '.join(legs.names)} {meaning}"
        raise ArgumentError("readings", expected, f"{own[index]:g}{where}", cause)
    index = first_offender(is_far)
    if legs.units[index[-1]] == "rad":
        expected, cause = f"angles in radians within ±{MOST_TURNED:g} for {legs.names[index[-1]]}", "In degrees?"
    else:
        expected = f"lengths in metres up to {LARGEST_RATIO:.0e} times the machine's own {size:.3g} m"
        cause = "Lengths in another unit?"
    raise ArgumentError("readings", expected, f"{own[index]:g}", cause)


@functools.lru_cache
def _farthest(units: tuple[str, ...], size: float) -> FloatArray:
    """Return the largest readings of legs with these units in a machine of this size [m]."""
    return np.where([unit == "m" for unit in units], LARGEST_RATIO * size, MOST_TURNED)


def _check_near(machine: Manipulator, lengths: FloatArray, near: Configuration) -> None:
    """Raise an ArgumentError if `near` is no closed state of this machine that goes with lengths (..., 6)."""
    check_configuration(near, "near", existing=True)
    check_same_machine(near.machine, machine, "near", "`machine`")
    broadcastable("near", near.shape, "readings", lengths.shape[:-1])
    residual = float(near.closure_residual.max(initial=0.0))
    if residual > _OPEN * machine.middle_side:
        raise ArgumentError("near", "a configuration that closes", f"a closure residual of {residual:.1e} m")


def _drawings(machine: Manipulator) -> tuple[Drawing, Drawing]:
    """Return the drawn stages. Of legs that are not RPS modes have no labels there, and take the first that fit."""
    legs, is_rps, (r, base, platform) = machine.nominal.legs, machine.legs.are_rps, radii(machine)
    whole = np.stack([legs.axes, legs.pivots, legs.balls])
    is_drawn = machine.is_nominal and is_rps
    lower, upper = (whole[:, half] for half in (slice(3), slice(3, 6)))
    return Drawing(lower, is_rps, is_drawn, r, base), Drawing(upper, is_rps, is_drawn, r, platform)


def _continuous_families(below: Modes, above: Modes) -> IntArray:
    """Return the dimensions of the continuous families in TT, TF, FT, FF, (N, 4)."""
    free = below.continuous[:, :, None].astype(np.intp) + above.continuous[:, None]
    # The first place of a mode, T or F, is filled first.
    exists = [stage.continuous | np.isfinite(stage.balls[:, ::8, 0, 0]) for stage in (below, above)]
    return np.asarray((free * (exists[0][:, :, None] & exists[1][:, None])).reshape(-1, 4))


def _of_stages(readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    return readings[:, :3], readings[:, 3:]


def _joined(machine: Manipulator, shape: tuple[int, ...], balls: FloatArray) -> Configuration:
    """Return the configurations (...) of the balls of both stages (N, 2, 3, 3), in {B} and in {m}."""
    from spm_pin.kinematics.kernels.ball_circles import join_stages

    states = run_kernel(join_stages, (balls,), (machine.legs.balls,), _STATE, _MIN_BATCH_PER_THREAD_PHYSICAL)
    return Configuration.from_arrays(machine, *with_batch_shape(states, shape))
