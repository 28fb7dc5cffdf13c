"""Any closed chain as MJCF, as URDF with its YAML file, and as SDF, with loops that other programs see.

Shapes are not part of a chain: the files have links, joints, masses, closures, joint equalities and actuators.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.loops.closures import Anchor, Closure, JointEquality, RobotDescription
from spm_pin.loops.links import JointKind, find_frame, place
from spm_pin.support.arguments import FloatArray, type_and_value
from spm_pin.support.xml_elements import document, element, texts

_URDF = {"hinge": "revolute", "slide": "prismatic", "free": "floating", "ball": "revolute"}
_SDF = {"hinge": "revolute", "slide": "prismatic", "ball": "ball"}
_YAML = {"point": "3d", "weld": "6d", "hinge": "hinge", "planar": "planar"}
_CLOSED = 1e-9
_ARM = 0.1
"""Distance of the points that stand for a hinge or a weld [m]."""


def _check_chain(chain: Any) -> None:
    from spm_pin.loops.closed_chain import ClosedChain

    if not isinstance(chain, ClosedChain | RobotDescription):
        raise ArgumentError("chain", "a ClosedChain or a RobotDescription", type_and_value(chain))


def mjcf_text(chain: Any) -> str:
    """Return a `ClosedChain` or `RobotDescription` as an MJCF file, which stands closed at its `q0`.

    Loops are anchored in bodies, so that Drake sees them too; in sites if the chain has ball joints that are turned at
    q0. A hinge becomes two points on its axis. q is the same vector, but MuJoCo has the scalar of quaternions first.
    """
    _check_chain(chain)
    robot = _Robot(chain, chain.q0, in_link_frames=True, merge=True)
    model = robot.model
    by_bodies = robot.is_closed_at_reference()
    welds: list[Element] = []
    for name, one, other in _pairs(robot, chain.closures, welds=False):
        ends = {"body1": one.frame, "body2": other.frame, "anchor": one.placement.translation}
        if not by_bodies:
            ends = {"site1": f"{name}_first", "site2": f"{name}_second"}
            for site, anchor in zip(ends.values(), (one, other), strict=True):
                robot.sites.append((str(site), anchor))
        welds.append(element("connect", name=name, **ends))
    for closure in chain.closures:
        if closure.kind == "weld":
            one, other = map(robot.anchor, (closure.first, closure.second))
            relative = one.placement * other.placement.inverse()
            welds.append(
                element(
                    "weld",
                    name=closure.name or None,
                    body1=one.frame,
                    body2=other.frame,
                    anchor=other.placement.translation,
                    relpose=(*one.placement.translation, *_scalar_first(relative.rotation)),
                )
            )
    for equality in chain.equalities:
        zeros = [robot.reference(joint) for joint in (equality.joint, equality.driver)]
        shifted = np.polynomial.Polynomial(equality.coefficients)(
            np.polynomial.Polynomial([zeros[1] - equality.driver_zero, 1.0])
        )
        coefficients = np.zeros(5)
        if shifted.degree() > 4:
            raise DescriptionError("chain", "joint equalities of a degree up to 4", f"{equality.joint!r}")
        coefficients[: len(shifted.coef)] = shifted.coef
        coefficients[0] += equality.zero - zeros[0]
        ends = {"joint1": equality.joint, "joint2": equality.driver}
        welds.append(element("joint", name=equality.name or None, polycoef=coefficients, **ends))
    keys = {"q0": chain.q0, **getattr(chain, "configurations", {})}
    root = element(
        "mujoco",
        element("compiler", angle="radian", autolimits="true", fusestatic="false"),
        element("option", gravity=model.gravity.linear),
        # Rigid closures, as stiff as steps of 1 ms allow.
        element("default", element("equality", solref="0.002 1", solimp="0.9999 0.9999 0.001 0.5 2")),
        element("worldbody", *robot.tree(None, _mjcf_body)),
        element("equality", *welds),
        element("actuator", *(element("motor", name=f"{joint}_motor", joint=joint) for joint in chain.actuated)),
        element("keyframe", *(element("key", name=name, qpos=_qpos(model, q)) for name, q in keys.items())),
        model=model.name or "robot",
    )
    return document(root)


def urdf_texts(chain: Any) -> tuple[str, str]:
    """Return a `ClosedChain` or `RobotDescription` as a URDF file, and the YAML file that closes its loops.

    The URDF also has Drake's ball constraints, if it has no ball joints: URDF has none, so that they are revolute
    joints there, and `SPHERICAL` in the YAML file. Joints that follow others are `mimic` joints.
    """
    _check_chain(chain)
    robot = _Robot(chain, pin.neutral(chain.model))
    balls = [name for name, kind in robot.kinds.items() if kind == "ball"]
    loops = []
    for count, closure in enumerate(chain.closures):
        names = []
        for anchor, end in ((closure.first, "first"), (closure.second, "second")):
            at = robot.anchor(anchor)
            name = at.frame
            if not at.placement.isIdentity(0.0) or name not in robot.links:
                name = f"{closure.name or f'closure{count}'}_{end}"
                robot.sites.append((name, at))
            names.append(name)
        loops.append((names, _YAML[closure.kind]))
    mimics = {}
    for equality in chain.equalities:
        offset, factor = _line(equality)
        mimics[equality.joint] = element("mimic", joint=equality.driver, multiplier=factor, offset=offset)
    parts: list[Element] = []
    roots = robot.roots()
    base = roots[0] if len(roots) == 1 and not robot.bodies[roots[0]].joints else "world"
    if base == "world":
        parts.append(element("link", name=base))
    for name, body in robot.bodies.items():
        parts.append(_urdf_link(name, body.inertia))
        if name != base:
            parts.append(_urdf_joint(robot, name, body, base, mimics))
    for name, anchor in robot.sites:
        parts.append(element("link", name=name))
        parts.append(_fixed(name, base if anchor.frame == "world" else anchor.frame, anchor.placement))
    for joint in chain.actuated:
        interface = element("hardwareInterface", text="hardware_interface/EffortJointInterface")
        kind = element("type", text="transmission_interface/SimpleTransmission")
        motor = element("actuator", element("mechanicalReduction", text="1"), name=f"{joint}_motor")
        parts.append(
            element("transmission", kind, element("joint", interface, name=joint), motor, name=f"{joint}_transmission")
        )
    if not balls:
        parts += _drake(robot, chain.closures, base, as_texts=False)
    root = element("robot", *parts, **{"name": chain.model.name or "robot", "xmlns:drake": "http://drake.mit.edu"})
    lists = {
        "closed_loop": [names for names, _ in loops],
        "type": [kind for _, kind in loops],
        "name_mot": list(chain.actuated),
        "joint_name": balls,
        "joint_type": ["SPHERICAL"] * len(balls),
    }
    return document(root), "".join(f"{key}: {value}\n" for key, value in lists.items())


def sdf_text(chain: Any) -> str:
    """Return a `ClosedChain` or `RobotDescription` as an SDF model, version 1.11.

    Loops are joints if they are closed when all joints are at zero, where an SDF model stands; otherwise Drake's ball
    constraints. Floating links stand where they do at q0. Joints that follow others have a `mimic`; actuated joints are
    those with a limit of effort.
    """
    _check_chain(chain)
    # An SDF file says where links float, and no other values.
    reference = pin.neutral(chain.model)
    for joint in chain.model.joints[1:]:
        if joint.nq == 7:
            reference[joint.idx_q : joint.idx_q + 7] = chain.q0[joint.idx_q : joint.idx_q + 7]
    robot = _Robot(chain, reference)
    mimics = {}
    for equality in chain.equalities:
        offset, factor = _line(equality)
        lines = texts(multiplier=factor, offset=offset, reference=0.0)
        mimics[equality.joint] = element("mimic", *lines, joint=equality.driver)
    parts: list[Element] = []
    for name, body in robot.bodies.items():
        parts += _sdf_body(robot, name, body, chain.actuated, mimics)
    if robot.is_closed_at_reference():
        for count, closure in enumerate(chain.closures):
            one, other = map(robot.anchor, (closure.first, closure.second))
            kind = {"point": "ball", "weld": "fixed"}.get(closure.kind, "revolute")
            axis = element("axis", *texts(xyz=(0.0, 0.0, 1.0))) if kind == "revolute" else None
            if other.frame == "world" or robot.floats(other.frame):
                one, other = other, one  # the child of a joint that closes a loop has a parent already
            ends = texts(parent=one.frame, child=other.frame)
            pose = element("pose", text=_xyzrpy(other.placement), relative_to=other.frame)
            parts.append(element("joint", pose, *ends, axis, name=closure.name or f"closure{count}", type=kind))
    else:
        parts += _drake(robot, chain.closures, "world", as_texts=True)
    model = element("model", *parts, name=chain.model.name or "robot")
    return document(element("sdf", model, **{"version": "1.11", "xmlns:drake": "http://drake.mit.edu"}))


class _Body(NamedTuple):
    """A link: its pose in the world at the reference, and the joints that move it against its parent."""

    parent: str  # "world" for none
    pose: Any
    joints: tuple[int, ...]
    inertia: Any


class _Robot:
    """The links of a chain in a configuration of reference, parents first."""

    def __init__(self, chain: Any, reference: FloatArray, *, in_link_frames: bool = False, merge: bool = False) -> None:
        model = self.model = chain.model
        self.chain, self.sites = chain, list[tuple[str, Anchor]]()
        self.q = np.array(reference)
        self.data = model.createData()
        for joint in model.joints[1:]:
            if joint.nq == 4:  # a file has no turned ball joints
                self.q[joint.idx_q : joint.idx_q + 4] = (0.0, 0.0, 0.0, 1.0)
        pin.framesForwardKinematics(model, self.data, self.q)
        self.kinds: dict[str, JointKind] = {model.names[i]: self._kind(i) for i in range(1, model.njoints)}
        self.bodies: dict[str, _Body] = {}
        self.links: set[str] = {"world"}
        owners = {0: "world"}
        pending: tuple[int, ...] = ()
        closed = {
            model.frames[find_frame(model, a.frame)].parentJoint for c in chain.closures for a in (c.first, c.second)
        }
        taken = {frame.name for frame in model.frames if frame.type != pin.FrameType.JOINT}
        for i in range(model.njoints):
            frames = [frame for frame in model.frames if frame.parentJoint == i and frame.type == pin.FrameType.BODY]
            frames = [frame for frame in frames if frame.name != "universe"]
            if i:
                pending = (*pending, i)
                alone = not frames and i not in closed and len(model.children[i]) == 1
                if merge and alone and not model.inertias[i].mass:
                    continue
                parent = owners[model.parents[pending[0]]]
                fitting = [f for f in frames if self._fits(i, f.placement, in_link_frames)]
                name = fitting[0].name if fitting else f"{model.names[i]}_link"
                while not fitting and name in taken:
                    name += "_"
                at = self.data.oMi[i] * (fitting[0].placement if fitting else pin.SE3.Identity())
                inertia = (at.inverse() * self.data.oMi[i]).act(model.inertias[i])
                self._add(name, _Body(parent, at, pending, inertia))
                owners[i], pending = name, ()
            for frame in frames:
                if frame.name not in self.bodies:
                    inertia = pin.Inertia.Zero()
                    self._add(frame.name, _Body(owners[i], self.data.oMi[i] * frame.placement, (), inertia))
        self.owners = owners

    def _add(self, name: str, body: _Body) -> None:
        self.bodies[name] = body
        self.links.add(name)

    def _kind(self, i: int) -> JointKind:
        joint = self.model.joints[i]
        directions = self.data.joints[i].S
        if joint.nv == 1 and not directions[:3].any():
            return "hinge"
        if joint.nv == 1 and not directions[3:].any():
            return "slide"
        name = joint.shortname()
        kinds: dict[str, JointKind] = {"JointModelSpherical": "ball", "JointModelFreeFlyer": "free"}
        if name not in kinds or joint.nq == joint.nv:
            expected = "joints that are hinges, slides, balls or free ones"
            raise DescriptionError("chain", expected, f"{self.model.names[i]!r}, a {name}")
        return kinds[name]

    def axis(self, i: int) -> FloatArray:
        """Return the axis of a joint in its own frame."""
        directions = self.data.joints[i].S.ravel()[:6]
        return np.asarray(directions[3:] if directions[3:].any() else directions[:3])

    def _fits(self, i: int, placement: Any, in_link_frames: bool) -> bool:
        """Return whether a link's frame may stand for the frame of the joint that carries it."""
        kind, at = self.kinds[self.model.names[i]], placement.translation
        if placement.isIdentity(0.0) or kind == "slide":
            return True
        if kind == "hinge":
            return in_link_frames or bool(np.linalg.norm(np.cross(self.axis(i), at)) < 1e-15)
        return kind == "ball" and in_link_frames and bool(np.array_equal(placement.rotation, np.eye(3)))

    def roots(self) -> list[str]:
        """Return the links that the world carries."""
        return [name for name, body in self.bodies.items() if body.parent == "world"]

    def floats(self, name: str) -> bool:
        """Return whether a link is moved by a free joint."""
        return any(self.kinds[self.model.names[i]] == "free" for i in self.bodies[name].joints)

    def pose(self, name: str) -> Any:
        """Return the pose of a link in the world."""
        return pin.SE3.Identity() if name == "world" else self.bodies[name].pose

    def placement(self, body: _Body) -> Any:
        """Return the placement of a link in its parent."""
        return self.pose(body.parent).inverse() * body.pose

    def anchor(self, anchor: Anchor) -> Anchor:
        """Return the same place on a link."""
        frame = self.model.frames[find_frame(self.model, anchor.frame)]
        name = frame.name if frame.name in self.bodies else self.owners[frame.parentJoint]
        at = self.data.oMi[frame.parentJoint] * frame.placement
        placement = self.pose(name).inverse() * at * anchor.placement
        return Anchor(name, anchor.placement if name == frame.name else placement)

    def reference(self, joint: str | None) -> float:
        """Return the value of a joint at the reference."""
        return 0.0 if joint is None else float(self.q[self.model.joints[self.model.getJointId(joint)].idx_q])

    def is_closed_at_reference(self) -> bool:
        """Return whether all loops are closed at the reference."""
        for closure in self.chain.closures:
            one, other = (self.pose(a.frame) * a.placement for a in map(self.anchor, (closure.first, closure.second)))
            apart = one.inverse() * other
            gaps = [*apart.translation[: 2 if closure.kind == "planar" else 3]]
            gaps += {"hinge": [*apart.rotation[:2, 2]], "weld": [*pin.log3(apart.rotation)]}.get(closure.kind, [])
            if np.abs(gaps).max() > _CLOSED:
                return False
        return True

    def tree(self, parent: str | None, make: Any) -> list[Element]:
        """Return the elements of the links that a link carries, and those of its sites."""
        name = parent or "world"
        found = [make(self, child, body) for child, body in self.bodies.items() if body.parent == name]
        for site, anchor in self.sites:
            if anchor.frame == name:
                at = _pos_quat(anchor.placement)
                found.append(element("site", name=site, size=0.005, **at))
        return found


