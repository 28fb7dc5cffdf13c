"""Conversions between poses, states and joint values: times per item of a batch, and of a single item."""

from __future__ import annotations

import numpy as np
from scipy.optimize import fsolve

import spm_pin as spm
from benchmarks import child
from benchmarks.peers.one_state import PlainPinocchio
from benchmarks.peers.package import renewed
from benchmarks.poses import MACHINE, leg_space, tiled
from benchmarks.report import Facts, Section, count, microseconds, spread_of_seconds, table, times
from benchmarks.sections.preparation import Progress
from benchmarks.sections.velocity import states
from benchmarks.timing import Pace, Spread, TimedCall, time_in_turns
from spm_pin.kinematics.inverse_displacement import BranchMemory
from spm_pin.kinematics.rates_and_forces import force_matrices

_MANY = 10_000
_BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time each conversion beside the call or the library that it uses."""
    section = Section("States and joints")
    with spm.threads(1):
        _batches(section, pace, progress, facts)
        _singles(section, pace, progress, facts)
        _memory(section, pace, progress, facts)
        _stages(section, pace, progress, facts)
    return section


def by_numpy(configuration: spm.Configuration) -> list[np.ndarray]:
    """Return the singular values of J_b, J_c and K (n, 6) by NumPy, with all vectors."""
    matrices = force_matrices(configuration)
    return [np.linalg.svd(matrices[:, :2])[1], np.linalg.svd(matrices[:, 2:])[1]]


def _batches(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    poses, few = leg_space(_MANY), 1000
    every = states(_MANY)
    chain = spm.ClosedChain.from_urdf()
    physical = spm.inverse_physical(MACHINE, poses)
    some = every[:few]
    calls = [
        TimedCall("`inverse_displacement`", lambda: spm.inverse_displacement(MACHINE, poses), _MANY),
        TimedCall("`inverse_physical`", lambda: spm.inverse_physical(MACHINE, poses), _MANY),
        TimedCall(
            "`SolutionSet.physical` of those", lambda: spm.inverse_displacement(MACHINE, poses).physical(), _MANY
        ),
        TimedCall("`singularities`", lambda: spm.singularities(renewed(every)), _MANY),
        TimedCall("the same matrices, `numpy.linalg.svd`", lambda: by_numpy(renewed(some)), few),
        TimedCall("`ClosedChain.joint_values`", lambda: chain.joint_values(renewed(physical)), _MANY),
    ]
    timings = time_in_turns(calls, pace, progress)
    rows = [[call.name, count(call.items), *spread_of_seconds(timings[call.name].spread)] for call in calls]
    section.add("Per item of a batch:")
    section.add(table(["", "items a call", "per item", "quartiles"], rows))
    facts["states/physical"] = timings["`inverse_physical`"].over(timings["`inverse_displacement`"])
    facts["states/singularities"] = microseconds(timings["`singularities`"].spread)
    facts["states/joint values"] = microseconds(timings["`ClosedChain.joint_values`"].spread)


def balls_by_scipy(readings: np.ndarray) -> np.ndarray:
    """Return the balls (n, 3, 3) of the balancer: `fsolve` on the three sides, from the level platform, one by one."""
    centres, radii = _BALANCER.legs.circles(readings)
    (outward, forward), corners = _BALANCER.legs.planes, _BALANCER.legs.balls
    squares = ((corners - np.roll(corners, -1, axis=0)) ** 2).sum(axis=-1)

    def balls(angles: np.ndarray, k: int) -> np.ndarray:
        return centres[k] + radii[k, :, None] * (np.cos(angles)[:, None] * outward + np.sin(angles)[:, None] * forward)

    def errors(angles: np.ndarray, k: int) -> np.ndarray:
        b = balls(angles, k)
        return ((b - np.roll(b, -1, axis=0)) ** 2).sum(axis=-1) - squares

    return np.array([balls(fsolve(errors, [1.5, 1.5, 1.5], (k,), xtol=1e-12), k) for k in range(len(readings))])


def _stages(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time the displacements of a ball balancer, a stage alone."""
    rng, few = np.random.default_rng(0), 50
    heights, tilts, azimuths = rng.uniform(0.11, 0.13, _MANY), rng.uniform(0.0, 0.3, _MANY), rng.uniform(-3, 3, _MANY)
    states = spm.inverse_physical(_BALANCER, heights, tilt=tilts, azimuth=azimuths)
    normals, readings = states.normal.copy(), states.readings
    scipy = "forward, SciPy's `fsolve` on the three sides"
    calls = [
        TimedCall("`inverse_physical`", lambda: spm.inverse_physical(_BALANCER, heights, normal=normals), _MANY),
        TimedCall("`inverse`, both modes", lambda: spm.inverse_displacement(_BALANCER, heights, normal=normals), _MANY),
        TimedCall("`forward_physical`", lambda: spm.forward_physical(_BALANCER, readings), _MANY),
        TimedCall(scipy, lambda: balls_by_scipy(readings[:few]), few),
    ]
    timings = time_in_turns(calls, pace, progress)
    rows = [[call.name, count(call.items), *spread_of_seconds(timings[call.name].spread)] for call in calls]
    section.add("A stage alone, a 3-RRS ball balancer, per item of a batch:")
    section.add(table(["", "items a call", "per item", "quartiles"], rows))
    facts["states/stage inverse"] = microseconds(timings["`inverse_physical`"].spread)
    facts["states/stage forward"] = microseconds(timings["`forward_physical`"].spread)
    facts["states/stage fsolve"] = timings[scipy].over(timings["`forward_physical`"])


