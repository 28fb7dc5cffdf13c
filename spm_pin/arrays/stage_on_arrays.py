"""The inverse displacement of a stage alone on arrays: a straight line of arithmetic, through which derivatives go."""

from __future__ import annotations

from typing import Any, NamedTuple

from array_api_compat import is_array_api_obj

from spm_pin.arrays.library import Array, Library, library_of, quietly
from spm_pin.formulas import planar_legs, stage_poses
from spm_pin.formulas.operations import bind, vector_of
from spm_pin.formulas.planar_legs import LegPlane
from spm_pin.mechanism import Stage
from spm_pin.mechanism.arguments import check_instance

_ON_ITS_CIRCLE = 1e-6
"""Error of a ball's distance from its circle's centre, relative to the radius, from which on it is out of reach."""


class StageState(NamedTuple):
    """States (...) of a stage."""

    rotation: Array
    """Of the platform in {B}, shape (..., 3, 3)."""
    translation: Array
    """Of its origin in {B} [m], shape (..., 3)."""
    readings: Array
    """Shape (..., 3): [m], of RRS legs [rad]."""
    exists: Array
    """Where there is such a state, shape (...). Elsewhere numbers and derivatives are finite and mean nothing."""


@quietly
def stage_inverse(stage: Stage, normal: Array, height: Array) -> StageState:
    """Compute the state of a stage in mode T whose platform has a normal and a height.

    Parameters
    ----------
    stage : Stage
        The stage, drawn or as built.
    normal : array, shape (..., 3)
        Unit normal of the platform in {B}. It is not checked; -z has no state.
    height : array, shape (...)
        Of the platform's origin above the pivots [m].

    Returns
    -------
    StageState
        As mode T of `spm_pin.stages.inverse`: whether it is in the home's aspect is not asked.
    """
    check_instance(stage, Stage, "stage")
    library = library_of(normal=normal, height=height[..., None] if is_array_api_obj(height) else height)
    legs, numbers = stage.legs, [tuple(row) for row in stage.kind.numbers.tolist()]
    run = _binder(library)
    rows = [tuple(map(tuple, x.tolist())) for x in (*legs.arrays[:3], *legs.planes)]
    constants = library.run(stage_poses.stage_constants, *rows[:3])
    turn = run(stage_poses.shortest_turn, vector_of(normal))
    equation = run(stage_poses.torsion_equation, turn, height, constants)
    rotation, position = run(stage_poses.pose_in_mode, 1.0, turn, height, equation, constants)
    exists, readings = run(stage_poses.discriminant, equation) >= 0.0, []
    for leg, ball in enumerate(run(stage_poses.platform_balls, rotation, position, constants.balls)):
        x, z = run(planar_legs.place_in_plane, ball, LegPlane(rows[1][leg], rows[3][leg], rows[4][leg]))
        reading = run(stage.kind.formulas.reading, x, z, numbers[leg])
        centre_x, centre_z, radius = run(stage.kind.formulas.circle, reading, numbers[leg])
        # Of a ball out of reach the root is that of zero: the reading then leaves the ball elsewhere.
        distance = (x - centre_x) ** 2 + (z - centre_z) ** 2
        exists = exists & (library.xp.abs(distance - radius**2) <= _ON_ITS_CIRCLE * radius**2)
        readings.append(reading + float(legs.offsets[leg]))
    zero = library.zeros(readings[0])
    rotation, position, readings = (library.stacked(x, zero) for x in (rotation, position, readings))
    return StageState(rotation, position, readings, exists)


def _binder(library: Library) -> Any:
    """Return a function that runs a formula, arc tangents too."""
    xp = library.xp
    operations = {"sqrt": library.sqrt, "where": library.where, "cos": xp.cos, "sin": xp.sin, "arctan2": xp.atan2}
    return lambda formula, *arguments: bind(formula, **operations)(*arguments)
