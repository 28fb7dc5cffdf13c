"""Whole jobs from input to answer, each beside the tool that a user would otherwise take."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

import spm_pin as spm
from benchmarks.peers import c_loop
from benchmarks.peers.one_state import PlainPinocchio
from benchmarks.peers.peer import FloatArray, Unavailable
from benchmarks.poses import MACHINE, tiled
from benchmarks.report import Facts, Section, count, seconds, spread_of_seconds, table, three_digits, times
from benchmarks.sections.preparation import Progress, failure
from benchmarks.timing import Pace, Spread, TimedCall, duration, time_in_turns
from spm_pin.sweeps.domains import SweepPlan
from spm_pin.sweeps.runner import CHUNK

ACCURACY = 1e-4
"""Largest error of the leg lengths after a second, for every simulator [m]."""
METRICS = ("reachable", "branches", "conditioning", "payload")
_LENGTHS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
_STIFFNESS, _DAMPING = 2e4, 500.0


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time each job once or a few times, and its peer on a part of it."""
    section = Section("Whole jobs")
    section.add(
        "On one thread, from the input to the answer. Peers that answer one item at a time solve a part of the job; "
        "their times are per item as well."
    )
    fewer = Pace(3 if pace.quick else 5, pace.turn, pace.quick)
    chain = spm.ClosedChain.from_urdf()
    chain.loops.compile()
    n = 100_000 if pace.quick else 1_000_000
    with spm.threads(1):
        _log(section, chain, n, fewer, progress, facts)
        _commands(section, chain, n, fewer, progress)
        _sweep(section, n, fewer, progress, facts)
        _simulation(section, chain, fewer, progress, facts)
        _control(section, chain, 2_000 if pace.quick else 20_000, progress, facts)
    return section


def walk(count: int) -> FloatArray:
    """Return leg lengths (count, 6) [m] as a machine in motion reports them, a millisecond apart."""
    times = 1e-3 * np.arange(count)
    return np.asarray(_LENGTHS + 0.05 * np.sin(np.outer(times, 0.7 + 0.3 * np.arange(6))))


def _add(section: Section, calls: list[TimedCall], pace: Pace, progress: Progress, job: str, item: str) -> list[Spread]:
    """Time calls of which the first is the package's; return the time of all its items, then the peers' ratios."""
    timings = time_in_turns(calls, pace, progress)
    ours = timings[calls[0].name]
    rows = []
    for call in calls:
        timing = timings[call.name]
        ratio = ["1", ""] if timing is ours else times(timing.over(ours))
        rows.append([call.name, count(call.items), *spread_of_seconds(timing.spread), *ratio])
    section.add(f"**{job}**")
    section.add(table(["", f"{item}s a call", f"per {item}", "quartiles", "× spm_pin", "quartiles"], rows))
    whole = Spread.of(ours.seconds * calls[0].items)
    return [whole, *(timings[call.name].over(ours) for call in calls[1:])]


def _log(section: Section, chain: Any, n: int, pace: Pace, progress: Progress, facts: Facts) -> None:
    lengths, few = walk(n), 200
    near = chain.forward_kinematics(lengths[0])
    calls = [
        TimedCall("spm_pin, `ClosedChain.forward_kinematics`", lambda: chain.forward_kinematics(lengths), n),
        TimedCall("`ClosedChain`, from the state before", lambda: chain.forward_kinematics(lengths[:few], near), few),
    ]
    text = f"A log of {count(n)} leg lengths to the values of all joints"
    whole, _ = _add(section, calls, pace, progress, text, "reading")
    facts["jobs/log"] = Spread(*(1e6 / n * x for x in (whole.median, whole.low, whole.high)))


def _commands(section: Section, chain: Any, n: int, pace: Pace, progress: Progress) -> None:
    few, poses = 200, tiled(n)
    path = spm.forward_physical(MACHINE, walk(few)).pose
    near = chain.joint_values(spm.forward_physical(MACHINE, walk(1)[0]))
    calls = [
        TimedCall("spm_pin, `inverse_physical`", lambda: spm.inverse_physical(MACHINE, poses).leg_lengths, n),
        TimedCall(
            "`ClosedChain`, from the state before",
            lambda: chain.leg_lengths(chain.inverse_kinematics(path, near)),
            few,
        ),
    ]
    try:
        part = poses[:100_000]
        calls.append(
            TimedCall("C loop, all branches, no choice", c_loop.fresh((MACHINE, part)).call, len(part.as_matrix()))
        )
    except Unavailable as reason:
        section.add(f"*C loop: {reason}*")
    _add(section, calls, pace, progress, f"{count(n)} poses to the legs to command", "pose")


