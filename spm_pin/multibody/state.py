"""The state of a constrained model: joint values and velocities, and what several calls about them share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.multibody.constrained_model import ConstrainedModel, SingularValues, TreeKinematics
from spm_pin.multibody.dynamics import (
    AccelerationSolver,
    Energy,
    PlatformDynamics,
    accelerations_for,
    balance,
    drift,
    energy_of,
    platform_dynamics,
    require_closed,
    require_closed_accelerations,
    wrench_torques,
)
from spm_pin.multibody.joint_layout import is_vector, one_vector

__all__ = ["ChainState", "ConstrainedState", "Gains", "WrenchLike", "read_gains", "read_wrenches"]

WrenchLike = npt.ArrayLike | Mapping[str, npt.ArrayLike] | None
"""A wrench (6,) on the platform, wrenches by the name of their frame, or none."""
Gains = tuple[float, float] | None
"""Gains of the constraint stabilisation on gap [1/s²] and gap rate [1/s], or none."""

WRENCH = "(f, m) at o in {B} in N and N m"


class ConstrainedState:
    """Joint values q and velocities v of a constrained model, with the memory for all that is computed from them.

    Made by the method `state` of `ClosedChain` and of `MountedChain`. Kinematics, constraint Jacobian and
    factorisations are computed once and kept for later calls: use it for several quantities of one q and v, or for one
    quantity of many in turn. `update` moves it to another q and v without new memory. One state is for one
    thread at a time. Methods are those of `ClosedChain` without q and v, for one member each, with the same errors.
    """

    def __init__(self, constrained: ConstrainedModel) -> None:
        self.constrained = constrained
        self.kinematics = TreeKinematics(constrained)
        self._v = np.zeros(constrained.model.nv)
        self._drift: tuple[FloatArray, FloatArray] | None = None
        self._solver: AccelerationSolver | None = None

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.constrained.model.nv} degrees of freedom of the tree>"

    @property
    def q(self) -> FloatArray:
        """Joint values, shape (nq,); a copy."""
        return self.kinematics.q.copy()

    @property
    def v(self) -> FloatArray:
        """Joint velocities, shape (nv,); a copy."""
        return self._v.copy()

    def update(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> Self:
        """Move to other joint values (nq,) and velocities (nv,), zero by default; return this state."""
        model, layout = self.constrained.model, self.constrained.layout
        joints = one_vector(q, "q", (model.nq,), "joint values in rad and m in Pinocchio's order")
        layout.checked(joints[layout.q])
        rates = (
            None if v is None else one_vector(v, "v", (model.nv,), "rates of the joints in Pinocchio's order").copy()
        )
        self.set(joints.copy(), rates)
        return self

    def set(self, q: FloatArray, v: FloatArray | None = None) -> None:
        """Move to arrays that have been checked, and are not changed while the state is there."""
        self.kinematics.evaluate(q)
        self._v = np.zeros(self.constrained.model.nv) if v is None else v
        self._drift = None

    @property
    def solver(self) -> AccelerationSolver:
        """Pinocchio's constrained dynamics, with its memory."""
        if self._solver is None:
            self._solver = AccelerationSolver(self.constrained)
        return self._solver

    def closure_gap(self) -> FloatArray:
        """Return how far the closures are open, shape (4, 3) [m]."""
        return self.kinematics.gap.copy()

    def constraint_jacobian(self) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (12, nv)."""
        return self.kinematics.closures.copy()

    def forward_dynamics(self, forces: npt.ArrayLike, wrench: WrenchLike = None, *, gains: Gains = None) -> FloatArray:
        """Return the accelerations of all joints (nv,) under the forces of all actuators, gravity and wrenches."""
        force = one_vector(forces, "forces", (self.constrained.actuated.size,), "of the actuators")
        return self.accelerations(force, *read_wrenches(self.constrained, wrench), read_gains(gains))

    def accelerations(
        self, forces: FloatArray, wrenches: FloatArray, frames: list[int], gains: Gains = None
    ) -> FloatArray:
        """Return `forward_dynamics` of arguments that have been read: wrenches (6 n,) at n frames."""
        kinematics = self.kinematics
        kinematics.require_constrained()
        if gains is None:
            require_closed(kinematics, self._v)
        torques = wrench_torques(kinematics, zip(frames, wrenches.reshape(-1, 6), strict=True))
        torques[self.constrained.actuated] += forces
        return self.solver.accelerations(kinematics.q, self._v, torques, gains or (0.0, 0.0))

    def inverse_dynamics(self, a: npt.ArrayLike, wrench: WrenchLike = None) -> FloatArray:
        """Return the forces of all actuators for joint accelerations (nv,), under gravity and wrenches."""
        wanted = one_vector(a, "a", (self.constrained.model.nv,), "accelerations of the joints")
        return self.actuator_forces(wanted, *read_wrenches(self.constrained, wrench))

    def actuator_forces(self, a: FloatArray, wrenches: FloatArray, frames: list[int]) -> FloatArray:
        """Return `inverse_dynamics` of arguments that have been read: wrenches (6 n,) at n frames."""
        kinematics, layout = self.kinematics, self.constrained.layout
        require_closed(kinematics, self._v)
        require_closed_accelerations(kinematics, self._bias()[0], self._v, a)
        torques = pin.rnea(kinematics.model, kinematics.data, kinematics.q, self._v, a)
        if frames:
            torques = torques - wrench_torques(kinematics, zip(frames, wrenches.reshape(-1, 6), strict=True))
        # Forces in the balls do no work on another robot: its actuators carry the tree's torques.
        legs = balance(kinematics, torques[layout.v])[0]
        return np.concatenate([torques[layout.others], legs])

    def energy(self) -> Energy:
        """Return the kinetic and the potential energy [J] of all bodies, closed or not."""
        return energy_of(self.kinematics, self._v)

    def _bias(self) -> tuple[FloatArray, FloatArray]:
        if self._drift is None:
            self._drift = drift(self.kinematics, self._v)
        return self._drift


class ChainState(ConstrainedState):
    """The state of a `ClosedChain`: joint values q and velocities v, and what several calls about them share.

    Made by `ClosedChain.state`. Methods are those of the chain without q and v, for one member each, with the same
    errors; what one of them computes, the next one finds. `update` moves the state to another q and v and keeps its
    memory. One state is for one thread at a time.
    """

    def configuration(self) -> Configuration:
        """Return the poses of m and of the middle platform's corners."""
        return Configuration.from_arrays(self.constrained.layout.geometry, *self.pose_arrays())

    def pose_arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the rotation (3, 3) and the translation (3,) of m, and the rows b_1, b_2, b_3."""
        return *self.kinematics.terminal_pose(), self.kinematics.corners()

    def leg_lengths(self) -> FloatArray:
        """Return the leg lengths (6,) [m]."""
        return self.constrained.layout.leg_lengths(self.kinematics.q)

    def inverse_jacobian(self) -> FloatArray:
        """Return J_f, which maps the platform's twist to the leg rates, shape (6, 6)."""
        return np.asarray(self.kinematics.velocities_of_twists()[self.constrained.layout.legs])

    def joint_velocities(self, twist: npt.ArrayLike) -> FloatArray:
        """Return the rates of all joints (18,) for a twist (6,) of m."""
        value = one_vector(twist, "twist", (6,), "(v, ω) at o in {B} in m/s and rad/s")
        return np.asarray(self.kinematics.velocities_of_twists() @ value)

    def joint_rates(self, leg_rates: npt.ArrayLike) -> FloatArray:
        """Return the rates of all joints (18,) for rates of the legs (6,)."""
        return self.kinematics.velocities_of_legs(one_vector(leg_rates, "leg_rates", (6,), "of r_b1 to r_c3 in m/s"))

    def leg_forces(self, wrench: npt.ArrayLike) -> FloatArray:
        """Return the actuator forces (6,) that hold a wrench (6,) applied onto the terminal platform."""
        return self._holding_forces(wrench)[0]

    def cut_forces(self, wrench: npt.ArrayLike) -> FloatArray:
        """Return the forces in the cut ball joints, shape (4, 3)."""
        return self._holding_forces(wrench)[1].reshape(-1, 3)

    def singular_values(self) -> SingularValues:
        """Return how near q is to each kind of singularity."""
        return self.kinematics.singular_values()

    def joint_accelerations(self, acceleration: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (18,) for one of the terminal platform (6,)."""
        value = one_vector(acceleration, "acceleration", (6,), "of o in m/s², angular in rad/s², in {B}")
        require_closed(self.kinematics, self._v)
        return accelerations_for(self.kinematics, value, self._bias())

    def platform_dynamics(self) -> PlatformDynamics:
        """Return the equations of motion at the terminal platform."""
        require_closed(self.kinematics, self._v)
        return platform_dynamics(self.kinematics, self._v)

    def _holding_forces(self, wrench: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        load = one_vector(wrench, "wrench", (6,), WRENCH)
        return balance(self.kinematics, -(self.kinematics.platform.T @ load))


def read_wrenches(constrained: ConstrainedModel, wrench: WrenchLike) -> tuple[FloatArray, list[int]]:
    """Return wrenches side by side, shape (..., 6 n), and the n frames that they act onto."""
    model, platform = constrained.model, constrained.layout.platform
    if wrench is None:
        return np.empty((0,)), []
    if not isinstance(wrench, Mapping):
        return read(wrench, "wrench", 6, "(f, m) in N and N m in the axes of {B}"), [platform]
    unknown = [name for name in wrench if not (isinstance(name, str) and model.existFrame(name))]
    if unknown:
        cause = "The names of links, with the prefix"
        raise ArgumentError("wrench", "frames of the model", ", ".join(map(repr, unknown)), cause)
    arrays = [read(value, "wrench", 6, "(f, m) in N and N m in the axes of {B}") for value in wrench.values()]
    try:
        spread = np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise ArgumentError("wrench", "leading axes that broadcast", f"shapes {shapes}") from None
    together = np.concatenate(spread, axis=-1) if spread else np.empty((0,))
    return together, [int(model.getFrameId(name)) for name in wrench]


def read_gains(gains: Gains) -> Gains:
    """Return the gains of a drift control, checked."""
    if gains is None:
        return None
    array = real_array(gains, "gains", (2,), "kp in 1/s² and kd in 1/s")
    if array.ndim != 1 or (array < 0.0).any():
        raise ArgumentError("gains", "a pair (kp, kd), not negative", repr(gains))
    return float(array[0]), float(array[1])


def read(value: npt.ArrayLike, argument: str, size: int, meaning: str) -> FloatArray:
    """Read vectors (..., size), quickly if there is one."""
    return np.asarray(value) if is_vector(value, size) else real_array(value, argument, (size,), meaning)
