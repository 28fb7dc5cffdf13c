"""Types of arguments, and a check for each kind: it returns the value read, or raises an error that names the argument.

Every check takes the value as the caller gave it, then `argument`, its name in the caller's signature. In messages,
`expected` and `meaning` say what is accepted, with the unit, and `cause` what the caller may have meant. The error is
an `ArgumentError`, which `raised_as` turns into another kind.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError

FloatArray = npt.NDArray[np.float64]
"""An array of 64-bit floating-point numbers."""
BoolArray = npt.NDArray[np.bool_]
"""An array of truth values."""
IntArray = npt.NDArray[np.intp]
"""An array of indices or counts."""
Progress = Callable[[str, int, int], None]
"""Called with a description of the work, the number of points or poses done and their total; may raise to interrupt."""
Kind = TypeVar("Kind")
Scalar = TypeVar("Scalar", bound=np.generic)

COLUMNS = {
    3: ("x", "y", "z"),
    4: ("qx", "qy", "qz", "qw"),
    6: ("r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3"),
}
"""Column names of a table of positions, quaternions or readings, by the number of columns."""
STAGE_COLUMNS = ("r_1", "r_2", "r_3")
"""The same for readings of a stage."""

_PRINTED, _LONGEST = 10**20, 60
"""Larger integers, and the rest of longer texts, are not printed in messages."""


def first_offender(wrong: BoolArray | np.bool_) -> tuple[int, ...]:
    """Return the index of the first True entry, as plain integers; `()` for a single value."""
    return tuple(int(i) for i in np.argwhere(wrong)[0])


def frozen(array: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """Return a read-only view of `array`."""
    view = array.view()
    view.flags.writeable = False
    return view


def check_instance(value: Any, kind: type[Kind], argument: str, cause: str = "") -> Kind:
    """Return `value` if it is an instance of `kind`."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise ArgumentError(argument, f"{article} {kind.__name__}", type(value).__name__, cause)
    return value


def check_function(value: Any, argument: str, *parameters: str, meaning: str = "") -> None:
    """Raise `ArgumentError` unless this is a function that can be called with these positional parameters."""
    expected = f"a function of {', '.join(parameters)}{meaning}"
    if not callable(value):
        raise ArgumentError(argument, expected, type_and_value(value))
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # functions of other languages may have none
        return
    try:
        signature.bind(*parameters)
    except TypeError as error:
        raise ArgumentError(argument, expected, f"one of {signature}") from error


def check_progress(value: object, told: str = "a description, the number done, and the total") -> None:
    """Raise `ArgumentError` if this is neither None nor a function."""
    if value is not None and not callable(value):
        raise ArgumentError("progress", f"a function of {told}", type_and_value(value))


def real_number(
    value: Any,
    argument: str,
    expected: str,
    *,
    above: float = -np.inf,
    least: float = -np.inf,
    most: float = np.inf,
    below: float = np.inf,
    cause: str = "",
) -> float:
    """Read a finite real number (no boolean) with above < number < below and least <= number <= most."""
    if isinstance(value, float | int) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            raise ArgumentError(argument, expected, "an integer beyond all floats", cause) from None
    else:
        array = as_array(value)
        if array is None or array.shape or array.dtype.kind not in "fiu":
            raise ArgumentError(argument, expected, type_and_value(value))
        number = float(array)
    if not (np.isfinite(number) and above < number < below and least <= number <= most):
        raise ArgumentError(argument, expected, f"{number:g}", cause if np.isfinite(number) else "")
    return number


SMALLEST, LARGEST = 1e-9, 1e9
"""Dimensions accepted [m]. Every result was found to scale to rounding from 1e-52 to 1e60 m."""
LARGEST_RATIO = 1e5
"""Leg lengths relative to the machine's size above which eleven of sixteen digits are lost."""


def dimension(value: Any, argument: str) -> float:
    """Read a radius or a side [m]."""
    expected = f"a positive length in metres, from {SMALLEST:g} to {LARGEST:g}"
    cause = "Is it in another unit?" if isinstance(value, float | int) and value > 0 else ""
    return real_number(value, argument, expected, least=SMALLEST, most=LARGEST, cause=cause)


