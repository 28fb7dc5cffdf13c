"""The inverse displacement of a stage alone on arrays: a straight line of arithmetic, through which derivatives go."""

from __future__ import annotations

from typing import NamedTuple

from array_api_compat import is_array_api_obj

from spm_pin.arrays.library import Array, library_of, quietly
from spm_pin.formulas import planar_legs, stage_poses
from spm_pin.formulas.operations import vector_of
from spm_pin.formulas.planar_legs import LegPlane
from spm_pin.mechanism import Stage
from spm_pin.mechanism.arguments import check_instance


class StageState(NamedTuple):
    """States (...) of a stage."""

    rotation: Array
    """Rotation of the platform in {B}, shape (..., 3, 3)."""
    translation: Array
    """Position of the platform's origin in {B} [m], shape (..., 3)."""
    readings: Array
    """Readings of the encoders, shape (..., 3): [m], of RRS legs [rad]."""
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
    run, formulas = library.run, stage.kind.formulas
    rows = [tuple(map(tuple, x.tolist())) for x in (*legs.arrays[:3], *legs.planes)]
    constants = run(stage_poses.stage_constants, *rows[:3])
    turn = run(stage_poses.shortest_turn, vector_of(normal))
    equation = run(stage_poses.torsion_equation, turn, height, constants)
    rotation, position = run(stage_poses.pose_in_mode, 1.0, turn, height, equation, constants)
    exists, readings = run(stage_poses.discriminant, equation) >= 0.0, []
    for leg, ball in enumerate(run(stage_poses.platform_balls, rotation, position, constants.balls)):
        x, z = run(planar_legs.place_in_plane, ball, LegPlane(rows[1][leg], rows[3][leg], rows[4][leg]))
        exists = exists & (run(formulas.reach, x, z, numbers[leg]) >= 0.0)
        readings.append(run(formulas.reading, x, z, numbers[leg]) + float(legs.offsets[leg]))
    zero = library.zeros(readings[0])
    rotation, position, readings = (library.stacked(x, zero) for x in (rotation, position, readings))
    return StageState(rotation, position, readings, exists)
