"""Motion in time: an explicit method of order eight in all joint coordinates, brought back onto the closures each step.

After each step q goes to the nearest closed one, and v to the admissible one nearest in kinetic energy. The work of all
forces is integrated beside the state. `docs/theory/dynamics.md` says why.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import DOP853
from scipy.optimize import brentq

from spm_pin.errors import ClosureError
from spm_pin.machine.legs import LEGS
from spm_pin.multibody.closure_solvers import close_loops
from spm_pin.multibody.constrained_model import AccelerationSolver, ConstrainedModel, TreeKinematics, read_vectors
from spm_pin.multibody.trajectory import increasing_times
from spm_pin.support.arguments import FloatArray, real_number

ForceFunction = Callable[[float, FloatArray, FloatArray], npt.ArrayLike]
"""A function of the time, q (18,) and v (18,): leg forces (6,), or a wrench (6,)."""
_Forces = Callable[[float, FloatArray, FloatArray], FloatArray]

LEAST_CONSTRAINED = 1e-5
"""Smallest singular value of the scaled closures at which a run ends: the forces in the balls grow as its inverse."""
SHORTEST_LEG = 1e-6
"""Length of a leg at which a run ends, in units of the middle platform's side: less has no direction."""
LARGEST_RATE = 1e100
"""Velocity, acceleration or power at which a run ends: SciPy's step control loops for ever on infinite ones."""
SHORTEST_PERIOD = 1e-7
"""Shortest period that is accepted, as a share of the run: more steps would not end."""


class SimulationEnd(enum.StrEnum):
    """Reason why a simulation ended."""

    COMPLETE = "complete"
    CONSTRAINT_SINGULARITY = "constraint singularity"
    COLLAPSE = "leg of no length"
    STALLED = "stalled"
    """Too fast for any step, for instance where forces are discontinuous or unbounded."""


@dataclass(frozen=True)
class Simulation:
    """A motion of a `ClosedChain` in time, at n times."""

    times: FloatArray
    """The requested times [s], shape (n,), up to the end of the motion; the last may be that of an event."""
    q: FloatArray
    """Joint values, shape (n, 18)."""
    v: FloatArray
    """Joint velocities, shape (n, 18)."""
    a: FloatArray
    """Joint accelerations, shape (n, 18)."""
    readings: FloatArray
    """Readings of the legs' encoders [m], for RRS legs [rad], shape (n, 6)."""
    leg_forces: FloatArray
    """Efforts of the actuators [N], for RRS legs torques [N m], shape (n, 6); positive increases the reading."""
    kinetic: FloatArray
    """Kinetic energy of all bodies [J], shape (n,)."""
    potential: FloatArray
    """Potential energy of all bodies [J], shape (n,)."""
    work: FloatArray
    """Work of the leg forces and the wrench since the start [J], shape (n,)."""
    closure_gap: FloatArray
    """The widest of the four gaps [m], shape (n,)."""
    end: SimulationEnd
    """Why it ended there."""
    detail: str
    """The leg, or the reason why no step was possible; may be empty."""
    limit_excess: FloatArray
    """Excess of readings above their limits, negative below them, shape (n, 6); 0 within."""

    def __repr__(self) -> str:
        last = f"t = {self.times[-1]:g} s" if self.times.size else "no time"
        return f"<Simulation: {self.times.size} times to {last}, {self.end}>"

    @property
    def complete(self) -> bool:
        """True if the simulation reached the last of the requested times."""
        return self.end is SimulationEnd.COMPLETE

    @property
    def energy(self) -> FloatArray:
        """Kinetic and potential energy [J], shape (n,)."""
        return np.asarray(self.kinetic + self.potential)

    @property
    def energy_error(self) -> FloatArray:
        """Energy gained since the start less the work done [J], shape (n,): zero but for errors of the method."""
        return np.asarray(self.energy - self.energy[0] - self.work)


