"""Writers of closed machines for other engines: MJCF, with equality constraints, and SDFormat."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.masses import Masses, Numbers, Placement
from spm_pin.description.robot import Joint, Link, Robot, Shape, read_robot
from spm_pin.description.source_files import Closure, check_prefix, machine_or_paper
from spm_pin.description.tree import HOME, machine_of, state_values
from spm_pin.errors import DescriptionError
from spm_pin.machine import Configuration, Stage
from spm_pin.machine.joint_angles import home_readings
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import FloatArray, check_instance, choice, real_number
from spm_pin.support.xml_elements import Value, document, element, texts, written

_ORIGIN = "Written by spm_pin, which is the place for changes."

_ACTUATORS = {"spm": "motors", "stage": "servos"}
"""Default actuators, by `Machine.file_stem`."""
SERVO = 200.0
"""Natural frequency of the machine on its servos [rad/s]: they deflect by g / SERVO² = 0.25 mm under its weight."""
_FRICTION = (0.8, 0.001, 0.0001)
"""Friction between ball and plate in MuJoCo's terms: Coulomb's coefficient, and the lever arms of the moments against
spinning and rolling [m]."""


@dataclass(frozen=True)
class Ball:
    """A ball that rolls freely on a stage's platform, and the round plate under it, for `mjcf_text`.

    Parameters
    ----------
    radius, mass : float
        Radius [m] and mass [kg] of the solid ball; by default about those of a golf ball.
    plate_radius, plate_height : float, optional
        Radius of the plate, and height of its upper face above the platform's origin [m]; by default 1.5 and 0.2
        times the platform's radius. The plate's mass is part of the platform's.
    """

    radius: float = 0.02
    mass: float = 0.045
    plate_radius: float | None = None
    plate_height: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("radius", "m"), ("mass", "kg"), ("plate_radius", "m"), ("plate_height", "m")):
            value = getattr(self, name)
            if value is not None or not name.startswith("plate"):
                number = real_number(value, name, f"a positive number of {unit}, to 100", above=0.0, most=100.0)
                object.__setattr__(self, name, number)

    def plate(self, stage: Stage) -> tuple[float, float]:
        """Return the radius of a stage's plate, and the height of its upper face [m]."""
        return self.plate_radius or 1.5 * stage.platform_radius, self.plate_height or 0.2 * stage.platform_radius

    def at_rest(self, stage: Stage, platform: FloatArray, place: Iterable[float] = (0.0, 0.0)) -> FloatArray:
        """Return the ball's centre (3,) at x and y on the plate, for this pose (4, 4) of the platform [m]."""
        _, height = self.plate(stage)
        return np.asarray((platform @ [*place, height + self.radius, 1.0])[:3])


