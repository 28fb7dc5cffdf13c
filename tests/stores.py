"""Sweeps for tests: a small one, its undisturbed store, and what a store holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import spm_pin as spm

MACHINE = spm.Manipulator.paper()
GRID = spm.sweeps.pose_grid((0.37, 0.44, 7), (-0.16, -0.12, 6), (2.45, 2.55, 5), xyx=[0.01, (0.3, 0.34, 3), 0.1])
METRICS = ("reachable", "branches", "conditioning", "payload")
CHUNK = 100
"""Seven chunks of 90 points each, some of which are reached."""


def small(path: Path, **changes: Any) -> Any:
    """Run the small sweep, in this process by default."""
    arguments = {"machine": MACHINE, "domain": GRID, "metrics": METRICS, "chunk": CHUNK, "workers": 1} | changes
    return spm.sweeps.run_sweep(store=path, **arguments)


def contents(path: Path) -> dict[str, bytes]:
    """Return every file below `path` but the drafts of killed processes, and of its own name beside it."""
    files = (file for file in path.rglob("*") if file.is_file() and not file.match("*.partial"))
    inside = {str(file.relative_to(path)): file.read_bytes() for file in files}
    beside = {file.name: b"" for file in path.parent.glob(f"*{path.name}*") if file != path}
    return inside | beside


def records(path: Path) -> list[Path]:
    """Return the marks of completed chunks, sorted."""
    return sorted((path / "sweep" / "done").glob("c.*"))


def times(path: Path) -> dict[str, int]:
    """Return when the mark of each completed chunk was written."""
    return {record.name: record.stat().st_mtime_ns for record in records(path)}
