"""A chain in one model with another robot: on an arm's tool, or with an arm on its platform."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, IntArray, broadcastable
from spm_pin.multibody.chain_state import ConstrainedState, Energy, ThreadState
from spm_pin.multibody.constrained_model import ConstrainedModel
from spm_pin.multibody.vector_arguments import GainsLike, WrenchLike, read_vectors


class MountedChain:
    """A `ClosedChain` and another robot in one Pinocchio model, the loops closed; read-only.

    Made by `ClosedChain.mounted_on` and `ClosedChain.carrying`. Its q is that of `model`; `join` and `split` put it
    together from the other robot's and the chain's and take it apart. Leading axes broadcast. The universe is that of
    whichever robot carries the other: all that is "in {B}" for a chain alone is in its axes here. Actuators are all of
    the other robot's, then the six legs: `actuated_indices`. nq, nv and the number n of actuators are those of `model`.
    The methods that a chain has too are described there.

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
        self._constrained = ConstrainedModel(model, chain.closures, chain.geometry, chain.prefix)
        self._calls = ThreadState(ConstrainedState, self._constrained)
        self._q, self._v = self._places(chain.model)
        self._other_q, self._other_v = self._places(other)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return type(self), (self.chain, self._other, self.model, *self._shapes)

    def __repr__(self) -> str:
        return f"<MountedChain: {self.chain!r} and {self._other.name}, {self.model.nv} degrees of freedom of the tree>"

    def _places(self, tree: Any) -> tuple[IntArray, IntArray]:
        """Return the indices in q and in v of the joints of one of the two trees, in its own order."""
        q, v = np.empty(tree.nq, dtype=np.intp), np.empty(tree.nv, dtype=np.intp)
        for part in tree.joints[1:]:
            joint = self.model.joints[self.model.getJointId(tree.names[part.id])]
            q[part.idx_q : part.idx_q + part.nq] = joint.idx_q + np.arange(part.nq)
            v[part.idx_v : part.idx_v + part.nv] = joint.idx_v + np.arange(part.nv)
        return q, v

    @property
    def chain_indices(self) -> IntArray:
        """Indices of the chain's joints in v, in the order of `chain.joint_names`, shape (18,)."""
        return self._v.copy()

    @property
    def other_indices(self) -> IntArray:
        """Indices of the other robot's degrees of freedom in v, in that robot's order."""
        return self._other_v.copy()

    @property
    def actuated_indices(self) -> IntArray:
        """Indices of the actuators in v: all of the other robot's, then the six legs."""
        return self._constrained.actuated.copy()

    def join(self, other: npt.ArrayLike, chain: npt.ArrayLike) -> FloatArray:
        """Return q (..., nq) of the model from the other robot's q and the chain's (..., 18)."""
        return _together(other, self._other_q, chain, self._q)

    def join_velocities(self, other: npt.ArrayLike, chain: npt.ArrayLike) -> FloatArray:
        """Return v (..., nv), or accelerations, from the other robot's and the chain's (..., 18)."""
        return _together(other, self._other_v, chain, self._v)

    def split(self, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the other robot's q and the chain's (..., 18) from q (..., nq) of the model."""
        array = read_vectors(q, "q", self.model.nq)
        return array[..., self._other_q], array[..., self._q]

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of both trees, with the shapes of both where they are known."""
        return pin.RobotWrapper(self.model, *self._shapes)

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ConstrainedState:
        """Return the state of joint values q (..., nq) and velocities v (..., nv), by default at rest."""
        return ConstrainedState(self._constrained).update(q, v)

    def _at(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ConstrainedState:
        """Return the state that calls of this thread compute in, moved to q and v."""
        state: ConstrainedState = self._calls.state
        return state.update(q, v)

    def closure_gap(self, q: npt.ArrayLike) -> FloatArray:
        """Return how far the closures are open, in the universe's axes [m], shape (..., 4, 3)."""
        return self._at(q).closure_gap()

    def constraint_jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return the derivative of `closure_gap` by q, shape (..., 12, nv)."""
        return self._at(q).constraint_jacobian()

    def forward_dynamics(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        forces: npt.ArrayLike,
        wrench: WrenchLike = None,
        *,
        gains: GainsLike = None,
    ) -> FloatArray:
        """Return the accelerations of all joints (..., nv) under actuators (..., n), gravity and wrenches."""
        return self._at(q, v).forward_dynamics(forces, wrench, gains=gains)

    def inverse_dynamics(
        self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, wrench: WrenchLike = None
    ) -> FloatArray:
        """Return the forces of the actuators (..., n) [N, N m] for a motion under gravity, inertia and wrenches."""
        return self._at(q, v).inverse_dynamics(a, wrench)

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike) -> Energy:
        """Return the kinetic and the potential energy (...) [J] of all bodies."""
        return self._at(q, v).energy()


def _together(other: npt.ArrayLike, other_place: IntArray, chain: npt.ArrayLike, place: IntArray) -> FloatArray:
    """Return vectors of the model from those of the other robot and of the chain."""
    parts = read_vectors(other, "other", other_place.size), read_vectors(chain, "chain", place.size)
    shape = broadcastable("chain", parts[1].shape[:-1], "other", parts[0].shape[:-1])
    whole = np.empty((*shape, other_place.size + place.size))
    whole[..., other_place], whole[..., place] = parts
    return whole


def mount(chain: Any, other: Any, frame: str, placement: Any, *, carried: bool) -> MountedChain:
    """Return a chain on another robot or with it; see `ClosedChain.mounted_on` and `ClosedChain.carrying`."""
    if isinstance(other, pin.Model):
        other = pin.RobotWrapper(other)
    if not isinstance(other, pin.RobotWrapper):
        cause = "Its loops would be lost" if isinstance(other, MountedChain | type(chain)) else ""
        raise ArgumentError("other", "a pinocchio.Model or a pinocchio.RobotWrapper", type(other).__name__, cause)
    robots = chain.robot_wrapper(), other
    parent, child = robots if carried else robots[::-1]
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
    return MountedChain(chain, other.model, model, *shapes)
