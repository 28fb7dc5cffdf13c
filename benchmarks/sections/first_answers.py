"""CPU time of new processes to their first answer, beside that of importing NumPy and SciPy."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.report import Facts, Section, spread_of_seconds, table, times
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, Spread

_UNIT = "import numpy, scipy.spatial.transform"
_ROBOT = """import numpy as np, spm_pin as spm
machine = spm.Manipulator.paper()
readings = [1.20, 1.20, 1.40, 1.25, 1.20, 1.50]
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
"""
_CALIBRATED = f"{_ROBOT}machine = machine.perturbed(0)\n"
_STATE = "state = spm.forward_physical(machine, readings)\n"
_STAGE = "import spm_pin as spm\nstage = spm.Stage(0.5, 0.3)\n"
_STAGE_STATE = f"{_STAGE}state = spm.inverse_physical(stage, 0.6, tilt=0.1, azimuth=0.0)\n"
_ANSWERS = {
    "`inverse_displacement`": "spm.inverse_displacement(machine, pose)",
    "`inverse_physical`": "spm.inverse_physical(machine, pose)",
    "`forward_physical`": "spm.forward_physical(machine, readings)",
    "`forward_displacement`": "spm.forward_displacement(machine, readings)",
    "`inverse_jacobian`": f"{_STATE}spm.inverse_jacobian(state)",
    "`leg_forces`": f"{_STATE}spm.leg_forces(state, np.ones(6))",
    "`stiffness`": f"{_STATE}spm.stiffness(state, 1e7)",
    "`singularities`": f"{_STATE}spm.singularities(state)",
}
_STAGE_ANSWERS = {
    "`inverse_displacement` of a stage": f"{_STAGE}spm.inverse_displacement(stage, 0.6, tilt=0.1, azimuth=0.0)",
    "`forward_physical` of a stage": f"{_STAGE_STATE}spm.forward_physical(stage, state.readings)",
    "`forward_displacement` of a stage": f"{_STAGE_STATE}spm.forward_displacement(stage, state.readings)",
    "`leg_forces` of a stage": f"{_STAGE_STATE}spm.leg_forces(state, [0.0, 0.0, -1.0, 0.0, 0.0, 0.0])",
    "`singularities` of a stage": f"{_STAGE_STATE}spm.singularities(state)",
}
_RUN = "try:\n    main()\nexcept SystemExit as end:\n    assert end.code in (0, 5), end"  # 5: beyond the limits
_COMMANDS = (
    "--help",
    "forward --legs 1.2 1.2 1.4 1.25 1.2 1.5",
    "stage inverse --base 80 --platform 90 --crank 50 --rod 110 --unit mm --height 120 --roll 8",
    "inverse --translation 68.89 49.63 225.3 --xyx -11.08 32.97 -12.88 --unit cm",
    "nearest --translation 0.3 0.1 3.0 --xyx 6 17 -6",
    "export c-stage --base 0.5 --platform 0.3 --out .",
)
_PROGRAMS = {
    **{f"{name}, nominal": _ROBOT + code for name, code in _ANSWERS.items()},
    **{f"{name}, calibrated": _CALIBRATED + code for name, code in _ANSWERS.items()},
    **_STAGE_ANSWERS,
    "`nearest_reachable_pose`": f"{_ROBOT}far = spm.pose([0.3, 0.1, 3.0], xyx=[0.1, 0.3, -0.1])\n"
    "spm.workspace.nearest_reachable_pose(machine, far)",
}
_LONGER = {
    **{
        f"`spm-pin {command.partition(' --')[0]}`": "import sys\nfrom spm_pin.cli import main\n"
        f"sys.argv = {['spm-pin', *command.split()]}\n{_RUN}"
        for command in _COMMANDS
    },
    "10⁴ calls of `forward_physical`, nominal": f"{_ROBOT}for _ in range(10_000): {_ANSWERS['`forward_physical`']}",
}
"""Commands, and what is more than one answer."""


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Measure the CPU time of new processes, with an empty and with a warm cache of compiled kernels."""
    section = Section("First answers")
    repeats = 3 if pace.quick else 5
    units, ratios = [], {name: ([], []) for name in _PROGRAMS | _LONGER}
    for k in range(repeats):
        units.append(_cpu(_UNIT))
        for name, program in (_PROGRAMS | _LONGER).items():
            progress(f"first answers, {k + 1} of {repeats}: {name}")
            with tempfile.TemporaryDirectory() as folder:
                for ratio in ratios[name]:
                    ratio.append(_cpu(program, folder) / units[-1])
    facts["first/slowest"] = max((Spread.of(ratios[name][0]) for name in _PROGRAMS), key=lambda x: x.median)
    section.add(
        "CPU time of new processes that import the package and get one answer, imports and a state where one is needed "
        f"included, over that of `{_UNIT}`, {spread_of_seconds(Spread.of(units))[0]}. The cache of compiled kernels is "
        "empty, or left by the process before."
    )
    rows = [[name, *times(Spread.of(empty)), *times(Spread.of(warm))] for name, (empty, warm) in ratios.items()]
    section.add(table(["first answer of", "empty cache", "quartiles", "warm cache", "quartiles"], rows))
    return section


def _cpu(program: str, cache: str = "") -> float:
    """Return the CPU time of a new process that runs a program [s]."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    if cache:
        environment["NUMBA_CACHE_DIR"] = cache
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", program], check=True, env=environment, cwd=cache or None, **silent)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