def _pairs(robot: _Robot, closures: Sequence[Closure], *, welds: bool) -> Iterator[tuple[str, Anchor, Anchor]]:
    """Yield pairs of points that coincide in a closed chain: one for a point, two for a hinge, three for a weld."""
    for count, closure in enumerate(closures):
        one, other = map(robot.anchor, (closure.first, closure.second))
        directions = {"hinge": [[0.0, 0.0, _ARM]], "weld": [[_ARM, 0.0, 0.0], [0.0, _ARM, 0.0]] if welds else None}
        further = directions.get(closure.kind, [])
        if further is None:
            continue
        if closure.kind == "planar":
            # The points of a planar linkage are apart along its normal.
            apart = (robot.pose(one.frame) * one.placement).inverse() * robot.pose(other.frame) * other.placement
            one = Anchor(one.frame, one.placement * place((0.0, 0.0, apart.translation[2])))
        for number, direction in enumerate([[0.0, 0.0, 0.0], *further]):
            name = closure.name or f"closure{count}"
            first, second = (Anchor(a.frame, place(a.placement.act(np.array(direction)))) for a in (one, other))
            yield f"{name}_{number}" if number else name, first, second


def _line(equality: JointEquality) -> tuple[float, float]:
    """Return offset and factor of a joint equality of degree one."""
    if len(equality.coefficients) > 2 and any(equality.coefficients[2:]):
        raise DescriptionError("chain", "joint equalities of degree one", repr(equality.joint), "MJCF has higher ones")
    if equality.driver is None:
        raise DescriptionError("chain", "joint equalities with a driver", repr(equality.joint), "MJCF has others")
    constant, factor, *_ = (*equality.coefficients, 0.0, 0.0)
    return equality.zero + constant - factor * equality.driver_zero, factor


