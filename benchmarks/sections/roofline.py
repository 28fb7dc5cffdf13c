"""Times relative to the machine's bounds, by the roofline model of Williams, Waterman and Patterson (CACM 52, 2009)."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

import spm_pin as spm
from benchmarks.peers import c_loop, package
from benchmarks.peers.compiled import address, library
from benchmarks.peers.operations import Operations, count_operations
from benchmarks.peers.peer import Unavailable
from benchmarks.peers.peers_by_task import OURS
from benchmarks.poses import MACHINE, leg_space, tiled
from benchmarks.report import Facts, Section, count, seconds, size, spread_of_seconds, table, three_digits
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, Spread, TimedCall, Timing, time_in_turns

_FLAGS = ("-O3", "-march=native", "-fno-math-errno")
_CACHED = 2048
"""Number of doubles that fit into the first-level cache."""
_TURNS = 100_000
_KERNEL = f"{OURS}, kernel alone"
_FEW = 1000
"""Number of poses whose results, a megabyte, fit into a cache."""
_CACHE, _AGAIN, _NEW = "a cache", "memory written before", "new memory"
_PLACES = (_CACHE, _AGAIN, _NEW)
"""Memory that the results are written to."""


@dataclass(frozen=True)
class Limits:
    """Measured throughput of the machine in one second: operations, and bytes to and from memory."""

    multiply_adds: float
    divisions: float
    square_roots: float
    triad: float
    fill_cached: float
    fill_again: float
    fill_new: float

    def compute(self, operations: Operations) -> tuple[float, float]:
        """Return the least time per pose [s] of the arithmetic, and of divisions and square roots."""
        return (
            operations.arithmetic / self.multiply_adds,
            operations.divisions / self.divisions + operations.square_roots / self.square_roots,
        )

    def memory(self, read: float, written: float, place: str) -> float:
        """Return the least time per pose [s] to read and write so many bytes, the results in one of `_PLACES`."""
        if place == _CACHE:
            return (read + written) / self.fill_cached
        return read / self.triad + written / (self.fill_new if place == _NEW else self.fill_again)


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Measure the limits of the machine and the solvers in the same rounds."""
    section = Section("Roofline")
    try:
        limits_of = _limits(pace)
        operations = count_operations(MACHINE, leg_space(1000))
    except Unavailable as reason:
        section.add(f"*Not measured: {reason}.*")
        return section
    small, large = _FEW, 100_000 if pace.quick else 1_000_000
    few, many = leg_space(_FEW), tiled(large)
    found = spm.kinematics.BranchMemory(MACHINE, large)
    timed_calls = [
        TimedCall(f"{OURS} {_CACHE}", package.inverse((MACHINE, few)).call, small),
        TimedCall(f"{_KERNEL} {_CACHE}", package.kernel((MACHINE, few)).call, small),
        TimedCall(f"C loop {_CACHE}", c_loop.answered((MACHINE, few)).call, small),
        TimedCall(f"{OURS} {_AGAIN}", lambda: spm.inverse_displacement(MACHINE, many, out=found), large),
        TimedCall(f"{_KERNEL} {_AGAIN}", package.kernel((MACHINE, many)).call, large),
        TimedCall(f"{OURS} {_NEW}", package.inverse((MACHINE, many)).call, large),
        TimedCall(f"C loop {_NEW}", c_loop.fresh((MACHINE, many)).call, large),
    ]
    timings = time_in_turns([*limits_of, *timed_calls], Pace(max(5, pace.rounds // 2), pace.turn / 2.0), progress)
    limits = Limits(*(1.0 / timings[call.name].spread.median for call in limits_of))
    arrays = c_loop.Arrays.of(few)
    read = arrays.poses.nbytes / small
    written = (arrays.joints.nbytes + arrays.lengths.nbytes + arrays.status.nbytes) / small
    bounds = {place: _bounds(limits, operations, read, written, place) for place in _PLACES}
    least = max(bounds[_CACHE].values())
    kernel = timings[f"{_KERNEL} {_CACHE}"].spread
    facts["roofline/inverse"] = Spread(kernel.median / least, kernel.low / least, kernel.high / least)
    section.add(_account(operations, read, written))
    section.add(_limits_table(limits, timings))
    sizes = {_CACHE: small, _AGAIN: large, _NEW: large}
    section.add(_table(bounds, timings, sizes))
    section.add(_reading(bounds, timings, sizes))
    return section


def _limits(pace: Pace) -> list[TimedCall]:
    """Return what measures the machine, in the order of `Limits`; an item is one operation, or one byte."""
    loaded, whole, real = library("limits.c", _FLAGS), ctypes.c_int64, ctypes.c_double
    loaded.multiply_add.restype = real
    near, far = np.full(_CACHED, 1.25), [np.ones(4_000_000 if pace.quick else 16_000_000) for _ in range(3)]
    n, size = whole(far[0].size), far[0].nbytes
    inner = whole(_TURNS // 100), whole(_CACHED), address(near)

    def triad() -> None:
        loaded.triad(n, *map(address, far), real(3.0))

    cached, again = np.ones(120 * _FEW), np.ones(far[0].size)

    def fill_cached() -> None:
        loaded.fill(whole(cached.size), address(cached), real(1.0))

    def fill_new() -> None:
        memory = np.empty(far[0].size)
        loaded.fill(n, address(memory), real(1.0))

    def multiply_add() -> None:
        loaded.multiply_add(whole(_TURNS), real(1.0))

    return [
        TimedCall("multiply-adds", multiply_add, _TURNS * 2 * 8 * 8),
        TimedCall("divisions", lambda: loaded.divide(*inner), _TURNS // 100 * _CACHED),
        TimedCall("square roots", lambda: loaded.square_root(*inner), _TURNS // 100 * _CACHED),
        TimedCall("triad", triad, 3 * size),
        TimedCall("fill, cached", fill_cached, cached.nbytes),
        TimedCall("fill, again", lambda: loaded.fill(n, address(again), real(1.0)), size),
        TimedCall("fill, new memory", fill_new, size),
    ]


def _account(operations: Operations, read: float, written: float) -> str:
    parts = {
        "additions": operations.additions,
        "multiplications": operations.multiplications,
        "divisions": operations.divisions,
        "square roots": operations.square_roots,
    }
    counted = ", ".join(f"{three_digits(value)} {name}" for name, value in parts.items())
    total = sum(parts.values())
    return (
        f"A pose costs the C loop {counted}, counted by running it on numbers that count, mean over poses in leg "
        f"space. It reads {size(read)} and writes {size(written)}: {three_digits(total / (read + written))} operations "
        "per byte."
    )


def _limits_table(limits: Limits, timings: dict[str, Timing]) -> str:
    rates = [
        ("multiply-adds, two operations each", limits.multiply_adds, "Gflop/s"),
        ("divisions", limits.divisions, "G/s"),
        ("square roots", limits.square_roots, "G/s"),
        ("triad, read and written", limits.triad, "GB/s"),
        ("fill, memory that stays in a cache", limits.fill_cached, "GB/s"),
        ("fill, memory written before, in no cache", limits.fill_again, "GB/s"),
        ("fill, memory new from the system", limits.fill_new, "GB/s"),
    ]
    names = "multiply-adds", "divisions", "square roots", "triad", "fill, cached", "fill, again", "fill, new memory"
    rows = []
    for (text, rate, unit), name in zip(rates, names, strict=True):
        spread = timings[name].spread
        low, high = 1e-9 / spread.high, 1e-9 / spread.low
        rows.append([text, f"{three_digits(rate / 1e9)} {unit}", f"{three_digits(low)} – {three_digits(high)}"])
    return table(["one thread", "measured", "quartiles"], rows)


def _bounds(limits: Limits, operations: Operations, read: float, written: float, place: str) -> dict[str, float]:
    arithmetic, roots = limits.compute(operations)
    return {
        "additions and multiplications": arithmetic,
        "divisions and square roots": roots,
        "memory": limits.memory(read, written, place),
    }


def _table(bounds: dict[str, dict[str, float]], timings: dict[str, Timing], sizes: dict[str, int]) -> str:
    rows = []
    for place, n in sizes.items():
        least = max(bounds[place].values())
        rows.append([count(n), place, "at best", seconds(least), "", "1"])
        for who in (OURS, _KERNEL, "C loop"):
            if f"{who} {place}" in timings:
                spread = timings[f"{who} {place}"].spread
                rows.append([count(n), place, who, *spread_of_seconds(spread), three_digits(spread.median / least)])
    return table(["poses a call", "results in", "", "per pose", "quartiles", "× at best"], rows, left=3)


def _reading(bounds: dict[str, dict[str, float]], timings: dict[str, Timing], sizes: dict[str, int]) -> str:
    sentences = []
    for place, n in sizes.items():
        tightest = max(bounds[place], key=lambda name: bounds[place][name])
        listed = ", ".join(f"{name} {seconds(value)}" for name, value in bounds[place].items())
        who = _KERNEL if f"{_KERNEL} {place}" in timings else OURS
        ratio = timings[f"{who} {place}"].spread.median / bounds[place][tightest]
        sentences.append(
            f"Of {count(n)} poses whose results go to {place}, the least times are {listed}. The bound is {tightest}, "
            f"and {who} takes {three_digits(ratio)} times that."
        )
    sentences.append(
        "The units work side by side, so the largest of the three is the bound. It is that of the C loop's formulas: "
        "additions and multiplications as if all could be fused in pairs, and nothing shared between families that the "
        "loop does not share."
    )
    return " ".join(sentences)
