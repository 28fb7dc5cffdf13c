"""Closures: the pairs of frames at which the loops of the spanning tree are cut, and the YAML file of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

from spm_pin.description.paths import CLOSURES, description_file
from spm_pin.description.xml_nodes import check_prefix
from spm_pin.errors import DescriptionError
from spm_pin.mechanism.yaml_node import YamlNode

KINDS = {"point": "3d", "weld": "6d"}
"""Kinds of closure, each with its name in an Extended-URDF file."""


@dataclass(frozen=True)
class Closure:
    """Two frames that the mechanism holds together, at which a loop is cut.

    Raises
    ------
    DescriptionError
        If a name is empty, the kind is unknown, or both frames are the same.
    """

    name: str
    """Name of the closure."""
    kind: str
    """Kind of the closure: "point" keeps the origins of the two frames together, as a ball joint; "weld" the frames."""
    frame_a: str
    """Name of the first frame, a link of the URDF."""
    frame_b: str
    """Name of the second frame, a link of the URDF."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, str) or not value:
                raise DescriptionError(field.name, "a name", repr(value))
        if self.kind not in KINDS:
            raise DescriptionError("kind", f"one of {', '.join(KINDS)}", repr(self.kind))
        if self.frame_a == self.frame_b:
            raise DescriptionError("frame_b", "another frame than frame_a", repr(self.frame_b))

    @property
    def pair(self) -> frozenset[str]:
        """The two frames."""
        return frozenset((self.frame_a, self.frame_b))

    def prefixed(self, prefix: str) -> Closure:
        """Return the same closure of a robot whose names all begin with `prefix`."""
        return Closure(prefix + self.name, self.kind, prefix + self.frame_a, prefix + self.frame_b)


def read_closures(path: str | Path | None = None, *, prefix: str = "") -> tuple[Closure, ...]:
    """Read the closures of a robot.

    Parameters
    ----------
    path : str or Path, optional
        A YAML file with one key `closures`, a list of mappings with the keys `name`, `kind`, `frame_a` and
        `frame_b`. By default the description's own.
    prefix : str
        Put before every name, as `expand` does in the URDF.

    Raises
    ------
    DescriptionError
        If the file cannot be read or is malformed, or holds two frames together twice; the error names the line
        and the key. If `prefix` cannot begin a name.
    """
    check_prefix(prefix)
    path = description_file(CLOSURES) if path is None else Path(path)
    listed = YamlNode.read(path, "the key closures").mapping({"closures"})["closures"]
    closures: list[Closure] = []
    for node in listed.items("closures"):
        found = node.mapping({field.name for field in fields(Closure)})
        values = {key: value.name(key) for key, value in found.items()}
        if any(values["name"] == other.name for other in closures):
            raise node.error("a name of its own under the key name", repr(values["name"]))
        closures.append(closure_at(node.place, closures, **values))
    return tuple(closure.prefixed(prefix) for closure in closures)


def closure_at(place: str, others: Iterable[Closure], **values: str) -> Closure:
    """Make a closure read at a place of a file; raise `DescriptionError` if another one holds its frames together."""
    try:
        closure = Closure(**values)
    except DescriptionError as error:
        raise DescriptionError(place, f"{error.expected} under the key {error.argument}", error.received) from error
    for other in others:
        if other.pair == closure.pair:
            received = f"{closure.frame_a} and {closure.frame_b}, as in {other.name}"
            raise DescriptionError(place, "two frames that no other closure holds", received)
    return closure
