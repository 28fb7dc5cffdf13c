"""Leading axes for what Pinocchio answers one state at a time, and the states that such calls share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.constrained_state import ConstrainedState
from spm_pin.multibody.vector_arguments import read_vectors

__all__ = ["BatchedStates", "located"]

_State = TypeVar("_State", bound=ConstrainedState)


class BatchedStates(Generic[_State]):
    """States of one constrained model for calls about batches; free ones are kept with their memory.

    Parameters
    ----------
    make : callable
        Returns a new state, where several threads call at the same time, or one call inside another.
    checked : callable
        Reads joint values (..., nq).
    """

    def __init__(self, make: Callable[[], _State], checked: Callable[[npt.ArrayLike], FloatArray]) -> None:
        self._make, self._checked, self._free = make, checked, [make()]
        self.constrained = self._free[0].constrained
        nv = self.constrained.model.nv
        self._sizes = {"v": nv, "a": nv, "forces": self.constrained.actuated.size, "stiffness": 36}

    def _take(self) -> _State:
        try:
            return self._free.pop()
        except IndexError:
            return self._make()

    @contextmanager
    def borrowed(self) -> Iterator[_State]:
        """Yield a state for the caller alone."""
        state = self._take()
        try:
            yield state
        finally:
            self._free.append(state)

    def over(
        self,
        function: Callable[..., tuple[Any, ...]],
        trailing: tuple[tuple[int, ...], ...],
        q: npt.ArrayLike,
        *,
        wrenches: FloatArray | None = None,
        **vectors: npt.ArrayLike,
    ) -> tuple[Any, ...]:
        """Call a function of a state and of vectors for each member of a batch.

        Parameters
        ----------
        function : callable
            Takes a state at q, and at v where `vectors` has it, and one member of each other vector; returns a tuple.
        trailing : tuple of tuple of int
            The shapes in that tuple.
        q : array_like, shape (..., nq)
            Joint values.
        wrenches : ndarray, shape (..., 6 n), optional
            As of `read_wrenches`; the last vector.
        **vectors : array_like, shapes (..., n)
            Leading axes broadcast. Their names are those of the errors and choose n, six by default.

        Returns
        -------
        tuple of ndarray
            The leading axes and those of `trailing`; a float for a single number.

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
        state = self._take()

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