def _mjcf_body(robot: _Robot, name: str, body: _Body) -> Element:
    if body.joints and not body.inertia.mass:
        raise DescriptionError("chain", "moving links that have a mass, for MuJoCo", repr(name))
    joints = [_mjcf_joint(robot, body, i) for i in body.joints]
    inertia = None
    if body.inertia.mass:
        tensor = body.inertia.inertia
        one, other, most = np.linalg.eigvalsh(tensor)
        if one < 0.0 or one + other < most - 1e-9 * most:
            expected = "moments of inertia of a body, none above the sum of the others, for MuJoCo"
            raise DescriptionError("chain", expected, f"{name!r}: {one:.3g}, {other:.3g}, {most:.3g} kg m²")
        full = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
        inertia = element("inertial", pos=body.inertia.lever, mass=body.inertia.mass, fullinertia=full)
    return element(
        "body", *joints, inertia, *robot.tree(name, _mjcf_body), name=name, **_pos_quat(robot.placement(body))
    )


def _mjcf_joint(robot: _Robot, body: _Body, i: int) -> Element:
    model, name = robot.model, robot.model.names[i]
    kind, joint = robot.kinds[name], model.joints[i]
    if kind == "free":
        if body.parent != "world" or not model.jointPlacements[i].isIdentity(0.0):
            raise DescriptionError("chain", "free joints of the world, for MuJoCo", repr(name))
        return element("freejoint", name=name)
    at = body.pose.inverse() * robot.data.oMi[i]
    values: dict[str, Any] = {"name": name, "type": kind}
    values |= {} if kind == "slide" else {"pos": at.translation}
    if kind != "ball":
        values |= {"axis": at.rotation @ robot.axis(i), "ref": robot.q[joint.idx_q]}
        lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        if np.isfinite(lower) and np.isfinite(upper):
            values["range"] = (lower, upper)
        effort = model.upperEffortLimit[joint.idx_v]
        if np.isfinite(effort) and effort > 0.0:
            values["actuatorfrcrange"] = (-effort, effort)
    dynamics = {"armature": model.armature, "damping": model.damping, "frictionloss": model.upperDryFrictionLimit}
    values |= {key: table[joint.idx_v] for key, table in dynamics.items() if table[joint.idx_v]}
    return element("joint", **values)


