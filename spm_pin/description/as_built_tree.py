"""The spanning tree of a machine as built: the nominal robot with its axes, pivots and ball centres moved.

A corner's frame stands at a pivot, x along the revolute axis. The middle corners stand at the balls of the lower legs,
those of the upper legs 2 and 3 get frames of their own. Shapes and masses are those of the nominal robot, and so is the
meaning of a joint's zero: the machine is assembled at the joint values of its states, not at zero.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Placement
from spm_pin.mechanism import LEGS, AsBuiltGeometry, Configuration
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.joint_angles import home_leans, home_lengths
from spm_pin.mechanism.pose import homogeneous

__all__ = ["as_built_joint_values", "as_built_robot"]


def as_built_robot(robot: RobotDescription, geometry: AsBuiltGeometry, prefix: str) -> RobotDescription:
    """Return the robot of a nominal geometry with the dimensions of a machine as built; names begin with `prefix`."""
    corners, middle = _leg_frames(geometry), _middle_frames(geometry)
    moved: dict[str, FloatArray] = {f"base_a{i + 1}_mount": corners[i] for i in range(3)}
    moved |= {f"terminal_c{i + 1}_mount": corners[3 + i] for i in (1, 2)}
    moved |= {f"middle_b{i + 1}_mount": middle[i] for i in (1, 2)}
    moved["terminal_c1_mount"] = np.asarray(np.linalg.inv(corners[3]), np.float64)
    moved["middle_b1_mount"] = np.asarray(np.linalg.inv(middle[0]), np.float64)
    moved["ball_c1_z"] = moved["middle_b1_mount"] @ middle[3]
    joints = tuple(_moved(joint, moved, geometry, prefix) for joint in robot.joints)
    upper = {f"{prefix}leg_c{i}_tip": f"{prefix}middle_b{i}_upper" for i in (2, 3)}
    mounts = tuple(
        Joint(f"{name}_mount", "fixed", f"{prefix}middle_platform", name, _placement(middle[3 + i]))
        for i, name in enumerate(upper.values(), start=1)
    )

    def frame(name: str, other: str) -> str:
        return upper.get(other, name)

    closures = tuple(
        replace(c, frame_a=frame(c.frame_a, c.frame_b), frame_b=frame(c.frame_b, c.frame_a)) for c in robot.closures
    )
    shared = {f"{prefix}middle_b{i}": f"{prefix}middle_b{i}_upper" for i in (2, 3)}
    links = [_halved(link) if link.name in shared else link for link in robot.links]
    links += [Link(shared[link.name], link.inertial) for link in links if link.name in shared]
    return replace(robot, links=tuple(links), joints=(*joints, *mounts), closures=closures)


def as_built_joint_values(configuration: Configuration) -> dict[str, float]:
    """Return the values of the tree's joints in a single state of a machine as built, by name; see `joint_values`."""
    geometry, state = configuration.geometry, configuration
    leans, homes = home_leans(geometry.nominal), np.repeat(home_lengths(geometry.nominal), 3)
    local = state.balls.copy()
    local[3:] = (local[3:] - state.translation) @ state.rotation
    frames, turns = _leg_frames(geometry), []
    found: dict[str, float] = {}
    for i, (name, frame) in enumerate(zip(LEGS, frames, strict=True)):
        _, y, z = (local[i] - frame[:3, 3]) @ frame[:3, :3]
        turns.append(float(np.arctan2(-y, z)))
        found[f"leg{name[1:]}_hip"] = float(np.remainder(turns[-1] - leans[i] + np.pi, 2.0 * np.pi) - np.pi)
        found[f"leg{name[1:]}_slide"] = float(np.hypot(y, z) - homes[i])
    middle = state.middle_pose.as_matrix()[:3, :3] @ _middle_frames(geometry)[0][:3, :3]
    rods = [
        turned @ frames[i][:3, :3] @ Rotation.from_euler("x", turns[i]).as_matrix()
        for i, turned in ((0, np.eye(3)), (3, state.rotation))
    ]
    lower: Any = Rotation.from_matrix(rods[0].T @ middle).as_euler("XYZ")
    upper: Any = Rotation.from_matrix(middle.T @ rods[1]).as_euler("ZYX")
    # At zero the balls take back the lean of the first legs.
    angles = {
        "b": {"x": lower[0] + leans[0], "y": lower[1], "z": lower[2]},
        "c": {"x": upper[2] - leans[3], "y": upper[1], "z": upper[0]},
    }
    for stage, turns_of_ball in angles.items():
        for axis, angle in turns_of_ball.items():
            found[f"ball_{stage}1_{axis}"] = float(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
    return found


def _moved(joint: Joint, moved: dict[str, FloatArray], geometry: AsBuiltGeometry, prefix: str) -> Joint:
    """Return a joint at its place in the machine; the limits of a slide are those of its reading."""
    name = joint.name.removeprefix(prefix)
    if name in moved:
        return replace(joint, placement=_placement(moved[name]))
    if not name.endswith("_slide"):
        return joint
    offset = float(geometry.offsets[LEGS.index(f"r_{name[4:6]}")])
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


def _leg_frames(geometry: AsBuiltGeometry) -> list[FloatArray]:
    """Return the frames (4, 4) of the six legs in {B} or {m}: origin at the pivot, x the axis, z nearly upwards."""
    x = geometry.axes
    z = np.array([0.0, 0.0, 1.0]) - x[:, 2:] * x
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    turns = np.stack([x, np.cross(z, x), z], axis=-1)
    return [homogeneous(turn, pivot) for turn, pivot in zip(turns, geometry.pivots, strict=True)]


def _middle_frames(geometry: AsBuiltGeometry) -> list[FloatArray]:
    """Return frames (4, 4) at the six balls in {n}, turned as the corners of the nominal middle platform are."""
    axes = np.tile(geometry.nominal.revolute_axes, (2, 1))
    up = np.broadcast_to([0.0, 0.0, 1.0], axes.shape)
    turns = np.stack([axes, np.cross(up, axes), up], axis=-1)
    return [homogeneous(turn, ball) for turn, ball in zip(turns, geometry.balls, strict=True)]


def _placement(frame: FloatArray) -> Placement:
    rpy: Any = Rotation.from_matrix(frame[:3, :3]).as_euler("xyz")
    return Placement(tuple(frame[:3, 3].tolist()), tuple(rpy.tolist()))
