"""Dimensions and leg limits of a 3RPS-3SPR manipulator, and the positions of its revolute joints.

Frames (Fig. 1 and Eq. (1) of the paper): {B} at the centre O of the base triangle, Z up; {m} at the centre o
of the terminal platform, z up. Legs 1, 2, 3 stand at the azimuths -30, 90 and 210 degrees in both.
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import (
    BoolArray,
    FloatArray,
    as_array,
    file_path,
    number_pair,
    real_array,
    real_number,
    type_and_value,
)
from spm_pin.mechanism.yaml_node import YamlNode

__all__ = ["LEGS", "Geometry", "LegLimits", "config_directory", "geometry_data", "geometry_of_node"]

LEGS = ("r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3")
"""Names and order of the legs: the lower stage's three, then the upper stage's."""

SMALLEST, LARGEST = 1e-9, 1e9
"""Dimensions accepted [m]. Every result was found to scale to rounding from 1e-52 to 1e60 m."""
_IMPLAUSIBLE = 20.0
"""A file with a larger dimension [m] is suspected to be in another unit."""
_ORDERED = "0 <= minimum < maximum for every leg, in metres"

_HALF_SQRT3 = math.sqrt(3.0) / 2.0
# Unit vectors towards leg 1, 2, 3, and the revolute axes R_1i of Eq. (4a), in {B}; in {m} they read the same.
_RADIAL = np.array([[_HALF_SQRT3, -0.5, 0.0], [0.0, 1.0, 0.0], [-_HALF_SQRT3, -0.5, 0.0]])
_AXES = np.array([[0.5, _HALF_SQRT3, 0.0], [1.0, 0.0, 0.0], [-0.5, _HALF_SQRT3, 0.0]])


def config_directory() -> Path:
    """Return the folder of the YAML files of the description, in an installed package or in a checkout."""
    package = Path(str(resources.files("spm_pin")))
    installed = package / "share" / "spm_description" / "config"
    return installed if installed.is_dir() else package.parent / "urdf" / "config"


def _six(value: float | Sequence[float], argument: str) -> tuple[float, ...]:
    expected = "one length or six in the order " + ", ".join(LEGS) + ", in metres"
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise GeometryError(argument, expected, type_and_value(value))
    if array.shape not in ((), (6,)):
        raise GeometryError(argument, expected, f"shape {array.shape}")
    if np.isnan(array).any():
        raise GeometryError(argument, expected, "NaN", "Use 0 and infinity where there is no limit")
    return tuple(float(x) for x in np.broadcast_to(array, 6))


@dataclass(frozen=True, init=False, repr=False)
class LegLimits:
    """Shortest and longest length of each leg.

    Parameters
    ----------
    minimum, maximum : float or sequence of six floats
        Lengths in metres, in the order of `LEGS`. `maximum` may be infinite.

    Raises
    ------
    GeometryError
        If a minimum is negative or not below its maximum.
    """

    minimum: tuple[float, ...]
    maximum: tuple[float, ...]

    def __init__(self, minimum: float | Sequence[float], maximum: float | Sequence[float]) -> None:
        object.__setattr__(self, "minimum", _six(minimum, "minimum"))
        object.__setattr__(self, "maximum", _six(maximum, "maximum"))
        for leg, low, high in zip(LEGS, self.minimum, self.maximum, strict=True):
            if not 0.0 <= low < high:
                raise GeometryError(
                    "limits",
                    _ORDERED,
                    f"[{low:g}, {high:g}] for {leg}",
                    "Minimum and maximum exchanged?" if low > high >= 0.0 else "",
                )

    @classmethod
    def stages(cls, lower: Sequence[float], upper: Sequence[float]) -> LegLimits:
        """Make limits from one (minimum, maximum) pair [m] for the lower legs and one for the upper."""
        pairs = [number_pair(lower, "lower", "metres", error=GeometryError)] * 3
        pairs += [number_pair(upper, "upper", "metres", error=GeometryError)] * 3
        return cls(*zip(*pairs, strict=True))

    def __repr__(self) -> str:
        pairs = [f"{low:.6g}, {high:.6g}" for low, high in zip(self.minimum, self.maximum, strict=True)]
        if len(set(pairs)) == 1:
            return f"LegLimits({pairs[0]})"
        if len(set(pairs[:3])) == len(set(pairs[3:])) == 1:
            return f"LegLimits.stages(({pairs[0]}), ({pairs[3]}))"
        bounds = (f"[{', '.join(f'{end:.6g}' for end in ends)}]" for ends in (self.minimum, self.maximum))
        return f"LegLimits({', '.join(bounds)})"

    def contains(self, leg_lengths: npt.ArrayLike) -> BoolArray:
        """Return which sets of lengths (..., 6) [m] respect all limits; NaN does not."""
        return np.asarray(self.margin(leg_lengths) >= 0.0)

    def excess(self, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return by how much each leg of (..., 6) [m] is too long, or too short (negative); 0 within its limits."""
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "leg lengths in metres", allow_nan=True)
        return np.asarray(np.maximum(lengths - self.maximum, 0.0) + np.minimum(lengths - self.minimum, 0.0))

    def margin(self, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return the margin [m] of the worst leg of (..., 6) [m] to its limits; negative outside, NaN for NaN."""
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "leg lengths in metres", allow_nan=True)
        inside = np.minimum(lengths - np.array(self.minimum), np.array(self.maximum) - lengths)
        # Leg by leg: NumPy takes several times as long to reduce a short last axis.
        return np.asarray(functools.reduce(np.minimum, np.moveaxis(inside, -1, 0)))


@dataclass(frozen=True, repr=False)
class Geometry:
    """Dimensions of a manipulator.

    Parameters
    ----------
    base_radius : float
        E, from the base's centre O to a lower revolute joint a_i [m].
    platform_radius : float
        C, from the terminal platform's centre o to an upper revolute joint c_i [m].
    middle_side : float
        d, side of the middle platform's triangle b_1 b_2 b_3 [m].
    limits : LegLimits, optional
        Limits of the leg lengths. None means unlimited.

    Raises
    ------
    GeometryError
        If a dimension is not a number from 1e-9 to 1e9 m, or `limits` are none. Within that range no product of
        lengths in this package over- or underflows.
    """

    base_radius: float
    platform_radius: float
    middle_side: float
    limits: LegLimits | None = None

    def __post_init__(self) -> None:
        for name in ("base_radius", "platform_radius", "middle_side"):
            object.__setattr__(self, name, _dimension(getattr(self, name), name))
        if self.limits is not None and not isinstance(self.limits, LegLimits):
            expected = "LegLimits(minimum, maximum) or None"
            raise GeometryError("limits", expected, type(self.limits).__name__)

    def __repr__(self) -> str:
        limits = "" if self.limits is None else f", limits={self.limits!r}"
        return (
            f"Geometry(base_radius={self.base_radius:.6g}, platform_radius={self.platform_radius:.6g}, "
            f"middle_side={self.middle_side:.6g}{limits})"
        )

    @classmethod
    def paper(cls) -> Geometry:
        """Return the paper's manipulator: E = 1.2/√3 m, C = 0.6/√3 m, d = 0.8 m, legs from 1.10 to 1.50 m.

        The paper prints no leg limits; these are the project's own, see `urdf/config/geometry.yaml`.
        """
        return cls.from_yaml(config_directory() / "geometry.yaml")

    @classmethod
    def from_yaml(cls, path: str | Path) -> Geometry:
        """Read a geometry from a YAML file.

        The keys are `base_side` or `base_radius`, `platform_side` or `platform_radius`, `middle_side`, and
        optionally `leg_limits` with the pairs `lower` and `upper`, or a pair for each leg `r_b1` to `r_c3`; all
        in metres. A warning is given for dimensions above 20 m, which are often centimetres or millimetres.

        Raises
        ------
        GeometryError
            If the file cannot be read, is no mapping, has a key missing, unknown or given twice, or numbers that
            describe no manipulator. The error names the line and the key.
        """
        path = file_path(path, error=GeometryError)
        return geometry_of_node(YamlNode.read(path, "a YAML mapping of dimensions", GeometryError))

    @property
    def nominal(self) -> Geometry:
        """The geometry itself; of an `AsBuiltGeometry`, `.nominal` is the one that it deviates from."""
        return self

    @property
    def dimensions(self) -> tuple[float, float, float]:
        """E, C and d [m]: what makes two machines the same, their limits aside."""
        return self.base_radius, self.platform_radius, self.middle_side

    @property
    def middle_radius(self) -> float:
        """Radius r = d/√3 of the middle platform, from its centre to a ball joint b_i [m]."""
        return self.middle_side / math.sqrt(3.0)

    @property
    def base_joints(self) -> FloatArray:
        """Lower revolute joints a_1..a_3 as rows (3, 3) [m] in {B}. Eq. (1a)."""
        return self.base_radius * _RADIAL

    @property
    def platform_joints(self) -> FloatArray:
        """Upper revolute joints c_1..c_3 as rows (3, 3) [m] in {m}. Eq. (1b)."""
        return self.platform_radius * _RADIAL

    @property
    def radial_directions(self) -> FloatArray:
        """Unit vectors from O towards a_i in {B}, equally from o towards c_i in {m}, as rows (3, 3)."""
        return _RADIAL.copy()

    @property
    def revolute_axes(self) -> FloatArray:
        """Unit revolute axes of legs 1..3 as rows (3, 3): in {B} at the a_i, in {m} at the c_i. Eq. (4)."""
        return _AXES.copy()


def geometry_of_node(root: YamlNode) -> Geometry:
    """Read the dimensions under a node of a YAML file; keys and errors as for `Geometry.from_yaml`."""
    sizes = {f"{triangle}_{size}" for triangle in ("base", "platform") for size in ("side", "radius")}
    nodes = root.mapping({"middle_side"}, sizes | {"leg_limits"})
    limits = nodes.pop("leg_limits", None)
    lengths = {
        key: _dimension(node.number(f"a number of metres under the key {key}"), f"{key} in {node.place}")
        for key, node in nodes.items()
    }

    def radius(triangle: str) -> float:
        keys = [key for key in (f"{triangle}_side", f"{triangle}_radius") if key in lengths]
        if len(keys) != 1:
            expected = f"exactly one of the keys {triangle}_side and {triangle}_radius"
            raise GeometryError(str(root.path), expected, " and ".join(keys) or "neither")
        return lengths[keys[0]] / (math.sqrt(3.0) if keys[0].endswith("_side") else 1.0)

    read = None if limits is None else _read_limits(limits)
    geometry = Geometry(radius("base"), radius("platform"), lengths["middle_side"], read)
    longest = max(lengths, key=lambda key: lengths[key])
    if lengths[longest] > _IMPLAUSIBLE:
        text = (
            f"{root.path}: {longest} is {lengths[longest]:g} m. Lengths are read as metres; are these in another unit?"
        )
        warnings.warn(text, stacklevel=3)
    return geometry


def geometry_data(geometry: Geometry) -> dict[str, Any]:
    """Return a geometry as the data of a YAML file: radii, and limits per leg, as `Geometry.from_yaml` takes them."""
    data: dict[str, Any] = {name: getattr(geometry, name) for name in ("base_radius", "platform_radius", "middle_side")}
    if geometry.limits is not None:
        pairs = zip(LEGS, geometry.limits.minimum, geometry.limits.maximum, strict=True)
        data["leg_limits"] = {leg: [low, high] for leg, low, high in pairs}
    return data


def _dimension(value: Any, argument: str) -> float:
    return real_number(
        value,
        argument,
        f"a positive length in metres, from {SMALLEST:g} to {LARGEST:g}",
        least=SMALLEST,
        most=LARGEST,
        error=GeometryError,
        cause="Given in another unit?" if isinstance(value, float | int) and value > 0 else "",
    )


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
            raise GeometryError(f"{leg} in {pairs[leg].place}", _ORDERED, f"[{low:g}, {high:g}]", wrong.cause) from None
        return low, high

    ends = {leg: bounds(leg) for leg in wanted}
    if not by_leg:
        return LegLimits.stages(ends["lower"], ends["upper"])
    return LegLimits([ends[leg][0] for leg in LEGS], [ends[leg][1] for leg in LEGS])
