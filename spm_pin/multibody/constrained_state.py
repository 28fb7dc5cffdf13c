"""The state of a constrained model: joint values and velocities, and what several calls about them share."""

from __future__ import annotations

from typing import Self

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.multibody import dynamics
from spm_pin.multibody.constrained_model import ConstrainedModel, SingularValues, TreeKinematics
from spm_pin.multibody.dynamics import AccelerationSolver, Energy, NaturalFrequencies, PlatformDynamics
from spm_pin.multibody.vector_arguments import Gains, WrenchLike, read_gains, read_stiffness, read_vector, read_wrenches

__all__ = ["ChainState", "ConstrainedState"]


class ConstrainedState:
    """Joint values q and velocities v of a constrained model, with the memory for all that is computed from them.

    Made by the method `state` of `ClosedChain` and of `MountedChain`. Kinematics, constraint Jacobian and
    factorisations are computed once and kept for later calls: use it for several quantities of one q and v, or for one
    quantity of many in turn. `update` moves it to another q and v without new memory. One state is for one thread at a
    time. Methods are those of the chain without q and v, for one member each, with the same errors.
    """

    def __init__(self, constrained: ConstrainedModel) -> None:
        self.constrained = constrained
        self.kinematics = TreeKinematics(constrained)
        self._v = np.zeros(constrained.model.nv)
        self._drift: tuple[FloatArray, FloatArray] | None = None
        self._closed = False
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
        joints = read_vector(q, "q", model.nq)
        layout.require_distances(joints[layout.q])
        self.set(joints.copy(), None if v is None else read_vector(v, "v", model.nv).copy())
        return self

    def set(self, q: FloatArray, v: FloatArray | None = None) -> None:
        """Move to arrays that have been checked, and are not changed while the state is there."""
        self.kinematics.evaluate(q)
        self._v = np.zeros(self.constrained.model.nv) if v is None else v
        self._drift = None
        self._closed = False

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
        force = read_vector(forces, "forces", self.constrained.actuated.size)
        return self.accelerations(force, *self._wrenches(wrench), gains)

    def accelerations(self, forces: FloatArray, wrenches: FloatArray, frames: list[int], gains: Gains) -> FloatArray:
        """Return `forward_dynamics` of vectors that have been read: wrenches (6 n,) at n frames."""
        kinematics, drift_gains = self.kinematics, read_gains(gains)
        kinematics.require_constrained()
        if gains is None:
            self._require_closed()
        torques = dynamics.wrench_torques(kinematics, frames, wrenches)
        torques[self.constrained.actuated] += forces
        return self.solver.accelerations(kinematics.q, self._v, torques, drift_gains)

    def inverse_dynamics(self, a: npt.ArrayLike, wrench: WrenchLike = None) -> FloatArray:
        """Return the forces of all actuators for joint accelerations (nv,), under gravity and wrenches."""
        return self.actuator_forces(read_vector(a, "a", self.constrained.model.nv), *self._wrenches(wrench))

    def actuator_forces(self, a: FloatArray, wrenches: FloatArray, frames: list[int]) -> FloatArray:
        """Return `inverse_dynamics` of vectors that have been read: wrenches (6 n,) at n frames."""
        kinematics, layout = self.kinematics, self.constrained.layout
        self._require_closed()
        dynamics.require_closed_accelerations(kinematics, self._bias()[0], self._v, a)
        torques = pin.rnea(kinematics.model, kinematics.data, kinematics.q, self._v, a)
        if frames:
            torques = torques - dynamics.wrench_torques(kinematics, frames, wrenches)
        # Forces in the balls do no work on another robot: its actuators carry the tree's torques.
        legs = dynamics.balance(kinematics, torques[layout.v])[0]
        return np.concatenate([torques[layout.others], legs])

    def energy(self) -> Energy:
        """Return the kinetic and the potential energy [J] of all bodies, closed or not."""
        return dynamics.energy_of(self.kinematics, self._v)

    def _wrenches(self, wrench: WrenchLike) -> tuple[FloatArray, list[int]]:
        return read_wrenches(wrench, self.constrained.model, self.constrained.layout.platform)

    def _require_closed(self) -> None:
        """Raise unless q is closed and v keeps it so; looked at once for each q and v."""
        if not self._closed:
            dynamics.require_closed(self.kinematics, self._v)
            self._closed = True

    def _bias(self) -> tuple[FloatArray, FloatArray]:
        if self._drift is None:
            self._drift = dynamics.drift(self.kinematics, self._v)
        return self._drift


class ChainState(ConstrainedState):
    """The state of a `ClosedChain`: a `ConstrainedState` with the methods that a mounted chain has not."""

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
        return np.asarray(self.kinematics.velocities_of_twists() @ read_vector(twist, "twist", 6))

    def joint_rates(self, leg_rates: npt.ArrayLike) -> FloatArray:
        """Return the rates of all joints (18,) for rates of the legs (6,)."""
        return self.kinematics.velocities_of_legs(read_vector(leg_rates, "leg_rates", 6))

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
        wanted = read_vector(acceleration, "acceleration", 6)
        self._require_closed()
        return dynamics.accelerations_for(self.kinematics, wanted, self._bias())

    def joint_accelerations_of_legs(self, leg_accelerations: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (18,) for those of the legs (6,) [m/s²]."""
        wanted = read_vector(leg_accelerations, "leg_accelerations", 6)
        self._require_closed()
        return dynamics.accelerations_for_legs(self.kinematics, wanted, self._bias())

    def platform_acceleration(self, a: npt.ArrayLike) -> FloatArray:
        """Return the time derivative of the twist of m (6,) [m/s², rad/s²] for joint accelerations (nv,)."""
        return np.asarray(self.kinematics.platform @ read_vector(a, "a", self.constrained.model.nv) + self._bias()[1])

    def natural_frequencies(self, stiffness: npt.ArrayLike) -> NaturalFrequencies:
        """Return the vibrations of the platform on elastic legs, of a stiffness (6, 6) as of `spm_pin.stiffness`."""
        dynamics.require_closed(self.kinematics)
        return dynamics.natural_frequencies(self.kinematics, read_stiffness(stiffness))

    def platform_dynamics(self) -> PlatformDynamics:
        """Return the equations of motion at the terminal platform."""
        self._require_closed()
        return dynamics.platform_dynamics(self.kinematics, self._v)

    def _holding_forces(self, wrench: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        load = read_vector(wrench, "wrench", 6)
        return dynamics.balance(self.kinematics, -(self.kinematics.platform.T @ load))