def mjcf_text(
    machine: Machine | None = None,
    *,
    prefix: str = "",
    states: Mapping[str, Configuration] | None = None,
    actuators: str | None = None,
    ball: Ball | None = None,
    collisions: str | None = None,
    meshes: str | None = None,
    masses: Masses | None = None,
) -> str:
    """Return a manipulator, or a stage alone, as an MJCF file.

    Parameters
    ----------
    machine, prefix, meshes, masses
        As for `urdf_text`.
    states : mapping of str to Configuration, optional
        Named states of this machine, which become keyframes after `home`: all joints at zero, or, if the loops of a
        calibrated machine are open there, the actuated joints, and the others where the loops close.
    actuators : str, optional
        "motors", whose `ctrl` is the effort, the default for a manipulator; or "servos", whose `ctrl` is the reading
        to reach, within its limits, the default for a stage.
    ball : Ball, optional
        A ball on a stage's platform, with its plate; they collide with one another and nothing else.
    collisions : str, optional
        Shapes that collide. "exact", the default: those of the URDF. "simple": capsules and boxes inside them in
        place of cylinders, whose contacts with boxes MJX does not support. "none": no shape collides.

    Notes
    -----
    The base is welded to the world. q is the same vector as in Pinocchio when it reads the URDF. Links are bodies; the
    base, closures' frames and links fixed to others have sites too, whose names end in _site. Velocity limits,
    which MJCF cannot express, are the numeric `velocity_limit`, in the order of the joints. The ball's six degrees of
    freedom come last.
    """
    check_prefix(prefix)
    machine = machine_of({} if states is None else states, machine_or_paper(machine))
    values_by_state = state_values({} if states is None else states, machine, prefix)
    kind = _ACTUATORS[machine.file_stem] if actuators is None else actuators
    kind = choice(kind, "actuators", ("motors", "servos"))
    stage = None if ball is None else _stage_under(ball, machine)
    shapes = choice("exact" if collisions is None else collisions, "collisions", ("exact", "simple", "none"))
    robot = read_robot(machine, prefix=prefix, meshes=meshes, masses=masses)
    home = robot.closed_home()
    values_by_state[HOME] = home
    # Each scale of a file becomes a mesh of its own.
    files: dict[tuple[str, Numbers], str] = {}
    for shape in (shape for link in robot.links.values() for shape in link.visuals):
        stem = PurePosixPath(shape.mesh).stem
        count = sum(PurePosixPath(file).stem == stem for file, _ in files)
        files.setdefault((shape.mesh, shape.size), f"{stem}_{count + 1}" if count else stem)
    assets = [element("mesh", name=name, file=file, scale=size) for (file, size), name in files.items()]
    assets += [element("material", name=name, rgba=rgba) for name, rgba in robot.materials.items()]
    zeros = home_readings(machine) + machine.legs.offsets
    driven = list(_servos(robot, machine, zeros) if kind == "servos" else _motors(robot))
    body = _body(robot, robot.base, home, _sites(robot), files, shapes)
    keys, balls = [], []
    rolling: dict[str, Value] = {}
    platform = f"{prefix}platform"
    if ball and stage:
        # To reduce slip at rest: a ball would roll with a tenth of its rolling friction.
        rolling = {"cone": "elliptic", "impratio": "10"}
        balls = [_ball(ball, stage, body, platform, robot.frames(home)[platform])]
    for name, values in values_by_state.items():
        state: dict[str, list[float]] = {"qpos": [values[joint.name] for joint in robot.moving]}
        if ball and stage:
            state["qpos"] += [*ball.at_rest(stage, robot.frames(values)[platform]), 1.0, 0.0, 0.0, 0.0]
        if kind == "servos":
            state["ctrl"] = (zeros + [values[joint] for joint in robot.motors]).tolist()
        keys.append(element("key", name=name, **state))
    velocities = [joint.limits["velocity"] for joint in robot.moving]
    root = element(
        "mujoco",
        element("compiler", angle="radian", autolimits="true"),
        # Rigid closures: steps that resolve the constraints' time constant, and no softening under load.
        element("option", timestep="0.001", integrator="implicitfast", **rolling),
        element("default", element("equality", solref="0.002 1", solimp="0.9999 0.9999 0.001 0.5 2")),
        element(
            "visual",
            element("headlight", ambient="0.4 0.4 0.4", diffuse="0.6 0.6 0.6"),
            element("global", offwidth="1280", offheight="960"),
        ),
        element("asset", *assets),
        element("worldbody", body, *balls),
        element("equality", *(_connection(robot, closure) for closure in robot.closures)),
        element("actuator", *driven),
        element("custom", element("numeric", name="velocity_limit", data=velocities)),
        element("keyframe", *keys),
        model=robot.name,
    )
    return document(root, _ORIGIN)


def _motors(robot: Robot) -> Iterable[Element]:
    for joint, motor in robot.motors.items():
        effort = robot.joints[joint].limits["effort"]
        yield element("motor", name=motor, joint=joint, ctrllimited="true", ctrlrange=(-effort, effort))


def _servos(robot: Robot, machine: Machine, zeros: FloatArray) -> Iterable[Any]:
    """Yield servos whose commands are readings, critically damped; three hold all moving masses with `SERVO`."""
    said = "ctrl is the reading of each leg, in metres, for cranks in radians: the value of its joint plus "
    assumed = "Their largest forces are assumed, and all masses that were not given, by the machine's size."
    yield ElementTree.Comment(f" {said}{written(zeros)}. {assumed} ")
    mass = sum(link.mass for name, link in robot.links.items() if robot.carrier(name)[0] != robot.base)
    for (joint, motor), zero, arm in zip(robot.motors.items(), zeros, machine.legs.largest_slopes, strict=True):
        limits, stiffness = robot.joints[joint].limits, SERVO**2 * mass / 3.0 * arm**2
        values: dict[str, Value] = {"name": motor.removesuffix("motor") + "servo", "joint": joint, "gainprm": stiffness}
        values |= {"biastype": "affine", "biasprm": (-stiffness * zero, -stiffness, -2.0 * stiffness / SERVO)}
        values |= {"ctrllimited": "true", "ctrlrange": (limits["lower"] + zero, limits["upper"] + zero)}
        yield element("general", **values, forcelimited="true", forcerange=(-limits["effort"], limits["effort"]))


def _stage_under(ball: Ball, machine: Machine) -> Stage:
    check_instance(ball, Ball, "ball")
    if not isinstance(machine, Stage):
        raise DescriptionError("ball", "a single stage, on which it rolls", "a manipulator")
    return machine


