"""Number of threads that solve a batch.

Kernels release the interpreter's lock and the members of a batch do not depend on each other, so a batch is cut into
parts and the parts go to threads that live as long as the call. Nothing is left behind that a fork could break, and
the answer does not depend on the number of threads.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar

from spm_pin.mechanism.arguments import whole_number

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
        thread: its parent has already allocated the cores.

    Raises
    ------
    ArgumentError
        If `count` is not a positive integer.

    Notes
    -----
    Small batches are not shared: a thread must have some milliseconds of work.
    """
    global _process_wide
    _process_wide = _checked(count)


@contextlib.contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Set how many threads may share a large batch inside a ``with``, in this thread alone; see `set_threads`."""
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

    `min_batch` is how many members are worth a thread.
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
