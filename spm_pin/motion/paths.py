"""Paths of the legs or of the platform, the mechanism along them, and the limits of a motion.

A path has a parameter s from 0 to 1. Gone through with the speed ṡ and the acceleration s̈, joints and leg forces are

    v = q' ṡ,    a = q' s̈ + q'' ṡ²,    f = f_a s̈ + f_b ṡ² + f_c,

because the equations of motion are linear in the accelerations and quadratic in the velocities. So limits of the legs
and of the platform are rows that are linear in u = s̈ and x = ṡ².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BPoly

from spm_pin import multibody
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import physical_at_poses
from spm_pin.machine import Configuration, Manipulator, Stage
from spm_pin.multibody.trajectory import PlatformMotion, PlatformPath
from spm_pin.support.arguments import FloatArray, IntArray, leg_bounds, leg_values, real_array

AnyMachine = Manipulator | Stage
State = Configuration
ROUNDING = 1e-9
"""Amount by which a rule of a path may be broken, in its unit: a state at its limit keeps it."""
STEP = 0.005
"""Largest distance of two samples of a path in the leg lengths, for RRS legs at the knees, in units of d."""
_LARGEST = 1e12
"""Largest limit of a leg that is accepted, far from overflow."""


class LegMotion(NamedTuple):
    """Readings of the legs along a path, (..., legs) [m], and their derivatives per unit of its parameter."""

    lengths: FloatArray
    """Leg lengths [m]."""
    first: FloatArray
    """First derivatives [m]."""
    second: FloatArray
    """Second derivatives [m]."""


class LegPath:
    """A twice continuously differentiable path through given leg lengths, over a parameter from 0 to 1.

    Two points are joined by a straight line; more points by quintic polynomials from each to the next, on which no leg
    leaves the range between its two lengths: if the points are within the leg limits, so is the whole path. The
    parameter grows with the distance between them, √Σ(difference of a length)².

    Parameters
    ----------
    lengths : array_like, shape (n, 6); for a stage (n, 3)
        Readings on the path [m] ([rad] for RRS legs), in order, at least two; consecutive readings must differ.
    """

    def __init__(self, lengths: npt.ArrayLike) -> None:
        points = real_array(lengths, "lengths", (), "leg lengths in metres, one row after another").copy()
        if points.ndim != 2 or len(points) < 2 or points.shape[1] not in (3, 6):
            raise ArgumentError("lengths", "shape (n, 6) or (n, 3), at least two rows", f"shape {points.shape}")
        distances = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        if (distances == 0.0).any():
            row = int(distances.argmin())
            raise ArgumentError(
                "lengths", "consecutive rows that differ", f"rows {row} and {row + 1} equal", "Drop rows without motion"
            )
        self._points = points
        self._knots = np.concatenate([[0.0], np.cumsum(distances) / distances.sum()])
        self._knots[-1] = 1.0
        slopes = _slopes(points, self._knots)
        self._path = BPoly.from_derivatives(self._knots, np.stack([points, slopes, np.zeros_like(points)], axis=1))
        self._derivatives = self._path.derivative(1), self._path.derivative(2)

    def __repr__(self) -> str:
        return f"<LegPath: {'a straight line' if len(self._points) == 2 else f'through {len(self._points)} points'}>"

    @property
    def knots(self) -> FloatArray:
        """Parameters from 0 to 1 at which it passes the given lengths, shape (n,); a copy."""
        return self._knots.copy()

    def __call__(self, parameters: npt.ArrayLike) -> LegMotion:
        """Return the lengths at parameters (...) from 0 to 1; raises `ArgumentError` outside."""
        values = real_array(parameters, "parameters", (), "from 0 to 1")
        if ((values < 0.0) | (values > 1.0)).any():
            raise ArgumentError("parameters", "numbers from 0 to 1", f"from {values.min():g} to {values.max():g}")
        # Not beyond its points by rounding.
        lengths = np.clip(self._path(values), self._points.min(axis=0), self._points.max(axis=0))
        return LegMotion(lengths, *(np.asarray(derivative(values)) for derivative in self._derivatives))


def _slopes(points: FloatArray, knots: FloatArray) -> FloatArray:
    """Return derivatives at the points, shape (n, legs), with which the path between two is monotonic.

    Zero where a leg turns back, else the harmonic mean of both sides, as PCHIP takes it. A quintic from y0 to y1 with
    the slopes d0, d1 and no curvature at its ends has the Bézier points y0 + (0, 1, 2) d0 h / 5 and
    y1 - (2, 1, 0) d1 h / 5: in order if d0 + d1 is at most 5/2 (y1 - y0) / h.
    """
    secants = np.diff(points, axis=0) / np.diff(knots)[:, None]
    before, after = secants[:-1], secants[1:]
    same = before * after > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(same, 2.0 * before * after / (before + after), 0.0)
    least = np.minimum(np.abs(before), np.abs(after))
    inner = np.sign(mean) * np.minimum(np.abs(mean), 1.25 * least)
    return np.concatenate([secants[:1], inner, secants[-1:]])


MotionPath = LegPath | PlatformPath
"""A path; its parameter goes from 0 to 1, of a `PlatformPath` the share of its duration."""


def states_along(machine: AnyMachine, path: MotionPath, parameters: FloatArray) -> State:
    """Return the states at parameters (n,) from 0 to 1; some may not exist."""
    if isinstance(path, LegPath):
        return forward_physical(machine, path(parameters).lengths)
    return physical_at_poses(machine, platform_motion(path, parameters).pose)


def platform_motion(path: PlatformPath, parameters: FloatArray) -> PlatformMotion:
    """Return the pose at parameters (n,) from 0 to 1, and its derivatives with respect to the path's own time."""
    # Not beyond the end by rounding.
    return path(np.minimum(path.start + parameters * path.duration, path.end))


