"""Dimensions and leg limits of a 3RPS-3SPR manipulator, and where its joints sit.

Frames (Fig. 1 and Eq. (1) of the paper): {B} at the centre O of the base triangle, Z up; {m} at the centre o
of the terminal platform, z up. Legs 1, 2, 3 stand at the azimuths -30, 90 and 210 degrees in both.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import FloatArray, real_array

__all__ = ["LEGS", "Geometry", "LegLimits", "config_directory"]

LEGS = ("r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3")
"""Order of everything that counts legs: the lower stage's three, then the upper stage's."""

_HALF_SQRT3 = math.sqrt(3.0) / 2.0
# Unit vectors towards leg 1, 2, 3, and the revolute axes R_1i of Eq. (4a), in {B}; in {m} they read the same.
_RADIAL = np.array([[_HALF_SQRT3, -0.5, 0.0], [0.0, 1.0, 0.0], [-_HALF_SQRT3, -0.5, 0.0]])
_AXES = np.array([[0.5, _HALF_SQRT3, 0.0], [1.0, 0.0, 0.0], [-0.5, _HALF_SQRT3, 0.0]])


def config_directory() -> Path:
    """Return the folder of the description's numbers, `urdf/config`, installed or in a checkout."""
    package = Path(str(resources.files("spm_pin")))
    installed = package / "urdf" / "config"
    return installed if installed.is_dir() else package.parent / "urdf" / "config"


def _six(value: float | Sequence[float], argument: str) -> tuple[float, ...]:
    expected = "one length or six in the order " + ", ".join(LEGS) + ", in metres"
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (6,)):
        raise GeometryError(argument, expected, f"shape {array.shape}")
    if np.isnan(array).any():
        raise GeometryError(argument, expected, "NaN", "Use 0 and infinity where there is no limit")
    return tuple(float(x) for x in np.broadcast_to(array, 6))


@dataclass(frozen=True, init=False)
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
                    "0 <= minimum < maximum for every leg, in metres",
                    f"[{low:g}, {high:g}] for {leg}",
                    "Minimum and maximum exchanged?" if low > high >= 0.0 else "",
                )

    @classmethod
    def stages(cls, lower: Sequence[float], upper: Sequence[float]) -> LegLimits:
        """Make limits from one (minimum, maximum) pair [m] for the lower legs and one for the upper."""
        for argument, pair in (("lower", lower), ("upper", upper)):
            if not isinstance(pair, Sequence) or len(pair) != 2:
                raise GeometryError(argument, "a pair (minimum, maximum) in metres", pair)
        return cls([lower[0]] * 3 + [upper[0]] * 3, [lower[1]] * 3 + [upper[1]] * 3)

    def contains(self, leg_lengths: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Tell which sets of lengths (..., 6) [m] respect all limits; NaN does not."""
        return np.asarray(self.margin(leg_lengths) >= 0.0)

    def margin(self, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return how far the worst leg of (..., 6) [m] is inside its limits [m]; negative outside, NaN for NaN."""
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "leg lengths in metres", allow_nan=True)
        inside = np.minimum(lengths - np.array(self.minimum), np.array(self.maximum) - lengths)
        # Leg by leg: NumPy takes several times as long to reduce a short last axis.
        return np.asarray(functools.reduce(np.minimum, np.moveaxis(inside, -1, 0)))


@dataclass(frozen=True)
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
        If a dimension is not a positive, finite number.
    """

    base_radius: float
    platform_radius: float
    middle_side: float
    limits: LegLimits | None = None

    def __post_init__(self) -> None:
        for name in ("base_radius", "platform_radius", "middle_side"):
            value = getattr(self, name)
            try:
                number = float(value)
            except (TypeError, ValueError):
                raise GeometryError(name, "a positive length in metres", repr(value)) from None
            if not (math.isfinite(number) and number > 0.0):
                raise GeometryError(name, "a positive, finite length in metres", repr(value))
            object.__setattr__(self, name, number)
        if self.limits is not None and not isinstance(self.limits, LegLimits):
            raise GeometryError("limits", "LegLimits(minimum, maximum) or None", repr(self.limits))

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
        in metres.

        Raises
        ------
        GeometryError
            If the file cannot be read, is no mapping, or has a key missing, unknown or given twice.
        """
        path = Path(path)
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise GeometryError("path", "a readable YAML file", path, str(error.strerror)) from error
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise GeometryError("path", "a YAML file", path, str(error)) from error
        if not isinstance(content, Mapping):
            raise GeometryError("path", "a YAML mapping of dimensions", f"{type(content).__name__} in {path}")
        return cls._from_mapping(dict(content), path)

    @classmethod
    def _from_mapping(cls, content: dict[str, Any], path: Path) -> Geometry:
        def radius(triangle: str) -> float:
            keys = [key for key in (f"{triangle}_side", f"{triangle}_radius") if key in content]
            if len(keys) != 1:
                expected = f"exactly one of {triangle}_side and {triangle}_radius"
                raise GeometryError(str(path), expected, ", ".join(keys) or "neither")
            value = content.pop(keys[0])
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise GeometryError(keys[0], f"a number of metres in {path}", repr(value))
            return value / math.sqrt(3.0) if keys[0].endswith("_side") else value

        base_radius, platform_radius = radius("base"), radius("platform")
        if "middle_side" not in content:
            raise GeometryError(str(path), "the key middle_side", ", ".join(content) or "nothing more")
        middle_side = content.pop("middle_side")
        limits = content.pop("leg_limits", None)
        if content:
            known = "base_side, base_radius, platform_side, platform_radius, middle_side, leg_limits"
            raise GeometryError(str(path), f"no keys but {known}", ", ".join(map(str, content)))
        if limits is not None:
            limits = _read_limits(limits, path)
        return cls(base_radius, platform_radius, middle_side, limits)

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


def _read_limits(content: object, path: Path) -> LegLimits:
    keys = set(content) if isinstance(content, Mapping) else set()
    if not isinstance(content, Mapping) or keys not in ({"lower", "upper"}, set(LEGS)):
        expected = f"the pairs lower and upper, or one for each of {', '.join(LEGS)}, in {path}"
        raise GeometryError("leg_limits", expected, repr(content))
    for key, pair in content.items():
        numbers = isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2
        if not numbers or any(isinstance(x, bool) or not isinstance(x, int | float) for x in pair):
            raise GeometryError(f"leg_limits.{key}", f"a pair of lengths in metres in {path}", repr(pair))
    if keys == {"lower", "upper"}:
        return LegLimits.stages(content["lower"], content["upper"])
    return LegLimits([content[leg][0] for leg in LEGS], [content[leg][1] for leg in LEGS])
