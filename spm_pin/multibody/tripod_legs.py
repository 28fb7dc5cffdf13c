"""The three legs of a tripod in any closed chain: which joints each has, in order from the base to the platform."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spm_pin.errors import DescriptionError
from spm_pin.loops.closed_chain import ClosedChain as LoopChain
from spm_pin.loops.closures import Anchor, find_frame
from spm_pin.support.arguments import FloatArray

LETTERS = {"hinge": "R", "slide": "P", "ball": "S"}
"""Letters of the kinds of joints in the names of legs."""
_FREE = 6
"""Degrees of freedom of a path of joints that does not constrain the body at its end."""
_ZERO = 1e-12
"""Largest component of a unit twist that counts as zero."""


class LegJoint(NamedTuple):
    """A joint of a leg in the closed home."""

    name: str
    kind: str
    """"hinge", "slide" or "ball"; for a joint that no leg has the name of its class in Pinocchio, or of a closure."""
    dof: int
    axis: FloatArray
    """Unit vector in the world along which the side of the platform turns or moves; zero for a ball."""
    point: FloatArray
    """Point of the axis, or the centre of the ball, in the world [m]."""


class Tripod(NamedTuple):
    """The legs of a tripod that stands on the world, and its platform."""

    legs: tuple[tuple[LegJoint, ...], ...]
    """Three joints of each leg, from the base to the platform."""
    platform: frozenset[int]
    """Numbers of the joints of Pinocchio that carry the platform's bodies."""


class _Edge(NamedTuple):
    ends: tuple[int, int]
    joint: LegJoint


_Path = list[tuple[int, _Edge]]
"""Edges, each with the body at its near end."""


def find_legs(chain: LoopChain, q: FloatArray, tolerance: float) -> Tripod:
    """Return the legs at closed joint values q (nq,); raise `DescriptionError` unless there are three like a stage's.

    Free bodies and all that does not tie the platform to the base are left out. Three hinges in a row whose axes meet
    within `tolerance` [m] are a ball.
    """
    owners, edges = _graph(chain, q)
    base = owners[0]
    while True:
        edges = _without_ends(edges)
        paths = list(_paths(edges, base))
        free = {id(edge) for path in paths if _is_free(path, chain) for _, edge in path}
        if not free:
            break
        edges = [edge for edge in edges if id(edge) not in free]
    tips = {_far(*path[-1]) for path in paths}
    junctions = {node for node, count in _degrees(edges).items() if count > 2}
    if len(paths) != 3 or len(tips) != 1 or base in tips or junctions != {base, *tips}:
        received = f"{len(paths)} legs"
        if paths:
            received += ": " + "; ".join(_names(edge.joint for _, edge in path) for path in paths)
        cause = "Links between legs or more platforms?" if len(paths) == 3 else ""
        if not paths:
            cause = "The base must be fixed to the world: without a free joint, and not on an arm"
        raise DescriptionError("chain", "three legs from the world to one platform", received, cause)
    legs = tuple(_leg([_seen_from(near, edge) for near, edge in path], chain, tolerance) for path in paths)
    return Tripod(legs, frozenset(joint for joint, owner in enumerate(owners) if owner in tips))


def _graph(chain: LoopChain, q: FloatArray) -> tuple[list[int], list[_Edge]]:
    """Return the body that each joint of Pinocchio carries, welded ones as one, and the joints between bodies."""
    model = chain.model
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    owners, numbers = list(range(model.njoints)), range(1, model.njoints)
    edges = [_Edge((model.parents[joint], joint), _tree_joint(model, data, joint)) for joint in numbers]

    def anchored(anchor: Anchor) -> tuple[int, pin.SE3]:
        frame = find_frame(model, anchor.frame)
        return model.frames[frame].parentJoint, data.oMf[frame] * anchor.placement

    for closure in chain.closures:
        (first, place), (second, _) = anchored(closure.first), anchored(closure.second)
        if closure.kind == "weld":
            kept, gone = owners[first], owners[second]
            owners = [kept if owner == gone else owner for owner in owners]
            continue
        kind, dof = {"point": ("ball", 3), "hinge": ("hinge", 1), "planar": ("planar closure", 4)}[closure.kind]
        axis = place.rotation[:, 2] if kind == "hinge" else np.zeros(3)
        edges.append(_Edge((first, second), LegJoint(closure.name, kind, dof, axis, place.translation)))
    named = [_Edge((owners[edge.ends[0]], owners[edge.ends[1]]), edge.joint) for edge in edges]
    return owners, [edge for edge in named if edge.ends[0] != edge.ends[1]]


