"""Motion of a closed chain in time: an explicit method of order eight, brought back onto the closures each step.

Joint values and velocities of the tree are integrated by DOP853. The result of each step is a closed q nearby, with
unit quaternions, and the admissible v nearest in kinetic energy. If rows depend on each other, which contradict each
other in open loops, so are the places within a step at which rates are computed. The work of all forces but gravity's
is integrated beside the state, so that energy gained less work done shows the method's error.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.integrate import DOP853
from scipy.linalg import lapack
from scipy.optimize import brentq

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.loops.loop_state import LoopState
from spm_pin.loops.state_kinematics import frame_index, largest, read_vectors
from spm_pin.support.arguments import FloatArray, Progress, check_function, increasing_times, real_number
from spm_pin.support.progress import shown_progress

Force = npt.ArrayLike | Callable[[float, FloatArray, FloatArray], npt.ArrayLike] | None
"""Constant values, or a function of the time, q (nq,) and v (nv,); None for zero."""

LARGEST_RATE = 1e100
"""Velocity, acceleration or power at which a run ends: SciPy's step control loops for ever on infinite ones."""
SHORTEST_PERIOD = 1e-7
"""Shortest period that is accepted, as a share of the run: more steps would not end."""
SHORTEST_STEP = 1e-12
"""Step, as a share of a period or of the run, at which a run ends if its rates cannot be computed within it."""
CLOSING_STEPS = 10
"""Newton's steps back onto the closures; one is the rule."""
CLOSED = 1e-14
"""Gap, relative to the loops, or Newton's step, relative to the joints' units, after which loops are closed."""
LEAST_CONSTRAINED, LEAST_SHARE = 1e-5, 1e-2
"""Independence of the rows, as `NullSpace.sigma`, at which a run ends: the forces of closures grow as its inverse. In
loops that are nearly dependent at the start, this share of what it is there."""


class SimulationEnd(enum.StrEnum):
    """Why a simulation ended."""

    COMPLETE = "complete"
    EVENT = "event"
    """A function of `events` became negative; `detail` is its name."""
    SINGULARITY = "singularity of the loops"
    """Forces of the closures have no bound there, or the motion is not unique."""
    STALLED = "stalled"
    """Too fast for any step, as where forces are discontinuous or have no bound."""


@dataclass(frozen=True)
class LoopMotion:
    """A motion of a `ClosedChain` in time, at k times."""

    times: FloatArray
    """The requested times [s], shape (k,), as far as the motion went; the last is that of an event that ended it."""
    q: FloatArray
    """Joint values, shape (k, nq)."""
    v: FloatArray
    """Joint velocities, shape (k, nv)."""
    a: FloatArray
    """Joint accelerations, shape (k, nv)."""
    tau: FloatArray
    """Forces of the actuators [N, N m], shape (k, n)."""
    kinetic: FloatArray
    """Kinetic energy of all bodies [J], shape (k,)."""
    potential: FloatArray
    """Potential energy of all bodies [J], shape (k,)."""
    work: FloatArray
    """Work of actuators and wrenches since the start [J], shape (k,)."""
    gap: FloatArray
    """Largest residual of a closure or joint equality, relative to the size of its loop, shape (k,)."""
    end: SimulationEnd
    """Why the run ended."""
    detail: str
    """Reason why an incomplete run stopped, or the name of the event; otherwise empty."""

    def __repr__(self) -> str:
        last = f"t = {self.times[-1]:g} s" if self.times.size else "no time"
        detail = f": {self.detail}" if self.detail else ""
        return f"<{type(self).__name__}: {self.times.size} times to {last}, {self.end}{detail}>"

    @property
    def complete(self) -> bool:
        """True if the motion reached the last of the requested times."""
        return self.end is SimulationEnd.COMPLETE

    @property
    def energy(self) -> FloatArray:
        """Kinetic and potential energy [J], shape (k,)."""
        return np.asarray(self.kinetic + self.potential)

    @property
    def energy_error(self) -> FloatArray:
        """Energy gained since the start less the work done [J], shape (k,): zero but for errors of the method."""
        return np.asarray(self.energy - self.energy[0] - self.work)