def number_pair(value: Any, argument: str, unit: str) -> tuple[float, float]:
    """Read a pair (minimum, maximum), which may be infinite, in a unit for the message."""
    array = as_array(value)
    if array is None or array.shape != (2,) or array.dtype.kind not in "fiu":
        raise ArgumentError(argument, f"a pair (minimum, maximum) in {unit}", type_and_value(value))
    return float(array[0]), float(array[1])


def whole_number(value: Any, argument: str, expected: str = "", *, least: int = 0, most: int = 10**12) -> int:
    """Read an integer from `least` to `most`, by default more than any memory holds; floats, even 2.0, are refused."""
    expected = expected or f"a whole number from {least} to {most}"
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None:
        raise ArgumentError(argument, expected, type_and_value(value))
    if not least <= number <= most:
        received = number if abs(number) < _PRINTED else "an integer of many digits"
        raise ArgumentError(argument, expected, received)
    return number


def as_bool(value: Any, argument: str) -> bool:
    """Read True or False; 0 and 1 are neither."""
    if not isinstance(value, bool | np.bool_):
        raise ArgumentError(argument, "True or False", type_and_value(value))
    return bool(value)


def choice(value: Any, argument: str, choices: Collection[str]) -> str:
    """Read one word out of `choices`."""
    if not isinstance(value, str) or value not in choices:
        received = repr(value) if isinstance(value, str) else type_and_value(value)
        raise ArgumentError(argument, f"one of {', '.join(map(repr, choices))}", received)
    return value


def name_sequence(value: Any, argument: str, of: str = "joints") -> tuple[str, ...]:
    """Read a sequence of different names."""
    expected = f"a sequence of names of {of}"
    if isinstance(value, str):
        raise ArgumentError(argument, expected, repr(value), f"[{value!r}]?")
    if not isinstance(value, Sequence) or not all(isinstance(name, str) for name in value):
        raise ArgumentError(argument, expected, type_and_value(value))
    if len(set(value)) != len(value):
        raise ArgumentError(argument, "each name once", ", ".join(value))
    return tuple(value)


def generator(value: Any, argument: str = "rng") -> np.random.Generator:
    """Return a random generator, or make one from a seed; None makes one that differs at every call."""
    if isinstance(value, np.random.Generator):
        return value
    if value is not None and not isinstance(value, np.random.SeedSequence | np.random.BitGenerator):
        expected = "a numpy.random.Generator, a seed from 0 to 2¹²⁸, or None"
        value = whole_number(value, argument, expected, most=1 << 128)
    return np.random.default_rng(value)


def boolean_array(value: Any, argument: str, shape: tuple[int, ...]) -> BoolArray:
    """Read an array of booleans that broadcasts to `shape`."""
    expected = f"booleans of shape {shape}"
    array = as_array(value)
    if array is None or array.dtype.kind != "b":
        raise ArgumentError(argument, expected, type_and_value(value) if array is None else f"dtype {array.dtype}")
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ArgumentError(argument, expected, f"shape {array.shape}") from None


