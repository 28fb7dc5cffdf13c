"""The spanning tree of a machine as built: the nominal robot with its axes, pivots and ball centres moved.

A corner's frame stands at a pivot, x along the revolute axis. The middle corners stand at the balls of the lower legs,
those of the upper legs 2 and 3 get frames of their own. Shapes and masses are those of the nominal robot, and so is the
meaning of a joint's zero: the machine is assembled at the joint values of its states, not at zero.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Placement
from spm_pin.mechanism import LEGS, Geometry
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.leg_frames import ball_placements, leg_placements


def as_built_robot(robot: RobotDescription, geometry: Geometry, prefix: str) -> RobotDescription:
    """Return the robot of a nominal geometry with the dimensions of a machine as built; names begin with `prefix`."""
    corners, middle = leg_placements(geometry), ball_placements(geometry)
    moved: dict[str, FloatArray] = {f"base_a{i + 1}_mount": corners[i] for i in range(3)}
    moved |= {f"terminal_c{i + 1}_mount": corners[3 + i] for i in (1, 2)}
    moved |= {f"middle_b{i + 1}_mount": middle[i] for i in (1, 2)}
    moved["terminal_c1_mount"] = np.asarray(np.linalg.inv(corners[3]), np.float64)
    moved["middle_b1_mount"] = np.asarray(np.linalg.inv(middle[0]), np.float64)
    moved["ball_c1_z"] = moved["middle_b1_mount"] @ middle[3]
    joints = tuple(_moved(joint, moved, geometry, prefix) for joint in robot.joints)
    shared = {f"{prefix}middle_b{i}": f"{prefix}middle_b{i}_upper" for i in (2, 3)}
    mounts = tuple(
        Joint(f"{name}_mount", "fixed", f"{prefix}middle_platform", name, _placement(middle[3 + i]))
        for i, name in enumerate(shared.values(), start=1)
    )
    links = [_halved(link) if link.name in shared else link for link in robot.links]
    links += [Link(shared[link.name], link.inertial) for link in links if link.name in shared]
    return replace(
        robot, links=tuple(links), joints=(*joints, *mounts), closures=as_built_closures(robot.closures, prefix)
    )


def as_built_closures(closures: Iterable[Closure], prefix: str) -> tuple[Closure, ...]:
    """Return the closures of a nominal robot with those of the upper legs at the balls of these."""
    tips = {f"{prefix}leg_c{i}_tip": f"{prefix}middle_b{i}_upper" for i in (2, 3)}
    return tuple(
        replace(c, frame_a=tips.get(c.frame_b, c.frame_a), frame_b=tips.get(c.frame_a, c.frame_b)) for c in closures
    )


def _moved(joint: Joint, moved: dict[str, FloatArray], geometry: Geometry, prefix: str) -> Joint:
    """Return a joint at its place in the machine; the limits of a slide are those of its reading."""
    name = joint.name.removeprefix(prefix)
    if name in moved:
        return replace(joint, placement=_placement(moved[name]))
    if not name.endswith("_slide"):
        return joint
    offset = float(geometry.legs.offsets[LEGS.index(f"r_{name[4:6]}")])
    return replace(
        joint, limit=replace(joint.limit, lower=joint.limit.lower - offset, upper=joint.limit.upper - offset)
    )


def _halved(link: Link) -> Link:
    """Return a link with half its mass: the bracket of a corner is shared by its two balls."""
    inertial = link.inertial
    if inertial is None:
        return link
    moments: Any = tuple(0.5 * moment for moment in inertial.moments)
    return replace(link, inertial=replace(inertial, mass=0.5 * inertial.mass, moments=moments))


def _placement(frame: FloatArray) -> Placement:
    rpy: Any = Rotation.from_matrix(frame[:3, :3]).as_euler("xyz")
    return Placement(tuple(frame[:3, 3].tolist()), tuple(rpy.tolist()))
