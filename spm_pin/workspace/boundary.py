"""Closed triangle meshes, and the boundary of the reachable positions as such a mesh.

Marching cubes need only the reachability of the nodes of a grid, which determines the edges that the boundary crosses;
bisection of these edges finds the points. `docs/theory/reachable_set.md` derives what bounds the set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.kernels import RESOLUTION
from spm_pin.machine import LegLimits, Manipulator
from spm_pin.machine.manipulator import check_manipulator
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    Progress,
    generator,
    real_array,
    real_number,
    whole_number,
)
from spm_pin.support.progress import shown_progress
from spm_pin.workspace.search import (
    NearestPoints,
    in_chunks,
    nearest_points,
    nearest_states,
    search_states,
    start_table,
)
from spm_pin.workspace.state_set import StateSet, finite_limits, states_within

if TYPE_CHECKING:
    from trimesh import Trimesh

FOR_STAGE = "For a stage see spm_pin.workspace.reach: its largest tilts by height and direction"
"""Cause of an error where a stage has no set of positions of its own."""
_OBLIQUE = Rotation.from_rotvec([0.37, -0.59, 0.83]).as_matrix()
"""Rotation to a frame whose last axis is far from the symmetries of a mesh: if a ray runs along a face, rounding could
hide whether it is ahead of the point."""
_TOGETHER = 256
"""Number of points whose winding numbers are computed together."""
_STEPS = 20
"""Steps of a grid along the longest side of the reachable set, if no spacing is given."""
_MOST_NODES = 5_000_000
"""Largest number of nodes of the grid."""
_HALVINGS = 25
"""Number of bisections of an edge, down to 3e-8 of it."""
_CHECK_DISTANCE = 1e-4
"""Distance beyond the boundary point, relative to the edge, at which nothing must be reachable."""
_BESIDE = 0.05
"""Fraction of the way from the nearest point found to the given one, where nothing may be nearer."""


@dataclass(frozen=True)
class ClosedMesh:
    """A closed, oriented triangle mesh; it may intersect itself."""

    vertices: FloatArray
    """Positions of o in {B} [m], shape (V, 3)."""
    faces: IntArray
    """Triangles, counter-clockwise seen from outside, shape (F, 3)."""

    @property
    def volume(self) -> float:
        """Volume enclosed by the mesh [m³]; its error decreases with the square of the spacing of its vertices."""
        a, b, c = np.moveaxis(self.vertices[self.faces] - self.vertices.mean(axis=0), 1, 0)
        return float((a * np.cross(b, c)).sum()) / 6.0

    @property
    def face_areas(self) -> FloatArray:
        """Areas of the faces [m²], shape (F,)."""
        return np.asarray(np.linalg.norm(self._doubled_normals, axis=-1) / 2.0)

    @property
    def area(self) -> float:
        """Area of the mesh [m²]."""
        return float(self.face_areas.sum())

    @property
    def euler_characteristic(self) -> int:
        """V - E + F of the mesh, 2 for a sphere; it depends on the spacing if the set has thin parts."""
        return len(self.vertices) - 3 * len(self.faces) // 2 + len(self.faces)

    @property
    def _doubled_normals(self) -> FloatArray:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def mesh(self) -> Trimesh:
        """The mesh as a `trimesh.Trimesh` in {B} [m], watertight, its normals outward."""
        mesh: Trimesh = _trimesh().Trimesh(self.vertices, self.faces, process=False)
        return mesh

    def winding_number(self, points: npt.ArrayLike) -> npt.NDArray[np.int32]:
        """Return the winding number of the mesh around each of `points` (..., 3) [m], shape (...).

        For a point on the mesh, to rounding, it is the number on one of its sides. The signed crossings of a ray
        from the point are counted. The same arithmetic decides for both faces at an edge on which side of it the ray
        passes, so no ray passes between them.
        """
        array = real_array(points, "points", (3,), "positions in metres")
        flat, vertices = array.reshape(-1, 3) @ _OBLIQUE, self.vertices @ _OBLIQUE
        top, (tree, reach) = vertices[self.faces, 2].max(axis=1), self._faces_across_rays
        following = np.roll(self.faces, -1, axis=1)
        number = np.zeros(len(flat), dtype=np.int32)
        for begin in range(0, len(flat), _TOGETHER):
            near: Any = tree.query_ball_point(flat[begin : begin + _TOGETHER, :2], reach)
            point = np.repeat(np.arange(begin, begin + len(near)), [*map(len, near)])
            face = np.concatenate(near).astype(np.intp)
            ahead = top[face] >= flat[point, 2]
            point, face = point[ahead], face[ahead]
            corners, after = self.faces[face], following[face]
            a, b = (vertices[pick(corners, after)] for pick in (np.minimum, np.maximum))
            x, y = flat[point, None, 0], flat[point, None, 1]
            upward, downward = (a[..., 1] <= y) & (y < b[..., 1]), (b[..., 1] <= y) & (y < a[..., 1])
            side = (b[..., 0] - a[..., 0]) * (y - a[..., 1]) - (x - a[..., 0]) * (b[..., 1] - a[..., 1])
            turn = (upward & (side > 0.0)).astype(np.int32) - (downward & (side < 0.0))
            # Winding number of the face's outline around the ray, and whether the ray meets its plane ahead.
            turn = np.where(corners < after, turn, -turn).sum(axis=1, dtype=np.int32)
            hit = np.flatnonzero(turn)
            p, q, r = np.moveaxis(vertices[corners[hit]], 1, 0)
            normal = np.cross(q - p, r - p)
            hit = hit[(normal * (p - flat[point[hit]])).sum(axis=1) * normal[:, 2] > 0.0]
            np.add.at(number, point[hit], turn[hit])
        return number.reshape(array.shape[:-1])

    def contains(self, points: npt.ArrayLike) -> BoolArray:
        """Return a mask (...) of the `points` (..., 3) [m] inside the mesh, with a nonzero winding number."""
        return np.asarray(self.winding_number(points) != 0)

    def distance(self, points: npt.ArrayLike) -> FloatArray:
        """Return distances of `points` (..., 3) from the mesh [m], shape (...); positive inside, negative outside."""
        array = real_array(points, "points", (3,), "positions in metres")
        closest_point = _trimesh().triangles.closest_point
        tree, reach = self._faces_by_place
        shortest = np.empty(array.shape[:-1])
        for k, point in enumerate(array.reshape(-1, 3)):
            # The nearest centroid is on the mesh; a face whose centroid is farther by `reach` is itself farther.
            near = tree.query_ball_point(point, tree.query(point)[0] + reach)
            nearest = closest_point(self.vertices[self.faces[near]], np.broadcast_to(point, (len(near), 3)))
            shortest.flat[k] = np.linalg.norm(nearest - point, axis=1).min()
        return np.where(self.contains(array), shortest, -shortest)

    @cached_property
    def _faces_by_place(self) -> tuple[KDTree, float]:
        return _centroids(self.vertices[self.faces])

    @cached_property
    def _faces_across_rays(self) -> tuple[KDTree, float]:
        return _centroids((self.vertices @ _OBLIQUE)[self.faces, :2])


def _centroids(corners: FloatArray) -> tuple[KDTree, float]:
    """Return a tree of the centroids of faces (F, 3, k), and a bound on the extent of a face from its own."""
    centroids = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centroids[:, None], axis=-1).max()
    return KDTree(centroids), (1.0 + 1e-9) * float(reach)


def _trimesh() -> Any:
    require_extra("workspace", "trimesh")
    return import_module("trimesh")


@dataclass(frozen=True)
class BoundaryPoints:
    """Points of the boundary, each the nearest to a point just outside; arrays over n."""

    position: FloatArray
    """Positions in {B} [m], shape (n, 3)."""
    normal: FloatArray
    """Outward unit normals, shape (n, 3); at an edge, one of those between its two sides."""
    readings: FloatArray
    """Readings r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], shape (n, 6); a leg at a limit has it to the last bit."""
    at_limit: npt.NDArray[np.int8]
    """-1 for a leg at its minimum, 1 at its maximum, 0 for a free one, shape (n, 6)."""
    violation: FloatArray
    """Residuals of the conditions of a nearest point, shape (n,), of the size of rounding."""


@dataclass(frozen=True)
class Boundary(ClosedMesh):
    """The boundary of the reachable positions, a mesh in {B}; made by `reachable_boundary`."""

    machine: Manipulator
    """The manipulator."""
    limits: LegLimits
    """The leg limits."""
    spacing: float
    """Spacing of the grid of the mesh [m]."""
    readings: FloatArray
    """Readings that put o at the vertices [m], shape (V, 6)."""

    def __repr__(self) -> str:
        return f"<Boundary: {len(self.vertices)} vertices, {len(self.faces)} faces, {self.volume:.4g} m³>"

    def sample(self, count: int, rng: np.random.Generator | int | None = None) -> BoundaryPoints:
        """Return `count` random points of the boundary, about uniformly over its area.

        They are chosen on the mesh, moved outwards until out of reach, then to the nearest reachable point. If that
        search does not converge (less than 1 % of points, with the widest limits), `violation` is large.
        """
        rng, count = generator(rng, "rng"), whole_number(count, "count", least=1)
        doubled = self._doubled_normals
        double_area = np.linalg.norm(doubled, axis=-1)
        face = rng.choice(len(self.faces), count, p=double_area / double_area.sum())
        share = np.sort(rng.uniform(size=(count, 2)), axis=-1)
        weights = np.stack([share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]], axis=-1)
        on_mesh = (self.vertices[self.faces[face]] * weights[..., None]).sum(axis=1)
        outwards = doubled[face] / double_area[face, None]
        states = states_within(self.machine, self.limits)
        left, lift = np.arange(count), 0.1 * self.spacing
        points = on_mesh + lift * outwards
        result = _globally_nearest(states, points)
        while len(left := left[result.distance[left] <= 0.01 * self.spacing]):
            lift *= 2.0
            points[left] = on_mesh[left] + lift * outwards[left]
            result.update(left, _globally_nearest(states, points[left]))
        position, readings = states.positions(result.coordinates), result.readings
        normal = (points - position) / np.maximum(result.distance, np.finfo(float).tiny)[:, None]
        at_limit = (readings >= states.maximum).astype(np.int8) - (readings <= states.minimum).astype(np.int8)
        return BoundaryPoints(position, normal, readings, at_limit, result.optimality)


def _globally_nearest(states: StateSet, points: FloatArray) -> NearestPoints:
    """Return the states nearest to `points` (N, 3) outside, searched again from close to them."""
    result = nearest_points(states, points)
    tolerance = RESOLUTION * states.size
    left = np.flatnonzero(result.distance > tolerance)
    while len(left):
        # Nothing is reachable inside the sphere around `points`; if something is, it is a better start.
        here, distance = states.positions(result.coordinates[left]), result.distance[left]
        beside = nearest_points(states, here + _BESIDE * (points[left] - here))
        nearer = np.flatnonzero(beside.distance < (1.0 - 1e-6) * _BESIDE * distance)
        left = left[nearer]
        better = nearest_states(states, points[left], beside.coordinates[nearer, None])
        nearer = np.flatnonzero(better.distance < (1.0 - 1e-9) * result.distance[left])
        left = left[nearer]
        result.update(left, better, nearer)
        left = left[result.distance[left] > tolerance]
    return result


class _Grid:
    """A grid whose ends are outside the reachable set, and a mask of its reachable nodes."""

    def __init__(self, states: StateSet, spacing: float, progress: Progress | None) -> None:
        self.set, self.spacing, self.progress = states, spacing, progress
        low, high = start_table(states).extent
        pad = 0.02 * (high - low) + 1.5 * spacing
        with np.errstate(over="ignore"):
            numbers = np.ceil((high - low + 2.0 * pad) / spacing) + 1.0
        if numbers.prod() > _MOST_NODES:
            expected = f"a spacing in metres that makes at most {_MOST_NODES:.0e} nodes"
            received = f"{spacing:g}, which makes {numbers.prod():.0e}"
            raise ArgumentError("spacing", expected, received, "In millimetres?")
        self.origin = 0.5 * (low + high - (numbers - 1.0) * spacing)
        shape = tuple(numbers.astype(int))
        nodes = self.origin + spacing * np.indices(shape).reshape(3, -1).T
        member = search_states(states, nodes, what="reachable nodes", progress=progress)
        inside, known = member.reached, member.coordinates
        # Nodes missed by a search are found from reachable neighbours. No reachable node is at the end of
        # a row, because there is a margin around the set.
        steps = [way * stride for stride in (1, shape[2], shape[1] * shape[2]) for way in (1, -1)]
        fresh, what = np.flatnonzero(inside), "nodes beside reachable ones"
        while len(fresh):
            before = inside.copy()
            for step in steps:
                beside = fresh[~inside[fresh + step]] + step
                member = search_states(states, nodes[beside], known[beside - step], what=what, progress=progress)
                inside[beside], known[beside] = member.reached, member.coordinates
            fresh = np.flatnonzero(inside & ~before)
        self.inside, self.states = inside.reshape(shape), known.reshape(*shape, 2, 3)

    def crossings(self, corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Move vertices of marching cubes (V, 3), in units of the grid, to the boundary [m]; and readings there."""
        first, last = np.floor(corners).astype(int), np.ceil(corners).astype(int)
        a, b = self.inside[tuple(first.T)], self.inside[tuple(last.T)]
        nodes = np.where(a[:, None], first, last)
        inner, outer = nodes.astype(np.float64), np.where(a[:, None], last, first).astype(np.float64)
        known = self.states[tuple(nodes.T)]
        # A vertex in the middle of a cube, which some ambiguous ones have, is on no edge.
        for k in np.flatnonzero((a == b) | ((last - first).sum(axis=-1) != 1)):
            cube = np.floor(corners[k]).astype(int) + np.indices((2, 2, 2)).reshape(3, -1).T
            reached = self.inside[tuple(cube.T)]
            centre = search_states(self.set, self.origin + self.spacing * corners[k : k + 1])
            if centre.reached[0]:
                inner[k], outer[k], known[k] = corners[k], cube[~reached][0], centre.coordinates[0]
            else:
                inner[k], outer[k], known[k] = cube[reached][0], corners[k], self.states[tuple(cube[reached][0])]
        arrays = self.origin + self.spacing * inner, self.origin + self.spacing * outer, known
        vertices, readings = in_chunks(partial(_crossings, self.set), "vertices", self.progress, *arrays)
        return vertices, readings


