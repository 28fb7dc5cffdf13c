"""Dimensions of an imperfect manipulator: axes, pivots, ball centres and encoder offsets of its six legs.

Frames as in `geometry`: lower axes and pivots in {B}, upper ones in {m}, ball centres in the middle platform's frame
{n}. {n} has its origin at the nominal triangle's centre, x along b_3 b_1 and z normal to it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import FloatArray, file_path, generator, instance, real_array, real_number, writing
from spm_pin.mechanism.ball_triangles import triangle_sides
from spm_pin.mechanism.dimension_checks import LARGEST, SMALLEST
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.geometry_files import geometry_data, leg_arrays, legs_data, read_dimensions
from spm_pin.mechanism.leg_limits import LEGS, LegLimits
from spm_pin.mechanism.yaml_node import YamlNode

__all__ = [
    "PARAMETERS",
    "AsBuiltGeometry",
    "any_geometry_from_yaml",
    "as_built",
    "axis_directions",
    "check_geometry",
    "is_nominal",
]

_COMPONENTS = ("direction_1", "direction_2", *(f"{p}_{x}" for p in ("pivot", "ball") for x in "xyz"), "offset")
PARAMETERS = tuple(f"{leg}.{component}" for leg in LEGS for component in _COMPONENTS)
"""Names of the 54 parameters, nine for each leg, in the order of `AsBuiltGeometry.parameters`."""

_UNIT = 1e-6
"""Largest error of the length of an axis that is taken for rounding."""
_FLAT = 1e-6
"""Smallest height of the triangle of three balls, in units of its longest side."""
_MOST_LENGTH, _MOST_ANGLE = 1e7, 0.2
"""Largest standard deviations of random errors: normal numbers then do not leave the ranges accepted."""


@dataclass(frozen=True, repr=False, eq=False)
class AsBuiltGeometry:
    """Dimensions of one machine as it was built.

    Leg i turns about a revolute axis, along which nothing moves: its line starts at the pivot, is perpendicular to the
    axis, and ends at the centre of a ball of the middle platform. Its reading is |ball - pivot| + offset.

    Parameters
    ----------
    nominal : Geometry
        The nominal machine: branches are named after its branches, and its leg limits hold for the readings.
    axes : array_like, shape (6, 3)
        Unit vectors along the revolute axes of `LEGS`, of the lower legs in {B}, of the upper legs in {m}.
    pivots : array_like, shape (6, 3)
        Points of these axes where the legs' lines start [m], in the same frames.
    balls : array_like, shape (6, 3)
        Centres of the balls [m] in {n}. Those of a lower and of an upper leg need not coincide.
    offsets : array_like, shape (6,)
        What each reading exceeds the length of its leg by [m].

    Raises
    ------
    GeometryError
        If an array has the wrong shape or numbers that are not finite or beyond 1e9 m, if an axis is no unit vector, or
        if the balls of the lower or of the upper legs are on one line.

    Notes
    -----
    Six of the 54 parameters are the choice of {n} and change no reading.
    """

    nominal: Geometry
    axes: FloatArray
    pivots: FloatArray
    balls: FloatArray
    offsets: FloatArray

    def __post_init__(self) -> None:
        instance(self.nominal, Geometry, "nominal")
        axes = _array(self.axes, "axes", (6, 3), "unit vectors along the revolute axes")
        sizes = np.sqrt((axes**2).sum(axis=-1))
        wrong = np.abs(sizes - 1.0) > _UNIT
        if wrong.any():
            leg = int(wrong.argmax())
            expected = "unit vectors along the revolute axes"
            raise GeometryError("axes", expected, f"length {sizes[leg]:g} of {LEGS[leg]}", "Divide it by its length")
        # An exact unit vector keeps its bits, so that writing and reading gives the same machine.
        exact = np.abs(sizes - 1.0) <= 4.0 * np.finfo(float).eps
        self._put("axes", axes / np.where(exact, 1.0, sizes)[:, None])
        self._put("pivots", _array(self.pivots, "pivots", (6, 3), "points of the revolute axes in metres"))
        balls = _array(self.balls, "balls", (6, 3), "ball centres in {n} in metres")
        for stage, b in (("lower", balls[:3]), ("upper", balls[3:])):
            longest = triangle_sides(b).max()
            if longest < SMALLEST or np.linalg.norm(np.cross(b[1] - b[0], b[2] - b[0])) < _FLAT * longest**2:
                expected = "three ball centres of each stage that form a triangle"
                raise GeometryError("balls", expected, f"those of the {stage} legs on one line")
        self._put("balls", balls)
        self._put("offsets", _array(self.offsets, "offsets", (6,), "offsets of the readings in metres"))

    def _put(self, name: str, array: FloatArray) -> None:
        copy = np.array(array)
        copy.flags.writeable = False
        object.__setattr__(self, name, copy)

    def __repr__(self) -> str:
        nominal = AsBuiltGeometry.from_nominal(self.nominal)
        length = max(float(np.abs(a - b).max()) for a, b in zip(self.arrays[1:], nominal.arrays[1:], strict=True))
        sine = np.sqrt((np.cross(self.axes, nominal.axes) ** 2).sum(axis=-1))
        angle = float(np.arctan2(sine, (self.axes * nominal.axes).sum(axis=-1)).max())
        return f"AsBuiltGeometry({self.nominal!r}, errors to {length:.3g} m, {angle:.3g} rad)"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, AsBuiltGeometry):
            return NotImplemented
        return self.nominal == other.nominal and all(map(np.array_equal, self.arrays, other.arrays))

    def __hash__(self) -> int:
        # -0.0 and 0.0 are equal and must have one hash.
        return hash((self.nominal, *((array + 0.0).tobytes() for array in self.arrays)))

    def __reduce__(self) -> tuple[Any, ...]:
        return AsBuiltGeometry, (self.nominal, *self.arrays)

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Axes, pivots, balls and offsets."""
        return self.axes, self.pivots, self.balls, self.offsets

    @classmethod
    def from_nominal(cls, geometry: Geometry) -> AsBuiltGeometry:
        """Return the machine without errors."""
        return _without_errors(instance(geometry, Geometry, "geometry"))

    def perturbed(self, rng: Any = None, *, length: float = 1e-4, angle: float = 1e-4) -> AsBuiltGeometry:
        """Return a machine with independent normal errors added to all parameters.

        Parameters
        ----------
        rng : numpy.random.Generator, seed, or None
            Source of the errors.
        length : float
            Standard deviation of each coordinate of the pivots and balls and of the offsets [m].
        angle : float
            Standard deviation of the turn of each axis about either direction perpendicular to it [rad].

        Raises
        ------
        ArgumentError
            If a standard deviation is negative, not finite, or larger than 1e7 m or 0.2 rad.
        """
        random = generator(rng)
        spread = real_number(
            length, "length", f"a standard deviation from 0 to {_MOST_LENGTH:g} m", least=0.0, most=_MOST_LENGTH
        )
        expected = f"a standard deviation from 0 to {_MOST_ANGLE} rad"
        turn = real_number(angle, "angle", expected, least=0.0, most=_MOST_ANGLE, cause="Given in degrees?")
        scale = np.tile(np.repeat([turn, spread], [2, 7]), 6)
        return self.from_parameters(self.parameters + scale * random.standard_normal(54))

    @property
    def parameters(self) -> FloatArray:
        """The 54 parameters, named in `PARAMETERS`: per leg the direction (2), pivot and ball (3 each) and offset.

        The direction is the turn of the axis from the nominal one about the two directions perpendicular to it [rad]:
        the tangent coordinates of the shortest arc. All else is in metres.
        """
        nominal, first, second = axis_directions(self.nominal)
        across = np.stack([(self.axes * first).sum(axis=-1), (self.axes * second).sum(axis=-1)], axis=-1)
        sine = np.sqrt((across**2).sum(axis=-1))
        angle = np.arctan2(sine, (self.axes * nominal).sum(axis=-1))
        turn = across * np.divide(angle, sine, out=np.ones(6), where=sine > 0.0)[:, None]
        return np.concatenate([turn, self.pivots, self.balls, self.offsets[:, None]], axis=-1).reshape(54)

    def from_parameters(self, parameters: npt.ArrayLike) -> AsBuiltGeometry:
        """Return the machine of the same nominal geometry that has these 54 `parameters`.

        Raises
        ------
        GeometryError
            If they are not 54 finite numbers, or those of no machine.
        """
        values = _array(parameters, "parameters", (54,), "radians and metres, see PARAMETERS").reshape(6, 9)
        nominal, first, second = axis_directions(self.nominal)
        angle = np.sqrt((values[:, :2] ** 2).sum(axis=-1))
        if (angle > np.pi / 2.0).any():
            leg = int(angle.argmax())
            expected = "directions of the axes within a quarter turn of the nominal ones, in radians"
            raise GeometryError("parameters", expected, f"{angle[leg]:g} rad at {LEGS[leg]}", "Given in degrees?")
        across = np.sinc(angle / np.pi)[:, None] * values[:, :2]
        axes = np.cos(angle)[:, None] * nominal + across[:, :1] * first + across[:, 1:] * second
        return replace(self, axes=axes, pivots=values[:, 2:5], balls=values[:, 5:8], offsets=values[:, 8])

    @property
    def axis_derivatives(self) -> FloatArray:
        """Derivatives of `axes` with respect to the two coordinates of their direction in `parameters`, (6, 3, 2)."""
        nominal, first, second = axis_directions(self.nominal)
        turn = self.parameters.reshape(6, 9)[:, None, :2]
        angle = np.sqrt((turn**2).sum(axis=-1, keepdims=True))
        sinc, across = np.sinc(angle / np.pi), np.stack([first, second], axis=-1)
        # (cos a - sin a / a) / a², which is -1/3 at zero.
        small = angle < 1e-3
        curve = np.where(small, -1.0 / 3.0 + angle**2 / 30.0, (np.cos(angle) - sinc) / np.where(small, 1.0, angle) ** 2)
        along = (across * turn).sum(axis=-1, keepdims=True)
        return np.asarray(sinc * (across - turn * nominal[..., None]) + curve * turn * along)

    @property
    def limits(self) -> LegLimits | None:
        """Limits of the readings: those of the nominal geometry."""
        return self.nominal.limits

    @classmethod
    def from_yaml(cls, path: str | Path) -> AsBuiltGeometry:
        """Read a machine that `to_yaml` wrote.

        The keys are `nominal`, a mapping with `base_radius`, `platform_radius`, `middle_side` and perhaps `leg_limits`
        with a pair for each leg, and `legs`, a mapping of the six legs to `axis`, `pivot`, `ball` (three numbers each)
        and `offset`; lengths in metres.

        Raises
        ------
        GeometryError
            If the file cannot be read or describes no machine. The error names the line and the key.
        """
        path = file_path(path, error=GeometryError)
        root = YamlNode.read(path, "a YAML mapping with the keys nominal and legs", GeometryError)
        nodes = root.mapping({"nominal", "legs"})
        nominal, arrays = Geometry(*read_dimensions(nodes["nominal"])), leg_arrays(nodes["legs"])
        try:
            return cls(nominal, *arrays)
        except GeometryError as wrong:
            place = f"{wrong.argument} in {nodes['legs'].place}"
            raise GeometryError(place, wrong.expected, wrong.received, wrong.cause) from None

    def to_yaml(self, path: str | Path) -> None:
        """Write the machine to a YAML file, every number with all its digits.

        Raises
        ------
        GeometryError
            If the file cannot be written.
        """
        path = file_path(path, error=GeometryError)
        data = {"nominal": geometry_data(self.nominal), "legs": legs_data(self.arrays)}
        text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)
        heading = "# A 3RPS-3SPR manipulator as built, lengths in metres: see AsBuiltGeometry of spm_pin.\n"
        with writing(path, error=GeometryError):
            path.write_text(heading + text, encoding="utf-8")


