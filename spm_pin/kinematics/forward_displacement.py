"""Forward displacement: every assembly mode of six leg lengths, the physical one, and the one near a state.

The upper stage seen from {m} is a 3RPS stage like the lower one, so the two are solved independently, see
`spm_pin.kinematics.formulas.stages`, and every solution of one goes with every solution of the other.

From a state, one mode is followed while the leg lengths change, in steps that are proved not to leave it: by the
theorem of Newton and Kantorovich, if the inverse of the derivative times its Lipschitz constant times Newton's first
step is at most 1/2, Newton's method converges to the only solution nearby. Steps are so short that this holds with a
margin. A machine as built is followed in the same way from the drawn machine, while the dimensions change.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.kinematics.batches import LARGEST_RATIO, flat_batch, radii, run_kernel, with_batch_shape
from spm_pin.mechanism.arguments import (
    BoolArray,
    FloatArray,
    broadcastable,
    check_instance,
    first_offender,
    real_array,
)
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry, unit_hint
from spm_pin.mechanism.joint_angles import home_lengths
from spm_pin.mechanism.leg_limits import LEGS
from spm_pin.mechanism.legs import triangle_frames, triangle_sides
from spm_pin.mechanism.solutions import Degeneracy, SolutionSet, Status

STAGE_MODES = tuple(f"{mode}{place + 1}{sheet}" for mode in "TF" for place in range(4) for sheet in "+-")
"""Canonical order of the sixteen assembly modes of a stage: T1+, T1-, T2+ … F4-."""
ASSEMBLY_MODES = tuple(f"{lower}/{upper}" for lower in STAGE_MODES for upper in STAGE_MODES)
"""Canonical order of the 256 assembly modes of the manipulator: the lower stage's, then the upper stage's."""

_NEAR = 1e-5
"""Distance from a family, of squared lengths and relative to their size, within which counts may be wrong."""
_SHORT = 1e-3
"""Length in units of r below which a leg is short."""
_OPEN = 1e-6
"""Closure residual of a state, relative to d, from which on it is no configuration."""
_START = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50]) / 1.30
"""Leg lengths of the paper's solution 3, over its home lengths."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_FOLLOWED, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 10, 1 << 12


def forward_displacement(geometry: Geometry, readings: npt.ArrayLike) -> SolutionSet:
    """Find all configurations of a drawn machine that its six leg lengths allow.

    Parameters
    ----------
    geometry : Geometry
        The manipulator, a drawn machine. Its leg limits are not applied.
    readings : array_like, shape (..., 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], in a drawn machine from revolute joint to ball joint centre.

    Returns
    -------
    SolutionSet
        The assembly modes of `ASSEMBLY_MODES` along the last axis, so `.rotation` is (..., 256, 3, 3), `.translation`
        (..., 256, 3) and `.middle_joints` (..., 256, 3, 3), NaN where a mode is not real. `.status` (...) is
        `Status.OK`; `UNREACHABLE` where a stage cannot be closed; or `DEGENERATE` where a stage moves with its legs
        locked: the continuous family is left out, and `.degeneracy` says in which families of modes it is.

    Raises
    ------
    ArgumentError
        If a length is not a positive number, or too large for the machine to be resolved beside it, or the machine is
        one as built: its assembly modes are not known, see `forward_physical`.

    Notes
    -----
    A stage's modes are named T (no torsion) or F (turned half round) and numbered by falling mean radius of the
    middle joints about the stage's own axis, hence T1 is tilted least; + is the sheet on which the middle platform
    stands above the base, or hangs below the terminal platform, - its mirror image. Two modes that are to rounding
    the same, at a forward singularity, count once. A problem takes 43 kB: give large batches in parts.

    The paper left this problem to CAD. T and F are the operation modes of the 3-RPS stage [1]_.

    References
    ----------
    .. [1] J. Schadlbauer, M. Husty, S. Caro, P. Wenger, "Self-Motions of 3-RPS Manipulators", Frontiers of Mechanical
       Engineering 8 (2013). More in docs/related_work.md.

    Examples
    --------
    >>> import spm_pin as spm
    >>> modes = spm.forward_displacement(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> int(modes.count), modes["T1+/T1+"].translation.round(4)
    (144, array([0.6889, 0.4963, 2.253 ]))
    """
    from spm_pin.kinematics.kernels.mode_kernels import all_modes

    checked = _read_lengths(geometry, readings)
    if not geometry.is_nominal:
        cause = "forward_physical finds the physical mode of a machine as built; all modes are those of its .nominal"
        raise GeometryError("geometry", "a machine as drawn", "one as built", cause)
    shape, lengths, n = checked.shape[:-1], checked.reshape(-1, 6), len(ASSEMBLY_MODES)
    results = (
        ((n, 3, 3), np.float64),
        ((n, 3), np.float64),
        ((n, 3, 3), np.float64),
        ((4,), np.int8),
        ((), np.int8),
    )
    solved = run_kernel(all_modes, (lengths,), radii(geometry), results, _MIN_BATCH_PER_THREAD)
    _solve_ill_conditioned(geometry, lengths, solved)
    *state, families, status = with_batch_shape(solved, shape)
    largest = np.asarray(families.max(axis=-1))
    modes = Configuration.from_arrays(geometry, *state)
    if not shape and status == Status.UNREACHABLE:
        modes.missing_reason = unit_hint(geometry, checked)
    return SolutionSet(
        modes,
        ASSEMBLY_MODES,
        np.where(largest > 0, Status.DEGENERATE, status),
        degeneracy=Degeneracy(largest, families > 0, np.zeros((*shape, 3), dtype=np.bool_)),
    )


