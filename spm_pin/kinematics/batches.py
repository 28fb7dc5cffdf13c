"""Running kernels over batches: results allocated, the batch divided between threads, shapes restored.

Kernels release the interpreter's lock and the members of a batch do not depend on each other, so a batch is divided
into parts for threads that live as long as the call. No thread is left that a fork could break, and
the results do not depend on the number of threads.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import multiprocessing
import os
import pkgutil
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import PoseError
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.support.arguments import LARGEST_RATIO, FloatArray, first_offender, whole_number
from spm_pin.support.pose import EXACT, PoseLike, checked_pose, unchecked_pose

_MIN_CHECKED = 1 << 17
"""Number of poses whose check is worth a thread."""
_CACHE_LINE, _LONG = 64, 1 << 14
"""Bytes of a cache line, at which large results begin: a store across two lines takes twice as long."""
Result = tuple[tuple[int, ...], npt.DTypeLike]
"""Trailing shape and type of one result of a kernel."""


class DrawnBranches(NamedTuple):
    """Results of the kernel `all_branches`, of N poses."""

    rotation: Any
    position: Any
    joints: Any
    lengths: Any
    discriminants: Any
    certain: Any
    at_home: Any
    status: Any
    flagged: Any


class BuiltBranches(NamedTuple):
    """Results of the kernel `calibrated_branches`, of N poses."""

    rotation: Any
    position: Any
    joints: Any
    lengths: Any
    roots: Any
    carried: Any
    status: Any


_BRANCHES: tuple[Result, Result, Result, Result] = (
    ((3, 3), np.float64),
    ((3,), np.float64),
    ((8, 3, 3), np.float64),
    ((8, 6), np.float64),
)
"""Shapes and types of rotation, position, joints and lengths, common to nominal and calibrated machines."""
DRAWN_BRANCHES = DrawnBranches(
    *_BRANCHES,
    discriminants=((4,), np.float64),
    certain=((4,), np.bool_),
    at_home=((8,), np.bool_),
    status=((), np.int8),
    flagged=((), np.uint8),
)
BUILT_BRANCHES = BuiltBranches(
    *_BRANCHES, roots=np.empty((0, 8, 3, 3), np.complex128), carried=((8,), np.uint8), status=((), np.int8)
)
"""Shapes and types of the results. The roots are not requested: no memory for them."""


def new_result(count: int, result: Result) -> npt.NDArray[Any]:
    """Return memory for one result of `count` members, which begins at a cache line if it is long."""
    if count == 1:
        return np.empty((1, *result[0]), result[1])
    shape, dtype = (count, *result[0]), np.dtype(result[1])
    size = math.prod(shape) * dtype.itemsize
    if size < _LONG:
        return np.empty(shape, dtype)
    memory = np.empty(size + _CACHE_LINE, np.uint8)
    first = -memory.__array_interface__["data"][0] % _CACHE_LINE
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
    """Run a kernel on a batch, on several threads if it is large, and return its results.

    The kernel takes `inputs`, arrays with the batch of N members along their first axis, then `constants`, then
    `results`: arrays to write into or, if given as `Result`, to allocate, with a first axis of N · packed. `min_batch`
    is the number of members that is worth a thread.
    """
    count = len(inputs[0])
    arrays = [r if isinstance(r, np.ndarray) else new_result(count * packed, r) for r in results]
    if count == 1:
        # Without slices: single calls are repeated thousands of times a second.
        kernel(*inputs, *constants, *arrays)
        return tuple(arrays)

    def work(part: slice) -> None:
        target = slice(part.start * packed, part.stop * packed)
        kernel(*[x[part] for x in inputs], *constants, *[y[target] for y in arrays])

    parallel_for(work, count, min_batch)
    return tuple(arrays)


def run_on_states(
    kernel: Callable[..., object],
    configuration: Configuration,
    constants: Sequence[Any],
    results: Sequence[Result],
    *,
    load: FloatArray | None = None,
    min_batch: int = 1 << 16,
) -> tuple[Any, ...]:
    """Run a kernel that takes b, R, o, circle centres, and optionally a load, on the states of a configuration.

    The leading axes of the load (..., 6) broadcast with those of the states; the results have those of both.
    """
    state = configuration
    shape = state.shape if load is None else np.broadcast_shapes(state.shape, load.shape[:-1])
    # For RPS legs nothing is computed or copied.
    centres = state.machine.legs.pivots if state.machine.legs.are_rps else state.own_circle_centres
    arrays = [state.middle_joints, state.rotation, state.translation, centres, *([] if load is None else [load])]
    # Two batch axes, so that values common to all branches of a pose need not be copied.
    inner = shape[-1] if len(shape) > 1 else 1
    inputs = []
    for array, trailing in zip(arrays, ((3, 3), (3, 3), (3,), (6, 3), (6,)), strict=False):
        whole = broadcast(array, (*shape, *trailing))
        inputs.append(whole.reshape(math.prod(shape) // max(inner, 1), inner, *trailing))
    written = run_kernel(kernel, inputs, constants, results, max(min_batch // max(inner, 1), 1), packed=inner)
    return with_batch_shape(written, shape)


def flat_batch(array: FloatArray, shape: tuple[int, ...], inner: int) -> FloatArray:
    """Return an array with `inner` axes per member, broadcast to a batch of this shape, with one batch axis."""
    trailing = array.shape[array.ndim - inner :]
    return broadcast(array, (*shape, *trailing)).reshape(-1, *trailing)


def broadcast(array: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Broadcast an array to a shape; arrays that have it already are returned as they are.

    `np.broadcast_to` takes as long as a kernel.
    """
    return array if array.shape == shape else np.broadcast_to(array, shape)


