"""The methods of `ClosedChain` that go from one closed q to another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.multibody.batches import located, over_batch
from spm_pin.multibody.chain_simulation import ChainSimulation
from spm_pin.multibody.closures import Workspace
from spm_pin.multibody.dynamics import accelerations_for, balanced_legs, require_closed, tree_torques
from spm_pin.multibody.follow import Guide, legs_to, pose_to
from spm_pin.multibody.platform_path import PlatformMotion, PlatformPath, increasing_times
from spm_pin.multibody.trajectory import JointTrajectory
from spm_pin.multibody.velocity import Linearization

__all__ = ["ChainPaths"]


class ChainPaths(ChainSimulation):
    """Where a `ClosedChain` can go; see there."""

    def forward_kinematics(
        self, leg_lengths: npt.ArrayLike, near: npt.ArrayLike | None = None, *, workspace: Workspace | None = None
    ) -> FloatArray:
        """Return all joints of six leg lengths: the passive ones from the actuated ones.

        Parameters
        ----------
        leg_lengths : array_like, shape (..., 6)
            r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m].
        near : array_like, shape (18,), optional
            A closed q to start from; by default the home. The mechanism goes from there to the first member by
            changing all legs in proportion, and on to each member from the one before, in C order. Legs that change
            little take one or two steps of Newton's method.

        Returns
        -------
        ndarray, shape (..., 18)
            Closed to rounding, in the assembly mode that the mechanism comes to. Angles are continuous along the way,
            and not reduced to one turn.

        Raises
        ------
        ArgumentError
            If an argument is malformed, or a ball joint comes to a middle angle of ±90°.
        ClosureError
            If `near` is open, or the way does not lead to a member: with how far it leads.
        SingularConfigurationError
            If `near` or a member is at a forward or a constraint singularity.
        """
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "r_b1 to r_c3 in metres")
        if (lengths < 0.0).any():
            raise ArgumentError("leg_lengths", "no negative length", f"{lengths.min():g} m")
        guide, q = self._guide(near, workspace)
        return _one_after_the_other(lambda q, legs: legs_to(q, legs, guide), q, (lengths,), lengths.shape[:-1])

    def inverse_kinematics(
        self, pose: PoseLike, near: npt.ArrayLike, *, workspace: Workspace | None = None
    ) -> FloatArray:
        """Return all joints of a pose of the terminal platform, in the branch that the mechanism comes to.

        Parameters
        ----------
        pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
            Of {m} in {B}.
        near : array_like, shape (18,)
            A closed q to start from. The platform moves and turns from there to the first member in proportion, and
            on to each member from the one before, in C order.

        Returns
        -------
        ndarray, shape (..., 18)
            As of `complete`. Leg limits play no part.

        Raises
        ------
        ArgumentError, PoseError
            If an argument is malformed, or a ball joint comes to a middle angle of ±90°.
        ClosureError
            If `near` is open, or the way does not lead to a member: with how far it leads.
        SingularConfigurationError
            If `near` or a member is at an inverse or a constraint singularity.
        """
        transform = as_rigid_transform(pose)
        guide, q = self._guide(near, workspace)
        given = transform.rotation.as_matrix(), transform.translation
        return _one_after_the_other(lambda q, r, t: pose_to(q, r, t, guide), q, given, transform.shape)

    def joint_rates(
        self, q: npt.ArrayLike, leg_rates: npt.ArrayLike, *, workspace: Workspace | None = None
    ) -> FloatArray:
        """Return the velocities of all joints for rates of the six legs; the other way is `joint_velocities`.

        Parameters
        ----------
        q : array_like, shape (..., 18)
            Joint values of a closed mechanism.
        leg_rates : array_like, shape (..., 6)
            [m/s]. Leading axes broadcast.

        Returns
        -------
        ndarray, shape (..., 18)
            [rad/s, m/s].

        Raises
        ------
        ArgumentError
            If an argument is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At a forward or a constraint singularity.
        """
        own = self._constraints.workspace(workspace)
        rates = real_array(leg_rates, "leg_rates", (6,), "of r_b1 to r_c3 in m/s")

        def member(q: FloatArray, rates: FloatArray) -> tuple[FloatArray]:
            linear = Linearization.at(q, self._placement, self._constraints, own)
            inverse = linear.regular_inverse(linear.held(), "forward")
            return (linear.columns @ (inverse[:, :6] @ rates) / linear.side,)

        return over_batch(member, ((18,),), **self._states(q=q), leg_rates=rates)[0]

    def joint_trajectory(
        self,
        path: Callable[[float], PlatformMotion],
        times: npt.ArrayLike,
        near: npt.ArrayLike,
        *,
        workspace: Workspace | None = None,
    ) -> JointTrajectory:
        """Return the motion of all joints for one of the platform, at any rate.

        Parameters
        ----------
        path : PlatformPath, or callable
            Takes a time [s], and returns pose, twist and acceleration of the terminal platform.
        times : array_like, shape (n,)
            Increasing [s].
        near : array_like, shape (18,)
            A closed q to start from, as of `reach`: in the branch wanted, near the path's begin.

        Returns
        -------
        JointTrajectory
            With the leg forces of the motion under gravity.

        Raises
        ------
        ArgumentError, PoseError, ClosureError
            As `reach`.
        SingularConfigurationError
            If the path meets a singularity; `index` says at which of the times.
        """
        moments = increasing_times(times)
        if not callable(path):
            raise ArgumentError("path", "a PlatformPath or another function of time", type(path).__name__)
        guide, q = self._guide(near, workspace)
        rows: list[tuple[FloatArray, ...]] = []
        # All at once where that is known to be allowed.
        motions = zip(*path(moments), strict=True) if isinstance(path, PlatformPath) else map(path, moments.tolist())
        for k, motion in enumerate(motions):
            try:
                rows.append(self._moving(q, PlatformMotion(*motion), guide))
            except (ArgumentError, ClosureError, SingularConfigurationError) as error:
                raise located(error, (k,)) from error
            q = rows[-1][0]
        columns = (np.array(column).reshape(moments.size, -1) for column in zip(*rows, strict=True))
        return JointTrajectory(self.joint_names, moments, *columns)

    def _moving(self, q: FloatArray, motion: PlatformMotion, guide: Guide) -> tuple[FloatArray, ...]:
        """Return q, v, a and the actuators' forces of a motion of the platform."""
        transform = as_rigid_transform(motion.pose, "path")
        twist, acceleration = (
            real_array(value, "path", (6,), f"{name} of the platform")
            for value, name in zip(motion[1:], ("twist", "acceleration"), strict=True)
        )
        q = pose_to(q, transform.rotation.as_matrix(), transform.translation, guide)
        linear, _ = guide.at(q)
        v = linear.joint_velocities() @ twist
        drift = self._constraints.drift(q, v, guide.workspace)
        platform = guide.placement.platform
        at = pin.getFrameClassicalAcceleration(self._model, guide.workspace.data, platform, pin.LOCAL_WORLD_ALIGNED)
        a = accelerations_for(linear, at.vector, drift, acceleration)
        efforts = np.zeros(q.size)
        efforts[guide.placement.legs] = balanced_legs(linear, tree_torques(self._model, q, v, a, (), guide.workspace))
        return q, v, a, efforts

    def _guide(self, near: npt.ArrayLike | None, workspace: Workspace | None) -> tuple[Guide, FloatArray]:
        own = self._constraints.workspace(workspace)
        q = np.zeros(self._model.nq) if near is None else self._placement.checked(near, "near", single=True)
        gap, jacobian = self._constraints.evaluate(q, own)
        require_closed(gap, jacobian, np.zeros(q.size), self._placement.geometry.middle_side)
        return Guide(self._placement, self._constraints, own), q


def _one_after_the_other(
    function: Callable[..., FloatArray], q: FloatArray, given: tuple[FloatArray, ...], shape: tuple[int, ...]
) -> FloatArray:
    """Return `function(q, *member)` of each member, with q that of the one before."""
    found = np.empty((*shape, q.size))
    for index in np.ndindex(shape):
        try:
            q = function(q, *(array[index] for array in given))
        except (ArgumentError, ClosureError, SingularConfigurationError) as error:
            raise (located(error, index) if shape else error) from error
        found[index] = q
    return found
