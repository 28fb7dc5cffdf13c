"""Measurements that need a new process: a first import, a first solve, a peak of memory.

Run by the benchmarks; each command prints a JSON object.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("numba", "casadi", "pinocchio", "dask", "trimesh", "viser", "matplotlib", "xacro")
WITH_IMPORTS = "import spm_pin; inverse_displacement"
FIRST = ("inverse_displacement", "inverse_jacobian", "leg_forces", "forward_physical", "forward_displacement")


def measure(command: str, *arguments: str, environment: dict[str, str] | None = None) -> dict[str, Any]:
    """Run a command of this file in a new process and return its measurements."""
    line = [sys.executable, str(Path(__file__).resolve()), command, *arguments]
    done = subprocess.run(line, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        raise RuntimeError(f"benchmarks/child.py {command} failed: {done.stderr.strip()[-2000:]}")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def _import() -> dict[str, Any]:
    begin = time.perf_counter()
    import spm_pin  # noqa: F401

    taken = time.perf_counter() - begin
    return {"seconds": taken, "heavy": [name for name in HEAVY if name in sys.modules]}


def _first() -> dict[str, Any]:
    """Time the first call of each function, and the first with all that comes before it: imports, geometry, pose."""
    start = time.perf_counter()
    import numpy as np

    import spm_pin as spm

    geometry = spm.Geometry.paper()
    pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    seconds = {}

    def timed(name: str, *arguments: Any) -> Any:
        begin = time.perf_counter()
        answer = getattr(spm, name)(*arguments)
        _ = getattr(answer, "leg_lengths", None)
        seconds[name] = time.perf_counter() - begin
        return answer

    solutions = timed("inverse_displacement", geometry, pose)
    seconds[WITH_IMPORTS] = time.perf_counter() - start
    state = solutions.configurations[solutions.exists][0]
    timed("inverse_jacobian", state)
    timed("leg_forces", state, np.ones(6))
    timed("forward_physical", geometry, state.leg_lengths)
    timed("forward_displacement", geometry, state.leg_lengths)
    return seconds


def _libraries() -> dict[str, Any]:
    """Time the imports alone of what a first solve cannot do without."""
    start = time.perf_counter()
    import numba  # noqa: F401
    import scipy.spatial.transform  # noqa: F401

    return {"seconds": time.perf_counter() - start}


def _peak() -> float:
    """Return the largest memory this process has held so far [B]."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    import resource

    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(largest) * (1.0 if sys.platform == "darwin" else 1024.0)


def _memory(count: int) -> dict[str, Any]:
    """Measure by how much a solve of `count` poses raises the peak, the poses themselves left out."""
    import spm_pin as spm
    from benchmarks.poses import GEOMETRY, tiled

    poses = tiled(count)
    _ = spm.inverse_displacement(GEOMETRY, poses[:10]).leg_lengths
    before = _peak()
    solutions = spm.inverse_displacement(GEOMETRY, poses)
    kept = solutions.middle_joints.nbytes + solutions.leg_lengths.nbytes
    return {"peak": _peak() - before, "answer": kept}


def _batch(kind: str, count: int) -> dict[str, Any]:
    """Time the first large batch of a process: all branches, or the physical one."""
    import spm_pin as spm
    from benchmarks.poses import GEOMETRY, tiled

    poses = tiled(count)
    solve = spm.inverse_displacement if kind == "all" else spm.inverse_physical
    solve(GEOMETRY, poses[:1])
    begin = time.perf_counter()
    with spm.threads(1):
        solve(GEOMETRY, poses)
    return {"seconds": time.perf_counter() - begin}


def main() -> None:
    """Run the command of the first argument."""
    sys.path.insert(0, str(ROOT))
    command, *arguments = sys.argv[1:]
    measured = {
        "import": _import,
        "first": _first,
        "libraries": _libraries,
        "memory": lambda: _memory(int(arguments[0])),
        "batch": lambda: _batch(arguments[0], int(arguments[1])),
    }
    print(json.dumps(measured[command]()))


if __name__ == "__main__":
    main()
