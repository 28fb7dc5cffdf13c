"""The fastest motion along a path under limits of the legs and of the platform.

With the quantities of `path_dynamics`, every limit is linear in u = s̈ and x = ṡ²,

    lower <= a u + b x + c <= upper,    x <= limit,

which toppra solves on a grid of parameters, u constant from each to the next. Forces jump then; with limited jerk they
do not, see `limited_jerk`.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism.arguments import FloatArray, check_instance, real_number, whole_number
from spm_pin.mechanism.leg_limits import LEGS
from spm_pin.motion.leg_path import LegPath
from spm_pin.motion.limited_jerk import Clock, EasedGrid, limited_jerk
from spm_pin.motion.motion_limits import LimitRows, MotionLimits
from spm_pin.motion.path_dynamics import PathDynamics, path_dynamics
from spm_pin.motion.path_states import ROUNDING, MotionPath
from spm_pin.motion.payload import Payload
from spm_pin.motion.planning import MotionPlan
from spm_pin.multibody.chain import ClosedChain
from spm_pin.multibody.loading import check_same_machine
from spm_pin.multibody.trajectory import JointTrajectory, PlatformPath

_LONGEST = 10**6
"""Samples that a trajectory may have."""
_FASTEST = 1e4
"""Largest speed of the parameter [1/s], where no limit is."""
_CORRECTIONS = 12
"""Motions tried at most, because limits are broken between points of the grid."""
_NARROWED = 6
"""The first of them, with narrower limits; the others are slower as a whole."""
_KEPT = 1e-7
"""Share of a limit by which it may be exceeded."""


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
        The machine with its masses, as built too.
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
        Largest jerk of each leg [m/s³], on the average between two rows too. The motion also begins and ends without
        acceleration. Its duration approaches that without a limit where the limit is large.
    grid : int
        Parts of the path at whose ends the limits hold; where rows in between exceed them, the motion is found again
        with narrower limits, or slowed down. With `leg_jerks` 2000 parts suffice for some 20 points on the way.
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
        machine at rest somewhere; if every motion that is tried exceeds a limit between points of `grid`.
    MissingExtraError
        Without the extra "motion", which `leg_jerks` does not need.

    Notes
    -----
    Time-optimal path parametrisation by reachability analysis: Pham and Pham, IEEE Transactions on Robotics 34 (2018),
    as implemented by toppra. With limited jerk, a nonlinear programme in the square of the speed, as in Verscheure et
    al., IEEE Transactions on Automatic Control 54 (2009), there without jerk; solved by IPOPT to a local optimum.
    """
    check_instance(chain, ClosedChain, "chain")
    way = _path(path, chain)
    if payload is not None:
        check_instance(payload, Payload, "payload")
    parts = whole_number(grid, "grid", "a number of parts from 10 to 100,000", least=10, most=100_000)
    step = real_number(period, "period", "a positive time in seconds", above=0.0)
    limits = MotionLimits.read(leg_rates, leg_accelerations, leg_jerks, leg_forces, twist)
    jerks, legs = limits.leg_jerks, chain.leg_indices
    eased = EasedGrid.over(_knots(way), parts)
    parameters = np.linspace(0.0, 1.0, parts + 1) if jerks is None else eased.parameters
    along = path_dynamics(chain, way, parameters, payload)
    _refuse_events(chain, along, way, planned=isinstance(path, MotionPlan))
    rows = limits.rows(chain, along)
    if jerks is None:
        duration, clock = _fastest(parameters, rows)
    else:
        duration, clock = limited_jerk(eased, rows, along.first[:, legs], along.second[:, legs], jerks)
    slower = 1.0
    for correction in range(_CORRECTIONS):
        times = _times(slower * duration, step)
        at, speeds, accelerations = clock(times / slower)
        speeds, accelerations = speeds / slower, accelerations / slower**2
        found = path_dynamics(chain, way, at, payload)
        share = limits.kept_share(chain, found, times, speeds, accelerations, _KEPT)
        if share >= 1.0:
            return _trajectory(chain, found, times, speeds, accelerations)
        # It happens between points of the grid.
        if jerks is None and correction < _NARROWED:
            rows = rows.narrowed(*limits.rows(chain, found).excess(speeds, accelerations))
            duration, clock = _fastest(parameters, rows)
        else:
            slower /= np.sqrt(share * (1.0 - _KEPT))
    expected = f"a grid on which a motion that keeps every limit is found in {_CORRECTIONS} tries"
    received = f"{parts} parts; the last motion exceeds a limit by {1.0 / share - 1.0:.1e} of what it leaves for moving"
    cause = "A turn of the path that is sharp between two points of the grid? A finer grid, or a path with wider turns"
    raise ArgumentError("grid", expected, received, cause)


def _path(path: Any, chain: ClosedChain) -> MotionPath:
    if isinstance(path, MotionPlan):
        check_same_machine(path.geometry, chain.geometry, "path", "the chain")
        if path.path is None:
            raise ArgumentError("path", "a plan with a path", "one without", path.reason)
        return path.path
    if not isinstance(path, LegPath | PlatformPath):
        raise ArgumentError("path", "a MotionPlan, LegPath or PlatformPath", type(path).__name__)
    if isinstance(path, PlatformPath) and not np.any(path([path.start, path.end]).twist):
        raise ArgumentError("path", "a path that moves at its ends", "a path at rest there", "Made with ease=True?")
    return path


def _knots(path: MotionPath) -> FloatArray:
    """Return the parameters, from 0 to 1, where the third derivative of a path may jump."""
    return path.knots if isinstance(path, LegPath) else (path.times - path.start) / path.duration


def _refuse_events(chain: ClosedChain, along: PathDynamics, path: MotionPath, *, planned: bool) -> None:
    """Raise `ArgumentError` where a path crosses a singularity or, unless it was planned, a leg limit of the chain.

    A path of leg lengths may cross inverse singularities: the legs lead through.
    """
    limits, lengths = chain.geometry.limits, along.states.readings
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


def _fastest(parameters: FloatArray, rows: LimitRows) -> tuple[float, Clock]:
    """Return the duration of the time-optimal motion, and s, ṡ and s̈ as functions of time."""
    require_extra("motion")
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, LinearConstraint

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

    def clock(times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        k = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(starts) - 2)
        since = times - starts[k]
        s = parameters[k] + since * (speeds[k] + 0.5 * since * accelerations[k])
        return np.clip(s, 0.0, 1.0), np.maximum(speeds[k] + since * accelerations[k], 0.0), accelerations[k]

    return float(starts[-1]), clock


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
