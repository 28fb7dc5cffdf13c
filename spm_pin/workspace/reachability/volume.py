"""Volumes of the reachable positions and poses, each by two methods, and the part outside the paper's shell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, Progress, choice, generator, instance, whole_number
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LegLimits
from spm_pin.workspace.reachability.boundary import Boundary, reachable_boundary
from spm_pin.workspace.reachability.confidence_intervals import Estimate, check_confidence, from_hits, from_mean
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox, leg_length_box
from spm_pin.workspace.reachability.membership import portions, search_states
from spm_pin.workspace.reachability.reachable_samples import pose_weights, sample_reachable
from spm_pin.workspace.table_6.shell import Shell

__all__ = ["ShellComparison", "compare_with_shell", "pose_volume", "reachable_volume"]

_PORTION = 10_000
"""States evaluated together."""


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
    """Estimate the volume of the positions that o can reach in the physical mode, in m³.

    Parameters
    ----------
    geometry, limits, progress
        As for `reachable_boundary`.
    method : str
        "sampling": the share of uniform points that are reachable, with Clopper and Pearson's interval, to which
        points are added for which the search failed. "mesh": what
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

    Raises
    ------
    ArgumentError
        As for `reachable_boundary`; or if another argument is not as above.
    """
    check_confidence(confidence)
    if choice(method, "method", ("sampling", "mesh")) == "mesh":
        coarse = reachable_boundary(geometry, limits, spacing=spacing, progress=progress)
        fine = reachable_boundary(geometry, limits, spacing=0.5 * spacing, progress=progress)
        # A mesh with vertices on a surface is off by the square of its spacing.
        added = (fine.volume - coarse.volume) / 3.0
        value, error = fine.volume + added, abs(added)
        how = f"meshes of spacing {spacing:g} and {0.5 * spacing:g} m, extrapolated"
        return Estimate(value, value - error, value + error, float("nan"), len(fine.vertices), how, "m³")
    box, rng = leg_length_box(geometry, limits), generator(rng)
    points, region = _points_around(box, whole_number(samples, "samples", least=2), rng)
    found = search_states(box, points, what="reachable points", progress=progress)
    hits, undecided = int(found.reached.sum()), int(found.undecided.sum())
    return from_hits(hits, len(points), region, confidence, "share of uniform points", "m³", undecided)


def _points_around(box: LegLengthBox, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """Draw points (count, 3) [m] uniformly from a region that holds the reachable set; and its volume [m³]."""
    corners, size = box.cells
    points = corners[rng.integers(len(corners), size=count)] + size * rng.uniform(size=(count, 3))
    return points, float(len(corners) * size.prod())


def pose_volume(
    geometry: Geometry,
    limits: LegLimits | None = None,
    *,
    samples: int = 100_000,
    confidence: float = 0.95,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the volume of the reachable poses, of positions times rotations, in m³ rad³.

    All rotations together measure 8π² rad³.

    Parameters
    ----------
    geometry, limits, rng, progress
        As for `reachable_volume`.
    samples : int
        States.
    confidence : float
        Of the interval, Student's.

    Raises
    ------
    ArgumentError
        As for `reachable_volume`.

    Notes
    -----
    The integral of |det ∂(o, R)/∂c| over the coordinates c of both stages, see
    `spm_pin.workspace.reachability.position_map`, each state counted by one over how many have its pose. In these
    coordinates the integrand is bounded; over the leg lengths it is not, towards forward singularities.
    """
    confidence = check_confidence(confidence)
    count = whole_number(samples, "samples", least=2)
    box, rng = leg_length_box(geometry, limits), generator(rng)
    parts, volumes = [], []
    for rows in portions(count, _PORTION, "states", progress):
        coordinates, volume = box.draw(rows.stop - rows.start, rng)
        parts.append(pose_weights(box, coordinates))
        volumes.append(volume)
    whole = float(np.average(volumes, weights=[len(part) for part in parts]))
    how = "change of variables from the stages' coordinates"
    # Of the size of each stage's set, of which the volume is the product.
    variance = 2.0 / count
    return from_mean(np.concatenate(parts), whole, confidence, how, "m³ rad³", variance)


@dataclass(frozen=True)
class ShellComparison:
    """Parts of the reachable set that the paper's 24 surfaces leave out."""

    legs: Estimate
    """Share of leg lengths, drawn uniformly within the limits, that put o outside the shell."""
    volume: Estimate
    """Share of the reachable volume that is outside the shell."""
    area: Estimate
    """Share of the area of the reachable set's boundary that is on none of the 24 surfaces."""
    farthest: float
    """The farthest that o was found outside [m], of the sets of lengths drawn."""


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
        Made by `spm_pin.workspace.shell`.
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
    count, rng = whole_number(samples, "samples", least=20), generator(rng)
    geometry, limits = instance(shell, Shell, "shell").geometry, shell.limits
    box = leg_length_box(geometry, limits)
    if boundary is None:
        boundary = reachable_boundary(geometry, limits, progress=progress)
    instance(boundary, Boundary, "boundary")
    if (boundary.geometry, boundary.limits) != (geometry, limits):
        raise ArgumentError("boundary", "that of the shell's geometry and limits", repr(boundary))

    positions = sample_reachable(geometry, count, limits, rng=rng).translation
    outside = positions[~shell.contains(positions)]
    legs = from_hits(len(outside), count, 1.0, confidence, "uniform leg lengths", "")
    farthest = float(-shell.distance(outside).min()) if len(outside) else 0.0

    points, _ = _points_around(box, count, rng)
    found = search_states(box, points, what="reachable points", progress=progress)
    points = points[found.reached]
    missed = int(np.count_nonzero(~shell.contains(points)))
    volume = from_hits(missed, len(points), 1.0, confidence, "uniform reachable points", "")

    drawn = boundary.sample(count // 10, rng)
    surfaces = np.array(
        [[{"min": -1, "max": 1}.get(leg.value, 0) for leg in patch.settings] for patch in shell.patches]
    )
    on_surface = ((surfaces == 0) | (surfaces == drawn.at_limit[:, None, :])).all(axis=-1).any(axis=-1)
    area = from_hits(int(np.count_nonzero(~on_surface)), count // 10, 1.0, confidence, "points of the boundary", "")
    return ShellComparison(legs, volume, area, farthest)
