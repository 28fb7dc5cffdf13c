"""Leading axes for methods that Pinocchio answers one configuration at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError, SpmError
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["located", "over_batch"]


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
        The leading axes, and then those of `trailing`.

    Raises
    ------
    ArgumentError
        If the leading axes do not broadcast.
    ArgumentError, ClosureError, SingularConfigurationError
        Of a member, with its index.
    """
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
            if shape:
                raise located(error, index) from error
            raise
        for result, value in zip(results, values, strict=True):
            result[index] = value
    return results


def located(error: SpmError, index: tuple[int, ...]) -> SpmError:
    """Return an error that says as well which member of the batch it is about."""
    if isinstance(error, SingularConfigurationError):
        return SingularConfigurationError(error.kind, error.sigma_min, index)
    if isinstance(error, ClosureError):
        return ClosureError(error.residual, error.iterations, f"At batch index {index}. {error.cause}")
    assert isinstance(error, ArgumentError)
    return type(error)(error.argument, error.expected, f"{error.received} at batch index {index}", error.cause)