def any_geometry_from_yaml(path: str | Path) -> Geometry | AsBuiltGeometry:
    """Read a YAML file of dimensions, or one that `AsBuiltGeometry.to_yaml` wrote, by its keys."""
    root = YamlNode.read(file_path(path, error=GeometryError), "a YAML mapping of dimensions", GeometryError)
    return AsBuiltGeometry.from_yaml(path) if {"nominal", "legs"} & root.keys else Geometry.from_yaml(path)


@functools.lru_cache(maxsize=16)
def _without_errors(geometry: Geometry) -> AsBuiltGeometry:
    axes, corners = geometry.revolute_axes, geometry.middle_radius * geometry.radial_directions
    pivots = np.concatenate([geometry.base_joints, geometry.platform_joints])
    balls = np.concatenate([corners, corners])
    return AsBuiltGeometry(geometry, np.concatenate([axes, axes]), pivots, balls, np.zeros(6))


def check_geometry(value: Any, argument: str = "geometry") -> Geometry | AsBuiltGeometry:
    """Return `value` if it is a `Geometry` or an `AsBuiltGeometry`, or raise `ArgumentError`."""
    return value if isinstance(value, AsBuiltGeometry) else instance(value, Geometry, argument)


def as_built(geometry: Geometry | AsBuiltGeometry) -> AsBuiltGeometry:
    """Return the machine itself, or the one without errors of a `Geometry`."""
    return geometry if isinstance(geometry, AsBuiltGeometry) else AsBuiltGeometry.from_nominal(geometry)