def run_simulation(
    constrained: ConstrainedModel,
    q0: npt.ArrayLike,
    v0: npt.ArrayLike,
    times: npt.ArrayLike,
    forces: npt.ArrayLike | ForceFunction | None,
    wrench: npt.ArrayLike | ForceFunction | None,
    period: float | None,
    tolerance: float,
) -> Simulation:
    """Integrate the motion; see `ClosedChain.simulate`."""
    q, v = constrained.read_q(q0, "q0", single=True), read_vectors(v0, "v0", constrained.model.nv, single=True)
    kinematics = TreeKinematics(constrained)
    kinematics.evaluate(q)
    kinematics.check_closed(v, "v0")
    recorded = increasing_times(times)
    begin, until = float(recorded[0]), float(recorded[-1])
    real_number(tolerance, "tolerance", "a number from 1e-13 to 1e-3", least=1e-13, most=1e-3)
    if period is not None:
        expected = "a time in seconds, greater than zero and not less than 1e-7 of the run"
        real_number(period, "period", expected, above=0.0, least=SHORTEST_PERIOD * (until - begin))
    act = _as_function(np.zeros(6) if forces is None else forces, "forces")
    integrator = _Integrator(kinematics, None if wrench is None else _as_function(wrench, "wrench"), tolerance)

    state = integrator.closed(np.concatenate([q, v, [0.0]]))
    stop = integrator.stop_event(state, begin)
    for k, span in enumerate(itertools.pairwise(_force_times(begin, until, period))):
        applied = act if period is None else _as_function(act(span[0], *_parts(state)), "forces")
        if k == 0:
            integrator.record(begin, state, applied)
        if stop is not None or until == begin:
            break
        inside = recorded[(recorded > span[0]) & (recorded <= span[1])]
        state, stop = integrator.advance(state, span, inside, applied)
        if stop is not None:
            integrator.record(stop.time, state, applied)
    end = (SimulationEnd.COMPLETE, "") if stop is None else stop[:2]
    values: list[Any] = [*map(np.array, zip(*integrator.rows, strict=True)), *end]
    limits, readings = constrained.machine.limits, values[4]
    values.append(np.zeros(readings.shape) if limits is None else limits.excess(readings))
    return Simulation(*values)


def _as_function(force: Any, argument: str) -> _Forces:
    """Return a function from a constant or a function; what a function returns is checked."""
    if callable(force):
        # Copies: the function may change them.
        return lambda t, q, v: read_vectors(force(t, q.copy(), v.copy()), argument, 6, single=True)
    value = read_vectors(force, argument, 6, single=True)
    return lambda t, q, v: value


def _force_times(begin: float, until: float, period: float | None) -> list[float]:
    """Return when forces change, from the start to the end of the run."""
    if period is None:
        return [begin, until]
    # Multiples rather than sums, and no last period of rounding's length.
    count = max(1, math.ceil((until - begin) / period - 1e-9))
    return [*(begin + k * period for k in range(count)), until]


