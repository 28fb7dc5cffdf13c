"""Links, joints and frames of a robot as plain data, and the `pinocchio.Model` that is made of them."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.loops.closures import Anchor, Closure, JointEquality, RobotDescription
from spm_pin.loops.constraint_rows import ConstraintRows, scalar_joint
from spm_pin.support.arguments import FloatArray

JointKind = Literal["hinge", "slide", "ball", "free"]
_ALIGNED = {"hinge": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)}
_ALIGNED["slide"] = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
_ALONG = {"hinge": pin.JointModelRevoluteUnaligned, "slide": pin.JointModelPrismaticUnaligned}
_OTHERS = {"ball": pin.JointModelSpherical, "free": pin.JointModelFreeFlyer}


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint, its frame at `before` from the frame that it stands on; what it carries is at `after` from its frame."""

    name: str
    kind: JointKind
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    before: Any = field(default_factory=pin.SE3.Identity)
    after: Any = field(default_factory=pin.SE3.Identity)
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf
    velocity: float = np.inf
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0


@dataclass(frozen=True, eq=False)
class Link:
    """A body, at `placement` from its parent if its joints, one after another, are at zero; fixed without joints."""

    name: str
    parent: str | None
    """Name of the link that carries it; None for the world."""
    placement: Any
    joints: tuple[Joint, ...] = ()
    inertia: Any = field(default_factory=pin.Inertia.Zero)


def place(position: Any = (0.0, 0.0, 0.0), rotation: Any = None) -> Any:
    """Return a `pinocchio.SE3` of a position (3,) and a rotation matrix (3, 3)."""
    return pin.SE3(np.eye(3) if rotation is None else np.asarray(rotation), np.asarray(position, dtype=float))


def build_model(name: str, links: Iterable[Link], sites: Mapping[str, tuple[str | None, Any]], source: str) -> Any:
    """Return the model of links, parents first and depth first, with a frame for each link and each site.

    Parameters
    ----------
    sites : mapping
        Further frames by name: the link that each is fixed to, None for the world, and its placement there.
    """
    links = list(links)
    joints = [joint.name for link in links for joint in link.joints]
    bodies = [link.name for link in links]
    for what, names in (("joint", joints), ("link or site", [*bodies, *sites, "universe"])):
        check_unique(names, what, source)
    model = pin.Model()
    model.name = name
    # The joint that moves a link, the link's placement in its frame, and the number of its frame.
    carriers: dict[str | None, tuple[int, Any, int]] = {None: (0, pin.SE3.Identity(), 0)}
    reserved = {*bodies, *sites}
    for link in links:
        parent, placement, frame = carriers[link.parent]
        placement = placement * link.placement
        for joint in link.joints:
            parent = _add_joint(model, parent, joint, placement * joint.before)
            placement = joint.after
            # A name that a link has too stands for the link.
            if joint.name not in reserved:
                made = pin.Frame(joint.name, parent, frame, pin.SE3.Identity(), pin.FrameType.JOINT)
                frame = model.addFrame(made)
        made = pin.Frame(link.name, parent, frame, placement, pin.FrameType.BODY, link.inertia)
        carriers[link.name] = parent, placement, model.addFrame(made)
    for site, (carrier, at) in sites.items():
        parent, placement, frame = carriers[carrier]
        model.addFrame(pin.Frame(site, parent, frame, placement * at, pin.FrameType.OP_FRAME))
    return model


def _add_joint(model: Any, parent: int, joint: Joint, placement: Any) -> int:
    axis = np.array(joint.axis) / (np.linalg.norm(joint.axis) or 1.0)
    if joint.kind in _OTHERS:
        kind = _OTHERS[joint.kind]()
    elif axis.max() == 1.0:
        kind = _ALIGNED[joint.kind][int(axis.argmax())]()
    else:
        kind = _ALONG[joint.kind](axis)
    index = int(model.addJoint(parent, kind, placement, joint.name))
    rows = slice(model.joints[index].idx_v, model.joints[index].idx_v + kind.nv)
    if kind.nq == 1:
        model.lowerPositionLimit[model.joints[index].idx_q] = joint.lower
        model.upperPositionLimit[model.joints[index].idx_q] = joint.upper
    model.lowerEffortLimit[rows], model.upperEffortLimit[rows] = -joint.effort, joint.effort
    model.lowerVelocityLimit[rows], model.upperVelocityLimit[rows] = -joint.velocity, joint.velocity
    model.lowerDryFrictionLimit[rows], model.upperDryFrictionLimit[rows] = -joint.friction, joint.friction
    model.armature[rows], model.damping[rows] = joint.armature, joint.damping
    return index


def check_unique(names: Iterable[str], what: str, source: str) -> None:
    """Raise `DescriptionError` if a name occurs twice."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise DescriptionError(source, f"a different name for each {what}", ", ".join(map(repr, twice)))


@contextlib.contextmanager
def reading(source: str) -> Iterator[None]:
    """Raise errors of arguments as those of a file."""
    try:
        yield
    except ArgumentError as error:
        raise DescriptionError(f"{source}, {error.argument}", error.expected, error.received, error.cause) from error


def describe(
    model: Any,
    closures: Sequence[Closure],
    equalities: Sequence[JointEquality],
    actuated: Iterable[str],
    configurations: Mapping[str, FloatArray],
    source: str,
    rest: FloatArray | None = None,
) -> RobotDescription:
    """Return what a reader has found, if a chain can be made of it.

    q0 is the first configuration, without one the rest pose, by default Pinocchio's neutral one.
    """
    check_unique([closure.name for closure in closures if closure.name], "closure", source)
    q0 = next(iter(configurations.values()), pin.neutral(model) if rest is None else rest)
    names, loops = tuple(dict.fromkeys(actuated)), (tuple(closures), tuple(equalities))
    with reading(source):
        ConstraintRows(model, *loops, q0)
        for name in names:
            scalar_joint(model, name, "actuated")
    return RobotDescription(model, *loops, names, q0.copy(), dict(configurations), source)


def hinges_of_points(closures: Iterable[Closure]) -> list[Closure]:
    """Return closures in which two points between the same links, equally far apart on both, are a hinge."""
    closures = list(closures)
    by_links: dict[tuple[str, ...], list[Closure]] = {}
    for closure in closures:
        by_links.setdefault((closure.first.frame, closure.second.frame), []).append(closure)
    for pair in by_links.values():
        if [closure.kind for closure in pair] != ["point", "point"]:
            continue
        ends = [[getattr(c, end).placement for c in pair] for end in ("first", "second")]
        apart = [other.translation - one.translation for one, other in ends]
        sizes = [float(np.linalg.norm(direction)) for direction in apart]
        if min(sizes) < 1e-6 or abs(sizes[0] - sizes[1]) > 1e-9 * sizes[0]:
            continue
        anchors = []
        for closure_end, (one, _), direction, size in zip(("first", "second"), ends, apart, sizes, strict=True):
            turned = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction / size)
            anchors.append(Anchor(getattr(pair[0], closure_end).frame, place(one.translation, turned.matrix())))
        closures[closures.index(pair[0])] = Closure("hinge", anchors[0], anchors[1], pair[0].name)
        closures.remove(pair[1])
    return closures