def _urdf_link(name: str, inertia: Any) -> Element:
    if not inertia.mass:
        return element("link", name=name)
    moments = inertia.inertia
    keys = {
        key: moments["xyz".index(key[1]), "xyz".index(key[2])] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    }
    origin = element("origin", xyz=inertia.lever, rpy=np.zeros(3))
    inertial = element("inertial", origin, element("mass", value=inertia.mass), element("inertia", **keys))
    return element("link", inertial, name=name)


def _fixed(name: str, parent: str, placement: Any) -> Element:
    ends = [element("parent", link=parent), element("child", link=name)]
    return element("joint", *ends, _origin(placement), name=f"{name}_fixed", type="fixed")


def _origin(placement: Any) -> Element:
    return element("origin", xyz=placement.translation, rpy=pin.rpy.matrixToRpy(placement.rotation))


def _urdf_joint(robot: _Robot, name: str, body: _Body, base: str, mimics: Mapping[str, Element]) -> Element:
    parent = base if body.parent == "world" else body.parent
    if not body.joints:
        return _fixed(name, parent, robot.placement(body))
    (i,) = body.joints
    joint, label = robot.model.joints[i], robot.model.names[i]
    kind = robot.kinds[label]
    parts = [element("parent", link=parent), element("child", link=name), _origin(robot.placement(body))]
    if kind in ("hinge", "slide"):
        axis = (body.pose.inverse() * robot.data.oMi[i]).rotation @ robot.axis(i)
        limits = _limits(robot.model, joint)
        dynamics = {"damping": robot.model.damping, "friction": robot.model.upperDryFrictionLimit}
        parts += [element("axis", xyz=axis), element("limit", **limits)]
        parts.append(element("dynamics", **{key: table[joint.idx_v] for key, table in dynamics.items()}))
        unlimited = kind == "hinge" and not np.isfinite([limits["lower"], limits["upper"]]).all()
    else:
        unlimited = False
        if kind == "ball":
            parts.append(element("limit", lower=-np.pi, upper=np.pi, effort=0.0, velocity=1e3))
    if label in mimics:
        parts.append(mimics[label])
    return element("joint", *parts, name=label, type="continuous" if unlimited else _URDF[kind])


