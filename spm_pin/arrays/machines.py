"""A machine as arrays: its drawing, and its two stages with their legs and balls."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from spm_pin.arrays.library import Array, Library, library_of
from spm_pin.errors import ArgumentError
from spm_pin.formulas import ball_motions, leg_constants, leg_planes
from spm_pin.formulas.leg_constants import AXES
from spm_pin.formulas.leg_planes import StageLegs
from spm_pin.formulas.operations import vector_of
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import type_and_value

_UNLIMITED = (0.0,) * 6, (math.inf,) * 6


class Machine(NamedTuple):
    """Dimensions and legs; floats, or arrays of any shape of batch."""

    radii: tuple[Any, Any]  # E and C
    r: Any  # of the drawn middle platform
    legs: tuple[StageLegs, StageLegs]  # in {B} and in {m}
    balls: tuple[Any, Any]  # in {n}
    squares: tuple[Any, Any]  # of the sides of the balls' triangles
    weights: Any  # see `leg_planes.upper_balls`
    offsets: tuple[Any, ...]
    limits: tuple[tuple[float, ...], tuple[float, ...]]
    is_drawn: bool

    def home_lengths(self, library: Library) -> list[Any]:
        """Return the leg lengths at home of both stages."""
        limits = ((max(self.limits[0][k : k + 3]), min(self.limits[1][k : k + 3])) for k in (0, 3))
        run = functools.partial(library.run, leg_constants.home_length)
        return [run(radius, self.r, *x) for radius, x in zip(self.radii, limits, strict=True)]

    def upper_balls(self, library: Library, b: Any) -> Any:
        """Return the upper legs' balls from the lower ones'."""
        return b if self.is_drawn else library.run(leg_planes.upper_balls, b, self.weights)


def read_machine(library: Library, geometry: Any) -> Machine:
    """Return a machine of a `Geometry`, of dimensions (..., 3) E, C, d, or of the parameters (..., 54) of its legs."""
    if isinstance(geometry, Geometry):
        return _machine_of(geometry)
    size = geometry.shape[-1] if geometry.ndim else 0
    if size == 3:
        base, platform, side = vector_of(geometry)
        r = side / 3.0**0.5
        corners = library.run(leg_constants.drawn_triangle, r)
        pivots = [x for radius in (base, platform) for x in library.run(leg_constants.drawn_triangle, radius)]
        legs = (*AXES, *AXES), tuple(pivots), (*corners, *corners), (0.0,) * 6
        return _completed(library, (base, platform), r, legs, _UNLIMITED, True)
    if size == 54:
        return _machine_of_parameters(library, geometry)
    expected = "a Geometry, dimensions (..., 3) E, C, d, or the parameters (..., 54) of the legs"
    raise ArgumentError("geometry", expected, f"shape {tuple(geometry.shape)}")


def _completed(library: Library, radii: Any, r: Any, legs: Any, *further: Any) -> Machine:
    """Return the machine of axes, pivots, balls and offsets of six legs."""
    axes, pivots, balls, offsets = legs
    stages, halves = (StageLegs(axes[:3], pivots[:3]), StageLegs(axes[3:], pivots[3:])), (balls[:3], balls[3:])
    lower, upper = (library.run(ball_motions.squared_sides, b) for b in halves)
    weights = library.run(leg_planes.upper_ball_weights, *halves)
    return Machine(radii, r, stages, halves, (lower, upper), weights, offsets, *further)


@functools.lru_cache(maxsize=32)
def _machine_of(geometry: Geometry) -> Machine:
    *vectors, offsets = (x.tolist() for x in geometry.legs.arrays)
    legs, limits = (*(tuple(map(tuple, x)) for x in vectors), tuple(offsets)), geometry.limits
    bounds = _UNLIMITED if limits is None else (tuple(limits.minimum), tuple(limits.maximum))
    library, radii = library_of(numbers=np.zeros(1)), (geometry.base_radius, geometry.platform_radius)
    return _completed(library, radii, geometry.middle_radius, legs, bounds, geometry.is_nominal)


def _machine_of_parameters(library: Library, parameters: Array) -> Machine:
    """Return the machine of 54 parameters; the drawing beside it has the means of its radii."""
    legs: Any = [tuple(parameters[..., 9 * i + k] for k in range(9)) for i in range(6)]
    axes = [library.run(leg_constants.turned_axis, AXES[i % 3], *legs[i][:2]) for i in range(6)]
    pivots, balls = tuple(leg[2:5] for leg in legs), tuple(leg[5:8] for leg in legs)
    halves = pivots[:3], pivots[3:], balls[:3], balls[3:]
    base, platform, *middle = (library.run(leg_constants.mean_radius, x) for x in halves)
    numbers = tuple(axes), pivots, balls, tuple(leg[8] for leg in legs)
    return _completed(library, (base, platform), 0.5 * sum(middle), numbers, _UNLIMITED, False)


def state_arrays(state: Any, name: str) -> dict[str, Any]:
    """Return the arrays of a state by their names in messages; none of None."""
    if state is None:
        return {}
    fields = "rotation", "translation", "middle_joints"
    if not all(hasattr(state, field) for field in (*fields, "exists")):
        raise ArgumentError(name, "a State or a Configuration", type_and_value(state))
    return {f"{name}.{field}": getattr(state, field) for field in fields}