def broadcastable(argument: str, shape: tuple[int, ...], other: str, other_shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape to which the leading axes of two arguments broadcast."""
    try:
        return np.broadcast_shapes(shape, other_shape)
    except ValueError:
        expected = f"leading axes that broadcast with those of {other}, {other_shape}"
        raise ArgumentError(argument, expected, f"{shape}") from None


def check_shapes(shapes: dict[str, tuple[int, ...]], last: dict[str, tuple[int, ...]]) -> None:
    """Check the last axes of arguments or their fields, and that their leading axes broadcast.

    `last` maps the last part of a name to its last axes; names that are not in `last` are vectors of any length.
    """
    batch: tuple[int, ...] = ()
    for k, (argument, shape) in enumerate(shapes.items()):
        axes = last.get(argument.rpartition(".")[2], ())
        if shape[len(shape) - len(axes) :] != axes:
            raise ArgumentError(argument, f"shape (..., {', '.join(map(str, axes))})", f"shape {shape}")
        batch = broadcastable(argument, shape[: len(shape) - max(len(axes), 1)], ", ".join([*shapes][:k]), batch)


def real_array(
    value: npt.ArrayLike, argument: str, trailing: tuple[int, ...], meaning: str, *, allow_nan: bool = False
) -> FloatArray:
    """Read finite real numbers as float64 of shape `(..., *trailing)`; with `allow_nan`, NaN marks a missing member."""
    array = shaped_array(value, argument, trailing, meaning)
    return finite_array(array, argument, trailing, meaning, allow_nan=allow_nan)


def likely_names(name: object, names: Sequence[str], otherwise: str = "") -> str:
    """Return a question with the names most like this one, as the cause of an error, or `otherwise`."""
    from difflib import get_close_matches  # for errors alone

    close = get_close_matches(str(name), names)
    return f"Did you mean {' or '.join(map(repr, close))}?" if close else otherwise


def increasing_times(times: npt.ArrayLike, *, least: int = 1) -> FloatArray:
    """Read times (n,) [s], or raise `ArgumentError`."""
    array = real_array(times, "times", (), "in seconds")
    if array.ndim != 1 or array.size < least:
        raise ArgumentError("times", f"times in seconds, shape (n,), at least {least}", f"shape {array.shape}")
    backward = np.diff(array) <= 0.0
    if backward.any():
        first = int(np.flatnonzero(backward)[0])
        raise ArgumentError("times", "increasing times", f"{array[first + 1]:g} after {array[first]:g}")
    return array


def leg_values(
    value: npt.ArrayLike, argument: str, meaning: str, *, most: float, cause: str = "", count: int = 6
) -> FloatArray:
    """Read a positive number for each leg, shape (..., count), or one for all, as (count,); at most `most`."""
    array = as_array(value)
    single = array is not None and not array.ndim
    numbers = real_array(value, argument, () if single else (count,), meaning)
    outside = (numbers <= 0.0) | (numbers > most)
    if outside.any():
        expected = f"positive numbers of at most {most:g}, {meaning}"
        raise ArgumentError(argument, expected, f"{numbers[outside].flat[0]:g}", cause)
    return np.full(count, numbers) if single else numbers


def leg_bounds(
    value: npt.ArrayLike, argument: str, meaning: str, *, most: float, count: int = 6
) -> tuple[FloatArray, FloatArray]:
    """Read the minimum and the maximum of `count` quantities, each of shape (count,).

    One positive number, or (count,), is the largest magnitude in both senses; (2, count) are minima and maxima.
    """
    array = as_array(value)
    if array is None or array.shape not in ((), (count,), (2, count)):
        shapes = f"shape () or ({count},), the largest magnitude, or (2, {count}), minima and maxima"
        received = type_and_value(value) if array is None else f"shape {array.shape}"
        raise ArgumentError(argument, f"{meaning} of {shapes}", received)
    bounds = real_array(array, argument, (), meaning)
    if bounds.ndim < 2:
        bounds = np.multiply.outer([-1.0, 1.0], np.broadcast_to(bounds, (count,)))
    lower, upper = bounds
    if (lower >= upper).any() or np.abs(bounds).max(initial=0.0) > most:
        expected = f"{meaning}, minima below maxima, at most {most:g} in magnitude"
        received = str(array if array.size <= 1 else bounds.tolist())
        raise ArgumentError(argument, expected, received, "Are the rows exchanged, or numbers not positive?")
    return np.array(lower), np.array(upper)


def symmetric_matrices(
    value: npt.ArrayLike, argument: str, size: int, meaning: str, *, allow_nan: bool = False, positive: bool = False
) -> FloatArray:
    """Read matrices (..., size, size), symmetric to 1e-9 of their largest entry; otherwise as `real_array`.

    With `positive`, they must be positive definite.
    """
    matrices = real_array(value, argument, (size, size), meaning, allow_nan=allow_nan)
    off = np.abs(matrices - matrices.swapaxes(-1, -2)).max(axis=(-1, -2), initial=0.0)
    if (off > 1e-9 * np.abs(matrices).max(axis=(-1, -2), initial=0.0)).any():
        raise ArgumentError(argument, "symmetric matrices", f"an asymmetry of {np.nanmax(off):.1e}")
    if positive:
        present = np.where(np.isnan(matrices).any(axis=(-1, -2), keepdims=True), np.eye(size), matrices)
        least = np.linalg.eigvalsh(present).min(initial=1.0)
        if least <= 0.0:
            raise ArgumentError(argument, "positive definite matrices", f"an eigenvalue of {least:.3g}")
    return matrices


def shaped_array(value: npt.ArrayLike, argument: str, trailing: tuple[int, ...], meaning: str) -> FloatArray:
    """Read real numbers, not necessarily finite, as float64 of shape `(..., *trailing)`."""
    if isinstance(value, np.ma.MaskedArray):
        raise ArgumentError(argument, _expected(trailing, meaning), "a masked array", "Fill or drop what is masked")
    array = value if type(value) is np.ndarray else as_array(_in_order(value, argument, trailing))
    if array is None:
        raise ArgumentError(argument, _expected(trailing, meaning), type_and_value(value), "Do rows differ in length?")
    if array.dtype.kind not in "fiu" and not (array.size == 0 and array.dtype.kind != "O"):
        raise ArgumentError(argument, _expected(trailing, meaning), f"{type_and_value(value)} of dtype {array.dtype}")
    if array.dtype != np.float64:
        with np.errstate(over="ignore"):
            array = array.astype(np.float64)
    if array.ndim < len(trailing) or array.shape[array.ndim - len(trailing) :] != trailing:
        raise ArgumentError(argument, _expected(trailing, meaning), f"shape {array.shape}")
    return array


def _in_order(value: Any, argument: str, trailing: tuple[int, ...]) -> Any:
    """Return the values of a table with named columns, such as a DataFrame of pandas, in the order of `COLUMNS`."""
    columns = getattr(value, "columns", ())  # in CasADi's matrices this is a method
    names = [] if callable(columns) else [name for name in columns if isinstance(name, str)]
    order = COLUMNS.get(trailing[-1], ()) if trailing else ()
    if (argument, trailing) == ("readings", (3,)):
        order = STAGE_COLUMNS
    if not names or tuple(names) == order:
        return value
    if not order or set(order) - set(names):
        expected = f"columns {', '.join(order)}" if order else "an array without column names"
        cause = "Columns are read by name: rename them, or pass .to_numpy() in this order"
        raise ArgumentError(argument, expected, f"a table with {', '.join(names)}", cause)
    return value[list(order)]


def finite_array(
    array: FloatArray, argument: str, trailing: tuple[int, ...], meaning: str, *, allow_nan: bool = False
) -> FloatArray:
    """Return `array`, whose shape has been checked; raise an error if a number is not finite."""
    wrong = np.isinf(array) if allow_nan else ~np.isfinite(array)
    # Takes a quarter of the time of `any()`, in single calls.
    if np.count_nonzero(wrong):
        index = first_offender(wrong)
        where = f" at index {index}" if index else ""
        cause = "A missing sample, the result of a missing solution, or a division by zero before this call?"
        raise ArgumentError(argument, f"finite {_expected(trailing, meaning)}", f"{array[index]}{where}", cause)
    return array


def _expected(trailing: tuple[int, ...], meaning: str) -> str:
    shape = f"(..., {', '.join(map(str, trailing))})" if trailing else "(...)"
    return f"real numbers of shape {shape}, {meaning}"


def as_array(value: Any) -> npt.NDArray[Any] | None:
    """Return `value` as an array, None if NumPy cannot make one."""
    try:
        return np.asarray(value)
    except Exception:  # whatever __array__ or __float__ of a foreign object raises
        return None


def type_and_value(value: Any) -> str:
    """Return the class of a value, with the value itself if it is a word or a number."""
    if value is None or isinstance(value, bool):
        return str(value)
    name = type(value).__name__
    if not (isinstance(value, str | bytes | float) or (isinstance(value, int) and abs(value) < _PRINTED)):
        return name
    text = repr(value)
    return f"{name} {text if len(text) <= _LONGEST else text[:_LONGEST] + '…'}"
