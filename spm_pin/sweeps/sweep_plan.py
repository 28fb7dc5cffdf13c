"""The plan of a sweep: a manipulator, a domain, metrics, and the chunks in which the results are stored."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Geometry, LegLimits, Legs
from spm_pin.mechanism.arguments import check_instance
from spm_pin.sweeps.domains import AXES, Domain
from spm_pin.sweeps.metrics import STATUS, Metric, prepare_metrics, resolve_metrics
from spm_pin.sweeps.points import Points

FORMAT = 4
"""Version of the layout of a store."""
_BLOCK = 8192
"""Points evaluated together: enough for little time outside kernels, few enough to need some megabytes."""
_RESERVED = {*AXES["pose"], *AXES["legs"], "sample", "status", "sweep"}


@dataclass(frozen=True)
class SweepPlan:
    """Everything that determines the bytes of a store."""

    geometry: Geometry
    """The machine."""
    domain: Domain
    """The points."""
    metrics: tuple[Metric, ...]
    """Metrics computed, in the order of their names."""
    chunk: tuple[int, ...]
    """Shape of a chunk along the dimensions of the domain."""
    version: str
    """Version of this package."""

    @classmethod
    def make(cls, geometry: Geometry, domain: Domain, metrics: Iterable[str | Metric], chunk: int) -> SweepPlan:
        """Make a plan of metrics, each given by its name or as it is, with chunks of at most `chunk` points."""
        check_instance(geometry, Geometry, "geometry")
        check_instance(domain, Domain, "domain", "Made by pose_grid, leg_grid, pose_sample or leg_sample?")
        # By name, so that their order makes no other sweep.
        ordered = tuple(sorted(resolve_metrics(metrics), key=lambda metric: metric.name))
        reserved = [metric.name for metric in ordered if metric.name in _RESERVED]
        if reserved:
            raise ArgumentError("metrics", "names other than those of the coordinates", ", ".join(reserved))
        return cls(geometry, domain, ordered, domain.chunk_shape(chunk), package_version())

    def prepare(self) -> None:
        """Evaluate the metrics at one point; raises `SpmError` where one cannot be computed for this machine."""
        first = self.domain.points((0,) * len(self.chunk), (1,) * len(self.chunk))
        prepare_metrics(self.metrics, Points(self.geometry, self.domain.space, first))

    @property
    def variables(self) -> tuple[Metric, ...]:
        """Variables stored for every point: coordinates of a sample, the status, and the metrics."""
        sampled = [
            Metric(axis.name, axis.unit, axis.description, lambda points, k=k: points.coordinates[:, k])
            for k, axis in enumerate(self.domain.axes)
            if axis.count == 0
        ]
        return (*sampled, STATUS, *self.metrics)

    @property
    def chunks(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(-(-length // size) for length, size in zip(self.domain.shape, self.chunk, strict=True))

    @property
    def count(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunks)

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        """Iterate over the indices of the chunks, without a list of them."""
        return (tuple(map(int, np.unravel_index(number, self.chunks))) for number in range(self.count))

    def chunk_size(self, index: tuple[int, ...]) -> int:
        """Return the number of points of the chunk at `index`."""
        return math.prod(part.stop - part.start for part in self.domain.region(index, self.chunk))

    def evaluate(self, index: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
        """Return the values of all variables on the chunk at `index`, each of the shape of its region."""
        coordinates = self.domain.points(index, self.chunk)
        # Metrics are given parts of this array.
        coordinates.flags.writeable = False
        variables, count = self.variables, len(coordinates)
        values = {metric.name: np.empty(count, dtype=metric.dtype) for metric in variables}
        for first in range(0, count, _BLOCK):
            block = slice(first, first + _BLOCK)
            points = Points(self.geometry, self.domain.space, coordinates[block])
            for metric in variables:
                values[metric.name][block] = metric.evaluate(points)
        shape = tuple(part.stop - part.start for part in self.domain.region(index, self.chunk))
        return {name: array.reshape(shape) for name, array in values.items()}

    def definition(self) -> dict[str, Any]:
        """Return the inputs that determine the results, as JSON."""
        geometry, limits = self.geometry, self.geometry.limits
        sizes = {name: getattr(geometry, name) for name in ("base_radius", "platform_radius", "middle_side")}
        ends = limits and [[x if math.isfinite(x) else None for x in end] for end in (limits.minimum, limits.maximum)]
        legs = {name: getattr(geometry.legs, name).tolist() for name in ("axes", "pivots", "balls", "offsets")}
        return {
            "format": FORMAT,
            "spm_pin": self.version,
            "geometry": {**sizes, "limits": ends, "legs": legs},
            "domain": self.domain.definition(),
            "metrics": [metric.definition() for metric in self.metrics],
            "chunk": list(self.chunk),
        }

    @classmethod
    def from_definition(cls, content: Mapping[str, Any]) -> SweepPlan:
        """Make a plan from its `definition`; metrics that are none of this package's can be named, but not computed."""
        sizes = dict(content["geometry"])
        limits, legs = sizes.pop("limits"), Legs(**sizes.pop("legs"))
        if limits is not None:
            limits = LegLimits(*([math.inf if x is None else x for x in end] for end in limits))
        domain = Domain.from_definition(content["domain"])
        metrics = tuple(map(Metric.from_definition, content["metrics"]))
        chunk = domain.chunk_shape(math.prod(content["chunk"]))
        return cls(Geometry(**sizes, limits=limits, legs=legs), domain, metrics, chunk, content["spm_pin"])

    @cached_property
    def text(self) -> str:
        """The definition as text; it is made once, and sent with the plan to workers."""
        return json.dumps(self.definition(), ensure_ascii=False, allow_nan=False)


def package_version() -> str:
    """Return the version of this package."""
    # By name: the root imports every floor, and no floor the root.
    return str(import_module("spm_pin").__version__)


def definition_differences(stored: Any, requested: Any, where: str = "", *, of: str = "sweep") -> list[str]:
    """Return the differences between two definitions, a line for each."""
    if stored == requested:
        return []
    pairs: list[tuple[str, Any, Any]] = []
    if isinstance(stored, dict) and isinstance(requested, dict):
        pairs = [(f"{where}.{key}".lstrip("."), stored.get(key), requested.get(key)) for key in {**stored, **requested}]
    elif isinstance(stored, list) and isinstance(requested, list):
        if len(stored) == len(requested):
            pairs = [(f"{where}[{k}]", *pair) for k, pair in enumerate(zip(stored, requested, strict=True))]
        elif where == "metrics":
            stored, requested = ([metric["name"] for metric in side] for side in (stored, requested))
    if pairs:
        return [line for name, old, new in pairs for line in definition_differences(old, new, name, of=of)]
    old, new = (json.dumps(value, ensure_ascii=False) for value in (stored, requested))
    return [f"{where} is {old} in the store and {new} in this {of}"]
