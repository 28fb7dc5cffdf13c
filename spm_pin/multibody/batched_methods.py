"""Methods of states for batches of q and v: those of a chain anywhere, and those of a chain by itself.

Pinocchio answers one state at a time: leading axes are gone through member by member, with states that are kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.mechanism.arguments import FloatArray, broadcastable
from spm_pin.multibody.constrained_model import SingularValues
from spm_pin.multibody.constrained_state import ChainState, ConstrainedState
from spm_pin.multibody.dynamics import Energy, NaturalFrequencies, PlatformDynamics
from spm_pin.multibody.vector_arguments import (
    Gains,
    Wrenches,
    WrenchLike,
    read_gains,
    read_stiffness,
    read_vectors,
    read_wrenches,
)

__all__ = ["BatchedStates", "ChainMethods", "ConstrainedMethods", "located"]

_State = TypeVar("_State", bound=ConstrainedState)


class BatchedStates(Generic[_State]):
    """States of one constrained model for calls about batches; free ones are kept with their memory.

    `make` returns a new state, where several threads call at the same time, or one call inside another; `checked` reads
    joint values (..., nq).
    """

    def __init__(self, make: Callable[[], _State], checked: Callable[[npt.ArrayLike], FloatArray]) -> None:
        self._make, self._checked, self._free = make, checked, [make()]
        self.constrained = self._free[0].constrained
        nv = self.constrained.model.nv
        self._sizes = {"v": nv, "a": nv, "forces": self.constrained.actuated.size, "stiffness": 36}

    def over(
        self,
        function: Callable[..., tuple[Any, ...]],
        trailing: tuple[tuple[int, ...], ...],
        q: npt.ArrayLike,
        *,
        wrenches: FloatArray | None = None,
        **vectors: npt.ArrayLike,
    ) -> tuple[Any, ...]:
        """Call a function of a state and of vectors for each member of a batch; return arrays of what it returns.

        The state is at q (..., nq), and at v where `vectors` has it; the function takes one member of each other vector
        (..., n), last `wrenches` as of `read_wrenches`, and returns a tuple of arrays whose shapes are `trailing`. The
        names of vectors are those of the errors and choose n, six by default. A result of one number is a float.

        Raises
        ------
        ArgumentError
            If a vector is malformed, or the leading axes do not broadcast.
        ArgumentError, ClosureError, SingularConfigurationError
            As of `function`, with the member's index.
        """
        arguments = {"q": self._checked(q)}
        for name, value in vectors.items():
            arguments[name] = read_vectors(value, name, self._sizes.get(name, 6))
        if wrenches is not None:
            arguments["wrench"] = wrenches
        moving = 2 if "v" in vectors else 1
        try:
            state = self._free.pop()
        except IndexError:
            state = self._make()

        def member(*values: FloatArray) -> tuple[Any, ...]:
            state.set(*values[:moving])
            return function(state, *values[moving:])

        try:
            return _over_batch(member, trailing, arguments)
        finally:
            self._free.append(state)

    def array(
        self, function: Callable[..., Any], trailing: tuple[int, ...], q: npt.ArrayLike, **vectors: Any
    ) -> FloatArray:
        """Return `over` of a function whose result is one array."""
        return np.asarray(self.over(lambda *values: (function(*values),), (trailing,), q, **vectors)[0])


def _over_batch(
    function: Callable[..., tuple[Any, ...]], trailing: tuple[tuple[int, ...], ...], arguments: dict[str, FloatArray]
) -> tuple[Any, ...]:
    """Call a function of vectors for each member of a batch; results are not shared with it."""
    if max([array.ndim for array in arguments.values()]) == 1:
        values = function(*arguments.values())
        return tuple(np.array(value) if last else value for value, last in zip(values, trailing, strict=True))
    shape: tuple[int, ...] = ()
    for name, array in arguments.items():
        shape = broadcastable(name, array.shape[:-1], "the other arguments", shape)
    spread = [np.broadcast_to(array, (*shape, array.shape[-1])) for array in arguments.values()]
    results = tuple(np.empty((*shape, *last)) for last in trailing)
    for index in np.ndindex(shape):
        try:
            values = function(*(array[index] for array in spread))
        except (ArgumentError, ClosureError, SingularConfigurationError) as error:
            raise located(error, index) from error
        for result, value in zip(results, values, strict=True):
            result[index] = value
    return results


def located(error: SpmError, index: tuple[int, ...]) -> SpmError:
    """Return an error that says as well which member of the batch it is about; `()` for a single member."""
    if not index:
        return error
    if isinstance(error, SingularConfigurationError):
        return SingularConfigurationError(error.kind, error.sigma_min, index)
    if isinstance(error, ClosureError):
        return ClosureError(error.residual, error.iterations, f"At batch index {index}. {error.cause}")
    assert isinstance(error, ArgumentError)
    return type(error)(error.argument, error.expected, f"{error.received} at batch index {index}", error.cause)


class ConstrainedMethods:
    """Methods that a chain has by itself and on another robot: q (..., nq) and v (..., nv) of its `model`, n actuators.

    By itself, nq and nv are 18, and the actuators are the six legs. On another robot, its own joints and actuators
    are among them, see `MountedChain.actuated_indices`, and the universe takes the place of {B}.
    """

    _states: BatchedStates[Any]

    def closure_gap(self, q: npt.ArrayLike) -> FloatArray:
        """Return how far the closures are open: from `frame_a` to `frame_b` of each, in {B} [m], shape (..., 4, 3)."""
        return self._states.array(lambda state: state.kinematics.gap, (len(self._states.constrained.closures), 3), q)

    def constraint_jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (..., 12, nv), three rows per closure.

        Its transpose maps forces in {B} onto the closures' `frame_b`, with the opposite onto `frame_a`, to
        generalized forces. Exact at any q.
        """
        shape = 3 * len(self._states.constrained.closures), self._states.constrained.model.nv
        return self._states.array(lambda state: state.kinematics.constraint_jacobian, shape, q)

    def forward_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        forces: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        gains: Gains = None,
    ) -> FloatArray:
        """Return the accelerations of all joints (..., nv) [rad/s², m/s²] under actuators, gravity and wrenches.

        Parameters
        ----------
        q, v : array_like, shapes (..., nq), (..., nv)
            Joint values, and joint velocities [rad/s, m/s].
        forces : array_like, shape (..., n)
            Of the actuators [N, N m].
        wrench : array_like, shape (..., 6), or mapping of str to such, optional
            Onto the terminal platform; or several, each onto the link or frame of that name, at its origin.
        gains : pair of float, optional
            (kp, kd) [1/s², 1/s], not negative, after Baumgarte: open gaps e then obey ë + kd ė + kp e = 0, for those
            who integrate by themselves. Without, q and v must be closed, and the accelerations keep them so.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v opens the loops, or a ball joint's middle angle is ±90°.
        ClosureError
            If q is open.
        SingularConfigurationError
            At a constraint singularity. Inverse and forward singularities are no obstacle.
        """
        (wrenches, frames), stabilisation = self._wrenches(wrench), read_gains(gains)

        def member(state: ConstrainedState, force: FloatArray, loads: FloatArray) -> FloatArray:
            return state.accelerations_under(force, Wrenches(loads, frames), stabilisation)

        shape = (self._states.constrained.model.nv,)
        return self._states.array(member, shape, q, v=v, forces=forces, wrenches=wrenches)

    def inverse_dynamics(
        self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, wrench: WrenchLike = None
    ) -> FloatArray:
        """Return the forces of the actuators (..., n) [N, N m] for a motion under gravity, inertia and wrenches.

        q, v and a (..., nv) are those of a closed mechanism, `wrench` is as in `forward_dynamics`. At rest, the weights
        of all bodies are left; `ClosedChain.leg_forces` has the wrench alone.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v or a opens the loops, or a ball joint's middle angle is ±90°.
        ClosureError
            If q is open.
        SingularConfigurationError
            At a forward or a constraint singularity.
        """
        wrenches, frames = self._wrenches(wrench)

        def member(state: ConstrainedState, a: FloatArray, loads: FloatArray) -> FloatArray:
            return state.forces_for(a, Wrenches(loads, frames))

        return self._states.array(member, (self._states.constrained.actuated.size,), q, v=v, a=a, wrenches=wrenches)

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike) -> Energy:
        """Return the kinetic and the potential energy (...) [J] of all bodies at q and v, closed or not."""
        return Energy(*self._states.over(ConstrainedState.energy, ((), ()), q, v=v))

    def _wrenches(self, wrench: WrenchLike) -> Wrenches:
        constrained = self._states.constrained
        return read_wrenches(wrench, constrained.model, constrained.layout.platform_frame)


