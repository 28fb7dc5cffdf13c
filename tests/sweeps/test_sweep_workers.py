"""Sweeps by several processes that are killed, interrupted, or lost."""

from __future__ import annotations

import logging
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import stores
from distributed import Client, LocalCluster
from stores import contents, records, small, times

import spm_pin as spm
from spm_pin.sweeps import (
    METRICS,
    Metric,
    Points,
    StoreError,
    SweepError,
    pose_grid,
    resume_sweep,
    run_sweep,
    runner,
    sweep_status,
)

EVERYTHING = tuple(name for name in METRICS if name != "assembly_modes")


def run_long(path: Path, workers: int, slices: int) -> Any:
    """Run a sweep of `slices` chunks with many metrics."""
    domain = pose_grid((0.3, 0.5, slices), (-0.2, -0.1, 20), (2.4, 2.6, 20), xyx=[0.01, (0.28, 0.36, 5), 0.1])
    return run_sweep(stores.MACHINE, domain, EVERYTHING, path, workers=workers, chunk=2000)


def local_cluster(count: int, processes: bool = True) -> LocalCluster:
    return LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        processes=processes,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with local_cluster(2) as cluster:
        yield cluster


def start(path: Path, slices: int) -> subprocess.Popen[str]:
    """Run a long sweep with two workers in a process group of its own."""
    code = (
        "import os, pathlib, signal, sys\n"
        "sys.path[:0] = sys.argv[2:4]\n"
        "from test_sweep_workers import run_long\n"
        "if __name__ == '__main__':\n"
        f"    run_long(pathlib.Path(sys.argv[1]), workers=2, slices={slices})\n"
    )
    script = path.with_name("script.py")
    script.write_text(code)
    here = Path(__file__).parent
    return subprocess.Popen(
        [sys.executable, "-W", "error", str(script), str(path), str(here), str(here.parents[0])],
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_records(path: Path, count: int, process: subprocess.Popen[str]) -> None:
    """Wait until there are `count` records, or the process has ended."""
    deadline = time.monotonic() + 300
    while len(records(path)) < count and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)


def test_several_processes_write_the_same_bytes_as_one(tmp_path: Path, undisturbed: Path) -> None:
    counted: list[tuple[int, int]] = []
    small(tmp_path / "map.zarr", workers=2, progress=lambda done, total: counted.append((done, total)))
    assert contents(tmp_path / "map.zarr") == contents(undisturbed)
    assert counted == [(90 * k, 630) for k in range(8)]


KILLED = """
import os, pathlib, signal, sys
sys.path.insert(0, sys.argv[2])
import stores
stores.small(pathlib.Path(sys.argv[1]), progress=lambda done, _: done > 200 and os.kill(os.getpid(), signal.SIGKILL))
"""


def test_a_sweep_that_is_killed_goes_on_without_loss(tmp_path: Path, undisturbed: Path) -> None:
    killed = tmp_path / "map.zarr"
    tests = str(Path(__file__).parents[1])
    done = subprocess.run([sys.executable, "-c", KILLED, str(killed), tests], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    kept = times(killed)
    assert sweep_status(killed).done == len(kept) == 3
    resume_sweep(killed, workers=1)
    assert kept.items() <= times(killed).items()
    assert contents(killed) == contents(undisturbed)


@pytest.mark.slow
def test_a_sweep_of_several_processes_killed_twice_ends_with_the_store_of_an_undisturbed_run(tmp_path: Path) -> None:
    slices, done = 24, 0
    whole, killed = tmp_path / "whole.zarr", tmp_path / "killed.zarr"
    run_long(whole, workers=2, slices=slices)
    # First all processes, then only the one that drives; its workers have to notice.
    for kill in (os.killpg, os.kill):
        with start(killed, slices) as process:
            wait_for_records(killed, done + 1, process)
            time.sleep(0.2)
            assert process.poll() is None, process.communicate()
            kill(process.pid, signal.SIGKILL)
            process.wait()
        before = times(killed)
        assert done < len(before) < slices
        done = len(before)
    with start(killed, slices) as process:
        errors = process.communicate()[1]
    assert (process.returncode, errors) == (0, "")
    assert before.items() <= times(killed).items()
    assert contents(killed) == contents(whole)


def test_a_client_is_given_all_chunks_in_parts_and_left_open(
    tmp_path: Path, undisturbed: Path, cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "_AHEAD", 2)
    with Client(cluster, set_as_default=False) as client:
        small(tmp_path / "map.zarr", workers=None, scheduler=client)
        assert client.submit(sum, [1, 2]).result() == 3
    assert contents(tmp_path / "map.zarr") == contents(undisturbed)


def test_metrics_of_users_are_sent_to_workers_and_their_errors_back(tmp_path: Path, cluster: LocalCluster) -> None:
    def fragile(points: Points) -> np.ndarray:
        raise ZeroDivisionError("of my own")

    shift, options = 2.0, {"workers": None, "scheduler": cluster.scheduler_address}
    mine = Metric("mine", "m", "x shifted", lambda points: points.coordinates[:, 0] + shift)
    found = small(tmp_path / "map.zarr", metrics=[mine], **options)
    assert (found.mine == found.x + 2).all()
    with pytest.raises(ZeroDivisionError, match="of my own"):
        small(tmp_path / "other.zarr", metrics=[Metric("fragile", "m", "", fragile)], **options)


@pytest.mark.slow
def test_workers_that_die_again_and_again_end_the_sweep(tmp_path: Path) -> None:
    def deadly(points: Points) -> np.ndarray:
        if points.coordinates[0, 0] > 0.42:
            os._exit(1)
        return points.coordinates[:, 0]

    path = tmp_path / "map.zarr"
    mine = Metric("deadly", "m", "", deadly)
    refused = pytest.raises(SweepError, match=r"several workers died.* chunks are complete")
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), refused as error:
        small(path, metrics=[mine], workers=2)
    assert error.value.done == len(records(path)) < 7


