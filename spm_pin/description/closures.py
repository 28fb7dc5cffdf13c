"""The closures: where the spanning tree is cut, and the files that say so."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import yaml

from spm_pin.description.locate import CLOSURES, description_file
from spm_pin.description.tree import SLIDES, check_prefix
from spm_pin.errors import DescriptionError

__all__ = ["KINDS", "Closure", "read_closures", "sidecar_text"]

KINDS = {"point": "3d"}
"""Kinds of closure, each with its name in an Extended-URDF file."""


@dataclass(frozen=True)
class Closure:
    """Two frames that a loop of the mechanism holds together.

    Parameters
    ----------
    name : str
        Name of the closure.
    kind : str
        What is held together; "point": the origins of the two frames, as by a ball joint.
    frame_a, frame_b : str
        Names of the two frames, links of the URDF.

    Raises
    ------
    DescriptionError
        If a name is empty, the kind is unknown, or both frames are the same.
    """

    name: str
    kind: str
    frame_a: str
    frame_b: str

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, str) or not value:
                raise DescriptionError(field.name, "a name", repr(value))
        if self.kind not in KINDS:
            raise DescriptionError("kind", f"one of {', '.join(KINDS)}", repr(self.kind))
        if self.frame_a == self.frame_b:
            raise DescriptionError("frame_b", "another frame than frame_a", repr(self.frame_b))

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
        If the file cannot be read or is malformed; the error names the line and the key. If `prefix` cannot
        begin a name.
    """
    check_prefix(prefix)
    path = description_file(CLOSURES) if path is None else Path(path)
    try:
        root = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except OSError as error:
        raise DescriptionError(str(path), "a readable YAML file", str(error.strerror)) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), "a YAML file", str(error)) from error
    if root is None:
        raise DescriptionError(str(path), "the key closures", "an empty file")
    listed = _mapping(root, {"closures"}, path)["closures"]
    if not isinstance(listed, yaml.SequenceNode):
        raise DescriptionError(_place(path, listed), "a list under the key closures", _what(listed))
    closures: dict[str, Closure] = {}
    for node in listed.value:
        closure = _closure(node, path)
        if closure.name in closures:
            raise DescriptionError(_place(path, node), "a name of its own under the key name", repr(closure.name))
        closures[closure.name] = closure
    return tuple(closure.prefixed(prefix) for closure in closures.values())


def sidecar_text(closures: Iterable[Closure], *, prefix: str = "") -> str:
    """Return the closures as an Extended-URDF file.

    Parameters
    ----------
    closures : iterable of Closure
        With the prefix applied.
    prefix : str
        The same prefix, for the actuated joints.

    Notes
    -----
    Layout of https://github.com/Gepetto/example-parallel-robots, whose loader reads it beside the URDF. No joint
    changes its type when loaded: `joint_name` and `joint_type` are empty.
    """
    closures = tuple(closures)
    pairs = ",\n  ".join(f"['{closure.frame_a}', '{closure.frame_b}']" for closure in closures)
    kinds = ", ".join(f"'{KINDS[closure.kind]}'" for closure in closures)
    motors = ", ".join(f"'{prefix}{name}'" for name in SLIDES)
    return f"closed_loop: [\n  {pairs}\n]\ntype: [{kinds}]\nname_mot: [{motors}]\njoint_name: []\njoint_type: []\n"


def _place(path: Path, node: yaml.Node) -> str:
    return f"{path}:{node.start_mark.line + 1}"


def _what(node: yaml.Node) -> str:
    """Return what a node is, for an error: a scalar as it is written, else its kind."""
    kind = type(node).__name__.removesuffix("Node").lower()
    return repr(node.value) if isinstance(node, yaml.ScalarNode) else f"a {kind}"


def _mapping(node: yaml.Node, keys: set[str], path: Path) -> dict[str, yaml.Node]:
    """Return the values of a mapping that must have just these keys, each once."""
    expected = f"a mapping with the keys {', '.join(sorted(keys))}"
    if not isinstance(node, yaml.MappingNode):
        raise DescriptionError(_place(path, node), expected, _what(node))
    found: dict[str, yaml.Node] = {}
    for key, value in node.value:
        if key.value not in keys:
            raise DescriptionError(_place(path, key), expected, f"the key {key.value!r}", "Misspelt?")
        if key.value in found:
            raise DescriptionError(_place(path, key), expected, f"the key {key.value!r} twice")
        found[key.value] = value
    missing = keys - found.keys()
    if missing:
        raise DescriptionError(_place(path, node), expected, f"no key {', '.join(sorted(missing))}")
    return found


def _closure(node: yaml.Node, path: Path) -> Closure:
    values = {}
    for key, value in _mapping(node, {field.name for field in fields(Closure)}, path).items():
        if not isinstance(value, yaml.ScalarNode) or value.tag != "tag:yaml.org,2002:str":
            raise DescriptionError(_place(path, value), f"a name under the key {key}", _what(value))
        values[key] = value.value
    try:
        return Closure(**values)
    except DescriptionError as error:
        expected = f"{error.expected} under the key {error.argument}"
        raise DescriptionError(_place(path, node), expected, error.received) from error
