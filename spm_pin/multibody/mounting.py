"""A chain in one model with another robot: on an arm's tool, or with an arm on its platform."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.multibody.batches import over_batch
from spm_pin.multibody.chain_dynamics import WrenchLike, read_gains, read_wrenches
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.dynamics import (
    Energy,
    balanced_legs,
    energy_of,
    require_closed,
    require_closed_accelerations,
    require_constrained,
    tree_torques,
    wrench_torques,
)
from spm_pin.multibody.placement import Placement
from spm_pin.multibody.velocity import Linearization

__all__ = ["MountedChain", "joined", "wrapped"]


class MountedChain:
    """A `ClosedChain` and another robot in one Pinocchio model, the loops closed; read-only.

    Made by `ClosedChain.mounted_on` and `ClosedChain.carrying`. Its q is that of `model`; `join` and `split` put it
    together from the other robot's and the chain's and take it apart. Leading axes broadcast. The universe is that of
    whichever robot carries the other: all that is "in {B}" for a chain alone is in its axes here.

    Attributes
    ----------
    chain : ClosedChain
        The chain, as it is by itself.
    model : pinocchio.Model
        Both trees; do not change it.
    """

    def __init__(
        self, chain: Any, placement: Placement, alone: ClosureConstraints, other: Any, both: tuple[Any, Any, Any]
    ) -> None:
        self.chain = chain
        self._placement, self._alone = placement, alone
        self._other = other
        self._both = both
        self.model = both[0]
        model = self.model
        self._constraints = ClosureConstraints(model, chain.closures)
        self._q, self._v = self._places(chain.model)
        self._other_q, self._other_v = self._places(other)

    def __repr__(self) -> str:
        return f"<MountedChain: {self.chain!r} and {self._other.name}, {self.model.nv} degrees of freedom of the tree>"

    def _places(self, tree: Any) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Return where the q and the v of one of the two trees are, in its own order."""
        q, v = np.empty(tree.nq, dtype=np.intp), np.empty(tree.nv, dtype=np.intp)
        for own in tree.joints[1:]:
            joint = self.model.joints[self.model.getJointId(tree.names[own.id])]
            q[own.idx_q : own.idx_q + own.nq] = joint.idx_q + np.arange(own.nq)
            v[own.idx_v : own.idx_v + own.nv] = joint.idx_v + np.arange(own.nv)
        return q, v

    @property
    def chain_indices(self) -> npt.NDArray[np.intp]:
        """Where the chain's joints are in v, in the order of `chain.joint_names`, shape (18,)."""
        return self._v.copy()

    @property
    def other_indices(self) -> npt.NDArray[np.intp]:
        """Where the other robot's degrees of freedom are in v, in its own order."""
        return self._other_v.copy()

    @property
    def actuated_indices(self) -> npt.NDArray[np.intp]:
        """Where the actuators are in v: all of the other robot's, then the six legs."""
        return np.concatenate([self._other_v, self._v[self.chain.leg_indices]])

    def join(self, other: npt.ArrayLike, chain: npt.ArrayLike) -> FloatArray:
        """Return q (..., nq) of the model from the other robot's q and the chain's (..., 18)."""
        parts = self._read(other, "other", self._other.nq), self._read(chain, "chain", self.chain.model.nq)
        return self._together(parts, (self._other_q, self._q), self.model.nq)

    def join_velocities(self, other: npt.ArrayLike, chain: npt.ArrayLike) -> FloatArray:
        """Return v (..., nv), or accelerations, from the other robot's and the chain's (..., 18)."""
        parts = self._read(other, "other", self._other.nv), self._read(chain, "chain", self.chain.model.nv)
        return self._together(parts, (self._other_v, self._v), self.model.nv)

    def split(self, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the other robot's q and the chain's (..., 18) from q (..., nq) of the model."""
        array = self._read(q, "q", self.model.nq)
        return array[..., self._other_q], array[..., self._q]

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of both trees, with the shapes of both where they are known."""
        return pin.RobotWrapper(*self._both)

    def workspace(self) -> Workspace:
        """Return memory to hand to methods called often, one per thread."""
        return self._constraints.workspace()

    def closure_gap(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return how far the closures are open (..., 4, 3) [m], in the axes of the universe."""
        own = self._constraints.workspace(workspace)
        count = len(self.chain.closures)
        return over_batch(
            lambda q: (self._constraints.evaluate(q, own)[0],), ((count, 3),), q=self._read(q, "q", self.model.nq)
        )[0]

    def constraint_jacobian(self, q: npt.ArrayLike, *, workspace: Workspace | None = None) -> FloatArray:
        """Return the rates of `closure_gap` by joint velocities, shape (..., 12, nv)."""
        own = self._constraints.workspace(workspace)
        shape = (3 * len(self.chain.closures), self.model.nv)
        return over_batch(
            lambda q: (self._constraints.evaluate(q, own)[1],), (shape,), q=self._read(q, "q", self.model.nq)
        )[0]

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
        """Return the accelerations (..., nv) under actuators, gravity and wrenches.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Of the model.
        v : array_like, shape (..., nv)
            Its rates.
        forces : array_like, shape (..., n)
            Of all actuators in the order of `actuated_indices`: the other robot's, then the legs.
        wrench, gains
            As in `ClosedChain.forward_dynamics`; in the axes of the universe.

        Raises
        ------
        ArgumentError, ClosureError, SingularConfigurationError
            As `ClosedChain.forward_dynamics`.
        """
        given = read_gains(gains)
        own, alone = self._constraints.workspace(workspace), self._alone.workspace()
        frames, wrenches = self._wrenches(wrench)
        actuated = self.actuated_indices

        def member(q: FloatArray, v: FloatArray, f: FloatArray, w: FloatArray) -> tuple[FloatArray]:
            require_constrained(self._linearization(q, alone).scaled_closures())
            gap, jacobian = self._constraints.evaluate(q, own)
            if given is None:
                require_closed(gap, jacobian, v, self.chain.geometry.middle_side)
            torques = wrench_torques(self.model, zip(frames, w.reshape(-1, 6), strict=True), own)
            torques[actuated] += f
            return (self._constraints.accelerations(q, v, torques, given or (0.0, 0.0), own),)

        read = self._read(q, "q", self.model.nq), self._read(v, "v", self.model.nv)
        force = self._read(forces, "forces", actuated.size)
        return over_batch(member, ((self.model.nv,),), q=read[0], v=read[1], forces=force, wrench=wrenches)[0]

    def inverse_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        a: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        workspace: Workspace | None = None,
    ) -> FloatArray:
        """Return the forces of all actuators (..., n), in the order of `actuated_indices`, of a motion.

        Parameters
        ----------
        q, v, a : array_like, shapes (..., nq), (..., nv), (..., nv)
            Of the model, closed.
        wrench
            As in `ClosedChain.forward_dynamics`; in the axes of the universe.

        Raises
        ------
        ArgumentError, ClosureError, SingularConfigurationError
            As `ClosedChain.inverse_dynamics`.
        """
        own, alone = self._constraints.workspace(workspace), self._alone.workspace()
        frames, wrenches = self._wrenches(wrench)
        side = self.chain.geometry.middle_side

        def member(q: FloatArray, v: FloatArray, a: FloatArray, w: FloatArray) -> tuple[FloatArray]:
            gap, jacobian = self._constraints.evaluate(q, own)
            require_closed(gap, jacobian, v, side)
            torques = tree_torques(self.model, q, v, a, zip(frames, w.reshape(-1, 6), strict=True), own)
            require_closed_accelerations(jacobian, self._constraints.drift(q, v, own), v, a, side)
            # Forces in the chain's own balls do no work on the other robot: its joints carry the tree's torques.
            legs = balanced_legs(self._linearization(q, alone), torques[self._v])
            return (np.concatenate([torques[self._other_v], legs]),)

        states = {"q": self._read(q, "q", self.model.nq)}
        states |= {name: self._read(value, name, self.model.nv) for name, value in (("v", v), ("a", a))}
        return over_batch(member, ((self.actuated_indices.size,),), **states, wrench=wrenches)[0]

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike, *, workspace: Workspace | None = None) -> Energy:
        """Return the kinetic and the potential energy [J] of both robots."""
        own = self._constraints.workspace(workspace)
        read = {"q": self._read(q, "q", self.model.nq), "v": self._read(v, "v", self.model.nv)}
        found = over_batch(lambda q, v: energy_of(self.model, q, v, own), ((), ()), **read)
        return Energy(*(float(part) if part.ndim == 0 else part for part in found))

    def _linearization(self, q: FloatArray, workspace: Workspace) -> Linearization:
        """Return the velocities of the chain by itself: how it is carried is nothing to its loops."""
        return Linearization.at(q[self._q], self._placement, self._alone, workspace)

    def _wrenches(self, wrench: WrenchLike) -> tuple[list[int], FloatArray]:
        return read_wrenches(self.model, wrench, self._placement.model.frames[self._placement.platform].name)

    @staticmethod
    def _read(value: npt.ArrayLike, argument: str, size: int) -> FloatArray:
        return real_array(value, argument, (size,), "in Pinocchio's order")

    @staticmethod
    def _together(
        parts: tuple[FloatArray, FloatArray], places: tuple[npt.NDArray[np.intp], ...], size: int
    ) -> FloatArray:
        try:
            shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
        except ValueError:
            expected = f"leading axes that broadcast with {parts[0].shape[:-1]}"
            raise ArgumentError("chain", expected, f"shape {parts[1].shape}") from None
        whole = np.empty((*shape, size))
        for part, place in zip(parts, places, strict=True):
            whole[..., place] = part
        return whole


def wrapped(robot: Any) -> Any:
    """Return a `pinocchio.RobotWrapper` of a model or of a wrapper, or raise `ArgumentError`."""
    if isinstance(robot, pin.RobotWrapper):
        return robot
    if isinstance(robot, pin.Model):
        return pin.RobotWrapper(robot)
    cause = "Its loops would be lost" if isinstance(getattr(robot, "closures", None), tuple) else ""
    raise ArgumentError("other", "a pinocchio.Model or a pinocchio.RobotWrapper", type(robot).__name__, cause)


def joined(parent: Any, child: Any, frame: str, placement: Any) -> tuple[Any, Any, Any]:
    """Return one model of two trees, and its collision and visual shapes.

    `parent` and `child` are `pinocchio.RobotWrapper`; the shapes are None where one of them has none.
    """
    if not parent.model.existFrame(frame):
        cause = "The name of a link or another frame of the robot that carries"
        raise ArgumentError("frame", f"a frame of {parent.model.name}", repr(frame), cause)
    where = pin.SE3.Identity() if placement is None else placement
    if not isinstance(where, pin.SE3):
        raise ArgumentError("placement", "a pinocchio.SE3", type(where).__name__)
    index = parent.model.getFrameId(frame)
    names = [{*robot.model.names, *(f.name for f in robot.model.frames)} for robot in (parent, child)]
    both = sorted((names[0] & names[1]) - {"universe"})
    if both:
        cause = "Give the chain a prefix: ClosedChain.from_urdf(prefix='spm_')"
        raise ArgumentError("other", "names that the chain has not", ", ".join(both[:3]), cause)
    shapes = []
    model = pin.appendModel(parent.model, child.model, index, where)
    for kind in ("collision_model", "visual_model"):
        pair = getattr(parent, kind), getattr(child, kind)
        known = all(shape is not None for shape in pair)
        shapes.append(pin.appendModel(parent.model, child.model, *pair, index, where)[1] if known else None)
    return model, shapes[0], shapes[1]