def forward_physical(geometry: Geometry, readings: npt.ArrayLike, near: Configuration | None = None) -> Configuration:
    """Find the physical configuration with these readings: the one that the machine is in.

    Parameters
    ----------
    geometry : Geometry
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
        If a length is not a positive number or too large for the machine to be resolved beside it, or `near` does
        not exist, does not close, belongs to another machine or has another shape.

    Notes
    -----
    The home's aspect holds one configuration at most, so what Newton's method finds from level stages is taken if it is
    in there; if not, all solutions of mode T are found and looked at. It is T1+/T1+ unless E or C is less than
    a twentieth of d. With `near` each step is so short that Newton's method provably stays on the path, see the module;
    so that state may be far. A machine as built is followed from the drawn machine, or from `near`; see
    `docs/theory/as_built.md`.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> state.pose.rotation.as_euler("XYX", degrees=True).round(4)
    array([-11.0818,  32.9691, -12.8831])
    """
    checked = _read_lengths(geometry, readings)
    if near is not None:
        _check_near(geometry, checked, near)
        follow = _follow_drawn if geometry.is_nominal else _follow_as_built
        return follow(geometry, checked, near)
    shape, lengths = checked.shape[:-1], checked.reshape(-1, 6)
    solve = _solve_drawn if geometry.is_nominal else _solve_as_built
    state = Configuration.from_arrays(geometry, *with_batch_shape(solve(geometry, lengths), shape))
    if not shape and not state.exists:
        reason = "with these leg lengths no configuration is reached from the home without a forward singularity"
        state.missing_reason = f"{reason}. {unit_hint(geometry, checked)}".rstrip(". ")
    return state


def starting_configuration(geometry: Geometry) -> Configuration:
    """Return a regular configuration of the manipulator: the paper's solution 3, in proportion.

    Its leg lengths are the paper's 120, 120, 140, 125, 120 and 150 cm over 130 cm, times the home lengths.

    Raises
    ------
    ArgumentError
        If the manipulator has no such configuration.
    """
    home = np.repeat(home_lengths(geometry), 3)
    for share in (1.0, 0.5, 0.2, 0.05):
        state = forward_physical(geometry, home * (1.0 + share * (_START - 1.0)) + geometry.legs.offsets)
        if state.exists:
            return state
    raise ArgumentError("geometry", "a manipulator that stands near its home", geometry, "Give a pose instead")


