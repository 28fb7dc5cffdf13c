"""The mechanism as a Pinocchio model whose loops are closed by constraints."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.description.closures import Closure, read_closures
from spm_pin.description.expand import expand
from spm_pin.description.locate import URDF, description_file
from spm_pin.description.srdf import srdf_text
from spm_pin.description.tree import JOINTS
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.loading import read_urdf
from spm_pin.multibody.newton import close
from spm_pin.multibody.placement import Placement, one_vector
from spm_pin.multibody.statics import held_forces
from spm_pin.multibody.velocity import Linearization, SingularValues

__all__ = ["ClosedChain"]


class ClosedChain:
    """The spanning tree of the description in Pinocchio, and the closures that make it the mechanism; read-only.

    Made by `from_urdf`. {B} is the link `base` and Pinocchio's universe. All methods take a single q, joint values
    [rad, m] in the order of `joint_names`, and raise `ArgumentError` if it has another shape, is not finite, or gives
    a leg a negative length. They keep nothing between calls: each makes its own `pinocchio.Data`, unless it is handed
    a `workspace`, which saves time.

    Parameters
    ----------
    urdf : str
        Text of the description expanded for `geometry` and `prefix`; not checked here.
    geometry : Geometry
        Its dimensions, and the limits that set its zero.
    prefix : str
        Before the name of every link and joint.
    """

    def __init__(self, urdf: str, geometry: Geometry, *, prefix: str = "") -> None:
        self._urdf = urdf
        self._geometry = geometry
        self._prefix = prefix
        self._model = pin.buildModelFromXML(urdf)
        self._closures = read_closures(prefix=prefix)
        self._constraints = ClosureConstraints(self._model, self._closures)
        self._placement = Placement(self._model, geometry, prefix)

    @classmethod
    def from_urdf(
        cls, path: str | Path | None = None, geometry: Geometry | None = None, *, prefix: str = ""
    ) -> ClosedChain:
        """Make a chain from the package's description, or from a URDF file expanded from it.

        Parameters
        ----------
        path : str or Path, optional
            A URDF of the description's tree, perhaps with other inertias, shapes and limits. The closures are the
            description's. By default the description itself, expanded for `geometry`.
        geometry : Geometry, optional
            The dimensions. By default those of the file, without a file the paper's.
        prefix : str
            Before the name of every link and joint: put there, or found in the file.

        Raises
        ------
        DescriptionError
            If the file cannot be read or is not the description's tree, or `prefix` cannot begin a name.
        GeometryError
            If the dimensions of the file are not those of `geometry`.
        """
        if geometry is not None and not isinstance(geometry, Geometry):
            raise ArgumentError("geometry", "a Geometry", type(geometry).__name__)
        if path is not None:
            return cls(*read_urdf(Path(path), geometry, prefix), prefix=prefix)
        paper = Geometry.paper()
        geometry = geometry or paper
        shipped = geometry == paper and prefix == ""
        text = description_file(URDF).read_text(encoding="utf-8") if shipped else expand(geometry, prefix=prefix)
        return cls(text, geometry, prefix=prefix)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return _rebuilt, (self._urdf, self._geometry, self._prefix)

    def __repr__(self) -> str:
        named = f" {self._prefix!r}" if self._prefix else ""
        return f"<ClosedChain{named}: {self._model.nq} joints, {len(self._closures)} closures, {self._geometry}>"

    @property
    def model(self) -> Any:
        """The spanning tree, a `pinocchio.Model`; do not change it."""
        return self._model

    @property
    def closures(self) -> tuple[Closure, ...]:
        """Where the tree is closed; the order of all that counts closures."""
        return self._closures

    @property
    def geometry(self) -> Geometry:
        """Dimensions and leg limits."""
        return self._geometry

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        order = np.argsort(self._placement.indices(*JOINTS))
        return tuple(self._prefix + JOINTS[i] for i in order)

    @property
    def leg_indices(self) -> npt.NDArray[np.intp]:
        """Where the slides of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 are in q, shape (6,)."""
        return self._placement.legs.copy()

    def joint_indices(self, *names: str) -> npt.NDArray[np.intp]:
        """Return where joints, named as in the URDF, are in q and in joint velocities, shape (n,).

        Raises
        ------
        ArgumentError
            If the chain has no joint of such a name.
        """
        return self._placement.indices(*(name.removeprefix(self._prefix) for name in names))

    @cached_property
    def visual_model(self) -> Any:
        """What is seen, a `pinocchio.GeometryModel`."""
        return pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.VISUAL)

    @cached_property
    def collision_model(self) -> Any:
        """What collides, a `pinocchio.GeometryModel`; the pairs leave out what touches by design."""
        shapes = pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.COLLISION)
        shapes.addAllCollisionPairs()
        pin.removeCollisionPairsFromXML(self._model, shapes, srdf_text({}, prefix=self._prefix))
        return shapes

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of the tree, which knows nothing of the closures."""
        return pin.RobotWrapper(self._model, self.collision_model, self.visual_model)

    def workspace(self) -> Workspace:
        """Return memory to hand to methods called often, one per thread."""
        return self._constraints.workspace()

    def place(self, configuration: Configuration) -> FloatArray:
        """Return q of a configuration, in closed form.

        Parameters
        ----------
        configuration : Configuration
            A single state that exists. Its leg limits play no part.

        Returns
        -------
        ndarray, shape (18,)
            Angles in [-π, π]. The tree is closed to rounding, or as far as the configuration is.

        Raises
        ------
        ArgumentError
            If `configuration` is a batch, does not exist, or is not closed to `AGREEMENT`.
        GeometryError
            If it has other dimensions than the chain.
        """
        return self._placement.place(configuration)

    def configuration(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> Configuration:
        """Return the configuration in q (18,): the poses of m and of the middle platform's corners.

        If q is not closed, neither is the configuration, and its leg lengths are those between its points, not
        those of q.
        """
        return self._placement.configuration(self._placement.checked(q), self._constraints.workspace(workspace).data)

    def leg_lengths(self, q: npt.ArrayLike) -> FloatArray:
        """Return r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m] of the slides in q (18,), shape (6,)."""
        return self._placement.leg_lengths(self._placement.checked(q))

    def with_leg_lengths(self, q: npt.ArrayLike, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return a copy of q (18,) with other leg lengths (6,) [m], all other joints as they are."""
        changed = self._placement.checked(q)
        lengths = one_vector(leg_lengths, "leg_lengths", 6, "leg lengths in metres")
        changed[self._placement.legs] = lengths - self._placement.home
        return self._placement.checked(changed)

    def closure_gap(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return how far the closures are open: from `frame_a` to `frame_b` of each, in {B} [m], shape (4, 3)."""
        return self._evaluate(q, workspace)[0]

    def constraint_jacobian(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (12, 18), three rows per closure.

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
        q : array_like, shape (18,)
            Where to start.
        hold_legs : bool
            Keep the leg lengths of q, and move the passive joints alone: forward displacement, to the assembly mode
            that q is near to. Otherwise all joints move, as little as closes the loops to first order, slides
            measured in units of the middle platform's side.
        max_iterations : int
            Number of steps allowed. Steps are halved where a full one does not shrink the gaps.

        Returns
        -------
        ndarray, shape (18,)
            Closed to rounding. Angles are not reduced to one turn.

        Raises
        ------
        ArgumentError
            If an argument is malformed.
        ClosureError
            If the loops do not close from there: with the largest gap and the number of steps.
        """
        if isinstance(max_iterations, bool) or not isinstance(max_iterations, int) or max_iterations < 0:
            raise ArgumentError("max_iterations", "a number of steps", repr(max_iterations))
        start = self._placement.checked(q)
        own = self._constraints.workspace(workspace)
        return close(start, self._placement, self._constraints, own, hold_legs, max_iterations)

    def inverse_jacobian(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return J_f, which maps the platform's twist to the leg rates.

        Parameters
        ----------
        q : array_like, shape (18,)
            Joint values of a closed configuration.

        Returns
        -------
        ndarray, shape (6, 6)
            Rows r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; columns the twist (v, ω): velocity of o [m/s], angular velocity
            of m [rad/s], both in {B}.

        Raises
        ------
        ArgumentError
            If `q` is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At an inverse or a constraint singularity; see `spm_pin.multibody.velocity.SINGULAR`.
        """
        return self._linearization(q, workspace).joint_velocities()[self._placement.legs]

    def joint_velocities(
        self, q: npt.ArrayLike, twist: npt.ArrayLike, *, workspace: Workspace | None = None
    ) -> FloatArray:
        """Return the rates of all joints (18,) [rad/s, m/s], in the order of `joint_names`, for a twist of m.

        The twist (6,) and the errors are those of `inverse_jacobian`.
        """
        value = one_vector(twist, "twist", 6, "(v, ω) at o in {B} in m/s and rad/s")
        return np.asarray(self._linearization(q, workspace).joint_velocities() @ value)

    def leg_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the actuator forces that hold a wrench applied onto the terminal platform.

        Parameters
        ----------
        q : array_like, shape (18,)
            Joint values of a closed configuration.
        wrench : array_like, shape (6,)
            (f, m): force [N] and moment [N m] at o, in {B}, applied onto m from outside.

        Returns
        -------
        ndarray, shape (6,)
            Of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [N]; positive pushes, to extend the leg. Weights and
            friction are left out.

        Raises
        ------
        ArgumentError
            If an argument is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At a forward or a constraint singularity; see `spm_pin.multibody.velocity.SINGULAR`.
        """
        return self._forces(q, wrench, workspace)[0]

    def cut_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the forces in the ball joints where the tree is cut, shape (4, 3) [N] in {B}.

        Per closure, what the middle platform (`frame_a`) exerts onto the tip of the leg (`frame_b`); the leg exerts
        the opposite onto the middle platform. Arguments and errors are those of `leg_forces`.
        """
        return self._forces(q, wrench, workspace)[1]

    def singular_values(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> SingularValues:
        """Return how near q (18,) is to each kind of singularity, without raising `SingularConfigurationError`."""
        return self._linearization(q, workspace).singular_values()

    def _evaluate(self, q: npt.ArrayLike, workspace: Workspace | None) -> tuple[FloatArray, FloatArray]:
        return self._constraints.evaluate(self._placement.checked(q), self._constraints.workspace(workspace))

    def _linearization(self, q: npt.ArrayLike, workspace: Workspace | None) -> Linearization:
        own = self._constraints.workspace(workspace)
        return Linearization.at(self._placement.checked(q), self._placement, self._constraints, own)

    def _forces(
        self, q: npt.ArrayLike, wrench: npt.ArrayLike, workspace: Workspace | None
    ) -> tuple[FloatArray, FloatArray]:
        load = one_vector(wrench, "wrench", 6, "(f, m) at o in {B} in N and N m")
        return held_forces(self._linearization(q, workspace), load)


def _rebuilt(urdf: str, geometry: Geometry, prefix: str) -> ClosedChain:
    return ClosedChain(urdf, geometry, prefix=prefix)
