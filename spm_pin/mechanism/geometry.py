"""The dimensions of a manipulator and its parameters, as drawn or as built, its files, and lengths that fit its size.

Frames (Fig. 1 and Eq. (1) of the paper): {B} at the centre O of the base triangle, Z up; {m} at the centre o of the
terminal platform, z up; {n} at the centre of the middle platform's triangle, x along b_3 b_1 and z normal to it. Legs
1, 2, 3 stand at the azimuths -30, 90 and 210 degrees in all three.
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Collection
from dataclasses import MISSING, dataclass, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from spm_pin.errors import GeometryError, raised_as
from spm_pin.formulas.leg_constants import turned_axis
from spm_pin.formulas.operations import on_arrays
from spm_pin.mechanism import notebook
from spm_pin.mechanism.arguments import FloatArray, check_instance, dimension, generator, real_number, type_and_value
from spm_pin.mechanism.files import file_path, read_yaml, writing
from spm_pin.mechanism.leg_kinds import KINDS, RPS, LegKind
from spm_pin.mechanism.legs import AXES, LEGS, RADIAL, LegLimits, Legs, axis_directions, bounded_array, drawn_legs
from spm_pin.mechanism.stage import Stage

_COMPONENTS = ("direction_1", "direction_2", *(f"{p}_{x}" for p in ("pivot", "ball") for x in "xyz"), "offset")
PARAMETERS = tuple(f"{leg}.{component}" for leg in LEGS for component in _COMPONENTS)
"""Names of the 54 parameters of RPS legs, nine for each, in the order of `Geometry.parameters`."""

_turned_axis = on_arrays(turned_axis)
_MOST_LENGTH, _MOST_ANGLE = 1e7, 0.2
"""Largest standard deviations of random errors: normal numbers then do not leave the ranges accepted."""

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
"""Units of length, and how many of them are a metre."""
_LARGEST_ANGLE = 4.0 * math.pi
"""Largest limit of an angle [rad]: a crank's, with its encoder's offset."""
_SAME = 1e-9
"""Machines that differ by less, relative to the middle side, are the same."""
_PROPORTION = 10.0
"""Lengths this many times the machine's size are read as a wrong unit."""
_LARGEST_MACHINE = 100.0
"""A machine more times as large as its legs are long is read as one in a wrong unit."""

_DIMENSIONS = {"E": "base_radius", "C": "platform_radius", "d": "middle_side"}
_LEG_KEYS = {
    "axis": "a unit vector along the revolute axis",
    "pivot": "in metres",
    "ball": "in metres",
    "offset": "a number of metres, of RRS legs of radians",
}
_KIND_KEYS = "lower_legs", "upper_legs"
_IMPLAUSIBLE = 20.0
"""A file with a larger dimension [m] is suspected to be in another unit."""
_HEADING = "# A 3RPS-3SPR manipulator, lengths in metres: see Geometry of spm_pin.\n"


def config_directory() -> Path:
    """Return the folder of the YAML files of the description, in an installed package or in a checkout."""
    package = Path(str(resources.files("spm_pin")))
    installed = package / "share" / "spm_description" / "config"
    return installed if installed.is_dir() else package.parent / "urdf" / "config"


