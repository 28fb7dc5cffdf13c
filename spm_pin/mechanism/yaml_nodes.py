"""Reading YAML files node by node: errors name the line, keys given twice are found, aliases are not expanded.

Nothing is constructed, so no tag in a file has an effect. All functions raise `error`, `DescriptionError` by default.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

import yaml

from spm_pin.errors import ArgumentError, DescriptionError

__all__ = ["compose", "items", "mapping", "name", "number", "place", "what"]

LARGEST_FILE = 1 << 20
"""Characters of a file that are read; a larger one is refused."""

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_INFINITY = re.compile(r"[-+]?\.(inf|Inf|INF)")
Error = type[ArgumentError]


def compose(path: Path, expected: str, *, error: Error = DescriptionError) -> yaml.Node:
    """Return the root node of a YAML file, of which `expected` says what it holds."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(LARGEST_FILE + 1)
    except OSError as failed:
        raise error(str(path), "a readable YAML file", str(failed.strerror)) from failed
    except ValueError as failed:
        raise error(str(path), "a YAML file, text in UTF-8", str(failed)) from failed
    if len(text) > LARGEST_FILE:
        raise error(str(path), f"a YAML file of at most {LARGEST_FILE} characters", "a longer one")
    try:
        root: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
    except Exception as failed:  # YAMLError; of malformed escapes, tags and nesting also other kinds
        raise error(str(path), "a YAML file", str(failed) or type(failed).__name__) from failed
    if root is None:
        raise error(str(path), expected, "an empty file")
    return root


def place(path: Path, node: yaml.Node) -> str:
    """Return a file and the line of a node, as ``closures.yaml:5``."""
    return f"{path}:{node.start_mark.line + 1}"


def what(node: yaml.Node) -> str:
    """Return what a node is, for an error: a scalar as it is written, else its kind."""
    kind = type(node).__name__.removesuffix("Node").lower()
    return repr(node.value) if isinstance(node, yaml.ScalarNode) else f"a {kind}"


def mapping(
    node: yaml.Node,
    keys: Collection[str],
    path: Path,
    *,
    optional: Collection[str] = (),
    error: Error = DescriptionError,
) -> dict[str, yaml.Node]:
    """Return the values of a mapping that must have all of `keys` and may have `optional` ones, each once."""
    expected = f"a mapping with the keys {', '.join(sorted(keys))}" if keys else "a mapping"
    if optional:
        expected += f", and perhaps {', '.join(sorted(optional))}"
    if not isinstance(node, yaml.MappingNode):
        raise error(place(path, node), expected, what(node))
    found: dict[str, yaml.Node] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode) or (key.value not in keys and key.value not in optional):
            raise error(place(path, key), expected, f"the key {what(key)}", "Misspelt?")
        if key.value in found:
            raise error(place(path, key), expected, f"the key {key.value!r} twice")
        found[key.value] = value
    missing = set(keys) - found.keys()
    if missing:
        raise error(place(path, node), expected, f"no key {', '.join(sorted(missing))}")
    return found


def items(node: yaml.Node, key: str, path: Path, *, error: Error = DescriptionError) -> list[yaml.Node]:
    """Return the members of a list."""
    if not isinstance(node, yaml.SequenceNode):
        raise error(place(path, node), f"a list under the key {key}", what(node))
    return list(node.value)


def name(node: yaml.Node, key: str, path: Path, *, error: Error = DescriptionError) -> str:
    """Return a scalar that is a string."""
    if not isinstance(node, yaml.ScalarNode) or node.tag != "tag:yaml.org,2002:str":
        raise error(place(path, node), f"a name under the key {key}", what(node))
    return str(node.value)


def number(node: yaml.Node, expected: str, path: Path, *, error: Error = DescriptionError) -> float:
    """Return a scalar that is written as a decimal number, or `.inf`, without quotes."""
    if isinstance(node, yaml.ScalarNode) and node.style is None:
        if _NUMBER.fullmatch(node.value):
            return float(node.value)
        if _INFINITY.fullmatch(node.value):
            return float(node.value.replace(".", ""))
    raise error(place(path, node), expected, what(node))
