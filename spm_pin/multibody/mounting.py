"""A chain in one model with another robot: on an arm's tool, or with an arm on its platform."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, broadcastable
from spm_pin.multibody.batches import BatchedStates
from spm_pin.multibody.constrained_model import ConstrainedModel
from spm_pin.multibody.dynamics import Energy
from spm_pin.multibody.joint_layout import JointLayout
from spm_pin.multibody.state import ConstrainedState, Gains, WrenchLike, read

__all__ = ["MountedChain", "joined", "wrapped"]

Indices = npt.NDArray[np.intp]


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

    def __init__(self, chain: Any, other: Any, model: Any, collisions: Any, visuals: Any) -> None:
        self.chain, self.model = chain, model
        self._other, self._shapes = other, (collisions, visuals)
        layout = JointLayout(model, chain.geometry, chain.prefix)
        self._constrained = constrained = ConstrainedModel(model, layout, chain.closures)
        self._states = BatchedStates(lambda: ConstrainedState(constrained), self._checked)
        self._q, self._v = self._places(chain.model)
        self._other_q, self._other_v = self._places(other)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return type(self), (self.chain, self._other, self.model, *self._shapes)

    def __repr__(self) -> str:
        return f"<MountedChain: {self.chain!r} and {self._other.name}, {self.model.nv} degrees of freedom of the tree>"

    def _places(self, tree: Any) -> tuple[Indices, Indices]:
        """Return where the q and the v of one of the two trees are, in its own order."""
        q, v = np.empty(tree.nq, dtype=np.intp), np.empty(tree.nv, dtype=np.intp)
        for part in tree.joints[1:]:
            joint = self.model.joints[self.model.getJointId(tree.names[part.id])]
            q[part.idx_q : part.idx_q + part.nq] = joint.idx_q + np.arange(part.nq)
            v[part.idx_v : part.idx_v + part.nv] = joint.idx_v + np.arange(part.nv)
        return q, v

    def _checked(self, q: npt.ArrayLike) -> FloatArray:
        array = self._read(q, "q", self.model.nq)
        self._constrained.layout.checked(array[..., self._constrained.layout.q])
        return array

    @property
    def chain_indices(self) -> Indices:
        """Indices of the chain's joints in v, in the order of `chain.joint_names`, shape (18,)."""
        return self._v.copy()

    @property
    def other_indices(self) -> Indices:
        """Indices of the other robot's degrees of freedom in v, in that robot's order."""
        return self._other_v.copy()

    @property
    def actuated_indices(self) -> Indices:
        """Indices of the actuators in v: all of the other robot's, then the six legs."""
        return self._constrained.actuated.copy()

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
        return pin.RobotWrapper(self.model, *self._shapes)

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ConstrainedState:
        """Return the state of joint values q (nq,) and velocities v (nv,), by default at rest."""
        return ConstrainedState(self._constrained).update(q, v)

    def closure_gap(self, q: npt.ArrayLike) -> FloatArray:
        """Return how far the closures are open (..., 4, 3) [m], in the axes of the universe."""
        return self._states.closure_gap(q)

    def constraint_jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return the rates of `closure_gap` by joint velocities, shape (..., 12, nv)."""
        return self._states.constraint_jacobian(q)

    def forward_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        forces: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        gains: Gains = None,
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
        return self._states.forward_dynamics(q, v, forces, wrench, gains)

    def inverse_dynamics(
        self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, wrench: WrenchLike = None
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
        return self._states.inverse_dynamics(q, v, a, wrench)

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike) -> Energy:
        """Return the kinetic and the potential energy [J] of both robots."""
        return self._states.energy(q, v)

    @staticmethod
    def _read(value: npt.ArrayLike, argument: str, size: int) -> FloatArray:
        return read(value, argument, size, "in Pinocchio's order")

    @staticmethod
    def _together(parts: tuple[FloatArray, FloatArray], places: tuple[Indices, Indices], size: int) -> FloatArray:
        shape = broadcastable("chain", parts[1].shape[:-1], "other", parts[0].shape[:-1])
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
