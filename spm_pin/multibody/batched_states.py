"""Loops over batches of q and v: Pinocchio computes one state at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.mechanism.arguments import FloatArray, broadcastable
from spm_pin.multibody.constrained_model import ConstrainedModel
from spm_pin.multibody.constrained_state import ConstrainedState
from spm_pin.multibody.vector_arguments import Wrenches, read_vectors

LOCATED = ArgumentError, ClosureError, SingularConfigurationError
"""The errors that are about a member of a batch."""


class BatchedStates:
    """A constrained model with states for calls about batches; free states are kept with their memory.

    `kind` is the class of the states, of which there are several where several threads call at the same time, or one
    call inside another.
    """

    def __init__(self, constrained: ConstrainedModel, kind: type[ConstrainedState]) -> None:
        self.constrained, self._kind = constrained, kind
        self._free: list[ConstrainedState] = []
        nv = constrained.model.nv
        self._sizes = {"v": nv, "a": nv, "forces": constrained.actuated.size, "stiffness": 36}

    def over(
        self,
        function: Callable[..., tuple[Any, ...]],
        trailing: tuple[tuple[int, ...], ...],
        q: npt.ArrayLike,
        **vectors: npt.ArrayLike | Wrenches,
    ) -> tuple[Any, ...]:
        """Call a function of a state and of vectors for each member of a batch; return arrays of what it returns.

        The state is at q (..., nq), and at v where `vectors` has it; the function takes one member of each other vector
        (..., n), of `Wrenches`, which are the last, as `Wrenches`, and returns a tuple of arrays whose shapes are
        `trailing`. The names of vectors are those of the errors and choose n, six by default. A result of one number is
        a float.

        Raises
        ------
        ArgumentError
            If a vector is malformed, or the leading axes do not broadcast.
        ArgumentError, ClosureError, SingularConfigurationError
            Raised by `function`; the member's index is added.
        """
        arguments, frames = {"q": self.constrained.checked(q)}, None
        for name, value in vectors.items():
            if isinstance(value, Wrenches):
                arguments[name], frames = value
            else:
                arguments[name] = read_vectors(value, name, self._sizes.get(name, 6))
        moving = 2 if "v" in vectors else 1
        try:
            state = self._free.pop()
        except IndexError:
            state = self._kind(self.constrained)

        def member(*values: FloatArray) -> tuple[Any, ...]:
            state._set_checked(*values[:moving])
            if frames is None:
                return function(state, *values[moving:])
            return function(state, *values[moving:-1], Wrenches(values[-1], frames))

        try:
            return _over_batch(member, trailing, arguments)
        finally:
            self._free.append(state)

    def array(
        self, function: Callable[..., Any], trailing: tuple[int, ...], q: npt.ArrayLike, **vectors: Any
    ) -> FloatArray:
        """Return `over` of a function whose result is one array."""
        return np.asarray(self.over(lambda *values: (function(*values),), (trailing,), q, **vectors)[0])


class ChainLike(Protocol):
    """A `ClosedChain` or a `MountedChain`."""

    @property
    def _states(self) -> BatchedStates: ...


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
        except LOCATED as error:
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
