"""The state of a closed chain: joint values and velocities, one or a batch, and all that is computed from them.

With the tree's mass matrix M, its nonlinear effects h, the Jacobian J of the closures' rows, the selection S of the
actuators, their forces τ, other generalized forces g and the forces λ of the rows,

    M a + h = Sᵀ τ + g + Jᵀ λ,    J a + J̇ v = 0.

Rows may depend on each other. Z, whose columns span the velocities that the closures admit, leaves λ out of it:

    a = a0 + Z y,    (Zᵀ M Z) y = Zᵀ (Sᵀ τ + g - h - M a0),    J a0 = -J̇ v.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.linalg import blas, lapack

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.loops.links import find_frame
from spm_pin.loops.null_space import NullSpace
from spm_pin.mechanism.arguments import FloatArray, IntArray, broadcastable, finite_array, real_array

AGREEMENT = 1e-9
"""Loops open by this share of the chain's size are taken for rounded, more for open."""
DEPENDENCE = 100.0
"""Rows that depend on each other in closed loops do so, in loops open by a gap, to about this times the gap."""
DETERMINED = 1e-9
"""Singular values below this of the map from freedoms, of scaled velocities of length one, to actuators are zero."""
COMPATIBLE = 1e-6
"""Largest disagreement of dependent rows on accelerations, relative to the terms; more at a singularity."""

_HATS = np.zeros((6, 16))
"""Rows of 4 x 4 matrices of the unit twists."""
_HATS[[0, 1, 2], [3, 7, 11]] = 1.0
_HATS[[3, 4, 5], [9, 2, 4]], _HATS[[3, 4, 5], [6, 8, 1]] = 1.0, -1.0

Result = TypeVar("Result")


class Energy(NamedTuple):
    """Energy of all moving bodies [J], floats or arrays (...)."""

    kinetic: Any
    """Kinetic energy [J]."""
    potential: Any
    """Potential energy of gravity [J], zero at the height of the universe's origin."""

    @property
    def total(self) -> Any:
        """Kinetic and potential energy together."""
        return self.kinetic + self.potential


