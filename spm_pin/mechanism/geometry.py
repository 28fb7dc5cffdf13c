"""Dimensions of a 3RPS-3SPR manipulator, and the positions of its revolute joints.

Frames (Fig. 1 and Eq. (1) of the paper): {B} at the centre O of the base triangle, Z up; {m} at the centre o
of the terminal platform, z up. Legs 1, 2, 3 stand at the azimuths -30, 90 and 210 degrees in both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import FloatArray, file_path
from spm_pin.mechanism.dimension_checks import dimension
from spm_pin.mechanism.geometry_files import read_dimensions
from spm_pin.mechanism.leg_limits import LegLimits
from spm_pin.mechanism.yaml_node import YamlNode

__all__ = ["Geometry", "config_directory"]

_HALF_SQRT3 = math.sqrt(3.0) / 2.0
# Unit vectors towards leg 1, 2, 3, and the revolute axes R_1i of Eq. (4a), in {B}; in {m} they read the same.
_RADIAL = np.array([[_HALF_SQRT3, -0.5, 0.0], [0.0, 1.0, 0.0], [-_HALF_SQRT3, -0.5, 0.0]])
_AXES = np.array([[0.5, _HALF_SQRT3, 0.0], [1.0, 0.0, 0.0], [-0.5, _HALF_SQRT3, 0.0]])


def config_directory() -> Path:
    """Return the folder of the YAML files of the description, in an installed package or in a checkout."""
    package = Path(str(resources.files("spm_pin")))
    installed = package / "share" / "spm_description" / "config"
    return installed if installed.is_dir() else package.parent / "urdf" / "config"


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
        If a dimension is not a number from 1e-9 to 1e9 m, or `limits` is neither a LegLimits nor None. Within that
        range no product of lengths in this package over- or underflows.
    """

    base_radius: float
    platform_radius: float
    middle_side: float
    limits: LegLimits | None = None

    def __post_init__(self) -> None:
        for name in ("base_radius", "platform_radius", "middle_side"):
            object.__setattr__(self, name, dimension(getattr(self, name), name))
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
        return cls(*read_dimensions(YamlNode.read(path, "a YAML mapping of dimensions", GeometryError)))

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
