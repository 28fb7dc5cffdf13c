"""The fastest motion along a path under limits of the legs and of the platform.

With the quantities of `paths`, every limit is linear in u = s̈ and x = ṡ²,

    lower <= a u + b x + c <= upper,    x <= limit.

`least_time` finds the motion on a grid of parameters, with u constant from each to the next. Forces jump then; with
limited jerk they do not, see `limited_jerk`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin import multibody
from spm_pin.description.masses import Masses, RigidBody
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.machine.legs import check_path_readings
from spm_pin.machine.manipulator import check_same_machine
from spm_pin.motion.least_time import Clock, LeastTime
from spm_pin.motion.limited_jerk import EasedGrid, limited_jerk
from spm_pin.motion.paths import LegPath, MotionLimits, MotionPath, PathDynamics, path_dynamics
from spm_pin.motion.planning import MotionPlan
from spm_pin.multibody.trajectory import JointTrajectory, PlatformPath
from spm_pin.support.arguments import (
    FloatArray,
    check_instance,
    increasing_times,
    real_array,
    real_number,
    whole_number,
)

_Rows = tuple[tuple[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray, RigidTransform]
"""Values, velocities, accelerations and efforts of the joints, readings, and poses."""
_LONGEST = 10**6
"""Samples that a trajectory may have."""
_SHORT_PERIOD = 1e-3
"""A last period shorter than this share of a whole one is added to the one before."""
_SLOWDOWNS = 16
"""Maximum number of times that a motion is slowed down until its rows keep all limits, each time by four times as
much."""
_ROUNDING, _RESERVE = 1e-10, 1e-9
"""Share of a limit by which it may be exceeded, and by how much more than that a motion is slowed down at first."""


class Payload(RigidBody):
    """A rigid body that the terminal platform carries, its centre and inertia in {m}."""


@dataclass(frozen=True, repr=False)
class TimedMotion(JointTrajectory):
    """The motion of all joints along a path, found by `time_optimal`."""

    error: float = 0.0
    """An estimate of the share of the duration by which it is above the least one, good to some ten percent of itself:
    the growth on half as fine a grid, and the slowing down that keeps limits between the points of the grid."""
    evaluate: Callable[[FloatArray], _Rows] | None = field(default=None, compare=False)
    """Returns joints, readings and poses at times (n,) [s]; a copy that was pickled has none."""

    def at(self, times: npt.ArrayLike) -> JointTrajectory:
        """Return the motion at other times [s], increasing, shape (n,), from 0 to that of the last row: set-points.

        Nothing is interpolated: loops are closed, and efforts are those of the inverse dynamics there.
        """
        at = increasing_times(np.atleast_1d(real_array(times, "times", (), "in seconds")))
        if not (at[0] >= 0.0 and at[-1] <= self.times[-1]):
            outside = at[-1] if at[-1] > self.times[-1] else at[0]
            raise ArgumentError("times", f"times from 0 to {self.times[-1]:g} s", f"{outside:g}")
        if self.evaluate is None:
            raise ArgumentError(
                "times", "a motion returned by time_optimal", "a motion read from a file", "Plan it again"
            )
        joints, readings, poses = self.evaluate(at)
        return JointTrajectory(self.joint_names, at, *joints, readings, poses, self.actuated, self.units, self.legs)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "evaluate": None}

    def __repr__(self) -> str:
        duration = f"{self.times[-1]:.4g} s, about {100.0 * self.error:.1g} % above the least"
        return f"<TimedMotion: {len(self.joint_names)} joints at {self.times.size} times, {duration}>"


def time_optimal(
    chain: multibody.ClosedChain,
    path: MotionPlan | LegPath | PlatformPath,
    *,
    leg_rates: npt.ArrayLike | None = None,
    leg_accelerations: npt.ArrayLike | None = None,
    leg_forces: npt.ArrayLike | None = None,
    twist: tuple[float, float] | None = None,
    payload: RigidBody | None = None,
    leg_jerks: npt.ArrayLike | None = None,
    grid: int = 2000,
    period: float = 2e-3,
) -> TimedMotion:
    """Return the fastest motion along a path, from rest to rest.

    Parameters
    ----------
    chain : ClosedChain
        A manipulator or a stage with its masses, calibrated too.
    path : MotionPlan, LegPath or PlatformPath
        The way; the times of a PlatformPath count as its parameter only. A plan keeps the leg limits it was made with,
        the others must keep those of `chain.machine`.
    leg_rates, leg_accelerations : array_like, shape (legs,) or (), optional
        Largest speed [m/s] and acceleration [m/s²] of each leg, or of all.
    leg_forces : array_like, shape (legs,), () or (2, legs), optional
        Largest force of each leg [N], pushing as pulling; or the least (pulling, negative) and the largest.
    twist : (float, float), optional
        Largest speed of o [m/s] and of turning [rad/s] of the terminal platform.
    payload : RigidBody, optional
        Additional payload of the terminal platform, besides the chain's masses, in {m}.
    leg_jerks : array_like, shape (legs,) or (), optional
        Largest jerk of each leg [m/s³], on the average between two rows too. The motion also begins and ends without
        acceleration. Its duration approaches that without a limit where the limit is large.
    grid : int
        Parts of the path at least; where a limit bends over a part it is split. The duration is longer than the least
        one by about `error` of the result.
    period : float
        Time between the rows of the result [s]; between the last two a thousandth more, or less. `TimedMotion.at` has
        the motion at any other times.

    Returns
    -------
    TimedMotion
        Motion from time 0; its efforts are the legs' forces with the payload. Its rows keep the limits, to 1e-9 of
        them.

    Raises
    ------
    ArgumentError
        If an argument is malformed, the plan is one of other dimensions, no limit bounds the acceleration, the path
        leaves the physical mode or meets a singularity, with the parameter where, or the forces cannot even hold the
        machine at rest somewhere. Along any other path there is a motion, and one is returned.

    Notes
    -----
    A convex programme in the square of the speed, as in Verscheure et al., IEEE Transactions on Automatic Control 54
    (2009); with limited jerk a nonlinear one, of which IPOPT finds a local optimum.
    """
    check_instance(chain, multibody.ClosedChain, "chain")
    way = _path(path, chain)
    if payload is not None:
        chain = chain.with_masses(Masses(payload=payload))
    parts = whole_number(grid, "grid", "a number of parts from 10 to 100,000", least=10, most=100_000)
    step = real_number(period, "period", "a positive time in seconds", above=0.0)
    limits = MotionLimits(chain.machine.legs.names, leg_rates, leg_accelerations, leg_jerks, leg_forces, twist)
    # The parameters, from 0 to 1, where the third derivative of the path may jump.
    knots = way.knots if isinstance(way, LegPath) else (way.times - way.start) / way.duration

    def checked_dynamics(parameters: FloatArray) -> PathDynamics:
        along = path_dynamics(chain, way, parameters)
        _refuse_events(chain, along, way, planned=isinstance(path, MotionPlan))
        return along

    if limits.leg_jerks is None:
        motion = LeastTime(knots, parts, lambda parameters: limits.rows(chain, checked_dynamics(parameters)))
        clock: Clock = motion.clock
        duration, error = motion.duration, motion.error
    else:
        eased, legs = EasedGrid.from_knots(knots, parts), chain.leg_indices
        along = checked_dynamics(eased.parameters)
        derivatives = along.first[:, legs], along.second[:, legs]
        duration, clock, error = limited_jerk(eased, limits.rows(chain, along), *derivatives, limits.leg_jerks)

    def moved(times: FloatArray, slower: float) -> tuple[PathDynamics, FloatArray, FloatArray]:
        s, speeds, accelerations = (values / slower**order for order, values in enumerate(clock(times / slower)))
        return path_dynamics(chain, way, s), speeds, accelerations

    slower = 1.0
    for slowdown in range(_SLOWDOWNS):
        times = _times(slower * duration, step)
        along, speeds, accelerations = moved(times, slower)
        scale = limits.feasible_scale(chain, along, times, speeds, accelerations)
        if scale.min() >= 1.0 - _ROUNDING:
            break
        slower /= np.sqrt(float(scale.min())) * (1.0 - _RESERVE * 4.0**slowdown)

    def rows(along: PathDynamics, speeds: FloatArray, accelerations: FloatArray) -> _Rows:
        rate, change = speeds[:, None], accelerations[:, None]
        efforts = np.zeros_like(along.q)
        efforts[:, chain.leg_indices] = along.inertial * change + along.centrifugal * rate**2 + along.static
        velocities, joint_accelerations = along.first * rate, along.first * change + along.second * rate**2
        return (along.q, velocities, joint_accelerations, efforts), along.states.readings, along.states.pose

    def motion_at(times: FloatArray) -> _Rows:
        return rows(*moved(times, slower))

    joints, readings, poses = rows(along, speeds, accelerations)
    above = slower * (1.0 + error) - 1.0
    columns, own = tuple(chain.leg_indices.tolist()), chain.machine.legs
    return TimedMotion(
        chain.joint_names, times, *joints, readings, poses, columns, own.units, own.names, above, motion_at
    )


def _path(path: Any, chain: multibody.ClosedChain) -> MotionPath:
    if isinstance(path, MotionPlan):
        check_same_machine(path.machine, chain.machine, "path", "the chain")
        if path.path is None:
            raise ArgumentError("path", "a plan with a path", "a plan that failed", path.reason)
        return path.path
    if not isinstance(path, LegPath | PlatformPath):
        raise ArgumentError("path", "a MotionPlan, LegPath or PlatformPath", type(path).__name__)
    if isinstance(path, PlatformPath) and not np.any(path([path.start, path.end]).twist):
        raise ArgumentError(
            "path", "a path with non-zero velocity at its ends", "a path at rest there", "Made with ease=True?"
        )
    return path


def _refuse_events(chain: multibody.ClosedChain, along: PathDynamics, path: MotionPath, *, planned: bool) -> None:
    """Raise where a path crosses a singularity (of legs, a forward one) or, unless it was planned, a leg limit."""
    if not planned:
        machine, readings = chain.machine, along.states.readings
        check_path_readings(machine.limits, machine.legs.units, readings, "path", along.parameters, "parameter")
    values = determinants(along.states)
    values = values[:, :-1] if isinstance(path, LegPath) else values
    crossed = (values[1:] * values[:-1] < 0.0).any(axis=-1)
    if crossed.any():
        point = int(crossed.argmax())
        received = f"one between the parameters {along.parameters[point]:.6g} and {along.parameters[point + 1]:.6g}"
        cause = "A path of leg lengths may pass level poses"
        raise ArgumentError("path", "a path without singularities", received, cause)


def _times(duration: float, period: float) -> FloatArray:
    count = max(int(np.ceil(duration / period - _SHORT_PERIOD)), 1)
    if count >= _LONGEST:
        raise ArgumentError("period", f"at most {_LONGEST:,} rows", f"{count + 1:,} of a motion of {duration:.4g} s")
    return np.append(period * np.arange(count), duration)