def modes_near(geometry: Geometry, readings: FloatArray, near: Configuration | None) -> SolutionSet:
    """Return the assembly modes of readings (6,) among which a path from the state `near` goes on.

    All of a drawn machine. Of one as built the only one that is followed from there, or without `near` the physical.
    """
    if geometry.is_nominal:
        return forward_displacement(geometry, readings)
    state = forward_physical(geometry, readings, near)
    arrays = state.rotation, state.translation, state.middle_joints
    states = Configuration.from_arrays(geometry, *(array[None] for array in arrays))
    return SolutionSet(states, ("followed",), Status.OK if state.exists else Status.UNREACHABLE)


def _read_lengths(geometry: Geometry, readings: npt.ArrayLike) -> FloatArray:
    """Return leg lengths (..., 6) [m] from readings that this machine can be resolved beside."""
    check_instance(geometry, Geometry, "geometry")
    meaning = f"{', '.join(LEGS)} in metres"
    read, offsets = real_array(readings, "readings", (6,), meaning), geometry.legs.offsets
    lengths = np.asarray(read - offsets) if offsets.any() else read
    if (lengths <= 0.0).any():
        index = first_offender(lengths <= 0.0)
        where = f" for {LEGS[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        if offsets[index[-1]]:
            expected = f"readings that exceed their offset, {offsets[index[-1]]:g} m{where}"
            raise ArgumentError("readings", expected, f"{read[index]:g}")
        cause = "Strokes of the actuators instead of distances between joint centres?"
        raise ArgumentError("readings", f"positive lengths {meaning}", f"{lengths[index]:g}{where}", cause)
    size = sum(geometry.dimensions)
    if (lengths > LARGEST_RATIO * size).any():
        index = first_offender(lengths > LARGEST_RATIO * size)
        expected = f"lengths in metres up to {LARGEST_RATIO:.0e} times the machine's own {size:.3g} m"
        raise ArgumentError("readings", expected, f"{lengths[index]:g}", "Lengths in another unit?")
    return lengths


def _check_near(geometry: Geometry, lengths: FloatArray, near: Configuration) -> None:
    """Raise an ArgumentError if `near` is no closed state of this machine that goes with lengths (..., 6)."""
    check_configuration(near, "near", existing=True)
    if not geometry.is_same_machine(near.geometry):
        raise ArgumentError("near", f"a configuration of this geometry, {geometry!r}", repr(near.geometry))
    broadcastable("near", near.shape, "readings", lengths.shape[:-1])
    residual = float(near.closure_residual.max(initial=0.0))
    if residual > _OPEN * geometry.middle_side:
        raise ArgumentError("near", "a configuration that closes", f"a closure residual of {residual:.1e} m")


def _follow_drawn(geometry: Geometry, lengths: FloatArray, near: Configuration) -> Configuration:
    """Follow `near` to leg lengths (..., 6), each stage by itself; NaN where a stage meets a singularity."""
    from spm_pin.kinematics.kernels.continuation_kernel import follow_stages, stage_states
    from spm_pin.kinematics.kernels.mode_kernels import compose_all

    shape = np.broadcast_shapes(lengths.shape[:-1], near.shape)
    r, count = geometry.middle_radius, int(np.prod(shape))
    legs = [flat_batch(x, shape, 1) / r for x in (near.leg_lengths, lengths)]
    # The lower stages, then the upper ones as they are seen from {m}.
    start, end = (np.concatenate([x[:, :3], x[:, 3:]]) for x in legs)
    corners = np.concatenate([flat_batch(balls, shape, 2) for balls in _balls_of_stages(near)])
    hips = np.repeat([geometry.base_radius / r, geometry.platform_radius / r], count)
    stage = ((4,), np.float64), ((), np.bool_)
    starts, half_turned = run_kernel(stage_states, (corners,), (r,), stage, _MIN_BATCH_PER_THREAD_FOLLOWED)
    inputs = start, end, np.where(half_turned, -hips, hips), starts
    states, arrived = run_kernel(follow_stages, inputs, (), stage, _MIN_BATCH_PER_THREAD_FOLLOWED)
    states[~arrived] = np.nan
    x0, x1, x2, zeta = states.T
    zero = 0.0 * x0  # NaN where a stage has not arrived
    plain, turned = np.stack([x0, x1, x2, zero, zeta], -1), np.stack([zero, x2, -x1, x0, -zeta], -1)
    stages = np.where(half_turned[:, None], turned, plain)
    results = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64)
    halves = stages[:count], stages[count:]
    composed = run_kernel(compose_all, halves, (r,), results, _MIN_BATCH_PER_THREAD_FOLLOWED)
    return Configuration.from_arrays(geometry, *with_batch_shape(composed, shape))


