"""Times of the import, of first calls and of single calls."""

from __future__ import annotations

import os
import tempfile

import numpy as np

import spm_pin as spm
from benchmarks import child
from benchmarks.poses import GEOMETRY, leg_space
from benchmarks.report import Facts, Section, spread_of_seconds, table
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, Spread, TimedCall, time_in_turns


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time imports, first calls and single calls."""
    section = Section("Start and single calls")
    repeats = 3 if pace.quick else 7
    imported = []
    for k in range(repeats):
        progress(f"import, {k + 1} of {repeats}")
        imported.append(child.measure("import"))
    loaded = Spread.of([result["seconds"] for result in imported])
    facts["startup/import"] = loaded
    heavy = sorted({name for result in imported for name in result["heavy"]})
    facts["startup/heavy"] = Spread(len(heavy), len(heavy), len(heavy))
    of = ", ".join(child.HEAVY)
    section.add(
        f"`import spm_pin` in a new process: {spread_of_seconds(loaded)[0]}. Of {of}, it loads "
        f"{', '.join(heavy) or 'none'}."
    )
    _first(section, 2 if pace.quick else 4, progress, facts)
    _single(section, pace, progress, facts)
    return section


def _first(section: Section, repeats: int, progress: Progress, facts: Facts) -> None:
    """Time first calls in new processes, with an empty cache of compiled kernels and with a full one."""
    fresh: list[dict[str, float]] = []
    warm: list[dict[str, float]] = []
    libraries = []
    for k in range(repeats):
        progress(f"first calls, {k + 1} of {repeats}")
        with tempfile.TemporaryDirectory() as folder:
            environment = os.environ | {"NUMBA_CACHE_DIR": folder}
            fresh.append(child.measure("first", environment=environment))
            warm.append(child.measure("first", environment=environment))
        libraries.append(child.measure("libraries")["seconds"])
    rows = []
    for name in (child.WITH_IMPORTS, *child.FIRST):
        both = [Spread.of([result[name] for result in runs]) for runs in (fresh, warm)]
        rows.append([f"`{name}`", *spread_of_seconds(both[0]), *spread_of_seconds(both[1])])
        if name == "inverse_displacement":
            facts["startup/fresh"], facts["startup/warm"] = both
        if name == child.WITH_IMPORTS:
            facts["startup/all fresh"], facts["startup/all warm"] = both
    section.add(
        "First calls of a process, one after the other, with an empty and with a warm cache of compiled kernels. The "
        "first row is from before `import spm_pin` to the first result; the others leave out what a pose imports. "
        f"NumPy, SciPy's transforms and Numba alone take {spread_of_seconds(Spread.of(libraries))[0]} to import."
    )
    section.add(table(["first call of", "empty cache", "quartiles", "warm cache", "quartiles"], rows))


def _single(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time calls with one problem each."""
    pose = leg_space(1)[0]
    matrix = pose.as_matrix()
    solutions = spm.inverse_displacement(GEOMETRY, pose)
    state = solutions.configurations[int(np.flatnonzero(solutions.exists)[0])]
    arrays = state.rotation, state.translation, state.middle_joints
    lengths, wrench = state.leg_lengths, np.ones(6)

    def new() -> spm.Configuration:
        return spm.Configuration.from_arrays(GEOMETRY, *arrays)

    calls = {
        "`inverse_displacement`, RigidTransform, with lengths": lambda: (
            spm.inverse_displacement(GEOMETRY, pose).leg_lengths
        ),
        "`inverse_displacement`, 4 × 4 array, with lengths": lambda: (
            spm.inverse_displacement(GEOMETRY, matrix).leg_lengths
        ),
        "`inverse_jacobian`": lambda: spm.inverse_jacobian(new()),
        "`leg_forces`": lambda: spm.leg_forces(new(), wrench),
        "`forward_physical`": lambda: spm.forward_physical(GEOMETRY, lengths),
        "`forward_displacement`": lambda: spm.forward_displacement(GEOMETRY, lengths),
    }
    timings = time_in_turns([TimedCall(name, call, 1) for name, call in calls.items()], pace, progress)
    first = timings[next(iter(calls))].spread
    facts["startup/one pose"] = Spread(1e6 * first.median, 1e6 * first.low, 1e6 * first.high)
    section.add("A single problem through the public functions, everything warm:")
    rows = [[name, *spread_of_seconds(timing.spread)] for name, timing in timings.items()]
    section.add(table(["one call of", "time", "quartiles"], rows))
