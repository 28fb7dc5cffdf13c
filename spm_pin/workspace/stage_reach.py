"""The reach of a stage: heights of the level platform, tilts in every direction, and the nearest tilt to one.

A state counts if it is physical (mode T, in the home assembly region) and within the stage's limits. A tilt is the
largest such that all smaller tilts in the same direction are reachable.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, UnreachableError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.singularity_analysis import singularities
from spm_pin.kinematics.stage_displacement import (
    inverse,
    inverse_physical,
    normals_of_tilt,
    poses,
    read_heights,
)
from spm_pin.machine.configuration import Condition, Configuration, check_condition
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, whole_number

_STEP = math.radians(0.5)
"""Step of the tilts that are tried [rad]: gaps narrower than this step are missed."""
_LARGEST_TILT = math.pi / 2.0
_HEIGHTS, _HIGHEST = 2000, 9.99
"""Number of heights that are tried, and the highest in units of the stage's size: higher ones are in another unit."""
_PARTS, _ROUNDS, _FEW = np.linspace(0.0, 1.0, 17), 11, 5
"""Number of parts and rounds in which an interval is divided: to 6e-14 of it, or with few rounds to 1e-6."""
_MOST_DIRECTIONS = 10_000
_REGULAR = 1e-6
"""Least distance to singularities of a home, see `StageSingularities`: closer to one, its digits are lost."""
_BESIDE = 1e-6
"""Distance beyond the end of the reach at which its cause is determined [rad]."""


class ReachEnd(enum.IntEnum):
    """Reason why a stage tilts no farther."""

    NOT_LEVEL = 0
    """The level platform is out of reach at this height."""
    LIMIT = 1
    """A reading is at its limit, or a condition that was given ends."""
    LEG = 2
    """A ball is out of a leg's reach: crank and rod in line, or the rod perpendicular to its slide."""
    FORWARD = 3
    """A forward singularity, where the platform can move with locked actuators."""
    PLANES = 4
    """The planes of the legs allow no platform with this normal; both modes meet there."""
    NONE = 5
    """No end: it tilts by a right angle at least."""

    def __str__(self) -> str:
        return {0: "not level", 1: "limit", 2: "leg's reach", 3: "forward singularity", 4: "planes", 5: "none"}[self]


@dataclass(frozen=True, repr=False)
class StageReach:
    """Largest tilts of a stage, by height and azimuth."""

    stage: Stage
    heights: FloatArray
    """Heights of the platform's origin [m], shape (n,)."""
    azimuths: FloatArray
    """Azimuths of the normal, evenly spaced from -π [rad], shape (m,)."""
    tilts: FloatArray
    """Largest tilts [rad], to π/2, shape (n, m); NaN if the level platform is out of reach."""
    ends: npt.NDArray[np.int8]
    """`ReachEnd` of each, shape (n, m)."""

    def __repr__(self) -> str:
        level, ends = np.isfinite(self.all_round), ", ".join(str(ReachEnd(end)) for end in np.unique(self.ends))
        if not level.any():
            return f"<StageReach: {len(self.heights)} heights, level at none>"
        best = int(np.nanargmax(self.all_round))
        most = f"{np.degrees(self.all_round[best]):.1f}° in every direction at {self.heights[best]:.4g} m"
        return f"<StageReach: {len(self.heights)} heights, {most}; what ends tilts: {ends}>"

    @property
    def all_round(self) -> FloatArray:
        """Largest tilt that is reached in every direction [rad], shape (n,); NaN if missing."""
        return np.asarray(self.tilts.min(axis=-1))


def height_range(stage: Stage) -> tuple[float, float]:
    """Return the heights [m] between which a stage can be level, in its physical state and within its limits.

    Parameters
    ----------
    stage : Stage
        The stage. Without limits the highest of an RPS stage is about ten times its size.

    Returns
    -------
    lowest, highest : float
        Heights of the platform's origin above the pivots: the widest of several such ranges, NaN if there is no range.
    """
    return _height_range(check_instance(stage, Stage, "stage"))


