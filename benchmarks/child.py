"""Measurements that need a new process: a first import, a first batch, a peak of memory.

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
    from benchmarks.poses import MACHINE, tiled

    spm.kinematics.compile_kernels()
    poses = tiled(count)
    _ = spm.inverse_displacement(MACHINE, poses[:10]).leg_lengths
    before = _peak()
    solutions = spm.inverse_displacement(MACHINE, poses)
    kept = solutions.middle_joints.nbytes + solutions.leg_lengths.nbytes
    return {"peak": _peak() - before, "answer": kept}


def _batch(kind: str, count: int) -> dict[str, Any]:
    """Time the first large batch of a process: all branches, or the physical one."""
    import spm_pin as spm
    from benchmarks.poses import MACHINE, tiled

    spm.kinematics.compile_kernels()
    poses = tiled(count)
    solve = spm.inverse_displacement if kind == "all" else spm.inverse_physical
    solve(MACHINE, poses[:1])
    begin = time.perf_counter()
    with spm.threads(1):
        solve(MACHINE, poses)
    return {"seconds": time.perf_counter() - begin}


def main() -> None:
    """Run the command of the first argument."""
    sys.path.insert(0, str(ROOT))
    command, *arguments = sys.argv[1:]
    measured = {
        "import": _import,
        "memory": lambda: _memory(int(arguments[0])),
        "batch": lambda: _batch(arguments[0], int(arguments[1])),
    }
    print(json.dumps(measured[command]()))


if __name__ == "__main__":
    main()