def simulate(
    chain: Any,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    tau: Force,
    times: npt.ArrayLike,
    *,
    wrenches: Mapping[str, Force] | None = None,
    events: Mapping[str, Callable[[FloatArray], float]] | None = None,
    period: float | None = None,
    tolerance: float = 1e-10,
    progress: Progress | None = None,
) -> LoopMotion:
    """Return the motion from q (nq,) and v (nv,) under actuators, gravity and wrenches.

    By SciPy's DOP853 with projection onto the closures after each step. It ends early at a singularity of the loops,
    and where velocities or forces have no bound; `end` and `detail` of the result say so. Singularities are looked for
    where rates are computed: a motion passes through one in between. Limits of joints are not applied.

    Parameters
    ----------
    q, v : array_like, shapes (nq,) and (nv,)
        Closed joint values, and velocities that keep them so, at the first time.
    tau : array_like (n,), callable, or None
        Efforts of the actuators [N, N m]: constant, or a function (t, q, v) → (n,); None lets them move freely. A
        function without `period` is smooth in its arguments: it is called several times a step, and not in order.
    times : array_like, shape (k,)
        Times to record [s], increasing; the motion begins at the first.
    wrenches : mapping of str, optional
        By name of a frame, (f, m) at its origin in the axes of the world: constant (6,), or a function as `tau`.
    events : mapping of str to callable, optional
        By name, functions of q (nq,), such as a distance that remains: the run ends where one becomes negative. They
        are looked at after each step, and located on its interpolant.
    period : float, optional
        Sampling period of a digital controller [s]: `tau` is called once at the start of each period, in order, and its
        answer held.
    tolerance : float
        Error of a step, relative and absolute in the units of q and v; from 1e-13 to 1e-3.
    progress : callable, optional
        Called with the current task, the completed thousandths of the run, and 1000; it may raise to interrupt.
        By default a line on the terminal after five seconds.
    """
    recorded = increasing_times(times)
    begin, until = float(recorded[0]), float(recorded[-1])
    real_number(tolerance, "tolerance", "a number from 1e-13 to 1e-3", least=1e-13, most=1e-3)
    if period is not None:
        expected = "a time in seconds, greater than zero and not less than 1e-7 of the run"
        real_number(period, "period", expected, above=0.0, least=SHORTEST_PERIOD * (until - begin))
    state = chain.state(q, v)
    if state.q.ndim != 1 or state.v.ndim != 1:
        raise ArgumentError("q", "one configuration and one velocity", f"shapes {state.q.shape}, {state.v.shape}")
    act = _as_function(tau, "tau", len(chain.actuated))
    for name, given in {"wrenches": wrenches, "events": events}.items():
        if not (given is None or isinstance(given, Mapping)):
            expected = "a mapping, of names of frames to wrenches or of events to functions of q"
            raise ArgumentError(name, expected, type(given).__name__)
    for name, function in (events or {}).items():
        check_function(function, f"events[{name!r}]", "q")
    loads = {k: _as_function(load, f"wrenches[{k!r}]", 6) for k, load in (wrenches or {}).items()}
    placed = {frame_index(chain.model, name, "wrenches"): load for name, load in loads.items()}
    report, run = shown_progress(progress), _Run(chain, state, placed, events or {}, tolerance)
    y, end = np.concatenate([state.q, state.v, [0.0]]), SimulationEnd.COMPLETE
    run.detail = run.event(y)

    def tell(time: float) -> None:
        report("simulation", int(1000.0 * (time - begin) / (until - begin)) if until > begin else 1000, 1000)

    # Bad input raises here, before anything is integrated.
    state.forward_dynamics(np.zeros(len(chain.actuated)))
    for k, span in enumerate(itertools.pairwise(_force_times(begin, until, period))):
        held = act if period is None else _as_function(act(span[0], *run.parts(y)), "tau", len(chain.actuated))
        if k == 0:
            run.record(begin, y, held)
            if run.detail:
                end = SimulationEnd.EVENT
            if run.detail or until == begin:
                break
        y, end = run.advance(y, span, recorded[(recorded > span[0]) & (recorded <= span[1])], held, tell)
        if end is not SimulationEnd.COMPLETE:
            break
    report("simulation", 1000, 1000)
    columns: list[Any] = [*map(np.array, zip(*run.records, strict=True)), end, run.detail]
    return LoopMotion(*columns)


