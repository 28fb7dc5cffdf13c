"""Any robot with closed loops: a tree of Pinocchio, its closures, and its actuated joints."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from functools import cached_property, partial
from os import PathLike
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.loops.assembly import assemble
from spm_pin.loops.closures import Closure, JointEquality, RobotDescription
from spm_pin.loops.constraint_rows import ConstraintRows, joint_of, scalar_joint
from spm_pin.loops.dynamics_kernel import accelerate
from spm_pin.loops.following import Follower
from spm_pin.loops.forward_simulation import LoopMotion, simulate
from spm_pin.loops.links import reading
from spm_pin.loops.loop_state import LoopState
from spm_pin.loops.mobility import Mobility, mobility
from spm_pin.loops.state_kinematics import StateKinematics, frame_index, read_vectors
from spm_pin.loops.tree_kernel import tree_of
from spm_pin.support.arguments import (
    FloatArray,
    IntArray,
    Kind,
    broadcastable,
    check_instance,
    name_sequence,
    type_and_value,
    whole_number,
)
from spm_pin.support.pose import PoseLike, as_rigid_transform


class ClosedChain:
    """A robot with closed loops on Pinocchio; read-only.

    q (nq,) and v (nv,) are Pinocchio's, of the tree `model`; closures and joint equalities say which q are possible.
    Answers are closed to rounding and stay in the assembly mode that they start from, or an error says why not.

    Parameters
    ----------
    model : pinocchio.Model
        Spanning tree, copied. Its joints are hinges, slides, balls, planar or free.
    closures : sequence of Closure
        Constraints between frames of the model that close the loops.
    actuated : sequence of str
        Names of the actuated joints, of one degree of freedom each; `values` and forces are in this order.
    equalities : sequence of JointEquality
        Joints that follow others, as gears and mimic joints do.
    held : sequence of str
        Joints that `close`, `forward` and `inverse` leave where they are, such as springs or the spin of a rod.
    q0 : array_like, shape (nq,), optional
        A configuration of typical size, at best closed; by default Pinocchio's neutral one.

    Attributes
    ----------
    model : pinocchio.Model
        The spanning tree.
    closures, equalities, actuated, held : tuple
        As given.
    q0 : ndarray, shape (nq,)
        Where `close` starts by default.
    rows : ConstraintRows
        The scalar equations of closures and equalities.

    Raises
    ------
    ArgumentError
        Invalid names, joints or closures; the message names them.

    See Also
    --------
    spm_pin.ClosedChain : The serial-parallel manipulator as such a chain.
    """

    dynamics = accelerate
    """The kernel of forward dynamics, the same for all chains."""

    def __init__(
        self,
        model: Any,
        closures: Sequence[Closure],
        actuated: Sequence[str],
        *,
        equalities: Sequence[JointEquality] = (),
        held: Sequence[str] = (),
        q0: npt.ArrayLike | None = None,
    ) -> None:
        if not isinstance(model, pin.Model):
            raise ArgumentError("model", "a pinocchio.Model", type(model).__name__)
        for k in range(2, model.njoints):
            if model.parents[k] not in model.supports[k - 1]:
                cause = "Pinocchio's dynamics are silently wrong otherwise. Add each joint before its parent's next one"
                raise ArgumentError("model", "joints in depth-first order", repr(model.names[k]), cause)
        self.model = model.copy()
        self._nq, self._is_flat = self.model.nq, self.model.nq == self.model.nv
        self.q0 = pin.neutral(self.model) if q0 is None else self._read_q(q0, "q0", single=True).copy()
        self.q0.flags.writeable = False
        self.closures = _members(closures, Closure, "closures")
        self.equalities = _members(equalities, JointEquality, "equalities")
        self.rows = ConstraintRows(self.model, self.closures, self.equalities, self.q0)
        self.actuated, self.held = name_sequence(actuated, "actuated"), name_sequence(held, "held")
        both = set(self.actuated) & set(self.held)
        if both:
            raise ArgumentError("held", "joints that are not actuated", ", ".join(sorted(both)))
        for name in self.actuated:
            scalar_joint(self.model, name, "actuated")
        self.actuated_in_q = self.indices_in_q(*self.actuated)
        self.actuated_in_v = self.indices_in_v(*self.actuated)
        for name in self.held:
            joint_of(self.model, name, "held")
        self._held_in_v = self.indices_in_v(*self.held)
        self.regular_dof = -1  # degrees of freedom at regular configurations, once they are known
        self._followers: dict[Any, Follower] = {}
        self._lock = threading.Lock()

    @classmethod
    def from_description(cls, description: RobotDescription, *, held: Sequence[str] = ()) -> Self:
        """Return the chain of a `RobotDescription`, the result of a reader."""
        check_instance(description, RobotDescription, "description")
        with reading(description.source):
            return cls(
                description.model,
                description.closures,
                description.actuated,
                equalities=description.equalities,
                held=held,
                q0=description.q0,
            )

    @classmethod
    def from_mjcf(cls, source: Any, *, actuated: Sequence[str] | None = None, held: Sequence[str] = ()) -> Self:
        """Return the chain of an MJCF file, its text, or a `mujoco.MjModel`; `spm_pin.loops.read_mjcf` reads it."""
        from spm_pin.loops.read_mjcf import read_mjcf

        return cls.from_description(read_mjcf(source, actuated=actuated), held=held)

    @classmethod
    def from_urdf(
        cls,
        source: str | PathLike[str],
        closures: Any = None,
        *,
        free_base: bool = False,
        actuated: Sequence[str] | None = None,
        srdf: str | PathLike[str] | None = None,
        held: Sequence[str] = (),
    ) -> Self:
        """Return the chain of a URDF file, or its text, and its closures; `spm_pin.loops.read_urdf` reads them.

        A URDF is a tree: one without Drake's tags and mimic joints needs closures, or an empty list to be left open.
        """
        from spm_pin.loops.read_urdf import read_urdf

        description = read_urdf(source, closures, free_base=free_base, actuated=actuated, srdf=srdf)
        if closures is None and not (description.closures or description.equalities):
            cause = f"Name the YAML file of {description.source}; closures=[] leaves the tree open"
            raise ArgumentError("closures", "what closes the loops", "none, and no Drake tags in the URDF", cause)
        return cls.from_description(description, held=held)

    @classmethod
    def from_sdf(
        cls,
        source: str | PathLike[str],
        *,
        actuated: Sequence[str] | None = None,
        srdf: str | PathLike[str] | None = None,
        held: Sequence[str] = (),
    ) -> Self:
        """Return the chain of an SDF file or its text; `spm_pin.loops.read_sdf` reads it."""
        from spm_pin.loops.read_sdf import read_sdf

        return cls.from_description(read_sdf(source, actuated=actuated, srdf=srdf), held=held)

    def __reduce__(self) -> tuple[Any, ...]:
        restored = partial(type(self), equalities=self.equalities, held=self.held, q0=self.q0)
        return restored, (self.model, self.closures, self.actuated)

    def __repr__(self) -> str:
        loops, joints = len(self.closures), self.model.njoints - 1
        return f"<ClosedChain {self.model.name!r}: {joints} joints, {loops} closures, {len(self.actuated)} actuators>"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints in Pinocchio's order."""
        return tuple(self.model.names)[1:]

    def indices_in_q(self, *names: str) -> IntArray:
        """Return the indices of joints in q."""
        joints = [joint_of(self.model, name, "names") for name in names]
        return np.array([j.idx_q + k for j in joints for k in range(j.nq)], dtype=np.intp)

    def indices_in_v(self, *names: str) -> IntArray:
        """Return the indices of joints in v."""
        joints = [joint_of(self.model, name, "names") for name in names]
        return np.array([j.idx_v + k for j in joints for k in range(j.nv)], dtype=np.intp)

    def close(self, q_guess: npt.ArrayLike | None = None) -> FloatArray:
        """Return closed joint values (nq,) near a guess (nq,), by default near `q0`.

        Joints that are held, or in no loop, stay. Damped Newton's method takes the shortest way, so the result is near
        the guess rather than the nearest of all.

        Raises
        ------
        ClosureError
            The loops do not close from the guess. The error has the largest gap, its loop, and the likely cause.
        """
        q = self._read_q(self.q0 if q_guess is None else q_guess, "q_guess", single=True).copy()
        free = np.setdiff1d(np.flatnonzero(self.rows.concerns()), self._held_in_v)
        return assemble(StateKinematics(self), q, free)

    def forward(self, values: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return all joint values (..., nq) for those of the actuated joints (..., n) [rad, m].

        From one closed configuration `near` (nq,), the actuated joints move in proportion to the first member of
        `values`, and on to each from the one before, in C order. With several (..., nq), each member of the batch
        starts from its own. A free base and joints that are held stay; limits of joints, which `model` has, do not
        count. `near` is by default `close()`.

        It is in the assembly mode of the start; `spm_pin.loops.continuation` says for which joints this is proved.

        Raises
        ------
        ClosureError
            `near` is not closed, or the path ends at a singularity before it reaches the values.
        ArgumentError
            The actuated joints do not determine the others, or are more than the degrees of freedom.
        """
        targets = read_vectors(values, "values", len(self.actuated), "of the actuated joints in rad and m")
        return self._follow(self._follower(None, ()), targets, 1, near, "values")

    def inverse(
        self, frame: str, pose: PoseLike, near: npt.ArrayLike | None = None, rows: Sequence[int] = (0, 1, 2, 3, 4, 5)
    ) -> FloatArray:
        """Return all joint values (..., nq) that place a frame of the model.

        Parameters
        ----------
        frame : str
            Name of a link or frame.
        pose : pinocchio.SE3, scipy.spatial.transform.RigidTransform or array_like of shape (..., 4, 4)
            Target of the frame in the world.
        near : array_like, shape (nq,) or (..., nq)
            Closed configurations to start from, as in `forward`.
        rows : sequence of int
            Components of the pose to be reached: 0 to 2 the position in the axes of the world, 3 to 5 the rotation
            vector to the orientation given, in the axes of the target. Without 5 the frame's z axis is the target's,
            and its spin is free.

        Raises
        ------
        ClosureError, ArgumentError
            As `forward`.
        """
        expected = "different numbers from 0, 1, 2 (position) and 3, 4, 5 (rotation)"
        listed = rows if isinstance(rows, Sequence | np.ndarray) and not isinstance(rows, str) else ()
        chosen = tuple(sorted({whole_number(row, "rows", expected, most=5) for row in listed}))
        if not chosen or len(chosen) != len(listed):
            raise ArgumentError("rows", expected, repr(rows))
        frame_index(self.model, frame)
        # To check an SE3, whose rotation is one, would take longer than the path.
        matrices = np.asarray(pose.homogeneous if isinstance(pose, pin.SE3) else as_rigid_transform(pose).as_matrix())
        return self._follow(self._follower(frame, chosen), matrices, 2, near, "pose")

    def compile(self) -> None:
        """Compile paths, batches and forward dynamics, once for all robots and sessions: half a minute, later a second.

        `forward` and `inverse` load what is compiled after some hundreds of steps in a process, and compile it after
        some thousands; `forward_dynamics` does for large batches. A control loop calls this before it starts, so that
        no call waits for the compiler.
        """
        self._follower(None, ()).compile()
        self.compile_dynamics()

    def compile_dynamics(self) -> None:
        """Compile forward dynamics alone."""
        zeros = np.zeros(self.model.nv)
        self.dynamics.call(self.tree, self.q0.copy(), zeros, zeros.copy(), -1, -1)

    @cached_property
    def tree(self) -> Any:
        """The chain as arrays for the compiled dynamics, which read them only."""
        return tree_of(self.rows, np.arange(self.model.nv), self.actuated_in_q, self.actuated_in_v, self._held_in_v)

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> LoopState:
        """Return the `LoopState` at joint values q (..., nq) and velocities v (..., nv), zero by default."""
        return LoopState(self, q, v)

    def mobility(self, q: npt.ArrayLike) -> Mobility:
        """Return degrees of freedom, dependent equations and joints that are not driven at a closed q (nq,)."""
        return mobility(self, q)

    def simulate(
        self, q: npt.ArrayLike, v: npt.ArrayLike, tau: Any, times: npt.ArrayLike, **options: Any
    ) -> LoopMotion:
        """Return the motion from q (nq,) and v (nv,) under actuator forces `tau`, a `LoopMotion`.

        Options, such as `wrenches` and `period`, are those of `spm_pin.loops.forward_simulation.simulate`.
        """
        return simulate(self, q, v, tau, times, **options)

    def _read_q(self, q: npt.ArrayLike, argument: str, *, single: bool = False) -> FloatArray:
        meaning = "joint values in rad and m in Pinocchio's order"
        array = read_vectors(q, argument, self._nq, meaning)
        if single and array.ndim != 1:
            raise ArgumentError(argument, f"shape ({self._nq},), {meaning}", f"shape {array.shape}")
        if not (self._is_flat or array.ndim > 1 or pin.isNormalized(self.model, array, 1e-6)):
            raise ArgumentError(
                argument,
                "quaternions of unit length",
                "quaternions of another length",
                "pinocchio.normalize scales them",
            )
        return array

    def _follower(self, frame: str | None, chosen: tuple[int, ...]) -> Follower:
        """Return what follows actuated joints, or the pose of a frame, made once."""
        key = frame, chosen
        if key not in self._followers:
            with self._lock:
                self._followers.setdefault(key, Follower(self, frame, chosen))
        return self._followers[key]

    def _follow(
        self, follower: Follower, targets: FloatArray, axes: int, near: npt.ArrayLike | None, argument: str
    ) -> FloatArray:
        starts = self.close() if near is None else self._read_q(near, "near")
        if starts.ndim == 1 and targets.ndim == axes:
            return follower.run(starts, targets[None], True, ()).reshape(-1)
        batch, is_path = targets.shape[: targets.ndim - axes], starts.ndim == 1
        if not is_path:
            batch = broadcastable(argument, batch, "near", starts.shape[:-1])
            starts = np.broadcast_to(starts, (*batch, self.model.nq)).reshape(math.prod(batch), self.model.nq)
        shape = targets.shape[targets.ndim - axes :]
        targets = np.broadcast_to(targets, (*batch, *shape)).reshape(math.prod(batch), *shape)
        return follower.run(starts, targets, is_path, batch).reshape(*batch, self.model.nq)

    def joint_of_velocity(self, index: int) -> str:
        """Return the name of the joint that an element of v belongs to."""
        whole_number(index, "index", most=self.model.nv - 1)
        for joint in list(self.model.joints)[1:]:
            if joint.idx_v <= index < joint.idx_v + joint.nv:
                return str(self.model.names[joint.id])
        raise ArgumentError("index", f"an index of v, below {self.model.nv}", index)


def _members(value: Any, kind: type[Kind], argument: str) -> tuple[Kind, ...]:
    """Read a sequence of members of a kind."""
    if not isinstance(value, Sequence):
        raise ArgumentError(argument, f"a sequence of {kind.__name__}", type_and_value(value))
    return tuple(check_instance(member, kind, f"{argument}[{k}]") for k, member in enumerate(value))
