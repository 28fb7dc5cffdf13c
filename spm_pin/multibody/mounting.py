"""A chain in one model with another robot: on an arm's tool, or with an arm on its platform."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.multibody.chain_state import ConstrainedState
from spm_pin.multibody.constrained_model import ConstrainedModel, read_vectors
from spm_pin.support.arguments import FloatArray, IntArray, broadcastable, frozen


class MountedChain:
    """A `ClosedChain` and another robot in one Pinocchio model, the loops closed; read-only.

    Made by `ClosedChain.mounted_on` and `ClosedChain.carrying`. The universe is that of whichever robot carries the
    other: all that is "in {B}" for a chain alone is in its axes here. q, nq and nv are those of `model`. The n
    actuators are all of the other robot's, then the legs. Leading axes broadcast.

    Attributes
    ----------
    chain : ClosedChain
        The chain by itself.
    model : pinocchio.Model
        Both trees; do not change it.
    chain_indices, other_indices : ndarray
        Indices in v of the chain's joints (joints,) and of the other robot's degrees of freedom, each in its own order.
    actuated_indices : ndarray
        Indices of the actuators in v.
    """

    def __init__(self, chain: Any, other: Any, model: Any, collisions: Any, visuals: Any) -> None:
        self._constrained = ConstrainedModel(model, chain.closures, chain.machine, chain.prefix)
        self.chain, self.model = chain, self._constrained.model
        self._other, self._shapes = other, (collisions, visuals)
        self._q, self.chain_indices = self._places(chain.model)
        self._other_q, self.other_indices = self._places(other)
        self.actuated_indices = self._constrained.actuated

    def __repr__(self) -> str:
        return f"<MountedChain: {self.chain!r} and {self._other.name}, {self.model.nv} degrees of freedom of the tree>"

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ConstrainedState:
        """Return the state of joint values q (..., nq) and velocities v (..., nv), by default at rest."""
        return ConstrainedState(self._constrained).update(q, v)

    def _places(self, tree: Any) -> tuple[IntArray, IntArray]:
        """Return the indices in q and in v of the joints of one of the two trees, in its own order."""
        q, v = np.empty(tree.nq, dtype=np.intp), np.empty(tree.nv, dtype=np.intp)
        for part in tree.joints[1:]:
            joint = self.model.joints[self.model.getJointId(tree.names[part.id])]
            q[part.idx_q : part.idx_q + part.nq] = joint.idx_q + np.arange(part.nq)
            v[part.idx_v : part.idx_v + part.nv] = joint.idx_v + np.arange(part.nv)
        return frozen(q), frozen(v)

    def join(self, other: npt.ArrayLike, chain: npt.ArrayLike) -> FloatArray:
        """Return q (..., nq) of the model from the other robot's q and the chain's (..., joints)."""
        return _joined(other, self._other_q, chain, self._q)

    def join_velocities(self, other: npt.ArrayLike, chain: npt.ArrayLike) -> FloatArray:
        """Return v (..., nv), or accelerations, from the other robot's and the chain's (..., joints)."""
        return _joined(other, self.other_indices, chain, self.chain_indices)

    def split(self, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the other robot's q and the chain's (..., joints) from q (..., nq) of the model."""
        array = read_vectors(q, "q", self.model.nq)
        return array[..., self._other_q], array[..., self._q]

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of both trees, with the shapes of both where they are known."""
        return pin.RobotWrapper(self.model, *self._shapes)


def _joined(other: npt.ArrayLike, other_places: IntArray, chain: npt.ArrayLike, places: IntArray) -> FloatArray:
    """Return vectors of the model from those of the other robot and of the chain."""
    parts = read_vectors(other, "other", other_places.size), read_vectors(chain, "chain", places.size)
    shape = broadcastable("chain", parts[1].shape[:-1], "other", parts[0].shape[:-1])
    joined = np.empty((*shape, other_places.size + places.size))
    joined[..., other_places], joined[..., places] = parts
    return joined


def mount(chain: Any, other: Any, frame: str, placement: Any, *, carried: bool) -> MountedChain:
    """Return a chain on another robot or with it; see `ClosedChain.mounted_on` and `ClosedChain.carrying`."""
    if isinstance(other, pin.Model):
        other = pin.RobotWrapper(other)
    if not isinstance(other, pin.RobotWrapper):
        cause = "Its loops would be lost" if isinstance(other, type(chain) | MountedChain) else ""
        raise ArgumentError("other", "a pinocchio.Model or a pinocchio.RobotWrapper", type(other).__name__, cause)
    robots = chain.robot_wrapper(), other
    parent, child = robots if carried else robots[::-1]
    if not parent.model.existFrame(frame):
        cause = "The name of a link or another frame of the robot that carries"
        raise ArgumentError("frame", f"a frame of {parent.model.name}", repr(frame), cause)
    if placement is not None and not isinstance(placement, pin.SE3):
        raise ArgumentError("placement", "a pinocchio.SE3", type(placement).__name__)
    names = [{*robot.model.names, *(f.name for f in robot.model.frames)} for robot in robots]
    both = sorted((names[0] & names[1]) - {"universe"})
    if both:
        cause = "Give the chain a prefix: ClosedChain.from_urdf(prefix='spm_')"
        raise ArgumentError("other", "joint and frame names that the chain does not have", ", ".join(both[:3]), cause)
    models, place = (parent.model, child.model), (parent.model.getFrameId(frame), placement or pin.SE3.Identity())
    shapes = []
    for kind in ("collision_model", "visual_model"):
        pair = getattr(parent, kind), getattr(child, kind)
        known = all(shape is not None for shape in pair)
        shapes.append(pin.appendModel(*models, *pair, *place)[1] if known else None)
    return MountedChain(chain, other.model, pin.appendModel(*models, *place), *shapes)