def with_batch_shape(arrays: Iterable[npt.NDArray[Any]], shape: tuple[int, ...]) -> tuple[Any, ...]:
    """Return arrays of N members with the axes of a batch of this shape in place of the first."""
    if not shape:
        # Takes half as long, in single calls, which are repeated thousands of times a second.
        return tuple([array[0, ...] for array in arrays])
    return tuple([array.reshape((*shape, *array.shape[1:])) for array in arrays])


def radii(machine: Manipulator) -> tuple[float, float, float]:
    """Return the circumradii of the nominal middle, base and terminal platforms [m]."""
    return machine.middle_radius, machine.base_radius, machine.platform_radius


def read_pose(machine: Manipulator, pose: PoseLike) -> tuple[tuple[int, ...], FloatArray, FloatArray]:
    """Return the batch shape of a pose, its rotations (N, 3, 3) and positions (N, 3) [m].

    Raises `PoseError` if it is not a pose, or so far away that the machine cannot be resolved relative to it. The
    arrays may be the caller's memory. Rotations are repaired if rounding made them inexact.
    """
    from spm_pin.kinematics.kernels.branch_kernels import are_valid

    check_manipulator(machine)
    rotation, position = unchecked_pose(pose)
    shape, flat, places = position.shape[:-1], rotation.reshape(-1, 3, 3), position.reshape(-1, 3)
    farthest = 2.0 * (LARGEST_RATIO + 1.0) * sum(machine.dimensions)
    good: list[bool] = []
    parallel_for(
        lambda part: good.append(are_valid(flat[part], places[part], EXACT, farthest)), len(flat), _MIN_CHECKED
    )
    if not all(good):
        rotation, position = checked_pose(rotation, position, "pose")
        flat, places = rotation.reshape(-1, 3, 3), position.reshape(-1, 3)
        too_far = np.abs(position).max(axis=-1) > farthest
        if too_far.any():
            index = first_offender(too_far)
            expected = f"a position in metres within {farthest:.3g} m, {2.0 * LARGEST_RATIO:.0e} times the machine"
            where = f" at index {index}" if index else ""
            raise PoseError("pose", expected, f"{position[index].tolist()}{where}", "Is it in another unit?")
    return shape, flat, places


ENVIRONMENT = "SPM_PIN_THREADS"
_PARTS = 4
"""Per thread, so that one that is interrupted does not keep the others waiting long."""
_process_wide: int | None = None
_in_this_context: ContextVar[int | None] = ContextVar("spm_pin_threads", default=None)


def set_threads(count: int | None) -> None:
    """Set how many threads may share a large batch, for the whole process.

    Parameters
    ----------
    count : int or None
        1 uses the caller's thread only. None, the default, takes the number from the environment: `SPM_PIN_THREADS`
        if set; else, in the main thread of a main process, `OMP_NUM_THREADS` if set, or the number of processors
        that the process may use; else 1. A Dask or joblib worker, a pool's thread or a child process thus uses one
        thread: its parent has already allocated the cores. Small batches are not shared.
    """
    global _process_wide
    _process_wide = _checked(count)


@contextlib.contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Set how many threads may share a large batch inside a ``with``, in this thread only; see `set_threads`."""
    token = _in_this_context.set(_checked(count))
    try:
        yield
    finally:
        _in_this_context.reset(token)


def _checked(count: int | None) -> int | None:
    return None if count is None else whole_number(count, "count", "a positive number of threads, or None", least=1)


def _allowed() -> int:
    if count := _in_this_context.get() or _process_wide or _from_environment(ENVIRONMENT):
        return count
    if threading.current_thread() is not threading.main_thread() or multiprocessing.parent_process() is not None:
        return 1
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return _from_environment("OMP_NUM_THREADS") or processors or 1


def _from_environment(name: str) -> int | None:
    text = os.environ.get(name, "")
    # OMP_NUM_THREADS may be a list, one number per level.
    first = text.split(",")[0].strip()
    return int(first) if first.isascii() and first.isdigit() and int(first) > 0 else None


def parallel_for(work: Callable[[slice], None], size: int, min_batch: int) -> None:
    """Call `work` on slices that cover a batch of this size, on several threads at once if it is large.

    `min_batch` is the least number of members per thread.
    """
    count = min(_allowed(), size // min_batch) if size >= 2 * min_batch else 1
    if count == 1:
        work(slice(0, size))
        return
    parts = _PARTS * count
    edges = [size * k // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(count) as pool:
        for done in [pool.submit(work, slice(*pair)) for pair in itertools.pairwise(edges)]:
            done.result()


def compile_kernels() -> None:
    """Compile all functions for this computer, in about a minute, and store them on disk for later processes.

    Otherwise each is interpreted, with the same results, until a large batch or many calls make compiling worthwhile,
    which delays that call by up to 20 s; after this function no call is delayed. Compiled code is stored in
    `NUMBA_CACHE_DIR` if set, else beside the sources, else in the user's cache directory. Call it in a controller that
    starts, when a container image is built, or before many processes start. Another processor model, or another
    version of spm_pin or Numba, compiles anew. The environment variable `SPM_PIN_KERNELS` set to "compiled" compiles
    each kernel at its first call, set to "interpreted" none.
    """
    from spm_pin.kinematics import kernels
    from spm_pin.kinematics.kernels.compilation import Kernel

    for module in pkgutil.iter_modules(kernels.__path__, f"{kernels.__name__}."):
        for member in vars(import_module(module.name)).values():
            if isinstance(member, Kernel):
                member.compile()
