"""Robots from URDF files, which are trees: what closes their loops is in a YAML file beside or in Drake's tags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any
from xml.etree.ElementTree import Element

import pinocchio as pin
import yaml

from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.loops.closures import Anchor, Closure, ClosureKind, JointEquality, RobotDescription
from spm_pin.loops.links import Joint, JointKind, Link, build_model, check_unique, describe, hinges_of_points, place
from spm_pin.loops.xml_input import inertia_of, name_of, number, numbers, read_source, read_xml, unit_axis
from spm_pin.support.arguments import as_bool, name_sequence, type_and_value
from spm_pin.support.files import file_path

_KINDS: dict[str, JointKind | None] = {
    "revolute": "hinge",
    "continuous": "hinge",
    "prismatic": "slide",
    "floating": "free",
    "fixed": None,
}
CLOSURE_TYPES: dict[str, ClosureKind] = {"3d": "point", "6d": "weld", "hinge": "hinge", "planar": "planar"}
"""Kinds of closures by their names in the YAML file; `hinge` and `planar` are additions to the published format."""


def read_urdf(
    source: Any,
    closures: Any = None,
    *,
    free_base: bool = False,
    actuated: Sequence[str] | None = None,
    srdf: str | PathLike[str] | None = None,
) -> RobotDescription:
    """Return a robot of a URDF file and of what closes its loops.

    Parameters
    ----------
    source : path or str
        A URDF file, or its text.
    closures : path, str or sequence of Closure, optional
        The YAML file that belongs to the URDF, as example-parallel-robots has it, or its text: `closed_loop`, pairs of
        links; `type`, for each `3d` (a point) or `6d` (a weld), and besides these `hinge` and `planar`; `name_mot`,
        the actuated joints; `joint_name` and `joint_type`, joints that are `SPHERICAL`, `FIXED` or `UJOINT_XY`
        instead, the latter with two axes, of which the joints are called `name_X` and `name_Y`. Or the closures
        themselves. By default those of the file's `drake:ball_constraint` tags.
    free_base : bool
        Whether the root link floats, by a joint called `root_joint`, instead of being fixed to the world.
    actuated : sequence of str, optional
        Names of the actuated joints; by default those of the YAML file, or of the URDF's transmissions.
    srdf : path, optional
        An SRDF file with named configurations; those of joints that the robot does not have are passed over.

    Notes
    -----
    Joints come in Pinocchio's order: depth first, those of one link by name. A continuous joint is one of one value
    without limits, in rad. Joints with `mimic` become joint equalities. Meshes are not read.

    Raises
    ------
    DescriptionError
        A file that is missing, malformed, or no tree; the argument says which file, and which joint or link.
    """
    root, where = read_xml(source, "robot", "a URDF file")
    extras: dict[str, Any] = {}
    if closures is None:
        loops = drake_closures(root, where)
    elif isinstance(closures, str | PathLike):
        loops, extras = _read_yaml(closures)
    elif isinstance(closures, list | tuple) and all(isinstance(closure, Closure) for closure in closures):
        loops = list(closures)
    else:
        raise ArgumentError("closures", "a YAML file, its text, or a sequence of Closure", type_and_value(closures))
    links = list(_links(root, where, as_bool(free_base, "free_base"), extras))
    model = build_model(root.get("name", ""), links, {}, where)
    if actuated is None:
        actuated = extras.get("name_mot") or list(_transmissions(root, where))
    else:
        name_sequence(actuated, "actuated")
    mimics = list(_mimics(root, where))
    return describe(model, loops, mimics, actuated, read_configurations(model, srdf), where)


def read_configurations(model: Any, srdf: str | PathLike[str] | None) -> dict[str, Any]:
    """Return the configurations that an SRDF file names."""
    if srdf is None:
        return {}
    read_xml(file_path(srdf, "srdf", expected="an SRDF file"), "robot", "an SRDF file", "srdf")
    # A copy: the model that is handed out is the file's alone.
    named = model.copy()
    pin.loadReferenceConfigurations(named, str(srdf), False)
    return {entry.key(): entry.data().copy() for entry in named.referenceConfigurations}


def _links(root: Element, where: str, free_base: bool, extras: dict[str, Any]) -> Iterator[Link]:
    """Yield the links from the root on, depth first, those of one parent by the names of their joints."""
    nodes = {name_of(node, f"{where}, link"): node for node in root.findall("link")}
    check_unique([node.get("name", "") for node in root.findall("link")], "link", where)
    joints = sorted(root.findall("joint"), key=lambda node: name_of(node, f"{where}, joint"))
    check_unique([node.get("name", "") for node in joints], "joint", where)
    for node in root.findall("drake_joint"):
        raise DescriptionError(
            f"{where}, joint {node.get('name')!r}", "a joint of URDF", f"drake:joint {node.get('type')}"
        )
    children: dict[str, list[Element]] = {name: [] for name in nodes}
    carriers: dict[str, str] = {}
    for node in joints:
        at = f"{where}, joint {node.get('name')!r}"
        ends = []
        for tag in ("parent", "child"):
            end = node.find(tag)
            ends.append("" if end is None else name_of(end, at, "link"))
            if ends[-1] not in nodes:
                raise DescriptionError(at, f"a link of the file as its {tag}", repr(ends[-1]) if ends[-1] else "none")
        parent, child = ends
        if child in carriers:
            cause = "A URDF is a tree: cut the loop there, and name what closes it in a YAML file or a Drake tag"
            raise DescriptionError(
                at, "a child without another parent", f"{child!r}, child of {carriers[child]!r}", cause
            )
        carriers[child] = str(node.get("name"))
        children[parent].append(node)
    changed = dict(zip(extras.get("joint_name") or (), extras.get("joint_type") or (), strict=False))
    for name in sorted(changed.keys() - carriers.values()):
        raise DescriptionError(f"{extras['file']}, joint_name", f"a joint of {where}", repr(name))
    roots = [name for name in nodes if name not in carriers]
    if len(roots) != 1:
        raise DescriptionError(
            where,
            "one link without a parent",
            ", ".join(map(repr, roots)) or ("a ring of links" if nodes else "no link"),
        )
    base = (Joint("root_joint", "free"),) if free_base else ()
    stack = [Link(roots[0], None, pin.SE3.Identity(), base, _inertia(nodes[roots[0]], where))]
    seen = 0
    while stack:
        link = stack.pop()
        yield link
        seen += 1
        for node in reversed(children[link.name]):
            child = node.find("child").get("link", "")  # type: ignore[union-attr]
            placement, moved = _joint(node, where, changed.get(str(node.get("name"))))
            stack.append(Link(child, link.name, placement, moved, _inertia(nodes[child], where)))
    if seen < len(nodes):
        raise DescriptionError(where, "a tree of links with one root", "a ring of links without a root")


def _joint(node: Element, where: str, change: str | None) -> tuple[Any, tuple[Joint, ...]]:
    """Return where a joint is in its parent, and its joints: none if it is fixed, two if it is a universal one."""
    name, kind = str(node.get("name")), node.get("type", "")
    at = f"{where}, joint {name!r}"
    if kind not in _KINDS:
        raise DescriptionError(at, f"one of the types {', '.join(_KINDS)}", repr(kind))
    placement = _origin(node.find("origin"), at)
    if change == "SPHERICAL":
        return placement, (Joint(name, "ball"),)
    if change and change.startswith("UJOINT_") and len(change) == 9 and set(change[7:]) <= set("XYZ"):
        axes = {letter: tuple(float(letter == other) for other in "XYZ") for letter in change[7:]}
        return placement, tuple(Joint(f"{name}_{letter}", "hinge", axis) for letter, axis in axes.items())  # type: ignore[arg-type]
    if change not in (None, "FIXED"):
        raise DescriptionError(at, "the type SPHERICAL, FIXED or UJOINT_ with two of X, Y, Z", repr(change))
    moves = _KINDS[kind]
    if moves is None or change == "FIXED":
        return placement, ()
    if moves == "free":
        return placement, (Joint(name, "free"),)
    axis = node.find("axis")
    direction = unit_axis(None if axis is None else axis.get("xyz"), f"{at}, axis", (1.0, 0.0, 0.0))
    limit, dynamics, values = node.find("limit"), node.find("dynamics"), {}
    if limit is not None:
        wide = kind == "continuous"
        for key in ("effort", "velocity") if wide else ("lower", "upper", "effort", "velocity"):
            default = 0.0 if key in ("lower", "upper") else float("inf")
            values[key] = number(limit.get(key), f"{at}, limit {key}", default)
    if dynamics is not None:
        for key in ("damping", "friction"):
            values[key] = number(dynamics.get(key), f"{at}, dynamics {key}", 0.0)
    return placement, (Joint(name, moves, direction, **values),)


def _origin(node: Element | None, where: str) -> Any:
    if node is None:
        return pin.SE3.Identity()
    zeros = (0.0, 0.0, 0.0)
    position, rpy = (numbers(node.get(key), 3, f"{where}, origin {key}", zeros) for key in ("xyz", "rpy"))
    return place(position, pin.rpy.rpyToMatrix(*rpy))


def _inertia(link: Element, where: str) -> Any:
    node, at = link.find("inertial"), f"{where}, link {link.get('name')!r}"
    if node is None:
        return pin.Inertia.Zero()
    mass, inertia = node.find("mass"), node.find("inertia")
    if mass is None or inertia is None:
        raise DescriptionError(at, "<mass> and <inertia> in <inertial>", "only one of them")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    moments = [number(inertia.get(key), f"{at}, {key}", 0.0) for key in keys]
    return inertia_of(number(mass.get("value"), f"{at}, mass"), moments, _origin(node.find("origin"), at), at)


def _fixed(root: Element) -> set[str | None]:
    return {joint.get("name") for joint in root.findall("joint") if joint.get("type") == "fixed"}


def _transmissions(root: Element, where: str) -> Iterator[str]:
    """Yield the joints that transmissions drive; published files have some of joints that are fixed."""
    for node in root.iter("transmission"):
        for joint in node.iter("joint"):
            name = name_of(joint, f"{where}, transmission")
            if name not in _fixed(root):
                yield name


def _mimics(root: Element, where: str) -> Iterator[JointEquality]:
    fixed = _fixed(root)
    for joint in root.findall("joint"):
        mimic, at = joint.find("mimic"), f"{where}, joint {joint.get('name')!r}, mimic"
        if mimic is not None and joint.get("name") not in fixed:
            factor, offset = (number(mimic.get(k), at, d) for k, d in (("multiplier", 1.0), ("offset", 0.0)))
            driver = name_of(mimic, at, "joint")
            coefficients = (offset,) if driver in fixed else (offset, factor)
            yield JointEquality(name_of(joint, at), None if driver in fixed else driver, coefficients)


def drake_closures(root: Element, where: str) -> list[Closure]:
    """Return what Drake's ball constraints close; their values are attributes in URDF files, texts in SDF files."""
    found, links = [], {node.get("name") for node in root.iter("link")}
    for count, node in enumerate(root.iter("drake_ball_constraint")):
        at, said = f"{where}, drake:ball_constraint {count}", []
        for key in ("body_A", "p_AP", "body_B", "p_BQ"):
            entry = node.find(f"drake_ball_constraint_{key}")
            value = "" if entry is None else entry.get("name") or entry.get("value") or entry.text or ""
            if not value.strip():
                raise DescriptionError(at, f"a tag drake:ball_constraint_{key}", "none")
            said.append(value.strip())
        ends = ["universe" if said[k] == "world" and said[k] not in links else said[k] for k in (0, 2)]
        first, second = (Anchor(ends[k], place(numbers(said[2 * k + 1], 3, at))) for k in (0, 1))
        found.append(Closure("point", first, second, f"ball_constraint{count}"))
    return hinges_of_points(found)


