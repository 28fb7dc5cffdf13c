"""Running kernels over batches: results allocated, the batch divided between threads, shapes restored."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.threads import parallel_for
from spm_pin.mechanism.arguments import FloatArray, check_instance
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import EXACT, PoseLike, checked_pose, unchecked_pose

_MIN_CHECKED = 1 << 17
"""Poses whose check is worth a thread."""

_LINE = 64
"""Bytes of a cache line; a store across two of them takes twice as long."""
_LONG = 1 << 14
"""Bytes of a result of which whole cache lines are written."""
Result = tuple[tuple[int, ...], npt.DTypeLike]
"""Trailing shape and type of one result of a kernel."""


BRANCH_RESULTS: tuple[Result, ...] = (
    ((3, 3), np.float64),
    ((3,), np.float64),
    ((8, 3, 3), np.float64),
    ((8, 6), np.float64),
    ((4,), np.float64),
    ((3,), np.uint8),
    ((), np.int8),
    ((), np.uint8),
)
"""Results of the kernel `all_branches`: R, o, joints, lengths, discriminants, choice, status and what is flagged."""


def new_result(count: int, result: Result) -> npt.NDArray[Any]:
    """Return memory for one result of `count` members, which begins at a cache line where it is long."""
    shape, dtype = (count, *result[0]), np.dtype(result[1])
    size = math.prod(shape) * dtype.itemsize
    if size < _LONG:
        return np.empty(shape, dtype)
    memory = np.empty(size + _LINE, np.uint8)
    first = -memory.__array_interface__["data"][0] % _LINE
    return memory[first : first + size].view(dtype).reshape(shape)


def run_kernel(
    kernel: Callable[..., object],
    inputs: Sequence[npt.NDArray[Any]],
    constants: Sequence[Any],
    results: Sequence[Result | npt.NDArray[Any]],
    min_batch: int,
    *,
    packed: int = 1,
) -> tuple[Any, ...]:
    """Run a kernel on a batch, on several threads if it is large.

    Parameters
    ----------
    kernel : callable
        Takes the inputs, the constants and the results, in this order, and writes the results.
    inputs : sequence of ndarray
        Arrays with the batch, N members, along their first axis.
    constants : sequence
        The same for all members.
    results : sequence of Result or ndarray
        What to allocate, with a first axis of N · packed; or arrays of that shape to write into.
    min_batch : int
        Members that are worth a thread.
    packed : int
        Results per member of the batch.

    Returns
    -------
    tuple of ndarray
        The results.
    """
    count = len(inputs[0])
    arrays = [r if isinstance(r, np.ndarray) else new_result(count * packed, r) for r in results]

    def work(part: slice) -> None:
        target = slice(part.start * packed, part.stop * packed)
        kernel(*[x[part] for x in inputs], *constants, *[y[target] for y in arrays])

    parallel_for(work, count, min_batch)
    return tuple(arrays)


def run_on_states(
    kernel: Callable[..., object],
    configuration: Configuration,
    constants: Sequence[float],
    results: Sequence[Result],
    *,
    load: FloatArray | None = None,
    min_batch: int = 1 << 16,
) -> tuple[Any, ...]:
    """Run a kernel that takes b, R, o, and a load if there is one, on the states of a configuration.

    Parameters
    ----------
    kernel, constants, results
        As for `run_kernel`.
    configuration : Configuration
        States of shape (...).
    load : ndarray, shape (..., 6), optional
        One more input, whose leading axes broadcast with those of the states.
    min_batch : int
        States that are worth a thread.

    Returns
    -------
    tuple of ndarray
        The results, their leading axes those of the states, broadcast with those of the load.
    """
    check_instance(configuration, Configuration, "configuration")
    shape = configuration.shape if load is None else np.broadcast_shapes(configuration.shape, load.shape[:-1])
    state = configuration
    arrays = [state.middle_joints, state.rotation, state.translation]
    trailing = [(3, 3), (3, 3), (3,), (6,)]
    if load is not None:
        arrays.append(load)
    inputs = [with_two_batch_axes(x, shape, ends) for x, ends in zip(arrays, trailing, strict=False)]
    inner = inputs[0].shape[1]
    outer_batch = max(min_batch // max(inner, 1), 1)
    written = run_kernel(kernel, inputs, constants, results, outer_batch, packed=inner)
    return with_batch_shape(written, shape)


def with_two_batch_axes(array: FloatArray, shape: tuple[int, ...], trailing: tuple[int, ...]) -> FloatArray:
    """Return an array broadcast to a batch of this shape, with two batch axes; not copied if strides allow it."""
    inner = shape[-1] if len(shape) > 1 else 1
    outer = int(np.prod(shape[:-1] if len(shape) > 1 else shape))
    return np.broadcast_to(array, (*shape, *trailing)).reshape(outer, inner, *trailing)


def flat_batch(array: FloatArray, shape: tuple[int, ...], inner: int) -> FloatArray:
    """Return an array with `inner` axes per member, broadcast to a batch of this shape, with one batch axis."""
    trailing = array.shape[array.ndim - inner :]
    return np.broadcast_to(array, (*shape, *trailing)).reshape(-1, *trailing)


def with_batch_shape(arrays: Iterable[npt.NDArray[Any]], shape: tuple[int, ...]) -> tuple[Any, ...]:
    """Return arrays of N members with the axes of a batch of this shape in place of the first."""
    return tuple([array.reshape((*shape, *array.shape[1:])) for array in arrays])


def branch_states(geometry: Geometry, shape: tuple[int, ...], solved: Iterable[npt.NDArray[Any]]) -> Configuration:
    """Return the branches (..., 8) of a batch of this shape, of the first four `BRANCH_RESULTS` of its N poses."""
    rotation, position, *rest = solved
    joints, lengths = with_batch_shape(rest, shape)
    return Configuration.from_arrays(
        geometry,
        np.broadcast_to(rotation.reshape((*shape, 1, 3, 3)), joints.shape),
        np.broadcast_to(position.reshape((*shape, 1, 3)), joints.shape[:-1]),
        joints,
        lengths,
    )


def radii(geometry: Geometry) -> tuple[float, float, float]:
    """Return the circumradii of the middle, base and terminal platforms [m].

    Raises `ArgumentError` if `geometry` is not a Geometry.
    """
    check_instance(geometry, Geometry, "geometry")
    return geometry.middle_radius, geometry.base_radius, geometry.platform_radius


def read_pose(pose: PoseLike) -> tuple[tuple[int, ...], FloatArray, FloatArray]:
    """Return the batch shape of a pose, its rotations (N, 3, 3) and positions (N, 3) [m].

    Raises `PoseError` if it is not a pose. The arrays may be the caller's memory. Rotations are repaired where rounding
    made them inexact.
    """
    from spm_pin.kinematics.kernels.branch_kernels import are_rigid

    rotation, position = unchecked_pose(pose)
    shape, flat, places = position.shape[:-1], rotation.reshape(-1, 3, 3), position.reshape(-1, 3)
    rigid: list[bool] = []
    parallel_for(lambda part: rigid.append(are_rigid(flat[part], places[part], EXACT)), len(flat), _MIN_CHECKED)
    if not all(rigid):
        rotation, position = checked_pose(rotation, position, "pose")
        flat = rotation.reshape(-1, 3, 3)
    return shape, flat, position.reshape(-1, 3)