def _crossings(states: StateSet, inner: FloatArray, outer: FloatArray, within: FloatArray) -> tuple[FloatArray, ...]:
    """Return the points (N, 3) [m] at which segments leave the reachable set, and readings (N, 6) [m] there.

    They go from reachable points `inner` to unreachable ones `outer`, (N, 3) [m]; `within` (N, 2, 3) put o at `inner`.
    Each is bisected, and the search continued from the last state within.
    """
    along, within, outermost = outer - inner, within.copy(), within.copy()
    low, high, left = np.zeros(len(along)), np.ones(len(along)), np.arange(len(along))
    while len(left):
        for _ in range(_HALVINGS):
            middle = 0.5 * (low[left] + high[left])
            points = inner[left] + middle[:, None] * along[left]
            member = search_states(states, points, within[left])
            good = member.reached
            within[left[good]], outermost[left[~good]] = member.coordinates[good], member.coordinates[~good]
            low[left], high[left] = np.where(good, middle, low[left]), np.where(good, high[left], middle)
        # The search outwards from one state may miss another state: just outside, nothing must be reachable.
        outside = np.minimum(high[left] + _CHECK_DISTANCE, 1.0)
        member = search_states(states, inner[left] + outside[:, None] * along[left])
        farther = np.flatnonzero(member.reached & (outside < 1.0))
        left = left[farther]
        within[left], low[left], high[left] = member.coordinates[farther], outside[farther], 1.0
    # In the outermost state, legs exceed their limits by the remaining residual. Next to a forward singularity such
    # readings may belong to another state: those of the last state within do not.
    vertices = inner + low[:, None] * along
    readings = np.clip(states.readings(outermost), states.minimum, states.maximum)
    reached = forward_physical(states.machine, readings).translation
    lost = ~(np.abs(reached - vertices).max(axis=-1) < 1e-6 * states.size)
    readings[lost] = np.clip(states.readings(within[lost]), states.minimum, states.maximum)
    return vertices, readings


