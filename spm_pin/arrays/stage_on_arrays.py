"""Displacements of a stage alone on arrays: the inverse in closed form, the forward one as that of the robot."""

from __future__ import annotations

import functools
import operator
from typing import Any, NamedTuple

from array_api_compat import is_array_api_obj

from spm_pin.arrays.displacement import indexed, solved_stages
from spm_pin.arrays.library import Array, library_of, quietly, stage_machine, state_arrays
from spm_pin.formulas import circles, stage_poses, vectors
from spm_pin.formulas.circles import Circles
from spm_pin.formulas.operations import mapped, rows_of, vector_of
from spm_pin.machine import Stage
from spm_pin.support.arguments import check_instance

_TURNED = 1e5
"""Least 1 + z of a normal over eps: the torsion is right to about the inverse of it."""


class StageState(NamedTuple):
    """States (...) of a stage, with fields that are read by name: an index is one of the batch, as of `State`."""

    rotation: Array
    """Rotation of the platform in {B}, shape (..., 3, 3)."""
    translation: Array
    """Position of the platform's origin in {B} [m], shape (..., 3)."""
    readings: Array
    """Readings of the encoders, shape (..., 3): [m], for RRS legs [rad]."""
    exists: Array
    """True where the state exists, shape (...). Elsewhere numbers and derivatives are arbitrary and finite."""

    def __getitem__(self, index: Any) -> Any:
        """Index the batch, all fields alike."""
        return StageState._make(indexed(self, (2, 1, 1, 0), index))


@quietly
def stage_inverse(stage: Stage, normal: Array, height: Array) -> StageState:
    """Compute the state of a stage in mode T whose platform has a normal and a height.

    Parameters
    ----------
    stage : Stage
        The stage, nominal or calibrated.
    normal : array, shape (..., 3)
        Normal of the platform in {B}, of any length. Zero, NaN and directions within 1.4 mrad of -z (9° in float32)
        have no state: there the legs hardly hold the torsion.
    height : array, shape (...)
        Height of the platform's origin above the pivots [m].

    Returns
    -------
    StageState
        Mode T of `spm_pin.inverse_displacement`; whether it is in the home assembly region is not tested.
    """
    machine = stage_machine(check_instance(stage, Stage, "stage"))
    library = library_of(normal=normal, height=height[..., None] if is_array_api_obj(height) else height)
    run, (axes, pivots) = library.run, machine.legs[0]
    height, is_height = library.checked(height, 2.0 * machine.farthest, machine.r)
    up, is_normal = run(stage_poses.unit_normal, vector_of(normal), max(stage_poses.LEAST_RISE, _TURNED * library.eps))
    constants = run(stage_poses.stage_constants, axes, pivots, machine.balls[0])
    turn = run(stage_poses.shortest_turn, up)
    equation = run(stage_poses.torsion_equation, turn, height, constants)
    rotation, position = run(stage_poses.pose_in_mode, 1.0, turn, height, equation, constants)
    places = machine.places(library, run(stage_poses.platform_balls, rotation, position, constants.balls))
    reaches = (reach >= 0.0 for reach in machine.of_places(library, "reach", places))
    real = run(stage_poses.discriminant, equation) >= 0.0
    exists = functools.reduce(operator.and_, reaches, real & is_normal & is_height)
    own = zip(machine.readings(library, places), machine.offsets, strict=True)
    readings = [x + offset for x, offset in own]
    zero = library.zeros(readings[0])
    return StageState._make([*(library.stacked(x, zero) for x in (rotation, position, readings)), exists])


@quietly
def stage_forward(stage: Stage, readings: Array, near: StageState | None = None) -> StageState:
    """Compute the physical state of a stage with these readings, or the state beside another.

    Parameters
    ----------
    stage : Stage
        The stage, nominal or calibrated.
    readings : array, shape (..., 3)
        Readings of the encoders [m], for RRS legs [rad].
    near : StageState, optional
        From where Newton's method begins: the state to which it leads, if it is on the same side of the forward
        singularities and all legs are in their working modes. No proof is given that it has not left the assembly mode
        where the state is far away.

    Returns
    -------
    StageState
        Without `near` that of `spm_pin.forward_physical`, but for states that Newton's method from the level
        platform does not find.

    Notes
    -----
    Without `near` a state to which Newton's method from the level platform does not lead does not exist here, where
    `spm_pin.forward_physical` finds it among all modes. Of random states tilted by up to 75° that is for seven
    stages of usual proportions up to 6 in 100,000, and none below 50° but for slides that are level; for PRS and RRS
    stages of random proportions 0.3 to 6 in 100, and up to 6 in 1,000 of those below 30°. Give `near` there.
    """
    machine = stage_machine(check_instance(stage, Stage, "stage"))
    library = library_of(legs=3, readings=readings, **state_arrays(near, "near", ("rotation", "translation")))
    shown, valid = machine.checked_readings(library, [readings[..., i] for i in range(3)])
    without_offsets = [x - offset for x, offset in zip(shown, machine.offsets, strict=True)]
    zero = library.zeros(*without_offsets, *([] if near is None else [near.translation[..., 0]]))
    centres, radii = zip(*machine.circles(library, without_offsets), strict=True)
    own = Circles(machine.legs[0].axes, centres, radii, machine.squares[0])
    if near is None:
        start = library.run(circles.level_balls, own, machine.balls[0], stage.kind.up)
    else:
        pose = rows_of(near.rotation), vector_of(near.translation)
        start = library.run(stage_poses.platform_balls, *pose, machine.balls[0])
    solved = solved_stages(library, machine, [own], [start], zero, is_near=near is not None)
    b, rotation, position, exists = mapped(lambda x: x[0, ...], solved)
    exists = exists & valid & machine.in_working_modes(library, b, without_offsets)
    if near is None:
        rods = library.run(vectors.differences, b, centres)
        exists = exists & library.run(circles.is_home_state, own, rods, b, stage.kind.up)
    else:
        exists = exists & near.exists
    return StageState._make([*(library.stacked(x, zero) for x in (rotation, position, shown)), exists])