def is_nominal(geometry: AsBuiltGeometry) -> bool:
    """Return True if the machine has no errors."""
    return geometry == _without_errors(geometry.nominal)


def _refused(name: str) -> property:
    def refuse(self: AsBuiltGeometry) -> None:
        expected = "a Geometry: this function is for the nominal machine alone"
        raise GeometryError("geometry", expected, f"an AsBuiltGeometry, which has no {name}", "Pass its .nominal?")

    return property(refuse)


# A function written for the nominal machine ends in an error that says so, never in a wrong answer.
for _name in (
    *("base_radius", "platform_radius", "middle_side", "middle_radius", "dimensions"),
    *("base_joints", "platform_joints", "radial_directions", "revolute_axes"),
):
    setattr(AsBuiltGeometry, _name, _refused(_name))


def _array(value: npt.ArrayLike, argument: str, shape: tuple[int, ...], meaning: str) -> FloatArray:
    array = real_array(value, argument, shape, meaning, error=GeometryError)
    if array.shape != shape:
        raise GeometryError(argument, f"shape {shape}, {meaning}", f"shape {array.shape}")
    if (np.abs(array) > LARGEST).any():
        raise GeometryError(argument, f"{meaning}, at most {LARGEST:g}", f"{np.abs(array).max():g}", "Another unit?")
    return array


def axis_directions(geometry: Geometry) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each leg's nominal axis and the two directions perpendicular to it, radial and along z, (6, 3) each."""
    axes = np.tile(geometry.revolute_axes, (2, 1))
    up = np.broadcast_to([0.0, 0.0, 1.0], (6, 3))
    return axes, np.cross(up, axes), up