@lru_cache(maxsize=16)
def _height_range(stage: Stage) -> tuple[float, float]:
    top = (_HIGHEST if stage.unit == "m" and stage.limits is None else 1.0) * stage.size
    if stage.unit == "m":
        ends = np.abs(stage.reading_limits - stage.legs.offsets)
        top = min(top + float(ends.max(initial=0.0, where=np.isfinite(ends))), _HIGHEST * stage.size)
    grid = np.linspace(-top, top, _HEIGHTS)
    # Narrow limits may lie between two of these heights, but rarely exclude the state in their middle.
    if (middle := _middle_state(stage)).exists:
        grid = np.union1d(grid, middle.height)

    def counts(heights: FloatArray) -> BoolArray:
        return _counts(inverse_physical(stage, heights))

    good = counts(grid)
    # The ranges' ends between the heights tried: one state that counts, one that does not.
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    if not len(edges):
        return math.nan, math.nan
    first, last = edges[::2], edges[1::2] - 1
    widest = int((last - first).argmax())
    low, high = int(first[widest]), int(last[widest])
    lowest = grid[low] if low == 0 else _last_good(counts, grid[low : low + 1], grid[low - 1 : low])
    beyond = grid[high + 1 : high + 2]
    highest = grid[high] if not len(beyond) else _last_good(counts, grid[high : high + 1], beyond)
    return float(np.squeeze(lowest)), float(np.squeeze(highest))


def home_height(stage: Stage) -> float:
    """Return a height [m] at which a stage is level within its limits.

    There readings are in the middle of their limits, and where these have none cranks are level, carriages at their
    pivots. If that is no state, or a singular one, it is the middle of `height_range`; where that is empty an
    `UnreachableError` is raised.
    """
    state = _middle_state(check_instance(stage, Stage, "stage"))
    if state.exists and _counts(inverse_physical(stage, state.height)):
        distances = singularities(state)
        if min(float(distances.forward), float(distances.leg.min())) > _REGULAR:
            return float(state.height)
    height = sum(height_range(stage)) / 2.0
    if math.isnan(height):
        expected = "one that is level at some height within its limits"
        raise UnreachableError("stage", expected, repr(stage), "Are the limits for other legs, or in degrees?")
    return height


def _middle_state(stage: Stage) -> Configuration:
    """Return the physical state with readings in the middle of their limits, or usual readings without limits."""
    limits = stage.reading_limits
    is_limited = np.isfinite(limits).all(axis=0)
    radii = stage.base_radius, stage.platform_radius
    usual = math.hypot(radii[0] - radii[1], radii[0] + radii[1]) if stage.kind.name == "RPS" else 0.0
    middle = 0.5 * np.where(is_limited, limits, 0.0).sum(axis=0)
    return forward_physical(stage, np.where(is_limited, middle, usual + stage.legs.offsets))


def reach(
    stage: Stage, heights: npt.ArrayLike | None = None, *, directions: int = 72, where: Condition | None = None
) -> StageReach:
    """Find the largest tilts of a stage in every direction, at one height or several.

    Parameters
    ----------
    stage : Stage
        The stage, with its limits.
    heights : array_like, shape () or (n,), optional
        Heights of the platform's origin above the pivots [m]; by default nine within `height_range`.
    directions : int
        Number of azimuths, 1 to 10,000.
    where : callable, optional
        Takes states (n,) and returns which of them count besides, (n,): `spm_pin.workspace.JointLimits` of balls and
        hinges, or a bound of a metric, as `spm_pin.sweeps.condition` makes it.

    Returns
    -------
    StageReach
        Largest tilts to 1e-12 rad, and the reason why they end. States are tried every half degree up to a right angle.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> balancer = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))
    >>> np.degrees(spm.workspace.reach(balancer, 0.12).all_round).round(2)
    array([22.88])
    """
    check_instance(stage, Stage, "stage")
    count = whole_number(directions, "directions", least=1, most=_MOST_DIRECTIONS)
    if heights is None:
        low, high = height_range(stage)
        if math.isnan(low):
            expected = "a stage that is level at some height"
            cause = "Are the limits for other readings? nearest_reachable_pose finds tilted states within them"
            raise ArgumentError("stage", expected, stage, cause)
        levels = np.linspace(low, high, 11)[1:-1]
    else:
        levels = np.atleast_1d(read_heights(stage, heights, "heights"))
    if levels.ndim > 1:
        raise ArgumentError("heights", "a height, or several of shape (n,)", f"shape {levels.shape}")
    azimuths = -math.pi + 2.0 * math.pi * np.arange(count) / count
    tilts = _largest_tilts(stage, levels[:, None], azimuths, where=where)
    return StageReach(stage, levels, azimuths, tilts, _ends(stage, levels[:, None], azimuths, tilts))


