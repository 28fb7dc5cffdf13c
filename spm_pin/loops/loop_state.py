"""The state of a closed chain: joint values and velocities, one or a batch, and all that is computed from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.loops.mobility import check_regular
from spm_pin.loops.state_kinematics import (
    AGREEMENT,
    JOINT_VALUES,
    StateKinematics,
    frame_index,
    largest,
    read_joint_values,
    read_vectors,
)
from spm_pin.support.arguments import FloatArray, broadcastable
from spm_pin.support.compiling import forced

MANY = 5000
"""Largest batch whose dynamics are computed by Pinocchio and NumPy, in about a second, if the kernel is not loaded."""

Result = TypeVar("Result")
ResultShape = tuple[int, ...] | list[tuple[int, ...]]
"""The shape of a result, or those of several."""


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


class TreeState:
    """State (q, v) of a tree with closures; base of those of `loops` and of `multibody`, which differ in arguments."""

    _kept_argument: ClassVar[str] = ""
    """Argument whose errors are kept in `failures` for a batch, as singularities and open loops are; others raise."""

    def __init__(self, chain: Any, kinematics: StateKinematics) -> None:
        self._chain, self.kinematics, self._is_flat = chain, kinematics, chain.model.nq == chain.model.nv
        self._nv = chain.model.nv
        self._q, self._v = kinematics.q, kinematics.zero_velocity
        self._batch: tuple[int, ...] = ()
        self.failures: dict[tuple[int, ...], SpmError] = {}

    def __repr__(self) -> str:
        several = f" of a batch of shape {self._batch}" if self._batch else ""
        return f"<{type(self).__name__}{several}: {self._nv} degrees of freedom of the tree>"

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
        joints, rates = self._read_q(q), self.kinematics.zero_velocity
        if v is not None:
            rates = read_vectors(v, "v", self._nv, "rates of the joints in Pinocchio's order").copy()
        if joints.ndim == rates.ndim == 1:
            self._batch, self._q, self._v = (), joints.copy(), rates
            self._move(self._q, rates)
        else:
            self._batch = broadcastable("v", rates.shape[:-1], "q", joints.shape[:-1])
            self._q, self._v = (np.broadcast_to(x, (*self._batch, x.shape[-1])).copy() for x in (joints, rates))
        return self

    def _read_q(self, q: npt.ArrayLike) -> FloatArray:
        if self._is_flat:
            return read_vectors(q, "q", self._nv, JOINT_VALUES)
        return read_joint_values(self._chain.model, q)

    def _move(self, q: FloatArray, v: FloatArray) -> None:
        """Move to q (nq,) and v (nv,) for the functions of a single state."""
        self.kinematics.evaluate(q)
        self._rates, self._is_closed = v, False

    def _each_member(self, function: Callable[..., Result], shape: ResultShape, **arrays: FloatArray) -> Result:
        """Return the results of a function of one q and v, and of one member of each array, for all members.

        For a single state and single arguments, the function's own result is returned.
        """
        if not self._batch and all(array.ndim == 1 for array in arrays.values()):
            return function(*arrays.values())
        batch, shapes = self._batch, shape if isinstance(shape, list) else [shape]
        for name, array in arrays.items():
            batch = broadcastable(name, array.shape[:-1], "the other arguments", batch)
        members = [np.broadcast_to(x, (*batch, x.shape[-1])) for x in (self._q, self._v, *arrays.values())]
        results: Any = [np.full((*batch, *each), np.nan) for each in shapes]
        self.failures = {}
        for index in np.ndindex(batch):
            q, v, *arguments = (array[index] for array in members)
            if self._batch:
                self._move(q.copy(), v.copy())
            try:
                result: Any = function(*arguments)
            except (ArgumentError, ClosureError, SingularConfigurationError) as error:
                if isinstance(error, ArgumentError) and error.argument != self._kept_argument:
                    raise at_index(error, index) from error
                self.failures[index] = error
                continue
            for array, value in zip(results, result if shape is shapes else [result], strict=True):
                array[index] = value
        outcome: Result = results if shape is shapes else results[0]
        return outcome

    def _each_closed_member(self, function: Callable[..., Result], shape: Any, **arrays: FloatArray) -> Result:
        """Return the same as `_each_member` for a function that takes a regular q, closed, and v that keeps it so."""

        def member(*arguments: FloatArray) -> Result:
            self._check_closed()
            return function(*arguments)

        return self._each_member(member, shape, **arrays)

    def _check_closed(self) -> None:
        if not self._is_closed:
            self.kinematics.check_closed(self._rates)
            check_regular(self._chain, self.kinematics)
            self._is_closed = True

    def energy(self) -> Energy:
        """Return the kinetic and the potential energy (...) [J] of all bodies, closed or not."""
        return Energy(*self._each_member(lambda: self.kinematics.energies(self._rates), [(), ()]))

    def _driven(self, values: FloatArray, argument: str, least: FloatArray | None = None) -> FloatArray:
        """Return the admissible rates (nv,) that, added to `least`, move the actuators with `values`."""
        kinematics = self.kinematics
        kinematics.check_driven()
        wanted = np.concatenate([values, np.zeros(len(kinematics.base))])
        if least is not None:
            wanted -= least.take(np.concatenate([kinematics.actuated, kinematics.base]))
        rates, missed = kinematics.rates.solve(wanted)
        if missed > AGREEMENT * max(largest(wanted / kinematics.rates.scales), largest(rates)):
            expected = "values that are compatible with the closures"
            cause = "There are more actuators than freedoms, or loops lock one: see mobility"
            raise ArgumentError(argument, expected, f"values that are {missed:.1e} off", cause)
        return np.asarray(kinematics.space.basis.dot(rates))

    def _forward_dynamics(
        self, argument: str, forces: FloatArray, frames: list[int], wrenches: dict[str, FloatArray]
    ) -> FloatArray:
        """Return the accelerations (..., nv) under actuators (..., n), given as `argument`, and wrenches at frames."""
        if not frames:
            if forces.ndim == 1 and not self._batch:
                return self._accelerations(forces, [], ())
            if max(math.prod(self._batch), math.prod(forces.shape[:-1])) > MANY and forced() != "interpreted":
                self._chain.compile_dynamics()
            accelerations = self._compiled_batch(argument, forces)
            if accelerations is not None:
                return accelerations

        def member(tau: FloatArray, *loads: FloatArray) -> FloatArray:
            return self._accelerations(tau, frames, loads)

        return self._each_member(member, (self._nv,), **{argument: forces}, **wrenches)

    def _compiled_batch(self, argument: str, tau: FloatArray) -> FloatArray | None:
        """Return the accelerations of a batch; None if nothing is compiled, or a member perhaps has an error."""
        batch = broadcastable(argument, tau.shape[:-1], "the other arguments", self._batch)
        q, v = (np.broadcast_to(x, (*batch, x.shape[-1])).reshape(-1) for x in (self._q, self._v))
        forces = np.zeros((*batch, self._nv))
        forces[..., self.kinematics.actuated] = tau
        self.failures = {}
        return forces if self.kinematics.accelerate(q, v, forces.reshape(-1)) else None

    def _accelerations(self, tau: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        """Return the accelerations of a single state under actuators (n,) and wrenches at frames."""
        forces = self._forces(tau, frames, loads)
        if self.kinematics.accelerate(self.kinematics.q, self._rates, forces):
            return forces
        self._check_closed()
        return self.kinematics.accelerations(self._rates, forces)

    def _actuator_forces(self, a: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        """Return the forces of the actuators (n,) for accelerations (nv,) of a single state."""
        kinematics, v = self.kinematics, self._rates
        bias, size = kinematics.bias(v), largest(v / self.kinematics.units)
        if not kinematics.is_admissible(a, bias, size * size):
            expected, received = "joint accelerations that keep the loops closed", "accelerations that open them"
            cause = "joint_accelerations makes them from those of the actuators"
            raise ArgumentError("a", expected, received, cause)
        return self._balance(pin.rnea(kinematics.model, kinematics.data, kinematics.q, v, a), frames, loads)

    def _balance(self, forces: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        """Return the least actuator forces (n,) that do the work of generalized ones (nv,), less that of wrenches."""
        kinematics = self.kinematics
        for frame, load in zip(frames, loads, strict=True):
            forces = forces - kinematics.frame_jacobian(frame).T.dot(load)
        basis = kinematics.space.basis
        wanted = basis.T.dot(forces)
        tau, missed = kinematics.actuation.solve_transposed(wanted)
        if missed > AGREEMENT * largest(wanted):
            # The wanted forces may be a difference of larger ones, such as weights and inertia in free fall.
            size = largest(np.abs(basis).T.dot(np.abs(forces))) + kinematics.weight
            if missed > AGREEMENT * size:
                loose = kinematics.moving_joints(basis @ kinematics.actuation.right[kinematics.actuation.rank :].T)
                expected = "actuators that balance the forces"
                cause = "Fewer actuators than freedoms, or a singular configuration: see mobility"
                raise ArgumentError("actuated", expected, f"forces that would move {', '.join(loose[:4])}", cause)
        return tau

    def _forces(self, tau: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        """Return generalized forces (nv,) of actuators (n,) and of wrenches."""
        forces = self.kinematics.zero_velocity.copy()
        forces[self.kinematics.actuated] = tau
        for frame, load in zip(frames, loads, strict=True):
            forces += self.kinematics.frame_jacobian(frame).T.dot(load)
        return forces

    @property
    def _count(self) -> int:
        return len(self.kinematics.actuated)

    def _actuator_values(self, value: npt.ArrayLike, argument: str) -> FloatArray:
        return read_vectors(value, argument, self._count, "one for each actuator, in the order of `actuated`")

    def _joint_vectors(self, value: npt.ArrayLike, argument: str) -> FloatArray:
        return read_vectors(value, argument, self._nv, "one for each degree of freedom in Pinocchio's order")


def at_index(error: SpmError, index: tuple[int, ...]) -> SpmError:
    """Return an error that also gives the member of a batch that it concerns; `()` for a single one."""
    if not index:
        return error
    if isinstance(error, SingularConfigurationError):
        return error.replaced(index=index)
    if isinstance(error, ClosureError):
        return error.replaced(cause=f"At batch index {index}. {error.cause}")
    assert isinstance(error, ArgumentError)
    return error.replaced(received=f"{error.received} at batch index {index}")


class LoopState(TreeState):
    """State (q, v) of a `ClosedChain`: rates, Jacobians, forces and dynamics.

    `ClosedChain.state` creates it; control loops create one and call `update`, which allocates no new memory. For one q
    and v, kinematics, Jacobians and factorisations are computed once and cached; for a batch, each call computes them
    anew, member by member. Arguments broadcast with the batch. A state is for one thread at a time.

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
        Errors of the last call for a batch: the `SingularConfigurationError` or `ClosureError` of each member that is
        NaN.
    """

    def __init__(self, chain: Any, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None:
        super().__init__(chain, StateKinematics(chain))
        self.update(q, v)

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy has kinematics of its own: it moves without this state.
        return type(self), (self._chain, self._q, self._v)

    def gap(self) -> FloatArray:
        """Return the residual of each row of the closures and joint equalities [m, rad], shape (..., m)."""
        return self._each_member(lambda: self.kinematics.residual[: self._rows].copy(), (self._rows,))

    def constraint_jacobian(self) -> FloatArray:
        """Return the derivative of `gap` with respect to the joints' motion, shape (..., m, nv); exact at any q."""
        return self._each_member(lambda: self.kinematics.jacobian[: self._rows].copy(), (self._rows, self._nv))

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
        """Return the twist (v, ω) of a frame at its origin, in the universe's axes [m/s, rad/s], shape (..., 6)."""
        index = self._frame(frame)
        return self._each_member(lambda: self.kinematics.frame_jacobian(index) @ self._rates, (6,))

    def frame_acceleration(self, frame: str, a: npt.ArrayLike) -> FloatArray:
        """Return the time derivative of the twist of a frame (..., 6) for joint accelerations (..., nv)."""
        index = self._frame(frame)

        def member(a: FloatArray) -> FloatArray:
            return self.kinematics.frame_acceleration(index, self._rates, a)

        return self._each_member(member, (6,), a=self._joint_vectors(a, "a"))

    def forward_dynamics(self, tau: npt.ArrayLike, wrenches: Mapping[str, npt.ArrayLike] | None = None) -> FloatArray:
        """Return the accelerations of all joints (..., nv) under actuators, gravity and wrenches.

        `tau` (..., n) [N, N m] is in the order of the actuators.
        """
        values = self._actuator_values(tau, "tau")
        if wrenches is None and values.ndim == 1 and not self._batch:
            # For control loops, a tenth of the time less.
            return self._accelerations(values, [], ())
        return self._forward_dynamics("tau", values, *self._read_wrenches(wrenches))

    def inverse_dynamics(self, a: npt.ArrayLike, wrenches: Mapping[str, npt.ArrayLike] | None = None) -> FloatArray:
        """Return the forces of the actuators (..., n) [N, N m] for a motion under gravity, inertia and wrenches.

        The accelerations `a` (..., nv) are those of closed loops: of `forward_dynamics`, or of `joint_accelerations`.
        With more actuators than degrees of freedom, the forces of least norm are returned. Raises `ArgumentError` for
        accelerations that no forces of the actuators cause, which is possible with fewer.
        """

        def member(a: FloatArray, *loads: FloatArray) -> FloatArray:
            return self._actuator_forces(a, frames, loads)

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

        At rest, without gravity and with a free base held fixed, actuator forces are this matrix times the actuator
        accelerations. Raises as `joint_jacobian`.
        """

        def member() -> FloatArray:
            self.kinematics.check_driven()
            mapped = self.kinematics.joint_jacobian()
            mass = mapped.T @ self.kinematics.mass_matrix() @ mapped
            return np.asarray(0.5 * (mass + mass.T))

        return self._each_closed_member(member, (self._count, self._count))

    @property
    def _rows(self) -> int:
        return int(self.kinematics.rows.count)

    def _frame(self, name: str) -> int:
        return frame_index(self._chain.model, name)

    def _read_wrenches(self, wrenches: Mapping[str, npt.ArrayLike] | None) -> tuple[list[int], dict[str, FloatArray]]:
        """Return the indices of the frames, and the wrenches as arguments of `_each_member`."""
        if wrenches is None:
            return [], {}
        if not isinstance(wrenches, Mapping):
            expected = "a mapping from frames to wrenches, as {'foot': (fx, fy, fz, mx, my, mz)}"
            raise ArgumentError("wrenches", expected, type(wrenches).__name__)
        meaning = "(f, m) in N and N m in the axes of the world"
        arrays = {f"wrenches[{name!r}]": value for name, value in wrenches.items()}
        return [frame_index(self._chain.model, name, "wrenches") for name in wrenches], {
            argument: read_vectors(value, argument, 6, meaning) for argument, value in arrays.items()
        }
