"""MJCF, its loops closed by equality constraints."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import ASSEMBLED, RobotDescription
from spm_pin.description.robot_parts import Inertial, Joint, Material, Placement, Shape, Transmission
from spm_pin.description.srdf import HOME
from spm_pin.description.xml_nodes import document, element
from spm_pin.errors import DescriptionError
from spm_pin.mechanism.arguments import FloatArray, choice

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
    return document(_Writer(robot, choice(anchors, "anchors", ("bodies", "sites")), folder).root())


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
        assets = self._assets()
        velocities = [joint.limit.velocity for joint in robot.moving]
        custom = None
        if any(map(math.isfinite, velocities)):
            data = [value if math.isfinite(value) else 0.0 for value in velocities]
            custom = element("custom", element("numeric", name="velocity_limit", data=data))
        states: Mapping[str, Mapping[str, float]] = {HOME: {}, **robot.states}
        keys = (
            element("key", name=name, qpos=[values.get(joint.name, 0.0) for joint in robot.moving])
            for name, values in states.items()
        )
        return element(
            "mujoco",
            element("compiler", angle="radian", autolimits="true"),
            # Rigid closures: steps that resolve the constraints' time constant, and no softening under load.
            element("option", timestep="0.001", integrator="implicitfast"),
            element("default", element("equality", solref="0.002 1", solimp="0.9999 0.9999 0.001 0.5 2")),
            element(
                "visual",
                element("headlight", ambient="0.4 0.4 0.4", diffuse="0.6 0.6 0.6"),
                element("global", offwidth="1280", offheight="960"),
            ),
            element("asset", *assets) if assets else None,
            element("worldbody", self._body(robot.base, None)),
            element("equality", *map(self._closure, robot.closures)) if robot.closures else None,
            element("actuator", *map(self._motor, robot.transmissions)) if robot.transmissions else None,
            custom,
            element("keyframe", *keys),
            model=robot.name,
        )

    def _motor(self, transmission: Transmission) -> Element:
        effort = next(joint.limit.effort for joint in self.robot.joints if joint.name == transmission.joint)
        limits: dict[str, Any] = {"ctrllimited": "true", "ctrlrange": (-effort, effort)} if effort < math.inf else {}
        return element("motor", name=transmission.actuator, joint=transmission.joint, **limits)

    def _assets(self) -> list[Element]:
        self.materials: dict[Material, str] = {}
        self.meshes: dict[tuple[str, tuple[float, ...]], str] = {}
        assets: list[Element] = []
        taken: set[str] = set()
        for shape in (s for link in self.robot.links for s in (*link.visuals, *link.collisions)):
            if shape.material is not None and shape.material not in self.materials:
                name = self.materials[shape.material] = _free(shape.material.name or "material", taken)
                assets.append(element("material", name=name, rgba=shape.material.rgba))
            if shape.mesh is not None and (str(shape.mesh.path), shape.size) not in self.meshes:
                if shape.mesh.path.suffix.lower() not in MESHES:
                    raise DescriptionError("robot", f"meshes in {', '.join(MESHES)}", shape.mesh.uri)
                name = self.meshes[str(shape.mesh.path), shape.size] = _free(shape.mesh.path.stem, taken)
                file = shape.mesh.reference(self.folder, uri=False)
                assets.append(element("mesh", name=name, file=file, scale=shape.size))
        return assets

    def _body(self, name: str, joint: Joint | None) -> Element:
        link = self.robot.link[name]
        parts = [] if joint is None or not joint.moves else [_joint(joint)]
        if link.inertial is not None and link.inertial.mass > 0.0:
            parts.append(_inertial(link.inertial))
        elif parts:
            raise DescriptionError("robot", "mass in every link that a joint moves", f"none in {name}")
        parts += [self._geom(shape, {"contype": "0", "conaffinity": "0", "group": "2"}) for shape in link.visuals]
        parts += [self._geom(shape, {"group": "3"}) for shape in link.collisions]
        for frame, at in self.sites.get(name, {}).items():
            turn = Rotation.from_matrix(at[:3, :3]).as_quat(scalar_first=True)
            parts.append(element("site", name=f"{frame}_site", size="0.005", pos=at[:3, 3], quat=turn))
        parts += [self._body(leaving.child, leaving) for leaving in self.robot.order if leaving.parent == name]
        return element("body", *parts, name=name, **({} if joint is None else _place(joint.placement)))

    def _geom(self, shape: Shape, seen: dict[str, Any]) -> Element:
        if shape.mesh is not None:
            solid: dict[str, Any] = {"mesh": self.meshes[str(shape.mesh.path), shape.size]}
        elif shape.kind == "box":
            solid = {"size": [0.5 * side for side in shape.size]}
        else:  # of a cylinder, MuJoCo takes half the length
            solid = {"size": np.array(shape.size) * (1.0, 0.5)[: len(shape.size)]}
        solid |= _place(shape.placement)
        if shape.material is not None:
            solid["material"] = self.materials[shape.material]
        return element("geom", **{"type": shape.kind, **solid, **seen})

    def _closure(self, closure: Closure) -> Element:
        (body_a, at_a), (body_b, at_b) = (self.robot.carrier(end) for end in (closure.frame_a, closure.frame_b))
        if body_a == self.robot.base:  # Pinocchio needs a moving first body
            body_a, at_a, body_b, at_b = body_b, at_b, body_a, at_a
        if body_a == body_b:
            raise DescriptionError("robot", "closures between links that move apart", closure.name)
        if closure.kind == "weld":
            relative = at_a @ np.linalg.inv(at_b)  # without an anchor: MuJoCo takes another relpose beside one
            quaternion = Rotation.from_matrix(relative[:3, :3]).as_quat(scalar_first=True)
            pose = (*relative[:3, 3], *quaternion)
            return element("weld", name=closure.name, body1=body_a, body2=body_b, relpose=pose)
        if self.by_sites:
            ends = f"{closure.frame_a}_site", f"{closure.frame_b}_site"
            return element("connect", name=closure.name, site1=ends[0], site2=ends[1])
        return element("connect", name=closure.name, body1=body_a, body2=body_b, anchor=at_a[:3, 3])


def _place(placement: Placement) -> dict[str, Any]:
    return {"pos": placement.xyz, "quat": placement.quaternion}


def _joint(joint: Joint) -> Element:
    limit = joint.limit
    values: dict[str, Any] = {"type": "slide" if joint.kind == "prismatic" else "hinge", "axis": joint.axis}
    if limit.lower == limit.upper:
        expected = "joints with room to move: MJCF has no empty ranges"
        raise DescriptionError("robot", expected, f"[{limit.lower:g}, {limit.upper:g}] of {joint.name}")
    if math.isfinite(limit.lower) and math.isfinite(limit.upper):
        values |= {"limited": "true", "range": (limit.lower, limit.upper)}
    elif math.isfinite(limit.lower) or math.isfinite(limit.upper):
        raise DescriptionError("robot", "two limits of a joint, or none", f"one of {joint.name}")
    if 0.0 < limit.effort < math.inf:
        values |= {"actuatorfrclimited": "true", "actuatorfrcrange": (-limit.effort, limit.effort)}
    if joint.damping:
        values["damping"] = joint.damping
    if joint.friction:
        values["frictionloss"] = joint.friction
    return element("joint", name=joint.name, **values)


def _inertial(inertial: Inertial) -> Element:
    xx, xy, xz, yy, yz, zz = inertial.moments
    if xy == xz == yz == 0.0:
        place = _place(inertial.placement)
        return element("inertial", pos=place["pos"], mass=inertial.mass, quat=place["quat"], diaginertia=(xx, yy, zz))
    # In the link's axes: MJCF takes either an orientation or all six.
    turn: FloatArray = inertial.placement.matrix[:3, :3]
    full = turn @ inertial.matrix @ turn.T
    moments = [*np.diag(full), full[0, 1], full[0, 2], full[1, 2]]
    return element("inertial", pos=inertial.placement.xyz, mass=inertial.mass, fullinertia=moments)


def _free(name: str, taken: set[str]) -> str:
    """Return a name that is not in `taken`, made unique by a number if need be, and add it there."""
    name = re.sub(r"\s", "_", name)
    candidates = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
    found = next(candidate for candidate in candidates if candidate not in taken)
    taken.add(found)
    return found
