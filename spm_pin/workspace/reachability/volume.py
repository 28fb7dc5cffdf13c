"""How large the reachable set is, in two ways each, and how much of it the paper's shell leaves out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry, LegLimits
from spm_pin.workspace.reachability.boundary import Boundary, reachable_boundary
from spm_pin.workspace.reachability.estimate import Estimate, check_confidence, check_count, from_hits, from_mean
from spm_pin.workspace.reachability.leg_box import LegBox, leg_box
from spm_pin.workspace.reachability.membership import pose_density
from spm_pin.workspace.reachability.nearest import RESOLUTION, Progress, nearest_in_box

if TYPE_CHECKING:
    from spm_pin.workspace.table_6.shell import Shell

__all__ = ["ShellComparison", "compare_with_shell", "pose_volume", "reachable_volume"]

_TRIES = 5
_CELLS = 12
_PORTION = 10_000


def reachable_volume(
    geometry: Geometry,
    limits: LegLimits | None = None,
    *,
    method: Literal["sampling", "mesh"] = "sampling",
    samples: int = 20_000,
    spacing: float = 0.1,
    confidence: float = 0.95,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the volume of the positions that o can reach in the mode of a real machine.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    method : str
        "sampling": the share of uniform points that are reachable, with Clopper and Pearson's interval. "mesh": what
        `reachable_boundary` encloses at `spacing` and at half of it, extrapolated; as error counts what the
        extrapolation adds, and the interval has no confidence.
    samples : int
        Points for "sampling".
    spacing : float
        Of the coarser grid for "mesh" [m].
    confidence : float
        Of the interval, for "sampling".
    rng : Generator or int, optional
        Source of randomness, or its seed.
    progress : callable, optional
        Called with what is being done, how many points are done, and of how many. What it raises ends the work.

    Returns
    -------
    Estimate
        In m³.

    Raises
    ------
    ArgumentError
        As for `reachable_boundary`; or if another argument is not as above.
    """
    check_confidence(confidence)
    if method == "mesh":
        coarse = reachable_boundary(geometry, limits, spacing=spacing, progress=progress)
        fine = reachable_boundary(geometry, limits, spacing=0.5 * spacing, progress=progress)
        # A mesh with vertices on a surface is off by the square of its spacing.
        added = (fine.volume - coarse.volume) / 3.0
        value, error = fine.volume + added, abs(added)
        how = f"meshes of spacing {spacing:g} and {0.5 * spacing:g} m, extrapolated"
        return Estimate(value, value - error, value + error, float("nan"), len(fine.vertices), how, "m³")
    if method != "sampling":
        raise ArgumentError("method", '"sampling" or "mesh"', repr(method))
    box = leg_box(geometry, limits)
    points, region = _points_around(box, check_count(samples, "samples"), np.random.default_rng(rng))
    hits = int(_reached(box, points, progress).sum())
    return from_hits(hits, samples, region, confidence, "share of uniform points", "m³")


