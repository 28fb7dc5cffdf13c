"""Leading axes for what Pinocchio answers one state at a time, and the states that such calls share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.mechanism.arguments import FloatArray, broadcastable
from spm_pin.multibody.constrained_state import ConstrainedState
from spm_pin.multibody.vector_arguments import read_vectors

__all__ = ["BatchedStates", "located"]

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
