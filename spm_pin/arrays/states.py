"""Joint values, Jacobian, leg forces and distances to singularities of states on arrays."""

from __future__ import annotations

from typing import Any

from spm_pin.arrays.displacement import State, rods_of
from spm_pin.arrays.library import Array, library_of, quietly, read_machine, state_arrays
from spm_pin.formulas import ball_motions, leg_constants, leg_planes, vectors, wrenches
from spm_pin.formulas import joint_values as values
from spm_pin.formulas.leg_constants import AXES, UP
from spm_pin.formulas.operations import mapped, rows_of, vector_of
from spm_pin.formulas.stage_numbers import relative_slopes
from spm_pin.machine import Configuration, Manipulator
from spm_pin.machine.leg_kinds import drawn_numbers


class _Legs:
    """The six legs of a state, seen from {B}."""

    def __init__(self, machine: Manipulator | Array, state: State | Configuration, **further: Array) -> None:
        self.library = library_of(machine=machine, **state_arrays(state, "state"), **further)
        self.machine = read_machine(self.library, machine)
        pose = rows_of(state.rotation), vector_of(state.translation)
        placeholder = self.library.run(ball_motions.placeholder_state, self.machine.r)
        self.exists = state.exists & self.machine.valid
        # Selected before anything is computed, or derivatives were NaN where nothing exists.
        self.b, self.pose = self.library.select(self.exists, (rows_of(state.middle_joints), pose), placeholder)
        self.zero = self.library.zeros(self.pose[1][0], self.pose[0][0][0], self.b[0][0], self.machine.r)
        self.lower, run = self.machine.stages[0], self.library.run
        self.upper = run(leg_planes.carried, self.machine.stages[1], *self.pose)
        self.c = self.machine.upper_balls(self.library, self.b)
        self.slopes, arms = rods_of(self.library, self.machine, self.pose, self.b)  # κ of each stage
        (self.lower_directions, _), (self.upper_directions, _) = (run(vectors.directions_and_lengths, x) for x in arms)

    def regular(self, stage: Any, *determinants: Any) -> Any:
        """Return balls and six forces, with regular ones where no state exists or a determinant is zero to rounding."""
        run, r, is_regular = self.library.run, self.machine.r, self.exists
        for determinant in determinants:
            is_regular = is_regular & (run(vectors.magnitude, determinant) > self.library.least * r**3)
        return self.library.select(is_regular, stage, (run(leg_constants.drawn_triangle, r), (UP, UP, UP), AXES))

    def rates(self) -> list[Any]:
        """Return κ of the legs, 1 of a leg that is singular."""
        relative = sum(self.machine.of_stages(self.library, relative_slopes, self.slopes), ())
        is_singular = (self.library.run(vectors.magnitude, x) <= self.library.least for x in relative)
        return [self.library.where(x, 1.0, slope) for x, slope in zip(is_singular, sum(self.slopes, ()), strict=True)]


@quietly
def inverse_jacobian(machine: Manipulator | Array, state: State | Configuration) -> Array:
    """Compute J_f (..., 6, 6), which maps the twist (v, ω) at o to the leg rates; arguments as for `leg_forces`.

    At an inverse singularity, such as the level home, or a leg's own singularity, J_f does not exist: the numbers are
    arbitrary and finite.
    """
    legs = _Legs(machine, state)
    library, run = legs.library, legs.library.run
    directions, stage = (legs.lower_directions, legs.upper_directions), (legs.b, legs.upper.axes, legs.lower.axes)
    determinant = run(wrenches.determinant, *stage)
    if legs.machine.is_nominal:
        b, a_m, a = legs.regular(stage, determinant)
        stages = run(wrenches.drawn_inverse_jacobian, b, *directions, a, a_m, legs.pose[1])
    else:
        side = run(ball_motions.structure_side, legs.b, legs.c, legs.lower, legs.upper)
        b, a_m, a = legs.regular(stage, determinant, side)
        c = legs.machine.upper_balls(library, b)
        stages = run(wrenches.inverse_jacobian, b, c, *directions, a, a_m, legs.pose[1])
    rows = [(*force, *moment) for stage in stages for force, moment in stage]
    return library.stacked([tuple(x / s for x in row) for row, s in zip(rows, legs.rates(), strict=True)], legs.zero)


