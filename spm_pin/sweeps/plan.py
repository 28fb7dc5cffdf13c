"""What a sweep computes: a manipulator, a domain, indices, and the chunks in which the results are stored."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Geometry, LegLimits, Status
from spm_pin.sweeps.domains import Axis, Domain, Grid, Sample, region
from spm_pin.sweeps.metric import Index
from spm_pin.sweeps.metrics import from_definition
from spm_pin.sweeps.points import Points

__all__ = ["FORMAT", "STATUS", "Plan", "differences", "domain_of", "package_version"]

FORMAT = 1
"""Version of the layout of a store."""

_TOGETHER = 4096
"""Points evaluated together: few enough for the intermediate results to stay near the processor's cache."""

STATUS = Index(
    "status",
    "1",
    "what became of the displacement problem of the point",
    lambda points: points.status,
    "int8",
    {str(status): int(status) for status in Status},
)
"""Is in every store: it alone tells "not computed" from "no value here"."""


@dataclass(frozen=True)
class Plan:
    """Everything that determines the bytes of a store.

    Attributes
    ----------
    geometry : Geometry
        The manipulator.
    domain : Domain
        Where.
    indices : tuple of Index
        What.
    chunk : tuple of int
        Shape of a chunk along the dimensions of the domain.
    version : str
        Version of this package.
    """

    geometry: Geometry
    domain: Domain
    indices: tuple[Index, ...]
    chunk: tuple[int, ...]
    version: str

    @classmethod
    def of(cls, geometry: Geometry, domain: Domain, indices: tuple[Index, ...], chunk: int) -> Plan:
        """Make a plan with chunks of at most `chunk` points.

        Raises
        ------
        ArgumentError
            If an argument is not what it should be, or the name of an index is that of a coordinate.
        """
        if not isinstance(geometry, Geometry):
            raise ArgumentError("geometry", "a Geometry", type(geometry).__name__)
        if not isinstance(domain, Grid | Sample):
            expected = "what pose_grid, leg_grid, pose_sample or leg_sample returns"
            raise ArgumentError("domain", expected, type(domain).__name__)
        taken = {axis.name for axis in domain.axes} | {"sample", "status", "sweep"}
        clash = sorted(taken & {index.name for index in indices})
        if clash:
            raise ArgumentError("indices", "names other than those of the coordinates", ", ".join(clash))
        # By name, so that the order in which they were asked for makes no other sweep.
        ordered = tuple(sorted(indices, key=lambda one: one.name))
        return cls(geometry, domain, ordered, domain.chunk_shape(chunk), package_version())

    @property
    def variables(self) -> tuple[Index, ...]:
        """The indices, and before them the status."""
        return (STATUS, *self.indices)

    @property
    def sampled(self) -> tuple[Axis, ...]:
        """Coordinates that are stored point by point."""
        return tuple(axis for axis in self.domain.axes if axis.count == 0)

    @property
    def chunks(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(-(-length // part) for length, part in zip(self.domain.shape, self.chunk, strict=True))

    @property
    def count(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunks)

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        """Iterate over the indices of the chunks; a generator, however many there are."""
        lengths = self.chunks
        for number in range(self.count):
            index = []
            for length in reversed(lengths):
                number, remainder = divmod(number, length)
                index.append(remainder)
            yield tuple(reversed(index))

    def region(self, index: tuple[int, ...]) -> tuple[slice, ...]:
        """Return where the chunk at `index` is in the results."""
        return region(self.domain.shape, index, self.chunk)

    def size(self, index: tuple[int, ...]) -> int:
        """Return the number of points of the chunk at `index`."""
        return math.prod(part.stop - part.start for part in self.region(index))

    def evaluate(self, index: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
        """Return the values of all variables on the chunk at `index`, each of the shape of its region."""
        coordinates = self.domain.points(index, self.chunk)
        count = len(coordinates)
        values = {one.name: np.empty(count, dtype=one.dtype) for one in self.variables}
        for first in range(0, count, _TOGETHER):
            part = slice(first, first + _TOGETHER)
            points = Points(self.geometry, self.domain.space, coordinates[part])
            for one in self.variables:
                values[one.name][part] = one(points)
        values |= {axis.name: coordinates[:, k] for k, axis in enumerate(self.domain.axes) if axis in self.sampled}
        shape = tuple(part.stop - part.start for part in self.region(index))
        return {name: array.reshape(shape) for name, array in values.items()}

    def definition(self) -> dict[str, Any]:
        """Return what determines the results, as JSON."""
        limits = self.geometry.limits
        return {
            "format": FORMAT,
            "spm_pin": self.version,
            "geometry": {
                "base_radius": self.geometry.base_radius,
                "platform_radius": self.geometry.platform_radius,
                "middle_side": self.geometry.middle_side,
                "limits": None if limits is None else [[_finite(x) for x in end] for end in _ends(limits)],
            },
            "domain": self.domain.definition(),
            "indices": [index.definition() for index in self.indices],
            "chunk": list(self.chunk),
        }

    @classmethod
    def from_definition(cls, content: Mapping[str, Any]) -> Plan:
        """Make a plan again from its `definition`.

        Raises
        ------
        ArgumentError
            If an index is none of this package's.
        """
        sizes = dict(content["geometry"])
        limits = sizes.pop("limits")
        if limits is not None:
            limits = LegLimits(*([math.inf if x is None else x for x in end] for end in limits))
        return cls(
            Geometry(**sizes, limits=limits),
            domain_of(content),
            tuple(from_definition(index) for index in content["indices"]),
            tuple(content["chunk"]),
            content["spm_pin"],
        )

    @cached_property
    def text(self) -> str:
        """The definition as text."""
        return json.dumps(self.definition(), ensure_ascii=False, allow_nan=False)

    @cached_property
    def digest(self) -> bytes:
        """SHA-256 of `text`."""
        return hashlib.sha256(self.text.encode()).digest()


def package_version() -> str:
    """Return the version of this package."""
    # By name: the root imports every floor, and no floor the root.
    return str(import_module("spm_pin").__version__)


def domain_of(definition: Mapping[str, Any]) -> Domain:
    """Return the domain of a plan's `definition`."""
    content = definition["domain"]
    return (Grid if content["kind"] == "grid" else Sample).from_definition(content)


def differences(stored: Any, asked: Any, where: str = "") -> list[str]:
    """Return what differs between two definitions, a line for each."""
    if isinstance(stored, dict) and isinstance(asked, dict):
        keys = list(dict.fromkeys([*stored, *asked]))
        prefix = f"{where}." if where else ""
        return [line for key in keys for line in differences(stored.get(key), asked.get(key), f"{prefix}{key}")]
    if isinstance(stored, list) and isinstance(asked, list) and len(stored) == len(asked):
        pairs = enumerate(zip(stored, asked, strict=True))
        return [line for k, pair in pairs for line in differences(*pair, f"{where}[{k}]")]
    if isinstance(stored, list) and isinstance(asked, list) and where == "indices":
        stored, asked = ([index["name"] for index in side] for side in (stored, asked))
    return [] if stored == asked else [f"{where} is {_shown(stored)} there and {_shown(asked)} here"]


def _shown(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _ends(limits: LegLimits) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return limits.minimum, limits.maximum


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
