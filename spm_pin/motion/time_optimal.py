"""The fastest motion along a path under limits of the legs and of the platform.

With the quantities of `path_dynamics`, every limit is linear in u = s̈ and x = ṡ²,

    lower <= a u + b x + c <= upper,    x <= limit,

which toppra solves on a grid of parameters, u constant from each to the next. With limited jerk the parameter itself
follows ruckig's profile of limited speed V, acceleration A and jerk J, chosen so that every limit holds along the whole
path: slower, and without steps of the force.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.singularity_analysis import determinants
from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.mechanism.arguments import FloatArray, instance, real_number, whole_number
from spm_pin.mechanism.geometry import LEGS
from spm_pin.motion.leg_path import LegPath
from spm_pin.motion.motion_limits import LimitRows, MotionLimits
from spm_pin.motion.path_dynamics import PathDynamics, path_dynamics
from spm_pin.motion.path_rules import ROUNDING
from spm_pin.motion.path_states import Path
from spm_pin.motion.payload import Payload
from spm_pin.motion.planning import MotionPlan
from spm_pin.multibody.chain import ClosedChain
from spm_pin.multibody.joint_layout import require_dimensions
from spm_pin.multibody.platform_path import PlatformPath
from spm_pin.multibody.trajectory import JointTrajectory

__all__ = ["time_optimal"]

_LONGEST = 10**6
"""Samples that a trajectory may have."""
_FASTEST = 1e4
"""Largest speed of the parameter [1/s], where no limit is."""
_TRIES = 60
"""Top speeds V tried for a motion of limited jerk."""
_CORRECTIONS = 8
"""Times that limits are narrowed at most, because they are broken between the parts of the grid."""
_KEPT = 1e-7
"""Share of a limit by which it may be exceeded."""

_Clock = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Times (n,), and s, ṡ and s̈ there."""


def time_optimal(
    chain: ClosedChain,
    path: MotionPlan | LegPath | PlatformPath,
    *,
    leg_rates: npt.ArrayLike | None = None,
    leg_accelerations: npt.ArrayLike | None = None,
    leg_forces: npt.ArrayLike | None = None,
    twist: tuple[float, float] | None = None,
    payload: Payload | None = None,
    leg_jerks: npt.ArrayLike | None = None,
    grid: int = 2000,
    period: float = 2e-3,
) -> JointTrajectory:
    """Return the fastest motion along a path, from rest to rest.

    Parameters
    ----------
    chain : ClosedChain
        The machine with its masses.
    path : MotionPlan, LegPath or PlatformPath
        The way; the times of a PlatformPath count as its parameter only. A plan keeps the leg limits it was made with,
        the others must keep those of `chain.geometry`.
    leg_rates, leg_accelerations : array_like, shape (6,) or (), optional
        Largest speed [m/s] and acceleration [m/s²] of each leg, or of all.
    leg_forces : array_like, shape (6,), () or (2, 6), optional
        Largest force of each leg [N], pushing as pulling; or the least (pulling, negative) and the largest.
    twist : (float, float), optional
        Largest speed of o [m/s] and of turning [rad/s] of the terminal platform.
    payload : Payload, optional
        Carried by the terminal platform.
    leg_jerks : array_like, shape (6,) or (), optional
        Largest jerk of each leg [m/s³]. The motion is then smooth, and not the fastest one possible: it has one top
        speed along the whole path.
    grid : int
        Parts of the path at whose ends the limits hold; where rows in between exceed them, the motion is found again
        with narrower limits.
    period : float
        Time between the rows of the result [s], at most.

    Returns
    -------
    JointTrajectory
        From time 0; its efforts are the legs' forces with the payload. The limits hold in its rows, to 1e-6.

    Raises
    ------
    ArgumentError
        If an argument is malformed, the plan is one of other dimensions, no limit bounds the acceleration, the path
        leaves the physical mode or meets a singularity, with the parameter where, or the forces cannot even hold the
        machine at rest somewhere.
    MissingExtraError
        Without the extra "motion".

    Notes
    -----
    Time-optimal path parametrisation by reachability analysis: Pham and Pham, IEEE Transactions on Robotics 34 (2018),
    as implemented by toppra.
    """
    instance(chain, ClosedChain, "chain")
    way = _path(path, chain)
    if payload is not None:
        instance(payload, Payload, "payload")
    parts = whole_number(grid, "grid", "a number of parts from 10 to 100,000", least=10, most=100_000)
    step = real_number(period, "period", "a positive time in seconds", above=0.0)
    limits = MotionLimits.read(leg_rates, leg_accelerations, leg_jerks, leg_forces, twist)
    parameters = np.linspace(0.0, 1.0, parts + 1)
    along = path_dynamics(chain, way, parameters, payload)
    _refuse_events(chain, along, way, planned=isinstance(path, MotionPlan))
    rows = limits.rows(chain, along)
    for _ in range(_CORRECTIONS):
        clock = (
            _fastest(parameters, rows) if limits.leg_jerks is None else _smooth(chain, along, rows, limits.leg_jerks)
        )
        times, at, rates, changes = clock(step)
        found = path_dynamics(chain, way, at, payload)
        over, faster = limits.rows(chain, found).excess(rates, changes)
        if faster <= _KEPT and (over <= _KEPT * (rows.upper - rows.lower)).all():
            break
        # It happens between the ends of two parts. Narrowed by a little more, so that the next motion keeps them.
        rows = replace(
            rows, lower=rows.lower + 1.2 * over, upper=rows.upper - 1.2 * over, fastest=rows.fastest / (1.0 + faster)
        )
    return _trajectory(chain, found, times, rates, changes)


