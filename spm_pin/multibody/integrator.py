"""Motion in time: an explicit method of order eight in all joint coordinates, brought back onto the closures each step.

The joint accelerations keep the loops closed to second order in time, so that errors of the method would open them.
After each step q goes to the nearest closed one, and v to the admissible one nearest in kinetic energy,

    v ← v - M⁻¹ Jcᵀ (Jc M⁻¹ Jcᵀ)⁻¹ Jc v,

moves as small as the error of the step. Eighteen joints rather than six coordinates: no choice of six is regular
everywhere, and these pass through inverse and forward singularities alike. The work of all forces is integrated beside
the state, so that energy less work is constant in every run, driven or not.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from spm_pin.errors import ClosureError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.leg_limits import LEGS, LegLimits
from spm_pin.multibody.closure_solvers import project_to_closure
from spm_pin.multibody.constrained_model import TreeKinematics
from spm_pin.multibody.dynamics import AccelerationSolver, energy_of, mass_matrix, wrench_torques
from spm_pin.multibody.vector_arguments import Wrenches

ForceCallback = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Forces at (t, q, v)."""

LEAST_CONSTRAINED = 1e-5
"""Smallest singular value of the scaled closures at which a run ends: the forces in the balls grow as its inverse."""

SHORTEST_LEG = 1e-6
"""Length of a leg at which a run ends, in units of the middle platform's side: less has no direction."""

LARGEST_RATE = 1e100
"""Velocity, acceleration or power at which a run ends: SciPy's step control loops for ever on infinite ones."""

BEYOND_BOUND = "velocities, accelerations or power above 1e100"


class SimulationEnd(enum.StrEnum):
    """Why a simulation ended."""

    COMPLETE = "complete"
    LIMIT = "leg limit"
    INVERSE_SINGULARITY = "inverse singularity"
    FORWARD_SINGULARITY = "forward singularity"
    CONSTRAINT_SINGULARITY = "constraint singularity"
    COLLAPSE = "leg of no length"
    STOPPED = "stopped"
    STALLED = "stalled"
    """Too fast for any step, as where forces are discontinuous or have no bound."""


SINGULAR_ENDS = (SimulationEnd.INVERSE_SINGULARITY, SimulationEnd.FORWARD_SINGULARITY)


class _InfiniteRateError(Exception):
    """The motion is too fast to be integrated."""


class Ending(NamedTuple):
    """Event that ends a simulation, and its time."""

    end: SimulationEnd
    detail: str
    time: float


