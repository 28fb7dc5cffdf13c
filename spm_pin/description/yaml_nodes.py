"""YAML files read node by node, so that an error can name the line."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import yaml

from spm_pin.errors import DescriptionError

__all__ = ["compose", "items", "mapping", "name", "place", "what"]


def compose(path: Path) -> yaml.Node | None:
    """Return the root node of a YAML file, None if it is empty; raises `DescriptionError` if it is no such file."""
    try:
        return yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except OSError as error:
        raise DescriptionError(str(path), "a readable YAML file", str(error.strerror)) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), "a YAML file", str(error)) from error


def place(path: Path, node: yaml.Node) -> str:
    """Return a file and the line of a node, as ``closures.yaml:5``."""
    return f"{path}:{node.start_mark.line + 1}"


def what(node: yaml.Node) -> str:
    """Return what a node is, for an error: a scalar as it is written, else its kind."""
    kind = type(node).__name__.removesuffix("Node").lower()
    return repr(node.value) if isinstance(node, yaml.ScalarNode) else f"a {kind}"


def mapping(
    node: yaml.Node, keys: Collection[str], path: Path, *, optional: Collection[str] = ()
) -> dict[str, yaml.Node]:
    """Return the values of a mapping that must have just these keys, each once; some of them only may be there."""
    expected = f"a mapping with the keys {', '.join(sorted(keys))}"
    if optional:
        expected += f", and perhaps {', '.join(sorted(optional))}"
    if not isinstance(node, yaml.MappingNode):
        raise DescriptionError(place(path, node), expected, what(node))
    found: dict[str, yaml.Node] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode) or (key.value not in keys and key.value not in optional):
            raise DescriptionError(place(path, key), expected, f"the key {what(key)}", "Misspelt?")
        if key.value in found:
            raise DescriptionError(place(path, key), expected, f"the key {key.value!r} twice")
        found[key.value] = value
    missing = set(keys) - found.keys()
    if missing:
        raise DescriptionError(place(path, node), expected, f"no key {', '.join(sorted(missing))}")
    return found


def items(node: yaml.Node, key: str, path: Path) -> list[yaml.Node]:
    """Return the members of a list."""
    if not isinstance(node, yaml.SequenceNode):
        raise DescriptionError(place(path, node), f"a list under the key {key}", what(node))
    return list(node.value)


def name(node: yaml.Node, key: str, path: Path) -> str:
    """Return a scalar that is a string."""
    if not isinstance(node, yaml.ScalarNode) or node.tag != "tag:yaml.org,2002:str":
        raise DescriptionError(place(path, node), f"a name under the key {key}", what(node))
    return str(node.value)
