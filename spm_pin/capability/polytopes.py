"""Sets of wrenches, twists and accelerations that the legs allow, as polytopes of states.

As many legs as freedoms: with x what the platform does and y what the legs do, y = N x for a regular matrix N, so that
limits of the legs, a box of y, are a parallelotope of x. Its facets, two of each leg, are the rows of N and its
vertices the corners of the box through N⁻¹, and of both matrices there is a closed form:

    wrench onto m    f = -Gᵀ w         w = -J_fᵀ f
    twist of m       ṙ = J_f t         t = G ṙ
    acceleration     f = Gᵀ (Λ ṫ + h)  ṫ = Λ⁻¹ (J_fᵀ f - h)

A stage has three freedoms: its x are the motion (v_z, ω_x, ω_y) and its time derivative, with J_f and the rows of G
that belong to it. The wrench onto its platform keeps all six components. Its structure holds a part of them without any
leg, so that limits of the legs alone leave a set without end, and those of joints, `joint_reactions`, close it.

Facets therefore also hold where the other matrix does not exist: at an inverse singularity the structure holds some
wrenches without any leg, at a forward singularity some twists need no leg rates, and the set has no end there.

y are efforts of the actuators, forces or torques, and rates of their readings: J_f and G have κ of each leg in them.
A leg without weight carries a force through its ball that lies in the plane of its rod and its revolute axis: one along
the rod, the actuator's effort over κ, and s along the axis, which the structure carries. s is an axial load of the
revolute joints, and with the distance L of the ball as lever the moment L s bends their bearings and the leg.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import inverse_jacobian, platform_jacobian
from spm_pin.kinematics.rates_and_forces import motion_rows, stage_inverses
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    broadcastable,
    choice,
    leg_bounds,
    real_array,
    symmetric_matrices,
)

_PARTS = {
    6: {"linear": slice(3), "angular": slice(3, 6)},
    3: {"linear": slice(1), "angular": slice(1, 3)},
}
"""Parts of x, by its length."""
_MOST = 1e100
_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
_FLATTEST = 1e-7
"""Radius of the largest ball in a section, in its own coordinates, that linear programming tells from none."""
_DIRECTIONS = 8
"""Directions of half a turn in which the force of a ball is looked at: its size is then known to 2 %."""


class HalfSpaces(NamedTuple):
    """Half-spaces A x <= b of polytopes of shape (...) with n rows each."""

    A: FloatArray
    """Outward normals, not of unit length, shape (..., 2 n, 6): upper limits, then lower ones; of motions (..., 3)."""
    b: FloatArray
    """Shape (..., 2 n), in the unit of the limits."""


class Ellipsoid(NamedTuple):
    """Ellipsoids of shape (...) in the space of k components of a wrench, twist or acceleration; mostly k = 3."""

    centre: FloatArray
    """Shape (..., k)."""
    semi_axes: FloatArray
    """From large to small, shape (..., k)."""
    directions: FloatArray
    """Their unit vectors in {B}, as rows, shape (..., k, k)."""


class Section(NamedTuple):
    """A convex polyhedron."""

    vertices: FloatArray
    """Shape (n, 3)."""
    faces: IntArray
    """Triangles, counter-clockwise seen from outside, shape (m, 3)."""


class JointReactions(NamedTuple):
    """Rows that multiply a wrench (f, m) at o in {B} [N, N m]; for `Polytope.within`, or ``rows @ wrench``."""

    axial: FloatArray
    """Force of each leg onto what it carries along its revolute axis `leg_axes`, shape (..., legs, 6)."""
    bending: FloatArray
    """Moment of each leg at the joint where the rod begins, at `Configuration.circle_centres`: the pivot of an RPS
    leg, the carriage or the knee of others. About the direction of the rod x its axis [N m], shape (..., legs, 6)."""
    pivot: FloatArray
    """Moment at the pivot itself, about the direction from there to the ball x the leg's axis [N m], shape
    (..., legs, 6): of an RRS leg at the bearings of its motor's shaft."""
    ball: FloatArray
    """Components of each ball's force in eight directions, over cos(π/16), shape (..., 8 legs, 6), leg by leg: all of
    them within ±F guarantee a resultant of at most F, and a resultant of at most 0.98 F keeps them within it."""


