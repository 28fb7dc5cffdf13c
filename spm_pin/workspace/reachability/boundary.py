"""The boundary of the reachable positions, as a closed mesh whose vertices lie on it.

Marching cubes need only the reachability of the nodes of a grid: it determines which edges the boundary crosses,
and `spm_pin.workspace.reachability.reachability_grid` says where. What bounds the set is derived in
`docs/theory/reachable_set.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism.arguments import FloatArray, Progress, generator, whole_number
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LegLimits
from spm_pin.workspace.closed_mesh import ClosedMesh
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox, leg_length_box
from spm_pin.workspace.reachability.nearest_points import NearestPoints, nearest_in_box
from spm_pin.workspace.reachability.reachability_grid import ReachabilityGrid
from spm_pin.workspace.reachability.state_search import RESOLUTION

_BESIDE = 0.05
"""Share of the way from a point found nearest to the given one, where nothing may be nearer."""


@dataclass(frozen=True)
class BoundaryPoints:
    """Points of the boundary, each nearest to a point just outside; arrays over n."""

    position: FloatArray
    """In {B} [m], shape (n, 3)."""
    normal: FloatArray
    """Outward unit normals, shape (n, 3); at an edge, one of those between its two sides."""
    leg_lengths: FloatArray
    """r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], shape (n, 6); a leg at a limit has it to the last bit."""
    at_limit: npt.NDArray[np.int8]
    """-1 for a leg at its minimum, 1 at its maximum, 0 for one that is free, shape (n, 6)."""
    gradient: FloatArray
    """How fast o moves along the normal with each leg, shape (n, 6): zero for those free, else of the sign of
    `at_limit`, or zero. At a forward singularity, where that is infinite, the multipliers of the limits."""
    violation: FloatArray
    """By how much normal and `gradient` miss the conditions of a nearest point, shape (n,); rounding."""


@dataclass(frozen=True)
class Boundary(ClosedMesh):
    """The boundary of the reachable positions, a mesh in {B}; made by `reachable_boundary`."""

    geometry: Geometry
    """The manipulator."""
    limits: LegLimits
    """The leg limits."""
    spacing: float
    """Spacing of the grid that the mesh was made on [m]."""
    leg_lengths: FloatArray
    """Lengths that put o at the vertices [m], shape (V, 6)."""

    def __repr__(self) -> str:
        return f"<Boundary: {len(self.vertices)} vertices, {len(self.faces)} faces, {self.volume:.4f} m³>"

    def sample(self, count: int, rng: np.random.Generator | int | None = None) -> BoundaryPoints:
        """Draw points of the boundary, about uniformly over its area.

        Parameters
        ----------
        count : int
            How many.
        rng : Generator or int, optional
            Source of randomness, or its seed.

        Notes
        -----
        Drawn on the mesh, lifted off it until out of reach, and moved to the nearest reachable point.
        """
        rng, count = generator(rng, "rng"), whole_number(count, "count", least=1)
        doubled = self._doubled_normals
        double_area = np.linalg.norm(doubled, axis=-1)
        face = rng.choice(len(self.faces), count, p=double_area / double_area.sum())
        share = np.sort(rng.uniform(size=(count, 2)), axis=-1)
        weights = np.stack([share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]], axis=-1)
        on_mesh = (self.vertices[self.faces[face]] * weights[..., None]).sum(axis=1)
        outwards = doubled[face] / double_area[face, None]
        box = leg_length_box(self.geometry, self.limits)
        left, lift = np.arange(count), 0.1 * self.spacing
        points = on_mesh + lift * outwards
        found = _globally_nearest(box, points)
        while len(left := left[found.distance[left] <= 0.01 * self.spacing]):
            lift *= 2.0
            points[left] = on_mesh[left] + lift * outwards[left]
            found.update(left, _globally_nearest(box, points[left]))
        normal = (points - found.position) / np.maximum(found.distance, np.finfo(float).tiny)[:, None]
        at_limit = (found.lengths >= box.maximum).astype(np.int8) - (found.lengths <= box.minimum).astype(np.int8)
        return BoundaryPoints(found.position, normal, found.lengths, at_limit, found.gradient, found.optimality)


def _globally_nearest(box: LegLengthBox, points: FloatArray) -> NearestPoints:
    """Return the reachable point nearest to each of `points` (N, 3) outside, searched again from just beside it."""
    found = nearest_in_box(box, points)
    left = np.flatnonzero(found.distance > RESOLUTION * box.size)
    while len(left):
        # Nothing is reachable inside the sphere around `points`; if something is, it is a better beginning.
        here, distance = found.position[left], found.distance[left]
        beside = nearest_in_box(box, here + _BESIDE * (points[left] - here))
        wrong = np.flatnonzero(beside.distance < (1.0 - 1e-6) * _BESIDE * distance)
        left = left[wrong]
        better = nearest_in_box(box, points[left], beside.coordinates[wrong])
        nearer = np.flatnonzero(better.distance < (1.0 - 1e-9) * found.distance[left])
        left = left[nearer]
        found.update(left, better, nearer)
        left = left[found.distance[left] > RESOLUTION * box.size]
    return found


def reachable_boundary(
    geometry: Geometry,
    limits: LegLimits | None = None,
    *,
    spacing: float = 0.1,
    progress: Progress | None = None,
) -> Boundary:
    """Find the boundary of the positions that o can reach in the physical mode.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    spacing : float
        Of the grid [m]. What is smaller may be missed; the vertices lie on the boundary whatever it is. Half the
        spacing takes eight times as long.
    progress : callable, optional
        Called with what is being done, how many points are done, and of how many. What it raises ends the work.

    Returns
    -------
    Boundary
        A closed mesh in {B} [m], outward.

    Raises
    ------
    ArgumentError
        If there are no limits, one is infinite, no lengths within them belong to a configuration, or the spacing is
        not positive, or so small or so large that there would be no grid.
    MissingExtraError
        If scikit-image is not installed.

    Notes
    -----
    The grid is not searched where a coarser one has shown that nothing reachable is near.

    Examples
    --------
    >>> import spm_pin as spm
    >>> boundary = spm.workspace.reachable_boundary(spm.Geometry.paper(), spacing=0.2)
    >>> 1.7 < boundary.volume < 1.9
    True
    """
    require_extra("workspace", "skimage")
    measure: Any = import_module("skimage.measure")
    box = leg_length_box(geometry, limits)
    grid = ReachabilityGrid(box, spacing, progress)
    if not grid.inside.any():
        smallest = float((box.coarse.extent[1] - box.coarse.extent[0]).min())
        cause = f"No node of the grid is reachable; the reachable set is about {smallest:.2g} m"
        raise ArgumentError("spacing", "a spacing much smaller than the reachable set, in metres", spacing, cause)
    corners, faces, _, _ = measure.marching_cubes(np.where(grid.inside, 1.0, -1.0), 0.0)
    vertices, lengths = grid.crossings(corners.astype(np.float64))
    boundary = Boundary(vertices, faces.astype(np.intp), geometry, box.limits, grid.spacing, lengths)
    return boundary if boundary.volume > 0.0 else replace(boundary, faces=boundary.faces[:, ::-1])
