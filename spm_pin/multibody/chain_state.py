"""The state of a chain: joint values and velocities, one or a batch, and all that is computed from them.

The equations are those of `spm_pin.loops.state_kinematics`, with the matrices of `constrained_model`; the forces λ are
those in the cut balls. `docs/theory/dynamics.md` says which unknowns each method solves for, and where that is regular.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.linalg import LinAlgError, eigh

from spm_pin.errors import ArgumentError
from spm_pin.loops.loop_state import TreeState
from spm_pin.machine.configuration import Configuration
from spm_pin.multibody.constrained_model import (
    ConstrainedModel,
    SingularValues,
    TreeKinematics,
    read_vectors,
)
from spm_pin.support.arguments import FloatArray, real_array, symmetric_matrices


class PlatformDynamics(NamedTuple):
    """The mechanism's equations of motion at its platform, Λ ṫ + C t + G = J_fᵀ f + w.

    t = (v, ω) is the twist of m at o and ṫ its time derivative, f are the leg forces, w is the wrench applied onto m,
    all in {B}. The masses of all bodies are included. For a stage t is the motion (v_z, ω_x, ω_y), and w the part of
    the wrench that does work along it, `platform_jacobian` @ `inverse_jacobian` transposed times the wrench.
    """

    mass: FloatArray
    """Λ, reflected at o, shape (..., 6, 6); for a stage (..., 3, 3); symmetric and positive definite."""
    coriolis: FloatArray
    """C, of the same shape, in the factorization for which Λ̇ - 2 C is skew-symmetric."""
    bias: FloatArray
    """C t [N, N m], shape (..., 6); for a stage (..., 3)."""
    gravity: FloatArray
    """G, of the same shape: minus what the weights of all bodies exert at o."""


class NaturalFrequencies(NamedTuple):
    """Vibrations of the platform on elastic legs, slowest first."""

    frequencies: FloatArray
    """Natural frequencies [Hz], shape (..., 6); for a stage (..., 3)."""
    modes: FloatArray
    """Small displacements (of o [m], rotation [rad]) in {B} as rows, shape (..., 6, 6); for a stage (..., 3, 3), in the
    order of the frequencies; Mᵀ Λ M = 1 of the columns."""


class ConstrainedState(TreeState):
    """Joint values q and velocities v of a model with closures, and quantities computed from them.

    Made by the method `state` of `ClosedChain` and `MountedChain`; `update`, batches, `kinematics` and `failures` are
    as of a `spm_pin.loops` `LoopState`. A ball joint whose middle angle is ±90° is a failure too.
    """

    _kept_argument = "q"

    def __init__(self, constrained: ConstrainedModel) -> None:
        self.kinematics: TreeKinematics
        super().__init__(constrained.loops, TreeKinematics(constrained))
        self._constrained = constrained

    def __reduce__(self) -> tuple[Any, ...]:
        return _state, (type(self), self._constrained, self._q, self._v)

    def _read_q(self, q: npt.ArrayLike) -> FloatArray:
        return self._constrained.read_q(q)

    def _check_closed(self) -> None:
        if not self._is_closed:
            self.kinematics.check_ball_angles()
            self.kinematics.check_closed(self._rates)
            self._is_closed = True

    def closure_gap(self) -> FloatArray:
        """Return how far the closures are open: from `frame_a` to `frame_b` of each [m], shape (..., 4, 3)."""

        def member() -> FloatArray:
            places = self.kinematics.data.oMf
            return np.array([places[b].translation - places[a].translation for a, b in self._constrained.pairs])

        return self._each_member(member, (len(self._constrained.closures), 3))

    def constraint_jacobian(self) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (..., 12, nv), three rows per closure; exact at any q.

        Its transpose maps forces on `frame_b` of the closures (and opposite forces on `frame_a`) to generalized forces.
        """
        shape = 3 * len(self._constrained.closures), self._constrained.model.nv
        of_frame = self.kinematics.frame_jacobian
        return self._each_member(lambda: _differences(self._constrained, of_frame), shape)

    def forward_dynamics(self, forces: npt.ArrayLike, wrench: npt.ArrayLike | None = None) -> FloatArray:
        """Return the accelerations of all joints (..., nv) [rad/s², m/s²] under actuators, gravity and a wrench.

        `forces` (..., n) [N, N m] are those of the actuators: of another robot first, then of the legs; `wrench`
        (..., 6) is onto the terminal platform. q and v are closed. Only constraint singularities raise: inverse and
        forward ones are no obstacle.
        """
        values = read_vectors(forces, "forces", self._count)
        return self._forward_dynamics("forces", values, *self._read_wrench(wrench))

    def inverse_dynamics(self, a: npt.ArrayLike, wrench: npt.ArrayLike | None = None) -> FloatArray:
        """Return the forces of the actuators (..., n) [N, N m] for a motion under gravity, inertia and a wrench.

        q, v and the accelerations `a` (..., nv) are those of a closed mechanism, the order of the forces and the wrench
        as in `forward_dynamics`. At rest, the weights of all bodies are left. Raises at a forward or a constraint
        singularity.
        """
        frames, arrays = self._read_wrench(wrench)

        def member(a: FloatArray, *loads: FloatArray) -> FloatArray:
            return self._actuator_forces(a, frames, loads)

        return self._each_closed_member(member, (self._count,), a=read_vectors(a, "a", self._nv), **arrays)

    def _balance(self, forces: FloatArray, frames: list[int], loads: tuple[FloatArray, ...]) -> FloatArray:
        kinematics = self.kinematics
        for frame, load in zip(frames, loads, strict=True):
            forces = forces - kinematics.frame_jacobian(frame).T.dot(load)
        # Forces in the balls do no work on another robot: its actuators carry the tree's torques.
        legs, others = kinematics.balance(forces)[0], self._constrained.others
        return np.concatenate([forces.take(others), legs]) if len(others) else legs

    def _read_wrench(self, wrench: npt.ArrayLike | None) -> tuple[list[int], dict[str, FloatArray]]:
        """Return the frame, and the argument of `_each_member`, of a wrench (..., 6) onto the platform, if any."""
        if wrench is None:
            return [], {}
        return [self._constrained.platform_frame], {"wrench": read_vectors(wrench, "wrench", 6)}


