"""All joints along a path of the platform or of the legs, and the leg forces as functions of how it is gone through.

At a parameter s of the path, gone through with the speed ṡ and the acceleration s̈,

    v = q' ṡ,    a = q' s̈ + q'' ṡ²,    f = f_a s̈ + f_b ṡ² + f_c,

because the equations of motion are linear in the accelerations and quadratic in the velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray, frozen, real_array, real_number, symmetric_matrices
from spm_pin.mechanism.configuration import Configuration
from spm_pin.motion.leg_path import LegPath
from spm_pin.motion.path_states import MotionPath, platform_motion, states_along
from spm_pin.multibody.chain import ClosedChain
from spm_pin.multibody.chain_state import ChainState


@dataclass(frozen=True, eq=False)
class Payload:
    """A rigid body that the terminal platform carries.

    Parameters
    ----------
    mass : float
        [kg], not negative.
    centre : array_like, shape (3,)
        Its centre of mass in {m} [m].
    inertia : array_like, shape (3, 3), optional
        About its centre of mass in the axes of {m} [kg m²]; a point mass by default.
    """

    mass: float
    centre: npt.ArrayLike = (0.0, 0.0, 0.0)
    inertia: npt.ArrayLike = ((0.0,) * 3,) * 3

    def __post_init__(self) -> None:
        mass = real_number(self.mass, "mass", "a mass in kg, not negative", least=0.0)
        centre = real_array(self.centre, "centre", (3,), "the centre of mass in {m} in metres")
        inertia = symmetric_matrices(self.inertia, "inertia", 3, "about the centre of mass in kg m²")
        if centre.ndim != 1 or inertia.ndim != 2:
            raise ArgumentError("centre, inertia", "shapes (3,) and (3, 3)", f"{centre.shape} and {inertia.shape}")
        moments = np.linalg.eigvalsh(inertia)
        rounding = 1e-9 * abs(moments).max()
        if moments[0] < -rounding or moments[:2].sum() < moments[2] - rounding:
            expected = "principal moments of a body: none negative or above the sum"
            raise ArgumentError("inertia", expected + " of the other two", f"moments {moments}", "About another point?")
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "centre", frozen(centre.copy()))
        object.__setattr__(self, "inertia", frozen(inertia.copy()))

    def wrench(
        self, rotation: FloatArray, twist: FloatArray, acceleration: FloatArray, gravity: npt.ArrayLike
    ) -> FloatArray:
        """Return the wrench (f, m) that the body exerts onto the platform at o, in {B} [N, N m].

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
            Of {m} in {B}.
        twist, acceleration : ndarray, shape (6,)
            (v, ω) of m at o and its time derivative, in {B}.
        gravity : array_like, shape (3,)
            [m/s²] in {B}.
        """
        arm, inertia = rotation @ np.asarray(self.centre), rotation @ np.asarray(self.inertia) @ rotation.T
        spin, change = twist[3:], acceleration[3:]
        push = acceleration[:3] + np.cross(change, arm) + np.cross(spin, np.cross(spin, arm)) - np.asarray(gravity)
        force = self.mass * push
        moment = inertia @ change + np.cross(spin, inertia @ spin) + np.cross(arm, force)
        return -np.concatenate([force, moment])


@dataclass(frozen=True)
class PathDynamics:
    """The mechanism at n parameters of a path; see the module."""

    parameters: FloatArray
    """Parameters from 0 to 1, shape (n,)."""
    states: Configuration
    """States in the physical mode, shape (n,)."""
    q: FloatArray
    """Joint values [rad or m], continuous along the path, shape (n, 18)."""
    first: FloatArray
    """q', first derivatives of `q` by the parameter, shape (n, 18)."""
    second: FloatArray
    """q'', second derivatives of `q` by the parameter, shape (n, 18)."""
    twist: FloatArray
    """Twist (v, ω) of the terminal platform at o in {B} per unit of ṡ [m, rad], shape (n, 6)."""
    inertial: FloatArray
    """f_a [N s²], shape (n, 6)."""
    centrifugal: FloatArray
    """f_b [N s²], shape (n, 6)."""
    static: FloatArray
    """f_c [N], shape (n, 6)."""


def path_dynamics(
    chain: ClosedChain, path: MotionPath, parameters: FloatArray, payload: Payload | None
) -> PathDynamics:
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
            rows.append(_at(state, joints, rates[k], changes[k], isinstance(path, LegPath), payload))
        except SingularConfigurationError as error:
            expected = "a path that keeps away from singularities"
            at = f"a {error.kind} singularity at parameter {parameters[k]:.6g}"
            raise ArgumentError("path", expected, at, "plan with a larger margin goes around") from error
    return PathDynamics(parameters, states, q, *(np.array(column) for column in zip(*rows, strict=True)))


def _at(
    state: ChainState, q: FloatArray, rate: FloatArray, change: FloatArray, of_legs: bool, payload: Payload | None
) -> tuple[FloatArray, ...]:
    """Return q', q'', the twist, f_a, f_b and f_c at one q, from the derivatives of leg lengths or of the platform."""
    state.update(q)
    first = state.joint_rates(rate) if of_legs else state.joint_velocities(rate)
    twist = state.kinematics.platform_jacobian @ first
    rest = np.zeros(len(q))
    still, moved = (_forces(state, a, np.zeros(6), payload) for a in (rest, first))
    state.update(q, first)
    second = state.joint_accelerations_of_legs(change) if of_legs else state.joint_accelerations(change)
    driven = _forces(state, second, twist, payload)
    return first, second, twist, moved - still, driven - still, still


def _forces(state: ChainState, a: FloatArray, twist: FloatArray, payload: Payload | None) -> FloatArray:
    """Return the leg forces (6,) of joint accelerations a at the velocity of the state."""
    if payload is None:
        return state.inverse_dynamics(a)
    rotation, _ = state.kinematics.terminal_pose()
    gravity = state.kinematics.model.gravity.linear
    load = payload.wrench(rotation, twist, state.platform_acceleration(a), gravity)
    return state.inverse_dynamics(a, load)
