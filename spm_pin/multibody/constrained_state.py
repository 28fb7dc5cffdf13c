"""The state of a constrained model: joint values and velocities, and what several calls about them share."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.linalg import LinAlgError, eigh

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.multibody.closure_checks import largest, require_closed
from spm_pin.multibody.constrained_model import ConstrainedModel, TreeKinematics
from spm_pin.multibody.dynamics import (
    AccelerationSolver,
    Energy,
    NaturalFrequencies,
    PlatformDynamics,
    energy_of,
    mass_matrix,
    wrench_torques,
)
from spm_pin.multibody.joint_layout import AGREEMENT
from spm_pin.multibody.regularity import SingularValues
from spm_pin.multibody.vector_arguments import GainsLike, WrenchLike, read_gains, read_stiffness, read_vector


class ConstrainedState:
    """Joint values q and velocities v of a constrained model, with the memory for all that is computed from them.

    Made by the method `state` of `ClosedChain` and of `MountedChain`. Kinematics, constraint Jacobian and
    factorisations are computed once and kept for later calls: use it for several quantities of one q and v, or for one
    quantity of many in turn. `update` moves it to another q and v without new memory. One state is for one thread at a
    time. Its methods are those of `MountedChain` about closures, dynamics and energy, without q and v, for one member
    each, with the same errors.

    Attributes
    ----------
    kinematics : TreeKinematics
        Pinocchio's data, Jacobians and factorisations at q; do not change it.
    """

    def __init__(self, constrained: ConstrainedModel) -> None:
        self._constrained = constrained
        self.kinematics = TreeKinematics(constrained)
        self._v = np.zeros(constrained.model.nv)
        self._drift: tuple[FloatArray, FloatArray] | None = None
        self._closed = False

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._constrained.model.nv} degrees of freedom of the tree>"

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
        joints = self._constrained.checked(q, single=True).copy()
        self._set_checked(joints, None if v is None else read_vector(v, "v", self._constrained.model.nv).copy())
        return self

    def _set_checked(self, q: FloatArray, v: FloatArray | None = None) -> None:
        """Move to arrays that have been checked, and are not changed while the state is there."""
        self.kinematics.evaluate(q)
        self._v = np.zeros(self._constrained.model.nv) if v is None else v
        self._drift = None
        self._closed = False

    def closure_gap(self) -> FloatArray:
        """Return how far the closures are open, shape (4, 3) [m]."""
        return self.kinematics.gap.copy()

    def constraint_jacobian(self) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (12, nv)."""
        return self.kinematics.constraint_jacobian.copy()

    def forward_dynamics(
        self, forces: npt.ArrayLike, wrench: WrenchLike = None, *, gains: GainsLike = None
    ) -> FloatArray:
        """Return the accelerations of all joints (nv,) under the forces of all actuators, gravity and wrenches."""
        kinematics, actuated = self.kinematics, self._constrained.actuated
        stabilisation, force = read_gains(gains), read_vector(forces, "forces", actuated.size)
        wrenches = self._constrained.read_wrenches(wrench, single=True)
        kinematics.require_constrained()
        if stabilisation is None:
            self._require_closed()
        torques = wrench_torques(kinematics, wrenches)
        torques[actuated] += force
        return self._solver.accelerations(kinematics.q, self._v, torques, stabilisation)

    def inverse_dynamics(self, a: npt.ArrayLike, wrench: WrenchLike = None) -> FloatArray:
        """Return the forces of all actuators for joint accelerations (nv,), under gravity and wrenches."""
        kinematics, layout = self.kinematics, self._constrained.layout
        wanted = read_vector(a, "a", kinematics.model.nv)
        wrenches = self._constrained.read_wrenches(wrench, single=True)
        self._require_closed()
        self._require_closed_accelerations(wanted)
        load = wrench_torques(kinematics, wrenches)
        torques = pin.rnea(kinematics.model, kinematics.data, kinematics.q, self._v, wanted) - load
        # Forces in the balls do no work on another robot: its actuators carry the tree's torques.
        return np.concatenate([torques[layout.others], self._balance(torques[layout.v])[0]])

    def energy(self) -> Energy:
        """Return the kinetic and the potential energy [J] of all bodies, closed or not."""
        return energy_of(self.kinematics, self._v)

    @cached_property
    def _solver(self) -> AccelerationSolver:
        return AccelerationSolver(self._constrained)

    def _balance(self, torques: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return leg forces (6,) and forces in the cut balls (3 n,) that give the tree's generalized forces (18,)."""
        layout = self._constrained.layout
        # The actuators do not act on the passive joints: these give λ, and the legs what is left.
        cuts = self.kinematics.forward_factors.solve_transposed(torques.take(layout.passive))
        return torques.take(layout.legs) - cuts.dot(self.kinematics.chain_constraint_jacobian).take(layout.legs), cuts

    def _bias(self) -> tuple[FloatArray, FloatArray]:
        """Return the accelerations where no joint accelerates: of the gaps, J̇c v (3 n,), and of m (6,)."""
        if self._drift is None:
            kinematics, constrained = self.kinematics, self._constrained
            model, data = kinematics.model, kinematics.data
            pin.forwardKinematics(model, data, kinematics.q, self._v, kinematics.still)
            *points, platform = (
                pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
                for frame in (*constrained.frames, constrained.layout.platform_frame)
            )
            self._drift = constrained.linear_differences(points), platform
        return self._drift

    def _require_closed(self) -> None:
        """Raise unless q is closed and v keeps it so; looked at once for each q and v."""
        if not self._closed:
            require_closed(self.kinematics, self._v)
            self._closed = True

    def _require_closed_accelerations(self, a: FloatArray) -> None:
        """Raise unless the closures allow the accelerations a, to `AGREEMENT`."""
        kinematics, drift = self.kinematics, self._bias()[0]
        opening, size = largest(kinematics.constraint_jacobian.dot(a) + drift), largest(drift)
        # The rest of the size takes longer and is rarely needed.
        if opening > AGREEMENT * size and opening > AGREEMENT * (
            size
            + kinematics.gap_rate_bound(a)
            + kinematics.gap_rate_bound(self._v) ** 2 / self._constrained.layout.side
        ):
            expected = "joint accelerations that keep the loops closed"
            cause = "joint_accelerations makes them from the platform's, at the velocities v"
            raise ArgumentError("a", expected, f"gaps that open at {opening:.1e} m/s²", cause)


class ChainState(ConstrainedState):
    """The state of a `ClosedChain`, a `ConstrainedState` with the methods that a mounted chain has not.

    It has the chain's methods about rates, forces and dynamics, without q and v, and `joint_accelerations_of_legs` and
    `platform_acceleration` besides.
    """

    def configuration(self) -> Configuration:
        """Return the poses of m and of the middle platform's corners."""
        return Configuration.from_arrays(self._constrained.layout.geometry, *self.kinematics.configuration_arrays())

    def leg_lengths(self) -> FloatArray:
        """Return the leg lengths (6,) [m]."""
        return self._constrained.layout.leg_lengths(self.kinematics.q)

    def inverse_jacobian(self) -> FloatArray:
        """Return J_f, which maps the platform's twist to the leg rates, shape (6, 6)."""
        return np.asarray(self.kinematics.velocities_of_twists()[self._constrained.layout.legs])

    def joint_velocities(self, twist: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints (18,) for a twist (6,) of m."""
        return np.asarray(self.kinematics.velocities_of_twists() @ read_vector(twist, "twist", 6))

    def joint_rates(self, leg_rates: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints (18,) for rates of the six legs (6,)."""
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
        kinematics, wanted = self.kinematics, read_vector(acceleration, "acceleration", 6)
        self._require_closed()
        gaps, platform = self._bias()
        return kinematics.inverse_factors.solve(kinematics.in_one_unit(wanted - platform, -gaps))

    def joint_accelerations_of_legs(self, leg_accelerations: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (18,) for those of the legs (6,) [m/s²]."""
        wanted = read_vector(leg_accelerations, "leg_accelerations", 6)
        self._require_closed()
        a = self.kinematics.velocities_of_legs(wanted)
        a[self._constrained.layout.passive] -= self.kinematics.forward_factors.solve(self._bias()[0])
        return a

    def platform_acceleration(self, a: npt.ArrayLike) -> FloatArray:
        """Return the time derivative of the twist of m (6,) [m/s², rad/s²] for joint accelerations (nv,)."""
        return np.asarray(
            self.kinematics.platform_jacobian @ read_vector(a, "a", self._constrained.model.nv) + self._bias()[1]
        )

    def natural_frequencies(self, stiffness: npt.ArrayLike) -> NaturalFrequencies:
        """Return the vibrations Λ ẍ + K x = 0 on elastic legs, of a stiffness K (6, 6) as of `spm_pin.stiffness`."""
        require_closed(self.kinematics)
        matrix, x = read_stiffness(stiffness, single=True), self.kinematics.velocities_of_twists()
        expected = "a symmetric matrix, positive definite"
        try:
            squares, modes = eigh(matrix, x.T @ mass_matrix(self.kinematics) @ x)
        except LinAlgError as error:
            raise ArgumentError("stiffness", expected, str(error)) from error
        if squares[0] <= 0.0:
            raise ArgumentError("stiffness", expected, f"a least ω² of {squares[0]:g} 1/s²")
        return NaturalFrequencies(np.sqrt(squares) / (2.0 * math.pi), modes.T)

    def platform_dynamics(self) -> PlatformDynamics:
        """Return the equations of motion at the terminal platform."""
        self._require_closed()
        kinematics, v = self.kinematics, self._v
        model, data, q = kinematics.model, kinematics.data, kinematics.q
        x = kinematics.velocities_of_twists()
        twist = kinematics.platform_jacobian @ v
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        *points, platform = (
            pin.getFrameJacobianTimeVariation(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            for frame in (*self._constrained.frames, self._constrained.layout.platform_frame)
        )
        # K Ẋ = -K̇ X.
        rates = kinematics.in_one_unit(platform, self._constrained.linear_differences(points))
        x_rate = -kinematics.inverse_factors.solve(rates @ x)
        mass = mass_matrix(kinematics)
        coriolis = x.T @ (mass @ x_rate + pin.computeCoriolisMatrix(model, data, q, v) @ x)
        reflected = x.T @ mass @ x
        gravity = x.T @ pin.computeGeneralizedGravity(model, data, q)
        return PlatformDynamics(0.5 * (reflected + reflected.T), coriolis, coriolis @ twist, gravity)

    def _holding_forces(self, wrench: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        return self._balance(-(self.kinematics.platform_jacobian.T @ read_vector(wrench, "wrench", 6)))