def _follow_as_built(geometry: Geometry, lengths: FloatArray, near: Configuration) -> Configuration:
    """Follow `near` to leg lengths (..., 6) as `_follow_drawn` does."""
    shape = np.broadcast_shapes(lengths.shape[:-1], near.shape)
    balls = np.concatenate(_balls_of_stages(near), axis=-2)
    legs = [flat_batch(x, shape, 1) for x in (near.leg_lengths, lengths)]
    followed = _follow_circles(geometry, geometry, flat_batch(balls, shape, 2), *legs)
    return Configuration.from_arrays(geometry, *with_batch_shape(_composed(geometry, followed), shape))


def _balls_of_stages(state: Configuration) -> tuple[FloatArray, FloatArray]:
    """Return the balls (..., 3, 3) of the lower legs in {B} and of the upper legs in {m} [m]."""
    upper = state.balls[..., 3:, :] - state.translation[..., None, :]
    return state.balls[..., :3, :], (upper[..., None, :] @ state.rotation[..., None, :, :])[..., 0, :]


def _solve_as_built(geometry: Geometry, lengths: FloatArray) -> tuple[FloatArray, ...]:
    """Return R, o and the b_i (N, ...) of the physical state of a machine as built with leg lengths (N, 6).

    The state of the drawn machine with the same distances from pivots to balls is followed while the dimensions change
    to those of this machine, or, where that gives none, the level state with equal legs is followed to the given legs.
    """
    drawn = geometry.nominal
    start = Configuration.from_arrays(drawn, *_solve_drawn(drawn, lengths))
    balls = np.concatenate(_balls_of_stages(start), axis=-2)
    balls = _follow_circles(drawn, geometry, balls, lengths, lengths)
    state = _composed(geometry, balls)
    is_physical = physical(Configuration.from_arrays(geometry, *state))
    missing = np.flatnonzero(~is_physical)
    if len(missing):
        others = _composed(geometry, _follow_from_home(geometry, lengths[missing]))
        wrong = ~physical(Configuration.from_arrays(geometry, *others))
        for array, values in zip(state, others, strict=True):
            values[wrong] = np.nan
            array[missing] = values
    return state


def _follow_from_home(geometry: Geometry, lengths: FloatArray) -> FloatArray:
    """Follow the level state with equal legs to legs (N, 6); return its balls as `_follow_circles` does."""
    drawn, r = geometry.nominal, geometry.middle_radius
    offsets = np.array([geometry.base_radius, geometry.platform_radius]) - r
    # Legs at least so long that the level stage is well away from flat.
    equal = np.maximum(lengths.reshape(-1, 2, 3).mean(axis=-1), np.hypot(1.0, 0.5) * np.abs(offsets))
    height = np.sqrt(np.maximum(equal**2 - offsets**2, 0.0))
    balls = np.concatenate([np.broadcast_to(r * geometry.radial_directions, (len(lengths), 3, 3))] * 2, axis=1)
    balls[..., 2] = np.repeat(height * [1.0, -1.0], 3, axis=-1)
    legs = np.repeat(equal, 3, axis=-1)
    return _follow_circles(geometry, geometry, _follow_circles(drawn, geometry, balls, legs, legs), legs, lengths)


