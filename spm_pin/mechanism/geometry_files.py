"""Geometries in YAML files: dimensions, limits of the readings, and the legs of a machine as built."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import FloatArray, dimension, file_path, writing
from spm_pin.mechanism.leg_limits import LEGS, ORDERED, LegLimits
from spm_pin.mechanism.yaml_node import YamlNode

_IMPLAUSIBLE = 20.0
"""A file with a larger dimension [m] is suspected to be in another unit."""
_LEG_KEYS = ("axis", "pivot", "ball", "offset")
_HEADING = "# A 3RPS-3SPR manipulator, lengths in metres: see Geometry of spm_pin.\n"


class GeometryData(NamedTuple):
    """What a file says."""

    dimensions: tuple[float, float, float]
    """E, C and d [m]."""
    limits: LegLimits | None
    legs: tuple[FloatArray, ...] | None
    """Axes, pivots, balls (6, 3) and offsets (6,)."""
    legs_place: str
    """File and line of the legs."""


def read(path: str | Path) -> GeometryData:
    """Read a file; keys and errors as for `Geometry.from_yaml`."""
    root = YamlNode.read(file_path(path, error=GeometryError), "a YAML mapping of dimensions", GeometryError)
    sizes = {f"{triangle}_{size}" for triangle in ("base", "platform") for size in ("side", "radius")}
    nodes = root.mapping({"middle_side"}, sizes | {"leg_limits", "legs"})
    limits, legs = nodes.pop("leg_limits", None), nodes.pop("legs", None)
    lengths = {
        key: dimension(node.number(f"a number of metres under the key {key}"), f"{key} in {node.place}")
        for key, node in nodes.items()
    }

    def radius(triangle: str) -> float:
        keys = [key for key in (f"{triangle}_side", f"{triangle}_radius") if key in lengths]
        if len(keys) != 1:
            expected = f"exactly one of the keys {triangle}_side and {triangle}_radius"
            raise GeometryError(str(root.path), expected, " and ".join(keys) or "neither")
        return lengths[keys[0]] / (math.sqrt(3.0) if keys[0].endswith("_side") else 1.0)

    data = GeometryData(
        (radius("base"), radius("platform"), lengths["middle_side"]),
        None if limits is None else _read_limits(limits),
        None if legs is None else _read_legs(legs),
        "" if legs is None else legs.place,
    )
    longest = max(lengths, key=lambda key: lengths[key])
    if lengths[longest] > _IMPLAUSIBLE:
        text = (
            f"{root.path}: {longest} is {lengths[longest]:g} m. Lengths are read as metres; are these in another unit?"
        )
        warnings.warn(text, stacklevel=3)
    return data


def as_data(
    dimensions: tuple[float, float, float], limits: LegLimits | None, legs: tuple[FloatArray, ...] | None
) -> dict[str, Any]:
    """Return E, C and d [m], limits, and legs of a machine as built, as the data of a file that `read` reads."""
    data: dict[str, Any] = dict(zip(("base_radius", "platform_radius", "middle_side"), dimensions, strict=True))
    if limits is not None:
        pairs = [list(pair) for pair in zip(limits.minimum, limits.maximum, strict=True)]
        data["leg_limits"] = pairs[0] if pairs.count(pairs[0]) == 6 else dict(zip(LEGS, pairs, strict=True))
    if legs is not None:
        rows = (zip(_LEG_KEYS, leg, strict=True) for leg in zip(*legs, strict=True))
        data["legs"] = {leg: {key: entry.tolist() for key, entry in row} for leg, row in zip(LEGS, rows, strict=True)}
    return data


def write(path: str | Path, data: dict[str, Any]) -> None:
    """Write the data of a geometry, every number with all its digits."""
    path = file_path(path, error=GeometryError)
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)
    with writing(path, error=GeometryError):
        path.write_text(_HEADING + text, encoding="utf-8")


def _read_limits(node: YamlNode) -> LegLimits:
    def bounds(pair: YamlNode, name: str) -> tuple[float, float]:
        expected = f"a pair of lengths in metres under the key {name}"
        low, high = (end.number(expected) for end in pair.items(name, 2, expected))
        try:
            LegLimits(low, high)
        except GeometryError as wrong:
            raise GeometryError(f"{name} in {pair.place}", ORDERED, f"[{low:g}, {high:g}]", wrong.cause) from None
        return low, high

    if not isinstance(node.node, yaml.MappingNode):
        return LegLimits(*bounds(node, "leg_limits"))
    pairs = node.mapping(LEGS)
    ends = [bounds(pairs[leg], leg) for leg in LEGS]
    return LegLimits([low for low, _ in ends], [high for _, high in ends])


def _read_legs(node: YamlNode) -> tuple[FloatArray, ...]:
    legs = node.mapping(LEGS)
    rows = [legs[leg].mapping(_LEG_KEYS) for leg in LEGS]
    vectors = [np.array([_vector(row[key], key) for row in rows]) for key in _LEG_KEYS[:3]]
    return *vectors, np.array([_finite(row["offset"], "a number of metres under the key offset") for row in rows])


def _finite(node: YamlNode, expected: str) -> float:
    number = node.number(expected)
    if not np.isfinite(number):
        raise node.error(expected, f"{number:g}")
    return number


def _vector(node: YamlNode, key: str) -> list[float]:
    expected = f"three numbers under the key {key}"
    return [_finite(entry, expected) for entry in node.items(key, 3, expected)]