class Drive(NamedTuple):
    """The singular value decomposition of A, admissible velocities (dof,) to scaled rates of the actuators (n,)."""

    scales: FloatArray
    left: FloatArray
    sizes: FloatArray
    right: FloatArray
    rank: int

    def inverse(self) -> FloatArray:
        """Return the least velocities for each rate, shape (dof, n)."""
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

    `q` (nq,) are the joint values of the last `evaluate`; `data`, a pinocchio.Data, has the joint placements, Jacobians
    and frames there, and other algorithms may work in it at the same q. Rows are those of the chain's closures and
    joint equalities, then one for each velocity of joints that are held. `rank` of them are independent; with None, as
    many as seem so at q, which is right in closed loops alone.
    """

    def __init__(self, chain: Any) -> None:
        self.model, self.rows, self.actuated = chain.model, chain.rows, chain.actuated_in_v
        self.data = self.model.createData()
        self.q, self.zero_velocity = np.zeros(0), np.zeros(self.model.nv)
        self._values: bytes | None = None
        self.rank: int | None = None
        rows, nv, held = self.rows, self.model.nv, chain.indices_in_v(*chain.held)
        self._held = np.eye(nv)[held]
        self.labels = (*rows.labels, *(name for name in chain.held for _ in chain.indices_in_v(name)))
        self.row_units = np.concatenate([rows.row_units, rows.units[held]])
        self.units = rows.units
        # Work of all weights in a step of order one.
        mass = sum(inertia.mass for inertia in self.model.inertias)
        self.weight = float(mass * np.linalg.norm(self.model.gravity.linear) * rows.size)
        # A free base, and other joints that are neither in a loop nor actuated, stand still where actuators have rates.
        in_loops = np.concatenate([np.flatnonzero(rows.signs.any(axis=0)), *rows.equality_places[:, [1, 3]]])
        self.base = np.setdiff1d(np.arange(nv), np.concatenate([in_loops, self.actuated, held]))
        # For each closure, which velocities move its first frame.
        self._first = np.zeros((len(rows.closures), nv))
        for moved, (first, _) in zip(self._first, rows.joints, strict=True):
            for joint in [self.model.joints[j] for j in list(self.model.supports[first])[1:]]:
                moved[joint.idx_v : joint.idx_v + joint.nv] = 1.0

    def evaluate(self, q: FloatArray) -> None:
        """Evaluate the kinematics at q (nq,), unless q is unchanged."""
        values, self.q = q.tobytes(), q
        if values == self._values:
            return
        self._values = None
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        self._values = values
        known = self.__dict__
        for name in _CACHED:
            known.pop(name, None)

    @cached_property
    def _placed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        placed: tuple[FloatArray, FloatArray, FloatArray] = self.rows.placements_of(self.data)
        return placed

    @cached_property
    def residual(self) -> FloatArray:
        """Left side of each equation [m, rad], shape (m,)."""
        return np.concatenate([self.rows.left_sides(self.q, self._placed[2]), np.zeros(len(self._held))])

    @cached_property
    def jacobian(self) -> FloatArray:
        """J, joint velocities (nv,) to the rates of the left sides, shape (m, nv); exact at any q."""
        rows = self.rows.jacobian(self.q, self.data, self._placed)
        return np.concatenate([rows, self._held]) if len(self._held) else rows

    def bias(self, v: FloatArray) -> FloatArray:
        """Return J̇ v (m,), the second derivatives of the left sides where no joint accelerates; exact at any q."""
        rows, data = self.rows, self.data
        pin.computeJointJacobiansTimeVariation(self.model, data, self.q, v)
        across, count = (rows.signs * v).T, len(rows.joints)
        columns = [data.J.dot(across), data.dJ.dot(across), data.J.dot((self._first * v).T)]
        hats = np.concatenate(columns, axis=1).T.dot(_HATS).reshape(3, count, 4, 4)
        relative, change, first = hats
        # X = M1⁻¹ M2 of the placements in the world; its second derivative is M1⁻¹ (...) M2, with a last row of zeros.
        inner = (change + relative @ (relative + first) - first @ relative)[:, :3]
        axes, tip, placed = self._placed
        moved = np.array(placed)
        moved[:, :3, :3], moved[:, :3, 3] = axes @ placed[:, :3, :3], tip
        second = axes.swapaxes(1, 2) @ inner @ moved
        # Left sides of closures are linear in X.
        bias = np.concatenate([rows.left_sides(self.q, second), np.zeros(len(self._held))])
        for k, (_, _, place, driver) in enumerate(rows.equality_places.tolist()):
            curvature = np.polynomial.Polynomial(rows.polynomials[k]).deriv(2) if driver >= 0 else np.zeros_like
            bias[len(rows.forms) + k] = -curvature(self.q[place] - rows.zeros[k, 1]) * v[driver] ** 2
        return bias

    @cached_property
    def widest_gap(self) -> float:
        """Largest residual of a row, relative to its unit."""
        return largest(self.residual / self.row_units)

    @cached_property
    def space(self) -> NullSpace:
        """The velocities that the closures admit."""
        return NullSpace(self.jacobian, self.row_units, self.units, DEPENDENCE * self.widest_gap, self.rank)

    @cached_property
    def actuation(self) -> Drive:
        """What the actuators drive."""
        return self._drive(self.actuated)

    @cached_property
    def rates(self) -> Drive:
        """What the actuators drive where a free base stands still; the base's own velocities count as driven."""
        return self._drive(np.concatenate([self.actuated, self.base])) if len(self.base) else self.actuation

    def _drive(self, places: IntArray) -> Drive:
        scales = self.units.take(places)
        left, sizes, right = np.linalg.svd(self.space.basis.take(places, axis=0) / scales[:, None])
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
        loose = self.undriven
        if not loose.shape[1]:
            return
        moved = loose / self.units[:, None] if rows is None else rows @ loose
        size = 1.0 if rows is None else np.abs(rows * self.units).sum(axis=1).max(initial=0.0)
        if np.abs(moved).max() > DETERMINED * size:
            sigma = float(self.rates.sizes[-1]) if self.rates.rank < len(self.rates.sizes) else 0.0
            joints = ", ".join(self.moving_joints(loose)[:4])
            raise SingularConfigurationError("forward", sigma, cause=f"Not driven: {joints}")

    def moving_joints(self, velocities: FloatArray) -> list[str]:
        """Return the names of the joints that move in any of the columns of velocities (nv, any)."""
        sizes = np.abs(velocities / self.units[:, None]).max(axis=1, initial=0.0)
        joints = zip(self.model.names[1:], self.model.joints[1:], strict=True)
        return [name for name, j in joints if sizes[j.idx_v : j.idx_v + j.nv].max() > DETERMINED * sizes.max()]

    def frame_jacobian(self, frame: int) -> FloatArray:
        """Return the Jacobian (6, nv) of a frame, at its origin in the universe's axes."""
        return np.asarray(pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED))

    def mass_matrix(self) -> FloatArray:
        """Return M (nv, nv)."""
        half = np.triu(pin.crba(self.model, self.data, self.q))
        return np.asarray(half + np.triu(half, 1).T)

    def energies(self, v: FloatArray) -> tuple[float, float]:
        """Return the kinetic and the potential energy of the bodies [J]."""
        kinetic = pin.computeKineticEnergy(self.model, self.data, self.q, v)
        return float(kinetic), float(pin.computePotentialEnergy(self.model, self.data, self.q))

    def check_closed(self, v: FloatArray | None = None, argument: str = "v") -> None:
        """Raise unless q is closed and v keeps it so, to `AGREEMENT`."""
        if not self.widest_gap <= AGREEMENT:
            worst = int(np.abs(self.residual / self.row_units).argmax())
            cause = f"The widest is {self.labels[worst]}. Rounded or guessed joint values? close() assembles them"
            raise ClosureError(float(abs(self.residual[worst])), 0, cause)
        if v is not None and not self.space.is_admissible(v, 0.0, AGREEMENT):
            expected, received = "joint velocities that keep the loops closed", "velocities that open them"
            raise ArgumentError(argument, expected, received, "joint_rates makes them from rates of the actuators")

    def closing_acceleration(self, v: FloatArray) -> FloatArray:
        """Return the least accelerations a0 (nv,) with J a0 = -J̇ v, or raise where the rows contradict each other."""
        bias = self.bias(v)
        least, missed = self.space.solve(-bias)
        if missed and missed > COMPATIBLE * (largest(bias / self.row_units) + largest(v / self.units) ** 2):
            raise SingularConfigurationError("constraint", self.space.least)
        return least

    def accelerations(self, v: FloatArray, forces: FloatArray) -> FloatArray:
        """Return the joint accelerations (nv,) under generalized forces (nv,), gravity and the closures' forces."""
        model, data, q, basis = self.model, self.data, self.q, self.space.basis
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
                "model", "inertias of all that moves", f"motion without inertia, of {still} among others"
            )
        return np.asarray(least + basis.dot(free))


