"""Processes that compute chunks of a sweep, or other tasks: this one, others of this machine, or a Dask scheduler's."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import itertools
import logging
import signal
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from spm_pin.errors import ArgumentError, SpmError
from spm_pin.mechanism.arguments import check_instance, whole_number
from spm_pin.sweeps.store import Store, StoreError
from spm_pin.sweeps.sweep_plan import SweepPlan, package_version

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

Chunk = tuple[int, ...]
Item = TypeVar("Item")
Result = TypeVar("Result")

_AHEAD = 1000
"""Chunks that a scheduler is given at a time, so that neither it nor this process holds a list of all of them."""
_KEEP_MEMORY = {
    f"distributed.nanny.pre-spawn-environ.MALLOC_{name}_THRESHOLD_": size
    for name, size in (("TRIM", 2**26), ("MMAP", 2**25))
}
"""Where freed memory goes back to the system at once, Dask's choice, NumPy's temporary arrays take twice the time."""
_PATIENCE = 15
"""Timeout of a connection to a scheduler [s]."""


class WorkersLostError(SpmError):
    """Workers, or their scheduler, have been lost and will not come back."""


_opened: dict[tuple[str, Path], Store] = {}


def check_workers(scheduler: object, workers: object) -> None:
    """Raise `ArgumentError` if these are not a scheduler, or a number of processes, or None."""
    if workers is not None:
        whole_number(workers, "workers", "a positive number of processes", least=1)
        if scheduler is not None:
            cause = "The number of workers of a scheduler is set where it is started."
            raise ArgumentError("workers", "None beside a scheduler", workers, cause)
    if scheduler is not None and not isinstance(scheduler, str):
        from distributed import Client

        check_instance(scheduler, Client, "scheduler", "Give the address of a Dask scheduler, or a Client.")


def complete_chunk(plan: SweepPlan, path: Path, chunk: Chunk) -> Chunk:
    """Compute and write a chunk unless it is complete; return its index. This is the task of a worker."""
    store = _opened.get((plan.text, path)) or _open(plan, path)
    if not store.is_complete(chunk):
        store.write(chunk, plan.evaluate(chunk))
    return chunk


def _open(plan: SweepPlan, path: Path) -> Store:
    host, version = socket.gethostname(), package_version()
    if plan.version != version:
        raise StoreError(str(path), f"a sweep of spm_pin {plan.version}, but the worker on {host} has {version}")
    try:
        store = Store(path, plan)
    except ArgumentError as error:
        reason = f"the worker on {host} does not see this store ({error.received}). All need a file system in common"
        raise StoreError(str(path), reason) from error
    _opened.clear()
    _opened[plan.text, path] = store
    return store


def complete_chunks(
    plan: SweepPlan, path: Path, scheduler: str | Client | None, workers: int | None
) -> Generator[Chunk]:
    """Complete all chunks, in any order, and yield the index of each; `ArgumentError` without the scheduler."""
    yield from run_tasks(partial(complete_chunk, plan, path), plan, plan.count, scheduler, workers)


def run_tasks(
    task: Callable[[Item], Result],
    items: Iterable[Item],
    count: int,
    scheduler: str | Client | None,
    workers: int | None,
) -> Generator[Result]:
    """Yield the results of a task for `count` items, in any order, by processes of this machine or of a scheduler."""
    with processes(count, scheduler, workers) as client:
        yield from map(task, items) if client is None else _scheduled(task, items, client)


@contextlib.contextmanager
def processes(count: int, scheduler: str | Client | None, workers: int | None) -> Iterator[Client | None]:
    """Start processes for `count` tasks at a time, or connect to a scheduler's, until the end of the `with` block.

    Its value is None if this process is to do all. `ArgumentError` without the scheduler.
    """
    if scheduler is None and 1 in (workers, count):
        yield None
        return
    import dask
    from dask.system import CPU_COUNT
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack, dask.config.set(_KEEP_MEMORY):
        client: Any = scheduler
        if isinstance(scheduler, str):
            try:
                client = stack.enter_context(Client(scheduler, timeout=_PATIENCE, set_as_default=False))
            except (OSError, ValueError, TypeError) as error:
                cause = "Is it running, and can it be reached from here?"
                raise ArgumentError("scheduler", "the address of a Dask scheduler", repr(scheduler), cause) from error
        elif scheduler is None:
            # One thread each: part of the work holds the interpreter's lock. Any free port for the dashboard: without
            # an address it takes a fixed one, which another sweep may have.
            cluster = LocalCluster(
                n_workers=min(workers or CPU_COUNT, count),
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
                env={"SPM_PIN_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
            )
            client = stack.enter_context(Client(stack.enter_context(cluster), set_as_default=False))
            client.register_plugin(_ignore_interrupts())
        yield client


def _scheduled(task: Callable[[Item], Result], items: Iterable[Item], client: Client) -> Iterator[Result]:
    from distributed import KilledWorker, as_completed

    def submit(count: int) -> list[Future[Any]]:
        return [client.submit(task, item, pure=False) for item in itertools.islice(left, count)]

    left = iter(items)
    finished = as_completed(submit(_AHEAD), loop=client.loop)
    try:
        for future in finished:
            result: Result = future.result()
            finished.update(submit(1))
            yield result
    except KilledWorker as error:
        cause = "out of memory, where a smaller chunk helps, or ended by somebody"
        raise WorkersLostError(f"several workers died, one after another, over the same chunk: {cause}") from error
    except (concurrent.futures.CancelledError, asyncio.CancelledError) as error:
        raise WorkersLostError("the scheduler is gone") from error
    finally:
        under_way = list(finished.futures)
        if under_way and client.status == "running":
            client.cancel(under_way)


def _ignore_interrupts() -> object:
    """Return a plugin by which workers ignore Ctrl-C, which a terminal sends to them too; the client handles it."""
    from distributed import WorkerPlugin

    class IgnoreInterrupts(WorkerPlugin):
        def setup(self, worker: Worker) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return IgnoreInterrupts()