def _state(kind: type[ConstrainedState], constrained: ConstrainedModel, q: FloatArray, v: FloatArray) -> TreeState:
    return kind(constrained).update(q, v)


def _differences(constrained: ConstrainedModel, of_frame: Callable[[int], FloatArray]) -> FloatArray:
    """Return the linear part at `frame_b` less that at `frame_a` of matrices (6, m) of frames, shape (3 n, m)."""
    return np.concatenate([of_frame(b)[:3] - of_frame(a)[:3] for a, b in constrained.pairs])


class ChainState(ConstrainedState):
    """The state of a `ClosedChain`: a `ConstrainedState` with methods that a mounted chain does not have.

    Wrenches are (f, m) [N, N m] onto the terminal platform at o in the axes of {B}, twists (v, ω) [m/s, rad/s] of it.
    The platform of a stage has three freedoms: its *motion* (v_z, ω_x, ω_y) replaces the twist of a manipulator, and
    the parasitic v_x, v_y and ω_z follow. The n legs are in the order of `Machine.legs.names`, and a positive leg force
    pushes, to extend the leg. `joints` are 18, or 9 of a stage.
    Methods that use rates or forces take a closed q, and raise `ArgumentError` where a ball joint's middle angle is
    ±90°, and `SingularConfigurationError` at the singularities they name, where a matrix is singular to rounding.
    """

    def configuration(self) -> Configuration:
        """Return the configuration (...): the pose of m and those of the middle platform's corners.

        If q is open, so is the configuration, and its leg lengths are those between its points, not those of q.
        """
        kinematics, constrained = self.kinematics, self._constrained

        def member() -> tuple[FloatArray, ...]:
            corners = [kinematics.data.oMf[frame].translation for frame in constrained.corner_frames]
            return *kinematics.terminal_pose(), np.array(corners).reshape(-1, 3)

        corners = len(constrained.corner_frames)
        rotation, translation, points = self._each_member(member, [(3, 3), (3,), (corners, 3)])
        if constrained.is_stage:
            return Configuration.from_arrays(constrained.machine, rotation, translation)
        return Configuration.from_arrays(constrained.machine, rotation, translation, points)

    def inverse_jacobian(self) -> FloatArray:
        """Return J_f (..., 6, 6), which maps the platform's twist to the leg rates; for a stage (..., 3, 3).

        Raises at an inverse or a constraint singularity.
        """
        legs, shape = self._constrained.legs, (len(self._constrained.legs), len(self._constrained.freedoms))
        return self._each_closed_member(lambda: self.kinematics.velocities_of_twists.take(legs, axis=0), shape)

    def platform_jacobian(self) -> FloatArray:
        """Return the map from leg rates to the twist of m, shape (..., 6, n), with the parasitic motion of a stage.

        Raises at a forward or a constraint singularity.
        """
        kinematics, legs = self.kinematics, len(self._constrained.legs)

        def member() -> FloatArray:
            columns = [kinematics.velocities_of_legs(rates) for rates in np.eye(legs)]
            return np.asarray(kinematics.platform_jacobian @ np.array(columns).T)

        return self._each_closed_member(member, (6, legs))

    def joint_velocities(self, twist: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints (..., joints) [rad/s, m/s] for a twist (..., 6) or motion (..., 3) of m.

        Raises as `inverse_jacobian`.
        """
        twists = self._freedoms(twist, "twist")
        each = self._each_closed_member
        return each(lambda t: self.kinematics.velocities_of_twists.dot(t), (self._joints,), twist=twists)

    def joint_rates(self, leg_rates: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints (..., joints) [rad/s, m/s] for rates of the legs (..., n) [m/s].

        Raises at a forward or a constraint singularity.
        """
        rates = self._legs(leg_rates, "leg_rates")
        return self._each_closed_member(self.kinematics.velocities_of_legs, (self._joints,), leg_rates=rates)

    @property
    def _joints(self) -> int:
        return len(self._constrained.names)

    def _legs(self, value: npt.ArrayLike, argument: str) -> FloatArray:
        return read_vectors(value, argument, len(self._constrained.legs))

    def _freedoms(self, value: npt.ArrayLike, argument: str) -> FloatArray:
        return read_vectors(value, argument, len(self._constrained.freedoms))

    def leg_forces(self, wrench: npt.ArrayLike) -> FloatArray:
        """Return the actuator forces (..., n) [N] that hold a wrench (..., 6) applied onto the terminal platform.

        Weights and friction are left out: `inverse_dynamics` has the weights. Raises at a forward or a constraint
        singularity.
        """
        loads = read_vectors(wrench, "wrench", 6)
        return self._each_closed_member(lambda w: self._holding(w)[0], (len(self._constrained.legs),), wrench=loads)

    def cut_forces(self, wrench: npt.ArrayLike) -> FloatArray:
        """Return the forces in the ball joints where the tree is cut, shape (..., closures, 3) [N] in {B}.

        Per closure, what the middle platform (`frame_a`) exerts onto the tip of the leg (`frame_b`). The wrench and the
        errors are those of `leg_forces`.
        """
        kinematics, shape = self.kinematics, (len(self._constrained.closures), 3)

        def member(load: FloatArray) -> FloatArray:
            return kinematics.in_universe(self._holding(load)[1]).reshape(shape)

        return self._each_closed_member(member, shape, wrench=read_vectors(wrench, "wrench", 6))

    def _holding(self, load: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the forces of the legs and of the closures' rows of a single state that hold a wrench (6,)."""
        return self.kinematics.balance(-self.kinematics.platform_jacobian.T.dot(load))

    def singular_values(self) -> SingularValues:
        """Return how near q is to each kind of singularity, without raising `SingularConfigurationError`."""
        return SingularValues(*self._each_closed_member(self.kinematics.singular_values, [(), (), ()]))

    def joint_accelerations(self, acceleration: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (..., joints) for one of the terminal platform (..., 6).

        That is the time derivative of the twist: of the point o [m/s²], and angular [rad/s²], in {B}; for a stage that
        of its motion (..., 3). Raises at an inverse or a constraint singularity.
        """
        kinematics, freedoms = self.kinematics, self._constrained.freedoms

        def member(acceleration: FloatArray) -> FloatArray:
            if not self._constrained.is_stage:
                return self._accelerations_of(acceleration)
            a = self._accelerations_of(np.zeros(6))
            platform = kinematics.frame_acceleration(self._constrained.platform_frame, self._rates, a)
            return np.asarray(a + kinematics.velocities_of_twists @ (acceleration - platform[freedoms]))

        wanted = self._freedoms(acceleration, "acceleration")
        return self._each_closed_member(member, (self._joints,), acceleration=wanted)

    def _accelerations_of(self, acceleration: FloatArray) -> FloatArray:
        """Return the joint accelerations of a single state for which W times that of m is W times the argument (6,)."""
        self._check_closed()
        kinematics, v = self.kinematics, self._rates
        return kinematics.velocities_along(acceleration - kinematics.platform_drift(v), -kinematics.bias(v))

    def velocities_along(self, twist: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints of a single state with which m moves as W times a twist (6,) says."""
        self._check_closed()
        return self.kinematics.velocities_along(real_array(twist, "twist", (6,), "a twist (v, ω) in m/s and rad/s"))

    def _accelerations_along(self, twist: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return the accelerations of all joints along a path of this twist and acceleration (6,) of the platform.

        A stage follows the normal n of the path and not its spin: n × n̈ = α - n (n·α) + (ω·n) n × ω is the same.
        """
        if self._constrained.is_stage:
            kinematics = self.kinematics
            spin, normal = (
                twist[3:] - (kinematics.platform_jacobian @ self._rates)[3:],
                kinematics.terminal_pose()[0][:, 2],
            )
            acceleration = acceleration.copy()
            acceleration[3:] += (spin @ normal) * np.cross(normal, twist[3:])
        return self._accelerations_of(acceleration)

    def joint_accelerations_of_legs(self, leg_accelerations: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (..., joints) for those of the legs (..., n) [m/s²].

        Raises as `joint_rates`.
        """

        def member(accelerations: FloatArray) -> FloatArray:
            return self.kinematics.velocities_of_legs(accelerations, -self.kinematics.bias(self._rates))

        wanted = self._legs(leg_accelerations, "leg_accelerations")
        return self._each_closed_member(member, (self._joints,), leg_accelerations=wanted)

    def platform_acceleration(self, a: npt.ArrayLike) -> FloatArray:
        """Return the time derivative of the twist of m (..., 6) [m/s², rad/s²] for joint accelerations (..., nv)."""

        def member(a: FloatArray) -> FloatArray:
            return self.kinematics.frame_acceleration(self._constrained.platform_frame, self._rates, a)

        return self._each_closed_member(member, (6,), a=read_vectors(a, "a", self._joints))

    def platform_dynamics(self) -> PlatformDynamics:
        """Return the equations of motion at the terminal platform, Λ ṫ + C t + G = J_fᵀ f + w, of all bodies' masses.

        Raises at an inverse or a constraint singularity.
        """
        n = len(self._constrained.freedoms)
        return PlatformDynamics(*self._each_closed_member(self._platform_dynamics, [(n, n), (n, n), (n,), (n,)]))

    def _platform_dynamics(self) -> tuple[FloatArray, ...]:
        kinematics, constrained, v = self.kinematics, self._constrained, self._rates
        model, data, q, x = kinematics.model, kinematics.data, kinematics.q, kinematics.velocities_of_twists
        pin.computeJointJacobiansTimeVariation(model, data, q, v)

        def change(frame: int) -> FloatArray:
            return np.asarray(pin.getFrameJacobianTimeVariation(model, data, frame, pin.LOCAL_WORLD_ALIGNED))

        # Jc Ẋ = -J̇c X, in the axes of `frame_a` as the rows are, and the twists of X have constant rows of freedoms.
        freedoms = constrained.freedoms
        opening = kinematics.in_universe(-_differences(constrained, change) @ x, back=True)
        part = np.stack([kinematics.velocities_along(np.zeros(6), column) for column in opening.T], axis=-1)
        platform = change(constrained.platform_frame)
        x_rate = part - x @ (platform @ x + kinematics.platform_jacobian @ part)[freedoms]
        mass = kinematics.mass_matrix()
        coriolis = x.T @ (mass @ x_rate + pin.computeCoriolisMatrix(model, data, q, v) @ x)
        reflected = x.T @ mass @ x
        gravity = x.T @ pin.computeGeneralizedGravity(model, data, q)
        bias = coriolis @ (kinematics.platform_jacobian @ v)[freedoms]
        return 0.5 * (reflected + reflected.T), coriolis, bias, gravity

    def natural_frequencies(self, stiffness: npt.ArrayLike) -> NaturalFrequencies:
        """Return the small vibrations of the platform with its motors held, on legs that are elastic: Λ ẍ + K x = 0.

        `stiffness` K (..., 6, 6) is that of the platform from `spm_pin.stiffness`; for a stage (..., 3, 3), with a
        rigid structure. The contribution of the weights to it is neglected. Raises at an inverse or a constraint
        singularity.
        """
        meaning = "in N/m, N/rad, N and N m/rad, as of spm_pin.stiffness"
        n = len(self._constrained.freedoms)
        matrices = symmetric_matrices(stiffness, "stiffness", n, meaning)
        flat = matrices.reshape(*matrices.shape[:-2], n * n)
        return NaturalFrequencies(*self._each_closed_member(self._vibrations, [(n,), (n, n)], stiffness=flat))

    def _vibrations(self, stiffness: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, expected = self.kinematics.velocities_of_twists, "a symmetric matrix, positive definite"
        try:
            squares, modes = eigh(stiffness.reshape(x.shape[1], -1), x.T @ self.kinematics.mass_matrix() @ x)
        except LinAlgError as error:
            raise ArgumentError("stiffness", expected, str(error)) from error
        if squares[0] <= 0.0:
            raise ArgumentError("stiffness", expected, f"a least ω² of {squares[0]:g} 1/s²")
        return np.sqrt(squares) / (2.0 * math.pi), modes.T
