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
from spm_pin.description.closures import Closure, read_closures
from spm_pin.description.expand import expand
from spm_pin.description.paths import URDF, description_directory, description_file
from spm_pin.description.srdf import srdf_text
from spm_pin.description.tree import check_prefix
from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray, file_path, first_offender, flag, instance, whole_number
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.multibody.batches import BatchedStates, located
from spm_pin.multibody.constrained_model import ConstrainedModel, SingularValues
from spm_pin.multibody.continuation_solver import ContinuationSolver
from spm_pin.multibody.dynamics import Energy, PlatformDynamics, require_closed
from spm_pin.multibody.joint_layout import JointLayout
from spm_pin.multibody.loading import read_chain_urdf
from spm_pin.multibody.mounting import MountedChain, joined, wrapped
from spm_pin.multibody.platform_path import PlatformMotion
from spm_pin.multibody.projection import project_to_closure
from spm_pin.multibody.simulation import ForceFunction, simulate
from spm_pin.multibody.simulation_result import Simulation
from spm_pin.multibody.state import ChainState, Gains, WrenchLike, read
from spm_pin.multibody.trajectory import JointTrajectory, joint_trajectory

__all__ = ["ClosedChain"]


class ClosedChain:
    """The spanning tree of the description in Pinocchio, and the closures that make it the mechanism; read-only.

    Made by `from_urdf`. {B} is the link `base` and Pinocchio's universe. Methods take q, joint values [rad, m] in the
    order of `joint_names`, of one state or of a batch (..., 18), and raise `ArgumentError` if it has another shape, is
    not finite, or gives a leg a negative length. Leading axes of several arguments broadcast. Pinocchio answers one
    state at a time, so that a batch takes as long as its members. `state` computes several quantities of
    one q and v; methods in closed form, which say so, are for millions of states.

    Wrenches are (f, m) [N, N m] onto the terminal platform at o in the axes of {B}, twists (v, ω) [m/s, rad/s] of it;
    legs are in the order r_b1, r_b2, r_b3, r_c1, r_c2, r_c3, and a positive leg force pushes, to extend the leg.

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
        self._urdf, self._geometry, self._prefix = urdf, geometry, prefix
        self._model = pin.buildModelFromXML(urdf)
        self._layout = JointLayout(self._model, geometry, prefix)
        constrained = ConstrainedModel(self._model, self._layout, read_closures(prefix=prefix))
        self._states = BatchedStates(lambda: ChainState(constrained), self._layout.checked)

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
        check_prefix(prefix)
        if geometry is not None:
            instance(geometry, Geometry, "geometry")
        if path is not None:
            return cls(*read_chain_urdf(file_path(path), geometry, prefix), prefix=prefix)
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
    def geometry(self) -> Geometry:
        """Dimensions and leg limits."""
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
    def leg_indices(self) -> npt.NDArray[np.intp]:
        """Indices of the legs' prismatic joints in q, shape (6,)."""
        return self._layout.legs.copy()

    def joint_indices(self, *names: str) -> npt.NDArray[np.intp]:
        """Return where joints, named as in the URDF, are in q and in joint velocities, shape (n,).

        Raises
        ------
        ArgumentError
            If the chain has no joint of such a name.
        """
        return self._layout.indices(*(name.removeprefix(self._prefix) for name in names))

    @cached_property
    def visual_model(self) -> Any:
        """The visual shapes, a `pinocchio.GeometryModel`."""
        return pin.buildGeomFromUrdfString(
            self._model, self._urdf, pin.GeometryType.VISUAL, package_dirs=str(description_directory())
        )

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
        """Return this chain carried by another robot, as an arm carries a tool.

        Parameters
        ----------
        other : pinocchio.Model or pinocchio.RobotWrapper
            The robot that carries; its base stays where it is.
        frame : str
            A frame of it, such as `tool0`.
        placement : pinocchio.SE3, optional
            Of {B} in that frame; by default they coincide.

        Returns
        -------
        MountedChain
            Both in one model, the loops closed.

        Raises
        ------
        ArgumentError
            If an argument is malformed, or both robots have a link, joint or frame of the same name: `from_urdf` takes
            a prefix.
        """
        robot = wrapped(other)
        return MountedChain(self, robot.model, *joined(robot, self.robot_wrapper(), frame, placement))

    def carrying(self, other: Any, frame: str = "terminal_platform", placement: Any = None) -> MountedChain:
        """Return this chain with another robot on it.

        Parameters
        ----------
        other : pinocchio.Model or pinocchio.RobotWrapper
            The robot that is carried; its universe is fixed to the frame.
        frame : str
            A link of the chain, without prefix.
        placement : pinocchio.SE3, optional
            Of the robot's universe in that frame; by default they coincide.

        Returns
        -------
        MountedChain
            As of `mounted_on`, with the same errors.
        """
        robot = wrapped(other)
        both = joined(self.robot_wrapper(), robot, f"{self._prefix}{frame}", placement)
        return MountedChain(self, robot.model, *both)

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ChainState:
        """Return the state of joint values q (18,) and velocities v (18,), by default at rest.

        Its methods are those of the chain without q and v, and share what they compute; `state.update(q, v)` moves it
        on. In a control loop it saves reading and computing the same twice.
        """
        return ChainState(self._states.constrained).update(q, v)

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return q of a configuration, in closed form and vectorised.

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
            If a member does not exist, or is not closed to 1e-9 of the middle platform's side.
        GeometryError
            If it has other dimensions than the chain.
        """
        return self._layout.joint_values(configuration)

    def configuration(self, q: npt.ArrayLike) -> Configuration:
        """Return the configuration in q (..., 18): the poses of m and of the middle platform's corners.

        If q is not closed, neither is the configuration, and its leg lengths are those between its points, not
        those of q.
        """
        return Configuration.from_arrays(self._geometry, *self._over(ChainState.pose_arrays, ((3, 3), (3,), (3, 3)), q))

    def leg_lengths(self, q: npt.ArrayLike) -> FloatArray:
        """Return the leg lengths [m] of the slides in q (..., 18), shape (..., 6)."""
        return self._layout.leg_lengths(self._layout.checked(q))

    def with_leg_lengths(self, q: npt.ArrayLike, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return a copy of q (..., 18) with other leg lengths (..., 6) [m], all other joints as they are.

        That opens the loops; `forward_kinematics` keeps them closed.
        """
        joints, lengths = self._layout.checked(q), read(leg_lengths, "leg_lengths", 6, "leg lengths in metres")
        try:
            shape = np.broadcast_shapes(joints.shape[:-1], lengths.shape[:-1])
        except ValueError:
            expected = f"leading axes that broadcast with {joints.shape[:-1]}"
            raise ArgumentError("leg_lengths", expected, f"shape {lengths.shape}") from None
        changed = np.broadcast_to(joints, (*shape, joints.shape[-1])).copy()
        changed[..., self._layout.legs] = lengths - self._layout.home
        return self._layout.checked(changed)

    def closure_gap(self, q: npt.ArrayLike) -> FloatArray:
        """Return how far the closures are open: from `frame_a` to `frame_b` of each, in {B} [m], shape (..., 4, 3)."""
        return self._states.closure_gap(q)

    def constraint_jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (..., 12, 18), three rows per closure.

        Its transpose maps forces in {B} onto the closures' `frame_b`, with the opposite onto `frame_a`, to
        generalized forces. Exact at any q.
        """
        return self._states.constraint_jacobian(q)

    def project(self, q: npt.ArrayLike, *, hold_legs: bool = False, max_iterations: int = 50) -> FloatArray:
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
        ClosureError
            If the loops of a member do not close from there: with the largest gap and the number of steps.
        """
        most, held = whole_number(max_iterations, "max_iterations", "a number of steps"), flag(hold_legs, "hold_legs")

        def member(state: ChainState) -> tuple[FloatArray]:
            return (project_to_closure(state.kinematics.q, state.kinematics, held, most),)

        return self._over(member, ((18,),), q)[0]

    def forward_kinematics(self, leg_lengths: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return all joints of six leg lengths: the passive ones from the actuated ones.

        Parameters
        ----------
        leg_lengths : array_like, shape (..., 6)
            [m].
        near : array_like, shape (18,), optional
            A closed q to start from. The mechanism goes from there to the first member by changing all legs in
            proportion, and on to each member from the one before, in C order. Legs that change little take one or two
            steps of Newton's method. By default the answer is the physical assembly mode of each member, in closed
            form and vectorised: `spm_pin.forward_physical`.

        Returns
        -------
        ndarray, shape (..., 18)
            Closed to rounding. With `near`, in the assembly mode that the mechanism comes to, angles continuous along
            the path and not reduced to one turn; without, angles in [-π, π].

        Raises
        ------
        ArgumentError
            If an argument is malformed, a ball joint comes to a middle angle of ±90°, or, without `near`, the physical
            mode cannot have these lengths.
        ClosureError
            If `near` is open, or the path does not lead to a member: with how far it leads.
        SingularConfigurationError
            If `near` or a member is at a forward or a constraint singularity.
        """
        if near is None:
            configuration = forward_physical(self._geometry, leg_lengths)
            absent = ~configuration.exists
            if np.any(absent):
                index = first_offender(absent)
                where = f" at batch index {index}" if index else ""
                cause = "A leg misread? With near=, the mode on a path from there is found"
                expected = "lengths that the physical assembly mode can have"
                raise ArgumentError("leg_lengths", expected, f"others{where}", cause)
            return self._layout.joint_values(configuration)
        lengths = read(leg_lengths, "leg_lengths", 6, "of the legs in metres")
        if (lengths < 0.0).any():
            raise ArgumentError("leg_lengths", "no negative length", f"{lengths.min():g} m")
        return self._follow(ContinuationSolver.to_leg_lengths, near, (lengths,), lengths.shape[:-1])

    def inverse_kinematics(self, pose: PoseLike, near: npt.ArrayLike) -> FloatArray:
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
            As of `forward_kinematics` with `near`. Leg limits play no part.

        Raises
        ------
        ArgumentError, PoseError
            If an argument is malformed, or a ball joint comes to a middle angle of ±90°.
        ClosureError
            If `near` is open, or the path does not lead to a member: with how far it leads.
        SingularConfigurationError
            If `near` or a member is at an inverse or a constraint singularity.
        """
        transform = as_rigid_transform(pose)
        poses = transform.rotation.as_matrix(), transform.translation
        return self._follow(ContinuationSolver.to_pose, near, poses, transform.shape)

    def joint_trajectory(
        self, path: Callable[[float], PlatformMotion], times: npt.ArrayLike, near: npt.ArrayLike
    ) -> JointTrajectory:
        """Return the motion of all joints for one of the platform, at any rate.

        Parameters
        ----------
        path : PlatformPath, or callable
            Takes a time [s], and returns pose, twist and acceleration of the terminal platform.
        times : array_like, shape (n,)
            Increasing [s].
        near : array_like, shape (18,)
            A closed q to start from, as of `inverse_kinematics`: in the branch wanted, near the path's begin.

        Returns
        -------
        JointTrajectory
            With the leg forces of the motion under gravity.

        Raises
        ------
        ArgumentError, PoseError, ClosureError
            As `inverse_kinematics`.
        SingularConfigurationError
            If the path meets a singularity; `index` says at which of the times.
        """
        start = self._layout.checked(near, "near", single=True)
        return joint_trajectory(ChainState(self._states.constrained), self.joint_names, path, times, start)

    def inverse_jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return J_f, which maps the platform's twist to the leg rates, shape (..., 6, 6).

        Raises
        ------
        ArgumentError
            If `q` is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At an inverse or a constraint singularity; see `spm_pin.multibody.constrained_model.SINGULAR`.
        """
        return self._over(lambda state: (state.inverse_jacobian(),), ((6, 6),), q)[0]

    def joint_velocities(self, q: npt.ArrayLike, twist: npt.ArrayLike) -> FloatArray:
        """Return the rates of all joints (..., 18) [rad/s, m/s], in the order of `joint_names`, for a twist of m.

        The twist (..., 6) and the errors are those of `inverse_jacobian`.
        """
        value = read(twist, "twist", 6, "(v, ω) at o in {B} in m/s and rad/s")
        return self._over(lambda state, t: (state.joint_velocities(t),), ((18,),), q, twist=value)[0]

    def joint_rates(self, q: npt.ArrayLike, leg_rates: npt.ArrayLike) -> FloatArray:
        """Return the velocities of all joints for rates of the six legs; the other way is `joint_velocities`.

        Parameters
        ----------
        q : array_like, shape (..., 18)
            Joint values of a closed mechanism.
        leg_rates : array_like, shape (..., 6)
            [m/s].

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
        rates = read(leg_rates, "leg_rates", 6, "of r_b1 to r_c3 in m/s")
        return self._over(lambda state, r: (state.joint_rates(r),), ((18,),), q, leg_rates=rates)[0]

    def leg_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike) -> FloatArray:
        """Return the actuator forces (..., 6) [N] that hold a wrench applied onto the terminal platform.

        Weights and friction are left out: `inverse_dynamics` has the weights.

        Raises
        ------
        ArgumentError
            If an argument is malformed, or a ball joint's middle angle is ±90°.
        SingularConfigurationError
            At a forward or a constraint singularity; see `spm_pin.multibody.constrained_model.SINGULAR`.
        """
        load = read(wrench, "wrench", 6, "(f, m) at o in {B} in N and N m")
        return self._over(lambda state, w: (state.leg_forces(w),), ((6,),), q, wrench=load)[0]

    def cut_forces(self, q: npt.ArrayLike, wrench: npt.ArrayLike) -> FloatArray:
        """Return the forces in the ball joints where the tree is cut, shape (..., 4, 3) [N] in {B}.

        Per closure, what the middle platform (`frame_a`) exerts onto the tip of the leg (`frame_b`); the leg exerts
        the opposite onto the middle platform. Arguments and errors are those of `leg_forces`.
        """
        load = read(wrench, "wrench", 6, "(f, m) at o in {B} in N and N m")
        return self._over(lambda state, w: (state.cut_forces(w),), ((4, 3),), q, wrench=load)[0]

    def singular_values(self, q: npt.ArrayLike) -> SingularValues:
        """Return how near q (..., 18) is to each kind of singularity, without raising `SingularConfigurationError`.

        Numbers for a single q, arrays (...) for a batch.
        """

        def member(state: ChainState) -> tuple[float, ...]:
            found = state.singular_values()
            return found.inverse, found.forward, found.constraint

        found = self._over(member, ((), (), ()), q)
        return SingularValues(*(float(value) if value.ndim == 0 else value for value in found))

    def forward_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        forces: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        gains: Gains = None,
    ) -> FloatArray:
        """Return the accelerations of all joints under leg forces, gravity and wrenches.

        Parameters
        ----------
        q, v : array_like, shape (..., 18)
            Joint values, and joint velocities [rad/s, m/s].
        forces : array_like, shape (..., 6)
            Of the actuators [N].
        wrench : array_like, shape (..., 6), or mapping of str to such, optional
            Onto the terminal platform; or several, each onto the link or frame of that name, at its origin.
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
        return self._states.forward_dynamics(q, v, forces, wrench, gains)

    def inverse_dynamics(
        self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, wrench: WrenchLike = None
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
            Of the actuators [N]. At rest, with the weights of all bodies; `leg_forces` has the wrench alone.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v or a opens the loops, or a ball joint's middle angle is ±90°.
        ClosureError
            If q is open.
        SingularConfigurationError
            At a forward or a constraint singularity.
        """
        return self._states.inverse_dynamics(q, v, a, wrench)

    def joint_accelerations(self, q: npt.ArrayLike, v: npt.ArrayLike, acceleration: npt.ArrayLike) -> FloatArray:
        """Return the accelerations of all joints (..., 18) for one of the terminal platform.

        Parameters
        ----------
        q, v : array_like, shape (..., 18)
            Joint values and velocities of a closed mechanism, as of `joint_velocities`.
        acceleration : array_like, shape (..., 6)
            The time derivative of the twist: of the point o [m/s²], and angular [rad/s²], in {B}.

        Raises
        ------
        ArgumentError, ClosureError
            As `inverse_dynamics`.
        SingularConfigurationError
            At an inverse or a constraint singularity.
        """
        wanted = read(acceleration, "acceleration", 6, "of o in m/s², angular in rad/s², in {B}")
        function = lambda state, a: (state.joint_accelerations(a),)  # noqa: E731
        return self._over(function, ((18,),), q, v, acceleration=wanted)[0]

    def platform_dynamics(self, q: npt.ArrayLike, v: npt.ArrayLike) -> PlatformDynamics:
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

        def member(state: ChainState) -> tuple[FloatArray, ...]:
            found = state.platform_dynamics()
            return found.mass, found.coriolis, found.bias, found.gravity

        return PlatformDynamics(*self._over(member, ((6, 6), (6, 6), (6,), (6,)), q, v))

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike) -> Energy:
        """Return the kinetic and the potential energy [J] of all bodies at q, v (..., 18), closed or not."""
        return self._states.energy(q, v)

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
        """Integrate the motion under leg forces, gravity and wrenches.

        Parameters
        ----------
        q0, v0 : array_like, shape (18,)
            Joint values and velocities of a closed mechanism at the first time.
        forces : array_like (6,), callable, or None
            Of the legs [N]: constant, or a function (t, q, v) → (6,); None lets the slides move freely. A function
            without `period` depends on its arguments alone and is smooth in them: it is called several times a step,
            at any t, and not in order.
        times : array_like, shape (n,)
            When to record [s], increasing; the motion begins at the first.
        wrench : as in `forward_dynamics`, or callable, optional
            Applied from outside: constant, or a function (t, q, v) → (6,) for the terminal platform.
        period : float, optional
            Of a digital controller [s]: `forces` is called once at the begin of each period, in order, and its
            answer held. It may keep a state of its own.
        stop_at : collection of {"limits", "inverse", "forward"}
            End the run at the leg limits of `geometry`, or where a singularity is crossed. Neither stops the
            mechanism itself: nothing bumps, and these singularities are passed through. A leg of no length always
            ends it, and so does a constraint singularity, where forces in the balls have no bound. Looked for at the
            ends of steps: a smaller `max_step` sees what happens and is undone within one.
        tolerance : float
            Of a step, relative and absolute in the units of q and v; from 1e-13 to 1e-3. The default keeps the energy
            to about 1e-12 of itself in a second of falling.
        max_step : float
            Longest step [s]; not less than 1e-7 of the run.
        progress : callable, optional
            Called with the share done, from 0 to 1, after each step. If it returns False, the run ends there.

        Returns
        -------
        Simulation
            What happened up to the last time, or to `Simulation.end`. The loops are closed to rounding at every time.

        Raises
        ------
        ArgumentError
            If an argument is malformed, v0 opens the loops, or a function returns something else than finite (6,).
        ClosureError
            If q0 is open.

        Notes
        -----
        DOP853 of SciPy with projection onto the closures after each step; see the module `integrator`. Errors that
        `forces`, `wrench` or `progress` raise end the run and reach the caller.
        """
        start = self.state(self._layout.checked(q0, "q0", single=True))
        return simulate(
            start,
            v0,
            forces,
            times,
            wrench=wrench,
            period=period,
            stop_at=stop_at,
            tolerance=tolerance,
            max_step=max_step,
            progress=progress,
        )

    def _over(
        self,
        function: Callable[..., tuple[Any, ...]],
        shapes: tuple[tuple[int, ...], ...],
        q: npt.ArrayLike,
        v: npt.ArrayLike | None = None,
        **vectors: FloatArray,
    ) -> tuple[FloatArray, ...]:
        """Call a function of the state at each q and v, and of vectors."""
        states = self._states.states(q) if v is None else self._states.states(q, v=v)
        return self._states.over(function, shapes, **states, **vectors)

    def _follow(
        self,
        function: Callable[..., FloatArray],
        near: npt.ArrayLike,
        targets: tuple[FloatArray, ...],
        shape: tuple[int, ...],
    ) -> FloatArray:
        """Return `function(solver, q, *target)` for each target, with q that of the one before."""
        q = self._layout.checked(near, "near", single=True)
        found, state = np.empty((*shape, q.size)), self._states.take()
        try:
            state.kinematics.evaluate(q)
            require_closed(state.kinematics)
            solver = ContinuationSolver(state.kinematics)
            for index in np.ndindex(shape):
                try:
                    q = function(solver, q, *(array[index] for array in targets))
                except (ArgumentError, ClosureError, SingularConfigurationError) as error:
                    raise located(error, index) from error
                found[index] = q
        finally:
            self._states.give_back(state)
        return found


def _rebuilt(urdf: str, geometry: Geometry, prefix: str) -> ClosedChain:
    return ClosedChain(urdf, geometry, prefix=prefix)
