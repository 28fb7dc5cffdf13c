"""Random reachable states, uniform in the leg lengths or in the poses."""

from __future__ import annotations

from typing import Literal

import numpy as np

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Configuration, Geometry, LegLimits
from spm_pin.mechanism.arguments import FloatArray, IntArray, Progress, choice, generator, whole_number
from spm_pin.mechanism.branches import physical
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox, leg_length_box

__all__ = ["pose_multiplicity", "pose_weights", "sample_reachable"]

_PORTION = 20_000
"""States drawn together, at most."""
_MOST_PORTIONS = 1000
"""Portions that are drawn at most."""


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
    same = (physical(branches) & limits.contains(branches.leg_lengths)).sum(axis=-1)
    return np.asarray(np.maximum(same, 1), dtype=np.intp)
