"""Elements of a URDF: origins, inertias, limits; Drake's ball constraints, and the constraints of the ROS proposal."""

from __future__ import annotations

import numpy as np

from spm_pin.description.closures import Closure
from spm_pin.description.robot_parts import Inertial, Limit, Placement
from spm_pin.description.xml_nodes import Node, parse
from spm_pin.errors import DescriptionError

LARGEST = 1e12
"""Largest mass [kg], moment of inertia [kg m²] and distance of a centre of mass [m] accepted."""
KINDS_OF_CONSTRAINT = {"spherical": "point", "spherical_joint": "point", "link": "weld"}
"""Kinds of closure by the names in the ROS proposal's `<constraint>`."""


def placement(node: Node) -> Placement:
    """Read where an element is placed in its link, by the element `<origin>` inside."""
    origin = node.optional("origin")
    if origin is None:
        return Placement()
    origin.check(attributes=("xyz", "rpy"))
    return Placement(origin.triple("xyz", "0 0 0"), origin.triple("rpy", "0 0 0"))


def inertial(node: Node) -> Inertial:
    """Read mass and moments of inertia, which must be possible."""
    node.check(children=("origin", "mass", "inertia"))
    mass, inertia = node.one("mass"), node.one("inertia")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    mass.check(attributes=("value",))
    inertia.check(attributes=keys)
    xx, xy, xz, yy, yz, zz = (inertia.number(key) for key in keys)
    value = mass.number("value")
    if not 0.0 <= value <= LARGEST:
        raise mass.error(f"a mass from 0 to {LARGEST:g} kg", mass.get("value"))
    found = Inertial(value, (xx, xy, xz, yy, yz, zz), placement(node))
    if max(map(abs, found.placement.xyz)) > LARGEST:
        raise node.error(f"a centre of mass up to {LARGEST:g} m away", f"{max(found.placement.xyz, key=abs):g} m")
    if max(map(abs, found.moments)) > LARGEST:
        raise inertia.error(f"moments of inertia up to {LARGEST:g} kg m²", f"{max(found.moments, key=abs):g}")
    smallest, largest = np.linalg.eigvalsh(found.matrix)[[0, -1]]
    # A negligible violation comes from the digits of an exporter.
    if smallest < -1e-9 * largest or largest < 0.0:
        cause = "Products of inertia with the wrong sign, or not about the centre of mass?"
        raise inertia.error("moments of inertia of which none is negative", f"principal moment {smallest:g}", cause)
    return found


def check_inertials(text: str, source: str) -> None:
    """Check masses and moments of inertia of a URDF's text, and that no joint has the name of a link.

    For readers that take what else is in the file from another library. Pinocchio keeps both kinds of names in one
    list, and takes a mass of NaN for none. Errors call the text `source` and name the line.
    """
    root = parse(text, source)
    links = {link.attributes.get("name") for link in root.all("link")}
    for joint in root.all("joint"):
        if joint.attributes.get("name") in links:
            raise joint.error("a name that no link has", repr(joint.get("name")), "Pinocchio keeps both in one list")
    for link in root.all("link"):
        masses = link.optional("inertial")
        if masses is not None:
            inertial(masses)


def limit(node: Node, kind: str) -> Limit:
    """Read the limits of a joint that moves."""
    limits = node.optional("limit")
    if limits is None:
        if kind == "continuous":
            return Limit()
        raise node.error(f"a <limit> of the {kind} joint", "none")
    limits.check(attributes=("lower", "upper", "effort", "velocity"))
    effort, velocity = limits.number("effort"), limits.number("velocity")
    if kind == "continuous":
        limits.check(attributes=("effort", "velocity"))
        return Limit(effort=effort, velocity=velocity)
    lower, upper = limits.number("lower", "0"), limits.number("upper", "0")
    if not lower <= upper:
        raise limits.error("lower <= upper", f"[{lower:g}, {upper:g}]", "Exchanged?")
    return Limit(lower, upper, effort, velocity)


def _ball(node: Node) -> tuple[Node, Closure]:
    tags = [f"drake:ball_constraint_{part}" for part in ("body_A", "p_AP", "body_B", "p_BQ")]
    node.check(children=tags)
    a, at_a, b, at_b = (node.one(tag) for tag in tags)
    for point in (at_a, at_b):
        if any(point.floats("value", 3)):
            raise point.error("the origins of the two links, 0 0 0", repr(point.get("value")), "Make a link there")
    return node, _closure(node, "", "point", a.get("name"), b.get("name"))


def _constraint(node: Node) -> tuple[Node, Closure]:
    tags = ("parent", "child", "parent_origin", "child_origin", "parent_axis", "child_axis")
    node.check(children=tags, attributes=("name", "type"))
    if node.get("type") not in KINDS_OF_CONSTRAINT:
        raise node.error(f"a constraint of type {', '.join(KINDS_OF_CONSTRAINT)}", repr(node.get("type")))
    for tag in ("parent_origin", "child_origin"):
        origin = node.optional(tag)
        if origin is not None and any((*origin.triple("xyz", "0 0 0"), *origin.triple("rpy", "0 0 0"))):
            raise origin.error("the frames of the two links, 0 0 0", "another one", "Make a link there")
    kind = KINDS_OF_CONSTRAINT[node.get("type")]
    return node, _closure(node, node.get("name"), kind, node.one("parent").get("link"), node.one("child").get("link"))


def _closure(node: Node, name: str, kind: str, frame_a: str, frame_b: str) -> Closure:
    try:
        return Closure(name or f"{frame_a}_{frame_b}", kind, frame_a, frame_b)
    except DescriptionError as error:
        raise node.error(error.expected, error.received) from error


def merged_closures(beside: tuple[Closure, ...], root: Node) -> tuple[Closure, ...]:
    """Return the closures beside a file, and those inside its root element that are not among them."""
    inside = [*map(_constraint, root.all("constraint")), *map(_ball, root.all("drake:ball_constraint"))]
    closures = list(beside)
    pairs = {closure.pair: closure for closure in beside}
    seen: set[tuple[str, frozenset[str]]] = set()
    for node, closure in inside:
        pair = closure.pair
        if (node.tag, pair) in seen:
            raise node.error("each pair of frames once", f"{closure.frame_a} and {closure.frame_b} again")
        seen.add((node.tag, pair))
        if pair not in pairs:
            closures.append(closure)
            pairs[pair] = closure
        elif pairs[pair].kind != closure.kind:
            raise node.error(f"a {pairs[pair].kind}, as the closure {pairs[pair].name}", f"a {closure.kind}")
    return tuple(closures)
