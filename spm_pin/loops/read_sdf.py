"""Robots from SDF files, whose joints may close loops."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from spm_pin.errors import DescriptionError
from spm_pin.loops.closures import Anchor, Closure, ClosureKind, JointEquality, RobotDescription
from spm_pin.loops.links import Joint, JointKind, Link, build_model, check_unique, describe, place
from spm_pin.loops.read_urdf import drake_closures, read_configurations
from spm_pin.loops.xml_input import inertia_of, name_of, number, numbers, read_xml, unit_axis
from spm_pin.support.arguments import FloatArray, name_sequence

_KINDS: dict[str, tuple[JointKind, ...]] = {
    "revolute": ("hinge",),
    "continuous": ("hinge",),
    "prismatic": ("slide",),
    "ball": ("ball",),
    "universal": ("hinge", "hinge"),
    "fixed": (),
}
_CLOSES: dict[str, ClosureKind] = {"ball": "point", "revolute": "hinge", "continuous": "hinge", "fixed": "weld"}
_UNLIMITED = 1e16  # by the specification


def read_sdf(
    source: Any, *, actuated: Sequence[str] | None = None, srdf: str | PathLike[str] | None = None
) -> RobotDescription:
    """Return the robot of an SDF file of one model.

    Parameters
    ----------
    source : path or str
        An SDF file, or its text.
    actuated : sequence of str, optional
        Names of the actuated joints; by default those with a limit of effort that is not zero.
    srdf : path, optional
        An SRDF file with named configurations; those of joints that the robot does not have are passed over.

    Notes
    -----
    Joints are taken in the order of the file, sliding and universal ones first. One whose child has a parent already
    closes a loop: a ball joint, a hinge, or a fixed joint, whose limits are not kept. The model stands at its poses
    when all joints are at zero, loops closed. Links that no joint leads to float; the joint of a single one is called
    `root_joint`, of several `pelvis_root_joint`. The two axes of a universal joint are `name_1` and `name_2`. Gearboxes
    and `mimic` become joint equalities, Drake's ball constraints points. Springs, meshes and plugins are not read.

    Raises
    ------
    DescriptionError
        A file that is missing or malformed, or that has elements which cannot be kept; it says which.
    """
    root, where = read_xml(source, "sdf", "an SDF file")
    models = [*root.findall("model"), *root.findall("world/model")]
    if len(models) != 1:
        raise DescriptionError(where, "one model", f"{len(models)}")
    return _Sdf(models[0], where, root.get("version", "1.6")).describe(actuated, srdf)


class _Sdf:
    """A model element, its links, joints and the poses of both in the model's frame."""

    def __init__(self, model: Element, where: str, version: str) -> None:
        self.model, self.where = model, where
        for tag in ("include", "model"):
            for node in model.findall(tag):
                raise DescriptionError(f"{where}, <{tag}>", "a model without others in it", repr(node.get("name", "")))
        self.axes_in_model = tuple(map(int, version.split(".")[:2])) < (1, 5) if version[:1].isdigit() else False
        self.links, self.joints, self.frames = (
            {self._name(e): e for e in model.findall(t)} for t in ("link", "joint", "frame")
        )
        for tag in ("link", "joint", "frame"):
            check_unique([self._name(node) for node in model.findall(tag)], tag, where)
        if not self.links:
            raise DescriptionError(where, "a model with links", "none")
        self.poses: dict[str, Any] = {"__model__": pin.SE3.Identity()}
        # The pose of the model is that of its placement frame, by default of the model's own frame.
        placed = self.pose(model.get("placement_frame") or "__model__")
        self.poses["world"] = placed * self._read_pose(model.find("pose"), f"{where}, model").inverse()
        self.ends = {name: tuple(self._end(name, tag) for tag in ("parent", "child")) for name in self.joints}

    def _name(self, node: Element) -> str:
        return name_of(node, f"{self.where}, <{node.tag}>")

    def _at(self, joint: str) -> str:
        return f"{self.where}, joint {joint!r}"

    def _end(self, joint: str, tag: str) -> str:
        """Return the link at an end of a joint, which may be named by a frame on it, or "world"."""
        end = (self.joints[joint].findtext(tag) or "").strip()
        for _ in range(len(self.frames) + 1):
            if end in self.links or (end == "world" and tag == "parent"):
                return end
            if end not in self.frames:
                break
            end = self.frames[end].get("attached_to", "")
        raise DescriptionError(self._at(joint), f"a link of the model as its {tag}", repr(end) if end else "none")

    def _read_pose(self, node: Element | None, at: str) -> Any:
        if node is None or not (node.text or "").strip():
            return pin.SE3.Identity()
        if node.get("rotation_format") == "quat_xyzw":
            x, y, z, *quaternion = numbers(node.text, 7, f"{at}, pose")
            return place((x, y, z), pin.Quaternion(np.array(quaternion)).normalized().matrix())
        values = numbers(node.text, 6, f"{at}, pose")
        angles = np.deg2rad(values[3:]) if node.get("degrees") in ("true", "1") else values[3:]
        return place(values[:3], pin.rpy.rpyToMatrix(*angles))

    def pose(self, name: str, above: tuple[str, ...] = ()) -> Any:
        """Return the pose of a link, joint or frame in the model."""
        if name in self.poses:
            return self.poses[name]
        node = next((table[name] for table in (self.links, self.joints, self.frames) if name in table), None)
        at = f"{self.where}, pose of {name!r}"
        if node is None or name in above:
            owner = f", pose of {above[-1]!r}" if above else ""
            received = "a ring of poses" if name in above else repr(name)
            raise DescriptionError(f"{self.where}{owner}", "a link, joint or frame of the model", received)
        own = node.find("pose")
        default = "__model__"
        if node.tag == "joint":
            default = (node.findtext("child") or "").strip()
        elif node.tag == "frame":
            default = node.get("attached_to") or default
        relative = None if own is None else own.get("relative_to") or own.get("frame")
        self.poses[name] = self.pose(relative or default, (*above, name)) * self._read_pose(own, at)
        return self.poses[name]

    def _axis(self, joint: str, tag: str = "axis") -> tuple[FloatArray, dict[str, float]]:
        """Return an axis in the joint's frame, and its limits, damping and friction."""
        node, at = self.joints[joint].find(tag), f"{self._at(joint)}, {tag}"
        if node is None:
            raise DescriptionError(at, f"an <{tag}>", "none")
        xyz = node.find("xyz")
        frame = None if xyz is None else xyz.get("expressed_in")
        if (node.findtext("use_parent_model_frame") or "").strip() in ("1", "true") or (
            self.axes_in_model and not frame
        ):
            frame = "__model__"
        axis = np.array(unit_axis(node.findtext("xyz"), at, (0.0, 0.0, 1.0)))
        if frame:
            axis = self.pose(joint).rotation.T @ (self.pose(frame).rotation @ axis)
        values = {}
        for key, default in (("lower", -np.inf), ("upper", np.inf), ("effort", np.inf), ("velocity", np.inf)):
            value = number(node.findtext(f"limit/{key}"), f"{at}, {key}", default)
            unlimited = abs(value) >= _UNLIMITED or (key in ("effort", "velocity") and value < 0.0)
            values[key] = default if unlimited else value
        for key in ("damping", "friction"):
            values[key] = number(node.findtext(f"dynamics/{key}"), f"{at}, {key}", 0.0)
        return axis, values

    def _kind(self, joint: str) -> str:
        kind = self.joints[joint].get("type", "")
        if kind not in _KINDS and kind != "gearbox":
            raise DescriptionError(self._at(joint), f"one of the types {', '.join(_KINDS)}, gearbox", repr(kind))
        return kind

    def _split(self) -> tuple[dict[str, str], list[str]]:
        """Return the joint that carries each link, and the joints that close loops."""
        carriers: dict[str, str] = {}
        closing: list[str] = []
        moving = [name for name in self.joints if self._kind(name) != "gearbox"]
        for name in sorted(moving, key=lambda joint: self._kind(joint) in _CLOSES):
            parent, child = self.ends[name]
            link = parent
            while link != child and link in carriers:
                link = self.ends[carriers[link]][0]
            if child not in carriers and link != child:
                carriers[child] = name
                continue
            if self._kind(name) not in _CLOSES:
                expected = f"a loop that a joint of the types {', '.join(_CLOSES)} closes"
                raise DescriptionError(self._at(name), expected, repr(self._kind(name)))
            closing.append(name)
        return carriers, [name for name in self.joints if name in closing]

    def describe(self, actuated: Sequence[str] | None, srdf: str | PathLike[str] | None) -> RobotDescription:
        carriers, closing = self._split()
        roots = [link for link in self.links if link not in carriers]
        static = (self.model.findtext("static") or "").strip() in ("1", "true")
        floating = {} if static else {link: f"{link}_root_joint" if len(roots) > 1 else "root_joint" for link in roots}
        links = list(self._tree(carriers, floating))
        model = build_model(self.model.get("name", ""), links, {}, self.where)
        rest = pin.neutral(model)
        for link, joint in floating.items():
            start = model.joints[model.getJointId(joint)].idx_q
            rest[start : start + 7] = pin.SE3ToXYZQUAT(self.poses["world"].inverse() * self.pose(link))
        closures = [self._closure(name) for name in closing] + drake_closures(self.model, self.where)
        hinged = {joint.name for link in links for joint in link.joints if joint.kind in ("hinge", "slide")}
        if actuated is None:
            actuated = [name for name in self.joints if name in hinged and self._is_driven(name)]
        name_sequence(actuated, "actuated")
        equalities = [*self._gearboxes(carriers), *self._mimics(hinged)]
        configurations = read_configurations(model, srdf)
        return describe(model, closures, equalities, actuated, configurations, self.where, rest)

    def _tree(self, carriers: dict[str, str], floating: dict[str, str]) -> Iterator[Link]:
        children: dict[str, list[str]] = {}
        for name in self.joints:
            parent, child = self.ends[name]
            if carriers.get(child) == name:
                children.setdefault(parent, []).append(child)
        roots = [*children.get("world", ()), *(link for link in self.links if link not in carriers)]
        stack = roots[::-1]
        while stack:
            link = stack.pop()
            stack += children.get(link, [])[::-1]
            inertia = self._inertia(link)
            if link in carriers:
                yield self._carried(link, carriers[link], inertia)
            elif link in floating:
                yield Link(link, None, pin.SE3.Identity(), (Joint(floating[link], "free"),), inertia)
            else:
                yield Link(link, None, self.pose("world").inverse() * self.pose(link), (), inertia)

    def _carried(self, link: str, name: str, inertia: Any) -> Link:
        parent, at = self.ends[name][0], self.pose(name)
        placement, after = self.pose(parent).inverse() * at, at.inverse() * self.pose(link)
        kinds, carrier = _KINDS[self._kind(name)], None if parent == "world" else parent
        if not kinds:
            return Link(link, carrier, placement * after, (), inertia)
        if kinds == ("ball",):
            return Link(link, carrier, placement, (Joint(name, "ball", after=after),), inertia)
        names = [name] if len(kinds) == 1 else [f"{name}_1", f"{name}_2"]
        joints = []
        for kind, label, tag in zip(kinds, names, ("axis", "axis2"), strict=False):
            (x, y, z), values = self._axis(name, tag)
            last = after if label == names[-1] else pin.SE3.Identity()
            joints.append(Joint(label, kind, (x, y, z), after=last, **values))
        return Link(link, carrier, placement, tuple(joints), inertia)

    def _inertia(self, link: str) -> Any:
        node, at = self.links[link].find("inertial"), f"{self.where}, link {link!r}"
        if node is None:
            node = Element("inertial")
        moments = [
            number(node.findtext(f"inertia/{key}"), f"{at}, {key}", float(key[1] == key[2]))
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        ]
        return inertia_of(
            number(node.findtext("mass"), f"{at}, mass", 1.0), moments, self._read_pose(node.find("pose"), at), at
        )

    def _closure(self, name: str) -> Closure:
        kind = _CLOSES[self._kind(name)]
        turned = pin.SE3.Identity()
        if kind == "hinge":
            axis, _ = self._axis(name)
            turned = place(rotation=pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix())
        at = self.pose(name) * turned
        first, second = (
            Anchor("universe" if link == "world" else link, self.pose(link).inverse() * at) for link in self.ends[name]
        )
        return Closure(kind, first, second, name)

    def _is_driven(self, joint: str) -> bool:
        text = self.joints[joint].findtext("axis/limit/effort")
        return text is not None and self._axis(joint)[1]["effort"] != 0.0

    def _gearboxes(self, carriers: dict[str, str]) -> Iterator[JointEquality]:
        """Yield what gearboxes couple: θ₂ = −ratio θ₁, of child and parent as seen from the reference body."""
        for name in self.joints:
            if self._kind(name) != "gearbox":
                continue
            reference = (self.joints[name].findtext("gearbox_reference_body") or "").strip()
            ratio = number(self.joints[name].findtext("gearbox_ratio"), f"{self._at(name)}, ratio", 1.0)
            turning = []
            for link, tag in zip(self.ends[name], ("axis", "axis2"), strict=True):
                joint = carriers.get(link, "")
                if not joint or self.ends[joint] != (reference, link) or _KINDS[self._kind(joint)] != ("hinge",):
                    expected = f"links that hinges carry on its reference body {reference!r}"
                    raise DescriptionError(self._at(name), expected, repr(link))
                directions = [self.pose(j).rotation @ self._axis(j, t)[0] for j, t in ((name, tag), (joint, "axis"))]
                turning.append((joint, float(np.sign(directions[0] @ directions[1]))))
            (driver, one), (joint, other) = turning
            yield JointEquality(joint, driver, (0.0, -ratio * one * other), name=name)

    def _mimics(self, hinged: set[str]) -> Iterator[JointEquality]:
        for joint, node in self.joints.items():
            mimic, at = node.find("axis/mimic"), f"{self._at(joint)}, mimic"
            if mimic is not None and joint in hinged:
                values = [number(mimic.findtext(key), at, d) for key, d in (("offset", 0.0), ("multiplier", 1.0))]
                reference = number(mimic.findtext("reference"), at, 0.0)
                yield JointEquality(joint, name_of(mimic, at, "joint"), (values[0], values[1]), driver_zero=reference)