class Integrator:
    """One simulation as it goes; a state vector is q, v and the work done, shape (37,).

    `kinematics` is moved; `wrenches` (6 n,) side by side act onto `frames`; the run stops at `limits` and `singular`.
    """

    def __init__(
        self,
        kinematics: TreeKinematics,
        frames: list[int],
        wrenches: ForceCallback,
        limits: LegLimits | None,
        singular: frozenset[SimulationEnd],
    ) -> None:
        self._kinematics, self._layout = kinematics, kinematics.layout
        self._solver = AccelerationSolver(kinematics.constrained)
        self._frames, self._wrenches = frames, wrenches
        self._limits, self._singular = limits, [end for end in SINGULAR_ENDS if end in singular]
        sides = () if limits is None else ("minimum", "maximum")
        # What ends the run, each with its margin.
        self._events = [(SimulationEnd.LIMIT, f"{leg}, {side}") for side in sides for leg in LEGS]
        self._events += [(end, "") for end in (SimulationEnd.CONSTRAINT_SINGULARITY, *self._singular)]
        self._size = len(self._layout.v)
        self._least = SHORTEST_LEG * self._layout.side
        self.rows: list[tuple[Any, ...]] = []  # what is recorded: the first fields of `Simulation`
        self.steps = self.evaluations = 0

    def start(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the state that begins at q and v."""
        return self._closed(np.concatenate([q, v, [0.0]]))

    def beyond(self, time: float, state: FloatArray) -> Ending | None:
        """Return the limit that a state is beyond."""
        lengths = self._layout.distances(state[: self._size])
        if lengths.min() < self._least:
            return Ending(SimulationEnd.COLLAPSE, LEGS[int(lengths.argmin())], time)
        margins = zip(self._events, self._margins(state), strict=True)
        ends = (Ending(*event, time) for event, margin in margins if event[0] not in SINGULAR_ENDS and margin < 0.0)
        return next(ends, None)

    def parts(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return q and v of a state."""
        return state[: self._size], state[self._size : -1]

    def record(self, time: float, state: FloatArray, forces: ForceCallback) -> None:
        """Record the motion at a time, unless the last record is of that time."""
        if self.rows and self.rows[-1][0] == time:
            return
        q, v = self.parts(state)
        a, force, _ = self._motion(time, q, v, forces)
        self._kinematics.evaluate(q)
        energy = energy_of(self._kinematics, v)
        gap = self._kinematics.widest_gap()
        self.rows.append((time, q, v, a, self._layout.leg_lengths(q), force, *energy, float(state[-1]), gap))

    def advance(
        self,
        state: FloatArray,
        span: tuple[float, float],
        times: FloatArray,
        forces: ForceCallback,
        tolerance: float,
        max_step: float,
        proceed: Callable[[float], bool],
    ) -> tuple[FloatArray, Ending | None]:
        """Integrate over a span of time, recording at `times` within; return the state there, or where it ended."""

        def rate(time: float, state: FloatArray) -> FloatArray:
            self.evaluations += 1
            q, v = self.parts(state)
            a, _, power = self._motion(time, q, v, forces)
            rates = np.concatenate([v, a, [power]])
            if not np.abs(rates).max() < LARGEST_RATE:
                raise _InfiniteRateError
            return rates

        margins, waiting = self._margins(state), 0
        try:
            solver = DOP853(rate, span[0], state, span[1], max_step=max_step, rtol=tolerance, atol=tolerance)
        except _InfiniteRateError:
            return state, Ending(SimulationEnd.STALLED, BEYOND_BOUND, span[0])
        while solver.status == "running":
            before = float(solver.t)
            try:
                # It returns a message where its status becomes "failed".
                if solver.step() is not None:
                    return state, Ending(SimulationEnd.STALLED, "no step is short enough", before)
            except _InfiniteRateError:
                return state, Ending(SimulationEnd.STALLED, BEYOND_BOUND, before)
            self.steps += 1
            time, collapse = self._collapse(solver, before)
            try:
                closed = self._closed(solver.y if collapse is None else np.asarray(solver.dense_output()(time)))
            except (ClosureError, np.linalg.LinAlgError):
                return state, Ending(SimulationEnd.STALLED, "the loops do not close any more", before)
            following = self._margins(closed)
            passed = [k for k, pair in enumerate(zip(margins, following, strict=True)) if self._passed(k, *pair)]
            inside = waiting < times.size and times[waiting] < time
            # Of the step as it was, before its end is moved onto the closures.
            dense = solver.dense_output() if inside or passed else None

            at = self._within(dense, (before, state), (time, closed))
            ending = self._first(passed, margins, at, before, time) or collapse
            last = time if ending is None else ending.time
            while waiting < times.size and times[waiting] <= last:
                self.record(float(times[waiting]), at(float(times[waiting])), forces)
                waiting += 1
            if ending is not None:
                return at(last), ending
            state, margins = closed, following
            if not proceed(time):
                return state, Ending(SimulationEnd.STOPPED, "", time)
            solver.y, solver.f = closed, rate(time, closed)
        return state, None

    def _within(
        self, dense: Any, begin: tuple[float, FloatArray], end: tuple[float, FloatArray]
    ) -> Callable[[float], FloatArray]:
        """Return the closed state as a function of time in a step, at its ends the states known there."""

        def at(time: float) -> FloatArray:
            if time <= begin[0]:
                return begin[1]
            return end[1] if time >= end[0] else self._closed(np.asarray(dense(time)))

        return at

    def _collapse(self, solver: Any, before: float) -> tuple[float, Ending | None]:
        """Return the time at which a step ends, with the first leg that has no length left if that ends it early."""
        lengths = self._layout.distances(solver.y[: self._size])
        if lengths.min() >= self._least:
            return float(solver.t), None
        dense = solver.dense_output()

        def length(time: float, k: int) -> float:
            left = float(self._layout.distances(np.asarray(dense(time))[: self._size])[k]) - self._least
            # Rounding must not take the length away before the step begins.
            return max(left, np.finfo(np.float64).tiny) if time <= before else left

        short = [int(k) for k in np.flatnonzero(lengths < self._least)]
        times = {k: float(brentq(length, before, solver.t, (k,), xtol=1e-15, rtol=1e-14)) for k in short}
        first = min(short, key=lambda k: times[k])
        return times[first], Ending(SimulationEnd.COLLAPSE, LEGS[first], times[first])

    def _first(
        self, passed: list[int], margins: list[float], at: Callable[[float], FloatArray], begin: float, end: float
    ) -> Ending | None:
        """Return the first event passed in a step."""

        def margin(time: float, k: int) -> float:
            return self._margins(at(time))[k]

        found = []
        for k in passed:
            time = begin if margins[k] == 0.0 else float(brentq(margin, begin, end, (k,), xtol=1e-15, rtol=1e-14))
            found.append(Ending(*self._events[k], time))
        return min(found, key=lambda ending: ending.time, default=None)

    def _passed(self, k: int, margin: float, following: float) -> bool:
        """Return whether an event occurs between one margin and the next."""
        if self._events[k][0] in SINGULAR_ENDS:
            return margin * following < 0.0 or (following == 0.0 and margin != 0.0)
        return following < 0.0

    def _margins(self, state: FloatArray) -> list[float]:
        """Return a margin for each event: positive inside a limit, of another sign beyond a singularity."""
        q, kinematics, margins = state[: self._size], self._kinematics, []
        if self._limits is not None:
            lengths = self._layout.leg_lengths(q)
            margins = [*(lengths - self._limits.minimum).tolist(), *(self._limits.maximum - lengths).tolist()]
        kinematics.evaluate(q)
        kinematics.require_ball_angles()
        margins.append(
            float(np.linalg.svd(kinematics.scaled_constraint_jacobian(), compute_uv=False)[-1]) - LEAST_CONSTRAINED
        )
        matrices = dict(zip(SINGULAR_ENDS, (kinematics.inverse_matrix, kinematics.forward_matrix), strict=True))
        return margins + [float(np.linalg.det(matrices[end]())) for end in self._singular]

    def _motion(
        self, time: float, q: FloatArray, v: FloatArray, forces: ForceCallback
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the accelerations, the leg forces and the power of all but gravity."""
        force = forces(time, q, v)
        torques = np.zeros(self._size)
        if self._frames:
            wrenches = Wrenches(self._wrenches(time, q, v), self._frames)
            self._kinematics.evaluate(q)
            torques += wrench_torques(self._kinematics, wrenches)
        torques[self._layout.legs] += force
        return self._solver.accelerations(q, v, torques), force, float(torques @ v)

    def _closed(self, state: FloatArray) -> FloatArray:
        """Return the state with q closed and v admissible."""
        q, v = self.parts(state)
        q = project_to_closure(q, self._kinematics)
        jacobian = self._kinematics.constraint_jacobian
        across = np.linalg.solve(mass_matrix(self._kinematics), jacobian.T)
        v = v - across @ np.linalg.solve(jacobian @ across, jacobian @ v)
        return np.concatenate([q, v, [state[-1]]])
