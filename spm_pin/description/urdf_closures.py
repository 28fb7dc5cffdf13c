"""Closures inside a URDF: Drake's ball constraints, and the constraints of the ROS proposal."""

from __future__ import annotations

from spm_pin.description.closures import Closure
from spm_pin.description.xml_nodes import Node
from spm_pin.errors import DescriptionError

__all__ = ["merged_closures"]

KINDS_OF_CONSTRAINT = {"spherical": "point", "spherical_joint": "point", "link": "weld"}
"""Kinds of closure by the names in the ROS proposal's `<constraint>`."""


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
