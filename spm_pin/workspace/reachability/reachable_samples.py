"""Random reachable states: uniform in the leg lengths, uniform in the poses, or with many legs at their limits."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism import Configuration, Geometry, LegLimits
from spm_pin.mechanism.arguments import FloatArray, IntArray, Progress, choice, generator, whole_number
from spm_pin.mechanism.branches import physical
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox, leg_length_box

_PORTION = 20_000
"""States drawn together, at most."""
_MOST_PORTIONS = 1000
"""Portions that are drawn at most."""
_AT_A_LIMIT = 0.35
"""Share of the legs that `sample_positions_near_limits` draws at a limit."""


def sample_reachable(
    geometry: Geometry,
    count: int,
    limits: LegLimits | None = None,
    *,
    space: Literal["legs", "poses"] = "legs",
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Configuration:
    """Draw physical states.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    count : int
        How many.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    space : str
        "legs": uniform in the leg lengths that belong to a configuration. "poses": uniform in the reachable poses, with
        the volume of positions times the uniform measure of rotations.
    rng : Generator or int, optional
        Source of randomness, or its seed.
    progress : callable, optional
        Called with what is being done, how many states are found, and of how many.

    Returns
    -------
    Configuration
        Of shape (count,).

    Raises
    ------
    ArgumentError
        As for `reachable_position`; or if `count` or `space` is none of the above.

    Notes
    -----
    Both stages are drawn independently. For poses, their coordinates c are drawn uniformly, see
    `spm_pin.workspace.reachability.position_map`, and states kept in proportion to |det ∂(o, R)/∂c|, which is how much
    of pose space they stand for, divided by the number of states with the same pose. The largest value is taken from
    what has been drawn; all is drawn again whenever a larger one comes up.
    """
    count = whole_number(count, "count")
    choice(space, "space", ("legs", "poses"))
    box, rng = leg_length_box(geometry, limits), generator(rng)
    parts, largest, kept = [np.empty((0, 2, 3))], 0.0, 0
    for _ in range(_MOST_PORTIONS):
        if progress is not None:
            progress("reachable states", min(kept, count), count)
        if kept >= count:
            break
        number = min(max(4 * count, 64), _PORTION)
        if space == "legs":
            parts.append(_uniform_in_legs(box, number, rng))
        else:
            coordinates, _ = box.draw(number, rng)
            density = pose_weights(box, coordinates)
            if density.max() > largest:
                # A bound that a later sample will hardly exceed.
                parts, largest = [parts[0]], 1.2 * float(density.max())
            parts.append(coordinates[rng.uniform(size=number) * largest < density])
        kept = sum(len(part) for part in parts)
    else:
        raise ArgumentError("limits", "limits within which states are not too rare to be drawn", f"{kept} of {count}")
    return box.map.states(np.concatenate(parts)[:count])


def _uniform_in_legs(box: LegLengthBox, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw `count` sets of leg lengths uniformly; return the coordinates of the states among them, (n, 2, 3).

    The legs of one stage say nothing about the other stage's: each stage is drawn by itself.
    """
    lengths = rng.uniform(box.minimum, box.maximum, (count, 6))
    known = box.map.lengths(box.draw(1, np.random.default_rng(0))[0])[0]
    halves = []
    for k in range(2):
        legs = np.tile(known, (count, 1))
        legs[:, 3 * k : 3 * k + 3] = lengths[:, 3 * k : 3 * k + 3]
        states = forward_physical(box.geometry, legs)
        halves.append(box.map.coordinates(states[states.exists])[:, k])
    number = min(len(half) for half in halves)
    return np.stack([half[:number] for half in halves], axis=1)


def pose_weights(box: LegLengthBox, coordinates: FloatArray) -> FloatArray:
    """Return the volume of poses per volume of `coordinates` (N, 2, 3), each pose counted once, (N,) [m³ rad³]."""
    return box.map.pose_densities(coordinates) / pose_multiplicity(box.map.states(coordinates), box.limits)


def pose_multiplicity(states: Configuration, limits: LegLimits) -> IntArray:
    """Return how many physical states within `limits` have the pose of each of `states` (N,), (N,)."""
    branches = inverse_displacement(states.geometry, states.pose).configurations
    # A state at a limit may miss it by rounding: it counts itself at least.
    same = (physical(branches) & limits.contains(branches.readings)).sum(axis=-1)
    return np.asarray(np.maximum(same, 1), dtype=np.intp)


def sample_positions_near_limits(
    geometry: Geometry, limits: LegLimits, *, count: int = 200_000, seed: int = 0
) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Draw leg lengths at limits or near them; return positions of o (N, 3) [m] and the sign of det K (N,) there.

    Drawn evenly, leg lengths seldom put the platform near the boundary of what it can reach. Of `count` sets of leg
    lengths within positive and finite limits. If the limits are the same for the legs of a stage, each gives six
    positions: it stands for its images under the symmetries of the machine as well.
    """
    low, high = np.array(limits.minimum), np.array(limits.maximum)
    rng = np.random.default_rng(seed)
    share = np.sin(0.5 * np.pi * rng.random((count, 6))) ** 2
    share = np.where(rng.random(share.shape) < _AT_A_LIMIT, share.round(), share)
    states = forward_physical(geometry, (1.0 - share) * low + share * high)
    states = states[states.exists]
    positions, aspect = states.translation, np.sign(determinants(states)[:, 2]).astype(np.int8)
    if all(len(set(ends)) == 1 for ends in (low[:3], low[3:], high[:3], high[3:])):
        positions, aspect = _images(positions, aspect)
    return positions, aspect


def _images(positions: FloatArray, aspect: npt.NDArray[np.int8]) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Return all positions turned by 0, 120 and 240 degrees, and mirrored; a mirror changes the sign of det K."""
    mirrored = positions * [-1.0, 1.0, 1.0]
    both, signs = np.concatenate([positions, mirrored]), np.concatenate([aspect, -aspect])
    turns = Rotation.from_euler("z", [[0.0], [120.0], [240.0]], degrees=True)
    return np.concatenate([turn.apply(both) for turn in turns]), np.tile(signs, 3)