def _points_around(box: LegBox, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """Draw points (count, 3) [m] uniformly from a region that holds the reachable set; and its volume [m³].

    The region is made of the cells of a grid whose centre is not farther from the set than its own corners.
    """
    low, high = box.positions.min(axis=0), box.positions.max(axis=0)
    # The sample that these come from has no point at the very ends.
    low, high = low - 0.1 * (high - low), high + 0.1 * (high - low)
    size = (high - low) / _CELLS
    index = np.indices((_CELLS,) * 3).reshape(3, -1).T
    distance = nearest_in_box(box, low + (index + 0.5) * size, tries=_TRIES).distance
    cells = index[distance <= 0.5 * np.linalg.norm(size)]
    points = low + (cells[rng.integers(len(cells), size=count)] + rng.uniform(size=(count, 3))) * size
    return points, float(len(cells) * size.prod())


def _reached(box: LegBox, points: FloatArray, progress: Progress | None) -> npt.NDArray[np.bool_]:
    reached = np.empty(len(points), dtype=bool)
    for begin in range(0, len(points), _PORTION):
        if progress is not None:
            progress("reachable points", begin, len(points))
        part = slice(begin, begin + _PORTION)
        reached[part] = nearest_in_box(box, points[part], tries=_TRIES).distance <= RESOLUTION * box.size
    if progress is not None:
        progress("reachable points", len(points), len(points))
    return reached


def pose_volume(
    geometry: Geometry,
    limits: LegLimits | None = None,
    *,
    samples: int = 100_000,
    confidence: float = 0.95,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the volume of the reachable poses, of positions times rotations.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    samples : int
        Sets of leg lengths.
    confidence : float
        Of the interval, Student's.
    rng : Generator or int, optional
        Source of randomness, or its seed.
    progress : callable, optional
        Called with what is being done, how many samples are done, and of how many.

    Returns
    -------
    Estimate
        In m³ rad³. All rotations together measure 8π² rad³.

    Raises
    ------
    ArgumentError
        As for `reachable_volume`.

    Notes
    -----
    The integral of |det ∂(o, R)/∂l| over the leg lengths l, each set of lengths counted by one over how many lead to
    its pose.
    """
    confidence = check_confidence(confidence)
    count = check_count(samples, "samples")
    box = leg_box(geometry, limits)
    generator = np.random.default_rng(rng)
    values = np.zeros(count)
    for begin in range(0, count, _PORTION):
        if progress is not None:
            progress("leg lengths", begin, count)
        states = forward_physical(
            geometry, generator.uniform(box.minimum, box.maximum, (min(_PORTION, count - begin), 6))
        )
        found = np.flatnonzero(states.exists)
        values[begin + found] = pose_density(states[found], box.limits)
    if progress is not None:
        progress("leg lengths", count, count)
    whole = float((box.maximum - box.minimum).prod())
    return from_mean(values, whole, confidence, "change of variables from the leg lengths", "m³ rad³")


@dataclass(frozen=True)
class ShellComparison:
    """What the paper's 24 surfaces leave out.

    Attributes
    ----------
    legs : Estimate
        Share of leg lengths, drawn uniformly within the limits, that put o outside the shell.
    volume : Estimate
        Share of the reachable volume that is outside the shell.
    area : Estimate
        Share of the area of the reachable set's boundary that is on none of the 24 surfaces.
    farthest : float
        The farthest that o was found outside [m], of the sets of lengths drawn.
    """

    legs: Estimate
    volume: Estimate
    area: Estimate
    farthest: float


def compare_with_shell(
    shell: Shell,
    *,
    boundary: Boundary | None = None,
    samples: int = 20_000,
    confidence: float = 0.95,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> ShellComparison:
    """Estimate how much of the reachable set, and of its boundary, the paper's surfaces leave out.

    Parameters
    ----------
    shell : Shell
        Of `workspace_shell`.
    boundary : Boundary, optional
        Of the same geometry and limits; made with a spacing of 0.1 m if not given.
    samples : int
        Sets of leg lengths, and points for the volume. A tenth of it are drawn from the boundary.
    confidence, rng, progress
        As for `reachable_volume`.

    Notes
    -----
    A point of the boundary is on a surface if the four legs that do not vary there are at their limits.
    """
    check_confidence(confidence)
    count = check_count(samples, "samples", 20)
    generator = np.random.default_rng(rng)
    geometry, limits = shell.geometry, shell.limits
    box = leg_box(geometry, limits)
    boundary = boundary or reachable_boundary(geometry, limits, progress=progress)
    if (boundary.geometry, boundary.limits) != (geometry, limits):
        raise ArgumentError("boundary", "that of the shell's geometry and limits", repr(boundary))

    positions = forward_physical(geometry, generator.uniform(box.minimum, box.maximum, (count, 6))).translation
    positions = positions[np.isfinite(positions[:, 0])]
    outside = positions[~shell.contains(positions)]
    legs = from_hits(len(outside), len(positions), 1.0, confidence, "uniform leg lengths", "")
    farthest = float(-shell.distance(outside).min()) if len(outside) else 0.0

    points, _ = _points_around(box, count, generator)
    points = points[_reached(box, points, progress)]
    missed = int(np.count_nonzero(~shell.contains(points)))
    volume = from_hits(missed, len(points), 1.0, confidence, "uniform reachable points", "")

    drawn = boundary.sample(count // 10, generator)
    surfaces = np.array(
        [[{"min": -1, "max": 1}.get(leg.value, 0) for leg in patch.settings] for patch in shell.patches]
    )
    on_surface = ((surfaces == 0) | (surfaces == drawn.at_limit[:, None, :])).all(axis=-1).any(axis=-1)
    area = from_hits(int(np.count_nonzero(~on_surface)), count // 10, 1.0, confidence, "points of the boundary", "")
    return ShellComparison(legs, volume, area, farthest)
