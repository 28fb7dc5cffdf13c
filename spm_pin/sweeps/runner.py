"""Sweeps: indices over any number of poses or leg lengths, on one machine or many, resumed wherever they stopped.

Memory does not grow with the number of points. The process that drives the sweep holds the chunks' numbers that are
under way; a worker holds one chunk of results and the intermediate results of a few thousand points; the disk has the
rest.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from spm_pin.errors import ArgumentError, MissingExtraError, SpmError
from spm_pin.mechanism import Geometry
from spm_pin.sweeps.domains import Domain
from spm_pin.sweeps.lock import locked
from spm_pin.sweeps.metric import Index
from spm_pin.sweeps.metrics import resolve
from spm_pin.sweeps.plan import Plan, domain_of, package_version
from spm_pin.sweeps.store import Store, StoreError, as_store_error, completed, stored_definition
from spm_pin.sweeps.workers import WorkersLostError, completed_chunks

if TYPE_CHECKING:
    import xarray
    from distributed import Client

__all__ = ["CHUNK", "Progress", "SweepError", "SweepStatus", "open_sweep", "resume_sweep", "sweep", "sweep_status"]

CHUNK = 2**18
"""Points in a chunk, if not told otherwise: about a second's work, and two megabytes per index."""

Progress = Callable[[int, int], None]


class SweepError(SpmError):
    """A sweep that stopped; what it had done is kept.

    Attributes
    ----------
    store : str
        Path of the store.
    reason : str
        Why it stopped.
    done, total : int
        Chunks that are complete, and chunks that there are.
    """

    def __init__(self, store: str, reason: str, done: int, total: int) -> None:
        self.store = store
        self.reason = reason
        self.done = done
        self.total = total
        super().__init__(
            f"{reason}. {done} of {total} chunks are complete in {store} and stay so; "
            "the same sweep, started again, does the others"
        )

    def __reduce__(self) -> tuple[type[SweepError], tuple[str, str, int, int]]:
        return type(self), (self.store, self.reason, self.done, self.total)


@dataclass(frozen=True)
class SweepStatus:
    """How far a sweep is.

    Attributes
    ----------
    done, total : int
        Chunks that have been completed, and chunks that there are.
    points : int
        Number of points of the whole sweep.
    indices : tuple of str
        What is computed.
    shape : dict of str to int
        Dimensions of the results.
    version : str
        Version of the package that computes it.
    """

    done: int
    total: int
    points: int
    indices: tuple[str, ...]
    shape: dict[str, int]
    version: str

    @property
    def complete(self) -> bool:
        """Whether nothing is left to do."""
        return self.done == self.total


def sweep(
    geometry: Geometry,
    domain: Domain,
    indices: Iterable[str | Index],
    store: str | os.PathLike[str],
    *,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    chunk: int = CHUNK,
    progress: Progress | None = None,
) -> xarray.Dataset:
    """Evaluate indices over a domain and store them; continue where an earlier run stopped.

    Parameters
    ----------
    geometry : Geometry
        The manipulator, with the leg limits that decide what is reachable.
    domain : Grid or Sample
        Poses or leg lengths: see `pose_grid`, `leg_grid`, `pose_sample`, `leg_sample`.
    indices : iterable of str or Index
        Names from `INDICES`, or indices of your own.
    store : path
        Folder of the results, in Zarr v3; on a file system that all workers see. If it exists it must be of this very
        sweep: what is complete in it is verified and kept.
    scheduler : str or distributed.Client, optional
        Address of a Dask scheduler, such as ``tcp://head:8786``, or a client. Worker processes on this machine if not
        given.
    workers : int, optional
        How many processes on this machine; one per processor if not given. With 1 the work is done in this process.
    chunk : int
        Largest number of points that are computed, stored and lost together. A worker's memory is bounded by that
        many points, at about 100 bytes each and twice the results of all indices, beside some 250 MB of code and of
        intermediate results; see `benchmarks/sweep.py`.
    progress : callable, optional
        Called with the number of points done and of all points, after every chunk.

    Returns
    -------
    xarray.Dataset
        The results, read from the store when used. Besides the indices it has `status`, a `Status` for each point, and
        -128 where nothing has been computed.

    Raises
    ------
    ArgumentError
        If an argument is not what it should be, `store` is something else or of another sweep, or the scheduler cannot
        be reached.
    StoreLockedError
        If another process is at work on the store.
    SweepError
        If it stopped: on a full disk, by a worker that died again and again, by a scheduler that is gone.
    MissingExtraError
        Without the extra ``cluster``.

    Notes
    -----
    It may be killed at any moment. A chunk counts as done when its record is on the disk, which is written after all
    its bytes are; everything else is done again. A run that was never disturbed and one that was leave the same bytes,
    given the same versions of libraries and the same kind of processor.

    Worker processes import the main module: a script that calls this needs ``if __name__ == "__main__":``.
    """
    plan = Plan.of(geometry, domain, resolve(indices), chunk)
    return _run(plan, Path(store), scheduler, workers, progress)