@dataclass(frozen=True, eq=False)
class Polytope:
    """Points x with lower <= rows · x <= upper, for states of shape (...); NaN for a state that does not exist.

    x is a wrench (f, m) [N, N m], a twist (v, ω) [m/s, rad/s] or its time derivative, at o in {B}; its "linear" part
    is (x_1, x_2, x_3), the "angular" one the rest. For a stage x is such a wrench, or the motion (v_z, ω_x, ω_y) of the
    stage, or the time derivative of that motion: then v_z is the "linear" part, the velocity of the tilt the "angular"
    one. Made by `wrench_polytope`, `velocity_polytope` and `acceleration_polytope`.
    """

    rows: FloatArray
    """Derivatives of the limited quantities by x, legs first, shape (..., n, 6), of motions (..., n, 3)."""
    lower: FloatArray
    """Least values, shape (..., n)."""
    upper: FloatArray
    """Largest values, shape (..., n)."""
    columns: Callable[[], FloatArray] | None = None
    """Returns the inverse of the rows of a parallelotope; None for other polytopes."""

    def __repr__(self) -> str:
        return f"<Polytope: shape {self.lower.shape[:-1]}, {2 * self.lower.shape[-1]} half-spaces>"

    @property
    def half_spaces(self) -> HalfSpaces:
        """All points x with A x <= b."""
        normals = np.concatenate([self.rows, -self.rows], axis=-2)
        return HalfSpaces(normals, np.concatenate([self.upper, -self.lower], axis=-1))

    @cached_property
    def vertices(self) -> FloatArray:
        """The 64 vertices, shape (..., 64, 6): in number k leg i is at its upper limit if bit i of k is set.

        For motions of a stage 8, shape (..., 8, 3). Raises `SingularConfigurationError` where the set is unbounded:
        wrenches at an inverse singularity, twists and accelerations at a forward one; `ArgumentError` for wrenches onto
        a stage. With rows added by `within` only a `section` has vertices.
        """
        if self.columns is None:
            cause = "Its vertices have no closed form: take a section, or scipy.spatial.HalfspaceIntersection"
            raise ArgumentError("vertices", "a parallelotope, of as many limits as freedoms", repr(self), cause)
        bits = np.arange(self._width)
        is_upper = (np.arange(2**self._width)[:, None] >> bits) & 1 == 1
        corners = np.where(is_upper, self.upper[..., None, :], self.lower[..., None, :])
        return np.asarray(corners @ self.columns().mT)

    def within(self, rows: npt.ArrayLike, limits: npt.ArrayLike, *, load: npt.ArrayLike | None = None) -> Polytope:
        """Return the part of the polytope in which other linear functions of x keep their limits as well.

        Parameters
        ----------
        rows : array_like, shape (6,) or (..., k, 6), of motions (3,) or (..., k, 3)
            The functions, such as the rows of `joint_reactions`.
        limits : array_like, shape (), (k,) or (2, k)
            Largest values, of either sign; or the least and the largest.
        load : array_like of the length of x, optional
            What is there besides x and adds to the functions: for reactions, the payload's part of the polytope's load.
        """
        added = np.atleast_2d(real_array(rows, "rows", (self._width,), "functions of x at o in {B}", allow_nan=True))
        lower, upper = leg_bounds(limits, "limits", "values of the rows", count=added.shape[-2], most=_MOST)
        shape = broadcastable("rows", added.shape[:-2], "the polytope", self.lower.shape[:-1])
        offset = _taken(added, load, "the polytope", shape)
        shape = np.broadcast_shapes(shape, offset.shape[:-1])

        def joined(own: FloatArray, new: FloatArray, axis: int) -> FloatArray:
            return np.concatenate([np.broadcast_to(x, (*shape, *x.shape[axis:])) for x in (own, new)], axis=axis)

        ends = joined(self.lower, lower - offset, -1), joined(self.upper, upper - offset, -1)
        return Polytope(joined(self.rows, added, -2), *ends)

    def contains(self, points: npt.ArrayLike) -> BoolArray:
        """Return which points x (..., 6), of motions (..., 3), are inside; their leading axes broadcast."""
        values = self._values(points, "points")
        return np.asarray(((values >= self.lower) & (values <= self.upper)).all(axis=-1))

    def extent(self, direction: npt.ArrayLike) -> FloatArray:
        """Return the largest multiple (...) of x = `direction`, a point, that is inside, with all smaller ones.

        Infinite where nothing limits it, 0 where zero is outside: where not even the weights are held, for instance.
        """
        values = self._values(direction, "direction")
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.where(values > 0.0, self.upper / values, self.lower / values)
        # Where a limit is zero and the function too, nothing is limited; where a state is absent all are NaN.
        ends = np.where(values == 0.0, np.inf, ends)
        return self._around_zero(ends.min(axis=-1))

    def ball(self, part: str = "linear") -> FloatArray:
        """Return the radius (...) of the largest ball about zero of one part, the other part zero.

        Parameters
        ----------
        part : str
            "linear": the force held, or the speed of o reached, in every direction; "angular": the moment, or the
            angular velocity. 0 where zero is outside, infinite where nothing is limited.
        """
        x = self.rows[..., self._part(part)]
        # Term by term: NumPy takes several times as long to reduce a short last axis.
        squares = x[..., 0] * x[..., 0]
        for k in range(1, x.shape[-1]):
            squares += x[..., k] * x[..., k]
        with np.errstate(divide="ignore", invalid="ignore"):
            radii = np.where(squares == 0.0, np.inf, np.minimum(self.upper, -self.lower) / np.sqrt(squares))
        return self._around_zero(np.asarray(reduce(np.minimum, np.moveaxis(radii, -1, 0))))

    def ellipsoid(self, part: str = "linear") -> Ellipsoid:
        """Return the section, where the other part is zero, of the ellipsoid Σ ((y_i - middle_i) / half range_i)² <= 1.

        `part` as for `ball`. NaN if the ellipsoid has no such section, or an unbounded one. In a parallelotope, the
        ellipsoid in all dimensions is the one of largest volume inside it, which touches all facets. In other polytopes
        it is inside, but not the largest.
        """
        half = 0.5 * (self.upper - self.lower)
        scaled = self.rows[..., self._part(part)] / half[..., None]
        middle = 0.5 * (self.upper + self.lower) / half
        matrix = scaled.mT @ scaled
        absent = np.asarray(~np.isfinite(matrix).all(axis=(-1, -2)))
        values, vectors = np.linalg.eigh(np.where(absent[..., None, None], np.eye(matrix.shape[-1]), matrix))
        values = np.where(values <= _ROUNDING * values[..., -1:], np.nan, values)
        towards = (scaled @ vectors).mT @ middle[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            centre = (vectors @ (towards / values[..., None]))[..., 0]
            left = 1.0 - ((middle - (scaled @ centre[..., None])[..., 0]) ** 2).sum(axis=-1)
            axes = np.sqrt(np.where(left < 0.0, np.nan, left)[..., None] / values)
        present = ~np.isnan(axes).any(axis=-1, keepdims=True) & ~absent[..., None]
        directions = np.where(present[..., None], vectors.mT, np.nan)
        return Ellipsoid(np.where(present, centre, np.nan), np.where(present, axes, np.nan), directions)

    def section(self, part: str = "linear") -> Section:
        """Return the polyhedron of one part with the other part zero, of a single state; it has to have some volume.

        `part` as for `ball`; of motions of a stage it is "motion", all three components.
        """
        from scipy.optimize import linprog
        from scipy.spatial import ConvexHull, HalfspaceIntersection

        columns = self._part(part) if self._width == 6 else {"motion": slice(3)}[choice(part, "part", ("motion",))]
        if self.lower.ndim > 1 or not np.isfinite(self.rows).all():
            received = "one that does not exist" if self.lower.ndim == 1 else f"shape {self.lower.shape[:-1]}"
            raise ArgumentError("polytope", "that of a single state", received, "Make it of one of the states")
        half, rows = 0.5 * (self.upper - self.lower), self.rows[:, columns]
        limited = rows.any(axis=-1) & (half > 0.0)
        is_empty = bool(((half <= 0.0) | ~limited & ((self.lower > 0.0) | (self.upper < 0.0))).any())
        rows, half, middle = rows[limited], half[limited], 0.5 * (self.upper + self.lower)[limited]
        is_endless = np.linalg.matrix_rank(rows / np.linalg.norm(rows, axis=-1, keepdims=True), tol=1e-9) < 3
        # In coordinates in which the section is about as wide as high, whatever the sizes of the limits.
        normals, scales, directions = np.linalg.svd(rows / half[:, None], full_matrices=False)
        sizes = np.linalg.norm(normals, axis=-1)
        matrix = np.concatenate([normals, -normals]) / np.tile(sizes, 2)[:, None]
        ends = np.concatenate([1.0 + middle / half, 1.0 - middle / half]) / np.tile(sizes, 2)
        # The centre of the largest ball anywhere inside.
        unknowns = np.column_stack([matrix, np.ones(len(ends))])
        inner = linprog([0.0, 0.0, 0.0, -1.0], A_ub=unknowns, b_ub=ends, bounds=[(None, None)] * 3 + [(0.0, None)])
        centre = None if inner.status != 0 else inner.x
        if is_endless or is_empty or centre is None or centre[3] <= _FLATTEST:
            received = "one without end" if is_endless else "one that is empty, or flat to rounding"
            raise ArgumentError("polytope", f"a section ({part}) of some volume", received)
        points = HalfspaceIntersection(np.column_stack([matrix, -ends]), centre[:3]).intersections
        hull = ConvexHull(points)
        # SciPy leaves the sense of a triangle open.
        corners = points[hull.simplices]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = (normal * hull.equations[:, :3]).sum(axis=-1) * np.linalg.det(directions) < 0.0
        faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
        return Section((points / scales) @ directions, faces.astype(np.intp))

    @property
    def _width(self) -> int:
        """Length of x."""
        return int(self.rows.shape[-1])

    def _part(self, part: str) -> slice:
        parts = _PARTS[self._width]
        return parts[choice(part, "part", tuple(parts))]

    def _values(self, points: npt.ArrayLike, argument: str) -> FloatArray:
        array = real_array(points, argument, (self._width,), "linear part, then angular part, at o in {B}")
        broadcastable(argument, array.shape[:-1], "the polytope", self.lower.shape[:-1])
        values = (self.rows @ array[..., None])[..., 0]
        # What is zero to rounding would be inside or outside a limit of zero by its sign.
        largest = np.abs(self.rows).max(axis=-1) * np.abs(array).max(axis=-1, keepdims=True)
        return np.where(np.abs(values) <= _ROUNDING * largest, 0.0, values)

    def _around_zero(self, sizes: FloatArray) -> FloatArray:
        """Return sizes about zero: 0, and not -0, where zero is outside; NaN where a state does not exist."""
        outside = ((self.lower > 0.0) | (self.upper < 0.0)).any(axis=-1)
        return np.where(np.isnan(self.rows[..., 0, 0]), np.nan, np.where(outside, 0.0, sizes + 0.0))


def wrench_polytope(
    configuration: Configuration, force_limits: npt.ArrayLike, *, load: npt.ArrayLike | None = None
) -> Polytope:
    """Return the wrenches onto the terminal platform that the legs hold within limits of their forces.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    force_limits : array_like, shape (), (6,) or (2, 6); for a stage (), (3,) or (2, 3)
        Largest effort of each actuator in either sense [N] ([N m] for RRS legs); or the least, which is negative, and
        the largest. A positive effort increases the reading: an RPS leg pushes.
    load : array_like, shape (..., 6), optional
        An additional wrench onto the platform [N, N m]: the weight of a payload, or of all bodies,
        ``-chain.state(q, v).platform_dynamics().gravity``. Leading axes broadcast with those of `configuration`.

    Returns
    -------
    Polytope
        Wrenches (f, m) [N, N m] at o in {B}, applied from outside as those of `leg_forces`; what the platform exerts
        has the opposite sign. At singularities as `platform_jacobian`. For a stage it is unbounded in directions that
        the structure supports, until `within` limits the reactions.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> held = spm.capability.wrench_polytope(state, 1000.0)
    >>> held.vertices.shape, float(held.ball("linear").round(1)), float(held.extent([0, 0, -1, 0, 0, 0]).round(1))
    ((64, 6), 492.1, 933.9)
    """
    bounds = _limits_of(configuration, force_limits, "force_limits", "efforts of the actuators", "N", "N m")
    rows = -platform_jacobian(configuration).mT
    offset = _taken(rows, load, "the configuration", configuration.shape)
    is_square = rows.shape[-2] == rows.shape[-1]
    return _polytope(rows, bounds, offset, partial(_wrenches_of_forces, configuration) if is_square else None)


def velocity_polytope(configuration: Configuration, rate_limits: npt.ArrayLike) -> Polytope:
    """Return the twists of the platform that limits of the leg rates allow.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    rate_limits : array_like, shape (), (6,) or (2, 6); for a stage (), (3,) or (2, 3)
        Largest rate of each reading [m/s] ([rad/s] for RRS legs), in either sense; or the least, which is negative, and
        the largest.

    Returns
    -------
    Polytope
        Twists (v, ω) [m/s, rad/s] at o in {B}, or motions (v_z, ω_x, ω_y) for a stage; at singularities as
        `inverse_jacobian`.
    """
    bounds = _limits_of(configuration, rate_limits, "rate_limits", "rates of the readings", "m/s", "rad/s")
    rows = inverse_jacobian(configuration)
    columns = partial(_twists_of_rates, configuration)
    return _polytope(rows, bounds, np.zeros(rows.shape[:-1]), columns)


def acceleration_polytope(
    configuration: Configuration,
    force_limits: npt.ArrayLike,
    mass: npt.ArrayLike,
    load: npt.ArrayLike | None = None,
) -> Polytope:
    """Return the accelerations of the platform that limits of the leg forces allow.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    force_limits : array_like
        As for `wrench_polytope`.
    mass : array_like, shape (..., 6, 6); for a stage (..., 3, 3)
        Λ of ``chain.state(q, v).platform_dynamics()``, the mass of all bodies reflected at o, or of the platform alone:
        for a stage whose platform has the 6 x 6 matrix M at o it is Pᵀ M P, with P from
        `spm_pin.kinematics.parasitic_jacobian`.
    load : array_like, shape (..., 6); for a stage (..., 3), optional
        The wrench onto the platform besides [N, N m]; with `dynamics` from that call, ``-dynamics.bias -
        dynamics.gravity`` for the robot's own velocity and weight. For a stage it is Pᵀ w of a wrench w.

    Returns
    -------
    Polytope
        Time derivatives of the twist, or of the motion for a stage, [m/s², rad/s²] at o in {B}; at singularities as
        `wrench_polytope`.
    """
    bounds = _limits_of(configuration, force_limits, "force_limits", "efforts of the actuators", "N", "N m")
    check_configuration(configuration)
    forces = -motion_rows(platform_jacobian(configuration)).mT
    matrix = symmetric_matrices(mass, "mass", forces.shape[-1], "in kg, kg m, kg m²", allow_nan=True, positive=True)
    broadcastable("mass", matrix.shape[:-2], "the configuration", configuration.shape)
    offset = _taken(forces, load, "the configuration", configuration.shape) + np.zeros(matrix.shape[:-1])
    return _polytope(-forces @ matrix, bounds, offset, partial(_accelerations_of_forces, configuration, matrix))


def joint_reactions(configuration: Configuration) -> JointReactions:
    """Return the reactions in states (...) at the ball and revolute joints to a wrench onto the terminal platform.

    Weights and friction are left out, the structure is rigid. NaN for a member that does not exist; raises
    `SingularConfigurationError` at a forward or a constraint singularity, where the legs do not hold the platform.
    """
    check_configuration(configuration)
    rows = -stage_inverses(configuration).mT
    shape = rows.shape[:-3]
    legs = 3 * rows.shape[-3]
    along, axial = (rows[..., k, :].reshape(*shape, legs, 6) for k in (slice(3), slice(3, 6)))
    angles = np.pi * np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS
    ball = np.cos(angles) * along[..., None, :] + np.sin(angles) * axial[..., None, :]
    rods = np.linalg.norm(configuration.leg_vectors, axis=-1)
    arms = np.linalg.norm(configuration.balls - configuration.leg_bases, axis=-1)
    bending, pivot = (lever[..., None] * axial for lever in (rods, arms))
    return JointReactions(
        axial, bending, pivot, ball.reshape(*shape, legs * _DIRECTIONS, 6) / np.cos(0.5 * np.pi / _DIRECTIONS)
    )


def _limits_of(
    configuration: Configuration, value: npt.ArrayLike, argument: str, meaning: str, *units: str
) -> tuple[FloatArray, FloatArray]:
    """Return `leg_bounds` in the units of lengths and of angles that the legs of a configuration have."""
    legs = check_configuration(configuration).machine.legs
    return leg_bounds(value, argument, f"{meaning} in {legs.unit_text(*units)}", most=_MOST, count=len(legs.names))


def _taken(rows: FloatArray, load: npt.ArrayLike | None, other: str, shape: tuple[int, ...]) -> FloatArray:
    """Return by how much a load shifts the limits of rows (..., n, k); 0 without one."""
    if load is None:
        return np.zeros(rows.shape[:-1])
    wrench = real_array(load, "load", rows.shape[-1:], "(f, m) at o in {B} in N and N m", allow_nan=True)
    broadcastable("load", wrench.shape[:-1], other, shape)
    return np.asarray((rows @ wrench[..., None])[..., 0])


def _polytope(
    rows: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    offset: FloatArray,
    columns: Callable[[], FloatArray] | None,
) -> Polytope:
    lower, upper = (bound - offset for bound in bounds)
    return Polytope(np.broadcast_to(rows, (*lower.shape, rows.shape[-1])), lower, upper, columns)


def _wrenches_of_forces(configuration: Configuration) -> FloatArray:
    return -inverse_jacobian(configuration).mT


def _twists_of_rates(configuration: Configuration) -> FloatArray:
    return motion_rows(platform_jacobian(configuration))


def _accelerations_of_forces(configuration: Configuration, mass: FloatArray) -> FloatArray:
    absent = np.isnan(mass).any(axis=(-1, -2), keepdims=True)
    wrenches = np.where(absent, np.nan, inverse_jacobian(configuration).mT)
    return np.linalg.solve(np.where(absent, np.eye(mass.shape[-1]), mass), wrenches)
