"""The methods of `ClosedChain` that know lengths and rates, and the forces that are their duals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.description.tree import JOINTS
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.multibody.batches import over_batch
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.newton import close
from spm_pin.multibody.placement import Placement
from spm_pin.multibody.statics import held_forces
from spm_pin.multibody.velocity import Linearization, SingularValues

__all__ = ["ChainKinematics"]


class ChainKinematics:
    """Where a `ClosedChain` is and how it can move; see there."""

    _model: Any
    _prefix: str
    _placement: Placement
    _constraints: ClosureConstraints

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        order = np.argsort(self._placement.indices(*JOINTS))
        return tuple(self._prefix + JOINTS[i] for i in order)

    def workspace(self) -> Workspace:
        """Return memory to hand to methods called often, one per thread."""
        return self._constraints.workspace()

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return q of a configuration, in closed form.

        Parameters
        ----------
        configuration : Configuration
            One state or a batch (...); all exist. Their leg limits play no part.

        Returns
        -------
        ndarray, shape (..., 18)
            Angles in [-π, π]. The tree is closed to rounding, or as far as the configuration is.

        Raises
        ------
        ArgumentError
            If a member does not exist, or is not closed to `AGREEMENT`.
        GeometryError
            If it has other dimensions than the chain.
        """
        return self._placement.joint_values(configuration)

    def configuration(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> Configuration:
        """Return the configuration in q (..., 18): the poses of m and of the middle platform's corners.

        If q is not closed, neither is the configuration, and its leg lengths are those between its points, not
        those of q.
        """
        data = self._constraints.workspace(workspace).data
        parts = over_batch(
            lambda q: self._placement.frames(q, data), ((3, 3), (3,), (3, 3)), q=self._placement.checked(q)
        )
        return Configuration.from_arrays(self._placement.geometry, *parts)

    def leg_lengths(self, q: npt.ArrayLike) -> FloatArray:
        """Return r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m] of the slides in q (..., 18), shape (..., 6)."""
        return self._placement.leg_lengths(self._placement.checked(q))

    def with_leg_lengths(self, q: npt.ArrayLike, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return a copy of q (..., 18) with other leg lengths (..., 6) [m], all other joints as they are.

        That opens the loops; `complete` keeps them closed.
        """
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "leg lengths in metres")
        slides = lengths - self._placement.home

        def member(q: FloatArray, slides: FloatArray) -> tuple[FloatArray]:
            changed = q.copy()
            changed[self._placement.legs] = slides
            return (changed,)

        given = {"q": self._placement.checked(q), "leg_lengths": slides}
        return self._placement.checked(over_batch(member, ((self._model.nq,),), **given)[0])

    def closure_gap(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return how far the closures are open: from `frame_a` to `frame_b` of each, in {B} [m], shape (..., 4, 3)."""
        return self._evaluate(q, workspace)[0]

    def constraint_jacobian(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (..., 12, 18), three rows per closure.

        Its transpose maps forces in {B} onto the closures' `frame_b`, with the opposite onto `frame_a`, to
        generalized forces. Exact at any q.
        """
        return self._evaluate(q, workspace)[1]

    def project(
        self,
        q: npt.ArrayLike,
        *,
        hold_legs: bool = False,
        max_iterations: int = 50,
        workspace: Workspace | None = None,
    ) -> FloatArray:
        """Close the loops from a q nearby, by Newton's method.

        Parameters
        ----------
        q : array_like, shape (..., 18)
            Where to start.
        hold_legs : bool
            Keep the leg lengths of q, and move the passive joints alone: forward displacement, to the assembly mode
            that q is near to. Otherwise all joints move, as little as closes the loops to first order, slides
            measured in units of the middle platform's side.
        max_iterations : int
            Number of steps allowed. Steps are halved where a full one does not shrink the gaps.

        Returns
        -------
        ndarray, shape (..., 18)
            Closed to rounding. Angles are not reduced to one turn.

        Raises
        ------
        ArgumentError
            If an argument is malformed.
        ClosureError
            If the loops of a member do not close from there: with the largest gap and the number of steps.
        """
        if isinstance(max_iterations, bool) or not isinstance(max_iterations, int) or max_iterations < 0:
            raise ArgumentError("max_iterations", "a number of steps", repr(max_iterations))
        start = self._placement.checked(q)
        own = self._constraints.workspace(workspace)
        return over_batch(
            lambda q: (close(q, self._placement, self._constraints, own, hold_legs, max_iterations),),
            ((self._model.nq,),),
            q=start,
        )[0]

    def inverse_jacobian(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return J_f, which maps the platform's twist to the leg rates.

        Parameters
        ----------
        q : array_like, shape (..., 18)
            Joint values of a closed configuration.

        Returns
        -------
        ndarray, shape (..., 6, 6)
            Rows r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; columns the twist (v, ω): velocity of o [m/s], angular velocity
            of m [rad/s], both in {B}.

        Raises
        ------
        ArgumentError
            If `q` is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At an inverse or a constraint singularity; see `spm_pin.multibody.velocity.SINGULAR`.
        """
        legs = self._placement.legs
        return self._over(q, workspace, lambda linear: (linear.joint_velocities()[legs],), ((6, 6),))[0]

    def joint_velocities(
        self, q: npt.ArrayLike, twist: npt.ArrayLike, *, workspace: Workspace | None = None
    ) -> FloatArray:
        """Return the rates of all joints (..., 18) [rad/s, m/s], in the order of `joint_names`, for a twist of m.

        The twist (..., 6) and the errors are those of `inverse_jacobian`; leading axes broadcast.
        """
        value = real_array(twist, "twist", (6,), "(v, ω) at o in {B} in m/s and rad/s")
        shapes = ((self._model.nv,),)
        return self._over(q, workspace, lambda linear, t: (linear.joint_velocities() @ t,), shapes, twist=value)[0]

    def leg_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the actuator forces that hold a wrench applied onto the terminal platform.

        Parameters
        ----------
        q : array_like, shape (..., 18)
            Joint values of a closed configuration.
        wrench : array_like, shape (..., 6)
            (f, m): force [N] and moment [N m] at o, in {B}, applied onto m from outside.

        Returns
        -------
        ndarray, shape (..., 6)
            Of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [N]; positive pushes, to extend the leg. Weights and
            friction are left out: `inverse_dynamics` has the weights.

        Raises
        ------
        ArgumentError
            If an argument is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At a forward or a constraint singularity; see `spm_pin.multibody.velocity.SINGULAR`.
        """
        return self._forces(q, wrench, workspace)[0]

    def cut_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the forces in the ball joints where the tree is cut, shape (..., 4, 3) [N] in {B}.

        Per closure, what the middle platform (`frame_a`) exerts onto the tip of the leg (`frame_b`); the leg exerts
        the opposite onto the middle platform. Arguments and errors are those of `leg_forces`.
        """
        return self._forces(q, wrench, workspace)[1]

    def singular_values(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> SingularValues:
        """Return how near q (..., 18) is to each kind of singularity, without raising `SingularConfigurationError`.

        Numbers for a single q, arrays (...) for a batch.
        """

        def member(linear: Linearization) -> tuple[float, ...]:
            found = linear.singular_values()
            return found.inverse, found.forward, found.constraint

        found = self._over(q, workspace, member, ((), (), ()))
        return SingularValues(*(float(value) if value.ndim == 0 else value for value in found))

    def _evaluate(self, q: npt.ArrayLike, workspace: Workspace | None) -> tuple[FloatArray, ...]:
        own, count = self._constraints.workspace(workspace), self._constraints.count
        shapes = ((count, 3), (3 * count, self._model.nv))
        return over_batch(lambda q: self._constraints.evaluate(q, own), shapes, q=self._placement.checked(q))

    def _over(
        self,
        q: npt.ArrayLike,
        workspace: Workspace | None,
        function: Callable[..., tuple[Any, ...]],
        shapes: tuple[tuple[int, ...], ...],
        **more: FloatArray,
    ) -> tuple[FloatArray, ...]:
        """Call a function of the linearization at each q, and of vectors."""
        own = self._constraints.workspace(workspace)

        def member(q: FloatArray, *vectors: FloatArray) -> tuple[Any, ...]:
            return function(Linearization.at(q, self._placement, self._constraints, own), *vectors)

        return over_batch(member, shapes, q=self._placement.checked(q), **more)

    def _forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike, workspace: Workspace | None) -> tuple[FloatArray, ...]:
        load = real_array(wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        return self._over(q, workspace, held_forces, ((6,), (self._constraints.count, 3)), wrench=load)
