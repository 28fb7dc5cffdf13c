"""The mechanism as a Pinocchio model whose loops are closed by constraints."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_physical
from spm_pin.description.closures import Closure
from spm_pin.description.paths import description_directory
from spm_pin.description.srdf import srdf_text
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, IntArray, broadcastable, first_offender, flag, whole_number
from spm_pin.mechanism.as_built import AsBuiltGeometry
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, Geometry
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.multibody.batched_methods import BatchedStates, ChainMethods
from spm_pin.multibody.closure_solvers import ContinuationSolver, project_to_closure
from spm_pin.multibody.constrained_model import ConstrainedModel
from spm_pin.multibody.constrained_state import ChainState
from spm_pin.multibody.dynamics import require_closed
from spm_pin.multibody.joint_layout import JointLayout
from spm_pin.multibody.loading import description_closures, read_description
from spm_pin.multibody.mounting import MountedChain, mount
from spm_pin.multibody.platform_path import PlatformMotion
from spm_pin.multibody.simulation import ForceFunction, Simulation, simulate
from spm_pin.multibody.trajectory import JointTrajectory, joint_trajectory
from spm_pin.multibody.vector_arguments import WrenchLike, read_vectors

__all__ = ["ClosedChain"]


class ClosedChain(ChainMethods):
    """The spanning tree of the description in Pinocchio, and the closures that make it the mechanism; read-only.

    Made by `from_urdf`. {B} is the link `base` and Pinocchio's universe. Methods take q, joint values [rad, m] in the
    order of `joint_names`, of one state or of a batch (..., 18), and raise `ArgumentError` if it has another shape, is
    not finite, or gives a leg a negative length. Leading axes of several arguments broadcast. Pinocchio answers one
    state at a time, so that a batch takes as long as its members. `state` computes several quantities of
    one q and v; methods in closed form, which say so, are for millions of states.

    The geometry may be that of a machine as built: leg lengths are then its readings, offsets included, and joint
    values zero at the home of the nominal machine, where its loops are open by about its errors.

    Wrenches are (f, m) [N, N m] onto the terminal platform at o in the axes of {B}, twists (v, ω) [m/s, rad/s] of it;
    legs are in the order r_b1, r_b2, r_b3, r_c1, r_c2, r_c3, and a positive leg force pushes, to extend the leg.
    Methods that use rates or forces raise `ArgumentError` where a ball joint's middle angle is ±90°, and
    `SingularConfigurationError` at the singularities they name; see `spm_pin.multibody.constrained_model.SINGULAR`.

    Parameters
    ----------
    urdf : str
        Text of the description expanded for `geometry` and `prefix`; not checked here.
    geometry : Geometry or AsBuiltGeometry
        Its dimensions, and the limits that set its zero.
    prefix : str
        Before the name of every link and joint.
    """

    def __init__(self, urdf: str, geometry: Geometry | AsBuiltGeometry, prefix: str = "") -> None:
        self._urdf, self._geometry, self._prefix = urdf, geometry, prefix
        self._model = pin.buildModelFromXML(urdf)
        self._layout = JointLayout(self._model, geometry, prefix)
        constrained = ConstrainedModel(self._model, self._layout, description_closures(geometry, prefix))
        self._states = BatchedStates(lambda: ChainState(constrained), self._layout.checked)

    @classmethod
    def from_urdf(
        cls,
        path: str | Path | None = None,
        geometry: Geometry | AsBuiltGeometry | None = None,
        *,
        prefix: str = "",
    ) -> ClosedChain:
        """Make a chain from the package's description, or from a URDF file expanded from it.

        A file at `path` has the description's tree, perhaps with other inertias, shapes and limits; the closures are
        the description's. `geometry` is by default that of the file, without a file the paper's; that of a machine as
        built, an AsBuiltGeometry, goes with a file that was written for it. `prefix` stands before the name of every
        link and joint. Raises `DescriptionError` if the file cannot be read or is another tree, its
        inertias are impossible or `prefix` cannot begin a name, and `GeometryError` if the dimensions of the file are
        not those of `geometry`.
        """
        return cls(*read_description(path, geometry, prefix), prefix)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return type(self), (self._urdf, self._geometry, self._prefix)

    def __repr__(self) -> str:
        named = f" {self._prefix!r}" if self._prefix else ""
        return f"<ClosedChain{named}: {self._model.nq} joints, {len(self.closures)} closures, {self._geometry}>"

    @property
    def model(self) -> Any:
        """The spanning tree, a `pinocchio.Model`; do not change it."""
        return self._model

    @property
    def closures(self) -> tuple[Closure, ...]:
        """The closures, in the order of all results per closure."""
        return self._states.constrained.closures

    @property
    def geometry(self) -> Any:
        """Dimensions and leg limits, a `Geometry` or an `AsBuiltGeometry`."""
        return self._geometry

    @property
    def prefix(self) -> str:
        """Before the name of every link and joint."""
        return self._prefix

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        return tuple(self._prefix + name for name in self._layout.names)

    @property
    def leg_indices(self) -> IntArray:
        """Indices of the legs' prismatic joints in q, shape (6,)."""
        return self._layout.legs.copy()

    def joint_indices(self, *names: str) -> IntArray:
        """Return the indices in q (n,) of joints named as in the URDF; raise `ArgumentError` for an unknown name."""
        return self._layout.indices(*(name.removeprefix(self._prefix) for name in names))

    @cached_property
    def visual_model(self) -> Any:
        """The visual shapes, a `pinocchio.GeometryModel`."""
        folder = str(description_directory())
        return pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.VISUAL, package_dirs=folder)

    @cached_property
    def collision_model(self) -> Any:
        """The collision shapes, a `pinocchio.GeometryModel`; the pairs leave out what touches by design."""
        shapes = pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.COLLISION)
        shapes.addAllCollisionPairs()
        pin.removeCollisionPairsFromXML(self._model, shapes, srdf_text({}, prefix=self._prefix))
        return shapes

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of the tree; it has no closures."""
        return pin.RobotWrapper(self._model, self.collision_model, self.visual_model)

    def mounted_on(self, other: Any, frame: str, placement: Any = None) -> MountedChain:
        """Return this chain carried by another robot, as an arm carries a tool, in one model with its loops closed.

        `other` is a pinocchio.Model or pinocchio.RobotWrapper whose base stays where it is, `frame` one of its frames
        such as `tool0`, `placement` the pinocchio.SE3 of {B} in it, by default the identity. Raises `ArgumentError` if
        one of them is malformed, or both robots have a link, joint or frame of the same name: `from_urdf` takes a
        prefix.
        """
        return mount(self, other, frame, placement, carried=False)

    def carrying(self, other: Any, frame: str = "terminal_platform", placement: Any = None) -> MountedChain:
        """Return this chain with another robot on it, whose universe is fixed to a frame of the chain.

        `frame` is named without prefix, `placement` is that of the other robot's universe in it; else as `mounted_on`.
        """
        return mount(self, other, f"{self._prefix}{frame}", placement, carried=True)

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ChainState:
        """Return the state of joint values q (18,) and velocities v (18,), by default at rest.

        Its methods are those of the chain without q and v, and share what they compute; `state.update(q, v)` moves it
        on. In a control loop it saves reading and computing the same twice.
        """
        return ChainState(self._states.constrained).update(q, v)

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return q (..., 18) of a configuration, in closed form and vectorised: angles in [-π, π].

        Its leg limits play no part. The tree is closed to rounding, or as far as the configuration is. Raises
        `ArgumentError` if a member does not exist or is not closed to 1e-9 of the middle platform's side, and
        `GeometryError` if the dimensions are not the chain's, those of a machine as built with all its errors.
        """
        return self._layout.joint_values(configuration)

    def configuration(self, q: npt.ArrayLike) -> Configuration:
        """Return the configuration in q (..., 18): the poses of m and of the middle platform's corners.

        If q is not closed, neither is the configuration, and its leg lengths are those between its points, not
        those of q.
        """
        arrays = self._states.over(ChainState.pose_arrays, ((3, 3), (3,), (3, 3)), q)
        return Configuration.from_arrays(self._geometry, *arrays)

    def leg_lengths(self, q: npt.ArrayLike) -> FloatArray:
        """Return the leg lengths [m] of the slides in q (..., 18), shape (..., 6)."""
        return self._layout.leg_lengths(self._layout.checked(q))

    def with_leg_lengths(self, q: npt.ArrayLike, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return a copy of q (..., 18) with other leg lengths (..., 6) [m], all other joints as they are.

        That opens the loops; `forward_kinematics` keeps them closed.
        """
        joints, lengths = self._layout.checked(q), read_vectors(leg_lengths, "leg_lengths", 6)
        shape = broadcastable("leg_lengths", lengths.shape[:-1], "q", joints.shape[:-1])
        changed = np.broadcast_to(joints, (*shape, joints.shape[-1])).copy()
        changed[..., self._layout.legs] = lengths - self._layout.home
        return self._layout.checked(changed)

    def project(self, q: npt.ArrayLike, *, hold_legs: bool = False, max_iterations: int = 50) -> FloatArray:
        """Return closed joint values (..., 18) near q, by Newton's method; angles are not reduced to one turn.

        All joints move, as little as closes the loops to first order, slides measured in units of the middle platform's
        side; with `hold_legs` the passive ones alone: forward displacement, to the assembly mode that q is near to.
        Steps are halved where a full one does not shrink the gaps. Raises `ClosureError`, with the largest gap and the
        number of steps, if the loops of a member do not close to rounding in `max_iterations`.
        """
        most, held = whole_number(max_iterations, "max_iterations", "a number of steps"), flag(hold_legs, "hold_legs")

        def member(state: ChainState) -> FloatArray:
            return project_to_closure(state.kinematics.q, state.kinematics, held, most)

        return self._states.array(member, (18,), q)

    def forward_kinematics(self, leg_lengths: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return all joints (..., 18) of leg lengths (..., 6) [m]: the passive ones from the actuated ones.

        By default in the physical assembly mode of each member, in closed form and vectorised, angles in [-π, π]; see
        `spm_pin.forward_physical`. With `near` (18,), a closed q, the mechanism goes from there to the first member by
        changing all legs in proportion, and on to each from the one before, in C order, in the assembly mode that it
        comes to, angles continuous and not reduced to one turn; legs that change little take one or two steps of
        Newton's method. Closed to rounding.

        Raises
        ------
        ArgumentError
            If an argument is malformed or, without `near`, the physical mode cannot have these lengths.
        ClosureError
            If `near` is open, or the path does not lead to a member: with how far it leads.
        SingularConfigurationError
            If `near` or a member is at a forward or a constraint singularity.
        """
        if near is None:
            found = forward_physical(self._geometry, leg_lengths)
            if not found.exists.all():
                index = first_offender(~found.exists)
                received = f"{_listed(np.asarray(leg_lengths, dtype=np.float64)[index])} m"
                expected = "lengths that the physical assembly mode can have"
                raise _not_found("leg_lengths", expected, received, index, found.absence or "A misread leg?")
            return self._layout.values_of(found)
        lengths = read_vectors(leg_lengths, "leg_lengths", 6)
        if (lengths < self._layout.offsets).any():
            worst = np.unravel_index(int((lengths - self._layout.offsets).argmin()), lengths.shape)
            expected = "no negative length" if isinstance(self._geometry, Geometry) else "readings above the offsets"
            raise ArgumentError("leg_lengths", expected, f"{lengths[worst]:g} m in {LEGS[worst[-1]]}")
        return self._follow(ContinuationSolver.to_leg_lengths, near, lengths.shape[:-1], lengths)

    def inverse_kinematics(self, pose: PoseLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return all joints (..., 18) of a pose (...) of the terminal platform, {m} in {B}.

        By default in the physical branch of each member, in closed form and vectorised, angles in [-π, π]; see
        `spm_pin.closed_form.inverse_physical`. With `near` (18,), a closed q, the platform moves and turns from there
        to the first member in proportion, and on to each from the one before, as in `forward_kinematics`, in the branch
        that it comes to; leg limits play no part. Closed to rounding.

        Raises
        ------
        ArgumentError, PoseError
            If an argument is malformed or, without `near`, no physical branch has the pose.
        ClosureError
            If `near` is open, or the path does not lead to a member: with how far it leads.
        SingularConfigurationError
            If `near` or a member is at an inverse or a constraint singularity.
        """
        if near is None:
            found = inverse_physical(self._geometry, pose)
            if not found.exists.all():
                transform, index = as_rigid_transform(pose), first_offender(~found.exists)
                place, turn = (x[index] for x in (transform.translation, transform.rotation.as_rotvec()))
                received = f"o at {_listed(place)} m, turned by the rotation vector {_listed(turn)} rad"
                expected = "poses that a physical branch has"
                raise _not_found("pose", expected, received, index, found.absence or "Level, or out of reach?")
            return self._layout.values_of(found)
        transform = as_rigid_transform(pose)
        poses = transform.rotation.as_matrix(), transform.translation
        return self._follow(ContinuationSolver.to_pose, near, transform.shape, *poses)

    def joint_trajectory(
        self, path: Callable[[float], PlatformMotion], times: npt.ArrayLike, near: npt.ArrayLike
    ) -> JointTrajectory:
        """Return the motion of all joints for one of the platform, with the leg forces of it under gravity.

        `path`, a `PlatformPath` or another callable, takes a time [s] and returns pose, twist and acceleration of the
        terminal platform; `times` (n,) [s] increase at any rate; `near` (18,) is a closed q in the branch wanted, near
        the path's begin. Raises as `inverse_kinematics`, with the index of the time.
        """
        start = self._layout.checked(near, "near", single=True)
        return joint_trajectory(ChainState(self._states.constrained), self.joint_names, path, times, start)

    def simulate(
        self,
        q0: npt.ArrayLike,
        v0: npt.ArrayLike,
        forces: npt.ArrayLike | ForceFunction | None,
        times: npt.ArrayLike,
        *,
        wrench: WrenchLike | ForceFunction = None,
        period: float | None = None,
        stop_at: Collection[str] = (),
        tolerance: float = 1e-11,
        max_step: float = np.inf,
        progress: Callable[[float], object] | None = None,
    ) -> Simulation:
        """Integrate the motion under leg forces, gravity and wrenches, up to the last time or what ends it before.

        By SciPy's DOP853 with projection onto the closures after each step; see the module `integrator`. The loops are
        closed to rounding at every time. Errors of `forces`, `wrench` or `progress` reach the caller.

        Parameters
        ----------
        q0, v0 : array_like, shape (18,)
            Joint values and velocities of a closed mechanism at the first time.
        forces : array_like (6,), callable, or None
            Of the legs [N]: constant, or a function (t, q, v) → (6,); None lets the slides move freely. A function
            without `period` is smooth in its arguments alone: it is called several times a step, and not in order.
        times : array_like, shape (n,)
            When to record [s], increasing; the motion begins at the first.
        wrench : as in `forward_dynamics`, or callable, optional
            Applied from outside: constant, or a function (t, q, v) → (6,) for the terminal platform.
        period : float, optional
            Of a digital controller [s]: `forces` is called once at the begin of each period, in order, and its
            answer held. It may keep a state of its own.
        stop_at : collection of {"limits", "inverse", "forward"}
            End the run at the leg limits of `geometry`, or where a singularity is crossed. By default these are passed
            through. A leg of no length and a constraint singularity always end it: forces in the balls have no bound
            there. Looked for at the ends of steps: a smaller `max_step` sees what happens and is undone within one.
        tolerance : float
            Of a step, relative and absolute in the units of q and v; from 1e-13 to 1e-3. The default keeps the energy
            to about 1e-12 of itself in a second of falling.
        max_step : float
            Longest step [s]; not less than 1e-7 of the run.
        progress : callable, optional
            Called with the share done, from 0 to 1, after each step. If it returns False, the run ends there.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v0 opens the loops, or a function returns something else than finite (6,).
        ClosureError
            If q0 is open.
        """
        start = self.state(self._layout.checked(q0, "q0", single=True))
        return simulate(start, v0, forces, times, wrench, period, stop_at, tolerance, max_step, progress)

    def _follow(
        self, solve: Callable[..., FloatArray], near: npt.ArrayLike, shape: tuple[int, ...], *targets: FloatArray
    ) -> FloatArray:
        """Return q of each target by a method of `ContinuationSolver`, from that of the one before."""
        q = self._layout.checked(near, "near", single=True)

        def found(state: ChainState) -> FloatArray:
            require_closed(state.kinematics)
            return ContinuationSolver(state.kinematics).to_each(solve, q, shape, *targets)

        return self._states.array(found, (*shape, q.size), q)


def _listed(numbers: FloatArray) -> str:
    """Return numbers (n,) as text, to nine digits."""
    return f"[{', '.join(f'{number:.9g}' for number in numbers)}]"


def _not_found(argument: str, expected: str, received: str, index: tuple[int, ...], reason: str) -> ArgumentError:
    """Return the error about a member of a batch that has no physical solution, `()` for a single one."""
    where = f" at batch index {index}" if index else ""
    sentence = f"{reason[0].upper()}{reason[1:]}{'' if reason.endswith(('.', '?')) else '.'}"
    cause = f"{sentence} Pass a closed q as near: the solution on the path from there need not be physical."
    return ArgumentError(argument, expected, f"{received}{where}", cause)