def best_height(stage: Stage, *, directions: int = 72, where: Condition | None = None) -> tuple[float, float]:
    """Return the height [m] at which a stage tilts farthest in every direction, and that tilt [rad].

    Parameters
    ----------
    stage, directions, where
        As for `reach`.

    Returns
    -------
    height, tilt : float
        The best of 17 heights within `height_range`, and of ever more about it, to 1e-4 of that range; NaN if the
        platform is nowhere level.
    """
    low, high = height_range(stage)
    best, tilt, width = 0.5 * (low + high), math.nan, high - low
    while width > 1e-4 * (high - low):
        heights = np.clip(best + width * np.linspace(-0.5, 0.5, 17), low, high)
        tilts = reach(stage, heights, directions=directions, where=where).all_round
        best, tilt, width = float(heights[np.nanargmax(tilts)]), float(np.nanmax(tilts)), width / 6.0
    return best, tilt


def nearest_tilt(stage: Stage, height: float, target: FloatArray, where: Condition | None = None) -> Configuration:
    """Return the physical state within the limits whose normal is nearest to a `target` (3,) at a height.

    See `spm_pin.workspace.nearest_reachable_pose`.
    """
    wanted = inverse_physical(stage, height, normal=target)
    if wanted.shape:
        expected = "a single state, given by a height with tilt and azimuth, roll and pitch, or a normal"
        raise ArgumentError("height", expected, f"a batch of shape {wanted.shape}")
    if _counts(wanted, where):
        return wanted
    level = float(height)
    if not _counts(inverse_physical(stage, level), where):
        if (found := _nearest_of_all(stage, level, target, where)).exists:
            return found
        low, high = height_range(stage)
        if math.isnan(low):
            middle = _middle_state(stage)
            return _nearest_of_all(stage, float(middle.height), target, where) if middle.exists else found
        level = float(np.clip(height, low, high))
        if not _counts(inverse_physical(stage, level), where):
            return _nearest_of_all(stage, level, target, where)
    azimuths, width = np.linspace(-math.pi, math.pi, 91), math.pi / 45.0
    for _ in range(5):
        ends = _largest_tilts(stage, np.array([level]), azimuths, _FEW, where)
        # In each direction the tilt nearest to the wanted one is its projection, or the end.
        along = np.arctan2(np.cos(azimuths) * target[0] + np.sin(azimuths) * target[1], target[2])
        tilts = np.clip(along, 0.0, ends)
        normals = normals_of_tilt(tilts, azimuths)
        angles = np.arctan2(np.linalg.norm(np.cross(normals, target), axis=-1), normals @ target)
        best = int(angles.argmin())
        azimuths, width = azimuths[best] + np.linspace(-width, width, 41), width / 15.0
    return inverse_physical(stage, level, normal=normals[best])


def _nearest_of_all(stage: Stage, height: float, target: FloatArray, where: Condition | None) -> Configuration:
    """Return the state at a height that counts whose normal is nearest to the target, even if level ones do not count.

    Normals are tried along great circles from the target.
    """
    across = np.linalg.svd(target[None])[2][1:]
    grid = np.linspace(0.0, math.pi, round(math.pi / _STEP) + 1)
    best, bearings, width = target, np.linspace(-math.pi, math.pi, 91), math.pi / 45.0
    for _ in range(5):
        sideways = np.cos(bearings)[:, None, None] * across[0] + np.sin(bearings)[:, None, None] * across[1]

        def normals(angles: FloatArray, sideways: FloatArray = sideways) -> FloatArray:
            return np.asarray(np.cos(angles)[..., None] * target + np.sin(angles)[..., None] * sideways)

        def counts(angles: FloatArray, normals: Callable[[FloatArray], FloatArray] = normals) -> BoolArray:
            return _counts(inverse_physical(stage, height, normal=normals(angles)), where)

        good = counts(np.broadcast_to(grid, (len(bearings), len(grid))))
        if not good.any():
            break
        first = good.argmax(axis=-1)[:, None]
        angles = _last_good(counts, grid[first], grid[np.maximum(first - 1, 0)], _FEW)
        place = int(np.where(good.any(axis=-1), angles[:, 0], np.inf).argmin())
        best = normals(angles)[place, 0]
        bearings, width = bearings[place] + np.linspace(-width, width, 41), width / 15.0
    state = inverse_physical(stage, height, normal=best)
    if _counts(state, where):
        return state
    nothing = state.where(np.array(False))
    nothing.missing_reason = f"no state at the height {height:.4g} m is found within the limits"
    return nothing


