"""A machine as a Pinocchio model whose loops are closed by constraints."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial.transform import RigidTransform

from spm_pin.description.masses import Masses, check_inertials, with_masses
from spm_pin.description.source_files import (
    URDF,
    check_prefix,
    description_directory,
    description_file,
    read_closures,
    urdf_text,
)
from spm_pin.description.tree import srdf_text
from spm_pin.errors import ArgumentError, ClosureError, DescriptionError, SingularConfigurationError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import physical_at_poses
from spm_pin.loops.closed_chain import ClosedChain as LoopChain
from spm_pin.loops.loop_state import at_index
from spm_pin.loops.state_kinematics import AGREEMENT
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.joint_angles import joint_angles, value_names
from spm_pin.machine.legs import check_path_readings
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.machine.manipulator import Manipulator, check_rps, check_same_machine
from spm_pin.machine.stage import Stage
from spm_pin.multibody.chain_state import ChainState
from spm_pin.multibody.constrained_model import ConstrainedModel, TreeKinematics, read_vectors, widest
from spm_pin.multibody.mounting import MountedChain, mount
from spm_pin.multibody.simulation import ForceFunction, Simulation, run_simulation
from spm_pin.multibody.trajectory import JointTrajectory, PlatformMotion, PlatformPath, read_motion
from spm_pin.support.arguments import (
    FloatArray,
    IntArray,
    broadcastable,
    check_function,
    check_instance,
    first_offender,
    increasing_times,
)
from spm_pin.support.files import file_path
from spm_pin.support.pose import PoseLike, as_rigid_transform

MOST_STEPS, SHORTEST_SHARE = 50, 2.0**-10
"""Largest number of Newton steps of `project`, and share of a step below which it ends without a solution."""
CLOSED = 32.0 * float(np.finfo(np.float64).eps)
"""Gap that rounding explains, as a share of the longest loop."""


class ClosedChain:
    """The spanning tree of a machine's description in Pinocchio, and the closures of its loops; read-only.

    Made by `from_urdf`. {B} is the link `base` and Pinocchio's universe. The chain finds joint values q [rad, m]
    that close the loops, in the order of `joint_names`; rates, forces and dynamics at q are methods of its `state`.
    Arguments are of one state or of a batch (..., nq), and leading axes of several broadcast. Pinocchio computes one
    state at a time, so that a batch takes as long as its members; `joint_values`, `forward_kinematics`,
    `inverse_kinematics` and large batches of `forward_dynamics` are vectorised or compiled, on the way or in advance by
    `loops.compile()`. nq = nv = 18, or 9 for a stage; the actuators are the n = 6 or 3 legs.

    A single state that is singular or not closed raises; in a batch such members are NaN, and `failures` of a `state`
    of the batch says why. Joint values of a calibrated machine are zero at the nominal home, where its loops are open
    by about its errors. The value of an actuated joint is its reading minus the offset and the reading in the home.

    Attributes
    ----------
    machine : Manipulator or Stage
        Dimensions, legs, and the limits that set the zero of the tree.
    prefix : str
        Prefix of the names of all links and joints.
    model : pinocchio.Model
        The spanning tree; do not change it.
    closures : tuple of Closure
        Closures, in the order of all results per closure.
    joint_names : tuple of str
        Names of the joints in the order of q.
    leg_indices : ndarray, shape (n,)
        Indices of the joints in q that the actuators move, in the order of the legs.

    See Also
    --------
    spm_pin.loops.ClosedChain : Any robot with closed loops; `loops` is this machine as one.
    """

    def __init__(self, urdf: str, machine: Manipulator | Stage, prefix: str = "") -> None:
        self._urdf, self.machine, self.prefix = urdf, machine, prefix
        self.closures = read_closures(machine, prefix=prefix)
        self._constrained = ConstrainedModel(pin.buildModelFromXML(urdf), self.closures, machine, prefix)
        self.model = self._constrained.model
        self._of_thread = threading.local()
        self.joint_names, self.leg_indices = self._constrained.names, self._constrained.legs
        self._order = np.argsort(self._constrained.joint_indices(*value_names(machine)))

    @classmethod
    def from_urdf(
        cls,
        path: str | Path | None = None,
        machine: Manipulator | Stage | None = None,
        *,
        prefix: str = "",
        masses: Masses | None = None,
    ) -> ClosedChain:
        """Make a chain of a machine from the package's description, or from a URDF file expanded from it.

        `machine`, a `Manipulator` or a `Stage`, is by default the paper's. A file at `path` has the tree of the
        description for this machine, perhaps with other inertias, shapes and limits; the closures are the
        description's. `prefix` stands before the name of every link and joint. Raises `DescriptionError` for another
        tree, and for impossible inertias.

        Without `masses`, those of the description are assumed, in proportion to the machine's size: weights, dynamics
        and forces of motions are no better than they.
        """
        check_prefix(prefix)
        if isinstance(path, Machine):
            cause = "A machine is the second argument: from_urdf(machine=...)"
            raise ArgumentError("path", "the name of a file", type(path).__name__, cause)
        machine = Manipulator.paper() if machine is None else check_machine(machine)
        is_shipped = machine == Manipulator.paper() and prefix == ""
        shipped = description_file(URDF)
        described = shipped.read_text(encoding="utf-8") if is_shipped else urdf_text(machine, prefix=prefix)
        text = described if path is None else _read_urdf(file_path(path), described, machine.ball_side)
        chain = cls(text, machine, prefix)
        return chain if masses is None else chain.with_masses(masses)

    def with_masses(self, masses: Masses) -> ClosedChain:
        """Return this chain with other masses, or with an additional payload."""
        urdf = with_masses(self._urdf, check_instance(masses, Masses, "masses"), self.prefix)
        return type(self)(urdf, self.machine, self.prefix)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return type(self), (self._urdf, self.machine, self.prefix)

    def __repr__(self) -> str:
        named = f" {self.prefix!r}" if self.prefix else ""
        return f"<ClosedChain{named}: {self.model.nq} joints, {len(self.closures)} closures, {self.machine}>"

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ChainState:
        """Return the state of joint values q (..., nq) and velocities v (..., nv), by default at rest.

        Its methods return what follows from q and v: rates, forces, dynamics, singularities, the configuration.
        """
        return ChainState(self._constrained).update(q, v)

    def _at(self, q: npt.ArrayLike) -> ChainState:
        """Return the state at q that this thread's projections and continuations compute in, without new memory."""
        if not hasattr(self._of_thread, "state"):
            self._of_thread.state = ChainState(self._constrained)
        state: ChainState = self._of_thread.state
        return state.update(q)

    def joint_indices(self, *names: str) -> IntArray:
        """Return the indices in q (n,) of joints named as in the URDF; raise `ArgumentError` for an unknown name."""
        return self._constrained.joint_indices(*names)

    @property
    def loops(self) -> LoopChain:
        """The same chain in `spm_pin.loops`, for functions of any closed chain: mobility, forces of closures."""
        return self._constrained.loops

    @cached_property
    def visual_model(self) -> Any:
        """The visual shapes, a `pinocchio.GeometryModel`."""
        folder = str(description_directory())
        return pin.buildGeomFromUrdfString(self.model, self._urdf, pin.GeometryType.VISUAL, package_dirs=folder)

    @cached_property
    def collision_model(self) -> Any:
        """The collision shapes, a `pinocchio.GeometryModel`; the pairs leave out what touches by design."""
        shapes = pin.buildGeomFromUrdfString(self.model, self._urdf, pin.GeometryType.COLLISION)
        shapes.addAllCollisionPairs()
        pin.removeCollisionPairsFromXML(self.model, shapes, srdf_text(machine=self.machine, prefix=self.prefix))
        return shapes

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of the tree; it has no closures."""
        return pin.RobotWrapper(self.model, self.collision_model, self.visual_model)

    def mounted_on(self, other: Any, frame: str, placement: Any = None) -> MountedChain:
        """Return this chain mounted on another robot, as a tool on an arm, in one model with its loops closed.

        `other` is a pinocchio.Model or pinocchio.RobotWrapper whose base stays where it is, `frame` one of its frames
        such as `tool0`, `placement` the pinocchio.SE3 of {B} in it, by default the identity. No link, joint or frame
        of both robots may have the same name: `from_urdf` takes a prefix.
        """
        return mount(self, other, frame, placement, carried=False)

    def carrying(self, other: Any, frame: str | None = None, placement: Any = None) -> MountedChain:
        """Return this chain with another robot on it, whose universe is fixed to a frame of the chain.

        `frame` is named without prefix, by default the platform; `placement` is that of the other robot's universe in
        it; else as `mounted_on`.
        """
        place = self._constrained.platform if frame is None else f"{self.prefix}{frame}"
        return mount(self, other, place, placement, carried=True)

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return q (..., nq) of a configuration of the chain's machine, in closed form: angles in [-π, π].

        Its leg limits are not applied. The configuration is closed to 1e-9 of the middle platform's side at least, and
        the tree as far as it is; members of a batch that do not exist are NaN.
        """
        state = check_configuration(configuration, existing=not np.shape(getattr(configuration, "exists", True)))
        if state.machine is not self.machine:
            check_same_machine(state.machine, self.machine, "configuration", "the chain")
            # With the chain's own limits: they set the zero of its slides.
            state = state.with_machine(self.machine)
        return self._values_of(state)

    def _values_of(self, configuration: Configuration) -> FloatArray:
        """Return `joint_values` of a configuration of the chain's own machine."""
        angles = joint_angles(configuration, corners=(0,))
        is_open = angles.closure_residual > AGREEMENT * self._constrained.side
        if is_open.any():
            index = first_offender(is_open)
            where = f" at batch index {index}" if index else ""
            received = f"a closure residual of {angles.closure_residual[index]:.1e} m{where}"
            cause = "Rounded numbers? inverse_displacement closes the loops for a pose"
            raise ArgumentError("configuration", "a closed mechanism", received, cause)
        missed = np.isnan(angles.actuated) & configuration.exists[..., None]
        if missed.any():
            leg = self.machine.legs.names[first_offender(missed)[-1]]
            raise ArgumentError(
                "configuration", "balls within the reach of their legs", f"the ball of {leg} out of reach"
            )
        return angles.values.take(self._order, axis=-1)

    def leg_lengths(self, q: npt.ArrayLike) -> FloatArray:
        """Return the distances from pivot to ball [m] that slides of RPS legs have in q (..., nq), shape (..., n)."""
        check_rps(self.machine, "lengths of the legs in q")
        return self._constrained.readings(self._constrained.read_q(q))

    def readings(self, q: npt.ArrayLike) -> FloatArray:
        """Return the readings of the encoders in q (..., nq), shape (..., n) [m] ([rad] for RRS legs)."""
        return np.asarray(self._constrained.readings(self._constrained.read_q(q)) + self.machine.legs.offsets)

    def with_readings(self, q: npt.ArrayLike, readings: npt.ArrayLike) -> FloatArray:
        """Return a copy of q (..., nq) with other readings (..., n), the other joints as they are: loops open."""
        joints, own = self._constrained.read_q(q), self._without_offsets(readings)
        shape = broadcastable("readings", own.shape[:-1], "q", joints.shape[:-1])
        changed = np.broadcast_to(joints, (*shape, joints.shape[-1])).copy()
        changed[..., self.leg_indices] = own - self._constrained.home_readings
        return changed

    def _without_offsets(self, readings: npt.ArrayLike) -> FloatArray:
        own = np.asarray(read_vectors(readings, "readings", len(self.leg_indices)) - self.machine.legs.offsets)
        self._constrained.check_readings(own, "readings", "A leg length is the reading less the offset of its encoder")
        return own

    def project(self, q: npt.ArrayLike) -> FloatArray:
        """Return closed joint values (..., nq) near q, by Newton's method; angles are not reduced to one turn.

        All joints move, as little as closes the loops to first order, slides measured in units of the middle platform's
        side. Raises `ClosureError` if the loops do not close to rounding in fifty steps.
        """
        state, shape = self._at(q), (self.model.nq,)
        return np.array(state._each_member(lambda: self._closed(state.kinematics), shape))

    def _closed(self, kinematics: TreeKinematics) -> FloatArray:
        """Return closed joint values near those of the kinematics, which are left there, or raise `ClosureError`."""
        constrained, q = self._constrained, kinematics.q
        tolerance, units = CLOSED * self.loops.rows.size, constrained.units
        for iteration in range(MOST_STEPS + 1):
            gap, share = kinematics.residual, 1.0
            if widest(gap) <= tolerance:
                return q
            move = units * np.linalg.lstsq(kinematics.jacobian * units, -gap, rcond=None)[0]
            while share >= SHORTEST_SHARE and iteration < MOST_STEPS:
                tried = q + share * move
                if (constrained.readings(tried) >= constrained.least_readings).all():
                    kinematics.evaluate(tried)
                    # To first order a share of the step shrinks the gaps by that share: a quarter of that is required.
                    if np.linalg.norm(kinematics.residual) <= (1.0 - 0.25 * share) * np.linalg.norm(gap):
                        q = tried
                        break
                share *= 0.5
            else:
                break
        raise ClosureError(widest(gap), iteration, "Too far from any closed q?")

    def forward_kinematics(self, readings: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return all joint values (..., nq) for readings (..., n) [m] ([rad] for RRS legs).

        By default in each member's physical assembly mode, by Newton's method on each stage, angles in [-π, π]; see
        `spm_pin.forward_physical`. With `near` (nq,), a closed q, the mechanism goes from there to the first member by
        changing all readings in proportion, and on to each from the one before, in C order, in the assembly mode that
        it comes to, angles continuous and not reduced to one turn.

        Readings that the physical mode cannot have raise `ArgumentError`; in a batch they give NaN. A path that does
        not lead to a member, for instance because it ends at a forward or a constraint singularity, is an error for a
        batch as well.
        """
        if near is None:
            expected = "readings that the physical assembly mode can have"
            state = forward_physical(self.machine, readings)
            return self._physical_values(state, "readings", expected, lambda: _listed(readings))
        q = self._constrained.read_q(near, "near", single=True)
        values = self._without_offsets(readings) - self._constrained.home_readings
        return self._explained(lambda: self.loops.forward(values, q), q, "forward_factors")

    def inverse_kinematics(self, pose: PoseLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return all joint values (..., nq) for a pose (...) of the terminal platform, {m} in {B}.

        For a stage only the height and the normal of the pose are used: shift and torsion follow from them. By default
        in the physical branch of each member, in closed form, angles in [-π, π]; see
        `spm_pin.kinematics.inverse_physical`. With `near` (nq,), a closed q, the platform moves and turns from there to
        the first member in proportion, and on to each from the one before, as in `forward_kinematics`, in the branch
        that it comes to. Leg limits are not applied. Errors are those of `forward_kinematics`, at inverse singularities
        instead of forward ones.
        """
        transform = as_rigid_transform(pose)
        if near is None:
            place, rotation = transform.translation, transform.rotation
            return self._physical_values(
                physical_at_poses(self.machine, transform),
                "pose",
                "poses that a physical branch has",
                lambda: f"o at {_listed(place)} m, turned by the rotation vector {_listed(rotation.as_rotvec())} rad",
            )
        return self._follow(self._constrained.read_q(near, "near", single=True), transform)

    def _physical_values(
        self,
        configuration: Configuration,
        argument: str,
        expected: str,
        received: Callable[[], str],
    ) -> FloatArray:
        """Return the joint values of a physical solution; for a single problem without one, raise an error."""
        if not configuration.shape and not configuration.exists:
            reason = configuration.missing_reason or "Out of reach, or a misread number?"
            sentence = f"{reason[0].upper()}{reason[1:]}{'' if reason.endswith(('.', '?')) else '.'}"
            cause = f"{sentence} Pass a closed q as near: the solution on the path from there need not be physical."
            raise ArgumentError(argument, expected, received(), cause)
        return self._values_of(configuration)

    def _follow(self, q: FloatArray, pose: RigidTransform) -> FloatArray:
        """Return q of each pose (...), starting from the one before, for a stage of its normal and height."""
        targets, rows = pose.as_matrix(), tuple(range(6))
        if self.machine.is_stage:
            rows, turned = (2, 3, 4), self._at(q).kinematics.terminal_pose()[0]
            # The spin is free: each normal is reached by the smallest turn from the one before.
            for target in targets.reshape(-1, 4, 4):
                turned = pin.Quaternion.FromTwoVectors(turned[:, 2], target[:3, 2]).matrix() @ turned
                target[:3, :3] = turned
        platform = self._constrained.platform
        return self._explained(lambda: self.loops.inverse(platform, targets, q, rows), q, "inverse_factors")

    def _explained(self, path: Callable[[], FloatArray], q: FloatArray, factors: str) -> FloatArray:
        """Return the result of `path`, or raise the error that q, where it starts, is open or singular, if it is."""
        try:
            return path()
        except (ArgumentError, ClosureError):
            kinematics: TreeKinematics = self._at(q).kinematics
            kinematics.check_closed()
            getattr(kinematics, factors)
            raise

    def joint_trajectory(
        self, path: Callable[[float], PlatformMotion], times: npt.ArrayLike, near: npt.ArrayLike
    ) -> JointTrajectory:
        """Return the motion of all joints for one of the platform, with the leg forces of it under gravity.

        `path`, a `PlatformPath` or another callable, takes a time [s] and returns pose, twist and acceleration of the
        terminal platform, of which a stage follows height and normal. `times` (n,) [s] increase at any rate; `near`
        (nq,) is a closed q in the branch wanted, near the path's start. Raises as `inverse_kinematics`, with the index
        of the time, and `UnreachableError` where a leg is beyond the limits of the machine.
        """
        near, t = self._constrained.read_q(near, "near", single=True), increasing_times(times)
        motions = _motions(path, t)
        positions = self._follow(near, motions.pose)
        state, rows = self.state(near), []
        for k, (q, twist, acceleration) in enumerate(zip(positions, motions.twist, motions.acceleration, strict=True)):
            try:
                v = state.update(q).velocities_along(twist)
                a = state.update(q, v)._accelerations_along(twist, acceleration)
                rows.append((v, a, state.inverse_dynamics(a)))
            except (ArgumentError, ClosureError, SingularConfigurationError) as error:
                raise at_index(error, (k,)) from error
        v, a, forces = (np.array(column) for column in zip(*rows, strict=True))
        efforts, readings = np.zeros(positions.shape), self.readings(positions)
        efforts[:, self.leg_indices] = forces
        check_path_readings(self.machine.limits, self.machine.legs.units, readings, "path", t, "time")
        columns, legs = tuple(self.leg_indices.tolist()), self.machine.legs
        of_joints = positions, v, a, efforts, readings
        return JointTrajectory(self.joint_names, t, *of_joints, motions.pose, columns, legs.units, legs.names)

    def simulate(
        self,
        q0: npt.ArrayLike,
        v0: npt.ArrayLike,
        forces: npt.ArrayLike | ForceFunction | None,
        times: npt.ArrayLike,
        *,
        wrench: npt.ArrayLike | ForceFunction | None = None,
        period: float | None = None,
        tolerance: float = 1e-11,
    ) -> Simulation:
        """Integrate the motion under leg forces, gravity and a wrench, up to the last time or an event that ends it.

        Leg limits, inverse and forward singularities do not stop it; `limit_excess` of the result shows limits. A leg
        whose length becomes zero and a constraint singularity end the run, since forces in the balls are unbounded
        there. They are detected at the ends of steps.

        Parameters
        ----------
        q0, v0, times, period, tolerance
            As `q`, `v` and so on of `spm_pin.loops.forward_simulation.simulate`. The default tolerance keeps the energy
            to about 1e-12 of itself in a second of falling.
        forces : array_like (n,), callable, or None
            Its `tau`: forces of the legs [N] ([N m] for RRS legs), or a function (t, q, v) → (n,).
        wrench : array_like (6,), or callable, optional
            Wrench onto the terminal platform: constant, or a function (t, q, v) → (6,).
        """
        return run_simulation(self._constrained, q0, v0, times, forces, wrench, period, tolerance)


def _motions(path: Callable[[float], PlatformMotion], times: FloatArray) -> PlatformMotion:
    """Return the motion along a path at times (n,), or raise `ArgumentError`."""
    check_function(path, "path", "t", meaning=", such as a PlatformPath")
    if isinstance(path, PlatformPath):
        return path(times)
    motions = []
    for k, time in enumerate(times.tolist()):
        try:
            motions.append(read_motion(path(time)))
        except ArgumentError as error:
            raise at_index(error, (k,)) from error
    poses, twists, accelerations = zip(*motions, strict=True)
    matrices = np.array([pose.as_matrix() for pose in poses])
    return PlatformMotion(RigidTransform.from_matrix(matrices), np.array(twists), np.array(accelerations))


def _listed(numbers: npt.ArrayLike) -> str:
    """Return numbers (n,) as text, to nine digits."""
    return f"[{', '.join(f'{number:.9g}' for number in np.asarray(numbers, dtype=np.float64))}]"


def _read_urdf(file: Path, described: str, side: float) -> str:
    """Return the text of a URDF file, if it is the tree of the one `described`; see `ClosedChain.from_urdf`."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(file), "a readable URDF file", getattr(error, "strerror", str(error))) from error
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        cause = "Not expanded yet? xacro writes the URDF" if file.suffix == ".xacro" else ""
        raise DescriptionError(str(file), "a URDF", str(error), cause) from error
    check_inertials(text, str(file))
    _check_tree(model, pin.buildModelFromXML(described), str(file), side)
    return text


def _check_tree(model: Any, expected: Any, path: str, side: float) -> None:
    """Raise `DescriptionError` unless both trees have the same joints, and links that move alike.

    Compared are each link's origin and the points on its axes at the distance of the middle platform's side, at
    one q with all joints different from zero, where every placement and axis matters.
    """
    links = [frame.name for frame in expected.frames if frame.type == pin.FrameType.BODY]
    joints, wanted = set(model.names), set(expected.names)
    missing = sorted(wanted - joints) + [name for name in links if not model.existFrame(name, pin.FrameType.BODY)]
    foreign = sorted(joints - wanted)
    cause = "The arguments machine and prefix are those the file was written for, by default the paper's and none"
    if missing or foreign or model.nq != expected.nq:
        names = (f"{', '.join(names[:3]) or 'none'}{', …' * (len(names) > 3)}" for names in (missing, foreign))
        received = "{} missing, {} foreign, nq = {}".format(*names, model.nq)
        raise DescriptionError(path, "the joints and links of the description", received, cause)
    values = dict(zip(expected.names[1:], np.linspace(0.2, 0.9, expected.nq), strict=True))
    places = []
    for tree in (model, expected):
        data = tree.createData()
        pin.framesForwardKinematics(tree, data, np.array([values[name] for name in tree.names[1:]]))
        places.append(np.array([data.oMf[tree.getFrameId(link)].homogeneous for link in links]))
    off = np.abs((places[0] - places[1]) * [side, side, side, 1.0]).max(axis=(-1, -2))
    if off.max() > AGREEMENT * side:
        received = f"{links[int(off.argmax())]} {off.max():.1e} m off where all joints are turned"
        cause = f"Another joint axis, order or zero, which follows from the leg limits? {cause}"
        raise DescriptionError(path, "the tree of the description for this machine", received, cause)