def _parts(state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return q and v of a state vector."""
    return state[:18], state[18:36]


class StopEvent(NamedTuple):
    """An event that ends a simulation: its kind, a sentence about it, and its time."""

    end: SimulationEnd
    detail: str
    time: float


class _UnboundedRateError(Exception):
    """Velocities, accelerations or power are too large to be integrated."""


class _Integrator:
    """Integrates the motion of a chain and records it; a state vector is q, v and the work done, shape (37,)."""

    def __init__(self, kinematics: TreeKinematics, wrench: _Forces | None, tolerance: float) -> None:
        self._kinematics, self._constrained = kinematics, kinematics.constrained
        self._solver = AccelerationSolver(self._constrained)
        self._wrench, self._tolerance = wrench, tolerance
        self._offsets = kinematics.constrained.machine.legs.offsets
        self.rows: list[tuple[Any, ...]] = []  # what is recorded: the first fields of `Simulation`

    def closed(self, state: FloatArray) -> FloatArray:
        """Return the state with q closed and v admissible."""
        q, v = _parts(state)
        q = close_loops(self._kinematics, q)
        jacobian = self._kinematics.constraint_jacobian
        across = np.linalg.solve(self._kinematics.mass_matrix(), jacobian.T)
        v = v - across @ np.linalg.solve(jacobian @ across, jacobian @ v)
        return np.concatenate([q, v, state[36:]])

    def _motion(
        self, time: float, q: FloatArray, v: FloatArray, forces: _Forces
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the accelerations, the leg forces and the power of all but gravity."""
        force, torques = forces(time, q, v), np.zeros(q.size)
        if self._wrench is not None:
            self._kinematics.evaluate(q)
            torques += self._kinematics.platform_torques(self._wrench(time, q, v))
        torques[self._constrained.legs] += force
        return self._solver.accelerations(q, v, torques), force, float(torques @ v)

    def record(self, time: float, state: FloatArray, forces: _Forces) -> None:
        """Record the motion at a time, unless the last record is of that time."""
        if self.rows and self.rows[-1][0] == time:
            return
        q, v = _parts(state)
        a, force, _ = self._motion(time, q, v, forces)
        self._kinematics.evaluate(q)
        energies, gap = self._kinematics.energies(v), self._kinematics.widest_gap
        self.rows.append(
            (time, q, v, a, self._constrained.readings(q) + self._offsets, force, *energies, float(state[-1]), gap)
        )

    def _margins(self, state: FloatArray) -> FloatArray:
        """Return how far a state is from ending a run, shape (7,): lengths of RPS legs [m], and σ of the closures."""
        kinematics, (q, _) = self._kinematics, _parts(state)
        kinematics.evaluate(q)
        kinematics.check_ball_angles()
        sigma = np.linalg.svd(kinematics.scaled_constraint_jacobian(), compute_uv=False)[-1]
        lengths = self._constrained.readings(q) - self._constrained.least_readings
        return np.append(lengths - SHORTEST_LEG * self._constrained.side, sigma - LEAST_CONSTRAINED)

    def stop_event(
        self, state: FloatArray, time: float, until: float | None = None, dense: Any = None
    ) -> StopEvent | None:
        """Return why no run can begin at a state, or what ends it first in the step that `dense` interpolates."""
        events = []
        for which in np.flatnonzero(self._margins(state) < 0.0).tolist():

            def margin(t: float, which: int = which) -> float:
                # Rounding must not have it end before the step begins.
                return float(self._margins(dense(t))[which]) if t > time else float(np.finfo(np.float64).tiny)

            when = time if until is None else float(brentq(margin, time, until, xtol=1e-15, rtol=1e-14))
            if which < len(LEGS):
                events.append(StopEvent(SimulationEnd.COLLAPSE, LEGS[which], when))
            else:
                events.append(StopEvent(SimulationEnd.CONSTRAINT_SINGULARITY, "", when))
        return min(events, key=lambda event: event.time, default=None)

    def advance(
        self, state: FloatArray, span: tuple[float, float], times: FloatArray, forces: _Forces
    ) -> tuple[FloatArray, StopEvent | None]:
        """Integrate over a span of time, recording at `times` within; return the state there, or where it ended."""

        def rate(time: float, state: FloatArray) -> FloatArray:
            q, v = _parts(state)
            a, _, power = self._motion(time, q, v, forces)
            rates = np.concatenate([v, a, [power]])
            if not np.abs(rates).max() < LARGEST_RATE:
                raise _UnboundedRateError
            return rates

        before, waiting = span[0], 0
        try:
            solver = DOP853(rate, span[0], state, span[1], rtol=self._tolerance, atol=self._tolerance)
            while solver.status == "running":
                before = float(solver.t)
                # It returns a message where its status becomes "failed".
                if solver.step() is not None:
                    return state, StopEvent(SimulationEnd.STALLED, "no step is short enough", before)
                # Of the original step, before its end is projected onto the closures.
                dense, time = solver.dense_output(), float(solver.t)
                stop = self.stop_event(dense(time), before, time, dense)
                time, end = (time, solver.y) if stop is None else (stop.time, dense(stop.time))
                try:
                    closed = self.closed(end)
                except (ClosureError, np.linalg.LinAlgError):
                    return state, StopEvent(SimulationEnd.STALLED, "the loops do not close any more", before)
                while waiting < times.size and times[waiting] <= time:
                    moment = float(times[waiting])
                    self.record(moment, closed if moment == time else self.closed(dense(moment)), forces)
                    waiting += 1
                if stop is not None:
                    return closed, stop
                state = closed
                solver.y, solver.f = closed, rate(time, closed)
        except _UnboundedRateError:
            return state, StopEvent(SimulationEnd.STALLED, "velocities, accelerations or power above 1e100", before)
        return state, None