def _counts(state: Configuration, where: Condition | None = None) -> BoolArray:
    """Return which states are physical, within the limits, and satisfy a condition."""
    good = np.asarray(state.exists & (state.limit_excess == 0.0).all(axis=-1))
    if where is not None:
        batch, mask = state if state.shape else state.transformed(lambda array, _: array[None]), np.atleast_1d(good)
        mask[mask] = check_condition(where, batch[mask])
    return good


def _last_good(
    counts: Callable[[FloatArray], BoolArray], good: FloatArray, bad: FloatArray, rounds: int = _ROUNDS
) -> FloatArray:
    """Return the last numbers (..., 1) that satisfy `counts`, between `good`, which do, and `bad`, which do not."""
    for _ in range(rounds):
        parts = good + (bad - good) * _PARTS
        inside = counts(parts)
        inside[..., 0], inside[..., -1] = True, False
        first_bad = inside.argmin(axis=-1)[..., None]
        good, bad = (np.take_along_axis(parts, place, axis=-1) for place in (first_bad - 1, first_bad))
    return good


def _largest_tilts(
    stage: Stage,
    heights: FloatArray,
    azimuths: FloatArray,
    rounds: int = _ROUNDS,
    where: Condition | None = None,
) -> FloatArray:
    """Return the largest tilts at heights and azimuths that broadcast, NaN where not even level."""
    shape = np.broadcast_shapes(heights.shape, azimuths.shape)
    heights, azimuths = np.broadcast_to(heights, shape), np.broadcast_to(azimuths, shape)

    def counts(tilts: FloatArray) -> BoolArray:
        return _counts(inverse_physical(stage, heights[..., None], tilt=tilts, azimuth=azimuths[..., None]), where)

    grid = np.linspace(0.0, _LARGEST_TILT, round(_LARGEST_TILT / _STEP) + 1)
    good = counts(grid)
    last = np.where(good.all(axis=-1), len(grid), good.argmin(axis=-1)) - 1
    inside = np.clip(last, 0, len(grid) - 2)[..., None]
    tilts = _last_good(counts, grid[inside], grid[inside + 1], rounds)[..., 0]
    return np.where(last == len(grid) - 1, _LARGEST_TILT, np.where(last < 0, np.nan, tilts))


def _ends(stage: Stage, heights: FloatArray, azimuths: FloatArray, tilts: FloatArray) -> npt.NDArray[np.int8]:
    """Return the reason why largest tilts end."""
    is_level, is_whole = np.isfinite(tilts), tilts == _LARGEST_TILT
    beyond = np.where(is_level & ~is_whole, tilts + _BESIDE, 0.0)
    both = inverse(stage, heights, tilt=beyond, azimuth=azimuths)
    state, physical = both["T"], both.is_physical[..., 0]
    is_limited = physical & (state.limit_excess != 0.0).any(axis=-1)
    normals, heights = normals_of_tilt(beyond, azimuths).reshape(-1, 3), np.broadcast_to(heights, tilts.shape)
    absent = np.isnan(poses(stage, normals, heights.reshape(-1), 1)[1][:, 0, 0]).reshape(tilts.shape)
    choices = {
        ReachEnd.NOT_LEVEL: ~is_level,
        ReachEnd.NONE: is_whole,
        ReachEnd.LIMIT: is_limited,
        ReachEnd.PLANES: absent,
        ReachEnd.LEG: ~state.exists,
        ReachEnd.FORWARD: ~physical,
    }
    return np.select(list(choices.values()), list(choices), ReachEnd.LIMIT).astype(np.int8)
