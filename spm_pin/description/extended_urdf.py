"""Extended-URDF: the YAML file beside a URDF that closes its loops and names its motors, read and written.

Layout of https://github.com/Gepetto/example-parallel-robots.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from spm_pin.description.closures import KINDS, Closure, closure_at
from spm_pin.description.robot_description import RobotDescription
from spm_pin.mechanism.yaml_node import YamlNode

JOINT_TYPES = re.compile(r"SPHERICAL|FIXED|UJOINT_[XYZ][XYZ]")
"""Joint types that a joint of the URDF can be changed to when it is loaded."""


@dataclass(frozen=True)
class ExtendedUrdf:
    """The content of an Extended-URDF file."""

    closures: tuple[Closure, ...]
    """`closed_loop` and `type`, named as by the format's own loader: both frames with a C between."""
    motors: tuple[str, ...]
    """`name_mot`, the actuated joints."""
    joint_types: dict[str, str]
    """`joint_name` and `joint_type`: the joints of the URDF that the loader replaces, and by what."""


def read_extended_urdf(path: str | Path) -> ExtendedUrdf:
    """Read an Extended-URDF file.

    The keys are `closed_loop`, `type` and `name_mot`, and perhaps `joint_name` and `joint_type`.

    Raises
    ------
    DescriptionError
        If the file cannot be read or is malformed: lists of different lengths, unknown types, two frames or a motor
        twice. The error names the line. The format's own loader takes some of these, and drops what is too much.
    """
    root = YamlNode.read(Path(path), "the keys closed_loop, name_mot and type")
    found = root.mapping({"closed_loop", "type", "name_mot"}, {"joint_name", "joint_type"})
    lists = {key: node.items(key) for key, node in found.items()}
    for several, each in (("type", "closed_loop"), ("joint_type", "joint_name")):
        lists.setdefault(several, [])
        if len(lists[several]) != len(lists.setdefault(each, [])):
            expected = f"as many members under {several} as under {each}, {len(lists[each])}"
            raise found.get(several, root).error(expected, len(lists[several]))

    kinds = {name: kind for kind, name in KINDS.items()}
    closures: list[Closure] = []
    for node, named in zip(lists["closed_loop"], lists["type"], strict=True):
        ends = node.items("closed_loop", 2, "two frames for each closed loop")
        a, b = (end.name("closed_loop") for end in ends)
        kind = named.name("type").lower()
        if kind not in kinds:
            raise named.error(f"a type {' or '.join(kinds)}", repr(kind))
        closures.append(closure_at(node.place, closures, name=f"{a}C{b}", kind=kinds[kind], frame_a=a, frame_b=b))

    motors: list[str] = []
    types: dict[str, str] = {}
    for node in lists["name_mot"]:
        motor = node.name("name_mot")
        if motor in motors:
            raise node.error("each motor once", f"{motor} again")
        motors.append(motor)
    for node, type_node in zip(lists["joint_name"], lists["joint_type"], strict=True):
        joint, kind = node.name("joint_name"), type_node.name("joint_type")
        if joint in types:
            raise node.error("each joint once", f"{joint} again")
        if not JOINT_TYPES.fullmatch(kind):
            raise type_node.error("SPHERICAL, FIXED or UJOINT_ with two axes", repr(kind))
        types[joint] = kind
    return ExtendedUrdf(tuple(closures), tuple(motors), types)


def extended_urdf_text(robot: RobotDescription) -> str:
    """Return closures and motors of a robot as an Extended-URDF file, to lie beside its URDF.

    The names of the closures have no place in it. No joint changes its type when loaded: `joint_name` and `joint_type`
    are empty.
    """
    pairs = ",\n  ".join(f"[{_quoted((closure.frame_a, closure.frame_b))}]" for closure in robot.closures)
    return (
        f"closed_loop: [\n  {pairs}\n]\n"
        f"type: [{_quoted(KINDS[closure.kind] for closure in robot.closures)}]\n"
        f"name_mot: [{_quoted(transmission.joint for transmission in robot.transmissions)}]\n"
        "joint_name: []\njoint_type: []\n"
    )


def _quoted(names: Iterable[str]) -> str:
    return ", ".join("'" + name.replace("'", "''") + "'" for name in names)
