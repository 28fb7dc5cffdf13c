"""Geometries in YAML files: dimensions, limits of the readings, and the legs of a machine as built.

Files are read node by node: errors name the line, keys given twice are found, aliases are not expanded. Nothing is
constructed, so no tag in a file has an effect.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import dimension, file_path, writing
from spm_pin.mechanism.leg_limits import LEGS, ORDERED, LegLimits
from spm_pin.mechanism.legs import Legs

_LARGEST_FILE = 1 << 20
"""Characters of a file that are read; a larger one is refused."""
_IMPLAUSIBLE = 20.0
"""A file with a larger dimension [m] is suspected to be in another unit."""
_LEG_KEYS = ("axis", "pivot", "ball", "offset")
_HEADING = "# A 3RPS-3SPR manipulator, lengths in metres: see Geometry of spm_pin.\n"
_SYMBOLS = {"E": "base_radius", "C": "platform_radius", "d": "middle_side"}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)", re.ASCII)


Dimensions = tuple[float, float, float]
"""E, C and d [m]."""


def read(path: str | Path) -> tuple[Dimensions, LegLimits | None, Legs | None]:
    """Read a file, as `Geometry.from_yaml` says."""
    root = _root(file_path(path, error=GeometryError))
    sizes = {f"{triangle}_{size}" for triangle in ("base", "platform") for size in ("side", "radius")}
    nodes = root.mapping({"middle_side"}, sizes | {"leg_limits", "legs"})
    limits, legs = nodes.pop("leg_limits", None), nodes.pop("legs", None)
    lengths = {
        key: dimension(node.number(f"a number of metres under the key {key}"), f"{key} in {node.place}")
        for key, node in nodes.items()
    }
    radii = []
    for triangle in ("base", "platform"):
        keys = [key for key in (f"{triangle}_side", f"{triangle}_radius") if key in lengths]
        if len(keys) != 1:
            expected = f"exactly one of the keys {triangle}_side and {triangle}_radius"
            raise GeometryError(str(root.path), expected, " and ".join(keys) or "neither")
        radii.append(lengths[keys[0]] / (math.sqrt(3.0) if keys[0].endswith("_side") else 1.0))
    data = (
        (radii[0], radii[1], lengths["middle_side"]),
        None if limits is None else _limits(limits),
        None if legs is None else _legs(legs),
    )
    longest = max(lengths, key=lambda key: lengths[key])
    if lengths[longest] > _IMPLAUSIBLE:
        text = f"{root.path}: {longest} is {lengths[longest]:g} m. Lengths are read as metres"
        warnings.warn(f"{text}; are these in another unit?", stacklevel=3)
    return data


def write(path: str | Path, data: dict[str, Any]) -> None:
    """Write the data of a geometry, every number with all its digits."""
    path = file_path(path, error=GeometryError)
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)
    with writing(path, error=GeometryError):
        path.write_text(_HEADING + text, encoding="utf-8")


def as_data(dimensions: Dimensions, limits: LegLimits | None, legs: Legs) -> dict[str, Any]:
    """Return the data of a file that `read` reads."""
    names = ("base_radius", "platform_radius", "middle_side")
    data: dict[str, Any] = dict(zip(names, dimensions, strict=True))
    if limits is not None:
        pairs = [list(pair) for pair in zip(limits.minimum, limits.maximum, strict=True)]
        data["leg_limits"] = pairs[0] if pairs.count(pairs[0]) == 6 else dict(zip(LEGS, pairs, strict=True))
    if not legs.is_drawn:
        rows = (zip(_LEG_KEYS, leg, strict=True) for leg in zip(*legs.arrays, strict=True))
        data["legs"] = {leg: {key: entry.tolist() for key, entry in row} for leg, row in zip(LEGS, rows, strict=True)}
    return data


@dataclass(frozen=True)
class _Node:
    """A node of a file; its methods raise `GeometryError` where it is not what it should be."""

    node: yaml.Node
    path: Path

    @property
    def place(self) -> str:
        """The file and the line, as ``machine.yaml:5``."""
        return f"{self.path}:{self.node.start_mark.line + 1}"

    def error(self, expected: str, received: object = None) -> GeometryError:
        """Return an error at this place; without `received` it says what the node is."""
        if received is None:
            kind = type(self.node).__name__.removesuffix("Node").lower()
            received = repr(self.node.value) if isinstance(self.node, yaml.ScalarNode) else f"a {kind}"
        return GeometryError(self.place, expected, received)

    def mapping(self, keys: Collection[str], optional: Collection[str] = ()) -> dict[str, _Node]:
        """Return the values of a mapping that must have all of `keys` and may have `optional` ones, each once."""
        expected = f"a mapping with the keys {', '.join(sorted(keys))}"
        if optional:
            expected += f", and perhaps {', '.join(sorted(optional))}"
        if not isinstance(self.node, yaml.MappingNode):
            raise self.error(expected)
        values: dict[str, _Node] = {}
        for entry, value in self.node.value:
            key = _Node(entry, self.path)
            if not isinstance(entry, yaml.ScalarNode) or (entry.value not in keys and entry.value not in optional):
                wrong = key.error(expected, f"the key {key.error('').received}")
                meant = _SYMBOLS.get(str(entry.value))
                if meant in keys or meant in optional:
                    raise GeometryError(wrong.argument, expected, wrong.received, f"{entry.value} is {meant}")
                raise wrong
            if entry.value in values:
                raise key.error(expected, f"the key {entry.value!r} twice")
            values[entry.value] = _Node(value, self.path)
        missing = set(keys) - values.keys()
        if missing:
            raise self.error(expected, f"no key {', '.join(sorted(missing))}")
        return values

    def numbers(self, count: int, expected: str) -> list[float]:
        """Return the members of a list of numbers."""
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.error(f"a list of {expected}")
        if len(self.node.value) != count:
            raise self.error(expected, f"{len(self.node.value)} of them")
        return [_Node(member, self.path).number(expected) for member in self.node.value]

    def number(self, expected: str) -> float:
        """Return a scalar that is written as a decimal number, or `.inf`, without quotes."""
        node = self.node
        if isinstance(node, yaml.ScalarNode) and node.style is None and _NUMBER.fullmatch(node.value):
            return float(node.value.replace(".inf", "inf").replace(".Inf", "inf").replace(".INF", "inf"))
        raise self.error(expected)


def _root(path: Path) -> _Node:
    """Return the root node of a file."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(_LARGEST_FILE + 1)
    except OSError as failed:
        raise GeometryError(str(path), "a readable YAML file", str(failed.strerror)) from failed
    except ValueError as failed:
        raise GeometryError(str(path), "a YAML file, text in UTF-8", str(failed)) from failed
    if len(text) > _LARGEST_FILE:
        raise GeometryError(str(path), f"a YAML file of at most {_LARGEST_FILE} characters", "a longer one")
    try:
        root: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
    except Exception as failed:  # YAMLError; of malformed escapes, tags and nesting also other kinds
        raise GeometryError(str(path), "a YAML file", str(failed) or type(failed).__name__) from failed
    if root is None:
        raise GeometryError(str(path), "a YAML mapping of dimensions", "an empty file")
    return _Node(root, path)


