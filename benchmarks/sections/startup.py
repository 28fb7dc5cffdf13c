"""Times of the import and of single calls."""

from __future__ import annotations

import numpy as np

import spm_pin as spm
from benchmarks import child
from benchmarks.poses import MACHINE, leg_space
from benchmarks.report import Facts, Section, spread_of_seconds, table
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, Spread, TimedCall, time_in_turns


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time imports and single calls."""
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
    _single(section, pace, progress, facts)
    return section


def _single(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time calls with one problem each."""
    pose = leg_space(1)[0]
    matrix = pose.as_matrix()
    solutions = spm.inverse_displacement(MACHINE, pose)
    state = solutions.configurations[int(np.flatnonzero(solutions.exists)[0])]
    arrays = state.rotation, state.translation, state.middle_joints
    lengths, wrench = state.leg_lengths, np.ones(6)
    moved, stage = lengths + 1e-3, spm.Stage(0.5, 0.3)
    stage_state = spm.inverse_physical(stage, 0.6, tilt=0.1, azimuth=0.0)

    def new() -> spm.Configuration:
        return spm.Configuration.from_arrays(MACHINE, *arrays)

    calls = {
        "`inverse_displacement`, RigidTransform, with lengths": lambda: (
            spm.inverse_displacement(MACHINE, pose).leg_lengths
        ),
        "`inverse_displacement`, 4 × 4 array, with lengths": lambda: (
            spm.inverse_displacement(MACHINE, matrix).leg_lengths
        ),
        "`inverse_jacobian`": lambda: spm.inverse_jacobian(new()),
        "`leg_forces`": lambda: spm.leg_forces(new(), wrench),
        "`forward_physical`": lambda: spm.forward_physical(MACHINE, lengths),
        "`forward_physical`, near a state": lambda: spm.forward_physical(MACHINE, moved, near=state),
        "`forward_displacement`": lambda: spm.forward_displacement(MACHINE, lengths),
        "`inverse_displacement` of a stage": lambda: spm.inverse_displacement(stage, 0.6, tilt=0.1, azimuth=0.0),
        "`forward_physical` of a stage": lambda: spm.forward_physical(stage, stage_state.readings),
        "`forward_displacement` of a stage": lambda: spm.forward_displacement(stage, stage_state.readings),
    }
    timings = time_in_turns([TimedCall(name, call, 1) for name, call in calls.items()], pace, progress)
    first = timings[next(iter(calls))].spread
    facts["startup/one pose"] = Spread(1e6 * first.median, 1e6 * first.low, 1e6 * first.high)
    section.add("A single problem through the public functions, everything warm:")
    rows = [[name, *spread_of_seconds(timing.spread)] for name, timing in timings.items()]
    section.add(table(["one call of", "time", "quartiles"], rows))