def reachable_boundary(
    machine: Manipulator,
    limits: LegLimits | None = None,
    *,
    spacing: float | None = None,
    progress: Progress | None = None,
) -> Boundary:
    """Find the boundary of the positions that o can reach in the physical mode.

    Parameters
    ----------
    machine : Manipulator
        The manipulator.
    limits : LegLimits, optional
        Leg limits; the machine's own if not given.
    spacing : float
        Spacing of the grid [m]; by default about a twentieth of the longest side of the reachable set. Smaller details
        may be missed, but the vertices are on the boundary. Half the spacing takes eight times as long.
    progress : callable, optional
        Called with a description of the work, the number of points done and their total; an exception ends the work. By
        default, a line on the terminal shows it after some seconds.

    Returns
    -------
    Boundary
        A closed mesh in {B} [m], with outward normals.

    Examples
    --------
    >>> import spm_pin as spm
    >>> boundary = spm.workspace.reachable_boundary(spm.Manipulator.paper(), spacing=0.2)
    >>> 1.7 < boundary.volume < 1.9
    True
    """
    check_manipulator(machine, for_stage=FOR_STAGE)
    require_extra("workspace", "skimage")
    measure: Any = import_module("skimage.measure")
    limits = finite_limits(machine, limits)
    states = states_within(machine, limits)
    if spacing is None:
        spacing = float(f"{np.ptp(start_table(states).extent, axis=0).max() / _STEPS:.2g}")
    spacing = real_number(spacing, "spacing", "a positive length in metres", above=0.0)
    grid = _Grid(states, spacing, shown_progress(progress))
    if not grid.inside.any():
        low, high = start_table(states).extent
        smallest = float((high - low).min())
        cause = f"No node of the grid is reachable; the reachable set is about {smallest:.2g} m"
        raise ArgumentError("spacing", "a spacing much smaller than the reachable set, in metres", spacing, cause)
    corners, faces, _, _ = measure.marching_cubes(np.where(grid.inside, 1.0, -1.0), 0.0)
    vertices, readings = grid.crossings(corners.astype(np.float64))
    boundary = Boundary(vertices, faces.astype(np.intp), machine, limits, spacing, readings)
    return boundary if boundary.volume > 0.0 else replace(boundary, faces=boundary.faces[:, ::-1])
