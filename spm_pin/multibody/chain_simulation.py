"""The method of `ClosedChain` that moves it in time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.chain_dynamics import ChainDynamics, WrenchLike, read_wrenches
from spm_pin.multibody.closures import Workspace
from spm_pin.multibody.dynamics import require_closed
from spm_pin.multibody.placement import one_vector
from spm_pin.multibody.platform_path import increasing_times
from spm_pin.multibody.simulation import Simulation, SimulationEnd
from spm_pin.multibody.stepper import Ending, Law, Stepper

__all__ = ["ChainSimulation", "ForceLaw"]

ForceLaw = Callable[[float, FloatArray, FloatArray], npt.ArrayLike]
"""A function of the time, q (18,) and v (18,): leg forces (6,), or a wrench (6,)."""

STOPS = {
    "limits": SimulationEnd.LIMIT,
    "inverse": SimulationEnd.INVERSE_SINGULARITY,
    "forward": SimulationEnd.FORWARD_SINGULARITY,
}


class ChainSimulation(ChainDynamics):
    """How a `ClosedChain` moves; see there."""

    def simulate(
        self,
        q0: npt.ArrayLike,
        v0: npt.ArrayLike,
        forces: npt.ArrayLike | ForceLaw | None,
        times: npt.ArrayLike,
        *,
        wrench: WrenchLike | ForceLaw = None,
        period: float | None = None,
        stop_at: Collection[str] = (),
        tolerance: float = 1e-11,
        max_step: float = math.inf,
        progress: Callable[[float], object] | None = None,
        workspace: Workspace | None = None,
    ) -> Simulation:
        """Integrate the motion under leg forces, gravity and wrenches.

        Parameters
        ----------
        q0, v0 : array_like, shape (18,)
            Joint values and velocities of a closed mechanism at the first time.
        forces : array_like (6,), callable, or None
            Of the legs [N], positive pushes: constant, or a function (t, q, v) → (6,); None lets the slides move
            freely. A function without `period` depends on its arguments alone and is smooth in them: it is called
            several times a step, at any t, and not in order.
        times : array_like, shape (n,)
            When to record [s], increasing; the motion begins at the first.
        wrench : as in `forward_dynamics`, or callable, optional
            Applied from outside: constant, or a function (t, q, v) → (6,) for the terminal platform.
        period : float, optional
            Of a digital controller [s]: `forces` is called once at the beginning of each period, in order, and its
            answer held. It may keep a state of its own.
        stop_at : collection of {"limits", "inverse", "forward"}
            End the run at the leg limits of `geometry`, or where a singularity is crossed. Neither stops the
            mechanism itself: nothing bumps, and these singularities are passed through. A leg of no length always
            ends it, and so does a constraint singularity, where forces in the balls have no bound. Looked for at the
            ends of steps: a smaller `max_step` sees what happens and is undone within one.
        tolerance : float
            Of a step, relative and absolute in the units of q and v; from 1e-13 to 1e-3. The default keeps the energy
            to about 1e-12 of itself in a second of falling.
        max_step : float
            Longest step [s].
        progress : callable, optional
            Called with the share done, from 0 to 1, after each step. If it returns False, the run ends there.
        workspace : Workspace, optional
            See `workspace`.

        Returns
        -------
        Simulation
            What happened up to the last time, or to `Simulation.end`. The loops are closed to rounding at every time.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v0 opens the loops, or a function returns something else than finite (6,).
        ClosureError
            If q0 is open.

        Notes
        -----
        DOP853 of SciPy with projection onto the closures after each step; see the module `stepper`. Errors that
        `forces`, `wrench` or `progress` raise end the run and reach the caller.
        """
        q, own = self._placement.checked(q0, "q0", single=True), self._constraints.workspace(workspace)
        v = one_vector(v0, "v0", (self._model.nv,), "rates of the joints in Pinocchio's order")
        gap, jacobian = self._constraints.evaluate(q, own)
        require_closed(gap, jacobian, v, self._placement.geometry.middle_side, "v0")
        moments = increasing_times(times)
        if not (isinstance(tolerance, float) and 1e-13 <= tolerance <= 1e-3):
            raise ArgumentError("tolerance", "a number from 1e-13 to 1e-3", repr(tolerance))
        _positive(max_step, "max_step")
        unknown = [stop for stop in stop_at if stop not in STOPS]
        if isinstance(stop_at, str) or unknown:
            raise ArgumentError("stop_at", f"a collection of {', '.join(map(repr, STOPS))}", repr(stop_at))
        limits = self._placement.geometry.limits
        if "limits" in stop_at and limits is None:
            raise ArgumentError("stop_at", "no limits, for a geometry without leg limits", "limits")

        law = _law(np.zeros(6) if forces is None else forces, "forces", "of the six legs in newtons")
        frames, push = self._pushes(wrench)
        ends = frozenset(STOPS[stop] for stop in stop_at)
        within = limits if "limits" in stop_at else None
        stepper = Stepper(self._placement, self._constraints, own, frames, push, within, ends - {SimulationEnd.LIMIT})
        begin, until = float(moments[0]), float(moments[-1])
        span = until - begin

        def proceed(time: float) -> bool:
            return progress is None or progress((time - begin) / span) is not False

        state, samples = stepper.start(q, v), _samples(begin, until, period)
        ending: Ending | None = stepper.beyond(begin, state)
        for k, (start, end) in enumerate(itertools.pairwise(samples)):
            held = law if period is None else _held(law(start, *stepper.parts(state)))
            if k == 0:
                stepper.record(begin, state, held)
            if ending is not None or span == 0.0:
                break
            inside = moments[(moments > start) & (moments <= end)]
            state, ending = stepper.advance(state, (start, end), inside, held, tolerance, max_step, proceed)
            if ending is not None:
                stepper.record(ending.time, state, held)
        return stepper.result(ending)

    def _pushes(self, wrench: WrenchLike | ForceLaw) -> tuple[list[int], Law]:
        """Return the frames that wrenches act onto, and the law of the wrenches side by side."""
        platform = self._prefix + "terminal_platform"
        if callable(wrench):
            return [int(self._model.getFrameId(platform))], _law(wrench, "wrench", "(f, m) in N and N m")
        frames, together = read_wrenches(self._model, wrench, platform)
        if together.ndim != 1:
            cause = "One motion a call"
            raise ArgumentError("wrench", "shape (6,), (f, m) in N and N m", f"shape {together.shape}", cause)
        return frames, _held(together)


def _held(value: FloatArray) -> Law:
    return lambda t, q, v: value


def _law(given: Any, argument: str, meaning: str) -> Law:
    """Return a law from a constant or a function; what a function returns is checked."""
    if isinstance(given, Mapping) or not callable(given):
        return _held(one_vector(given, argument, (6,), meaning))

    def law(t: float, q: FloatArray, v: FloatArray) -> FloatArray:
        # Copies: what the function does to them is its own affair.
        return one_vector(given(t, q.copy(), v.copy()), argument, (6,), meaning)

    return law


def _positive(value: float, argument: str) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0.0:
        raise ArgumentError(argument, "a time in seconds, greater than zero", repr(value))


def _samples(begin: float, until: float, period: float | None) -> list[float]:
    """Return when forces change, from the begin to the end of the run."""
    if period is None:
        return [begin, until]
    _positive(period, "period")
    # Multiples rather than sums, and no last period of rounding's length.
    count = max(1, math.ceil((until - begin) / period - 1e-9))
    return [*(begin + k * period for k in range(count)), until]