def _read_yaml(source: str | PathLike[str]) -> tuple[list[Closure], dict[str, Any]]:
    """Return the closures of a YAML file, and what else it says."""
    text, where = read_source(source, "closed_loop", "a YAML file of closures", "closures")
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        at = f"{where}:{mark.line + 1}" if mark else where
        raise DescriptionError(at, "well-formed YAML", str(getattr(error, "problem", error))) from None
    if not isinstance(content, dict):
        raise DescriptionError(where, "a mapping with closed_loop and type", type(content).__name__)
    if "closed_loop" not in content:
        keys = ", ".join(map(str, content)) or "none"
        raise DescriptionError(where, "the key closed_loop", keys, "Is it a file of something else?")
    pairs, kinds = content.get("closed_loop") or [], content.get("type") or []
    for key in ("closed_loop", "type", "name_mot", "joint_name", "joint_type"):
        if not isinstance(content.get(key) or [], list):
            raise DescriptionError(f"{where}, {key}", "a list", type(content[key]).__name__)
    for first, second in (("closed_loop", "type"), ("joint_name", "joint_type")):
        counts = [len(content.get(key) or []) for key in (first, second)]
        if counts[0] != counts[1]:
            raise DescriptionError(f"{where}, {second}", f"{counts[0]} entries, one for each {first}", str(counts[1]))
    closures = []
    for count, (pair, kind) in enumerate(zip(pairs, kinds, strict=True)):
        at = f"{where}, closed_loop {count}"
        if not isinstance(pair, list) or len(pair) != 2 or not all(isinstance(end, str) for end in pair):
            raise DescriptionError(at, "a pair of links", str(pair))
        if str(kind).lower() not in CLOSURE_TYPES:
            raise DescriptionError(f"{at}, type", f"one of {', '.join(CLOSURE_TYPES)}", repr(kind))
        one, other = map(Anchor, pair)
        closures.append(Closure(CLOSURE_TYPES[str(kind).lower()], one, other, f"{pair[0]}-{pair[1]}"))
    return closures, {**content, "file": where}