def box() -> list[tuple[float, float]]:
    """Return ranges of x, y, z [m] and three X-Y-X angles [rad] around the middle of the workspace."""
    state = spm.forward_physical(MACHINE, [1.2, 1.3, 1.4, 1.25, 1.35, 1.3])
    middle = [*state.translation, *state.pose.rotation.as_euler("XYX")]
    return [(float(value) - 0.1, float(value) + 0.1) for value in middle]


def metrics_by_numpy(poses: RigidTransform) -> tuple[npt.NDArray[Any], ...]:
    """Return the four metrics of poses (n,) from all branches, J_f and NumPy's inverses and decompositions."""
    found = spm.inverse_displacement(MACHINE, poses)
    state = found.physical()
    limits = MACHINE.limits
    assert limits is not None
    with np.errstate(invalid="ignore"):
        reachable = (state.leg_lengths >= limits.minimum).all(-1) & (state.leg_lengths <= limits.maximum).all(-1)
    conditioning, payload = np.full((2, len(reachable)), np.nan)
    linear_and_angular = np.linalg.inv(spm.inverse_jacobian(state[reachable]))
    scaled = linear_and_angular * np.repeat([1.0, MACHINE.platform_radius], 3)[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    conditioning[reachable] = values[:, -1] / values[:, 0]
    payload[reachable] = 1.0 / np.linalg.norm(linear_and_angular[:, :3], axis=-2).max(axis=-1)
    return reachable, found.count, conditioning, payload


def _sweep(section: Section, n: int, pace: Pace, progress: Progress, facts: Facts) -> None:
    x, y, z, *angles = box()
    domain = spm.sweeps.pose_sample(n, x, y, z, xyx=angles)
    drawn = np.random.default_rng(0).uniform(*np.transpose(box()), (10_000, 6))
    part = spm.pose(drawn[:, :3], xyx=drawn[:, 3:])

    def ours() -> None:
        with tempfile.TemporaryDirectory() as folder:
            spm.sweeps.run_sweep(MACHINE, domain, METRICS, f"{folder}/store", workers=1).close()

    calls = [
        TimedCall("spm_pin, `spm.sweeps.run_sweep`, with the start of a worker and the store", ours, n),
        TimedCall("J_f and `numpy.linalg.svd`, stacked, nothing stored", lambda: metrics_by_numpy(part), len(drawn)),
    ]
    text = f"A sweep of {count(n)} random poses: {', '.join(METRICS)}"
    _add(section, calls, Pace(2, pace.turn, pace.quick), progress, text, "point")
    plan = SweepPlan.make(MACHINE, domain, METRICS, CHUNK)
    rates = []
    for index in list(plan)[:3]:
        begin = time.process_time()
        plan.evaluate(index)
        rates.append(1e-6 * plan.chunk_size(index) / (time.process_time() - begin))
    facts["jobs/sweep"] = Spread.of(rates)


def of_simulation(chain: Any) -> tuple[FloatArray, FloatArray, Callable[..., FloatArray]]:
    """Return q, v and the forces (t, q, v) of a machine on stiff legs whose forces swing for a second."""
    q = chain.forward_kinematics(_LENGTHS)
    held = chain.state(q).inverse_dynamics(np.zeros(18))
    legs = chain.leg_indices
    rest = q[legs]

    def forces(t: float, q: FloatArray, v: FloatArray) -> FloatArray:
        swing = 300.0 * np.sin(12.0 * t + np.arange(6))
        return np.asarray(held + swing - _STIFFNESS * (q[legs] - rest) - _DAMPING * v[legs])

    return q, chain.state(q).joint_rates([0.1, -0.2, 0.15, 0.05, -0.1, 0.2]), forces


def _simulation(section: Section, chain: Any, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time each simulator at its longest step, or largest tolerance, that is accurate enough."""
    q, v, forces = of_simulation(chain)
    truth = chain.simulate(q, v, forces, [0.0, 1.0], tolerance=1e-12).readings[-1]
    legs = chain.leg_indices
    rows, fastest = [], np.inf

    def ours(tolerance: float) -> Callable[[], FloatArray]:
        return lambda: np.asarray(chain.simulate(q, v, forces, [0.0, 1.0], tolerance=tolerance).readings[-1])

    def mujoco(step: float, integrator: str) -> Callable[[], FloatArray]:
        from engines import Mujoco

        engine = Mujoco(step=step, integrator=integrator)
        return lambda: np.asarray(chain.leg_lengths(engine.run(q, v, forces, 1.0, legs)))

    peers: list[tuple[str, Callable[[float], Callable[[], FloatArray]], list[float]]] = [
        ("spm_pin, `ClosedChain.simulate`", ours, [10.0**-k for k in range(3, 9)]),
        ("MuJoCo, Runge-Kutta", partial(mujoco, integrator="mjINT_RK4"), [4e-3 / 2**k for k in range(7)]),
        ("MuJoCo, Euler", partial(mujoco, integrator="mjINT_EULER"), [4e-3 / 2**k for k in range(8)]),
    ]
    for name, prepare, settings in peers:
        progress(f"one second of simulation: {name}")
        value = error = taken = np.nan
        try:
            for value in settings:
                run = prepare(value)
                begin = time.perf_counter()
                error = float(np.abs(run() - truth).max())
                taken = time.perf_counter() - begin
                # A run that would take minutes at the next step is not made.
                if error <= ACCURACY or taken > (4.0 if pace.quick else 15.0):
                    break
        except Exception as reason:
            if name.startswith("spm_pin"):
                raise
            rows.append([name, f"*missing: {failure(reason)}*", "", "", ""])
            continue
        if taken < 3.0:
            taken = min(taken, *(duration(run) for _ in range(pace.rounds - 1)))
        fastest = taken if name.startswith("spm_pin") else fastest
        rows.append(
            [name, three_digits(1e6 * value), three_digits(1e6 * error), seconds(taken), three_digits(taken / fastest)]
        )
    section.add(
        "**One second of simulation**, at the longest step, or largest tolerance, at which the error of the leg "
        f"lengths is at most {1e6 * ACCURACY:.0f} µm, or the last one tried. Models are loaded beforehand; all call "
        "the same law of forces in Python:"
    )
    header = ["", "step [µs], or tolerance · 10⁶", "error [µm]", "time", "× spm_pin"]
    section.add(table(header, rows))


def tick(chain: Any) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return a controller's step: from leg lengths and rates of encoders to the forces that let the platform rest."""
    state, still = chain.state(np.zeros(18)), np.zeros(6)

    def step(lengths: FloatArray, rates: FloatArray) -> FloatArray:
        q = chain.forward_kinematics(lengths)
        v = state.update(q).joint_rates(rates)
        return np.asarray(state.update(q, v).inverse_dynamics(state.joint_accelerations(still)))

    return step


def _control(section: Section, chain: Any, n: int, progress: Progress, facts: Facts) -> None:
    """Time every control step on its own."""
    progress(f"{n} control ticks")
    lengths = walk(n + 1)
    rates = np.diff(lengths, axis=0) / 1e-3
    ours, plain = tick(chain), PlainPinocchio(chain)
    q = chain.forward_kinematics(lengths[0])
    still = np.zeros(18)

    def other(now: FloatArray, _: FloatArray) -> FloatArray:
        nonlocal q
        q = chain.forward_kinematics(now, near=q)
        return plain.inverse(q, still, still)

    rows = []
    for name, step in (("spm_pin", ours), ("`near=` and `rnea` of Pinocchio, at rest", other)):
        taken = np.empty(n)
        for k in range(n):
            begin = time.perf_counter()
            step(lengths[k], rates[k])
            taken[k] = time.perf_counter() - begin
        middle, rare, worst = np.quantile(taken[n // 100 :], [0.5, 0.999, 1.0])
        rows.append([name, *(seconds(float(x)) for x in (middle, rare, worst))])
        if name == "spm_pin":
            facts["jobs/tick"] = Spread(*[1e6 * float(middle)] * 3)
            facts["jobs/slow tick"] = Spread(*[1e3 * float(rare)] * 3)
    section.add(
        f"**A control tick**, {count(n)} of them: leg lengths and rates from encoders to the joints' values and "
        "velocities, and by inverse dynamics to the forces that stop the platform:"
    )
    section.add(table(["", "median", "99.9 %", "longest"], rows))