@quietly
def leg_forces(machine: Manipulator | Array, state: State | Configuration, wrench: Array) -> Array:
    """Compute what actuators exert (..., 6) to hold a wrench [N], for RRS legs [N m]; positive increases readings.

    Parameters
    ----------
    machine : Manipulator, array of shape (..., 3) or (..., 54), or pair
        As for `inverse_physical`.
    state : State or Configuration
        Of shape (...).
    wrench : array, shape (..., 6)
        Force [N] and moment [N m] at o in {B}, applied to the platform from outside.
    """
    legs = _Legs(machine, state, wrench=wrench)
    library, zero = legs.library, legs.library.zeros(legs.zero, wrench[..., 0])
    stages = (legs.b, legs.lower_directions, legs.lower.axes), (legs.c, legs.upper_directions, legs.upper.axes)
    stage = library.together(stages, zero)
    stage = legs.regular(stage, library.run(wrenches.determinant, *stage))
    twists = library.run(wrenches.stage_twists, *stage, legs.pose[1])
    forces = library.run(wrenches.stage_forces, twists, (vector_of(wrench[..., :3]), vector_of(wrench[..., 3:])))
    along = [x[i, ...] for i in range(2) for x in forces]
    return library.stacked([x * slope for x, slope in zip(along, sum(legs.slopes, ()), strict=True)], zero)


@quietly
def joint_values(machine: Manipulator | Array, state: State | Configuration) -> Array:
    """Compute the values of the eighteen joints of the URDF, shape (..., 18), in the order of its tree.

    For RPS legs the names are `JOINTS`, for others `spm_pin.machine.joint_angles.joint_names`.

    Angles in radians, slides in metres: with these a simulator of the open tree is reset to a closed state. Leg limits
    decide where the joints are at zero; dimensions and parameters have none. Arguments are as for `leg_forces`.
    """
    legs = _Legs(machine, state)
    library, arrays, run = legs.library, legs.machine, legs.library.run
    triangle, columns = run(values.triangle_axes, legs.b), run(vectors.transposed, legs.pose[0])
    own = run(values.triangle_axes, legs.lower.balls)
    upper_balls = run(ball_motions.points_from_platform, legs.c, *legs.pose)
    named, seen = {}, tuple(run(vectors.times, columns, axis) for axis in triangle)
    stages = zip(arrays.kinds, arrays.radii, arrays.stages, (legs.b, upper_balls), (triangle, seen), strict=True)
    for k, (kind, radius, stage, balls, axes) in enumerate(stages):
        names, up, formulas = (("b1", "b2", "b3"), ("c1", "c2", "c3"))[k], 1.0 - 2.0 * k, library.formulas(kind)
        low, high = (ends[3 * k : 3 * k + 3] for ends in arrays.limits)
        drawn = drawn_numbers(stage.numbers, len(kind.identified))
        constants = stage, own, (radius, arrays.r), (max(low), min(high)), drawn, up, formulas
        frames = library.together(run(values.stage_frames, *constants), legs.zero)
        of_legs = run(values.leg_values, library.together(balls, legs.zero), frames, formulas)
        first = mapped(lambda x: x[0, ...], (of_legs, frames))
        for x, (sine, cosine) in zip("xyz", run(values.ball_angles, *first, axes, up), strict=True):
            named[f"ball_{names[0]}_{x}"] = library.xp.atan2(sine, cosine)
        passive = library.xp.atan2(*of_legs.passive)
        for i, leg in enumerate(names):
            named |= {
                f"leg_{leg}_{kind.passive}": passive[i, ...],
                f"leg_{leg}_{kind.actuated}": of_legs.actuated[i, ...],
            }
    return library.stacked([named[name] for name in arrays.joint_names], legs.zero)


@quietly
def singularity_distance(machine: Manipulator | Array, state: State | Configuration) -> Array:
    """Compute the smallest singular values of J_b, J_c and K, shape (..., 3).

    Dimensionless, and zero at a forward singularity of the lower or of the upper stage, or at an inverse one; see
    `spm_pin.kinematics.Singularities.sigma`. Arguments are as for `leg_forces`.
    """
    legs = _Legs(machine, state)
    run, side = legs.library.run, legs.machine.r * 3.0**0.5
    centre = run(wrenches.mean, legs.b)
    lower, upper = (run(wrenches.arms, b, centre, side) for b in (legs.b, legs.c))

    def rows(forces: Any, arms: Any) -> Any:
        return run(wrenches.force_rows, forces, arms, (0.0, 0.0, 0.0))

    a, a_m = rows(legs.lower.axes, lower), rows(legs.upper.axes, upper)
    matrices = (rows(legs.lower_directions, lower), a), (rows(legs.upper_directions, upper), a_m), (a, a_m)
    stacked = legs.library.stacked(matrices, legs.zero)
    return legs.library.xp.linalg.svdvals(legs.library.xp.reshape(stacked, (*legs.zero.shape, 3, 6, 6)))[..., -1]