@dataclass(frozen=True, repr=False)
class Geometry:
    """Dimensions of a manipulator, and its legs: those of the drawing, or those of one machine as built.

    Parameters
    ----------
    base_radius, platform_radius : float
        E and C, from the centres O and o of base and terminal platform to their revolute joints a_i and c_i [m].
    middle_side : float
        d, side of the middle platform's triangle b_1 b_2 b_3 [m].
    limits : LegLimits, optional
        Limits of the encoders' readings, which in a drawn machine are the leg lengths. None means unlimited.
    legs : Legs, optional
        The legs of a machine as built; branches are named after those of the drawn machine.

    Notes
    -----
    A dimension is a number from 1e-9 to 1e9 m: then no product of lengths in this package over- or underflows. Six of
    the 54 parameters of the legs are the choice of {n} and change no reading.
    """

    base_radius: float
    platform_radius: float
    middle_side: float
    limits: LegLimits | None = None
    legs: Legs = None  # type: ignore[assignment]  # drawn below

    @raised_as(GeometryError)
    def __post_init__(self) -> None:
        for name in _DIMENSIONS.values():
            object.__setattr__(self, name, dimension(getattr(self, name), name))
        if self.limits is not None:
            check_instance(self.limits, LegLimits, "limits", "LegLimits(minimum, maximum), or None")
        legs: Legs | None = self.legs
        if legs is not None:
            check_instance(legs, Legs, "legs", "Legs(axes, pivots, balls, offsets), or None")
        drawn = drawn_legs(*self.dimensions, *([] if legs is None else [legs.kinds]))
        if self.limits is not None:
            _check_limits(self.limits, drawn)
        # Drawn legs follow the dimensions when these are replaced.
        if legs is None or legs.is_drawn or legs == drawn:
            object.__setattr__(self, "legs", drawn)
        if self.limits is not None:
            self._check_proportion(self.limits)

    def _check_proportion(self, limits: LegLimits) -> None:
        """Raise `GeometryError` if limits and dimensions are in different units."""
        lengths = np.array(self.legs.units) == "m"
        ends, size = (np.array([limits.minimum, limits.maximum]) - self.legs.offsets)[:, lengths], machine_size(self)
        if not self.legs.are_rps:
            ends = np.abs(ends)
        longest = float(ends.max(initial=0.0, where=np.isfinite(ends)))
        cause = unit_hint(self, longest)
        if 0.0 < longest < size / _LARGEST_MACHINE:
            cause = f"Lengths are in metres: is the middle side {self.middle_side:g} mm or cm?"
        if cause:
            expected = f"limits in proportion to a machine about {size:.3g} m high, or infinity for none"
            raise GeometryError("limits", expected, f"lengths of up to {longest:g} m", cause)

    def __repr__(self) -> str:
        limits = "" if self.limits is None else f", limits={self.limits!r}"
        text = (
            f"Geometry(base_radius={self.base_radius:.6g}, platform_radius={self.platform_radius:.6g}, "
            f"middle_side={self.middle_side:.6g}{limits}"
        )
        if not self.legs.are_rps:
            text += f", legs={self.legs.kinds[0]!r} below, {self.legs.kinds[1]!r} above"
        if self.is_nominal:
            return f"{text})"
        angles, *lengths = self._deviations()
        length = max(float(deviations.max()) for deviations in lengths)
        return f"{text}, legs off the drawing by up to {length:.3g} m, {float(angles.max()):.3g} rad)"

    def _repr_html_(self) -> str:
        dimensions = zip(("E, base radius", "C, platform radius", "d, middle side"), self.dimensions, strict=True)
        rows = [(name, f"{value:.6g} m") for name, value in dimensions]
        ends = () if self.limits is None else (self.limits.minimum, self.limits.maximum)
        pairs = [f"{low:.6g} to {high:.6g} m" for low, high in zip(*ends, strict=True)]
        if len(set(pairs)) <= 1:
            rows.append(("leg limits", pairs[0] if pairs else "none"))
        else:
            rows += [(f"limits of {leg}", pair) for leg, pair in zip(LEGS, pairs, strict=True)]
        if not self.is_nominal:
            for name, deviations in zip(("axes", "pivots", "balls", "offsets"), self._deviations(), strict=True):
                unit, leg = "mrad" if name == "axes" else "mm", int(deviations.argmax())
                rows.append((f"{name} off the drawing", f"up to {1e3 * deviations[leg]:.3g} {unit}, {LEGS[leg]}"))
        title = "Geometry as drawn" if self.is_nominal else "Geometry as built"
        return notebook.table(title, ("dimension", ""), rows)

    def _deviations(self) -> tuple[FloatArray, ...]:
        """Return by how much each leg differs from the drawing: axis [rad], and pivot, ball, offset [m], (6,) each."""
        drawn = self.nominal.legs
        sine = np.sqrt((np.cross(self.legs.axes, drawn.axes) ** 2).sum(axis=-1))
        angles = np.arctan2(sine, (self.legs.axes * drawn.axes).sum(axis=-1))
        _, pivots, balls, offsets = map(np.abs, map(np.subtract, self.legs.arrays, drawn.arrays))
        return angles, pivots.max(axis=-1), balls.max(axis=-1), offsets

    def __reduce__(self) -> tuple[Any, ...]:
        return Geometry, (*self.dimensions, self.limits, self.legs)

    @classmethod
    @raised_as(GeometryError)
    def of_stages(cls, lower: Stage, upper: Stage) -> Geometry:
        """Return the machine as drawn of two stages, of legs of either kind, whose platforms are one triangle of balls.

        The upper stage stands on the same balls with its base for the terminal platform.
        """
        check_instance(lower, Stage, "lower")
        check_instance(upper, Stage, "upper")
        if not math.isclose(lower.platform_radius, upper.platform_radius, rel_tol=_SAME):
            expected = (
                f"the platform_radius of the lower stage, {lower.platform_radius:g} m: both stand on one triangle"
            )
            raise GeometryError("upper", expected, f"{upper.platform_radius:g} m")
        dimensions = lower.base_radius, upper.base_radius, math.sqrt(3.0) * lower.platform_radius
        ends = [x.limits or (-math.inf, math.inf) for x in (lower, upper)]
        limits = LegLimits.stages(*ends) if lower.limits or upper.limits else None
        return cls(*dimensions, limits, drawn_legs(*dimensions, (lower.legs, upper.legs)))

    @classmethod
    def paper(cls) -> Geometry:
        """Return the paper's manipulator: E = 1.2/√3 m, C = 0.6/√3 m, d = 0.8 m, legs from 1.10 to 1.50 m.

        The paper prints no leg limits; these are the project's own, see `urdf/config/geometry.yaml`.
        """
        return cls.from_yaml(config_directory() / "geometry.yaml")

    @classmethod
    def from_yaml(cls, path: str | Path) -> Geometry:
        """Read a geometry from a YAML file, all lengths in metres; `docs/howto/geometry_files.md` describes it.

        A `GeometryError` names the key of what describes no manipulator. A warning is given for dimensions above 20 m,
        which are often centimetres or millimetres.
        """
        return _read(path)

    def to_yaml(self, path: str | Path) -> None:
        """Write the geometry to a YAML file that `from_yaml` reads, every number with all its digits."""
        with raised_as(GeometryError):
            path = file_path(path)
            text = yaml.safe_dump(self.as_data(), sort_keys=False, default_flow_style=None, width=120)
            with writing(path):
                path.write_text(_HEADING + text, encoding="utf-8")

    def as_data(self) -> dict[str, Any]:
        """Return what `to_yaml` writes."""
        data: dict[str, Any] = dict(zip(_DIMENSIONS.values(), self.dimensions, strict=True))
        if self.limits is not None:
            pairs = [list(pair) for pair in zip(self.limits.minimum, self.limits.maximum, strict=True)]
            data["leg_limits"] = pairs[0] if pairs.count(pairs[0]) == 6 else dict(zip(LEGS, pairs, strict=True))
        if not self.legs.are_rps:
            data |= {key: kind.as_data() for key, kind in zip(_KIND_KEYS, self.legs.kinds, strict=True)}
        if not self.is_nominal:
            rows = zip(*(array.tolist() for array in self.legs.arrays), strict=True)
            data["legs"] = {leg: dict(zip(_LEG_KEYS, row, strict=True)) for leg, row in zip(LEGS, rows, strict=True)}
        return data

    @property
    def is_nominal(self) -> bool:
        """True if the legs are those of the drawing."""
        return self.legs.is_drawn

    @functools.cached_property
    def nominal(self) -> Geometry:
        """The machine as drawn, with the same dimensions and limits."""
        drawn = drawn_legs(*self.dimensions, self.legs.kinds)
        return self if self.is_nominal else Geometry(*self.dimensions, self.limits, drawn)

    @property
    def dimensions(self) -> tuple[float, float, float]:
        """E, C and d [m]."""
        return self.base_radius, self.platform_radius, self.middle_side

    @property
    def middle_radius(self) -> float:
        """Radius r = d/√3 of the drawn middle platform, from its centre to a ball joint b_i [m]."""
        return self.middle_side / math.sqrt(3.0)

    @property
    def base_joints(self) -> FloatArray:
        """Lower revolute joints a_1..a_3 of the drawing as rows (3, 3) [m] in {B}. Eq. (1a)."""
        return self.base_radius * RADIAL

    @property
    def platform_joints(self) -> FloatArray:
        """Upper revolute joints c_1..c_3 of the drawing as rows (3, 3) [m] in {m}. Eq. (1b)."""
        return self.platform_radius * RADIAL

    @property
    def radial_directions(self) -> FloatArray:
        """Unit vectors from O towards the drawn a_i in {B}, equally from o towards c_i in {m}, as rows (3, 3)."""
        return RADIAL.copy()

    @property
    def revolute_axes(self) -> FloatArray:
        """Unit revolute axes of the drawn legs 1..3 as rows (3, 3): in {B} at the a_i, in {m} at the c_i. Eq. (4)."""
        return AXES.copy()

    @property
    def parameters(self) -> FloatArray:
        """The parameters of the legs, named in `parameter_names`: per leg direction (2), pivot, ball (3 each), offset.

        After these 54 follow the numbers that are fixed in PRS and RRS legs, leg by leg. The direction is the turn of
        the axis from the drawn one about the two directions perpendicular to it [rad]: the tangent coordinates of the
        shortest arc. Units are in `parameter_units`.
        """
        drawn, first, second = axis_directions()
        axes = self.legs.axes
        across = np.stack([(axes * first).sum(axis=-1), (axes * second).sum(axis=-1)], axis=-1)
        sine = np.sqrt((across**2).sum(axis=-1))
        angle = np.arctan2(sine, (axes * drawn).sum(axis=-1))
        turn = across * np.divide(angle, sine, out=np.ones(6), where=sine > 0.0)[:, None]
        _, pivots, balls, offsets = self.legs.arrays
        numbers = [kind.numbers[:, : len(kind.identified)].ravel() for kind in self.legs.kinds]
        rows = np.concatenate([turn, pivots, balls, offsets[:, None]], axis=-1)
        return np.concatenate([rows.ravel(), *numbers])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the `parameters`: `PARAMETERS`, and for PRS and RRS legs such as `r_b1.rod`."""
        stages = zip(self.legs.kinds, (LEGS[:3], LEGS[3:]), strict=True)
        return *PARAMETERS, *(f"{leg}.{name}" for kind, legs in stages for leg in legs for name in kind.identified)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the `parameters`, "m" or "rad"."""
        offsets = dict(zip((f"{leg}.offset" for leg in LEGS), self.legs.units, strict=True))
        return tuple(offsets.get(name, "rad" if ".direction" in name else "m") for name in self.parameter_names)

    @raised_as(GeometryError)
    def from_parameters(self, parameters: npt.ArrayLike) -> Geometry:
        """Return the machine of the same dimensions and limits whose legs have these `parameters`."""
        count, meaning = len(self.parameter_names), "radians and metres, see Geometry.parameter_names"
        read = bounded_array(parameters, "parameters", (count,), meaning)
        values, kinds, first = read[:54].reshape(6, 9), [], 54
        for kind in self.legs.kinds:
            last = first + 3 * len(kind.identified)
            kinds.append(kind.with_numbers(read[first:last].reshape(3, -1)))
            first = last
        angle = np.sqrt((values[:, :2] ** 2).sum(axis=-1))
        if (angle > np.pi / 2.0).any():
            leg = int(angle.argmax())
            expected = "directions of the axes within a quarter turn of the drawn ones, in radians"
            raise GeometryError("parameters", expected, f"{angle[leg]:g} rad at {LEGS[leg]}", "Given in degrees?")
        axes = np.stack(_turned_axis(tuple(np.tile(AXES, (2, 1)).T), values[:, 0], values[:, 1]), axis=-1)
        legs = Legs(axes, values[:, 2:5], values[:, 5:8], values[:, 8], (kinds[0], kinds[1]))
        return Geometry(*self.dimensions, self.limits, legs)

    def perturbed(self, rng: Any = None, *, length: float = 1e-4, angle: float = 1e-4) -> Geometry:
        """Return a machine with independent normal errors added to all parameters of the legs.

        Their standard deviations are `length`, of each coordinate of pivots and balls and of the offsets [m], up to
        1e7, and `angle`, of the turn of each axis about either direction perpendicular to it [rad], up to 0.2.
        """
        random = generator(rng)
        expected = f"a standard deviation from 0 to {_MOST_LENGTH:g} m"
        spread = real_number(length, "length", expected, least=0.0, most=_MOST_LENGTH)
        expected = f"a standard deviation from 0 to {_MOST_ANGLE} rad"
        turn = real_number(angle, "angle", expected, least=0.0, most=_MOST_ANGLE, cause="Given in degrees?")
        scale = np.array([turn if unit == "rad" else spread for unit in self.parameter_units])
        return self.from_parameters(self.parameters + scale * random.standard_normal(len(scale)))

    @property
    def axis_derivatives(self) -> FloatArray:
        """Derivatives of the axes with respect to the two coordinates of their direction in `parameters`, (6, 3, 2)."""
        drawn, first, second = axis_directions()
        turn = self.parameters.reshape(6, 9)[:, None, :2]
        angle = np.sqrt((turn**2).sum(axis=-1, keepdims=True))
        sinc, across = np.sinc(angle / np.pi), np.stack([first, second], axis=-1)
        # (cos a - sin a / a) / a², which is -1/3 at zero.
        small = angle < 1e-3
        curve = np.where(small, -1.0 / 3.0 + angle**2 / 30.0, (np.cos(angle) - sinc) / np.where(small, 1.0, angle) ** 2)
        along = (across * turn).sum(axis=-1, keepdims=True)
        return np.asarray(sinc * (across - turn * drawn[..., None]) + curve * turn * along)


