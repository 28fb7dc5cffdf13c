"""A tick of a controller by the exported C, Python and Pinocchio; and the time of every single call of the C."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import spm_pin as spm
from benchmarks.peers import completion
from benchmarks.peers.exported import CALLS, call_times, completions, ticks
from benchmarks.peers.one_state import PlainPinocchio
from benchmarks.peers.peer import FloatArray, Unavailable
from benchmarks.poses import MACHINE, leg_space
from benchmarks.report import Facts, Section, count, seconds, spread_of_seconds, table, times
from benchmarks.sections.jobs import walk
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, TimedCall, time_in_turns
from spm_pin.machine.joint_angles import JOINTS

_CHANGE = 1e-3
_STATES = 10_000
_WRENCH = np.array([30.0, -20.0, -500.0, 4.0, -6.0, 8.0])


def ticks_by_package(readings: FloatArray, wrench: FloatArray) -> Callable[[], tuple[FloatArray, ...]]:
    """Return a call of the ticks that `peers.exported.ticks` makes, by the package's kernels from Python."""
    start = spm.forward_physical(MACHINE, readings[0])

    def call() -> tuple[FloatArray, ...]:
        state, jacobian, forces = start, np.empty((6, 6)), np.empty(6)
        for now in readings:
            state = spm.forward_physical(MACHINE, now, near=state)
            jacobian, forces = spm.inverse_jacobian(state), spm.leg_forces(state, wrench)
        return jacobian, forces

    return call


def ticks_by_chain(
    chain: spm.ClosedChain, readings: FloatArray, wrench: FloatArray
) -> Callable[[], tuple[FloatArray, ...]]:
    """Return a call of the same ticks by the chain in Pinocchio."""
    start, state = chain.forward_kinematics(readings[0]), chain.state(np.zeros(18))

    def call() -> tuple[FloatArray, ...]:
        q, jacobian, forces = start, np.empty((6, 6)), np.empty(6)
        for now in readings:
            q = chain.forward_kinematics(now, q)
            jacobian, forces = state.update(q).inverse_jacobian(), state.leg_forces(wrench)
        return jacobian, forces

    return call


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time a tick, and each call of the exported functions."""
    del facts
    section = Section("Controllers")
    _ticks(section, pace, progress)
    _completions(section, pace, progress)
    _calls(section, pace, progress)
    return section


def _ticks(section: Section, pace: Pace, progress: Progress) -> None:
    """Time ticks along readings a millisecond apart, by all that can make them."""
    many, few = walk(_STATES), walk(100)
    chain = spm.ClosedChain.from_urdf()
    chain.loops.compile()
    plain, q = PlainPinocchio(chain), chain.forward_kinematics(few[0])
    calls = [
        TimedCall("spm_pin, functions of numbers from Python", ticks_by_package(few, _WRENCH), len(few)),
        TimedCall("spm_pin, `ClosedChain` on Pinocchio", ticks_by_chain(chain, few, _WRENCH), len(few)),
        TimedCall("Pinocchio's calls for the closures' Jacobian alone", lambda: plain.closures(q), 1),
    ]
    try:
        start = spm.forward_physical(MACHINE, many[:1])
        calls.insert(0, TimedCall("the exported C, `cc -std=c99 -O2`", ticks(start, many, _WRENCH), len(many)))
    except Unavailable as reason:
        section.add(f"*The exported C: {reason}*")
    timings = time_in_turns(calls, pace, progress)
    first = timings[calls[0].name]
    rows = [
        [call.name, *spread_of_seconds(timings[call.name].spread), *times(timings[call.name].over(first))]
        for call in calls
    ]
    section.add(
        "**A tick**: forward displacement from the state of the last tick, a millisecond before, J_f, and the leg "
        "forces that hold a wrench. The last row is what Pinocchio's C++ takes for one evaluation of the closures, of "
        "which a step of Newton's method there needs one:"
    )
    section.add(table(["", "a tick", "quartiles", "× the first", "quartiles"], rows))


def _completions(section: Section, pace: Pace, progress: Progress) -> None:
    """Time all eighteen joints of six slides, by the closed form and by an iteration on the closures."""
    readings, chain = walk(1_000), spm.ClosedChain.from_urdf()
    try:
        complete = completions(spm.forward_physical(MACHINE, readings[:1]), readings)
    except Unavailable as reason:
        section.add(f"*Completion of joints by the exported C: {reason}*")
        return
    iterate = completion.completions(chain, readings)
    calls = [
        TimedCall("the exported C", complete, len(readings)),
        TimedCall(f"Levenberg and Marquardt, tolerance {completion.TOLERANCE:g}", iterate, len(readings)),
    ]
    timings = time_in_turns(calls, pace, progress)
    exact = chain.joint_values(spm.forward_physical(MACHINE, readings))
    first, (joints, evaluations) = timings[calls[0].name], iterate()
    of_tree = chain.joint_indices(*JOINTS)
    errors = [np.abs(found - exact[:, of_tree]).max() for found in (complete(), joints[:, of_tree])]
    rows = [
        [
            call.name,
            *spread_of_seconds(timings[call.name].spread),
            *times(timings[call.name].over(first)),
            f"{error:.0e}",
        ]
        for call, error in zip(calls, errors, strict=True)
    ]
    section.add(
        "**All joints of six slides**, a millisecond apart, as publishers of joint states need them: `spm_forward` and "
        "`spm_joint_values`, and MINPACK on the gaps of the four closures in Pinocchio from the last joints, "
        f"{evaluations / len(readings):.1f} evaluations of gaps or their Jacobian a completion:"
    )
    section.add(table(["", "a completion", "quartiles", "× the first", "quartiles", "largest error [rad, m]"], rows))


def _calls(section: Section, pace: Pace, progress: Progress) -> None:
    """Time every single call of each exported function."""
    calls = 100_000 if pace.quick else 1_000_000
    progress(f"{count(calls)} calls of each exported function")
    states = spm.inverse_physical(MACHINE, leg_space(_STATES))
    try:
        times, failed = call_times(states, _CHANGE, calls)
    except Unavailable as reason:
        section.add(f"Calls of the exported C not timed: {reason}.")
        return
    section.add(
        f"**Every call of the exported C**: {count(calls)} calls of each function on states of leg lengths drawn "
        "uniformly from the limits, each between two readings of the clock; a state `near` is up to "
        f"{1e3 * _CHANGE:g} mm a leg, or in each direction, away. The worst calls are those that the system "
        "interrupted, as the row of the clock shows; the slowest state is the one whose calls have the largest median."
    )
    rows = []
    for name, seconds_of_calls, none in zip(CALLS, times, failed, strict=True):
        slowest = np.median(seconds_of_calls.reshape(-1, _STATES), axis=0).max()
        numbers = *np.quantile(seconds_of_calls, [0.5, 0.999, 1.0]), slowest
        rows.append([name, *(seconds(float(x)) for x in numbers), count(none)])
    section.add(table(["", "median", "99.9 %", "worst", "slowest state", "not found"], rows))