def _limits(model: Any, joint: Any) -> dict[str, float]:
    return {
        "lower": model.lowerPositionLimit[joint.idx_q],
        "upper": model.upperPositionLimit[joint.idx_q],
        "effort": model.upperEffortLimit[joint.idx_v],
        "velocity": model.upperVelocityLimit[joint.idx_v],
    }


def _sdf_body(
    robot: _Robot, name: str, body: _Body, actuated: Sequence[str], mimics: Mapping[str, Element]
) -> Iterator[Element]:
    inertia = body.inertia
    # Without these lines a link has a mass of 1 kg.
    tensor = inertia.inertia if inertia.mass else np.zeros((3, 3))
    keys = {key: tensor["xyz".index(key[1]), "xyz".index(key[2])] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    centre = element("pose", text=(*inertia.lever, 0.0, 0.0, 0.0)) if inertia.mass else None
    inertial = element("inertial", centre, *texts(mass=inertia.mass), element("inertia", *texts(**keys)))
    yield element("link", element("pose", text=_xyzrpy(body.pose)), inertial, name=name)
    kind = robot.kinds[robot.model.names[body.joints[0]]] if body.joints else None
    if kind == "free":
        if body.parent != "world":
            raise DescriptionError(
                "chain", "free joints of the world, for SDF", repr(robot.model.names[body.joints[0]])
            )
        return
    ends = texts(parent=body.parent, child=name)
    if kind is None:
        yield element("joint", *ends, name=f"{name}_fixed", type="fixed")
        return
    (i,) = body.joints
    joint, label = robot.model.joints[i], robot.model.names[i]
    axis = None
    if kind != "ball":
        direction = (body.pose.inverse() * robot.data.oMi[i]).rotation @ robot.axis(i)
        limits = _limits(robot.model, joint)
        limits["effort"] = (limits["effort"] if np.isfinite(limits["effort"]) else -1.0) if label in actuated else 0.0
        limits = {key: value for key, value in limits.items() if np.isfinite(value)}
        dynamics = {"damping": robot.model.damping, "friction": robot.model.upperDryFrictionLimit}
        lines = texts(**{key: table[joint.idx_v] for key, table in dynamics.items()})
        following = mimics.get(label)
        parts = [*texts(xyz=direction), element("limit", *texts(**limits)), element("dynamics", *lines), following]
        axis = element("axis", *parts)
    yield element("joint", *ends, axis, name=label, type=_SDF[kind])


def _drake(robot: _Robot, closures: Sequence[Closure], base: str, *, as_texts: bool) -> Iterator[Element]:
    """Yield Drake's ball constraints, whose values are attributes in URDF files, texts in SDF files."""
    tag = "drake:ball_constraint"
    for _, one, other in _pairs(robot, closures, welds=True):
        values: dict[str, Any] = {}
        for anchor, body, point in ((one, "body_A", "p_AP"), (other, "body_B", "p_BQ")):
            values[body] = base if anchor.frame == "world" else anchor.frame
            values[point] = anchor.placement.translation
        if as_texts:
            yield element(tag, *texts(**{f"{tag}_{key}": value for key, value in values.items()}))
        else:
            keys = {"body_A": "name", "body_B": "name"}
            yield element(tag, *(element(f"{tag}_{k}", **{keys.get(k, "value"): v}) for k, v in values.items()))


def _scalar_first(rotation: FloatArray) -> FloatArray:
    return np.roll(pin.Quaternion(rotation).normalized().coeffs(), 1)


def _pos_quat(placement: Any) -> dict[str, FloatArray]:
    return {"pos": placement.translation, "quat": _scalar_first(placement.rotation)}


def _xyzrpy(placement: Any) -> tuple[float, ...]:
    return (*placement.translation, *pin.rpy.matrixToRpy(placement.rotation))


def _qpos(model: Any, q: FloatArray) -> FloatArray:
    """Return MuJoCo's qpos: quaternions have their scalar first."""
    qpos = np.array(q)
    for joint in model.joints[1:]:
        if joint.nq > joint.nv:
            end = joint.idx_q + joint.nq
            qpos[end - 4 : end] = np.roll(qpos[end - 4 : end], 1)
    return qpos
