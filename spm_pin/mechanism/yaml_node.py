"""Reading YAML files node by node: errors name the line, keys given twice are found, aliases are not expanded.

Nothing is constructed, so no tag in a file has an effect.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import yaml

from spm_pin.errors import ArgumentError, DescriptionError

LARGEST_FILE = 1 << 20
"""Characters of a file that are read; a larger one is refused."""

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_INFINITY = re.compile(r"[-+]?\.(inf|Inf|INF)")


@dataclass(frozen=True)
class YamlNode:
    """A node of a file; its methods raise `kind` where it is not what it should be."""

    node: yaml.Node
    path: Path
    kind: type[ArgumentError]

    @classmethod
    def read(cls, path: Path, expected: str, kind: type[ArgumentError] = DescriptionError) -> YamlNode:
        """Return the root node of a YAML file, of which `expected` says what it holds."""
        try:
            with path.open(encoding="utf-8") as file:
                text = file.read(LARGEST_FILE + 1)
        except OSError as failed:
            raise kind(str(path), "a readable YAML file", str(failed.strerror)) from failed
        except ValueError as failed:
            raise kind(str(path), "a YAML file, text in UTF-8", str(failed)) from failed
        if len(text) > LARGEST_FILE:
            raise kind(str(path), f"a YAML file of at most {LARGEST_FILE} characters", "a longer one")
        try:
            root: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
        except Exception as failed:  # YAMLError; of malformed escapes, tags and nesting also other kinds
            raise kind(str(path), "a YAML file", str(failed) or type(failed).__name__) from failed
        if root is None:
            raise kind(str(path), expected, "an empty file")
        return cls(root, path, kind)

    @property
    def place(self) -> str:
        """The file and the line, as ``closures.yaml:5``."""
        return f"{self.path}:{self.node.start_mark.line + 1}"

    @property
    def keys(self) -> set[str]:
        """The keys of a mapping that are scalars; none of another node."""
        entries = self.node.value if isinstance(self.node, yaml.MappingNode) else []
        return {key.value for key, _ in entries if isinstance(key, yaml.ScalarNode)}

    def error(self, expected: str, received: object = None, cause: str = "") -> ArgumentError:
        """Return an error at this place; without `received` it says what the node is."""
        if received is None:
            kind = type(self.node).__name__.removesuffix("Node").lower()
            received = repr(self.node.value) if isinstance(self.node, yaml.ScalarNode) else f"a {kind}"
        return self.kind(self.place, expected, received, cause)

    def mapping(self, keys: Collection[str], optional: Collection[str] = ()) -> dict[str, YamlNode]:
        """Return the values of a mapping that must have all of `keys` and may have `optional` ones, each once."""
        expected = f"a mapping with the keys {', '.join(sorted(keys))}" if keys else "a mapping"
        if optional:
            expected += f", and perhaps {', '.join(sorted(optional))}"
        if not isinstance(self.node, yaml.MappingNode):
            raise self.error(expected)
        found: dict[str, YamlNode] = {}
        for entry, value in self.node.value:
            key = YamlNode(entry, self.path, self.kind)
            if not isinstance(entry, yaml.ScalarNode) or (entry.value not in keys and entry.value not in optional):
                raise key.error(expected, f"the key {key.error('').received}", "Misspelt?")
            if entry.value in found:
                raise key.error(expected, f"the key {entry.value!r} twice")
            found[entry.value] = YamlNode(value, self.path, self.kind)
        missing = set(keys) - found.keys()
        if missing:
            raise self.error(expected, f"no key {', '.join(sorted(missing))}")
        return found

    def items(self, key: str, count: int | None = None, expected: str = "") -> list[YamlNode]:
        """Return the members of a list; if a `count` of them is `expected`, so many."""
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.error(f"a list under the key {key}")
        if count is not None and len(self.node.value) != count:
            raise self.error(expected, f"{len(self.node.value)} of them")
        return [YamlNode(member, self.path, self.kind) for member in self.node.value]

    def name(self, key: str) -> str:
        """Return a scalar that is a string."""
        if not isinstance(self.node, yaml.ScalarNode) or self.node.tag != "tag:yaml.org,2002:str":
            raise self.error(f"a name under the key {key}")
        return str(self.node.value)

    def number(self, expected: str) -> float:
        """Return a scalar that is written as a decimal number, or `.inf`, without quotes."""
        if isinstance(self.node, yaml.ScalarNode) and self.node.style is None:
            if _NUMBER.fullmatch(self.node.value):
                return float(self.node.value)
            if _INFINITY.fullmatch(self.node.value):
                return float(self.node.value.replace(".", ""))
        raise self.error(expected)