def _path(path: Any, chain: ClosedChain) -> Path:
    if isinstance(path, MotionPlan):
        require_dimensions(path.geometry, chain.geometry, "path", "the chain")
        if path.path is None:
            raise ArgumentError("path", "a plan with a path", "one without", path.reason)
        return path.path
    if not isinstance(path, LegPath | PlatformPath):
        raise ArgumentError("path", "a MotionPlan, LegPath or PlatformPath", type(path).__name__)
    if isinstance(path, PlatformPath) and not np.any(path([path.start, path.end]).twist):
        raise ArgumentError("path", "a path that moves at its ends", "a path at rest there", "Made with ease=True?")
    return path


def _refuse_events(chain: ClosedChain, along: PathDynamics, path: Path, *, planned: bool) -> None:
    """Raise `ArgumentError` where a path crosses a singularity or, unless it was planned, a leg limit of the chain.

    A path of leg lengths may cross inverse singularities: the legs lead through.
    """
    limits, lengths = chain.geometry.limits, along.states.leg_lengths
    if limits is not None and not planned:
        beyond = np.abs(limits.excess(lengths))
        if (beyond > ROUNDING).any():
            at = int((beyond > ROUNDING).any(axis=-1).argmax())
            leg = int(beyond[at].argmax())
            received = f"{LEGS[leg]} of {lengths[at, leg]:.6g} m at parameter {along.parameters[at]:.4g}"
            raise ArgumentError("path", f"leg lengths within the chain's {limits}", received)
    values = determinants(along.states)[:, : 2 if isinstance(path, LegPath) else 3]
    crossed = (values[1:] * values[:-1] < 0.0).any(axis=-1)
    if crossed.any():
        at = int(crossed.argmax())
        received = f"one between the parameters {along.parameters[at]:.6g} and {along.parameters[at + 1]:.6g}"
        cause = "A path of leg lengths may pass level poses"
        raise ArgumentError("path", "a path without singularities", received, cause)


def _fastest(parameters: FloatArray, rows: LimitRows) -> Callable[[float], _Clock]:
    """Return the time-optimal clock, a function of the period."""
    try:
        import toppra
        from toppra.algorithm import TOPPRA
        from toppra.constraint import DiscretizationType, LinearConstraint
    except ImportError as error:
        raise MissingExtraError("motion", "toppra") from error

    class Limits(LinearConstraint):  # type: ignore[misc]
        """The rows as toppra reads them."""

        def __init__(self) -> None:
            super().__init__()
            self.identical = True
            self.set_discretization_type(DiscretizationType.Interpolation)

        def compute_constraint_params(self, *_: object, **__: object) -> tuple[Any, ...]:
            eye = np.eye(len(rows.lower))
            bounds = np.stack([np.zeros_like(rows.fastest), np.minimum(rows.fastest, _FASTEST**2)], axis=-1)
            values = np.concatenate([rows.upper, -rows.lower])
            return rows.a, rows.b, rows.c, np.concatenate([eye, -eye]), values, None, bounds

    logging.getLogger("toppra").setLevel(logging.ERROR)
    line = toppra.SplineInterpolator(parameters[[0, -1]], np.array([[0.0], [1.0]]))
    solver = TOPPRA([Limits()], line, gridpoints=parameters)
    accelerations, speeds, _ = solver.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.isfinite(speeds).all() or not (speeds[1:-1] > 0.0).all():
        cause = "A force limit that only just holds the machine, or a turn of the path too sharp for this grid"
        raise ArgumentError("path", "a path that the limits let the machine go along", "no such motion", cause)
    starts = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(parameters) / (speeds[:-1] + speeds[1:]))])

    def clock(period: float) -> _Clock:
        times = _times(float(starts[-1]), period)
        k = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(starts) - 2)
        since = times - starts[k]
        s = parameters[k] + since * (speeds[k] + 0.5 * since * accelerations[k])
        return times, np.clip(s, 0.0, 1.0), np.maximum(speeds[k] + since * accelerations[k], 0.0), accelerations[k]

    return clock


