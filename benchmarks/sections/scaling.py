"""Time against the size of the batch and the number of threads, and memory."""

from __future__ import annotations

import contextlib

import numpy as np

from benchmarks import child
from benchmarks.machine import available_memory, cores
from benchmarks.peers import c_loop, package
from benchmarks.peers.peer import Unavailable
from benchmarks.peers.peers_by_task import OURS
from benchmarks.poses import MACHINE, tiled
from benchmarks.report import Facts, Section, count, seconds, size, spread_of_seconds, table, times
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, TimedCall, time_in_turns
from spm_pin.kinematics.batches import parallel_for, threads

_SHARE = 0.5
"""Largest share of the free memory for a batch."""


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Measure batches, memory and threads of the full inverse displacement."""
    section = Section("Scaling")
    section.add(
        "Full inverse displacement through the public function, answers in new arrays. Large batches repeat ten "
        "thousand different poses."
    )
    per_pose = _memory(section, pace, progress)
    _batches(section, pace, progress, per_pose)
    _threads(section, pace, progress, facts, per_pose)
    return section


def _memory(section: Section, pace: Pace, progress: Progress) -> float:
    """Add the memory per pose; return the peak [B]."""
    poses = 100_000 if pace.quick else 300_000
    progress(f"memory of {poses} poses")
    measured = child.measure("memory", str(poses))
    section.add(
        f"**Memory.** A batch of {count(poses)} poses raises the peak of the process by "
        f"{size(measured['peak'] / poses)} a pose, of which {size(measured['answer'] / poses)} are ball joints and leg "
        "lengths."
    )
    return float(measured["peak"]) / poses


def _batches(section: Section, pace: Pace, progress: Progress, per_pose: float) -> None:
    largest = 5 if pace.quick else 7 if pace.full else 6
    fewer = Pace(max(3, pace.rounds // 3), pace.turn / 2.0, pace.quick)
    rows = []
    for exponent in range(largest + 1):
        n = 10**exponent
        if n * per_pose > _SHARE * available_memory():
            rows.append([count(n), f"*left out: needs {size(n * per_pose)}*", "", "", "", "", ""])
            continue
        poses = tiled(n)
        timed_calls = [TimedCall(OURS, package.inverse((MACHINE, poses)).call, n)]
        with contextlib.suppress(Unavailable):
            timed_calls.append(TimedCall("C loop", c_loop.fresh((MACHINE, poses)).call, n))
        timings = time_in_turns(timed_calls, fewer, progress)
        ours = timings[OURS]
        cells = [count(n), seconds(ours.spread.median * n), *spread_of_seconds(ours.spread)]
        if "C loop" in timings:
            cells += [*spread_of_seconds(timings["C loop"].spread)[:1], *times(ours.over(timings["C loop"]))]
        rows.append(cells + [""] * (7 - len(cells)))
    header = ["poses", "a call", "per pose", "quartiles", "C loop, new arrays", f"{OURS} / C loop", "quartiles"]
    section.add("**Batches**, one thread:")
    section.add(table(header, rows, left=0))


def _threads(section: Section, pace: Pace, progress: Progress, facts: Facts, per_pose: float) -> None:
    n = 100_000 if pace.quick else 1_000_000
    if n * per_pose > _SHARE * available_memory():
        section.add(f"**Threads.** Left out: {count(n)} poses need {size(n * per_pose)}.")
        return
    poses = tiled(n)
    memory = np.ones((n, 120))

    def fill() -> None:
        parallel_for(lambda part: memory[part].fill(1.0), n, 1)

    jobs = {
        "`inverse_displacement`": package.inverse((MACHINE, poses)).call,
        "`inverse_physical`, a fifth of the memory": package.inverse_physical((MACHINE, poses)).call,
        "memory filled that was written before, a kilobyte a pose": fill,
    }

    def shared(job: str, number: int) -> TimedCall:
        def on_threads() -> None:
            with threads(number):
                jobs[job]()

        return TimedCall(f"{job} {number}", on_threads, n)

    numbers = sorted({1, *(2**k for k in range(1, 8) if 2**k <= cores()), cores()})
    rounds = Pace(max(7, pace.rounds // 2), pace.turn, pace.quick)
    timings = time_in_turns([shared(job, number) for job in jobs for number in numbers], rounds, progress)
    rows = []
    for job in jobs:
        for number in numbers:
            timing = timings[f"{job} {number}"]
            ratio = timings[f"{job} 1"].over(timing)
            rows.append([job, str(number), *spread_of_seconds(timing.spread), *times(ratio)])
            if number == 2 and job == "`inverse_displacement`":
                facts["scaling/two threads"] = ratio
    section.add(f"**Threads**, {count(n)} poses, on {cores()} cores:")
    section.add(table(["", "threads", "per pose", "quartiles", "faster than one", "quartiles"], rows))
