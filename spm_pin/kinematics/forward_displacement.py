"""Forward displacement: every assembly mode of six leg lengths, the physical one, and the one near a state.

The upper stage in {m} is a 3RPS stage like the lower one, so the two are solved independently, and every
solution of one is combined with every solution of the other. The physical state is the one to which Newton's method
leads from the level stages. From a state, one mode is followed while the leg lengths change, in steps so short that
Newton's method provably does not leave it. See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import stage_displacement
from spm_pin.kinematics.batches import flat_batch, radii, run_kernel, with_batch_shape
from spm_pin.kinematics.either_machine import or_of_stage
from spm_pin.kinematics.readings import read_readings
from spm_pin.kinematics.stage_balls import STAGE_MODES, Modes, NominalStage, all_modes, followed_balls, physical_balls
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.joint_angles import homes
from spm_pin.machine.machine import unit_hint
from spm_pin.machine.manipulator import Manipulator, check_manipulator, check_same_machine
from spm_pin.machine.solution_axis import Status
from spm_pin.machine.solutions import Degeneracy, SolutionSet
from spm_pin.support.arguments import FloatArray, IntArray, broadcastable

ASSEMBLY_MODES = tuple(f"{lower}/{upper}" for lower in STAGE_MODES for upper in STAGE_MODES)
"""Canonical order of the 256 assembly modes of the manipulator: the lower stage's, then the upper stage's."""

_OPEN = 1e-6
"""Largest closure residual of a configuration, relative to d."""
_START = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50]) / 1.30
"""Leg lengths of the paper's solution 3, over its home lengths."""
_STATE = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64)
"""Results of kernels: R, o and the b_i."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 12


@or_of_stage(stage_displacement.forward)
def forward_displacement(machine: Manipulator, readings: npt.ArrayLike) -> SolutionSet:
    """Find all configurations with given leg lengths; for a stage see `spm_pin.kinematics.stage_displacement.forward`.

    Parameters
    ----------
    machine : Manipulator or Stage
        The manipulator. Its leg limits are not applied.
    readings : array_like, shape (..., 6); for a stage (..., 3)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], in a nominal machine from revolute joint to ball joint centre.

    Returns
    -------
    SolutionSet
        The assembly modes of `ASSEMBLY_MODES` along the last axis, so `.rotation` is (..., 256, 3, 3), `.translation`
        (..., 256, 3) and `.middle_joints` (..., 256, 3, 3), NaN where a mode is not real. `.status` (...) is
        `Status.OK`; `UNREACHABLE` if a stage cannot be closed; `DEGENERATE` if a stage of a nominal machine moves
        with locked legs: the continuous family is omitted, and `.degeneracy` says to which families of modes it
        belongs; or `UNSOLVED`, all missing, if modes could not be separated: beside such a family, with legs
        shorter than a thousandth of the middle platform, and in a calibrated machine beside a forward singularity or
        with legs of fifty times its sides.

        For a calibrated machine labels are tracked from the nominal machine with the same leg lengths while the errors
        grow. `.merged` (..., 256) is true if the tracked mode has met another one, and for remaining labels.

    Notes
    -----
    A stage's modes are named T (no torsion) or F (turned by half a turn) and numbered by decreasing mean radius of the
    middle joints about the stage's own axis, so T1 is tilted least; + is the sheet on which the middle platform
    is above the base, or below the terminal platform, - its mirror image. Two modes that coincide to rounding,
    at a forward singularity, count once. A problem takes 43 kB: divide large batches.

    Examples
    --------
    >>> import spm_pin as spm
    >>> modes = spm.forward_displacement(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> int(modes.count), modes["T1+/T1+"].translation.round(4)
    (144, array([0.6889, 0.4963, 2.253 ]))
    """
    from spm_pin.kinematics.kernels.circle_modes import join_modes

    legs = check_manipulator(machine).legs
    checked = read_readings(legs, sum(machine.dimensions), readings)
    shape, readings, n = checked.shape[:-1], checked.reshape(-1, 6), len(ASSEMBLY_MODES)
    is_nominal_rps = machine.is_nominal and legs.are_rps
    stages = zip(legs.stages, _of_stages(readings), _nominal_stages(machine), strict=True)
    below, above = (all_modes(*stage) for stage in stages)
    # If one stage cannot be closed there is no solution.
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
        merged=None if is_nominal_rps else merged,
    )


@or_of_stage(stage_displacement.forward_physical)
def forward_physical(machine: Manipulator, readings: npt.ArrayLike, near: Configuration | None = None) -> Configuration:
    """Find the physical configuration with these readings, in which an assembled machine is.

    For a stage see `spm_pin.kinematics.stage_displacement.forward_physical`.

    Parameters
    ----------
    machine : Manipulator or Stage
        The manipulator. Its leg limits are not applied.
    readings : array_like, shape (..., 6); for a stage (..., 3)
        Readings of the encoders of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m]: in a nominal machine the leg lengths.
    near : Configuration, optional
        A state of the machine before. Its leading axes broadcast with those of `readings`.

    Returns
    -------
    Configuration
        Of shape (...). Without `near` the configuration in the home assembly region: both stages without
        torsion, on the sheet +, and reached from equal legs without a forward singularity. With `near` the end of the
        path on which its leg lengths change to the given ones in a straight line, whatever its mode. `.exists` is
        False, and everything NaN, if there is no such configuration, or if that path meets a forward
        singularity or takes more than 250,000 steps of a stage.

    Raises
    ------
    ArgumentError
        If a length is too large for the machine to be resolved, or `near` does not close or belongs to
        another machine.

    Notes
    -----
    Nominal RPS legs have at most one configuration in the home assembly region; `docs/theory/uniqueness.md` proves
    it. It was T1+/T1+ in all cases with E and C at least a twentieth of d. Other legs may have two: give `near`.
    Newton's method finds it from the level stages; if that leads to another state, it is searched among all modes.
    If that fails no state exists: this held for a million sets of leg lengths, but is not proved. The state
    `near` may be far: each step of the path is so short that Newton's method provably stays on it.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> state.pose.rotation.as_euler("XYX", degrees=True).round(4)
    array([-11.0818,  32.9691, -12.8831])
    """
    legs = check_manipulator(machine).legs
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
        moved = places * (1.0 + share * (_START - 1.0))[:, None]
        readings = machine.legs.readings(moved, machine.crank_middles)
        if np.isfinite(readings).all() and (state := forward_physical(machine, readings)).exists:
            return state
    raise ArgumentError("machine", "a manipulator that stands near its home", machine, "Give a pose instead")


def _check_near(machine: Manipulator, lengths: FloatArray, near: Configuration) -> None:
    """Raise an ArgumentError if `near` is not a closed state of this machine whose shape fits lengths (..., 6)."""
    check_configuration(near, "near", existing=True)
    check_same_machine(near.machine, machine, "near", "`machine`")
    broadcastable("near", near.shape, "readings", lengths.shape[:-1])
    residual = float(near.closure_residual.max(initial=0.0))
    if residual > _OPEN * machine.middle_side:
        raise ArgumentError("near", "a configuration that closes", f"a closure residual of {residual:.1e} m")


def _nominal_stages(machine: Manipulator) -> tuple[NominalStage, NominalStage]:
    """Return the nominal stages. Modes of other legs than RPS have no nominal labels, and take the first that fit."""
    legs, is_rps, (r, base, platform) = machine.nominal.legs, machine.legs.are_rps, radii(machine)
    whole = np.stack([legs.axes, legs.pivots, legs.balls])
    is_nominal_rps = machine.is_nominal and is_rps
    lower, upper = (whole[:, half] for half in (slice(3), slice(3, 6)))
    return NominalStage(lower, is_rps, is_nominal_rps, r, base), NominalStage(
        upper, is_rps, is_nominal_rps, r, platform
    )


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