def resume_sweep(
    store: str | os.PathLike[str],
    *,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> xarray.Dataset:
    """Continue a sweep from its store alone.

    Parameters
    ----------
    store, scheduler, workers, progress
        As for `sweep`.

    Raises
    ------
    ArgumentError
        If there is no such store, it has indices of your own, or another version of this package made it; and as for
        `sweep`.
    """
    definition = stored_definition(Path(store))
    version, own = definition["spm_pin"], package_version()
    if version != own:
        cause = "Results of two versions would be mixed."
        raise ArgumentError("store", f"a sweep of spm_pin {own}", f"{store}, made by {version}", cause)
    return _run(Plan.from_definition(definition), Path(store), scheduler, workers, progress)


def sweep_status(store: str | os.PathLike[str]) -> SweepStatus:
    """Tell how far a sweep is, without disturbing it.

    Parameters
    ----------
    store : path
        The folder that `sweep` was given.

    Raises
    ------
    ArgumentError, StoreError
        If there is no such store, or it cannot be read.
    """
    path = Path(store)
    definition = stored_definition(path)
    domain = domain_of(definition)
    chunks = zip(domain.shape, definition["chunk"], strict=True)
    return SweepStatus(
        done=completed(path),
        total=math.prod(-(-length // part) for length, part in chunks),
        points=domain.size,
        indices=tuple(index["name"] for index in definition["indices"]),
        shape=dict(zip(domain.dims, domain.shape, strict=True)),
        version=definition["spm_pin"],
    )


def open_sweep(store: str | os.PathLike[str]) -> xarray.Dataset:
    """Open the results of a sweep, complete or not, without disturbing it.

    Parameters
    ----------
    store : path
        The folder that `sweep` was given.

    Returns
    -------
    xarray.Dataset
        As `sweep` returns it; the same as ``xarray.open_zarr(store)``.

    Raises
    ------
    ArgumentError
        If there is no such store.
    """
    try:
        import xarray
        import zarr
    except ImportError as missing:
        raise MissingExtraError("cluster", missing.name or "xarray") from missing
    del zarr  # xarray's own error would not name it

    stored_definition(Path(store))
    dataset: xarray.Dataset = xarray.open_zarr(Path(store))
    return dataset


def _run(
    plan: Plan, path: Path, scheduler: str | Client | None, workers: int | None, progress: Progress | None
) -> xarray.Dataset:
    if workers is not None and (isinstance(workers, bool) or not isinstance(workers, int) or workers < 1):
        raise ArgumentError("workers", "a positive number of processes", workers)
    if workers is not None and scheduler is not None:
        cause = "How many workers a scheduler has is not for this process to say."
        raise ArgumentError("workers", "None beside a scheduler", workers, cause)
    # Workers may stand in another folder.
    path = path.absolute()
    with contextlib.ExitStack() as stack:
        with as_store_error(path):
            stack.enter_context(locked(path))
        store = Store.create(path, plan)
        store.tidy()
        done, total = 0, plan.domain.size
        if progress is not None:
            progress(done, total)
        try:
            chunks = stack.enter_context(contextlib.closing(completed_chunks(plan, path, scheduler, workers)))
            for chunk in chunks:
                done += plan.size(chunk)
                if progress is not None:
                    progress(done, total)
        except KeyboardInterrupt as interrupt:
            interrupt.add_note(str(SweepError(str(path), "interrupted", completed(path), plan.count)))
            raise
        except (StoreError, WorkersLostError) as error:
            raise SweepError(str(path), str(error), completed(path), plan.count) from error
        store.tidy()
    return open_sweep(path)