def limit_files(size: int) -> None:
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))


def test_a_disk_that_fails_the_workers(tmp_path: Path, undisturbed: Path, cluster: LocalCluster) -> None:
    path = tmp_path / "map.zarr"
    with Client(cluster, set_as_default=False) as client:
        client.run(limit_files, 20)
        with pytest.raises(SweepError, match=r"file too large.* 0 of 7 chunks are complete"):
            small(path, workers=None, scheduler=client)
        client.run(limit_files, resource.RLIM_INFINITY)
        small(path, workers=None, scheduler=client)
    assert contents(path) == contents(undisturbed)


def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, undisturbed: Path, cluster: LocalCluster) -> None:
    with Client(cluster, set_as_default=False) as client:
        victims = list(client.run(os.getpid).values())
    path = tmp_path / "map.zarr"

    def progress(done: int, total: int) -> None:
        if done and victims:
            os.kill(victims.pop(), signal.SIGKILL)
            victims.clear()

    small(path, workers=None, scheduler=cluster.scheduler_address, progress=progress)
    assert victims == []
    assert contents(path) == contents(undisturbed)


def test_a_scheduler_that_is_gone(tmp_path: Path, undisturbed: Path) -> None:
    path = tmp_path / "map.zarr"
    with local_cluster(1, processes=False) as cluster:

        def close(done: int, total: int) -> None:
            if done == 90:
                cluster.close()

        with pytest.raises(SweepError, match="the scheduler is gone"):
            small(path, workers=None, scheduler=cluster.scheduler_address, progress=close)
    resume_sweep(path, workers=1)
    assert contents(path) == contents(undisturbed)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", ""])
def test_a_scheduler_that_is_not_there(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_PATIENCE", 0.5)
    with pytest.raises(spm.ArgumentError, match="the address of a Dask scheduler"):
        small(tmp_path / "map.zarr", workers=None, scheduler=address)


def test_a_worker_of_another_version_or_elsewhere_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = runner.SweepPlan.make(stores.MACHINE, stores.GRID, (METRICS["reachable"],), 100)
    with pytest.raises(StoreError, match="need a file system in common"):
        runner.complete_chunk(plan, tmp_path / "nowhere.zarr", (0, 0, 0, 0))
    monkeypatch.setattr(spm, "__version__", "9.9")
    with pytest.raises(StoreError, match=r"of spm_pin 0\..* but the worker on .* has 9.9"):
        runner.complete_chunk(plan, tmp_path / "nowhere.zarr", (0, 0, 0, 0))


@pytest.mark.slow
def test_ctrl_c_ends_the_workers_quietly(tmp_path: Path) -> None:
    path = tmp_path / "map.zarr"
    with start(path, slices=200) as process:
        wait_for_records(path, 2, process)
        os.killpg(process.pid, signal.SIGINT)
        errors = process.communicate(timeout=300)[1]
    # One traceback, that of the interrupt, with its note at the end.
    assert errors.count("Traceback") == 1
    assert "KeyboardInterrupt\ninterrupted. " in errors
    assert "of 200 chunks are complete" in errors
    assert (path / "sweep" / "lock").read_bytes() == b""
