"""All joints along a path, the leg forces as functions of how it is gone through, and the limits of a motion along it.

At a parameter s of the path, gone through with the speed ṡ and the acceleration s̈,

    v = q' ṡ,    a = q' s̈ + q'' ṡ²,    f = f_a s̈ + f_b ṡ² + f_c,

because the equations of motion are linear in the accelerations and quadratic in the velocities. So limits of the legs
and of the platform are rows that are linear in u = s̈ and x = ṡ².
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism import LEGS, Configuration
from spm_pin.mechanism.arguments import FloatArray, IntArray, leg_bounds, leg_values, real_array
from spm_pin.motion.paths import LegPath, MotionPath, platform_motion, states_along
from spm_pin.multibody.chain import ClosedChain
from spm_pin.multibody.chain_state import ChainState

_LARGEST = 1e12
"""Largest limit of a leg that is accepted, far from overflow."""


@dataclass(frozen=True)
class PathDynamics:
    """The mechanism at n parameters of a path; see the module."""

    parameters: FloatArray  # parameters from 0 to 1, shape (n,)
    states: Configuration  # states in the physical mode, shape (n,)
    q: FloatArray  # joint values [rad or m], continuous along the path, shape (n, 18)
    first: FloatArray  # q', first derivatives of `q` by the parameter, shape (n, 18)
    second: FloatArray  # q'', second derivatives of `q` by the parameter, shape (n, 18)
    twist: FloatArray  # twist (v, ω) of the terminal platform at o in {B} per unit of ṡ [m, rad], shape (n, 6)
    inertial: FloatArray  # f_a [N s²], shape (n, 6)
    centrifugal: FloatArray  # f_b [N s²], shape (n, 6)
    static: FloatArray  # f_c [N], shape (n, 6)


def path_dynamics(chain: ClosedChain, path: MotionPath, parameters: FloatArray) -> PathDynamics:
    """Return the mechanism along a path; `ArgumentError` where it is out of reach or meets a singularity."""
    states = states_along(chain.geometry, path, parameters)
    if not states.exists.all():
        bad = parameters[int((~states.exists).argmax())]
        expected = "a path that the machine can go along in its physical mode"
        raise ArgumentError("path", expected, f"no such state at parameter {bad:.6g}", "Level, or out of reach?")
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
    state: ChainState, q: FloatArray, rate: FloatArray, change: FloatArray, of_legs: bool
) -> tuple[FloatArray, ...]:
    """Return q', q'', the twist, f_a, f_b and f_c at one q, from the derivatives of leg lengths or of the platform."""
    state.update(q)
    first = state.joint_rates(rate) if of_legs else state.joint_velocities(rate)
    static, moved = state.inverse_dynamics(np.zeros(len(q))), state.inverse_dynamics(first)
    twist = state.kinematics.platform_jacobian @ first
    state.update(q, first)
    second = state.joint_accelerations_of_legs(change) if of_legs else state.joint_accelerations(change)
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
        """Return the largest factor of ṡ² and s̈ (n,) with which all limits hold, shape (n,).

        All rows hold at rest, and therefore with every smaller factor too.
        """
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


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a motion; None where there is none."""

    leg_rates: FloatArray | None  # largest leg rates [m/s], shape (6,)
    leg_accelerations: FloatArray | None  # largest leg accelerations [m/s²], shape (6,)
    leg_jerks: FloatArray | None  # largest leg jerks [m/s³], shape (6,)
    leg_forces: tuple[FloatArray, FloatArray] | None  # least and largest leg forces [N], each of shape (6,)
    twist: tuple[float, float] | None  # largest speed of o [m/s] and of turning [rad/s]

    @classmethod
    def read(
        cls,
        leg_rates: Any = None,
        leg_accelerations: Any = None,
        leg_jerks: Any = None,
        leg_forces: Any = None,
        twist: Any = None,
    ) -> MotionLimits:
        """Read the limits of `time_optimal`; raises `ArgumentError`."""
        limits = cls(
            _largest(leg_rates, "leg_rates", "m/s"),
            _largest(leg_accelerations, "leg_accelerations", "m/s²"),
            _largest(leg_jerks, "leg_jerks", "m/s³"),
            _force_limits(leg_forces),
            _speeds(twist),
        )
        if limits.leg_forces is None and limits.leg_accelerations is None:
            cause = "Without them the motion would start with a jump"
            raise ArgumentError("leg_forces, leg_accelerations", "limits of one of them", "neither", cause)
        return limits

    def rows(self, chain: ClosedChain, along: PathDynamics) -> LimitRows:
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
                holds = f"{LEGS[leg]} from {forces[0][leg]:g} to {forces[1][leg]:g} N"
                needed = f"{along.static[point, leg]:.4g} N needed at rest at parameter {along.parameters[point]:.4g}"
                expected = "forces that hold the machine along the path"
                raise ArgumentError("leg_forces", expected, f"{needed}, {holds}", "Too heavy?")
            blocks.append((along.inertial, along.centrifugal, along.static, *forces))
        fastest = np.full(len(first), np.inf)
        with np.errstate(divide="ignore", over="ignore"):
            if (rates := self.leg_rates) is not None:
                fastest = np.minimum(fastest, ((rates / np.abs(first)) ** 2).min(axis=-1))
            for part, speed in enumerate(self.twist or ()):
                turned = np.linalg.norm(along.twist[:, 3 * part : 3 * part + 3], axis=-1)
                fastest = np.minimum(fastest, (speed / turned) ** 2)
        a, b, c = (np.concatenate([block[k] for block in blocks], axis=-1) for k in range(3))
        lower, upper = (np.concatenate([block[k] for block in blocks]) for k in (3, 4))
        return LimitRows(a, b, c, lower, upper, fastest)

    def feasible_scale(
        self, chain: ClosedChain, along: PathDynamics, times: FloatArray, speeds: FloatArray, accelerations: FloatArray
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


def _largest(value: npt.ArrayLike | None, argument: str, unit: str) -> FloatArray | None:
    """Return the positive limits of the legs (6,); None if there are none."""
    if value is None:
        return None
    meaning = f"a limit of each leg or of all in {unit}"
    numbers = leg_values(value, argument, meaning, most=_LARGEST, cause="No limit? Leave it out")
    if numbers.ndim > 1:
        raise ArgumentError(argument, f"shape (6,) or (), {meaning}", f"shape {numbers.shape}")
    return numbers


def _force_limits(value: npt.ArrayLike | None) -> tuple[FloatArray, FloatArray] | None:
    """Return the least and the largest force of each leg, both (6,)."""
    return None if value is None else leg_bounds(value, "leg_forces", "forces of the legs in N", most=_LARGEST)


def _speeds(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    numbers = real_array(value, "twist", (2,), "the largest speed of o in m/s and of turning in rad/s")
    if numbers.ndim != 1 or (numbers <= 0.0).any():
        received = f"shape {numbers.shape}, {numbers.min():g}"
        raise ArgumentError("twist", "two positive speeds in m/s and rad/s", received)
    return float(numbers[0]), float(numbers[1])
