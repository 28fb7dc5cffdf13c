"""Random reachable states: uniform in the leg lengths, uniform in the poses, or with many legs at their limits."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism import Configuration, Geometry, LegLimits
from spm_pin.mechanism.arguments import FloatArray, Progress, choice, generator, whole_number
from spm_pin.workspace.states import pose_densities, states_within

_CHUNK, _MOST_CHUNKS = 20_000, 1000
"""States drawn together at most, and how often."""
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
        "legs": uniform in the readings that belong to a configuration. "poses": uniform in the reachable poses, with
        the volume of positions times the uniform measure of rotations.
    rng : Generator or int, optional
        Source of randomness, or its seed.
    progress : callable, optional
        Called with what is being done, how many states are found, and of how many.

    Returns
    -------
    Configuration
        Of shape (count,).

    Notes
    -----
    For poses, coordinates c of the stages are drawn uniformly and states kept in proportion to |det ∂(o, R)/∂c| over
    the number of states with the same pose. The largest value is taken from what has been drawn; all is drawn again
    whenever a larger one comes up.
    """
    count = whole_number(count, "count")
    choice(space, "space", ("legs", "poses"))
    states, rng = states_within(geometry, limits), generator(rng)
    parts, largest, kept = [np.empty((0, 2, 3))], 0.0, 0
    for _ in range(_MOST_CHUNKS):
        if progress is not None:
            progress("reachable states", min(kept, count), count)
        if kept >= count:
            break
        number = min(max(4 * count, 64), _CHUNK)
        if space == "legs":
            parts.append(states.draw_in_readings(number, rng))
        else:
            coordinates = states.draw(number, rng)
            density = pose_densities(states, coordinates)
            if density.max() > largest:
                # A bound that a later sample will hardly exceed.
                parts, largest = [parts[0]], 1.2 * float(density.max())
            parts.append(coordinates[rng.uniform(size=number) * largest < density])
        kept = sum(len(part) for part in parts)
    else:
        raise ArgumentError("limits", "limits within which states are not too rare to be drawn", f"{kept} of {count}")
    return states.states(np.concatenate(parts)[:count])


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