def _limits(node: _Node) -> LegLimits:
    def bounds(pair: _Node, name: str) -> tuple[float, float]:
        low, high = pair.numbers(2, f"a pair of lengths in metres under the key {name}")
        try:
            LegLimits(low, high)
        except GeometryError as wrong:
            raise GeometryError(f"{name} in {pair.place}", ORDERED, f"[{low:g}, {high:g}]", wrong.cause) from None
        return low, high

    if not isinstance(node.node, yaml.MappingNode):
        return LegLimits(*bounds(node, "leg_limits"))
    pairs = node.mapping(LEGS)
    return LegLimits(*zip(*(bounds(pairs[leg], leg) for leg in LEGS), strict=True))


def _legs(node: _Node) -> Legs:
    legs = node.mapping(LEGS)
    rows = [legs[leg].mapping(_LEG_KEYS) for leg in LEGS]
    vectors = [[row[key].numbers(3, f"three numbers under the key {key}") for row in rows] for key in _LEG_KEYS[:3]]
    offsets = [row["offset"].number("a number of metres under the key offset") for row in rows]
    try:
        return Legs(*(np.array(values) for values in (*vectors, offsets)))
    except GeometryError as wrong:
        place = f"{wrong.argument} in {node.place}"
        raise GeometryError(place, wrong.expected, wrong.received, wrong.cause) from None
