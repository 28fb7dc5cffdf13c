"""Run a sweep, on one machine or many, and continue it wherever it stopped."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import check_progress
from spm_pin.sweeps.domains import Domain
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
from spm_pin.sweeps.sweep_plan import SweepPlan, package_version
from spm_pin.sweeps.workers import WorkersLostError, check_workers, complete_chunks

if TYPE_CHECKING:
    import xarray
    from distributed import Client

CHUNK = 2**18
"""Points in a chunk by default: a fraction of a second's work, and two megabytes per metric."""

PointProgress = Callable[[int, int], None]
"""A function that is called with the points done and all points."""


@dataclass(frozen=True)
class SweepStatus:
    """Progress of a sweep."""

    done: int
    """Chunks that have been completed."""
    total: int
    """All chunks."""
    points: int
    """Number of points of the whole sweep."""
    metrics: tuple[str, ...]
    """Names of what is computed."""
    shape: dict[str, int]
    """Dimensions of the results."""
    version: str
    """Version of the package that computes it."""

    @property
    def complete(self) -> bool:
        """True if nothing is left to do."""
        return self.done == self.total


def run_sweep(
    geometry: Geometry,
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
    geometry : Geometry
        The manipulator, with the leg limits that decide what is reachable.
    domain : Domain
        Poses or leg lengths: see `pose_grid`, `leg_grid`, `pose_sample`, `leg_sample`.
    metrics : iterable of str or Metric
        Names from `METRICS`, or metrics of your own. Those continue a store only with a `version`.
    store : path
        Folder of the results, in Zarr v3; on a file system that all workers see. If it exists it must be of this very
        sweep: what is complete in it is verified and kept.
    scheduler : str or distributed.Client, optional
        Address of a Dask scheduler, such as ``tcp://head:8786``, or a client; processes on this machine if not given.
    workers : int, optional
        Number of processes on this machine; one per processor if not given. With 1 the work is done in this process.
        The others import the main module: a script that calls this needs ``if __name__ == "__main__":``.
    chunk : int
        Most points per chunk: the unit of work, of storage, and of loss when a worker is killed.
    progress : callable, optional
        Called with the number of points done and of all points, after every chunk.

    Returns
    -------
    xarray.Dataset
        The results, read from the store when used. Besides the metrics it has `status`, a `Status` for each point, and
        -128 where nothing has been computed.
    """
    plan = SweepPlan.make(geometry, domain, metrics, chunk)
    return _run(plan, store_path(store), scheduler, workers, progress)


def resume_sweep(
    store: str | os.PathLike[str],
    *,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    progress: PointProgress | None = None,
) -> xarray.Dataset:
    """Continue a sweep from its store alone.

    Parameters
    ----------
    store, scheduler, workers, progress
        As for `run_sweep`.
    """
    path = store_path(store)
    plan, here = read_plan(path), package_version()
    if plan.version != here:
        cause = "Results of two versions would be mixed."
        raise ArgumentError("store", f"a sweep of spm_pin {here}", f"{path}, made by {plan.version}", cause)
    return _run(plan, path, scheduler, workers, progress)


def sweep_status(store: str | os.PathLike[str]) -> SweepStatus:
    """Return the progress of a sweep, without disturbing it.

    Parameters
    ----------
    store : path
        The folder that `run_sweep` was given.
    """
    path = store_path(store)
    plan = read_plan(path)
    return SweepStatus(
        done=completed_count(path),
        total=plan.count,
        points=plan.domain.size,
        metrics=tuple(metric.name for metric in plan.metrics),
        shape=dict(zip(plan.domain.dims, plan.domain.shape, strict=True)),
        version=plan.version,
    )


def _run(
    plan: SweepPlan, path: Path, scheduler: str | Client | None, workers: int | None, progress: PointProgress | None
) -> xarray.Dataset:
    require_extra("cluster")
    check_workers(scheduler, workers)
    check_progress(progress, "the points done and all points")
    report = progress or (lambda done, total: None)
    plan.prepare()
    store = Store.create(path, plan)
    with locked(path):
        store.remove_drafts()
        done, total = 0, plan.domain.size
        report(done, total)
        try:
            with contextlib.closing(complete_chunks(plan, path, scheduler, workers)) as chunks:
                for chunk in chunks:
                    done += plan.chunk_size(chunk)
                    report(done, total)
        except KeyboardInterrupt as interrupt:
            interrupt.add_note(str(SweepError(str(path), "interrupted", completed_count(path), plan.count)))
            raise
        except (StoreError, WorkersLostError) as error:
            raise SweepError(str(path), str(error), completed_count(path), plan.count) from error
        store.remove_drafts()
    import xarray

    with as_store_error(path, "metadata"):
        dataset: xarray.Dataset = xarray.open_zarr(path, zarr_format=3)
    return dataset
