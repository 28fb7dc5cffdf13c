"""Sweeps on one computer or many, their continuation after a stop, and their worker processes.

Chunks, or other tasks, are computed by this process, by others of this machine, or by those of a Dask scheduler.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import itertools
import logging
import os
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from spm_pin.errors import ArgumentError, SpmError, require_extra
from spm_pin.machine import Manipulator, Stage
from spm_pin.support.arguments import check_instance, check_progress, whole_number
from spm_pin.support.progress import shown_progress
from spm_pin.sweeps.domains import Domain, SweepPlan, package_version
from spm_pin.sweeps.metrics import Metric
from spm_pin.sweeps.store import (
    Store,
    StoreError,
    SweepError,
    as_store_error,
    completed_count,
    locked,
    read_plan,
    store_path,
)

if TYPE_CHECKING:
    import xarray
    from distributed import Client, Future

CHUNK = 2**18
"""Points in a chunk by default: a fraction of a second's work, and two megabytes per metric."""
PointProgress = Callable[[int, int], None]
"""A function that is called with the number of completed points and that of all points."""
Chunk = tuple[int, ...]
Item = TypeVar("Item")
Result = TypeVar("Result")
_AHEAD = 1000
"""Maximum number of chunks submitted to a scheduler at a time, so that no process keeps a list of all of them."""
_KEEP_MEMORY = {
    f"distributed.nanny.pre-spawn-environ.MALLOC_{name}_THRESHOLD_": size
    for name, size in (("TRIM", 2**26), ("MMAP", 2**25))
}
"""Without this, Dask's default, freed memory returns to the system at once, and NumPy's temporary arrays take twice
as long."""
_IGNORE_INTERRUPTS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Run by workers at their start: a terminal sends Ctrl-C to them too, and the main process handles it."""
_PATIENCE = 15
"""Timeout of a connection to a scheduler [s]."""


class WorkersLostError(SpmError):
    """Workers, or their scheduler, have been lost and will not come back."""


@dataclass(frozen=True)
class SweepStatus:
    """Progress of a sweep: `done` of `total` chunks."""

    done: int
    total: int
    points: int
    """Number of points of the whole sweep."""
    metrics: tuple[str, ...]
    """Names of the metrics."""
    shape: dict[str, int]
    """Dimensions of the results."""
    version: str
    """Version of the package that computes the sweep."""
    own_metrics: tuple[str, ...] = ()
    """Names of metrics that are not of this package: without their functions the sweep cannot continue."""

    @property
    def complete(self) -> bool:
        """True if all chunks are complete."""
        return self.done == self.total


def run_sweep(
    machine: Manipulator | Stage,
    domain: Domain,
    metrics: Iterable[str | Metric],
    store: str | os.PathLike[str],
    *,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    chunk: int = CHUNK,
    progress: PointProgress | None = None,
) -> xarray.Dataset:
    """Evaluate metrics over a domain and store them; continue where an earlier run stopped.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine, with the leg limits that decide what is reachable.
    domain : Domain
        Poses, heights and tilts of a stage, or readings: see `pose_grid`, `tilt_grid`, `leg_grid`, `pose_sample`,
        `tilt_sample`, `leg_sample`.
    metrics : iterable of str or Metric
        Names from `METRICS`, or metrics of your own. Those continue a store only with a `version`.
    store : path
        Folder of the results, in Zarr v3; on a file system that all workers can access. If it exists it must be of this
        very sweep: what is complete in it is verified and kept.
    scheduler : str or distributed.Client, optional
        Address of a Dask scheduler, such as ``tcp://head:8786``, or a client; processes on this machine if not given.
    workers : int, optional
        Number of processes on this machine; one per processor if not given. With 1 the work is done in this process.
        The others import the main module: a script that calls this needs ``if __name__ == "__main__":``.
    chunk : int
        Maximum number of points per chunk: the unit of work, of storage, and of loss if a worker is killed.
    progress : callable, optional
        Called with the number of completed points and that of all points, after every chunk. If not given, a line on
        the terminal shows them after some seconds.

    Returns
    -------
    xarray.Dataset
        The results, read from the store when used. Besides the metrics it has `status`, a `Status` for each point, and
        -128 where nothing has been computed.
    """
    plan = SweepPlan.make(machine, domain, metrics, chunk)
    return _run(plan, store_path(store), scheduler, workers, progress)


def resume_sweep(
    store: str | os.PathLike[str],
    *,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    progress: PointProgress | None = None,
) -> xarray.Dataset:
    """Continue a sweep from its store alone; arguments are as for `run_sweep`."""
    path = store_path(store)
    plan, here = read_plan(path), package_version()
    if plan.version != here:
        cause = "Results of two versions would be mixed."
        raise ArgumentError("store", f"a sweep of spm_pin {here}", f"{path}, made by {plan.version}", cause)
    return _run(plan, path, scheduler, workers, progress)


def sweep_status(store: str | os.PathLike[str]) -> SweepStatus:
    """Return the progress of the sweep into a store, without disturbing it."""
    path = store_path(store)
    plan = read_plan(path)
    return SweepStatus(
        done=completed_count(path),
        total=plan.count,
        points=plan.domain.size,
        metrics=tuple(metric.name for metric in plan.metrics),
        shape=dict(zip(plan.domain.dims, plan.domain.shape, strict=True)),
        version=plan.version,
        own_metrics=tuple(metric.name for metric in plan.metrics if not metric.is_of_package),
    )


def _run(
    plan: SweepPlan, path: Path, scheduler: str | Client | None, workers: int | None, progress: PointProgress | None
) -> xarray.Dataset:
    require_extra("cluster")
    check_workers(scheduler, workers)
    check_progress(progress, "the points done and all points")
    line = shown_progress(None)
    report = progress or (lambda done, total: line("points", done, total))
    plan.prepare()
    Store.create(path, plan)
    with locked(path):
        done, total = 0, plan.domain.size
        report(done, total)
        try:
            task = partial(complete_chunk, plan, path)
            with contextlib.closing(run_tasks(task, plan, plan.count, scheduler, workers)) as chunks:
                for chunk in chunks:
                    done += plan.chunk_size(chunk)
                    report(done, total)
        except KeyboardInterrupt as interrupt:
            interrupt.add_note(str(SweepError(str(path), "interrupted", completed_count(path), plan.count)))
            raise
        except (StoreError, WorkersLostError) as error:
            raise SweepError(str(path), str(error), completed_count(path), plan.count) from error
    import xarray

    with as_store_error(path, "metadata"):
        dataset: xarray.Dataset = xarray.open_zarr(path, zarr_format=3)
    return dataset


def check_workers(scheduler: object, workers: object) -> None:
    """Raise `ArgumentError` if these are not a scheduler, or a number of processes, or None."""
    if workers is not None:
        whole_number(workers, "workers", "a positive number of processes", least=1)
        if scheduler is not None:
            cause = "The number of workers of a scheduler is set where it is started."
            raise ArgumentError("workers", "None if a scheduler is given", workers, cause)
    if scheduler is not None and not isinstance(scheduler, str):
        from distributed import Client

        check_instance(scheduler, Client, "scheduler", "Give the address of a Dask scheduler, or a Client.")


_opened: dict[tuple[str, Path], Store] = {}


def complete_chunk(plan: SweepPlan, path: Path, chunk: Chunk) -> Chunk:
    """Compute and write a chunk unless it is complete; return its index. This is the task of a worker."""
    store = _opened.get((plan.text, path)) or _open(plan, path)
    if not store.is_complete(chunk):
        store.write(chunk, plan.evaluate(chunk))
    return chunk


def _open(plan: SweepPlan, path: Path) -> Store:
    host, version = socket.gethostname(), package_version()
    if plan.version != version:
        raise StoreError(path, f"a sweep of spm_pin {plan.version}, but the worker on {host} has {version}")
    try:
        store = Store(path, plan)
    except ArgumentError as error:
        reason = f"the worker on {host} does not see this store ({error.received}). All need a file system in common"
        raise StoreError(path, reason) from error
    _opened.clear()
    _opened[plan.text, path] = store
    return store


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

    Its value is None if this process does all the work. Raises `ArgumentError` if the scheduler cannot be reached.
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
                # Failures are raised here; connections that close while a sweep is interrupted need no message.
                silence_logs=logging.CRITICAL + 1,
                preload=[_IGNORE_INTERRUPTS],
                env={"SPM_PIN_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
            )
            client = stack.enter_context(Client(stack.enter_context(cluster), set_as_default=False))
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
