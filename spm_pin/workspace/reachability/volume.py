"""Volumes of the reachable positions, by samples or by meshes, and of the reachable poses."""

from __future__ import annotations

from typing import Literal

import numpy as np

from spm_pin.mechanism.arguments import Progress, choice, generator, whole_number
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LegLimits
from spm_pin.workspace.reachability.boundary import reachable_boundary
from spm_pin.workspace.reachability.confidence_intervals import Estimate, check_confidence, from_hits, from_mean
from spm_pin.workspace.reachability.leg_length_box import leg_length_box
from spm_pin.workspace.reachability.membership import search_states
from spm_pin.workspace.reachability.portions import portions
from spm_pin.workspace.reachability.reachable_samples import pose_weights

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
        "sampling": the share of uniform points that are reachable, with Clopper and Pearson's interval, whose upper end
        counts undecided points as reachable. "mesh": the volume enclosed by `reachable_boundary` at `spacing` and half
        of it, extrapolated; the error is the extrapolated part, and the interval has no confidence.
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
    points, region = box.coarse.draw_around(whole_number(samples, "samples", least=2), rng)
    found = search_states(box, points, what="reachable points", progress=progress)
    hits, undecided = int(found.reached.sum()), int(found.undecided.sum())
    return from_hits(hits, len(points), region, confidence, "share of uniform points", "m³", undecided)


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