def line_states(machine: AnyMachine, start: FloatArray, end: FloatArray) -> State:
    """Return the states on a straight line between readings (legs,), at most `STEP` apart."""
    parameters = spaced_parameters(machine, np.array([start, end]))[:, None]
    return forward_physical(machine, start + parameters * (end - start))


def spaced_parameters(machine: AnyMachine, lengths: FloatArray) -> FloatArray:
    """Return evenly spaced parameters from 0 to 1 for a path through readings (n, legs), at most `STEP` apart."""
    distance = float(np.linalg.norm(machine.legs.largest_slopes * np.diff(lengths, axis=0), axis=-1).sum())
    return np.linspace(0.0, 1.0, max(int(np.ceil(distance / (STEP * machine.ball_side))), 2) + 1)


@dataclass(frozen=True)
class PathDynamics:
    """The mechanism at n parameters of a path; see the module."""

    parameters: FloatArray  # parameters from 0 to 1, shape (n,)
    states: State  # states in the physical mode, shape (n,)
    q: FloatArray  # joint values [rad or m], continuous along the path, shape (n, nq)
    first: FloatArray  # q', first derivatives of `q` with respect to the parameter, shape (n, nq)
    second: FloatArray  # q'', second derivatives of `q` with respect to the parameter, shape (n, nq)
    twist: FloatArray  # twist (v, ω) of the platform at o in {B} per unit of ṡ [m, rad], shape (n, 6)
    inertial: FloatArray  # f_a [N s²], shape (n, legs)
    centrifugal: FloatArray  # f_b [N s²], shape (n, legs)
    static: FloatArray  # f_c [N], shape (n, legs)


def path_dynamics(chain: multibody.ClosedChain, path: MotionPath, parameters: FloatArray) -> PathDynamics:
    """Return the mechanism along a path; `ArgumentError` where it is out of reach or meets a singularity."""
    states: Any = states_along(chain.machine, path, parameters)
    if not states.exists.all():
        bad = parameters[int((~states.exists).argmax())]
        expected = "a path that the machine can go along in its physical mode"
        raise ArgumentError(
            "path", expected, f"no state at parameter {bad:.6g}", "Is the pose there level or out of reach?"
        )
    if isinstance(path, LegPath):
        _, rates, changes = path(parameters)
    else:
        _, twist, acceleration = platform_motion(path, parameters)
        rates, changes = path.duration * twist, path.duration**2 * acceleration
    # Slides are not angles, but never jump either.
    q = np.unwrap(chain.joint_values(states), axis=0)
    state, rows = chain.state(q[0]), []
    for k, joints in enumerate(q):
        try:
            rows.append(_at(state, joints, rates[k], changes[k], isinstance(path, LegPath)))
        except SingularConfigurationError as error:
            expected = "a path that keeps away from singularities"
            received = f"a {error.kind} singularity at parameter {parameters[k]:.6g}"
            raise ArgumentError("path", expected, received, "plan with a larger margin goes around") from error
    return PathDynamics(parameters, states, q, *(np.array(column) for column in zip(*rows, strict=True)))


