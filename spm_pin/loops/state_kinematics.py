"""A tree with closures at one configuration: equations, their derivatives, admissible velocities and what drives them.

All that a `LoopState` computes of one configuration is kept here until the next. With the tree's mass matrix M, its
nonlinear effects h, the Jacobian J of the closures' rows, generalized forces g and the forces λ of the rows,

    M a + h = g + Jᵀ λ,    J a + J̇ v = 0.

Rows may depend on each other. Z, whose columns span the velocities that the closures admit, leaves λ out of it:

    a = a0 + Z y,    (Zᵀ M Z) y = Zᵀ (g - h - M a0),    J a0 = -J̇ v.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.linalg import blas, lapack

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.loops.closures import find_frame
from spm_pin.loops.null_space import NullSpace
from spm_pin.loops.point_closures import PointDynamics, PointRows
from spm_pin.support.arguments import FloatArray, IntArray, finite_array, likely_names, real_array

AGREEMENT = 1e-9
"""Loops open by this share of the chain's size are taken for rounded, more for open."""
DEPENDENCE = 100.0
"""Rows that depend on each other in closed loops do so, in loops open by a gap, to about this times the gap."""
DETERMINED = 1e-9
"""Singular values below this of the map from freedoms, of scaled velocities of length one, to actuators are zero."""
COMPATIBLE = 1e-6
"""Largest disagreement of dependent rows on accelerations, relative to the terms; more at a singularity."""

JOINT_VALUES = "joint values in rad and m in Pinocchio's order"
LEAST_INERTIA = 1e-9
"""Smallest eigenvalue of the tree's mass matrix, relative to the largest, at which motions of the tree have inertia."""

_DOUBLE = np.dtype(np.float64)
_HATS = np.zeros((6, 16))
"""Rows of 4 x 4 matrices of the unit twists."""
_HATS[[0, 1, 2], [3, 7, 11]] = 1.0
_HATS[[3, 4, 5], [9, 2, 4]], _HATS[[3, 4, 5], [6, 8, 1]] = 1.0, -1.0


class Drive(NamedTuple):
    """The singular value decomposition of A, admissible velocities (dof,) to scaled rates of the actuators (n,)."""

    scales: FloatArray
    left: FloatArray
    sizes: FloatArray
    right: FloatArray
    rank: int

    def inverse(self) -> FloatArray:
        """Return the pseudoinverse of A (dof, n): minimum-norm admissible velocities for unit actuator rates."""
        left, right = self.left[:, : self.rank] / self.sizes[: self.rank], self.right[: self.rank]
        return np.asarray(right.T @ left.T / self.scales)

    def solve(self, rates: FloatArray) -> tuple[FloatArray, float]:
        """Return the least velocities (dof,) for rates (n,), and how far the rates are off, scaled."""
        scaled = rates / self.scales
        parts = scaled.dot(self.left)
        velocities = (parts[: self.rank] / self.sizes[: self.rank]).dot(self.right[: self.rank])
        return velocities, largest(self.left[:, self.rank :].dot(parts[self.rank :]))

    def solve_transposed(self, work: FloatArray) -> tuple[FloatArray, float]:
        """Return the least actuator forces (n,) of generalized forces (dof,), and how far these are out of reach."""
        parts = self.right.dot(work)
        forces = self.left[:, : self.rank].dot(parts[: self.rank] / self.sizes[: self.rank])
        return forces / self.scales, largest(parts[self.rank :])


