"""Forward displacement of a machine as built: each stage is followed from the nominal machine, or from a seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.batches import flat_batch, run_kernel, with_batch_shape
from spm_pin.kinematics.forward_displacement_arguments import check_seed, read_leg_lengths
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.ball_triangles import triangle_frames, triangle_sides
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

_MIN_BATCH_PER_THREAD = 1 << 11


def as_built_forward(
    geometry: Geometry,
    leg_lengths: npt.ArrayLike,
    seed: Configuration | None,
    solve_nominal: Callable[[Geometry, FloatArray], Configuration],
) -> Configuration:
    """Find the configuration that a machine as built with these readings is in; see `forward_physical`.

    Without a seed, the state of the nominal machine with the same distances from pivots to balls is followed while the
    dimensions change to those of this machine, or, where that gives none, the level state with equal legs is followed
    to the given legs. `solve_nominal` is `forward_physical` of nominal machines.
    """
    lengths = read_leg_lengths(geometry, leg_lengths)
    if seed is not None:
        check_seed(geometry, lengths, seed)
        shape = np.broadcast_shapes(lengths.shape[:-1], seed.shape)
        rotation, position = seed.rotation[..., None, :, :], seed.translation[..., None, :]
        upper = ((seed.balls[..., 3:, :] - position)[..., None, :] @ rotation)[..., 0, :]
        balls = np.concatenate([seed.balls[..., :3, :], upper], axis=-2)
        legs = [flat_batch(x, shape, 1) for x in (seed.leg_lengths, lengths)]
        return _compose(geometry, _follow(geometry, geometry, flat_batch(balls, shape, 2), *legs), shape)
    shape, lengths = lengths.shape[:-1], lengths.reshape(-1, 6)
    nominal = geometry.nominal
    start = solve_nominal(geometry.nominal, lengths)
    upper = (start.middle_joints - start.translation[:, None]) @ start.rotation
    balls = _follow(nominal, geometry, np.concatenate([start.middle_joints, upper], axis=1), lengths, lengths)
    found = physical(_compose(geometry, balls, (len(lengths),)))
    rest = np.flatnonzero(~found)
    if len(rest):
        balls[rest] = _follow_from_home(nominal, geometry, lengths[rest])
        found[rest] = physical(_compose(geometry, balls[rest], (len(rest),)))
        balls[~found] = np.nan
    return _compose(geometry, balls, shape)


def _follow(
    start: Geometry, end: Geometry, balls: FloatArray, start_lengths: FloatArray, end_lengths: FloatArray
) -> FloatArray:
    """Follow states to other dimensions and lengths (N, 6); balls (N, 6, 3), the lower in {B}, the upper in {m}."""
    from spm_pin.kinematics.kernels.ball_circles import follow_circles

    unit, found = end.nominal.middle_radius, np.empty_like(balls)
    for stage in (slice(3), slice(3, 6)):
        machines = [np.stack([g.legs.axes[stage], g.legs.pivots[stage] / unit]) for g in (start, end)]
        sides = [triangle_sides(g.legs.balls[stage]) / unit for g in (start, end)]
        inputs = balls[:, stage] / unit, start_lengths[:, stage] / unit, end_lengths[:, stage] / unit
        results = ((3, 3), np.float64), ((), np.bool_)
        moved, _ = run_kernel(follow_circles, inputs, (*machines, *sides), results, _MIN_BATCH_PER_THREAD)
        found[:, stage] = moved * unit
    found[np.isnan(found).any(axis=(-1, -2))] = np.nan
    return found


def _follow_from_home(nominal: Geometry, geometry: Geometry, lengths: FloatArray) -> FloatArray:
    """Follow the level state with equal legs to legs (N, 6); return its balls as `_follow` does."""
    dimensions = geometry.nominal
    hips = np.array([dimensions.base_radius, dimensions.platform_radius]) - dimensions.middle_radius
    # Legs at least so long that the level stage is well away from flat.
    equal = np.maximum(lengths.reshape(-1, 2, 3).mean(axis=-1), np.hypot(1.0, 0.5) * np.abs(hips))
    height = np.sqrt(np.maximum(equal**2 - hips**2, 0.0))
    level = dimensions.middle_radius * dimensions.radial_directions
    balls = np.concatenate([np.broadcast_to(level, (len(lengths), 3, 3))] * 2, axis=1)
    balls[..., 2] = np.repeat(height * [1.0, -1.0], 3, axis=-1)
    legs = np.repeat(equal, 3, axis=-1)
    return _follow(geometry, geometry, _follow(nominal, geometry, balls, legs, legs), legs, lengths)


def _compose(geometry: Geometry, balls: FloatArray, shape: tuple[int, ...]) -> Configuration:
    """Return the states of shape (...) in which {n} is where balls (N, 6, 3) are, seen from {B} and from {m}."""
    local, placed = geometry.legs.balls.reshape(2, 3, 3), balls.reshape(-1, 2, 3, 3)
    turns = triangle_frames(placed) @ np.swapaxes(triangle_frames(local), -1, -2)
    places = placed.mean(axis=-2) - (turns @ local.mean(axis=-2)[..., None])[..., 0]
    rotation = turns[:, 0] @ np.swapaxes(turns[:, 1], -1, -2)
    translation = places[:, 0] - (rotation @ places[:, 1, :, None])[..., 0]
    state = rotation, translation, np.ascontiguousarray(balls[:, :3])
    return Configuration.from_arrays(geometry, *with_batch_shape(state, shape))
