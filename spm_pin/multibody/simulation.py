"""Motion of a chain in time: what acts on it, when it is recorded, what ends it, and the result."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_number
from spm_pin.multibody.batched_states import ChainLike
from spm_pin.multibody.closure_checks import require_closed
from spm_pin.multibody.constrained_model import TreeKinematics
from spm_pin.multibody.integrator import Ending, ForceCallback, Integrator, SimulationEnd
from spm_pin.multibody.platform_path import increasing_times
from spm_pin.multibody.vector_arguments import WrenchLike, read_vector

ForceFunction = Callable[[float, FloatArray, FloatArray], npt.ArrayLike]
"""A function of the time, q (18,) and v (18,): leg forces (6,), or a wrench (6,)."""

STOPS = {
    "limits": SimulationEnd.LIMIT,
    "inverse": SimulationEnd.INVERSE_SINGULARITY,
    "forward": SimulationEnd.FORWARD_SINGULARITY,
}

SHORTEST_INTERVAL = 1e-7
"""Shortest period and longest step that are accepted, as a share of the run: more steps would not end."""


@dataclass(frozen=True)
class Simulation:
    """A motion of a `ClosedChain` in time, at n times."""

    times: FloatArray
    """The requested times [s], shape (n,), as far as the motion went; the last is that of an event that ended it."""
    q: FloatArray
    """Joint values, shape (n, 18)."""
    v: FloatArray
    """Joint velocities, shape (n, 18)."""
    a: FloatArray
    """Joint accelerations, shape (n, 18)."""
    leg_lengths: FloatArray
    """Leg lengths [m], shape (n, 6)."""
    leg_forces: FloatArray
    """Forces of the actuators [N], shape (n, 6); positive pushes."""
    kinetic: FloatArray
    """Kinetic energy of all bodies [J], shape (n,)."""
    potential: FloatArray
    """Potential energy of all bodies [J], shape (n,)."""
    work: FloatArray
    """Work of the leg forces and the wrenches since the start [J], shape (n,)."""
    closure_gap: FloatArray
    """The widest of the four gaps [m], shape (n,)."""
    end: SimulationEnd
    """Why it ended there."""
    detail: str
    """Which leg and which limit; empty if there is nothing to say."""
    steps: int
    """Steps of the integrator."""
    evaluations: int
    """Evaluations of the forward dynamics."""

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


def simulate(
    self: ChainLike,
    q0: npt.ArrayLike,
    v0: npt.ArrayLike,
    forces: npt.ArrayLike | ForceFunction | None,
    times: npt.ArrayLike,
    *,
    wrench: WrenchLike | ForceFunction = None,
    period: float | None = None,
    stop_at: Collection[str] = (),
    tolerance: float = 1e-11,
    max_step: float = np.inf,
    progress: Callable[[float], object] | None = None,
) -> Simulation:
    """Integrate the motion under leg forces, gravity and wrenches, up to the last time or what ends it before.

    By SciPy's DOP853 with projection onto the closures after each step; see the module `integrator`. The loops are
    closed to rounding at every time. Errors of `forces`, `wrench` or `progress` reach the caller.

    Parameters
    ----------
    q0, v0 : array_like, shape (18,)
        Joint values and velocities of a closed mechanism at the first time.
    forces : array_like (6,), callable, or None
        Of the legs [N]: constant, or a function (t, q, v) → (6,); None lets the slides move freely. A function
        without `period` is smooth in its arguments alone: it is called several times a step, and not in order.
    times : array_like, shape (n,)
        When to record [s], increasing; the motion begins at the first.
    wrench : as in `forward_dynamics`, or callable, optional
        Applied from outside: constant, or a function (t, q, v) → (6,) for the terminal platform.
    period : float, optional
        Of a digital controller [s]: `forces` is called once at the start of each period, in order, and its
        answer held. It may keep a state of its own.
    stop_at : collection of {"limits", "inverse", "forward"}
        End the run at the leg limits of `geometry`, or where a singularity is crossed. By default these are passed
        through. A leg of no length and a constraint singularity always end it: forces in the balls have no bound
        there. Looked for at the ends of steps: a smaller `max_step` sees what happens and is undone within one.
    tolerance : float
        Of a step, relative and absolute in the units of q and v; from 1e-13 to 1e-3. The default keeps the energy
        to about 1e-12 of itself in a second of falling.
    max_step : float
        Longest step [s]; not less than 1e-7 of the run.
    progress : callable, optional
        Called with the share done, from 0 to 1, after each step. If it returns False, the run ends there.

    Raises
    ------
    ArgumentError
        If an argument is malformed, v0 opens the loops, or a function returns something else than finite (6,).
    ClosureError
        If q0 is open.
    """
    constrained = self._states.constrained
    q, v = constrained.checked(q0, "q0", single=True), read_vector(v0, "v0", constrained.model.nv)
    kinematics = TreeKinematics(constrained)
    kinematics.evaluate(q)
    require_closed(kinematics, v, "v0")
    recorded = increasing_times(times)
    begin, until = float(recorded[0]), float(recorded[-1])
    span = until - begin
    real_number(tolerance, "tolerance", "a number from 1e-13 to 1e-3", least=1e-13, most=1e-3)
    if max_step != math.inf:
        _interval(max_step, "max_step", span)
    if period is not None:
        _interval(period, "period", span)
    if isinstance(stop_at, str) or any(stop not in STOPS for stop in stop_at):
        raise ArgumentError("stop_at", f"a collection of {', '.join(map(repr, STOPS))}", repr(stop_at))
    limits = constrained.layout.geometry.limits if "limits" in stop_at else None
    if "limits" in stop_at and limits is None:
        raise ArgumentError("stop_at", "no limits, for a geometry without leg limits", "limits")

    act = _callback(np.zeros(6) if forces is None else forces, "forces")
    if callable(wrench):
        wrenches, frames = _callback(wrench, "wrench"), [constrained.layout.platform_frame]
    else:
        together, frames = constrained.read_wrenches(wrench, single=True)
        wrenches = _constant(together)
    ends = frozenset(STOPS[stop] for stop in stop_at) - {SimulationEnd.LIMIT}
    integrator = Integrator(kinematics, frames, wrenches, limits, ends)

    def proceed(time: float) -> bool:
        return progress is None or progress((time - begin) / span) is not False

    now, samples = integrator.start(q, v), _samples(begin, until, period)
    ending: Ending | None = integrator.beyond(begin, now)
    for k, (start, end) in enumerate(itertools.pairwise(samples)):
        applied = act if period is None else _constant(act(start, *integrator.parts(now)))
        if k == 0:
            integrator.record(begin, now, applied)
        if ending is not None or span == 0.0:
            break
        inside = recorded[(recorded > start) & (recorded <= end)]
        now, ending = integrator.advance(now, (start, end), inside, applied, tolerance, max_step, proceed)
        if ending is not None:
            integrator.record(ending.time, now, applied)
    why, detail = (SimulationEnd.COMPLETE, "") if ending is None else ending[:2]
    names = (field.name for field in fields(Simulation))
    columns: dict[str, Any] = dict(zip(names, map(np.array, zip(*integrator.rows, strict=True)), strict=False))
    return Simulation(**columns, end=why, detail=detail, steps=integrator.steps, evaluations=integrator.evaluations)


def _constant(value: FloatArray) -> ForceCallback:
    return lambda t, q, v: value


def _callback(force: Any, argument: str) -> ForceCallback:
    """Return a function from a constant or a function; what a function returns is checked."""
    if isinstance(force, Mapping) or not callable(force):
        return _constant(read_vector(force, argument, 6))
    # Copies: the function may change them.
    return lambda t, q, v: read_vector(force(t, q.copy(), v.copy()), argument, 6)


def _interval(value: float, argument: str, span: float) -> None:
    expected = "a time in seconds, greater than zero and not less than 1e-7 of the run"
    real_number(value, argument, expected, above=0.0, least=SHORTEST_INTERVAL * span)


def _samples(begin: float, until: float, period: float | None) -> list[float]:
    """Return when forces change, from the start to the end of the run."""
    if period is None:
        return [begin, until]
    # Multiples rather than sums, and no last period of rounding's length.
    count = max(1, math.ceil((until - begin) / period - 1e-9))
    return [*(begin + k * period for k in range(count)), until]