class StateKinematics:
    """Residuals, Jacobians and factorisations of a chain at one q, each computed on first use.

    `q` (nq,) are the joint values of the last `evaluate`. Rows are those of the chain's closures and
    joint equalities, then one for each velocity of joints that are held. `rank` of them are independent; with None, as
    many as seem so at q, which is right in closed loops alone.
    """

    remedy = "close() assembles them"
    """Advice in the error for open loops."""

    def __init__(self, chain: Any, actuated: IntArray | None = None) -> None:
        """Take the chain's actuators, or velocities that others drive as well."""
        self.model, self.rows = chain.model, chain.rows
        self.actuated: IntArray = chain.actuated_in_v if actuated is None else actuated
        self._chain, self._data = chain, self.model.createData()
        self.q, self.zero_velocity = np.zeros(0), np.zeros(self.model.nv)
        self._values, self._has_placements = b"", False
        members = (item for kind in type(self).__mro__ for item in vars(kind).items())
        self._cached = {name for name, member in members if isinstance(member, cached_property)} - {"point_dynamics"}
        self.rank: int | None = None
        rows, nv, held = self.rows, self.model.nv, chain.indices_in_v(*chain.held)
        self._held = np.eye(nv)[held]
        self._points = PointRows(rows) if rows.are_points and not chain.held else None
        self.labels = (*rows.labels, *(name for name in chain.held for _ in chain.indices_in_v(name)))
        self.row_units = np.concatenate([rows.row_units, rows.units[held]])
        self.units = rows.units
        self._scale = self.units / self.row_units[:, None]
        # Work of all weights in a step of order one.
        mass = sum(inertia.mass for inertia in self.model.inertias)
        self.weight = float(mass * np.linalg.norm(self.model.gravity.linear) * rows.size)
        # A free base, and other joints that are neither in a loop nor actuated, stand still where actuators have rates.
        in_loops = np.concatenate([np.flatnonzero(rows.signs.any(axis=0)), *rows.equality_places[:, [1, 3]]])
        self.base = np.setdiff1d(np.arange(nv), np.concatenate([in_loops, self.actuated, held]))
        self._compiled: Any = None
        self._bare = 0  # number of attributes while no member is cached
        self._bare = len(self.__dict__)

    def evaluate(self, q: FloatArray) -> None:
        """Move to q (nq,); what is known of the same q is kept."""
        values, self.q = q.tobytes(), q
        if values != self._values:
            self._values, self._has_placements = values, False
            if len(self.__dict__) > self._bare:
                for name in self._cached & self.__dict__.keys():
                    del self.__dict__[name]

    @property
    def data(self) -> Any:
        """The pinocchio.Data with joint placements, Jacobians and frames; algorithms may work in it at the same q."""
        if not self._has_placements:
            self._place()
        return self._data

    def _place(self) -> None:
        """Compute placements and Jacobians, unless they are known."""
        if not self._has_placements:
            pin.computeJointJacobians(self.model, self._data, self.q)
            pin.updateFramePlacements(self.model, self._data)
            if self._points is not None:
                self._points.update(self._data)
            self._has_placements = True

    @cached_property
    def placed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Result of `ConstraintRows.placements_of`."""
        placed: tuple[FloatArray, FloatArray, FloatArray] = self.rows.placements_of(self.data)
        return placed

    @cached_property
    def residual(self) -> FloatArray:
        """Left side of each equation [m, rad], shape (m,)."""
        if self._points is not None:
            self._place()
            return self._points.residual()
        return np.concatenate([self.rows.left_sides(self.q, self.placed[2]), np.zeros(len(self._held))])

    @cached_property
    def jacobian(self) -> FloatArray:
        """J, joint velocities (nv,) to the rates of the left sides, shape (m, nv); exact at any q."""
        if self._points is not None:
            return self._points.jacobian(self.data)
        rows = self.rows.jacobian(self.q, self.data, self.placed)
        return np.concatenate([rows, self._held]) if len(self._held) else rows

    def bias(self, v: FloatArray) -> FloatArray:
        """Return J̇ v (m,), the second derivatives of the left sides where no joint accelerates; exact at any q."""
        rows, data = self.rows, self.data
        if self._points is not None:
            return self._points.bias(data, self.q, v, self.zero_velocity)
        pin.computeJointJacobiansTimeVariation(self.model, data, self.q, v)
        across, count = (rows.signs * v).T, len(rows.joints)
        columns = [data.J.dot(across), data.dJ.dot(across), data.J.dot((rows.moves[:, 0] * v).T)]
        hats = np.concatenate(columns, axis=1).T.dot(_HATS).reshape(3, count, 4, 4)
        relative, change, first = hats
        # X = M1⁻¹ M2 of the placements in the world; its second derivative is M1⁻¹ (...) M2, with a last row of zeros.
        inner = (change + relative @ (relative + first) - first @ relative)[:, :3]
        axes, tip, placed = self.placed
        moved = np.array(placed)
        moved[:, :3, :3], moved[:, :3, 3] = axes @ placed[:, :3, :3], tip
        second = axes.swapaxes(1, 2) @ inner @ moved
        # Left sides of closures are linear in X.
        bias = np.concatenate([rows.left_sides(self.q, second), np.zeros(len(self._held))])
        if len(rows.equalities):
            bias[len(rows.forms) : rows.count] = -rows.curves(self.q, 2) * v[rows.equality_places[:, 3]] ** 2
        return bias

    @cached_property
    def scaled_jacobian(self) -> FloatArray:
        """J, dimensionless, in units of rows and joints, shape (m, nv)."""
        return np.asarray(self.jacobian * self._scale)

    def is_admissible(self, rates: FloatArray, bias: FloatArray | None = None, extra: float = 0.0) -> bool:
        """Return whether J x + bias is zero, for rates x, to `AGREEMENT` of the largest of x, bias and `extra`."""
        scaled_rates, size = rates / self.units, extra
        opening = self.scaled_jacobian.dot(scaled_rates)
        if bias is not None:
            scaled_bias = bias / self.row_units
            opening, size = opening + scaled_bias, size + largest(scaled_bias)
        return largest(opening) <= AGREEMENT * (size + largest(scaled_rates))

    @cached_property
    def widest_gap(self) -> float:
        """Largest residual of a row, relative to its unit."""
        return largest(self.residual / self.row_units)

    @cached_property
    def space(self) -> NullSpace:
        """The velocities that the closures admit."""
        return NullSpace(self.scaled_jacobian, self.row_units, self.units, DEPENDENCE * self.widest_gap, self.rank)

    @property
    def are_independent(self) -> bool:
        """True if no row depends on others at q."""
        return self.space.rank == len(self.labels)

    @cached_property
    def actuation(self) -> Drive:
        """Admissible velocities driven by the actuators."""
        return self._drive(self.actuated)

    @cached_property
    def rates(self) -> Drive:
        """Admissible velocities driven by the actuators; the velocities of a free base count as driven ones."""
        return self._drive(np.concatenate([self.actuated, self.base])) if len(self.base) else self.actuation

    def _drive(self, places: IntArray) -> Drive:
        scales = self.units.take(places)
        if not len(places):
            return Drive(scales, np.zeros((0, 0)), np.zeros(0), np.eye(self.space.basis.shape[1]), 0)
        left, sizes, right, info = lapack.dgesdd(self.space.basis.take(places, axis=0) / scales[:, None])
        if info:
            raise np.linalg.LinAlgError("the singular values of the actuators do not converge")
        rank = sum(size > DETERMINED for size in sizes.tolist())
        return Drive(scales, left, sizes, right, rank)

    def joint_jacobian(self) -> FloatArray:
        """Return T, rates of the actuators to the least velocities of all joints, shape (nv, n)."""
        count = len(self.actuated)
        return np.asarray(self.space.basis @ self.rates.inverse()[:, :count])

    @cached_property
    def undriven(self) -> FloatArray:
        """Velocities that the closures admit where actuators and a free base stand still, shape (nv, any)."""
        return np.asarray(self.space.basis @ self.rates.right[self.rates.rank :].T)

    def check_driven(self, rows: FloatArray | None = None) -> None:
        """Raise unless the actuators determine the velocities of all joints, or of what `rows` (k, nv) maps them to."""
        if self.rates.rank == self.space.basis.shape[1]:
            return
        loose = self.undriven
        moved = loose / self.units[:, None] if rows is None else rows @ loose
        size = 1.0 if rows is None else np.abs(rows * self.units).sum(axis=1).max(initial=0.0)
        if np.abs(moved).max() > DETERMINED * size:
            sigma = float(self.rates.sizes[-1]) if self.rates.rank < len(self.rates.sizes) else 0.0
            joints = self.moving_joints(loose)[:4]
            cause = f"Not driven: {', '.join(joints)}"
            if any(self.model.joints[self.model.getJointId(name)].nq == 4 for name in joints):
                cause += ". A rod with a ball at each end spins: write one of them as two hinges"
            raise SingularConfigurationError("forward", sigma, cause=cause)

    def moving_joints(self, velocities: FloatArray) -> list[str]:
        """Return the names of the joints that move in any of the columns of velocities (nv, any)."""
        sizes = np.abs(velocities / self.units[:, None]).max(axis=1, initial=0.0)
        joints = zip(self.model.names[1:], self.model.joints[1:], strict=True)
        return [name for name, j in joints if sizes[j.idx_v : j.idx_v + j.nv].max() > DETERMINED * sizes.max()]

    def frame_jacobian(self, frame: int) -> FloatArray:
        """Return the Jacobian (6, nv) of a frame, at its origin in the universe's axes."""
        return np.asarray(pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED))

    def frame_acceleration(self, frame: int, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the time derivative of the twist (6,) of a frame, at its origin in the universe's axes."""
        pin.forwardKinematics(self.model, self.data, self.q, v, a)
        frames = self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED
        return np.array(pin.getFrameClassicalAcceleration(*frames).vector)

    def mass_matrix(self) -> FloatArray:
        """Return the joint-space mass matrix M, shape (nv, nv)."""
        half = np.triu(pin.crba(self.model, self.data, self.q))
        return np.asarray(half + np.triu(half, 1).T)

    def energies(self, v: FloatArray) -> tuple[float, float]:
        """Return the kinetic energy, that of armatures included, and the potential energy [J]."""
        # computeKineticEnergy of Pinocchio 4.1 leaves out armatures of hinges along no axis of their frames.
        kinetic = 0.5 * v.dot(self.mass_matrix().dot(v))
        return float(kinetic), float(pin.computePotentialEnergy(self.model, self.data, self.q))

    def check_closed(self, v: FloatArray | None = None, argument: str = "v") -> None:
        """Raise unless q is closed and v keeps it so, to `AGREEMENT`."""
        if not self.widest_gap <= AGREEMENT:
            gap, unit, loop = self.rows.widest(self.residual)
            cause = f"The widest is {loop}. Rounded or guessed joint values? {self.remedy}"
            raise ClosureError(gap, 0, cause, loop, unit)
        if v is not None and v is not self.zero_velocity and not self.is_admissible(v):
            expected, received = "joint velocities that keep the loops closed", "velocities that open them"
            raise ArgumentError(argument, expected, received, "joint_rates makes them from rates of the actuators")

    @cached_property
    def point_dynamics(self) -> PointDynamics | None:
        """Solver of accelerations for closures that are points, or None; used where their rows are independent."""
        if self._points is None:
            return None
        # It divides by the mass matrix of the tree, in which links without mass have no part; loops often have some.
        mass = np.triu(pin.crba(self.model, self.model.createData(), self._chain.q0)) * self.units
        sizes = np.linalg.eigvalsh(mass * self.units[:, None], UPLO="U")
        return PointDynamics(self.rows) if sizes[0] > LEAST_INERTIA * sizes[-1] else None

    def closing_acceleration(self, v: FloatArray) -> FloatArray:
        """Return the least accelerations a0 (nv,) with J a0 = -J̇ v, or raise where the rows contradict each other."""
        bias = self.bias(v)
        least, missed = self.space.solve(-bias)
        if missed and missed > COMPATIBLE * (largest(bias / self.row_units) + largest(v / self.units) ** 2):
            raise SingularConfigurationError("constraint", self.space.least)
        return least

    def accelerate(self, q: FloatArray, v: FloatArray, forces: FloatArray) -> bool:
        """Replace forces by `accelerations` of one member or several, flat arrays; return whether it is done.

        It is not if nothing is compiled, or a state is not regular and closed.
        """
        if self._compiled is None:
            if not self._chain.dynamics.is_loaded:
                return False
            self._compiled = self._chain.dynamics.call
        chain, rank = self._chain, -1 if self.rank is None else self.rank
        return bool(self._compiled(chain.tree, q, v, forces, rank, chain.regular_dof))

    def accelerations(self, v: FloatArray, forces: FloatArray) -> FloatArray:
        """Return the joint accelerations (nv,) under generalized forces (nv,), gravity and the closures' forces."""
        model, data, q = self.model, self.data, self.q
        if self.point_dynamics is not None and self.are_independent:
            return self.point_dynamics.accelerations(q, v, forces)
        basis = self.space.basis
        least = self.closing_acceleration(v)
        if not basis.shape[1]:
            return least
        # One triangle of M is filled.
        mass = np.asfortranarray(pin.crba(model, data, q))
        reflected = basis.T.dot(blas.dsymm(1.0, mass, basis))
        rest = forces - pin.nonLinearEffects(model, data, q, v) - blas.dsymv(1.0, mass, least)
        _, free, info = lapack.dposv(reflected, basis.T.dot(rest))
        if info:
            still = ", ".join(self.moving_joints(basis)[:4])
            raise ArgumentError(
                "model", "inertias for all moving links", f"a motion without inertia, which moves {still}"
            )
        return np.asarray(least + basis.dot(free))


def frame_index(model: Any, name: str, argument: str = "frame") -> int:
    """Return the index of a frame of a model, or raise `ArgumentError`."""
    frame = find_frame(model, name) if isinstance(name, str) else None
    if frame is None:
        names = [frame.name for frame in model.frames]
        cause = likely_names(name, names, f"Frames are {', '.join(names[:12])}")
        raise ArgumentError(argument, "the name of a frame of the model", repr(name), cause)
    return frame


def read_joint_values(model: Any, q: npt.ArrayLike, argument: str = "q") -> FloatArray:
    """Return joint values (..., nq) with quaternions of length one, or raise `ArgumentError`."""
    array = read_vectors(q, argument, model.nq, JOINT_VALUES)
    if model.nq == model.nv:
        return array
    if array.ndim == 1 and pin.isNormalized(model, array, 1e-6):
        return np.asarray(pin.normalize(model, array))
    flat = array.reshape(-1, model.nq)
    if not all(pin.isNormalized(model, row, 1e-6) for row in flat):
        expected = "unit quaternions (x, y, z, w) of free and ball joints"
        raise ArgumentError(
            argument, expected, "quaternions of another length", "pinocchio.neutral(model) has them, zeros do not"
        )
    return np.array([pin.normalize(model, row) for row in flat]).reshape(array.shape)


def read_vectors(value: npt.ArrayLike, argument: str, size: int, meaning: str) -> FloatArray:
    """Return vectors (..., size) as float64, or raise `ArgumentError`."""
    if type(value) is np.ndarray and value.shape == (size,) and value.dtype is _DOUBLE:
        # For the single vectors of control loops an eighth of the time of NumPy's own tests.
        return value if math.isfinite(sum(value.tolist())) else finite_array(value, argument, (size,), meaning)
    return real_array(value, argument, (size,), meaning)


def largest(vector: FloatArray) -> float:
    """Return the largest absolute value of a short vector: quicker than NumPy."""
    return float(max(map(abs, vector.tolist()), default=0.0))
