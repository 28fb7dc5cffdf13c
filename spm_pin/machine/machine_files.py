"""Parts of the files of manipulators and stages: mappings, limits, and legs with their kinds."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from types import MappingProxyType
from typing import Any

import numpy as np

from spm_pin.errors import GeometryError, raised_as
from spm_pin.machine.leg_kinds import KINDS, LegKind
from spm_pin.machine.legs import LEGS, STAGE_LEGS, LegLimits, Legs
from spm_pin.support.arguments import real_number, type_and_value

_LEG_KEYS = {
    "axis": "a unit vector along the revolute axis",
    "pivot": "in metres",
    "ball": "in metres",
    "offset": "a number in the unit of the readings",
}


def read_mapping(
    data: Any,
    argument: str,
    keys: Collection[str],
    optional: Collection[str] = (),
    symbols: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return a mapping of a file, which must have all of `keys` and may have the `optional` ones.

    `symbols` are names that may have been written in place of keys, with their meaning.
    """
    expected = f"a mapping with the keys {', '.join(sorted(keys))}"
    if optional:
        expected += f", and optionally {', '.join(sorted(optional))}"
    if not isinstance(data, dict):
        received, cause = "an empty file" if data is None else type_and_value(data), ""
        if isinstance(data, str):
            cause = "A URDF or another XML file?" if data.lstrip().startswith("<") else "A table, such as a CSV file?"
        raise GeometryError(argument, expected, received, cause)
    for key in data:
        if key not in keys and key not in optional:
            meant = symbols.get(key)
            raise GeometryError(argument, expected, f"the key {key!r}", f"{key} is {meant}" if meant else "")
    if missing := set(keys) - data.keys():
        raise GeometryError(argument, expected, f"no key {', '.join(sorted(missing))}")
    return data


def _read_numbers(data: Any, argument: str, count: int, meaning: str) -> list[float]:
    """Return a list of numbers of a file."""
    if not isinstance(data, list) or len(data) != count or not all(isinstance(x, float) for x in data):
        received = f"{len(data)} members" if isinstance(data, list) else type_and_value(data)
        raise GeometryError(argument, f"a list of {count} numbers, {meaning}", received)
    return data


def read_limits(data: Any, argument: str, legs: tuple[str, ...]) -> LegLimits:
    """Return limits of a file: a pair for all legs, or one for each."""
    pairs = read_mapping(data, argument, legs) if isinstance(data, dict) else dict.fromkeys(legs, data)
    bounds = []
    for leg in legs:
        where = f"{leg} of {argument}" if isinstance(data, dict) else argument
        bounds.append(_read_numbers(pairs[leg], where, 2, "a minimum and a maximum in the unit of the readings"))
        try:
            LegLimits(*bounds[-1])
        except GeometryError as wrong:
            raise GeometryError(where, wrong.expected, str(bounds[-1]), wrong.cause) from None
    return LegLimits(*zip(*bounds, strict=True))


def limits_as_data(limits: LegLimits) -> Any:
    """Return the data of limits for a file."""
    pairs = [list(pair) for pair in zip(limits.minimum, limits.maximum, strict=True)]
    return pairs[0] if pairs.count(pairs[0]) == len(pairs) else dict(zip(limits.legs, pairs, strict=True))


def read_kind(data: Any, argument: str) -> LegKind:
    """Return the kind of a stage's legs, with their fixed numbers."""
    names = ", ".join(KINDS)
    if not isinstance(data, dict) or data.get("kind") not in list(KINDS):
        received = repr(data.get("kind")) if isinstance(data, dict) else type_and_value(data)
        raise GeometryError(argument, f"a mapping with the key kind, one of {names}, and the kind's numbers", received)
    kind = KINDS[data["kind"]]
    keys = {field.name for field in fields(kind)}
    numbers = read_mapping(data, argument, {"kind"} | {x.name for x in fields(kind) if x.default is MISSING}, keys)
    with raised_as(GeometryError, argument):
        return kind(**{key: value for key, value in numbers.items() if key != "kind"})


def read_legs(data: Any, argument: str, kinds: tuple[LegKind, ...]) -> Legs:
    """Return legs of these kinds, read from the data of a file."""
    names = LEGS if len(kinds) == 2 else STAGE_LEGS
    legs = read_mapping(data, argument, names)
    arrays = []
    for key, meaning in _LEG_KEYS.items():
        rows = []
        for leg in names:
            where = f"{key} of {leg} of {argument}"
            row = read_mapping(legs[leg], f"{leg} of {argument}", _LEG_KEYS)[key]
            rows.append(real_number(row, where, meaning) if key == "offset" else _read_numbers(row, where, 3, meaning))
        arrays.append(np.array(rows))
    with raised_as(GeometryError, argument):
        axes, pivots, balls, offsets = arrays
        return Legs(axes, pivots, balls, offsets, kinds)


def legs_as_data(legs: Legs) -> dict[str, Any]:
    """Return the data of calibrated legs for a file."""
    rows = zip(*(array.tolist() for array in legs.arrays), strict=True)
    return {leg: dict(zip(_LEG_KEYS, row, strict=True)) for leg, row in zip(legs.names, rows, strict=True)}