def _as_function(force: Force, argument: str, size: int) -> Callable[[float, FloatArray, FloatArray], FloatArray]:
    """Return a function from a constant or a function; what a function returns is checked."""

    def read(value: npt.ArrayLike) -> FloatArray:
        array = read_vectors(value, argument, size, "in N and N m")
        if array.ndim != 1:
            raise ArgumentError(argument, f"shape ({size},) at each time", f"shape {array.shape}")
        return array

    if callable(force):
        check_function(force, argument, "t", "q", "v")
        # Copies: the function may change them.
        return lambda t, q, v: read(force(t, q.copy(), v.copy()))
    value = read(np.zeros(size) if force is None else force)
    return lambda t, q, v: value


def _force_times(begin: float, until: float, period: float | None) -> list[float]:
    """Return when forces change, from the start to the end of the run."""
    if period is None:
        return [begin, until]
    # Multiples rather than sums, and no last period of rounding's length.
    count = max(1, math.ceil((until - begin) / period - 1e-9))
    return [*(begin + k * period for k in range(count)), until]


class _UnboundedRateError(Exception):
    """Velocities, accelerations or power are too large to be integrated."""


def _check_bounded(rates: FloatArray) -> FloatArray:
    if not largest(rates) < LARGEST_RATE:
        raise _UnboundedRateError("velocities, accelerations or power above 1e100")
    return rates


_ENDS = (_UnboundedRateError, ClosureError, SingularConfigurationError)