def _check_limits(limits: LegLimits, legs: Legs) -> None:
    """Raise a GeometryError for limits that no readings of such legs have."""
    for leg, name in enumerate(LEGS):
        kind, low, high = legs.kinds[leg // 3], limits.minimum[leg], limits.maximum[leg]
        received = f"[{low:g}, {high:g}] for {name}"
        if isinstance(kind, RPS) and low < 0.0:
            raise GeometryError("limits", "limits of lengths, 0 <= minimum < maximum, in metres", received)
        if kind.unit == "rad" and max(abs(x) for x in (low, high, 0.0) if math.isfinite(x)) > _LARGEST_ANGLE:
            raise GeometryError("limits", f"angles in radians, within ±{_LARGEST_ANGLE:.3g}", received, "In degrees?")


def check_same_machine(geometry: Geometry, expected: Geometry, argument: str, owner: str) -> None:
    """Raise `GeometryError` unless both have the same dimensions and legs; limits only choose the tree's zero."""
    cause = "Computed for another machine?"
    for name in _DIMENSIONS.values():
        received, wanted = getattr(geometry, name), getattr(expected, name)
        if abs(received - wanted) > _SAME * expected.middle_side:
            raise GeometryError(argument, f"the {name} of {owner}, {wanted:.9g} m", f"{received:.9g} m", cause)
    for name in ("axes", "pivots", "balls", "offsets"):
        apart = np.abs(getattr(geometry.legs, name) - getattr(expected.legs, name))
        unit, scale = ("rad", 1.0) if name == "axes" else ("m", expected.middle_side)
        if apart.max() > _SAME * scale:
            leg = LEGS[int(apart.argmax()) * len(LEGS) // apart.size]
            difference = f"a machine that differs by {apart.max():.1e} {unit} in {leg}"
            raise GeometryError(argument, f"the {name} of {owner}", difference, cause)


def check_rps(geometry: Geometry, what: str) -> None:
    """Raise a `GeometryError` unless all legs are RPS, which `what` is known for alone."""
    if not geometry.legs.are_rps:
        lower, upper = (kind.name for kind in geometry.legs.kinds)
        cause = "Known for PRS and RRS legs are displacements, rates, forces, stiffness, singularities and paths"
        raise GeometryError("geometry", f"a machine of RPS legs for {what}", f"{lower} below and {upper} above", cause)


def machine_size(geometry: Geometry) -> float:
    """Return E + C + 2 d [m], about the height of a machine."""
    return geometry.base_radius + geometry.platform_radius + 2.0 * geometry.middle_side


def likely_unit(geometry: Geometry, length: float, unit: str = "m") -> str | None:
    """Return the unit in which a length [m], if it was typed in `unit`, would be in proportion; None if it is."""

    def disproportion(tried: str) -> float:
        return abs(math.log(length * PER_METRE[unit] / PER_METRE[tried] / machine_size(geometry)))

    if not (np.isfinite(length) and length > 0.0) or disproportion(unit) < math.log(_PROPORTION):
        return None
    better = min(PER_METRE, key=disproportion)
    return better if better != unit else None


def unit_hint(geometry: Geometry, lengths: npt.ArrayLike) -> str:
    """Return a sentence on the unit that the largest of these lengths [m] may be in; empty if in proportion."""
    length = float(np.abs(lengths).max())
    unit = likely_unit(geometry, length)
    if unit is None:
        return ""
    return f"Lengths are in metres, and {length:g} m are out of proportion to this machine; is it {length:g} {unit}?"


@raised_as(GeometryError)
def _read(path: str | Path) -> Geometry:
    sizes = {f"{triangle}_{size}" for triangle in ("base", "platform") for size in ("side", "radius")}
    data = _mapping(read_yaml(path), str(path), {"middle_side"}, sizes | {"leg_limits", "legs", *_KIND_KEYS})
    own = {"leg_limits", "legs", *_KIND_KEYS}
    lengths = {key: dimension(data[key], f"{key} in {path}") for key in data.keys() - own}
    radii = []
    for triangle in ("base", "platform"):
        keys = [key for key in (f"{triangle}_side", f"{triangle}_radius") if key in lengths]
        if len(keys) != 1:
            expected = f"exactly one of the keys {triangle}_side and {triangle}_radius"
            raise GeometryError(str(path), expected, " and ".join(keys) or "neither")
        radii.append(lengths[keys[0]] / (math.sqrt(3.0) if keys[0].endswith("_side") else 1.0))
    limits = _limits(data["leg_limits"], f"leg_limits in {path}") if "leg_limits" in data else None
    kinds = [_kind(data[key], f"{key} in {path}") if key in data else RPS() for key in _KIND_KEYS]
    dimensions, pair = (radii[0], radii[1], lengths["middle_side"]), (kinds[0], kinds[1])
    legs = _legs(data["legs"], f"legs in {path}", pair) if "legs" in data else drawn_legs(*dimensions, pair)
    geometry = Geometry(*dimensions, legs=legs)
    with raised_as(GeometryError, str(path)):
        geometry = replace(geometry, limits=limits)
    longest = max(lengths, key=lambda key: lengths[key])
    if lengths[longest] > _IMPLAUSIBLE:
        text = f"{path}: {longest} is {lengths[longest]:g} m. Lengths are read as metres"
        warnings.warn(f"{text}; are these in another unit?", stacklevel=4)
    return geometry


def _mapping(data: Any, place: str, keys: Collection[str], optional: Collection[str] = ()) -> dict[str, Any]:
    """Return a mapping of a file, which must have all of `keys` and may have `optional` ones."""
    expected = f"a mapping with the keys {', '.join(sorted(keys))}"
    if optional:
        expected += f", and perhaps {', '.join(sorted(optional))}"
    if not isinstance(data, dict):
        received, cause = "an empty file" if data is None else type_and_value(data), ""
        if isinstance(data, str):
            cause = "A URDF or another XML file?" if data.lstrip().startswith("<") else "A table, as CSV files are?"
        raise GeometryError(place, expected, received, cause)
    for key in data:
        if key not in keys and key not in optional:
            meant = _DIMENSIONS.get(key)
            raise GeometryError(place, expected, f"the key {key!r}", f"{key} is {meant}" if meant else "")
    if missing := set(keys) - data.keys():
        raise GeometryError(place, expected, f"no key {', '.join(sorted(missing))}")
    return data


def _numbers(data: Any, place: str, count: int, meaning: str) -> list[float]:
    """Return a list of numbers of a file."""
    if not isinstance(data, list) or len(data) != count or not all(isinstance(x, float) for x in data):
        received = f"{len(data)} members" if isinstance(data, list) else type_and_value(data)
        raise GeometryError(place, f"a list of {count} numbers, {meaning}", received)
    return data


def _limits(data: Any, place: str) -> LegLimits:
    pairs = _mapping(data, place, LEGS) if isinstance(data, dict) else dict.fromkeys(LEGS, data)
    bounds = []
    for leg in LEGS:
        where = f"{leg} of {place}" if isinstance(data, dict) else place
        bounds.append(_numbers(pairs[leg], where, 2, "a minimum and a maximum in metres"))
        try:
            LegLimits(*bounds[-1])
        except GeometryError as wrong:
            raise GeometryError(where, wrong.expected, str(bounds[-1]), wrong.cause) from None
    return LegLimits(*zip(*bounds, strict=True))


def _kind(data: Any, place: str) -> LegKind:
    """Return the kind of a stage's legs, with their fixed numbers."""
    names = ", ".join(KINDS)
    if not isinstance(data, dict) or data.get("kind") not in KINDS:
        received = repr(data.get("kind")) if isinstance(data, dict) else type_and_value(data)
        raise GeometryError(place, f"a mapping with the key kind, one of {names}, and the kind's numbers", received)
    kind = KINDS[data["kind"]]
    keys = {field.name for field in fields(kind)}
    numbers = _mapping(data, place, {"kind"} | {x.name for x in fields(kind) if x.default is MISSING}, keys)
    with raised_as(GeometryError, place):
        return kind(**{key: value for key, value in numbers.items() if key != "kind"})


def _legs(data: Any, place: str, kinds: tuple[LegKind, LegKind]) -> Legs:
    legs = _mapping(data, place, LEGS)
    arrays = []
    for key, meaning in _LEG_KEYS.items():
        rows = []
        for leg in LEGS:
            where = f"{key} of {leg} of {place}"
            row = _mapping(legs[leg], f"{leg} of {place}", _LEG_KEYS)[key]
            rows.append(real_number(row, where, meaning) if key == "offset" else _numbers(row, where, 3, meaning))
        arrays.append(np.array(rows))
    with raised_as(GeometryError, place):
        axes, pivots, balls, offsets = arrays
        return Legs(axes, pivots, balls, offsets, kinds)