def _at(
    state: multibody.ChainState, q: FloatArray, rate: FloatArray, change: FloatArray, of_legs: bool
) -> tuple[FloatArray, ...]:
    """Return q', q'', the twist, f_a, f_b and f_c at one q, from the derivatives of leg lengths or of the platform."""
    state.update(q)
    first = state.joint_rates(rate) if of_legs else state.velocities_along(rate)
    static, moved = state.inverse_dynamics(np.zeros(len(q))), state.inverse_dynamics(first)
    twist = state.kinematics.platform_jacobian @ first
    state.update(q, first)
    second = state.joint_accelerations_of_legs(change) if of_legs else state._accelerations_along(rate, change)
    return first, second, twist, moved - static, state.inverse_dynamics(second) - static, static


@dataclass(frozen=True)
class LimitRows:
    """Limits on a grid: lower <= a u + b x + c <= upper of (n, m) rows, and x <= fastest (n,)."""

    a: FloatArray  # coefficients of u, shape (n, m)
    b: FloatArray  # coefficients of x, shape (n, m)
    c: FloatArray  # constants, shape (n, m)
    lower: FloatArray  # least values of the rows, shape (m,)
    upper: FloatArray  # largest values of the rows, shape (m,)
    fastest: FloatArray  # largest x at each point of the grid, shape (n,)

    def feasible_scale(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the largest factor (n,) of ṡ² and s̈ (n,) with which, and with all smaller ones, limits hold."""
        moved = self.a * u[:, None] + self.b * x[:, None]
        room = np.where(moved > 0.0, self.upper - self.c, self.c - self.lower)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(moved != 0.0, room / np.abs(moved), np.inf).min(axis=-1)
            return np.asarray(np.minimum(shares, np.where(x > 0.0, self.fastest / x, np.inf)))

    def joined(self, other: LimitRows) -> LimitRows:
        """Return the limits at these points and at other ones."""
        arrays = ((getattr(self, name), getattr(other, name)) for name in ("a", "b", "c", "fastest"))
        a, b, c, fastest = map(np.concatenate, arrays)
        return LimitRows(a, b, c, self.lower, self.upper, fastest)

    def __getitem__(self, index: IntArray) -> LimitRows:
        """Return the limits at some points of the grid."""
        a, b, c = self.a[index], self.b[index], self.c[index]
        return LimitRows(a, b, c, self.lower, self.upper, self.fastest[index])


class MotionLimits:
    """Limits of a motion for legs with these names, as in `time_optimal`; None for a quantity without a limit."""

    def __init__(
        self,
        legs: Sequence[str],
        leg_rates: npt.ArrayLike | None = None,
        leg_accelerations: npt.ArrayLike | None = None,
        leg_jerks: npt.ArrayLike | None = None,
        leg_forces: npt.ArrayLike | None = None,
        twist: Any = None,
    ) -> None:
        count = len(legs)
        self.leg_rates = _largest(leg_rates, "leg_rates", "m/s, for RRS legs in rad/s", count)
        self.leg_accelerations = _largest(leg_accelerations, "leg_accelerations", "m/s², for RRS legs in rad/s²", count)
        self.leg_jerks = _largest(leg_jerks, "leg_jerks", "m/s³, for RRS legs in rad/s³", count)
        self.leg_forces = None
        if leg_forces is not None:
            meaning = "forces of the legs in N, for RRS legs in N m"
            self.leg_forces = leg_bounds(leg_forces, "leg_forces", meaning, most=_LARGEST, count=count)
        elif leg_accelerations is None:
            cause = "Without them the motion would start with a jump"
            raise ArgumentError(
                "leg_forces, leg_accelerations", "at least one of the two limits", "None for both", cause
            )
        self.twist = None if twist is None else _speeds(twist)

    def rows(self, chain: multibody.ClosedChain, along: PathDynamics) -> LimitRows:
        """Return all limits on the grid; raises `ArgumentError` where the forces do not hold the machine at rest."""
        legs = chain.leg_indices
        first, second = along.first[:, legs], along.second[:, legs]
        blocks: list[tuple[FloatArray, ...]] = []
        if (acceleration := self.leg_accelerations) is not None:
            blocks.append((first, second, np.zeros_like(first), -acceleration, acceleration))
        if (forces := self.leg_forces) is not None:
            short = np.maximum(along.static - forces[1], forces[0] - along.static)
            if (short > 0.0).any():
                point, leg = np.unravel_index(int(short.argmax()), short.shape)
                unit = {"m": "N", "rad": "N m"}[chain.machine.legs.units[leg]]
                holds = f"{chain.machine.legs.names[leg]} from {forces[0][leg]:g} to {forces[1][leg]:g} {unit}"
                needed = (
                    f"{along.static[point, leg]:.4g} {unit} needed at rest at parameter {along.parameters[point]:.4g}"
                )
                expected = "forces that hold the machine along the path"
                raise ArgumentError("leg_forces", expected, f"{needed}, {holds}", "Too heavy?")
            blocks.append((along.inertial, along.centrifugal, along.static, *forces))
        fastest = np.full(len(first), np.inf)
        with np.errstate(divide="ignore", over="ignore"):
            if (rates := self.leg_rates) is not None:
                fastest = np.minimum(fastest, ((rates / np.abs(first)) ** 2).min(axis=-1))
            for part, speed in enumerate([] if self.twist is None else self.twist):
                turned = np.linalg.norm(along.twist[:, 3 * part : 3 * part + 3], axis=-1)
                fastest = np.minimum(fastest, (speed / turned) ** 2)
        a, b, c = (np.concatenate([block[k] for block in blocks], axis=-1) for k in range(3))
        lower, upper = (np.concatenate([block[k] for block in blocks]) for k in (3, 4))
        return LimitRows(a, b, c, lower, upper, fastest)

    def feasible_scale(
        self,
        chain: multibody.ClosedChain,
        along: PathDynamics,
        times: FloatArray,
        speeds: FloatArray,
        accelerations: FloatArray,
    ) -> FloatArray:
        """Return the largest factor of ṡ² and s̈ (n,), at times (n,), with which all limits hold, shape (n,).

        A leg's jerk is the change of its acceleration from one time to the next.
        """
        scale = self.rows(chain, along).feasible_scale(speeds**2, accelerations)
        if self.leg_jerks is not None:
            first, second = along.first[:, chain.leg_indices], along.second[:, chain.leg_indices]
            changes = np.diff(first * accelerations[:, None] + second * speeds[:, None] ** 2, axis=0)
            used = np.abs(changes / (np.diff(times)[:, None] * self.leg_jerks)).max(axis=-1)
            scale[1:] = np.minimum(scale[1:], np.maximum(used, 1e-300) ** (-2.0 / 3.0))
        return scale


def _largest(value: npt.ArrayLike | None, argument: str, unit: str, count: int) -> FloatArray | None:
    """Return the positive limits of the legs (count,), or None without limits."""
    if value is None:
        return None
    meaning = f"a limit of each leg or of all in {unit}"
    numbers = leg_values(value, argument, meaning, most=_LARGEST, cause="No limit? Leave it out", count=count)
    if numbers.ndim > 1:
        raise ArgumentError(argument, f"shape ({count},) or (), {meaning}", f"shape {numbers.shape}")
    return numbers


def _speeds(value: Any) -> FloatArray:
    """Return the largest speed of o and of turning (2,)."""
    numbers = real_array(value, "twist", (2,), "the largest speed of o in m/s and of turning in rad/s")
    if numbers.ndim != 1 or (numbers <= 0.0).any():
        received = f"shape {numbers.shape}, {numbers.min():g}"
        raise ArgumentError("twist", "two positive speeds in m/s and rad/s", received)
    return numbers
