"""Description of the machine on which the results were measured."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from pathlib import Path

from benchmarks.peers.compiled import FLAGS, compiler_version
from benchmarks.peers.peer import version
from benchmarks.report import table

_VECTORS = ("avx512f", "avx2", "avx", "sse4_2", "asimd", "sve")


def processor() -> tuple[str, str]:
    """Return the processor's name and its widest vector units."""
    try:
        fields = dict(
            (part.strip() for part in line.split(":", 1))
            for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
            if ":" in line
        )
    except OSError:
        return platform.processor() or platform.machine(), "unknown"
    flags = fields.get("flags", fields.get("Features", "")).split()
    return fields.get("model name", platform.machine()), next((v for v in _VECTORS if v in flags), "none known")


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_memory() -> float:
    """Return the memory that is available [B]; infinity where the system does not say."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    return float("inf")


def describe(packages: Sequence[str], load: Sequence[float]) -> str:
    """Return a table of the machine; `load` holds its load averages before and after."""
    name, vectors = processor()
    rows = [
        ["processor", f"{name}, {cores()} cores for this process, vectors: {vectors}"],
        ["system", f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"],
        ["C compiler", f"{compiler_version()}, `{' '.join(FLAGS)}`"],
        ["packages", ", ".join(f"{package} {version(package)}" for package in packages)],
        ["load average", " before, ".join(f"{value:.1f}" for value in load) + " after"],
    ]
    return table(["", ""], rows, left=2)