class ChainMethods(ConstrainedMethods):
    """Methods of a chain by itself about the twist, the wrench and the legs at q (..., 18) of a closed mechanism."""

    _states: BatchedStates[ChainState]

    def inverse_jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return J_f (..., 6, 6), which maps the platform's twist to the leg rates; q is closed.

        Raises `SingularConfigurationError` at an inverse or a constraint singularity.
        """
        return self._states.array(ChainState.inverse_jacobian, (6, 6), q)

    def joint_velocities(self, q: npt.ArrayLike, twist: npt.ArrayLike) -> FloatArray:
        """Return the rates of all joints (..., 18) [rad/s, m/s], in the order of `joint_names`, for a twist of m.

        The twist is (..., 6); else as `inverse_jacobian`.
        """
        return self._states.array(ChainState.joint_velocities, (18,), q, twist=twist)

    def joint_rates(self, q: npt.ArrayLike, leg_rates: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints (..., 18) [rad/s, m/s] for rates of the six legs (..., 6) [m/s].

        q is closed; the other way is `joint_velocities`. Raises `SingularConfigurationError` at a forward or a
        constraint singularity.
        """
        return self._states.array(ChainState.joint_rates, (18,), q, leg_rates=leg_rates)

    def leg_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike) -> FloatArray:
        """Return the actuator forces (..., 6) [N] that hold a wrench (..., 6) applied onto the terminal platform.

        Weights and friction are left out: `inverse_dynamics` has the weights. Raises `SingularConfigurationError` at a
        forward or a constraint singularity.
        """
        return self._states.array(ChainState.leg_forces, (6,), q, wrench=wrench)

    def cut_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike) -> FloatArray:
        """Return the forces in the ball joints where the tree is cut, shape (..., 4, 3) [N] in {B}.

        Per closure, what the middle platform (`frame_a`) exerts onto the tip of the leg (`frame_b`); the leg exerts
        the opposite onto the middle platform. Arguments and errors are those of `leg_forces`.
        """
        return self._states.array(ChainState.cut_forces, (4, 3), q, wrench=wrench)

    def singular_values(self, q: npt.ArrayLike) -> SingularValues:
        """Return how near q (..., 18) is to each kind of singularity, without raising `SingularConfigurationError`."""
        return SingularValues(*self._states.over(ChainState.singular_values, ((), (), ()), q))

    def joint_accelerations(self, q: npt.ArrayLike, v: npt.ArrayLike, acceleration: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (..., 18) for one of the terminal platform (..., 6).

        That is the time derivative of the twist: of the point o [m/s²], and angular [rad/s²], in {B}. q and v (..., 18)
        are those of a closed mechanism. Raises `ClosureError` if q is open, `ArgumentError` if v opens the loops, and
        `SingularConfigurationError` at an inverse or a constraint singularity.
        """
        return self._states.array(ChainState.joint_accelerations, (18,), q, v=v, acceleration=acceleration)

    def platform_dynamics(self, q: npt.ArrayLike, v: npt.ArrayLike) -> PlatformDynamics:
        """Return the equations of motion at the terminal platform, Λ ṫ + C t + G = J_fᵀ f + w, of all bodies' masses.

        q, v and the errors are those of `joint_accelerations`.
        """
        return PlatformDynamics(*self._states.over(ChainState.platform_dynamics, ((6, 6), (6, 6), (6,), (6,)), q, v=v))

    def natural_frequencies(self, q: npt.ArrayLike, stiffness: npt.ArrayLike) -> NaturalFrequencies:
        """Return the small vibrations of the platform with its motors held, on legs that are elastic.

        q is closed, `stiffness` (..., 6, 6) the platform's as of `spm_pin.stiffness`; all bodies' masses take part as
        if rigid. What weights add to the stiffness is left out: it is of the size of weight / leg length. Raises
        `ClosureError` if q is open, `ArgumentError` if a matrix is not symmetric and positive definite, and
        `SingularConfigurationError` at an inverse or a constraint singularity.
        """
        matrices = read_stiffness(stiffness)

        def member(state: ChainState, matrix: FloatArray) -> NaturalFrequencies:
            return state.natural_frequencies(matrix.reshape(6, 6))

        flat = matrices.reshape(*matrices.shape[:-2], 36)
        return NaturalFrequencies(*self._states.over(member, ((6,), (6, 6)), q, stiffness=flat))
