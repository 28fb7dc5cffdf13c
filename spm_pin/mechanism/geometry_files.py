"""The data of geometries in YAML files, and back: dimensions, leg limits, and the legs of a machine as built."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.dimension_checks import dimension
from spm_pin.mechanism.leg_limits import LEGS, ORDERED, LegLimits
from spm_pin.mechanism.yaml_node import YamlNode

__all__ = ["geometry_data", "leg_arrays", "legs_data", "read_dimensions"]

_IMPLAUSIBLE = 20.0
"""A file with a larger dimension [m] is suspected to be in another unit."""
_LEG_KEYS = ("axis", "pivot", "ball", "offset")


def read_dimensions(root: YamlNode) -> tuple[float, float, float, LegLimits | None]:
    """Read E, C, d [m] and the leg limits under a node of a YAML file; keys and errors as for `Geometry.from_yaml`."""
    sizes = {f"{triangle}_{size}" for triangle in ("base", "platform") for size in ("side", "radius")}
    nodes = root.mapping({"middle_side"}, sizes | {"leg_limits"})
    limits = nodes.pop("leg_limits", None)
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

    read = None if limits is None else _read_limits(limits)
    dimensions = radius("base"), radius("platform"), lengths["middle_side"], read
    longest = max(lengths, key=lambda key: lengths[key])
    if lengths[longest] > _IMPLAUSIBLE:
        text = (
            f"{root.path}: {longest} is {lengths[longest]:g} m. Lengths are read as metres; are these in another unit?"
        )
        warnings.warn(text, stacklevel=3)
    return dimensions


def geometry_data(geometry: Any) -> dict[str, Any]:
    """Return a geometry as the data of a YAML file: radii, and limits per leg, as `Geometry.from_yaml` takes them."""
    data: dict[str, Any] = {name: getattr(geometry, name) for name in ("base_radius", "platform_radius", "middle_side")}
    if geometry.limits is not None:
        pairs = zip(LEGS, geometry.limits.minimum, geometry.limits.maximum, strict=True)
        data["leg_limits"] = {leg: [low, high] for leg, low, high in pairs}
    return data


def _read_limits(node: YamlNode) -> LegLimits:
    by_leg = not node.keys.isdisjoint(LEGS)
    wanted = LEGS if by_leg else ("lower", "upper")
    pairs = node.mapping(wanted)

    def bounds(leg: str) -> tuple[float, float]:
        expected = f"a pair of lengths in metres under the key {leg}"
        low, high = (end.number(expected) for end in pairs[leg].items(leg, 2, expected))
        try:
            LegLimits(low, high)
        except GeometryError as wrong:
            raise GeometryError(f"{leg} in {pairs[leg].place}", ORDERED, f"[{low:g}, {high:g}]", wrong.cause) from None
        return low, high

    ends = {leg: bounds(leg) for leg in wanted}
    if not by_leg:
        return LegLimits.stages(ends["lower"], ends["upper"])
    return LegLimits([ends[leg][0] for leg in LEGS], [ends[leg][1] for leg in LEGS])


def leg_arrays(root: YamlNode) -> list[FloatArray]:
    """Read axes, pivots, balls (6, 3) and offsets (6,) of a machine as built, under a node with a key for each leg."""
    legs = root.mapping(LEGS)
    read = [legs[leg].mapping(_LEG_KEYS) for leg in LEGS]
    vectors = [np.array([_vector(leg[key], key) for leg in read]) for key in _LEG_KEYS[:3]]
    return [*vectors, np.array([_finite(leg["offset"], "a number of metres under the key offset") for leg in read])]


def legs_data(arrays: Sequence[FloatArray]) -> dict[str, Any]:
    """Return what `leg_arrays` reads as the data of a YAML file, every number with all its digits."""
    rows = (zip(_LEG_KEYS, leg, strict=True) for leg in zip(*arrays, strict=True))
    return {leg: {key: part.tolist() for key, part in row} for leg, row in zip(LEGS, rows, strict=True)}


def _finite(node: YamlNode, expected: str) -> float:
    number = node.number(expected)
    if not np.isfinite(number):
        raise node.error(expected, f"{number:g}")
    return number


def _vector(node: YamlNode, key: str) -> list[float]:
    expected = f"three numbers under the key {key}"
    return [_finite(entry, expected) for entry in node.items(key, 3, expected)]
