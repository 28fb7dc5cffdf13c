"""MJCF, its loops closed by equality constraints."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import ASSEMBLED, RobotDescription
from spm_pin.description.robot_parts import Inertial, Joint, Material, Shape
from spm_pin.description.srdf import HOME
from spm_pin.description.xml_nodes import document, numbers
from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["mjcf_text"]

MESHES = (".stl", ".obj", ".msh")
"""Mesh formats that MuJoCo reads."""


def mjcf_text(robot: RobotDescription, *, anchors: str = "bodies", folder: Path | None = None) -> str:
    """Return a robot as an MJCF file.

    Parameters
    ----------
    robot : RobotDescription
        Its base is welded to the world. Each state becomes a keyframe, after `home`, all joints at zero.
    anchors : str
        How a point closure is written. "bodies": by a body and a point in it, which MuJoCo, Drake and Pinocchio take
        alike; the other body's point follows from the pose at zero, so that the robot must stand assembled there.
        "sites": by two sites, which MuJoCo takes, and Pinocchio where neither is fixed to the base. A weld is written
        with bodies and their relative pose, which MuJoCo and Pinocchio take.
    folder : Path, optional
        Where the file will lie, if it is to name its meshes relative to that; by default their paths are absolute.

    Raises
    ------
    DescriptionError
        If the robot does not stand assembled at zero and `anchors` is "bodies"; if a moving link has no mass, a joint
        an empty range, a mesh a format that MuJoCo does not read, or a link or a state a name that MJCF keeps for
        others.

    Notes
    -----
    Joints are in the order in which Pinocchio has them when it reads the URDF, so that q is the same vector in
    all of them. Links are bodies, fixed ones without a joint; the base, closures' frames and links fixed to others
    have sites too, whose names end in _site. Constraints and sites are placed in the bodies that joints move, and in
    the base: Pinocchio misplaces them in others. Every transmission is a motor of force or torque. Velocity limits,
    for which MJCF has no place, are the numeric `velocity_limit`, in the order of the joints, 0 for none.
    """
    if anchors not in ("bodies", "sites"):
        raise ArgumentError("anchors", "bodies or sites", repr(anchors))
    return document(_Writer(robot, anchors, folder).root())


class _Writer:
    def __init__(self, robot: RobotDescription, anchors: str, folder: Path | None) -> None:
        self.robot = robot
        self.folder = folder
        self.by_sites = anchors == "sites"
        ends = {frame for closure in robot.closures for frame in (closure.frame_a, closure.frame_b)}
        self.sites: dict[str, dict[str, FloatArray]] = {}
        for link in robot.link:
            carrier, at = robot.carrier(link)
            if link in ends or link == robot.base or carrier != link:
                self.sites.setdefault(carrier, {})[link] = at
        if not self.by_sites:
            points = {closure.name for closure in robot.closures if closure.kind == "point"}
            for name, gap in robot.open_closures().items():
                if name in points:
                    cause = 'anchors="sites" takes it, in MuJoCo and Pinocchio'
                    expected = f"closures that are closed to {ASSEMBLED:g} m at zero"
                    raise DescriptionError("robot", expected, f"{name}, open by {gap:.2g} m", cause)
        if HOME in robot.states:
            raise DescriptionError("robot", f"states with other names than {HOME}, all joints at zero", HOME)
        if "world" in robot.link:
            raise DescriptionError("robot", "links with other names than world", "world")

    def root(self) -> Element:
        robot = self.robot
        root = Element("mujoco", model=robot.name)
        SubElement(root, "compiler", angle="radian", autolimits="true")
        # Rigid closures: steps that resolve the constraints' time constant, and no softening under load.
        SubElement(root, "option", timestep="0.001", integrator="implicitfast")
        equality = SubElement(SubElement(root, "default"), "equality")
        equality.attrib.update(solref="0.002 1", solimp="0.9999 0.9999 0.001 0.5 2")
        visual = SubElement(root, "visual")
        SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.6 0.6 0.6")
        SubElement(visual, "global", offwidth="1280", offheight="960")
        self._assets(root)
        self._body(SubElement(root, "worldbody"), robot.base, None)
        if robot.closures:
            equalities = SubElement(root, "equality")
            for closure in robot.closures:
                equalities.append(self._closure(closure))
        if robot.transmissions:
            actuators = SubElement(root, "actuator")
            joints = {joint.name: joint for joint in robot.joints}
            for transmission in robot.transmissions:
                motor = SubElement(actuators, "motor", name=transmission.actuator, joint=transmission.joint)
                effort = joints[transmission.joint].limit.effort
                if math.isfinite(effort):
                    motor.attrib.update(ctrllimited="true", ctrlrange=numbers((-effort, effort)))
        velocities = [joint.limit.velocity for joint in robot.moving]
        if any(map(math.isfinite, velocities)):
            data = numbers(value if math.isfinite(value) else 0.0 for value in velocities)
            SubElement(SubElement(root, "custom"), "numeric", name="velocity_limit", data=data)
        keyframe = SubElement(root, "keyframe")
        states: Mapping[str, Mapping[str, float]] = {HOME: {}, **robot.states}
        for name, values in states.items():
            SubElement(keyframe, "key", name=name, qpos=numbers(values.get(j.name, 0.0) for j in robot.moving))
        return root

    def _assets(self, root: Element) -> None:
        self.materials: dict[Material, str] = {}
        self.meshes: dict[tuple[str, tuple[float, ...]], str] = {}
        assets = Element("asset")
        taken: set[str] = set()
        for shape in (s for link in self.robot.links for s in (*link.visuals, *link.collisions)):
            if shape.material is not None and shape.material not in self.materials:
                name = _free(shape.material.name or "material", taken)
                self.materials[shape.material] = name
                SubElement(assets, "material", name=name, rgba=numbers(shape.material.rgba))
            if shape.mesh is not None and (str(shape.mesh.path), shape.size) not in self.meshes:
                if shape.mesh.path.suffix.lower() not in MESHES:
                    raise DescriptionError("robot", f"meshes in {', '.join(MESHES)}", shape.mesh.uri)
                name = _free(shape.mesh.path.stem, taken)
                self.meshes[str(shape.mesh.path), shape.size] = name
                file = shape.mesh.reference(self.folder, uri=False)
                SubElement(assets, "mesh", name=name, file=file, scale=numbers(shape.size))
        if len(assets):
            root.append(assets)

    def _body(self, parent: Element, name: str, joint: Joint | None) -> None:
        link = self.robot.link[name]
        body = SubElement(parent, "body", name=name)
        if joint is not None:
            body.attrib.update(pos=numbers(joint.placement.xyz), quat=numbers(joint.placement.quaternion))
            if joint.moves:
                body.append(self._joint(joint))
        if link.inertial is not None and link.inertial.mass > 0.0:
            body.append(_inertial(link.inertial))
        elif joint is not None and joint.moves:
            raise DescriptionError("robot", "mass in every link that a joint moves", f"none in {name}")
        for shape, seen in [(s, True) for s in link.visuals] + [(s, False) for s in link.collisions]:
            body.append(self._geom(shape, seen))
        for frame, at in self.sites.get(name, {}).items():
            turn = Rotation.from_matrix(at[:3, :3]).as_quat(scalar_first=True)
            site = SubElement(body, "site", name=f"{frame}_site", size="0.005")
            site.attrib.update(pos=numbers(at[:3, 3]), quat=numbers(turn))
        for leaving in self.robot.order:
            if leaving.parent == name:
                self._body(body, leaving.child, leaving)

    def _joint(self, joint: Joint) -> Element:
        kind = "slide" if joint.kind == "prismatic" else "hinge"
        element = Element("joint", name=joint.name, type=kind, axis=numbers(joint.axis))
        limit = joint.limit
        if limit.lower == limit.upper:
            expected = "joints with room to move: MJCF has no empty ranges"
            raise DescriptionError("robot", expected, f"[{limit.lower:g}, {limit.upper:g}] of {joint.name}")
        if math.isfinite(limit.lower) and math.isfinite(limit.upper):
            element.attrib.update(limited="true", range=numbers((limit.lower, limit.upper)))
        elif math.isfinite(limit.lower) or math.isfinite(limit.upper):
            raise DescriptionError("robot", "two limits of a joint, or none", f"one of {joint.name}")
        if 0.0 < limit.effort < math.inf:
            element.attrib.update(actuatorfrclimited="true", actuatorfrcrange=numbers((-limit.effort, limit.effort)))
        if joint.damping:
            element.set("damping", numbers([joint.damping]))
        if joint.friction:
            element.set("frictionloss", numbers([joint.friction]))
        return element

    def _geom(self, shape: Shape, seen: bool) -> Element:
        geom = Element("geom", type=shape.kind)
        if shape.mesh is not None:
            geom.set("mesh", self.meshes[str(shape.mesh.path), shape.size])
        elif shape.kind == "box":
            geom.set("size", numbers(0.5 * side for side in shape.size))
        else:  # of a cylinder, MuJoCo takes half the length
            geom.set("size", numbers(np.array(shape.size) * (1.0, 0.5)[: len(shape.size)]))
        geom.attrib.update(pos=numbers(shape.placement.xyz), quat=numbers(shape.placement.quaternion))
        if shape.material is not None:
            geom.set("material", self.materials[shape.material])
        if seen:
            geom.attrib.update(contype="0", conaffinity="0", group="2")
        else:
            geom.set("group", "3")
        return geom

    def _closure(self, closure: Closure) -> Element:
        (body_a, at_a), (body_b, at_b) = (self.robot.carrier(end) for end in (closure.frame_a, closure.frame_b))
        if body_a == self.robot.base:  # Pinocchio needs a moving first body
            body_a, at_a, body_b, at_b = body_b, at_b, body_a, at_a
        if body_a == body_b:
            raise DescriptionError("robot", "closures between links that move apart", closure.name)
        element = Element("connect" if closure.kind == "point" else "weld", name=closure.name)
        if closure.kind == "weld":
            relative = at_a @ np.linalg.inv(at_b)  # without an anchor: MuJoCo takes another relpose beside one
            quaternion = Rotation.from_matrix(relative[:3, :3]).as_quat(scalar_first=True)
            pose = numbers((*relative[:3, 3], *quaternion))
            element.attrib.update(body1=body_a, body2=body_b, relpose=pose)
        elif self.by_sites:
            element.attrib.update(site1=f"{closure.frame_a}_site", site2=f"{closure.frame_b}_site")
        else:
            element.attrib.update(body1=body_a, body2=body_b, anchor=numbers(at_a[:3, 3]))
        return element


def _inertial(inertial: Inertial) -> Element:
    element = Element("inertial", pos=numbers(inertial.placement.xyz), mass=numbers([inertial.mass]))
    xx, xy, xz, yy, yz, zz = inertial.moments
    if xy == xz == yz == 0.0:
        element.attrib.update(quat=numbers(inertial.placement.quaternion), diaginertia=numbers((xx, yy, zz)))
    else:  # in the link's axes: MJCF takes either an orientation or all six
        turn: FloatArray = inertial.placement.matrix[:3, :3]
        full = turn @ inertial.matrix @ turn.T
        element.set("fullinertia", numbers([*np.diag(full), full[0, 1], full[0, 2], full[1, 2]]))
    return element


def _free(name: str, taken: set[str]) -> str:
    """Return a name that is not in `taken`, made unique by a number if need be, and add it there."""
    name = re.sub(r"\s", "_", name)
    candidates = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
    found = next(candidate for candidate in candidates if candidate not in taken)
    taken.add(found)
    return found
