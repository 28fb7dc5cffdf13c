"""A sweep of ten million poses: throughput, and the memory of every process that takes part.

Three runs, each in a store of its own: some tenth of the points, all of them, and all in chunks four times as large.
If memory is bounded by the chunk, the first two peaks are the same and the third is higher by what the larger results
weigh. A fourth run looks at the complete store again: every chunk is verified and none computed. Before them, the time
that one core needs to evaluate points, by the processor's clock, so that other processes do not count.

`python benchmarks/sweep.py` takes some minutes on two cores; `--points 1000000` a tenth of that.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import threading
import time
from importlib.metadata import version
from pathlib import Path

import psutil

import spm_pin as spm
from spm_pin.sweeps.domains import Domain, SweepPlan
from spm_pin.sweeps.runner import CHUNK

MACHINE = spm.Manipulator.paper()
METRICS = ("reachable", "branches", "conditioning", "payload")
MIB = 2**20


class Memory:
    """The largest resident sizes of this process and of those it starts, sampled while the context is open."""

    def __init__(self) -> None:
        self.driver = 0
        self.worker = 0
        self.together = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Memory:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        here = psutil.Process()
        while not self._stop.wait(0.05):
            driver = here.memory_info().rss
            others = []
            for child in here.children(recursive=True):
                try:
                    others.append(child.memory_info().rss)
                except psutil.NoSuchProcess:
                    continue
            self.driver = max(self.driver, driver)
            self.worker = max([self.worker, *others])
            self.together = max(self.together, driver + sum(others))


def lattice(points: int) -> Domain:
    """Return a lattice of about `points` poses around one in the middle of the workspace, some 2 % of them reached."""
    state = spm.forward_physical(MACHINE, [1.2, 1.3, 1.4, 1.25, 1.35, 1.3])
    x, y, z = state.translation
    angles = state.pose.rotation.as_euler("XYX")
    first = max(2, round(points / (25 * 16 * 10**3)))
    return spm.sweeps.pose_grid(
        (x - 0.1, x + 0.1, first),
        (y - 0.1, y + 0.1, 25),
        (z - 0.1, z + 0.1, 16),
        xyx=[(angle - 0.1, angle + 0.1, 10) for angle in angles],
    )


def run(name: str, points: int, workers: int, chunk: int, store: Path) -> str:
    """Return one row of the table."""
    domain = lattice(points)
    begin = time.perf_counter()
    with Memory() as memory:
        found = spm.sweeps.run_sweep(MACHINE, domain, METRICS, store, workers=workers, chunk=chunk)
    seconds = time.perf_counter() - begin
    found.close()
    size = sum(file.stat().st_size for file in store.rglob("*") if file.is_file())
    peaks = " | ".join(f"{peak / MIB:.0f}" for peak in (memory.driver, memory.worker, memory.together))
    rate = domain.size / seconds
    return f"| {name} | {domain.size} | {chunk} | {seconds:.1f} | {rate:.0f} | {peaks} | {size / MIB:.1f} |"


def per_core(points: int) -> tuple[float, float]:
    """Return points per second of processor time: of a lattice of poses, and of leg lengths within the limits."""
    rates = []
    for domain in (lattice(points), spm.sweeps.leg_sample(points // 4, (1.1, 1.5), (1.1, 1.5))):
        plan = SweepPlan.make(MACHINE, domain, METRICS, CHUNK)
        index = next(iter(plan))
        begin = time.process_time()
        with spm.threads(1):
            plan.evaluate(index)
        rates.append(plan.chunk_size(index) / (time.process_time() - begin))
    return rates[0], rates[1]


def main() -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=10_000_000, help="how many poses, roughly (10000000)")
    parser.add_argument("--workers", type=int, default=2, help="processes (2)")
    parser.add_argument("--folder", type=Path, help="where to put the stores for the while; a temporary one")
    parser.add_argument("--write", type=Path, help="also write the table to this file")
    options = parser.parse_args()
    versions = ", ".join(f"{name} {version(name)}" for name in ("dask", "numpy", "xarray", "zarr"))
    load = psutil.getloadavg()[0]
    lines = [
        "# A sweep of poses",
        "",
        f"By `python benchmarks/sweep.py`: {', '.join(METRICS)};",
        f"{options.workers} worker processes on {psutil.cpu_count()} processors, load {load:.1f} beforehand.",
        "Memory is the largest resident size, in MiB, of the process that drives, of a worker, and of all",
        "together; pages that processes share are counted in each.",
        f"Python {platform.python_version()}, {versions}.",
        "",
        "| run | points | chunk | s | points/s | driver | worker | all | store |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    print("\n".join(lines), flush=True)
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        # Kernels are compiled once per machine, which is not what is measured.
        spm.sweeps.run_sweep(MACHINE, lattice(2000), METRICS, Path(folder, "first"), workers=1)
        poses, legs = per_core(options.points // 10)
        rows = (
            ("fewer points", options.points // 10, CHUNK, "tenth"),
            ("all", options.points, CHUNK, "all"),
            ("all, in larger chunks", options.points, 4 * CHUNK, "large"),
            ("all again: verified", options.points, CHUNK, "all"),
        )
        for name, points, chunk, store in rows:
            lines.append(run(name, points, options.workers, chunk, Path(folder, store)))
            print(lines[-1], flush=True)
    rates = f"One core evaluates {poses:.0f} poses, or {legs:.0f} sets of leg lengths, per second of processor time."
    lines += ["", rates]
    print(f"\n{rates}")
    if options.write is not None:
        options.write.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
