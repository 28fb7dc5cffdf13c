"""The methods of `ClosedChain` that know masses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.multibody.batches import over_batch
from spm_pin.multibody.chain_kinematics import ChainKinematics
from spm_pin.multibody.closures import Workspace
from spm_pin.multibody.dynamics import (
    Energy,
    PlatformDynamics,
    accelerations_for,
    balanced_legs,
    energy_of,
    platform_dynamics,
    require_closed,
    require_closed_accelerations,
    require_constrained,
    tree_torques,
    wrench_torques,
)
from spm_pin.multibody.velocity import Linearization

__all__ = ["ChainDynamics", "WrenchLike", "read_gains", "read_wrenches"]

WrenchLike = npt.ArrayLike | Mapping[str, npt.ArrayLike] | None


class ChainDynamics(ChainKinematics):
    """What a `ClosedChain` does under forces; see there.

    Leading axes of q, v, a, forces and wrenches broadcast. Gravity is that of `ClosedChain.model`.
    """

    def forward_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        forces: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        gains: tuple[float, float] | None = None,
        workspace: Workspace | None = None,
    ) -> FloatArray:
        """Return the accelerations of all joints under leg forces, gravity and wrenches.

        Parameters
        ----------
        q : array_like, shape (..., 18)
            Joint values.
        v : array_like, shape (..., 18)
            Joint velocities [rad/s, m/s].
        forces : array_like, shape (..., 6)
            Of the actuators of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [N]; positive pushes, to extend the leg.
        wrench : array_like, shape (..., 6), or mapping of str to such, optional
            (f, m) [N, N m] onto the terminal platform at o; or several, each onto the link or frame of that name, at
            its origin. In the axes of {B}.
        gains : pair of float, optional
            (kp, kd) [1/s², 1/s], not negative, after Baumgarte: open gaps e then obey ë + kd ė + kp e = 0, for those
            who integrate by themselves. Without, q and v must be closed, and the accelerations keep them so.

        Returns
        -------
        ndarray, shape (..., 18)
            Joint accelerations [rad/s², m/s²].

        Raises
        ------
        ArgumentError
            If an argument is malformed, v opens the loops, or a ball joint's middle angle is ±90°.
        ClosureError
            If q is open.
        SingularConfigurationError
            At a constraint singularity. Inverse and forward singularities are no obstacle.
        """
        given = read_gains(gains)
        own = self._constraints.workspace(workspace)
        frames, wrenches = self._wrenches(wrench)
        side = self._placement.geometry.middle_side

        def member(q: FloatArray, v: FloatArray, f: FloatArray, w: FloatArray) -> tuple[FloatArray]:
            linearization = Linearization.at(q, self._placement, self._constraints, own)
            require_constrained(linearization.scaled_closures())
            if given is None:
                require_closed(self._constraints.gaps(own), linearization.closures, v, side)
            torques = wrench_torques(self._model, zip(frames, w.reshape(-1, 6), strict=True), own)
            torques[self._placement.legs] += f
            return (self._constraints.accelerations(q, v, torques, given or (0.0, 0.0), own),)

        states = self._states(q=q, v=v)
        force = real_array(forces, "forces", (6,), "of the six legs in newtons")
        return over_batch(member, ((18,),), **states, forces=force, wrench=wrenches)[0]

    def inverse_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        a: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        workspace: Workspace | None = None,
    ) -> FloatArray:
        """Return the leg forces of a motion under gravity, inertia and wrenches.

        Parameters
        ----------
        q, v, a : array_like, shape (..., 18)
            Joint values, velocities and accelerations of a closed mechanism.
        wrench
            As in `forward_dynamics`.

        Returns
        -------
        ndarray, shape (..., 6)
            Of the actuators [N]; positive pushes, to extend the leg. At rest, with the weights of all bodies:
            `leg_forces` knows the wrench alone.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v or a opens the loops, or a ball joint's middle angle is ±90°.
        ClosureError
            If q is open.
        SingularConfigurationError
            At a forward or a constraint singularity.
        """
        own = self._constraints.workspace(workspace)
        frames, wrenches = self._wrenches(wrench)
        side = self._placement.geometry.middle_side

        def member(q: FloatArray, v: FloatArray, a: FloatArray, w: FloatArray) -> tuple[FloatArray]:
            linearization = Linearization.at(q, self._placement, self._constraints, own)
            require_closed(self._constraints.gaps(own), linearization.closures, v, side)
            torques = tree_torques(self._model, q, v, a, zip(frames, w.reshape(-1, 6), strict=True), own)
            drift = self._constraints.drift(q, v, own)
            require_closed_accelerations(linearization.closures, drift, v, a, side)
            return (balanced_legs(linearization, torques),)

        return over_batch(member, ((6,),), **self._states(q=q, v=v, a=a), wrench=wrenches)[0]

    def joint_accelerations(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        acceleration: npt.ArrayLike,
        *,
        workspace: Workspace | None = None,
    ) -> FloatArray:
        """Return the accelerations of all joints (..., 18) for one of the terminal platform.

        Parameters
        ----------
        q, v : array_like, shape (..., 18)
            Joint values and velocities of a closed mechanism, as of `joint_velocities`.
        acceleration : array_like, shape (..., 6)
            The time derivative of the twist (v, ω) of m at o: of the point o [m/s²], and angular [rad/s²], in {B}.

        Raises
        ------
        ArgumentError, ClosureError
            As `inverse_dynamics`.
        SingularConfigurationError
            At an inverse or a constraint singularity.
        """
        own = self._constraints.workspace(workspace)
        placement = self._placement
        wanted = real_array(acceleration, "acceleration", (6,), "of o in m/s², angular in rad/s², in {B}")

        def member(q: FloatArray, v: FloatArray, wanted: FloatArray) -> tuple[FloatArray]:
            linearization = Linearization.at(q, placement, self._constraints, own)
            require_closed(self._constraints.gaps(own), linearization.closures, v, placement.geometry.middle_side)
            drift = self._constraints.drift(q, v, own)
            at = pin.getFrameClassicalAcceleration(self._model, own.data, placement.platform, pin.LOCAL_WORLD_ALIGNED)
            return (accelerations_for(linearization, at.vector, drift, wanted),)

        return over_batch(member, ((18,),), **self._states(q=q, v=v), acceleration=wanted)[0]

    def platform_dynamics(
        self, q: npt.ArrayLike, v: npt.ArrayLike, *, workspace: Workspace | None = None
    ) -> PlatformDynamics:
        """Return the equations of motion at the terminal platform, of all bodies' masses.

        Parameters
        ----------
        q, v : array_like, shape (..., 18)
            Joint values and velocities of a closed mechanism.

        Returns
        -------
        PlatformDynamics
            mass Λ, coriolis C, bias C t and gravity G, with Λ ṫ + C t + G = J_fᵀ f + w.

        Raises
        ------
        ArgumentError, ClosureError
            As `inverse_dynamics`.
        SingularConfigurationError
            At an inverse or a constraint singularity: the platform's twist is no coordinate there.
        """
        own = self._constraints.workspace(workspace)
        side = self._placement.geometry.middle_side

        def member(q: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
            gap, jacobian = self._constraints.evaluate(q, own)
            require_closed(gap, jacobian, v, side)
            found = platform_dynamics(q, v, self._placement, self._constraints, own)
            return found.mass, found.coriolis, found.bias, found.gravity

        return PlatformDynamics(*over_batch(member, ((6, 6), (6, 6), (6,), (6,)), **self._states(q=q, v=v)))

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike, *, workspace: Workspace | None = None) -> Energy:
        """Return the kinetic and the potential energy [J] of all bodies, closed or not; floats for a single q.

        Parameters
        ----------
        q, v : array_like, shape (..., 18)
            Joint values and velocities.
        """
        own = self._constraints.workspace(workspace)
        found = over_batch(lambda q, v: energy_of(self._model, q, v, own), ((), ()), **self._states(q=q, v=v))
        return Energy(*(float(part) if part.ndim == 0 else part for part in found))

    def _states(self, **given: npt.ArrayLike) -> dict[str, FloatArray]:
        """Read joint values under the name q, anything else as their rates."""
        meaning = "rates of the joints in Pinocchio's order"
        return {
            name: self._placement.checked(value) if name == "q" else real_array(value, name, (self._model.nv,), meaning)
            for name, value in given.items()
        }

    def _wrenches(self, wrench: WrenchLike) -> tuple[list[int], FloatArray]:
        return read_wrenches(self._model, wrench, self._prefix + "terminal_platform")


def read_wrenches(model: Any, wrench: WrenchLike, platform: str) -> tuple[list[int], FloatArray]:
    """Return the frames that wrenches act onto, and these side by side, shape (..., 6 n)."""
    named = wrench if isinstance(wrench, Mapping) else {} if wrench is None else {platform: wrench}
    unknown = [name for name in named if not model.existFrame(name)]
    if unknown:
        cause = "The names of links, with the prefix"
        raise ArgumentError("wrench", "frames of the model", ", ".join(map(repr, unknown)), cause)
    meaning = "(f, m) in N and N m in the axes of {B}"
    arrays = [real_array(value, "wrench", (6,), meaning) for value in named.values()]
    try:
        spread = np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise ArgumentError("wrench", "leading axes that broadcast", f"shapes {shapes}") from None
    together = np.concatenate(spread, axis=-1) if spread else np.empty((0,))
    return [int(model.getFrameId(name)) for name in named], together


def read_gains(gains: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return the gains of a drift control, checked."""
    if gains is None:
        return None
    array = real_array(gains, "gains", (2,), "kp in 1/s² and kd in 1/s")
    if array.ndim != 1 or (array < 0.0).any():
        raise ArgumentError("gains", "a pair (kp, kd), not negative", repr(gains))
    return float(array[0]), float(array[1])