def _smooth(chain: ClosedChain, along: PathDynamics, rows: LimitRows, jerks: FloatArray) -> Callable[[float], _Clock]:
    """Return the clock of limited jerk, as `_fastest`: the quickest of ruckig's profiles that keep all limits."""
    try:
        import ruckig
    except ImportError as error:
        raise MissingExtraError("motion", "ruckig") from error
    legs = chain.leg_indices
    first, second = np.abs(along.first[:, legs]), np.abs(along.second[:, legs])
    third = np.abs(np.asarray(np.gradient(along.second[:, legs], along.parameters, axis=0)))

    def bounds(speed: float) -> tuple[float, float]:
        """Return the largest |s̈| and jerk of s with which all limits hold at every ṡ up to a speed; NaN for none."""
        above = (rows.upper - rows.c) - np.maximum(rows.b, 0.0) * speed**2
        below = np.minimum(rows.b, 0.0) * speed**2 + (rows.c - rows.lower)
        # The jerk of a leg is l' s⃛ + 3 l'' ṡ s̈ + l''' ṡ³; half of the limit is kept for its first term.
        spare = jerks - third * speed**3
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            acceleration = float(np.nanmin(np.minimum(above, below) / np.abs(rows.a)))
            acceleration = min(acceleration, float(np.nanmin(spare / (6.0 * second * speed))))
            jerk = float(np.nanmin((spare - 3.0 * second * speed * acceleration) / first))
        return acceleration, jerk

    def profile(speed: float) -> Any:
        acceleration, jerk = bounds(speed)
        if not (acceleration > 0.0 and jerk > 0.0):
            return None
        given, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
        given.current_position, given.target_position = [0.0], [1.0]
        given.max_velocity, given.max_acceleration, given.max_jerk = [speed], [acceleration], [jerk]
        result = ruckig.Ruckig(1).calculate(given, found)
        return found if result in (ruckig.Result.Working, ruckig.Result.Finished) else None

    with np.errstate(divide="ignore", over="ignore"):
        top = min(float(np.sqrt(rows.fastest.min())), float(np.cbrt(np.min(jerks / third))), _FASTEST)
    trials = [found for found in map(profile, np.geomspace(1e-3, 1.0, _TRIES) * top) if found is not None]
    if not trials:
        raise ArgumentError("path", "a path that the limits let the machine go along smoothly", "no such motion")
    best = min(trials, key=lambda found: float(found.duration))

    def clock(period: float) -> _Clock:
        times = _times(float(best.duration), period)
        s, speed, acceleration = (np.array(x)[:, 0] for x in zip(*map(best.at_time, times), strict=True))
        return times, np.clip(s, 0.0, 1.0), speed, acceleration

    return clock


def _times(duration: float, period: float) -> FloatArray:
    count = int(np.ceil(duration / period)) + 1
    if count > _LONGEST:
        raise ArgumentError("period", f"at most {_LONGEST:,} rows", f"{count:,} of a motion of {duration:.4g} s")
    return np.linspace(0.0, duration, max(count, 2))


def _trajectory(
    chain: ClosedChain, along: PathDynamics, times: FloatArray, speeds: FloatArray, accelerations: FloatArray
) -> JointTrajectory:
    """Return all joints and forces of a path gone through on a clock."""
    rate, change = speeds[:, None], accelerations[:, None]
    efforts = np.zeros_like(along.q)
    efforts[:, chain.leg_indices] = along.inertial * change + along.centrifugal * rate**2 + along.static
    velocities, joint_accelerations = along.first * rate, along.first * change + along.second * rate**2
    return JointTrajectory(chain.joint_names, times, along.q, velocities, joint_accelerations, efforts)
