"""Reading array arguments: finite numbers of the expected trailing shape, or an error that says so."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError

__all__ = ["FloatArray", "finite_array", "first_offender", "frozen", "real_array", "shaped_array"]

FloatArray = npt.NDArray[np.float64]


def first_offender(wrong: npt.NDArray[np.bool_] | np.bool_) -> tuple[int, ...]:
    """Return the index of the first True entry, as plain integers; `()` for a single value."""
    return tuple(int(i) for i in np.argwhere(wrong)[0])


def frozen(array: FloatArray) -> FloatArray:
    """Return a read-only view of `array`."""
    view = array.view()
    view.flags.writeable = False
    return view


def real_array(
    value: npt.ArrayLike,
    argument: str,
    trailing: tuple[int, ...],
    meaning: str,
    *,
    error: type[ArgumentError] = ArgumentError,
    allow_nan: bool = False,
) -> FloatArray:
    """Read `value` as float64 of shape `(..., *trailing)`.

    Parameters
    ----------
    value : array_like
        The argument as the caller gave it.
    argument : str
        Its name in the caller's signature.
    trailing : tuple of int
        The last axes it must have.
    meaning : str
        What it holds and in which unit, for the error message.
    error : type of ArgumentError
        The error to raise.
    allow_nan : bool
        Accept NaN, which marks an absent member of a batch. Infinity is never accepted.

    Raises
    ------
    ArgumentError
        If `value` is not numeric and real, has another shape, or holds a number that is not finite.
    """
    array = shaped_array(value, argument, trailing, meaning, error=error)
    return finite_array(array, argument, trailing, meaning, error=error, allow_nan=allow_nan)


def shaped_array(
    value: npt.ArrayLike, argument: str, trailing: tuple[int, ...], meaning: str, *, error: type[ArgumentError]
) -> FloatArray:
    """Read `value` as `real_array` does, without a look at the numbers."""
    try:
        array = np.asarray(value)
    except ValueError as ragged:
        raise error(argument, _expected(trailing, meaning), type(value).__name__, str(ragged)) from ragged
    if array.dtype.kind not in "fiu" and not (array.size == 0 and array.dtype.kind != "O"):
        raise error(argument, _expected(trailing, meaning), f"{type(value).__name__} of dtype {array.dtype}")
    array = array.astype(np.float64, copy=False)
    if array.ndim < len(trailing) or array.shape[array.ndim - len(trailing) :] != trailing:
        raise error(argument, _expected(trailing, meaning), f"shape {array.shape}")
    return array


def finite_array(
    array: FloatArray,
    argument: str,
    trailing: tuple[int, ...],
    meaning: str,
    *,
    error: type[ArgumentError],
    allow_nan: bool = False,
) -> FloatArray:
    """Return `array`, of a shape found good, if its numbers are too."""
    wrong = np.isinf(array) if allow_nan else ~np.isfinite(array)
    if wrong.any():
        index = first_offender(wrong)
        where = f" at index {index}" if index else ""
        cause = "A missing sample, or a division by zero before this call?"
        raise error(argument, f"finite {_expected(trailing, meaning)}", f"{array[index]}{where}", cause)
    return array


def _expected(trailing: tuple[int, ...], meaning: str) -> str:
    shape = f"(..., {', '.join(map(str, trailing))})" if trailing else "(...)"
    return f"real numbers of shape {shape}, {meaning}"