def _ball(ball: Ball, stage: Stage, body: Element, platform: str, home: FloatArray) -> Element:
    """Return the body of a ball at rest in the home, and add the plate under it to the platform's body."""
    radius, height = ball.plate(stage)
    half = 0.02 * stage.platform_radius
    # Their own collision bits, so that nothing else of the machine is touched. A fifth of the default time constant.
    both: dict[str, Value] = {
        "contype": "2",
        "conaffinity": "2",
        "condim": "6",
        "friction": _FRICTION,
        "solref": (0.004, 1.0),
    }
    size, colour = (radius, half), (0.867, 0.878, 0.890, 0.9)
    plate = element(
        "geom", name=f"{platform}_plate", type="cylinder", size=size, pos=(0.0, 0.0, height - half), rgba=colour, **both
    )
    next(each for each in body.iter("body") if each.get("name") == platform).append(plate)
    solid = element("geom", type="sphere", size=ball.radius, mass=ball.mass, rgba=(0.835, 0.369, 0.0, 1.0), **both)
    name = platform.removesuffix("platform") + "ball"
    return element("body", element("freejoint", name=f"{name}_free"), solid, name=name, pos=ball.at_rest(stage, home))


def _sites(robot: Robot) -> dict[str, dict[str, FloatArray]]:
    """Return the frames to be marked, by the body that moves with them, and their poses (4, 4) in it.

    Pinocchio misplaces constraints and sites in bodies without a joint of their own.
    """
    sites: dict[str, dict[str, FloatArray]] = {}
    ends = {frame for closure in robot.closures for frame in (closure.frame_a, closure.frame_b)}
    for link in robot.links:
        carrier, pose = robot.carrier(link)
        if link in ends or link == robot.base or carrier != link:
            sites.setdefault(carrier, {})[link] = pose
    return sites


def _body(
    robot: Robot,
    name: str,
    home: Mapping[str, float],
    sites: Mapping[str, Mapping[str, FloatArray]],
    meshes: Mapping[tuple[str, Numbers], str],
    collisions: str,
) -> Element:
    """Return the body of a link, those of its child links inside, in the home, from which engines take anchors."""
    link, joint, parts = robot.links[name], robot.joint_to.get(name), []
    place = {} if joint is None else _place(joint.placement)
    if joint is not None and joint.moves:
        limits, effort = joint.limits, joint.limits["effort"]
        kind = {"prismatic": "slide", "revolute": "hinge"}[joint.kind]
        values: dict[str, Value] = {"type": kind, "axis": joint.axis, "limited": "true"}
        values["range"] = (limits["lower"], limits["upper"])
        if value := home[joint.name]:
            values["ref"] = value
            place = _pose_of(joint.placement.matrix @ joint.motion(value))
        if effort > 0.0:
            values |= {"actuatorfrclimited": "true", "actuatorfrcrange": (-effort, effort)}
        parts.append(element("joint", name=joint.name, **values))
    parts.append(element("inertial", mass=link.mass, diaginertia=link.moments, **_place(link.inertial)))
    for shape in link.visuals:
        seen = {"material": shape.material, "contype": "0", "conaffinity": "0"}
        parts.append(element("geom", **_solid(shape, "2", meshes), **seen))
    for shape in () if collisions == "none" else link.collisions:
        solid = _solid(shape, "3", meshes)
        if collisions == "simple" and shape.kind == "cylinder":
            solid |= _without_cylinder(*shape.size)
        parts.append(element("geom", **solid))
    for frame, pose in sites.get(name, {}).items():
        parts.append(element("site", name=f"{frame}_site", size="0.005", **_pose_of(pose)))
    parts += [_body(robot, each.child, home, sites, meshes, collisions) for each in robot.order if each.parent == name]
    return element("body", *parts, name=name, **place)


def _solid(shape: Shape, group: str, meshes: Mapping[tuple[str, Numbers], str]) -> dict[str, Value]:
    solid: dict[str, Value] = {"type": shape.kind, "group": group, **_place(shape.placement)}
    if shape.kind == "mesh":
        return solid | {"mesh": meshes[shape.mesh, shape.size]}
    # MuJoCo takes half the sides of a box and half the length of a cylinder.
    halves = {"box": 0.5, "cylinder": np.array([1.0, 0.5]), "sphere": 1.0}
    return solid | {"size": halves[shape.kind] * np.array(shape.size)}


def _without_cylinder(radius: float, length: float) -> dict[str, Value]:
    """Return a capsule inside a cylinder, or a square box inside a flat one."""
    if length > 2.0 * radius:
        return {"type": "capsule", "size": (radius, 0.5 * length - radius)}
    return {"type": "box", "size": (radius / np.sqrt(2.0), radius / np.sqrt(2.0), 0.5 * length)}


