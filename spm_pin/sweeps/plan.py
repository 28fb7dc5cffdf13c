"""The plan of a sweep: a manipulator, a domain, metrics, and the chunks in which the results are stored."""

from __future__ import annotations

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
from spm_pin.mechanism import Geometry, LegLimits
from spm_pin.mechanism.arguments import instance
from spm_pin.sweeps.domains import AXES, Axis, Domain, chunk_region
from spm_pin.sweeps.metric import Metric
from spm_pin.sweeps.metrics import metric_from_definition, status
from spm_pin.sweeps.points import Points

__all__ = ["FORMAT", "Plan", "definition_differences", "package_version"]

FORMAT = 2
"""Version of the layout of a store."""

_BLOCK = 8192
"""Points evaluated together: enough for little time outside kernels, few enough to need some megabytes."""
_RESERVED = {*AXES["pose"], *AXES["legs"], "sample", "status", "sweep"}


@dataclass(frozen=True)
class Plan:
    """Everything that determines the bytes of a store.

    Attributes
    ----------
    geometry : Geometry
        The manipulator.
    domain : Domain
        The points.
    metrics : tuple of Metric
        What is computed, in the order of the names.
    chunk : tuple of int
        Shape of a chunk along the dimensions of the domain.
    version : str
        Version of this package.
    """

    geometry: Geometry
    domain: Domain
    metrics: tuple[Metric, ...]
    chunk: tuple[int, ...]
    version: str

    @classmethod
    def make(cls, geometry: Geometry, domain: Domain, metrics: tuple[Metric, ...], chunk: int) -> Plan:
        """Make a plan with chunks of at most `chunk` points.

        Raises
        ------
        ArgumentError
            If an argument is not what it should be, or the name of a metric is that of a coordinate.
        """
        instance(geometry, Geometry, "geometry")
        instance(domain, Domain, "domain", "Made by pose_grid, leg_grid, pose_sample or leg_sample?")
        taken = sorted(_RESERVED & {metric.name for metric in metrics})
        if taken:
            raise ArgumentError("metrics", "names other than those of the coordinates", ", ".join(taken))
        # By name, so that their order makes no other sweep.
        ordered = tuple(sorted(metrics, key=lambda metric: metric.name))
        return cls(geometry, domain, ordered, domain.chunk_shape(chunk), package_version())

    @property
    def variables(self) -> tuple[Metric, ...]:
        """The metrics, and before them the status."""
        return (status, *self.metrics)

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
        """Iterate over the indices of the chunks, without a list of them."""
        return (tuple(map(int, np.unravel_index(number, self.chunks))) for number in range(self.count))

    def region(self, index: tuple[int, ...]) -> tuple[slice, ...]:
        """Return the slices of the chunk at `index` in the results."""
        return chunk_region(self.domain.shape, index, self.chunk)

    def points_of(self, index: tuple[int, ...]) -> int:
        """Return the number of points of the chunk at `index`."""
        return math.prod(part.stop - part.start for part in self.region(index))

    def evaluate(self, index: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
        """Return the values of all variables on the chunk at `index`, each of the shape of its region."""
        coordinates = self.domain.points(index, self.chunk)
        # Metrics are given parts of this array.
        coordinates.flags.writeable = False
        count = len(coordinates)
        values = {variable.name: np.empty(count, dtype=variable.dtype) for variable in self.variables}
        for first in range(0, count, _BLOCK):
            part = slice(first, first + _BLOCK)
            points = Points(self.geometry, self.domain.space, coordinates[part])
            for variable in self.variables:
                values[variable.name][part] = variable.evaluate(points)
        values |= {axis.name: coordinates[:, k] for k, axis in enumerate(self.domain.axes) if axis in self.sampled}
        shape = tuple(part.stop - part.start for part in self.region(index))
        return {name: array.reshape(shape) for name, array in values.items()}

    def definition(self) -> dict[str, Any]:
        """Return what determines the results, as JSON."""
        limits = self.geometry.limits
        ends = None if limits is None else (limits.minimum, limits.maximum)
        return {
            "format": FORMAT,
            "spm_pin": self.version,
            "geometry": {
                "base_radius": self.geometry.base_radius,
                "platform_radius": self.geometry.platform_radius,
                "middle_side": self.geometry.middle_side,
                "limits": ends and [[x if math.isfinite(x) else None for x in end] for end in ends],
            },
            "domain": self.domain.definition(),
            "metrics": [metric.definition() for metric in self.metrics],
            "chunk": list(self.chunk),
        }

    @classmethod
    def from_definition(cls, content: Mapping[str, Any]) -> Plan:
        """Make a plan from its `definition`.

        Raises
        ------
        ArgumentError
            If a metric is none of this package's.
        """
        sizes = dict(content["geometry"])
        limits = sizes.pop("limits")
        if limits is not None:
            limits = LegLimits(*([math.inf if x is None else x for x in end] for end in limits))
        return cls(
            Geometry(**sizes, limits=limits),
            Domain.from_definition(content["domain"]),
            tuple(metric_from_definition(definition) for definition in content["metrics"]),
            tuple(content["chunk"]),
            content["spm_pin"],
        )

    @cached_property
    def text(self) -> str:
        """The definition as text; it is made once, and sent with the plan to workers."""
        return json.dumps(self.definition(), ensure_ascii=False, allow_nan=False)


def package_version() -> str:
    """Return the version of this package."""
    # By name: the root imports every floor, and no floor the root.
    return str(import_module("spm_pin").__version__)


def definition_differences(stored: Any, requested: Any, where: str = "") -> list[str]:
    """Return what differs between two definitions, a line for each."""
    if isinstance(stored, dict) and isinstance(requested, dict):
        keys = list(dict.fromkeys([*stored, *requested]))
        prefix = f"{where}." if where else ""
        return [
            line
            for key in keys
            for line in definition_differences(stored.get(key), requested.get(key), f"{prefix}{key}")
        ]
    if isinstance(stored, list) and isinstance(requested, list) and len(stored) == len(requested):
        pairs = enumerate(zip(stored, requested, strict=True))
        return [line for k, pair in pairs for line in definition_differences(*pair, f"{where}[{k}]")]
    if isinstance(stored, list) and isinstance(requested, list) and where == "metrics":
        stored, requested = ([metric["name"] for metric in metrics] for metrics in (stored, requested))
    if stored == requested:
        return []
    there, here = (json.dumps(value, ensure_ascii=False) for value in (stored, requested))
    return [f"{where} is {there} there and {here} here"]
