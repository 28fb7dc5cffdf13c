"""Any closed chain, `spm_pin.loops`: forward calls, paths, batches and dynamics of the robots of examples/robots."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.optimize import least_squares

import spm_pin as spm
from benchmarks.report import Facts, Section, count, microseconds, spread_of_seconds, table, times
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, Spread, TimedCall, Timing, time_in_turns
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.state_kinematics import StateKinematics

Array = npt.NDArray[np.float64]
NAMES = ("four_bar", "five_bar", "ankle", "delta", "stewart")
FOLDER = Path(__file__).resolve().parents[2] / "examples/robots"
_SPREAD = 0.1
"""Targets differ from home by at most this, in units of `ConstraintRows.units`: 1 rad, or a fourth of a loop."""
_SINGLE, _BATCH, _PATH, _SCIPY = 20, 1000, 1000, 5
"""Targets of a call that is timed: one by one, as a batch, along a path, and by SciPy or mink."""
_MINK_STEPS, _MINK_ERROR = 50, 1e-9


def robot(name: str) -> ClosedChain:
    """Return a robot of examples/robots."""
    return ClosedChain.from_mjcf(FOLDER / f"{name}.xml")


def targets_near(chain: ClosedChain, home: Array, number: int) -> Array:
    """Return random values (number, n) of the actuated joints."""
    steps = np.random.default_rng(0).uniform(-_SPREAD, _SPREAD, (number, len(chain.actuated)))
    return home[chain.actuated_in_q] + steps * chain.rows.units[chain.actuated_in_v]


def path_of(chain: ClosedChain, home: Array, number: int) -> Array:
    """Return values (number, n) of the actuated joints along a closed curve through those at home."""
    angles = np.linspace(0.0, 2.0 * np.pi, number)[:, None] * np.arange(1, len(chain.actuated) + 1)
    return home[chain.actuated_in_q] + _SPREAD * np.sin(angles) * chain.rows.units[chain.actuated_in_v]


def by_scipy(chain: ClosedChain, home: Array) -> Callable[[Array], Array]:
    """Return the forward solution by `least_squares`: the same equations, with their Jacobian, from home."""
    equations, units = StateKinematics(chain), chain.rows.units
    unknown = np.setdiff1d(np.arange(chain.model.nv), chain.actuated_in_v)

    def moved(start: Array, x: Array) -> Array:
        step = np.zeros(chain.model.nv)
        step[unknown] = x
        return np.asarray(pin.integrate(chain.model, start, step * units))

    def at(q: Array) -> StateKinematics:
        equations.evaluate(q)
        return equations

    def solve(values: Array) -> Array:
        start = home.copy()
        start[chain.actuated_in_q] = values
        found = least_squares(
            lambda x: at(moved(start, x)).residual / equations.row_units,
            np.zeros(len(unknown)),
            lambda x: at(moved(start, x)).scaled_jacobian[:, unknown],
            xtol=1e-12,
            ftol=1e-15,
            gtol=1e-12,
        )
        return moved(start, found.x)

    return solve


def by_mink(name: str, chain: ClosedChain) -> Callable[[Array], Array]:
    """Return the forward solution, MuJoCo's qpos, by steps of mink from home: loops and actuated joints are tasks."""
    import mink
    import mujoco

    model, home = mujoco.MjModel.from_xml_path(str(FOLDER / f"{name}.xml")), chain.close()
    joints = {joint: chain.model.joints[chain.model.getJointId(joint)] for joint in chain.joint_names}
    start, costs = np.zeros(model.nq), np.zeros(model.nv)
    for joint, ours in joints.items():
        index, own = model.joint(joint).qposadr[0], home[ours.idx_q : ours.idx_q + ours.nq]
        if ours.nq in (4, 7):
            # MuJoCo writes the real part of a quaternion first.
            own = np.concatenate([own[:-4], np.roll(own[-4:], 1)])
        start[index : index + ours.nq] = own
    actuated = [model.joint(joint).qposadr[0] for joint in chain.actuated]
    costs[[model.joint(joint).dofadr[0] for joint in chain.actuated]] = 1.0
    loops, posture = mink.EqualityConstraintTask(model, 1.0), mink.PostureTask(model, costs)
    configuration = mink.Configuration(model)

    def solve(values: Array) -> Array:
        target = start.copy()
        target[actuated] = values
        posture.set_target(target)
        configuration.update(start)
        for _ in range(_MINK_STEPS):
            errors = loops.compute_error(configuration), configuration.q[actuated] - values
            if max(np.abs(error).max() for error in errors) <= _MINK_ERROR:
                break
            rates = mink.solve_ik(configuration, [loops, posture], 1.0, "daqp", limits=[])
            configuration.integrate_inplace(rates, 1.0)
        return np.array(configuration.q)

    return solve


