"""Joint values and velocities, one pair or a batch, and functions that run on each member of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.support.arguments import FloatArray, broadcastable

Result = TypeVar("Result")
ResultShape = tuple[int, ...] | list[tuple[int, ...]]
"""The shape of a result, or those of several."""


class BatchedState:
    """Base of the states of chains; a subclass moves its kinematics to one q and v in `_move`."""

    _kept_argument: ClassVar[str] = ""
    """Argument whose errors are kept in `failures` for a batch, as singularities and open loops are; others raise."""

    def __init__(self, nv: int) -> None:
        self._nv = nv
        self.failures: dict[tuple[int, ...], SpmError] = {}
        self._batch: tuple[int, ...] = ()
        self._q: FloatArray
        self._v: FloatArray

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

    def _move(self, q: FloatArray, v: FloatArray) -> None:
        """Set q (nq,) and v (nv,) for the functions that `_each_of_batch` runs."""
        raise NotImplementedError

    def _set_batch(self, q: FloatArray, v: FloatArray) -> None:
        """Take joint values (..., nq) and velocities (..., nv), at least one of them several."""
        self._batch = broadcastable("v", v.shape[:-1], "q", q.shape[:-1])
        self._q, self._v = (np.broadcast_to(x, (*self._batch, x.shape[-1])).copy() for x in (q, v))

    def _each_of_batch(
        self, function: Callable[..., Result], shape: ResultShape, arrays: Mapping[str, FloatArray]
    ) -> Result:
        """Return the results of a function of one q and v, and of one member of each array, for all members."""
        batch = self._batch
        for name, array in arrays.items():
            batch = broadcastable(name, array.shape[:-1], "the other arguments", batch)
        members = [np.broadcast_to(x, (*batch, x.shape[-1])) for x in (self._q, self._v, *arrays.values())]
        results: Any = [np.full((*batch, *each), np.nan) for each in (shape if isinstance(shape, list) else [shape])]
        self.failures = {}
        for index in np.ndindex(batch):
            q, v, *arguments = (array[index] for array in members)
            if self._batch:
                self._move(q.copy(), v.copy())
            try:
                result: Any = function(*arguments)
            except (SingularConfigurationError, ClosureError) as error:
                self.failures[index] = error
                continue
            except ArgumentError as error:
                if error.argument != self._kept_argument:
                    raise at_index(error, index) from error
                self.failures[index] = error
                continue
            for array, value in zip(results, result if isinstance(shape, list) else [result], strict=True):
                array[index] = value
        outcome: Result = results if isinstance(shape, list) else results[0]
        return outcome


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