class _Run:
    """Integrates the motion of a chain and records it; a vector y is q, v and the work done."""

    def __init__(
        self, chain: Any, state: LoopState, loads: dict[int, Any], events: Mapping[str, Any], tolerance: float
    ) -> None:
        self._chain, self._kinematics = chain, state.kinematics
        self._kinematics.rank = state.kinematics.space.rank
        self._are_independent = self._kinematics.rank == len(self._kinematics.labels)
        self._points = state.kinematics.point_dynamics if self._are_independent else None
        self._loads, self._events, self._tolerance = loads, events, tolerance
        self._least_sigma = min(LEAST_CONSTRAINED, LEAST_SHARE * state.kinematics.space.sigma)
        self.detail = ""
        self._nq, self._is_flat = chain.model.nq, chain.model.nq == chain.model.nv
        self.records: list[tuple[Any, ...]] = []  # what is recorded: the first fields of `LoopMotion`

    def parts(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return q, with unit quaternions, and v."""
        q, v = y[: self._nq].copy(), y[self._nq : -1].copy()
        return (q if self._is_flat else np.array(pin.normalize(self._chain.model, q))), v

    def _motion(self, t: float, q: FloatArray, v: FloatArray, act: Any) -> tuple[FloatArray, FloatArray, float]:
        """Return the accelerations at closed q, the forces of the actuators and the power of all but gravity."""
        kinematics, tau = self._kinematics, act(t, q, v)
        if self._loads or self._points is None:
            kinematics.evaluate(q)
        forces = np.zeros(self._chain.model.nv)
        forces[kinematics.actuated] = tau
        for frame, load in self._loads.items():
            forces += kinematics.frame_jacobian(frame).T @ load(t, q, v)
        # A run ends with rates that are too large, or not finite.
        with np.errstate(over="ignore", invalid="ignore"):
            power = float(forces @ v)
            if self._points is not None:
                return self._points.accelerations(q, v, forces), tau, power
            is_done = kinematics.accelerate(q, v, forces)
            return forces if is_done else kinematics.accelerations(v, forces), tau, power

    def record(self, t: float, y: FloatArray, act: Any) -> None:
        """Record the motion at a time."""
        q, v = self.parts(y)
        a, tau, _ = self._motion(t, q, v, act)
        self._kinematics.evaluate(q)
        kinetic, potential = self._kinematics.energies(v)
        self.records.append((t, q, v, a, tau.copy(), kinetic, potential, float(y[-1]), self._kinematics.widest_gap))

    def _closed(self, y: FloatArray) -> FloatArray:
        """Return y with q closed, and v admissible: a move of the size of the step's error."""
        kinematics, (q, v) = self._kinematics, self.parts(y)
        _check_bounded(y)
        for _ in range(CLOSING_STEPS):
            kinematics.evaluate(q)
            if kinematics.widest_gap <= CLOSED:
                break
            step = kinematics.space.solve(-kinematics.residual)[0]
            q = pin.integrate(kinematics.model, q, step)
            if largest(step / kinematics.units) <= CLOSED:
                kinematics.evaluate(q)
                break
        kinematics.check_closed()
        if kinematics.space.rank and not kinematics.space.sigma > self._least_sigma:
            raise SingularConfigurationError("constraint", kinematics.space.sigma)
        basis, mass = kinematics.space.basis, kinematics.mass_matrix()
        if basis.shape[1]:
            v = basis @ lapack.dposv(basis.T @ mass @ basis, basis.T @ (mass @ v))[1]
        else:
            v = np.zeros_like(v)
        return np.concatenate([q, v, y[-1:]])

    def event(self, y: FloatArray) -> str:
        """Return the name of a function of events that is negative, or nothing."""
        q = self.parts(y)[0]
        return next((name for name in self._events if self._margin(name, q) < 0.0), "")

    def _margin(self, name: str, q: FloatArray) -> float:
        return real_number(self._events[name](q), f"events[{name!r}]", "a function of q with a finite number")

    def first_event(self, dense: Callable[[float], FloatArray], before: float, t: float) -> tuple[str, float]:
        """Return the name of the first event in a step, or nothing, and its time, or that of the step's end."""

        def margin(time: float, name: str) -> float:
            # Rounding must not have it end before the step begins.
            return self._margin(name, self.parts(dense(time))[0]) if time > before else 1e-300

        passed = [name for name in self._events if margin(t, name) < 0.0]
        times = {name: float(brentq(margin, before, t, args=(name,), xtol=1e-15, rtol=1e-14)) for name in passed}
        first = min(times, key=lambda name: times[name], default="")
        return first, times.get(first, t)

    def advance(
        self, y: FloatArray, span: tuple[float, float], times: FloatArray, act: Any, tell: Callable[[float], None]
    ) -> tuple[FloatArray, SimulationEnd]:
        """Integrate over a span of time, recording at `times` within; return the state there, and how it ended."""
        model = self._chain.model

        def rate(t: float, y: FloatArray) -> FloatArray:
            q, v = self.parts(y if self._are_independent else self._closed(y))
            a, _, power = self._motion(t, q, v, act)
            along = v if self._is_flat else pin.tangentMap(model, q) @ v
            rates = np.concatenate([along, a, [power]])
            return _check_bounded(rates)

        waiting, shortest = 0, SHORTEST_STEP * (span[1] - span[0])
        options: dict[str, Any] = {"rtol": self._tolerance, "atol": self._tolerance}
        try:
            try:
                solver = DOP853(rate, span[0], y, span[1], **options)
            except _ENDS:
                # The place from which the solver estimates a first step is too far away.
                solver = DOP853(rate, span[0], y, span[1], first_step=shortest, **options)
            while solver.status == "running":
                try:
                    failure = solver.step()
                except _ENDS:
                    # Places within a step that is too long may be beyond an end, as where a force sets in.
                    solver.h_abs = 0.1 * min(solver.h_abs, span[1] - solver.t)
                    if solver.h_abs < shortest:
                        raise
                    continue
                if failure is not None:
                    self.detail = "no step is short enough"
                    return y, SimulationEnd.STALLED
                # The interpolant of DOP853 belongs to the step before its end is projected onto the closures.
                dense, before, t = solver.dense_output(), float(solver.t_old), float(solver.t)
                self.detail, stop = self.first_event(dense, before, t)
                closed = self._closed(dense(stop) if self.detail else solver.y)
                t = stop
                while waiting < times.size and times[waiting] <= t:
                    moment = float(times[waiting])
                    self.record(moment, closed if moment == t else self._closed(dense(moment)), act)
                    waiting += 1
                y = closed
                if self.detail:
                    if self.records[-1][0] < t:
                        self.record(t, y, act)
                    return y, SimulationEnd.EVENT
                solver.y, solver.f = closed, rate(t, closed)
                tell(t)
        except (_UnboundedRateError, ClosureError) as error:
            self.detail = str(error)
            return y, SimulationEnd.STALLED
        except SingularConfigurationError as error:
            self.detail = str(error)
            return y, SimulationEnd.SINGULARITY
        return y, SimulationEnd.COMPLETE