def by_pinocchio(chain: ClosedChain) -> Callable[[Array, Array, Array], Array]:
    """Return forward dynamics by `pinocchio.constraintDynamics` alone; the chain has point closures only."""
    model, data = chain.model, chain.model.createData()
    constraints, memory = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for (first, second), places in zip(chain.rows.joints, chain.rows.placements, strict=True):
        kind = pin.ContactType.CONTACT_3D
        constraints.append(pin.RigidConstraintModel(kind, model, first, places[0], second, places[1], pin.LOCAL))
        memory.append(constraints[-1].createData())
    pin.initConstraintDynamics(model, data, constraints, memory)
    # Some equations depend on others: without damping the result is NaN.
    settings, forces = pin.ProximalSettings(0.0, 1e-12, 20), np.zeros(model.nv)

    def accelerations(q: Array, v: Array, tau: Array) -> Array:
        forces[chain.actuated_in_v] = tau
        return np.array(pin.constraintDynamics(model, data, q, v, forces, constraints, memory, settings))

    return accelerations


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time forward solutions beside SciPy's, then forward dynamics beside Pinocchio's."""
    section = Section("Any closed chain")
    section.add(
        "The robots are in `examples/robots`. A call and each member of a batch start from home, a sample of a path "
        "from the one before. `least_squares` solves the same equations from home, with their exact Jacobian, and "
        "does not check in which assembly mode it ends. mink takes steps of its quadratic program to errors of 1e-9."
    )
    chains = {name: robot(name) for name in NAMES}
    with spm.threads(1):
        forward, dynamics = {}, {}
        for name, chain in chains.items():
            progress(f"compiling the loops of {name}")
            chain.compile()
            forward[name] = time_in_turns(_forward_calls(chain, name), pace, progress)
            dynamics[name] = time_in_turns(_dynamics_calls(chain, name), pace, progress)
    _add_forward(section, forward, facts)
    _add_dynamics(section, dynamics, facts)
    return section


def _forward_calls(chain: ClosedChain, name: str) -> list[TimedCall]:
    home = chain.close()
    values, path = targets_near(chain, home, _BATCH), path_of(chain, home, _PATH)
    starts, solve = np.tile(home, (_BATCH, 1)), by_scipy(chain, home)
    calls = [
        TimedCall(f"single, {name}", lambda: [chain.forward(x, home) for x in values[:_SINGLE]], _SINGLE),
        TimedCall(f"batch, {name}", lambda: chain.forward(values, starts), _BATCH),
        TimedCall(f"path, {name}", lambda: chain.forward(path, home), _PATH),
        TimedCall(f"SciPy, {name}", lambda: [solve(x) for x in values[:_SCIPY]], _SCIPY),
    ]
    if importlib.util.find_spec("mink"):
        by_steps = by_mink(name, chain)
        calls.append(TimedCall(f"mink, {name}", lambda: [by_steps(x) for x in values[:_SCIPY]], _SCIPY))
    return calls


def _dynamics_calls(chain: ClosedChain, name: str) -> list[TimedCall]:
    rng, home = np.random.default_rng(1), chain.close()
    # Two states in turns, since a second call about the same state computes less.
    configurations = chain.forward(targets_near(chain, home, 2), np.tile(home, (2, 1)))
    rates, tau = rng.uniform(-0.1, 0.1, len(chain.actuated)), rng.uniform(-1.0, 1.0, len(chain.actuated))
    motions = [(q, chain.state(q).joint_rates(rates)) for q in configurations]
    state, plain = chain.state(*motions[0]), by_pinocchio(chain)
    return [
        TimedCall(f"dynamics, {name}", lambda: [state.update(*m).forward_dynamics(tau) for m in motions], 2),
        TimedCall(f"Pinocchio, {name}", lambda: [plain(*m, tau) for m in motions], 2),
    ]


def _add_forward(section: Section, timings: dict[str, dict[str, Timing]], facts: Facts) -> None:
    rows, ratios = [], []
    for name, timing in timings.items():
        scipy, ours = timing[f"SciPy, {name}"], [timing[f"{kind}, {name}"] for kind in ("single", "path", "batch")]
        ratios.append([scipy.over(one) for one in ours])
        medians = [spread_of_seconds(one.spread)[0] for one in (*ours, scipy)]
        mink = timing.get(f"mink, {name}")
        by_steps = [times(mink.over(one))[0] if mink else "not installed" for one in ours]
        rows.append([name.replace("_", "-"), *medians, *(times(ratio)[0] for ratio in ratios[-1]), *by_steps])
    header = [
        "",
        "single call",
        "sample of a path",
        "member of a batch",
        "`least_squares`",
        "× single",
        "× path",
        "× batch",
        "mink × single",
        "× path",
        "× batch",
    ]
    section.add(f"Forward solution, per target; a batch and a path have {count(_BATCH)}:")
    section.add(table(header, rows))
    for k, kind in enumerate(("single", "path", "batch")):
        facts[f"loops/{kind}"] = microseconds(
            _extreme([timing[f"{kind}, {name}"].spread for name, timing in timings.items()], max)
        )
        facts[f"loops/SciPy over {kind}"] = _extreme([ratio[k] for ratio in ratios], min)


def _add_dynamics(section: Section, timings: dict[str, dict[str, Timing]], facts: Facts) -> None:
    rows, ratios = [], []
    for name, timing in timings.items():
        ours, plain = timing[f"dynamics, {name}"], timing[f"Pinocchio, {name}"]
        ratios.append(ours.over(plain))
        cells = [spread_of_seconds(one.spread)[0] for one in (ours, plain)]
        rows.append([name.replace("_", "-"), *cells, *times(ratios[-1])])
    section.add("Forward dynamics of a new state per call, beside `pinocchio.constraintDynamics` alone:")
    section.add(table(["", "`forward_dynamics`", "`constraintDynamics`", "ratio", "quartiles"], rows))
    facts["loops/dynamics"] = _extreme(ratios, max)


def _extreme(spreads: list[Spread], choose: Callable[..., Spread]) -> Spread:
    """Return the spread with the largest or smallest median: that of the least favourable robot."""
    return choose(spreads, key=lambda spread: spread.median)
