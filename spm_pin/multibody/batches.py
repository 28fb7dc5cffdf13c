"""Leading axes for what Pinocchio answers one state at a time, and the states that such calls share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.dynamics import Energy
from spm_pin.multibody.state import ConstrainedState, Gains, WrenchLike, read, read_gains, read_wrenches

__all__ = ["BatchedStates", "located", "over_batch"]

State = TypeVar("State", bound=ConstrainedState)

RATES = "rates of the joints in Pinocchio's order"


class BatchedStates(Generic[State]):
    """Calls about states of shape (...) of one constrained model, whatever it is mounted on.

    States that are not in use are kept with their memory, so that a call makes one only where several threads call at
    the same time, or one call inside another.

    Parameters
    ----------
    make : callable
        Returns a new state.
    checked : callable
        Reads joint values (..., nq).
    """

    def __init__(self, make: Callable[[], State], checked: Callable[..., FloatArray]) -> None:
        self._make, self.checked = make, checked
        self._free = [make()]
        self.constrained = self._free[0].constrained

    def take(self) -> State:
        """Return a state for the caller alone."""
        try:
            return self._free.pop()
        except IndexError:
            return self._make()

    def give_back(self, state: State) -> None:
        """Leave a state to the next call."""
        self._free.append(state)

    def over(
        self, function: Callable[..., tuple[Any, ...]], trailing: tuple[tuple[int, ...], ...], **arguments: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Call a function of a state and of vectors for each member; arguments q and v, if there, are the state's."""
        state, moving = self.take(), "v" in arguments

        def member(q: FloatArray, *vectors: FloatArray) -> tuple[Any, ...]:
            if moving:
                state.set(q, vectors[0])
                return function(state, *vectors[1:])
            state.set(q)
            return function(state, *vectors)

        try:
            return over_batch(member, trailing, **arguments)
        finally:
            self.give_back(state)

    def states(self, q: Any, **rates: Any) -> dict[str, FloatArray]:
        """Read joint values, and velocities or accelerations by name."""
        size = self.constrained.model.nv
        return {"q": self.checked(q), **{name: read(value, name, size, RATES) for name, value in rates.items()}}

    def closure_gap(self, q: Any) -> FloatArray:
        """Return the gaps of the closures, shape (..., n, 3)."""
        shape = (len(self.constrained.closures), 3)
        return self.over(lambda state: (state.kinematics.gap,), (shape,), **self.states(q))[0]

    def constraint_jacobian(self, q: Any) -> FloatArray:
        """Return the derivatives of the gaps, shape (..., 3 n, nv)."""
        shape = (3 * len(self.constrained.closures), self.constrained.model.nv)
        return self.over(lambda state: (state.kinematics.closures,), (shape,), **self.states(q))[0]

    def forward_dynamics(self, q: Any, v: Any, forces: Any, wrench: WrenchLike, gains: Gains) -> FloatArray:
        """Return accelerations, shape (..., nv); see `ClosedChain.forward_dynamics`."""
        force = read(forces, "forces", self.constrained.actuated.size, "of the actuators in N and N m")
        wrenches, frames = read_wrenches(self.constrained, wrench)
        checked = read_gains(gains)
        return self.over(
            lambda state, f, w: (state.accelerations(f, w, frames, checked),),
            ((self.constrained.model.nv,),),
            **self.states(q, v=v),
            forces=force,
            wrench=wrenches,
        )[0]

    def inverse_dynamics(self, q: Any, v: Any, a: Any, wrench: WrenchLike) -> FloatArray:
        """Return forces of the actuators, shape (..., n); see `ClosedChain.inverse_dynamics`."""
        wrenches, frames = read_wrenches(self.constrained, wrench)
        return self.over(
            lambda state, a, w: (state.actuator_forces(a, w, frames),),
            ((self.constrained.actuated.size,),),
            **self.states(q, v=v, a=a),
            wrench=wrenches,
        )[0]

    def energy(self, q: Any, v: Any) -> Energy:
        """Return kinetic and potential energy, floats or shape (...)."""
        found = self.over(lambda state: tuple(state.energy()), ((), ()), **self.states(q, v=v))
        return Energy(*(float(part) if part.ndim == 0 else part for part in found))


def over_batch(
    function: Callable[..., tuple[Any, ...]], trailing: tuple[tuple[int, ...], ...], **arguments: FloatArray
) -> tuple[FloatArray, ...]:
    """Call a function of vectors for each member of a batch.

    Parameters
    ----------
    function : callable
        Takes the vectors of one member in the order of `arguments`; returns a tuple of arrays.
    trailing : tuple of tuple of int
        Their shapes.
    **arguments : ndarray, shape (..., n)
        Their leading axes broadcast; the names are those of the errors.

    Returns
    -------
    tuple of ndarray
        The leading axes, and then those of `trailing`; not shared with the function.

    Raises
    ------
    ArgumentError
        If the leading axes do not broadcast.
    ArgumentError, ClosureError, SingularConfigurationError
        Of a member, with its index.
    """
    if all(array.ndim == 1 for array in arguments.values()):
        return tuple(np.array(value) for value in function(*arguments.values()))
    shape: tuple[int, ...] = ()
    for name, array in arguments.items():
        try:
            shape = np.broadcast_shapes(shape, array.shape[:-1])
        except ValueError:
            expected = f"leading axes that broadcast with {shape}"
            raise ArgumentError(name, expected, f"shape {array.shape}") from None
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