def _tree_joint(model: pin.Model, data: pin.Data, number: int) -> LegJoint:
    joint = model.joints[number]
    columns = pin.getJointJacobian(model, data, number, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    twists = columns[:, joint.idx_v : joint.idx_v + joint.nv]
    moves, turns = (bool(np.abs(part).max() > _ZERO) for part in (twists[:3], twists[3:]))
    kind, axis = joint.shortname(), np.zeros(3)
    if joint.nv == 1 and moves != turns:
        kind, axis = ("slide", twists[:3, 0]) if moves else ("hinge", twists[3:, 0])
    elif joint.nv == 3 and not moves:
        kind = "ball"
    return LegJoint(str(model.names[number]), kind, joint.nv, axis, data.oMi[number].translation.copy())


def _degrees(edges: Iterable[_Edge]) -> Counter[int]:
    return Counter(end for edge in edges for end in edge.ends)


def _without_ends(edges: list[_Edge]) -> list[_Edge]:
    """Return the joints that are in loops or between them."""
    while True:
        degrees = _degrees(edges)
        kept = [edge for edge in edges if min(degrees[end] for end in edge.ends) > 1]
        if len(kept) == len(edges):
            return kept
        edges = kept


def _paths(edges: list[_Edge], base: int) -> Iterator[_Path]:
    """Yield the paths from the base to the next body with other than two joints, or back to the base."""
    degrees, started = _degrees(edges), set[int]()
    for first in edges:
        if base not in first.ends or id(first) in started:
            continue
        near, edge, path = base, first, _Path()
        while True:
            path.append((near, edge))
            near = _far(near, edge)
            if near == base or degrees[near] != 2:
                break
            edge = next(other for other in edges if near in other.ends and other is not edge)
        started.add(id(edge))
        yield path


def _far(near: int, edge: _Edge) -> int:
    return edge.ends[1] if edge.ends[0] == near else edge.ends[0]


def _is_free(path: _Path, chain: LoopChain) -> bool:
    joints = [edge.joint for _, edge in path]
    return sum(joint.dof for joint in joints) >= _FREE and not any(joint.name in chain.actuated for joint in joints)


def _seen_from(near: int, edge: _Edge) -> LegJoint:
    """Return a joint with the sense in which its far side moves."""
    return edge.joint if edge.ends[0] == near else edge.joint._replace(axis=-edge.joint.axis)


def _names(joints: Iterable[LegJoint]) -> str:
    return ", ".join(f"{joint.kind} {joint.name}" for joint in joints)


def _leg(joints: list[LegJoint], chain: LoopChain, tolerance: float) -> tuple[LegJoint, ...]:
    """Return the three joints of a leg, three hinges that meet in one point as a ball."""
    own = {joint.name for joint in joints}
    if len(joints) == 5 and all(joint.kind == "hinge" for joint in joints[2:]):
        centre = _common_point(joints[2:], tolerance)
        if centre is not None:
            ball = LegJoint("+".join(joint.name for joint in joints[2:]), "ball", 3, np.zeros(3), centre)
            joints = [*joints[:2], ball]
    letters = "".join(LETTERS.get(joint.kind, "?") for joint in joints)
    if letters not in ("RPS", "PRS", "RRS"):
        cause = "The ball is at the base: turned over, this is a stage" if letters in ("SPR", "SRP", "SRR") else ""
        expected = "legs of hinge, slide and ball (RPS), slide, hinge and ball (PRS) or two hinges and a ball (RRS)"
        raise DescriptionError("chain", expected, _names(joints), cause)
    driven = [joint.name for joint in joints if joint.name in chain.actuated]
    wanted = joints[letters.index("P") if "P" in letters else 0].name
    if driven != [wanted]:
        cause = "The argument actuated of ClosedChain and of its readers names the motors"
        received = ", ".join(map(repr, driven)) or "no actuator"
        raise DescriptionError("chain", f"an actuator of {wanted!r} in its {letters} leg", received, cause)
    tied = own & {name for equality in chain.equalities for name in (equality.joint, equality.driver)}
    if tied:
        received = f"a joint equality of {', '.join(sorted(map(repr, tied)))}"
        raise DescriptionError("chain", "legs whose joints move independently", received)
    return tuple(joints)


def _common_point(hinges: list[LegJoint], tolerance: float) -> FloatArray | None:
    """Return the point where three axes meet, None if they do not, or lie in one plane."""
    axes = np.array([hinge.axis for hinge in hinges])
    if abs(np.linalg.det(axes)) < 1e-6:
        return None
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    points = np.array([hinge.point for hinge in hinges])
    rows, right = across.reshape(9, 3), (across @ points[..., None]).reshape(9)
    centre = np.linalg.lstsq(rows, right, rcond=None)[0]
    return centre if np.abs(rows @ centre - right).max() <= tolerance else None