def _follow_circles(
    start: Geometry, end: Geometry, balls: FloatArray, start_lengths: FloatArray, end_lengths: FloatArray
) -> FloatArray:
    """Follow states to other dimensions and lengths (N, 6); balls (N, 6, 3), the lower in {B}, the upper in {m}."""
    from spm_pin.kinematics.kernels.ball_circles import follow_circles

    unit, moved = end.middle_radius, np.empty_like(balls)
    for stage in (slice(3), slice(3, 6)):
        machines = [np.stack([g.legs.axes[stage], g.legs.pivots[stage] / unit]) for g in (start, end)]
        sides = [triangle_sides(g.legs.balls[stage]) / unit for g in (start, end)]
        inputs = balls[:, stage] / unit, start_lengths[:, stage] / unit, end_lengths[:, stage] / unit
        results = ((3, 3), np.float64), ((), np.bool_)
        reached, _ = run_kernel(follow_circles, inputs, (*machines, *sides), results, _MIN_BATCH_PER_THREAD_FOLLOWED)
        moved[:, stage] = reached * unit
    moved[np.isnan(moved).any(axis=(-1, -2))] = np.nan
    return moved


def _composed(geometry: Geometry, balls: FloatArray) -> tuple[FloatArray, ...]:
    """Return R, o and the b_i of the states in which {n} is where balls (N, 6, 3) are, seen from {B} and from {m}."""
    local, placed = geometry.legs.balls.reshape(2, 3, 3), balls.reshape(-1, 2, 3, 3)
    turns = triangle_frames(placed) @ np.swapaxes(triangle_frames(local), -1, -2)
    places = placed.mean(axis=-2) - (turns @ local.mean(axis=-2)[..., None])[..., 0]
    rotation = turns[:, 0] @ np.swapaxes(turns[:, 1], -1, -2)
    translation = places[:, 0] - (rotation @ places[:, 1, :, None])[..., 0]
    return rotation, translation, np.ascontiguousarray(balls[:, :3])


def _solve_drawn(geometry: Geometry, lengths: FloatArray) -> tuple[FloatArray, ...]:
    """Return R, o and the b_i (N, ...) of the physical state of a drawn machine with leg lengths (N, 6)."""
    from spm_pin.kinematics.kernels.mode_kernels import home_modes

    results = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64)
    return run_kernel(home_modes, (lengths,), radii(geometry), results, _MIN_BATCH_PER_THREAD_PHYSICAL)


def _solve_ill_conditioned(geometry: Geometry, lengths: FloatArray, solved: tuple[Any, ...]) -> None:
    """Solve problems again, with more digits, of which a stage is near a continuous family or has a very short leg."""
    rotation, translation, joints, dimension, status = solved
    r, *hips = radii(geometry)
    halves = lengths[:, :3], lengths[:, 3:]
    doubtful = np.zeros(len(lengths), dtype=np.bool_)
    for half, hip in zip(halves, hips, strict=True):
        doubtful |= _is_ill_conditioned(half / r, hip / r)
    at = np.flatnonzero(doubtful & (dimension.max(axis=-1) == 0))
    if not len(at):
        return
    from spm_pin.kinematics.ill_conditioned_stages import solve_stage_with_more_digits
    from spm_pin.kinematics.kernels.mode_kernels import compose_all

    for n in at:
        lower, upper = (
            solve_stage_with_more_digits(half[n], hip, geometry.middle_side, sign)
            for half, hip, sign in zip(halves, hips, (1.0, -1.0), strict=True)
        )
        pairs = np.repeat(lower, len(STAGE_MODES), axis=0), np.tile(upper, (len(STAGE_MODES), 1))
        compose_all(*pairs, r, rotation[n], translation[n], joints[n])
        status[n] = Status.UNREACHABLE if np.isnan(joints[n]).all() else Status.OK


def _is_ill_conditioned(lengths: FloatArray, epsilon: float) -> BoolArray:
    """Return whether double precision may miscount the modes of stages (N, 3), lengths and hips ε in units of r."""
    squares = lengths**2
    scale = squares.mean(axis=-1) + (1.0 + epsilon) ** 2
    odd, even = 9.0 * epsilon**2, 3.0 - 3.0 * epsilon**2
    away = [np.abs(squares - np.roll([odd, even, even], k)).max(axis=-1) for k in range(3)]
    near = (np.minimum.reduce(away) <= _NEAR * scale) & (epsilon < 1.0 + _NEAR)
    equal = np.ptp(squares, axis=-1) <= _NEAR * scale
    near_half = equal & (abs(2.0 * epsilon - 1.0) <= _NEAR)
    return np.asarray(near | near_half | (lengths.min(axis=-1) < _SHORT))