def _connection(robot: Robot, closure: Closure) -> Element:
    # Two bodies and a point in the first: Drake ignores closures between sites.
    (body_a, pose), (body_b, _) = (robot.carrier(end) for end in (closure.frame_a, closure.frame_b))
    return element("connect", name=closure.name, body1=body_a, body2=body_b, anchor=pose[:3, 3])


def _pose_of(pose: FloatArray) -> dict[str, Value]:
    return {"pos": pose[:3, 3], "quat": Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)}


def _place(placement: Placement) -> dict[str, Value]:
    return {"pos": placement.xyz, "quat": placement.rotation.as_quat(scalar_first=True)}


def sdf_text(
    machine: Machine | None = None,
    *,
    prefix: str = "",
    loops: str | None = None,
    meshes: str | None = None,
    masses: Masses | None = None,
) -> str:
    """Return a manipulator, or a stage alone, as an SDFormat model, its base fixed to the world.

    Parameters
    ----------
    machine, prefix, meshes, masses
        As for `urdf_text`.
    loops : str, optional
        "joints": a ball joint between the two frames of each closure, which requires a robot that is assembled at
        zero, as nominal ones are. "drake": Drake's ball constraints, since Drake does not support loops of joints.
        By default joints if possible.

    Notes
    -----
    http://sdformat.org/spec, version 1.9. A joint is driven if its limit of effort is not zero.
    """
    robot = read_robot(machine, prefix=prefix, meshes=meshes, masses=masses)
    is_assembled = robot.is_assembled()
    way = "joints" if is_assembled else "drake"
    loops = choice(way if loops is None else loops, "loops", ("joints", "drake"))
    if loops == "joints" and not is_assembled:
        raise DescriptionError("loops", "drake for a machine whose loops are open at zero", loops)
    ends = {"parent": "world", "child": robot.base}
    model = element(
        "model",
        element("joint", *texts(**ends), name=f"{robot.base}_to_world", type="fixed"),
        *(_sdf_link(robot, name, link) for name, link in robot.links.items()),
        *map(_sdf_joint, robot.joints.values()),
        *(_sdf_closure(closure, loops) for closure in robot.closures),
        name=robot.name,
    )
    return document(element("sdf", model, **{"version": "1.9", "xmlns:drake": "http://drake.mit.edu"}), _ORIGIN)


def _pose(placement: Placement, **relative: str) -> Element:
    return element("pose", text=(*placement.xyz, *placement.rpy), **relative)


def _sdf_link(robot: Robot, name: str, link: Link) -> Element:
    moments = dict(zip(("ixx", "iyy", "izz"), link.moments, strict=True))
    inertia = element("inertia", *texts(**moments, ixy=0.0, ixz=0.0, iyz=0.0))
    carrier = robot.joint_to.get(name)
    shapes = {"visual": link.visuals, "collision": link.collisions}
    return element(
        "link",
        None if carrier is None else _pose(Placement(), relative_to=carrier.name),
        element("inertial", _pose(link.inertial), *texts(mass=link.mass), inertia),
        *(
            _sdf_shape(robot, tag, f"{name}_{tag}_{i}", shape)
            for tag, solids in shapes.items()
            for i, shape in enumerate(solids, start=1)
        ),
        name=name,
    )


def _sdf_shape(robot: Robot, tag: str, name: str, shape: Shape) -> Element:
    if shape.kind == "mesh":
        solid = texts(uri=shape.mesh, scale=shape.size)
    elif shape.kind == "box":
        solid = texts(size=shape.size)
    else:
        solid = texts(**dict(zip(("radius", "length"), shape.size, strict=False)))
    parts = [_pose(shape.placement), element("geometry", element(shape.kind, *solid))]
    if shape.material:
        colour = robot.materials[shape.material]
        parts.append(element("material", *texts(ambient=colour, diffuse=colour)))
    return element(tag, *parts, name=name)


def _sdf_joint(joint: Joint) -> Element:
    parts = [_pose(joint.placement, relative_to=joint.parent), *texts(parent=joint.parent, child=joint.child)]
    if joint.moves:
        parts.append(element("axis", *texts(xyz=joint.axis), element("limit", *texts(**joint.limits))))
    return element("joint", *parts, name=joint.name, type=joint.kind)


def _sdf_closure(closure: Closure, loops: str) -> Element:
    if loops == "joints":
        return element("joint", *texts(parent=closure.frame_a, child=closure.frame_b), name=closure.name, type="ball")
    ends = {"body_A": closure.frame_a, "p_AP": "0 0 0", "body_B": closure.frame_b, "p_BQ": "0 0 0"}
    tag = "drake:ball_constraint"
    return element(tag, *texts(**{f"{tag}_{key}": end for key, end in ends.items()}))
