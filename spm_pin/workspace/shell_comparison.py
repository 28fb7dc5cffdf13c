"""The paper's 24 surfaces compared with the reachable set: the parts of the set that they leave out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import Progress, check_instance, generator, whole_number
from spm_pin.workspace.paper_shell.shell import Shell
from spm_pin.workspace.reachability.boundary import Boundary, reachable_boundary
from spm_pin.workspace.reachability.confidence_intervals import Estimate, check_confidence, from_hits
from spm_pin.workspace.reachability.leg_length_box import leg_length_box
from spm_pin.workspace.reachability.membership import search_states
from spm_pin.workspace.reachability.reachable_samples import sample_reachable


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
    geometry, limits = check_instance(shell, Shell, "shell").geometry, shell.limits
    box = leg_length_box(geometry, limits)
    if boundary is None:
        boundary = reachable_boundary(geometry, limits, progress=progress)
    check_instance(boundary, Boundary, "boundary")
    if (boundary.geometry, boundary.limits) != (geometry, limits):
        raise ArgumentError("boundary", "that of the shell's geometry and limits", repr(boundary))

    positions = sample_reachable(geometry, count, limits, rng=rng).translation
    outside = positions[~shell.contains(positions)]
    legs = from_hits(len(outside), count, 1.0, confidence, "uniform leg lengths", "")
    farthest = float(-shell.distance(outside).min()) if len(outside) else 0.0

    points, _ = box.coarse.draw_around(count, rng)
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
