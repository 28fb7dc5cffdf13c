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
from spm_pin.loops.closures import Anchor, Closure, JointEquality, RobotDescription, find_frame
from spm_pin.loops.links import Joint, JointKind, place
from spm_pin.support.arguments import FloatArray, type_and_value
from spm_pin.support.xml_elements import document, element, texts

_URDF = {"hinge": "revolute", "slide": "prismatic", "free": "floating", "ball": "revolute"}
_SDF = {"hinge": "revolute", "slide": "prismatic", "ball": "ball"}
_YAML = {"point": "3d", "weld": "6d", "hinge": "hinge", "planar": "planar"}
_LIMITS = ("lower", "upper", "effort", "velocity")
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
    for name, one, other in _pairs(robot, welds=False):
        ends = {"body1": one.frame, "body2": other.frame, "anchor": one.placement.translation}
        if not by_bodies:
            ends = {"site1": f"{name}_first", "site2": f"{name}_second"}
            for site, anchor in zip(ends.values(), (one, other), strict=True):
                robot.sites.append((str(site), anchor))
        welds.append(element("connect", name=name, **ends))
    for closure in robot.closures:
        if closure.kind == "weld":
            one, other = closure.first, closure.second
            relative = one.placement * other.placement.inverse()
            relpose = (*one.placement.translation, *_scalar_first(relative.rotation))
            ends = {"body1": one.frame, "body2": other.frame, "anchor": other.placement.translation}
            welds.append(element("weld", name=closure.name, **ends, relpose=relpose))
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
    for closure in robot.closures:
        names = []
        for anchor, end in ((closure.first, "first"), (closure.second, "second")):
            names.append(anchor.frame)
            if not anchor.placement.isIdentity(0.0):
                names[-1] = f"{closure.name}_{end}"
                robot.sites.append((names[-1], anchor))
        loops.append((names, _YAML[closure.kind]))
    mimics = {}
    for equality in chain.equalities:
        offset, factor = _line(equality)
        mimics[equality.joint] = element("mimic", joint=equality.driver, multiplier=factor, offset=offset)
    parts: list[Element] = [element("link", name="world")]
    for name, body in robot.bodies.items():
        parts += [_urdf_link(name, body.inertia), _urdf_joint(robot, name, body, mimics)]
    for name, anchor in robot.sites:
        parts += [element("link", name=name), _fixed(name, anchor.frame, anchor.placement)]
    for joint in chain.actuated:
        interface = element("hardwareInterface", text="hardware_interface/EffortJointInterface")
        kind = element("type", text="transmission_interface/SimpleTransmission")
        motor = element("actuator", element("mechanicalReduction", text="1"), name=f"{joint}_motor")
        parts.append(
            element("transmission", kind, element("joint", interface, name=joint), motor, name=f"{joint}_transmission")
        )
    if not balls:
        parts += _drake(robot, as_texts=False)
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
        for closure in robot.closures:
            one, other = closure.first, closure.second
            kind = {"point": "ball", "weld": "fixed"}.get(closure.kind, "revolute")
            axis = element("axis", *texts(xyz=(0.0, 0.0, 1.0))) if kind == "revolute" else None
            if other.frame == "world" or robot.floats(other.frame):
                one, other = other, one  # the child of a joint that closes a loop has a parent already
            ends = texts(parent=one.frame, child=other.frame)
            pose = element("pose", text=_xyzrpy(other.placement), relative_to=other.frame)
            parts.append(element("joint", pose, *ends, axis, name=closure.name, type=kind))
    else:
        parts += _drake(robot, as_texts=True)
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
        self.sites = list[tuple[str, Anchor]]()
        self.q = np.array(reference)
        self.data = model.createData()
        for joint in model.joints[1:]:
            if joint.nq == 4:  # a file has no turned ball joints
                self.q[joint.idx_q : joint.idx_q + 4] = (0.0, 0.0, 0.0, 1.0)
        pin.framesForwardKinematics(model, self.data, self.q)
        self.kinds: dict[str, JointKind] = {model.names[i]: self._kind(i) for i in range(1, model.njoints)}
        self.bodies: dict[str, _Body] = {}
        owners = {0: "world"}
        pending: tuple[int, ...] = ()
        closed = {
            model.frames[find_frame(model, a.frame)].parentJoint for c in chain.closures for a in (c.first, c.second)
        }
        taken = {frame.name for frame in model.frames if frame.type != pin.FrameType.JOINT}
        for i in range(model.njoints):
            frames = [frame for frame in model.frames if frame.parentJoint == i and frame.type == pin.FrameType.BODY]
            # A link of the world's name at its place is the world.
            frames = [frame for frame in frames if frame.name not in ("universe", "world")]
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
                self.bodies[name] = _Body(parent, at, pending, inertia)
                owners[i], pending = name, ()
            for frame in frames:
                if frame.name not in self.bodies:
                    inertia = pin.Inertia.Zero()
                    self.bodies[frame.name] = _Body(owners[i], self.data.oMi[i] * frame.placement, (), inertia)
        self._owners = owners
        self.closures = [
            Closure(c.kind, self._anchor(c.first), self._anchor(c.second), c.name or f"closure{count}")
            for count, c in enumerate(chain.closures)
        ]

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

    def _axis(self, i: int) -> FloatArray:
        """Return the axis of a joint in its own frame."""
        directions = self.data.joints[i].S.ravel()[:6]
        return np.asarray(directions[3:] if directions[3:].any() else directions[:3])

    def joint(self, body: _Body, i: int) -> Joint:
        """Return a joint of a link, from whose frame `before` and `axis` are."""
        model, place, v = self.model, body.pose.actInv(self.data.oMi[i]), self.model.joints[i].idx_v
        name, q = model.names[i], model.joints[i].idx_q
        x, y, z = place.rotation @ self._axis(i)
        limits = {"lower": model.lowerPositionLimit[q], "upper": model.upperPositionLimit[q]}
        limits |= {"effort": model.upperEffortLimit[v], "velocity": model.upperVelocityLimit[v]}
        dynamics = {"armature": model.armature[v], "damping": model.damping[v]}
        friction = model.upperDryFrictionLimit[v]
        return Joint(name, self.kinds[name], (x, y, z), place, **limits, **dynamics, friction=friction)

    def _fits(self, i: int, placement: Any, in_link_frames: bool) -> bool:
        """Return whether a link's frame may stand for the frame of the joint that carries it."""
        kind, at = self.kinds[self.model.names[i]], placement.translation
        if placement.isIdentity(0.0) or kind == "slide":
            return True
        if kind == "hinge":
            return in_link_frames or bool(np.linalg.norm(np.cross(self._axis(i), at)) < 1e-15)
        return kind == "ball" and in_link_frames and bool(np.array_equal(placement.rotation, np.eye(3)))

    def floats(self, name: str) -> bool:
        """Return whether a link is moved by a free joint."""
        return any(self.kinds[self.model.names[i]] == "free" for i in self.bodies[name].joints)

    def pose(self, name: str) -> Any:
        """Return the pose of a link in the world."""
        return pin.SE3.Identity() if name == "world" else self.bodies[name].pose

    def placement(self, body: _Body) -> Any:
        """Return the placement of a link in its parent."""
        return self.pose(body.parent).inverse() * body.pose

    def _anchor(self, anchor: Anchor) -> Anchor:
        """Return the same place on a link."""
        frame = self.model.frames[find_frame(self.model, anchor.frame)]
        name = frame.name if frame.name in self.bodies else self._owners[frame.parentJoint]
        at = self.data.oMi[frame.parentJoint] * frame.placement
        placement = self.pose(name).inverse() * at * anchor.placement
        return Anchor(name, anchor.placement if name == frame.name else placement)

    def reference(self, joint: str | None) -> float:
        """Return the value of a joint at the reference."""
        return 0.0 if joint is None else float(self.q[self.model.joints[self.model.getJointId(joint)].idx_q])

    def apart(self, one: Anchor, other: Anchor) -> Any:
        """Return the placement of an anchor in another."""
        return (self.pose(one.frame) * one.placement).actInv(self.pose(other.frame) * other.placement)

    def is_closed_at_reference(self) -> bool:
        """Return whether all loops are closed at the reference."""
        for closure in self.closures:
            apart = self.apart(closure.first, closure.second)
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