def _singles(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time single calls, and the dynamics beside the Pinocchio calls and matrices that they contain."""
    chain = spm.ClosedChain.from_urdf()
    plain = PlainPinocchio(chain)
    pose = leg_space(1)[0]
    physical = spm.inverse_physical(MACHINE, pose)
    q = chain.joint_values(physical)
    v = chain.state(q).joint_velocities([0.1, -0.2, 0.1, 0.2, 0.1, -0.1])
    a = chain.state(q, v).joint_accelerations([1.0, 0.5, -0.5, 0.2, 0.3, 0.1])
    # Two states in turns, for the second call about the same one computes less.
    motions = [(q, v), (chain.forward_kinematics(physical.leg_lengths * 1.001), v)]
    motions[1] = motions[1][0], chain.state(motions[1][0]).joint_velocities([0.1, -0.2, 0.1, 0.2, 0.1, -0.1])
    forces, state = np.full(6, 100.0), chain.state(q, v)
    accelerations = [a, chain.state(*motions[1]).joint_accelerations([1.0, 0.5, -0.5, 0.2, 0.3, 0.1])]
    calls = {
        "`inverse_physical`": lambda: spm.inverse_physical(MACHINE, pose),
        "`ClosedChain.joint_values`": lambda: chain.joint_values(renewed(physical)),
        "forward dynamics, Pinocchio's calls alone": lambda: [plain.forward(*m, forces) for m in motions],
        "`state.forward_dynamics`": lambda: [state.update(*m).forward_dynamics(forces) for m in motions],
        "inverse dynamics, Pinocchio's calls alone": lambda: [
            plain.inverse(*m, x) for m, x in zip(motions, accelerations, strict=True)
        ],
        "`state.inverse_dynamics`": lambda: [
            state.update(*m).inverse_dynamics(x) for m, x in zip(motions, accelerations, strict=True)
        ],
    }
    timed = [TimedCall(name, call, 1 if k < 2 else 2) for k, (name, call) in enumerate(calls.items())]
    timings = time_in_turns(timed, pace, progress)
    rows = []
    for name, timing in timings.items():
        kind = "forward" if "forward" in name else "inverse"
        ratio = timing.over(timings[f"{kind} dynamics, Pinocchio's calls alone"])
        rows.append([name, *spread_of_seconds(timing.spread), *(times(ratio) if "dynamics" in name else ["", ""])])
    section.add(
        "One item a call. Pinocchio's calls alone are those for frames, constraint Jacobian, accelerations and its "
        "factorisation, without checks of arguments, closure or singularity:"
    )
    section.add(table(["one call of", "time", "quartiles", "× Pinocchio's calls", "quartiles"], rows))
    facts["states/one pose"] = microseconds(timings["`inverse_physical`"].spread)
    facts["states/one joint values"] = microseconds(timings["`ClosedChain.joint_values`"].spread)
    for kind in ("forward", "inverse"):
        ratio = timings[f"`state.{kind}_dynamics`"].over(timings[f"{kind} dynamics, Pinocchio's calls alone"])
        facts[f"states/{kind} dynamics"] = ratio


def _memory(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time first calls on new memory, and large batches on memory written before."""
    repeats, rows = 3 if pace.quick else 5, []
    for command, key, text in (
        ("all", "states/fresh all", "`inverse_displacement`"),
        ("physical", "states/fresh physical", "`inverse_physical`"),
    ):
        progress(f"first large batch of {command}")
        measured = [child.measure("batch", command, "100000")["seconds"] / 1e5 for _ in range(repeats)]
        rows.append(
            [
                f"{text}, {count(100_000)} poses, the first large call of a process",
                *spread_of_seconds(Spread.of(measured)),
            ]
        )
        facts[key] = Spread.of(1e6 * np.array(measured))
    n = 100_000 if pace.quick else 1_000_000
    large, small = tiled(n), leg_space(_MANY)
    found, less = BranchMemory(MACHINE, n), BranchMemory(MACHINE, _MANY)
    names = [f"`inverse_displacement(out=...)`, {count(n)} poses", f"the same, {count(_MANY)}"]
    calls = [
        TimedCall(names[0], lambda: spm.inverse_displacement(MACHINE, large, out=found), n),
        TimedCall(names[1], lambda: spm.inverse_displacement(MACHINE, small, out=less), _MANY),
    ]
    timings = time_in_turns(calls, Pace(max(5, pace.rounds // 3), pace.turn), progress)
    facts["states/out"] = timings[names[0]].over(timings[names[1]])
    rows += [[name, *spread_of_seconds(timings[name].spread)] for name in names]
    section.add("Memory new from the system, and memory written before:")
    section.add(table(["", "per pose", "quartiles"], rows))