_CACHED = {name for name, member in vars(StateKinematics).items() if isinstance(member, cached_property)}


class LoopState:
    """Joint values q and velocities v of a `ClosedChain`, and what is computed from them.

    Made by its method `state` and moved on by `update`, without new memory: loops make one and update it. Of one q and
    v, kinematics, Jacobians and factorisations are computed once and kept for later calls; of a batch each call
    computes them anew, member by member. Arguments broadcast with the batch. A state is for one thread at a time.

    Twists (v, ω) [m/s, rad/s] and wrenches (f, m) [N, N m] are at the origin of a frame, in the axes of the world,
    linear first. `wrenches` are a mapping from names of frames to what acts there, (..., 6). Springs, damping and
    friction of joints are left out; armatures are part of the masses.

    Methods that use rates or forces take a closed q, and raise `SingularConfigurationError` at a singularity of the
    loops, where some velocities that their equations admit lead to no motion.

    Joints that the chain holds stand still. A free base does so where rates of the actuators are given, as all joints
    in no loop that are not actuated; in dynamics they move freely.

    Attributes
    ----------
    kinematics : StateKinematics
        Pinocchio's data, Jacobians and factorisations at a single q; do not change it.
    failures : dict of tuple of int to SpmError
        Of the last call for a batch: the `SingularConfigurationError` or `ClosureError` of each member that is NaN.
    """

    def __init__(self, chain: Any, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None:
        self._chain, self.kinematics = chain, StateKinematics(chain)
        self.failures: dict[tuple[int, ...], SpmError] = {}
        self._batch: tuple[int, ...] = ()
        self.update(q, v)

    def __repr__(self) -> str:
        several = f" of a batch of shape {self._batch}" if self._batch else ""
        return f"<{type(self).__name__}{several}: {self._chain.model.nv} degrees of freedom of the tree>"

    @property
    def q(self) -> FloatArray:
        """Joint values, shape (..., nq); a copy."""
        return self._q.copy()

    @property
    def v(self) -> FloatArray:
        """Joint velocities, shape (..., nv); a copy."""
        return self._v.copy()

    def update(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> Self:
        """Move to other joint values (..., nq) and velocities (..., nv), zero by default; return this state."""
        joints, rates = read_joint_values(self._chain.model, q), self.kinematics.zero_velocity
        if v is not None:
            rates = _vectors(v, "v", rates.size, "rates of the joints in Pinocchio's order").copy()
        if joints.ndim == rates.ndim == 1:
            self._batch, self._q, self._v = (), joints.copy(), rates
            self._move(self._q, rates)
        else:
            self._batch = broadcastable("v", rates.shape[:-1], "q", joints.shape[:-1])
            self._q, self._v = (np.broadcast_to(x, (*self._batch, x.shape[-1])).copy() for x in (joints, rates))
        return self

    def _move(self, q: FloatArray, v: FloatArray) -> None:
        """Set q (nq,) and v (nv,) for the functions that `_each_member` runs."""
        self.kinematics.evaluate(q)
        self._rates, self._is_closed = v, False

    def _each_member(
        self, function: Callable[..., Result], shape: tuple[int, ...] | list[tuple[int, ...]], **arrays: FloatArray
    ) -> Result:
        """Return the results of a function of one q and v, and of one member of each array, for all members.

        `shape` is that of a result, or a list of shapes if the function returns several. For a single state and single
        arguments, the function's own result is returned.
        """
        if not self._batch and all(array.ndim == 1 for array in arrays.values()):
            return function(*arrays.values())
        batch = self._batch
        for name, array in arrays.items():
            batch = broadcastable(name, array.shape[:-1], "the other arguments", batch)
        members = [np.broadcast_to(x, (*batch, x.shape[-1])) for x in (self._q, self._v, *arrays.values())]
        results: Any = [np.full((*batch, *each), np.nan) for each in (shape if isinstance(shape, list) else [shape])]
        self.failures = {}
        for index in np.ndindex(batch):
            q, v, *arguments = (array[index] for array in members)
            if self._batch:
                self._move(q, v)
            try:
                result: Any = function(*arguments)
            except (SingularConfigurationError, ClosureError) as error:
                self.failures[index] = error
                continue
            except ArgumentError as error:
                received = f"{error.received} at batch index {index}"
                raise type(error)(error.argument, error.expected, received, error.cause) from error
            for array, value in zip(results, result if isinstance(shape, list) else [result], strict=True):
                array[index] = value
        outcome: Result = results if isinstance(shape, list) else results[0]
        return outcome

    def _each_closed_member(self, function: Callable[..., Result], shape: Any, **arrays: FloatArray) -> Result:
        """Return the same as `_each_member` for a function that takes a regular q, closed, and v that keeps it so."""
        from spm_pin.loops.mobility import check_regular

        def member(*arguments: FloatArray) -> Result:
            if not self._is_closed:
                self.kinematics.check_closed(self._rates)
                check_regular(self._chain, self.kinematics)
                self._is_closed = True
            return function(*arguments)

        return self._each_member(member, shape, **arrays)

    def gap(self) -> FloatArray:
        """Return the residual of each row of the closures and joint equalities [m, rad], shape (..., m)."""
        return self._each_member(lambda: self.kinematics.residual[: self._rows].copy(), (self._rows,))

    def constraint_jacobian(self) -> FloatArray:
        """Return the derivative of `gap` by the joints' motion, shape (..., m, nv); exact at any q."""
        return self._each_member(lambda: self.kinematics.jacobian[: self._rows].copy(), (self._rows, self._nv))

    def energy(self) -> Energy:
        """Return the kinetic and the potential energy (...) [J] of all bodies, closed or not."""
        return Energy(*self._each_member(lambda: self.kinematics.energies(self._rates), [(), ()]))

    def joint_jacobian(self) -> FloatArray:
        """Return the map from rates of the actuators to velocities of all joints, shape (..., nv, n).

        Raises `SingularConfigurationError` where the actuators do not determine them. With more actuators than
        freedoms, rates that contradict each other are mapped to the closest that do not.
        """

        def member() -> FloatArray:
            self.kinematics.check_driven()
            return self.kinematics.joint_jacobian()

        return self._each_closed_member(member, (self._nv, self._count))

    def joint_rates(self, actuator_rates: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints (..., nv) for rates of the actuators (..., n).

        Raises as `joint_jacobian`, and `ArgumentError` for rates that contradict each other.
        """
        rates = self._actuator_values(actuator_rates, "actuator_rates")
        return self._each_closed_member(lambda r: self._driven(r, "actuator_rates"), (self._nv,), actuator_rates=rates)

    def joint_accelerations(self, actuator_accelerations: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (..., nv) for those of the actuators (..., n).

        A free base does not accelerate. Raises as `joint_rates`.
        """

        def member(accelerations: FloatArray) -> FloatArray:
            least = self.kinematics.closing_acceleration(self._rates)
            return least + self._driven(accelerations, "actuator_accelerations", least)

        values = self._actuator_values(actuator_accelerations, "actuator_accelerations")
        return self._each_closed_member(member, (self._nv,), actuator_accelerations=values)

    def _driven(self, values: FloatArray, argument: str, least: FloatArray | None = None) -> FloatArray:
        """Return the admissible rates (nv,) that, added to `least`, move the actuators with `values`."""
        kinematics = self.kinematics
        kinematics.check_driven()
        wanted = np.concatenate([values, np.zeros(len(kinematics.base))])
        if least is not None:
            wanted -= least.take(np.concatenate([kinematics.actuated, kinematics.base]))
        rates, missed = kinematics.rates.solve(wanted)
        if missed > AGREEMENT * max(largest(wanted / kinematics.rates.scales), largest(rates)):
            expected = "values on which the closures agree"
            cause = "There are more actuators than freedoms, or loops lock one: see mobility"
            raise ArgumentError(argument, expected, f"values that are {missed:.1e} off", cause)
        return np.asarray(kinematics.space.basis.dot(rates))

    def actuator_jacobian(self, frame: str) -> FloatArray:
        """Return the map from rates of the actuators to the twist of a frame, shape (..., 6, n).

        Raises `SingularConfigurationError` where the actuators do not determine the twist. Joints that do not move the
        frame, such as spins of rods, need no actuator. More actuators than freedoms are treated as in `joint_jacobian`.
        """
        index = self._frame(frame)

        def member() -> FloatArray:
            jacobian = self.kinematics.frame_jacobian(index)
            self.kinematics.check_driven(jacobian)
            return np.asarray(jacobian @ self.kinematics.joint_jacobian())

        return self._each_closed_member(member, (6, self._count))

    def twist(self, frame: str) -> FloatArray:
        """Return the twist of a frame, shape (..., 6)."""
        index = self._frame(frame)
        return self._each_member(lambda: self.kinematics.frame_jacobian(index) @ self._rates, (6,))

    def frame_acceleration(self, frame: str, a: npt.ArrayLike) -> FloatArray:
        """Return the time derivative of the twist of a frame (..., 6) for joint accelerations (..., nv)."""
        index = self._frame(frame)

        def member(a: FloatArray) -> FloatArray:
            kinematics = self.kinematics
            pin.forwardKinematics(kinematics.model, kinematics.data, kinematics.q, self._rates, a)
            frames = kinematics.model, kinematics.data, index, pin.LOCAL_WORLD_ALIGNED
            return np.array(pin.getFrameClassicalAcceleration(*frames).vector)

        return self._each_member(member, (6,), a=self._joint_vectors(a, "a"))

    def forward_dynamics(self, tau: npt.ArrayLike, wrenches: Mapping[str, npt.ArrayLike] | None = None) -> FloatArray:
        """Return the accelerations of all joints (..., nv) under actuators, gravity and wrenches.

        `tau` (..., n) [N, N m] is in the order of the actuators.
        """

        def member(tau: FloatArray, *loads: FloatArray) -> FloatArray:
            return self.kinematics.accelerations(self._rates, self._forces(tau, frames, loads))

        frames, arrays = self._read_wrenches(wrenches)
        return self._each_closed_member(member, (self._nv,), tau=self._actuator_values(tau, "tau"), **arrays)

    def inverse_dynamics(self, a: npt.ArrayLike, wrenches: Mapping[str, npt.ArrayLike] | None = None) -> FloatArray:
        """Return the forces of the actuators (..., n) [N, N m] for a motion under gravity, inertia and wrenches.

        The accelerations `a` (..., nv) are those of closed loops: of `forward_dynamics`, or of `joint_accelerations`.
        With more actuators than freedoms, the least forces. Raises `ArgumentError` for accelerations that no forces of
        the actuators cause, as may be with fewer.
        """

        def member(a: FloatArray, *loads: FloatArray) -> FloatArray:
            kinematics, v = self.kinematics, self._rates
            bias, size = kinematics.bias(v), largest(v / self.kinematics.units)
            if not kinematics.space.is_admissible(a, bias, AGREEMENT, size * size):
                expected, received = "joint accelerations that keep the loops closed", "accelerations that open them"
                cause = "joint_accelerations makes them from those of the actuators"
                raise ArgumentError("a", expected, received, cause)
            return self._balance(pin.rnea(kinematics.model, kinematics.data, kinematics.q, v, a), frames, loads)

        frames, arrays = self._read_wrenches(wrenches)
        return self._each_closed_member(member, (self._count,), a=self._joint_vectors(a, "a"), **arrays)

    def holding_forces(self, wrenches: Mapping[str, npt.ArrayLike] | None = None) -> FloatArray:
        """Return the forces of the actuators (..., n) [N, N m] at rest, under gravity and wrenches.

        With more actuators than freedoms, the least. Raises `ArgumentError` where the actuators do not hold the chain.
        """

        def member(*loads: FloatArray) -> FloatArray:
            kinematics = self.kinematics
            weights = pin.computeGeneralizedGravity(kinematics.model, kinematics.data, kinematics.q)
            return self._balance(weights, frames, loads)

        frames, arrays = self._read_wrenches(wrenches)
        return self._each_closed_member(member, (self._count,), **arrays)

    def actuator_forces(self, joint_forces: npt.ArrayLike) -> FloatArray:
        """Return the forces of the actuators (..., n) that do the same work as forces of all joints (..., nv).

        It maps torques of a leg's serial joints, as a policy commands them, to its motors; masses and weights play no
        part. With more actuators than freedoms, the least. Raises as `holding_forces`.
        """
        forces = self._joint_vectors(joint_forces, "joint_forces")
        return self._each_closed_member(lambda g: self._balance(g, [], ()), (self._count,), joint_forces=forces)

    def _balance(self, forces: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        """Return the least actuator forces (n,) that do the work of generalized ones (nv,), less that of wrenches."""
        kinematics = self.kinematics
        for frame, load in zip(frames, loads, strict=True):
            forces = forces - kinematics.frame_jacobian(frame).T.dot(load)
        basis = kinematics.space.basis
        wanted = basis.T.dot(forces)
        tau, missed = kinematics.actuation.solve_transposed(wanted)
        if missed > AGREEMENT * largest(wanted):
            # Weights, too, may cancel, as in free fall.
            size = largest(np.abs(basis).T.dot(np.abs(forces))) + kinematics.weight
            if missed > AGREEMENT * size:
                loose = kinematics.moving_joints(basis @ kinematics.actuation.right[kinematics.actuation.rank :].T)
                expected = "forces that the actuators can bear"
                cause = "Fewer actuators than freedoms, or a singular configuration: see mobility"
                raise ArgumentError("forces", expected, f"others in {', '.join(loose[:4])}", cause)
        return tau

    def constraint_forces(self, tau: npt.ArrayLike, wrenches: Mapping[str, npt.ArrayLike] | None = None) -> FloatArray:
        """Return the forces λ of the rows of `gap` (..., m) [N, N m] while actuators, gravity and wrenches act.

        `constraint_jacobian` transposed maps them to generalized forces. Where rows depend on each other, the closures
        share loads in more than one way, and the least forces are returned, moments in units of the chain's length.
        """

        def member(tau: FloatArray, *loads: FloatArray) -> FloatArray:
            kinematics, forces = self.kinematics, self._forces(tau, frames, loads)
            a = kinematics.accelerations(self._rates, forces)
            missing = pin.rnea(kinematics.model, kinematics.data, kinematics.q, self._rates, a) - forces
            return kinematics.space.row_forces(missing)[: self._rows]

        frames, arrays = self._read_wrenches(wrenches)
        return self._each_closed_member(member, (self._rows,), tau=self._actuator_values(tau, "tau"), **arrays)

    def actuator_mass(self) -> FloatArray:
        """Return the mass matrix of all bodies in the actuators' coordinates, shape (..., n, n).

        Times accelerations of the actuators it is, at rest, what moves the masses; a free base is held. Raises as
        `joint_jacobian`.
        """

        def member() -> FloatArray:
            self.kinematics.check_driven()
            mapped = self.kinematics.joint_jacobian()
            mass = mapped.T @ self.kinematics.mass_matrix() @ mapped
            return np.asarray(0.5 * (mass + mass.T))

        return self._each_closed_member(member, (self._count, self._count))

    @property
    def _nv(self) -> int:
        return int(self._chain.model.nv)

    @property
    def _rows(self) -> int:
        return int(self.kinematics.rows.count)

    @property
    def _count(self) -> int:
        return len(self.kinematics.actuated)

    def _frame(self, name: str) -> int:
        return frame_index(self._chain.model, name)

    def _actuator_values(self, value: npt.ArrayLike, argument: str) -> FloatArray:
        return _vectors(value, argument, self._count, "one for each actuator, in the order of `actuated`")

    def _joint_vectors(self, value: npt.ArrayLike, argument: str) -> FloatArray:
        return _vectors(value, argument, self._nv, "one for each degree of freedom in Pinocchio's order")

    def _read_wrenches(self, wrenches: Mapping[str, npt.ArrayLike] | None) -> tuple[list[int], dict[str, FloatArray]]:
        """Return the indices of the frames, and the wrenches as arguments of `_each_member`."""
        if wrenches is None:
            return [], {}
        if not isinstance(wrenches, Mapping):
            expected = "a mapping from frames to wrenches, as {'foot': (fx, fy, fz, mx, my, mz)}"
            raise ArgumentError("wrenches", expected, type(wrenches).__name__)
        meaning = "(f, m) in N and N m in the axes of the world"
        arrays = {f"wrenches[{name!r}]": value for name, value in wrenches.items()}
        return [self._frame(name) for name in wrenches], {
            argument: _vectors(value, argument, 6, meaning) for argument, value in arrays.items()
        }

    def _forces(self, tau: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        """Return generalized forces (nv,) of actuators (n,) and of wrenches."""
        forces = np.zeros(self._nv)
        np.add.at(forces, self.kinematics.actuated, tau)
        for frame, load in zip(frames, loads, strict=True):
            forces += self.kinematics.frame_jacobian(frame).T.dot(load)
        return forces


def frame_index(model: Any, name: str) -> int:
    """Return the index of a frame of a model, or raise `ArgumentError`."""
    frame = find_frame(model, name) if isinstance(name, str) else None
    if frame is None:
        names = [frame.name for frame in model.frames]
        close = difflib.get_close_matches(str(name), names, n=3)
        cause = f"Did you mean {' or '.join(map(repr, close))}?" if close else f"Frames are {', '.join(names[:12])}"
        raise ArgumentError("frame", "the name of a frame of the model", repr(name), cause)
    return frame


def read_joint_values(model: Any, q: npt.ArrayLike, argument: str = "q") -> FloatArray:
    """Return joint values (..., nq) with quaternions of length one, or raise `ArgumentError`."""
    array = _vectors(q, argument, model.nq, "joint values in rad and m in Pinocchio's order")
    if model.nq == model.nv:
        return array
    flat = array.reshape(-1, model.nq)
    if not all(pin.isNormalized(model, row, 1e-6) for row in flat):
        expected = "unit quaternions (x, y, z, w) of free and ball joints"
        raise ArgumentError(argument, expected, "others", "pinocchio.neutral(model) has them, zeros do not")
    return np.array([pin.normalize(model, row) for row in flat]).reshape(array.shape)


def _vectors(value: npt.ArrayLike, argument: str, size: int, meaning: str) -> FloatArray:
    """Return vectors (..., size) as float64, or raise `ArgumentError`."""
    if type(value) is np.ndarray and value.shape == (size,) and value.dtype == np.float64:
        # For the single vectors of control loops an eighth of the time of NumPy's own tests.
        return value if math.isfinite(sum(value.tolist())) else finite_array(value, argument, (size,), meaning)
    return real_array(value, argument, (size,), meaning)


def largest(vector: FloatArray) -> float:
    """Return the largest absolute value of a short vector: quicker than NumPy."""
    return float(max(map(abs, vector.tolist()), default=0.0))