def _pairs(robot: _Robot, *, welds: bool) -> Iterator[tuple[str, Anchor, Anchor]]:
    """Yield pairs of points that coincide in a closed chain: one for a point, two for a hinge, three for a weld."""
    further = {"hinge": [[0.0, 0.0, _ARM]], "weld": [[_ARM, 0.0, 0.0], [0.0, _ARM, 0.0]]}
    for closure in robot.closures:
        if closure.kind == "weld" and not welds:
            continue
        one, other = closure.first, closure.second
        if closure.kind == "planar":
            # The points of a planar linkage are apart along its normal.
            one = Anchor(one.frame, one.placement * place((0.0, 0.0, robot.apart(one, other).translation[2])))
        for number, direction in enumerate([[0.0, 0.0, 0.0], *further.get(closure.kind, ())]):
            first, second = (Anchor(a.frame, place(a.placement.act(np.array(direction)))) for a in (one, other))
            yield f"{closure.name}_{number}" if number else closure.name, first, second


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
    joint = robot.joint(body, i)
    if joint.kind == "free":
        if body.parent != "world" or not robot.model.jointPlacements[i].isIdentity(0.0):
            raise DescriptionError("chain", "free joints of the world, for MuJoCo", repr(joint.name))
        return element("freejoint", name=joint.name)
    values: dict[str, Any] = {"name": joint.name, "type": joint.kind}
    values |= {} if joint.kind == "slide" else {"pos": joint.before.translation}
    if joint.kind != "ball":
        values |= {"axis": joint.axis, "ref": robot.reference(joint.name)}
        if np.isfinite([joint.lower, joint.upper]).all():
            values["range"] = (joint.lower, joint.upper)
        if np.isfinite(joint.effort) and joint.effort > 0.0:
            values["actuatorfrcrange"] = (-joint.effort, joint.effort)
    dynamics = {"armature": joint.armature, "damping": joint.damping, "frictionloss": joint.friction}
    return element("joint", **values, **{key: value for key, value in dynamics.items() if value})


