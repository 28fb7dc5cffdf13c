"""Who does the chunks of a sweep: this process, processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import itertools
import logging
import signal
import socket
import uuid
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spm_pin.errors import ArgumentError, MissingExtraError, SpmError
from spm_pin.sweeps.plan import Plan, package_version
from spm_pin.sweeps.store import Store, StoreError

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

__all__ = ["WorkersLostError", "completed_chunks", "ensure"]

Chunk = tuple[int, ...]

_AHEAD = 1000
"""Chunks that a scheduler is given at a time, so that neither it nor this process has to know a million of them."""
_PATIENCE = 15
"""How long to knock at a scheduler's door [s]."""


class WorkersLostError(SpmError):
    """Workers, or their scheduler, are gone for good."""


_opened: dict[tuple[str, Path], Store] = {}


def ensure(plan: Plan, path: Path, chunk: Chunk) -> Chunk:
    """Compute and write a chunk unless it is complete; return its index. This is what workers are asked to do.

    Raises
    ------
    StoreError
        If the store cannot be written, is not seen from here, or this is another version of the package.
    """
    store = _opened.get((plan.text, path)) or _open(plan, path)
    if not store.is_complete(chunk):
        store.write(chunk, plan.evaluate(chunk))
    return chunk


def _open(plan: Plan, path: Path) -> Store:
    host = socket.gethostname()
    own = package_version()
    if plan.version != own:
        raise StoreError(str(path), f"a sweep of spm_pin {plan.version}, but the worker on {host} has {own}")
    try:
        store = Store(path, plan)
    except ArgumentError as error:
        reason = f"the worker on {host} does not see this store ({error.received}). All need a file system in common"
        raise StoreError(str(path), reason) from error
    _opened.clear()
    _opened[plan.text, path] = store
    return store


def completed_chunks(plan: Plan, path: Path, scheduler: str | Client | None, workers: int | None) -> Generator[Chunk]:
    """Make sure of every chunk, in any order, and yield its index.

    Raises
    ------
    ArgumentError
        If the scheduler cannot be reached.
    StoreError
        If the store cannot be written.
    WorkersLostError
        If workers die over a chunk again and again, or the scheduler is gone.
    MissingExtraError
        If Dask is needed and not installed.
    """
    if scheduler is None and 1 in (workers, plan.count):
        yield from (ensure(plan, path, chunk) for chunk in plan)
        return
    try:
        import distributed
        from dask.system import CPU_COUNT
    except ImportError as missing:
        raise MissingExtraError("cluster", missing.name or "distributed") from missing

    if isinstance(scheduler, distributed.Client):
        yield from _scheduled(plan, path, scheduler)
    elif scheduler is not None:
        with _connected(scheduler) as client:
            yield from _scheduled(plan, path, client)
    else:
        count = min(workers or CPU_COUNT, plan.count)
        # One thread each: much of the work holds the interpreter's lock. Any free port for the dashboard: without an
        # address it takes a fixed one, which another sweep may have.
        with (
            distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
                env={"SPM_PIN_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            client.register_plugin(_undisturbed())
            yield from _scheduled(plan, path, client)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        cause = "Is it running, and can it be reached from here?"
        raise ArgumentError("scheduler", "the address of a Dask scheduler", repr(address), cause) from error
    with client:
        yield client


def _scheduled(plan: Plan, path: Path, client: Client) -> Iterator[Chunk]:
    from distributed import KilledWorker, as_completed

    name = f"spm_pin.sweep-{uuid.uuid4().hex}"
    under_way: set[Future[Any]] = set()

    def submit(chunk: Chunk) -> Future[Any]:
        key = f"{name}-{'.'.join(map(str, chunk))}"
        future = client.submit(ensure, plan, path, chunk, key=key, pure=False)
        under_way.add(future)
        return future

    left = iter(plan)
    finished = as_completed([submit(chunk) for chunk in itertools.islice(left, _AHEAD)], loop=client.loop)
    try:
        for future in finished:
            chunk: Chunk = future.result()
            under_way.discard(future)
            for following in itertools.islice(left, 1):
                finished.add(submit(following))
            yield chunk
    except KilledWorker as error:
        cause = "out of memory, where a smaller chunk helps, or ended by somebody"
        raise WorkersLostError(f"several workers died, one after another, over the same chunk: {cause}") from error
    except (concurrent.futures.CancelledError, asyncio.CancelledError) as error:
        raise WorkersLostError("the scheduler is gone") from error
    finally:
        if under_way and client.status == "running":
            client.cancel(list(under_way))


def _undisturbed() -> object:
    """Return a plugin by which workers leave Ctrl-C, which a terminal sends to them too, to who asks for the work."""
    from distributed import WorkerPlugin

    class Undisturbed(WorkerPlugin):
        idempotent = True

        def setup(self, worker: Worker) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return Undisturbed()