def _moments(inertia: Any) -> dict[str, float]:
    tensor = inertia.inertia
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    return {key: tensor["xyz".index(key[1]), "xyz".index(key[2])] for key in keys}


def _urdf_link(name: str, inertia: Any) -> Element:
    if not inertia.mass:
        return element("link", name=name)
    origin = element("origin", xyz=inertia.lever, rpy=np.zeros(3))
    moments = element("inertia", **_moments(inertia))
    return element("link", element("inertial", origin, element("mass", value=inertia.mass), moments), name=name)


def _fixed(name: str, parent: str, placement: Any) -> Element:
    ends = [element("parent", link=parent), element("child", link=name)]
    return element("joint", *ends, _origin(placement), name=f"{name}_fixed", type="fixed")


def _origin(placement: Any) -> Element:
    return element("origin", xyz=placement.translation, rpy=pin.rpy.matrixToRpy(placement.rotation))


def _urdf_joint(robot: _Robot, name: str, body: _Body, mimics: Mapping[str, Element]) -> Element:
    if not body.joints:
        return _fixed(name, body.parent, robot.placement(body))
    (i,) = body.joints
    joint, kind = robot.joint(body, i), _URDF[robot.joint(body, i).kind]
    parts = [element("parent", link=body.parent), element("child", link=name), _origin(robot.placement(body))]
    if joint.kind in ("hinge", "slide"):
        limits = {key: getattr(joint, key) for key in _LIMITS}
        dynamics = element("dynamics", damping=joint.damping, friction=joint.friction)
        parts += [element("axis", xyz=joint.axis), element("limit", **limits), dynamics]
        if joint.kind == "hinge" and not np.isfinite([joint.lower, joint.upper]).all():
            kind = "continuous"
    elif joint.kind == "ball":
        parts.append(element("limit", lower=-np.pi, upper=np.pi, effort=0.0, velocity=1e3))
    if joint.name in mimics:
        parts.append(mimics[joint.name])
    return element("joint", *parts, name=joint.name, type=kind)


def _sdf_body(
    robot: _Robot, name: str, body: _Body, actuated: Sequence[str], mimics: Mapping[str, Element]
) -> Iterator[Element]:
    # Without these lines a link has a mass of 1 kg.
    inertia = body.inertia if body.inertia.mass else pin.Inertia.Zero()
    centre = element("pose", text=(*inertia.lever, 0.0, 0.0, 0.0)) if inertia.mass else None
    inertial = element("inertial", centre, *texts(mass=inertia.mass), element("inertia", *texts(**_moments(inertia))))
    yield element("link", element("pose", text=_xyzrpy(body.pose)), inertial, name=name)
    ends = texts(parent=body.parent, child=name)
    if not body.joints:
        yield element("joint", *ends, name=f"{name}_fixed", type="fixed")
        return
    (i,) = body.joints
    joint = robot.joint(body, i)
    if joint.kind == "free":
        if body.parent != "world":
            raise DescriptionError("chain", "free joints of the world, for SDF", repr(joint.name))
        return
    axis = None
    if joint.kind != "ball":
        limits = {key: getattr(joint, key) for key in _LIMITS}
        limits["effort"] = (joint.effort if np.isfinite(joint.effort) else -1.0) if joint.name in actuated else 0.0
        limit = element("limit", *texts(**{key: value for key, value in limits.items() if np.isfinite(value)}))
        dynamics = element("dynamics", *texts(damping=joint.damping, friction=joint.friction))
        axis = element("axis", *texts(xyz=joint.axis), limit, dynamics, mimics.get(joint.name))
    yield element("joint", *ends, axis, name=joint.name, type=_SDF[joint.kind])


def _drake(robot: _Robot, *, as_texts: bool) -> Iterator[Element]:
    """Yield Drake's ball constraints, whose values are attributes in URDF files, texts in SDF files."""
    tag = "drake:ball_constraint"
    for _, one, other in _pairs(robot, welds=True):
        values: dict[str, Any] = {"body_A": one.frame, "p_AP": one.placement.translation}
        values |= {"body_B": other.frame, "p_BQ": other.placement.translation}
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
