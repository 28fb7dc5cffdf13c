"""Inverse and forward displacement on arrays.

Solutions are computed without derivatives. Then two steps of Newton's method are taken from them whose matrix is held
constant and of which only the derivatives are kept: by the implicit function theorem these are the derivatives of the
solutions, the first ones after one step, the second ones after two.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from array_api_compat import is_array_api_obj

from spm_pin.arrays.library import (
    Array,
    Library,
    MachineOnArrays,
    library_of,
    quietly,
    read_machine,
    state_arrays,
)
from spm_pin.errors import ArgumentError
from spm_pin.formulas import (
    ball_motions,
    branches,
    circles,
    joint_values,
    leg_constants,
    leg_planes,
    stage_poses,
    vectors,
    wrenches,
)
from spm_pin.formulas.ball_motions import BallMotions
from spm_pin.formulas.circles import Circles
from spm_pin.formulas.leg_constants import AXES, UP, drawn_triangle
from spm_pin.formulas.operations import bind, mapped, rows_of, vector_of
from spm_pin.formulas.stage_numbers import circles_of_readings, readings_of_balls, relative_slopes, rods_at
from spm_pin.machine import Manipulator, Stage
from spm_pin.machine.branch_of_state import FAMILIES
from spm_pin.support.arguments import check_instance

_NEWTON_STEPS = 16
_LONGEST_STEP = 0.4
"""Longest displacement of a ball in a step of Newton's method, in units of r."""
_CLOSED = 2000.0
"""Largest error of a solution, in roundings of the lengths in it."""
_APART = (0.0, 1e-3, 1e-1)
"""Least discriminants, in units of r², for which nominal branches are computed as starts: beside their folds
those of a calibrated machine are elsewhere, or exist where no nominal ones do."""
_TURNED = 1e5
"""Least 1 + z of a normal over eps: the torsion is right to about the inverse of it."""
_ORDERS = 2
"""Orders of derivatives."""
_LEVEL = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), UP
_REGULAR = bind(drawn_triangle, sqrt=math.sqrt)(1.0)
_REGULAR_MOTIONS = bind(ball_motions.ball_motions, sqrt=math.sqrt)(_REGULAR, (UP, UP, UP), AXES)
"""Regular balls and their motions: they take the place of what does not exist, so that all numbers are finite."""


class Branches(NamedTuple):
    """The eight branches of poses (...), in the order of `spm_pin.machine.BRANCHES`; an index is one of the poses."""

    middle_joints: Array
    """b_i in {B} [m], shape (..., 8, 3, 3)."""
    readings: Array
    """Readings of the encoders, shape (..., 8, 6): [m], for RRS legs [rad]."""
    exists: Array
    """True for branches that are real and in reach, shape (..., 8); numbers of the others are arbitrary and finite."""

    def __getitem__(self, index: Any) -> Branches:
        """Index the batch axes of all fields."""
        return Branches._make(_indexed(self, (3, 2, 1), index))


class State(NamedTuple):
    """States (...) of a machine, with fields to be read by name; an index selects members of the batch, `state[k]`.

    To JAX and PyTorch it is a named tuple of its fields, in this order.
    """

    rotation: Array
    """Rotation from {m}, or from the platform of a stage, to {B}, shape (..., 3, 3)."""
    translation: Array
    """The platform's origin o in {B} [m], shape (..., 3)."""
    middle_joints: Array
    """b_i in {B} [m], for a stage its balls, shape (..., 3, 3)."""
    readings: Array
    """Readings of the encoders, shape (..., 6), for a stage (..., 3): [m], for RRS legs [rad]."""
    exists: Array
    """True where the state exists, shape (...). Elsewhere numbers and all derivatives are arbitrary and finite."""

    def __getitem__(self, index: Any) -> Any:
        """Index the batch, all fields alike."""
        return State._make(_indexed(self, (2, 1, 2, 1, 0), index))


def _indexed(fields: Iterable[Array], inner: tuple[int, ...], index: Any) -> list[Array]:
    """Index the batch axes of arrays that have these numbers of inner axes."""
    batch = index if isinstance(index, tuple) else (index,)
    batch = batch if any(part is Ellipsis for part in batch) else (*batch, Ellipsis)
    return [x[(*batch, *(slice(None),) * n)] for x, n in zip(fields, inner, strict=True)]


@quietly
def inverse_displacement(machine: Manipulator | Array, rotation: Array, translation: Array) -> Branches:
    """Compute all branches of the inverse displacement of a nominal machine, in closed form.

    Parameters
    ----------
    machine : Manipulator or array, shape (..., 3)
        A nominal machine, or dimensions E, C, d [m].
    rotation : array, shape (..., 3, 3)
        Rotation from {m} to {B}. It is not checked.
    translation : array, shape (..., 3)
        o in {B} [m].
    """
    problem = _Inverse(machine, rotation, translation)
    library = problem.library
    if not problem.machine.is_nominal:
        cause = "Its eight roots have no closed form: use inverse_physical, or dimensions E, C, d of a nominal machine"
        raise ArgumentError("machine", "a nominal machine", "a calibrated one, as parameters always are", cause)
    b, exists = problem.nominal_branches(range(len(FAMILIES)), 0.0)
    b = problem.with_derivatives(b, exists)
    zero, (readings, reach) = library.zeros(b[0][0]), _readings(library, problem.machine, problem.pose, b)
    arrays = library.stacked(b, zero), library.stacked(readings, zero), exists & (reach >= 0.0)
    return Branches(*(library.xp.moveaxis(x, 0, problem.zero.ndim) for x in arrays))


@quietly
def inverse_physical(
    machine: Manipulator | Array, rotation: Array, translation: Array, near: State | None = None
) -> State:
    """Compute the physical branch of the inverse displacement, or the branch beside a state, of any machine.

    Parameters
    ----------
    machine : Manipulator, array of shape (..., 3) or (..., 54), or pair
        A machine; dimensions E, C, d [m] of a nominal one with RPS legs, or the parameters of RPS legs, see
        `spm_pin.Manipulator.parameters`; or a pair of a `Manipulator` and of parameters (..., n): its kinds of legs,
        working modes and leg limits, and other numbers.
    rotation, translation
        As for `inverse_displacement`.
    near : State, optional
        From where Newton's method begins: the branch to which it leads, if it is on the same side of the inverse
        singularities. No proof is given that it has not left the branch where the state is far away.

    Returns
    -------
    State
        Without `near` that of `spm_pin.inverse_physical`, but for one state in some thousands of a machine with errors
        of 1e-3 m and rad, one in a hundred with 1e-2. Of parameters no leg limits are known.
    """
    problem = _Inverse(machine, rotation, translation, near)
    if near is not None:
        start = problem.library.constant(rows_of(near.middle_joints))
        b, exists = problem.closed(start)
        before = _Inverse(machine, near.rotation, near.translation, near)
        exists = exists & (problem.side(b) * before.side(start) > 0.0) & near.exists
    elif problem.machine.is_nominal:
        b, exists = problem.preferred(*problem.nominal_branches([0], 0.0))
    else:
        starts = [problem.nominal_branches([0], least)[0] for least in _APART]
        starts = mapped(lambda *parts: problem.library.xp.concat(parts), *starts)
        b, exists = problem.preferred(*problem.closed(starts))
    b = problem.with_derivatives(b, exists)
    library = problem.library
    readings, reach = _readings(library, problem.machine, problem.pose, b)
    values = *problem.pose, b, readings
    return State._make([*(library.stacked(x, problem.zero) for x in values), exists & (reach >= 0.0)])


@quietly
def forward_physical(machine: Manipulator | Stage | Array, readings: Array, near: State | None = None) -> State:
    """Compute the physical state with these readings, or the state beside another, of any machine.

    Parameters
    ----------
    machine : Manipulator, Stage, array of shape (..., 3) or (..., 54), or pair
        A stage, nominal or calibrated, or as for `inverse_physical`.
    readings : array, shape (..., 6); for a stage (..., 3)
        Readings of the encoders [m], for RRS legs [rad].
    near : State, optional
        From where Newton's method begins: the state to which it leads, if all stages keep the signs of their
        determinants, and all legs are in their working modes. No proof is given that it has not left the assembly mode
        where the state is far away.

    Returns
    -------
    State
        Without `near` that of `spm_pin.forward_physical`, but for states to which Newton's method from the level
        stages does not lead: these do not exist here.

    Notes
    -----
    Without `near` such states are one in 500 strongly tilted ones of manipulators with PRS and RRS legs. Of random
    states of a stage tilted by up to 75° they are up to 6 in 100,000 for seven stages of usual proportions, and none
    below 50° but for slides that are level; for PRS and RRS stages of random proportions 0.3 to 6 in 100, and up to 6
    in 1,000 of those below 30°. Give `near` there.
    """
    is_stage = isinstance(machine, Stage)
    legs = 3 if is_stage else 6
    library = library_of(legs=legs, machine=machine, readings=readings, **state_arrays(near, "near", legs))
    numbers, run = read_machine(library, machine), library.run
    shown, own, valid = numbers.checked_readings(library, readings)
    zero = library.zeros(*sum(own, ()), numbers.r, *([] if near is None else [near.translation[..., 0]]))
    # All stages are solved together, each seen from its own plate.
    stages = numbers.of_stages(library, circles_of_readings, own)
    if near is None:
        starts = [run(circles.level_balls, x, s.balls, s.up) for x, s in zip(stages, numbers.stages, strict=True)]
    else:
        pose = rows_of(near.rotation), vector_of(near.translation)
        starts = _own_balls(library, numbers, pose, rows_of(near.middle_joints))
    b, turns, places, exists = _solved_stages(library, numbers, stages, starts, zero, is_near=near is not None)
    balls = [mapped(lambda x, k=k: x[k, ...], b) for k in range(len(stages))]
    slopes = [slopes for slopes, _ in numbers.of_stages(library, rods_at, balls, own)]
    relative = sum(numbers.of_stages(library, relative_slopes, slopes), ())
    exists = functools.reduce(operator.and_, (slope > 0.0 for slope in relative), exists & valid & numbers.valid)
    pose, *upper = (mapped(lambda x, k=k: x[k, ...], (turns, places)) for k in range(len(stages)))
    if upper:
        # The middle platform seen from {B} and from {m}.
        pose = run(ball_motions.pose_of_frames, *pose, *upper[0])
    exists = exists if near is None else exists & near.exists
    return State._make([*(library.stacked(x, zero) for x in (*pose, balls[0], sum(shown, ()))), exists])


def _solved_stages(
    library: Library, machine: MachineOnArrays, stages: list[Circles], starts: list[Any], zero: Array, *, is_near: bool
) -> tuple[Any, Any, Any, Any]:
    """Return the balls of stages on circles, with derivatives, their platforms' frames, and whether all are solutions.

    Balls and frames have a first axis that counts the stages. Newton's method begins from balls; if `is_near`, a
    solution is on their side of the forward singularities, otherwise in the home assembly region.
    """
    run, both = library.run, library.together(stages, zero)
    stage, r = library.constant(both), library.constant(machine.r)
    start = run(circles.directions_to, stage, library.constant(library.together(starts, zero)))

    def step(e: Any) -> Any:
        return run(circles.turned_back, stage, e, run(circles.limited, run(circles.newton_step, stage, e)))

    e = library.repeated(step, start, _NEWTON_STEPS)
    b, lengths = run(circles.balls_at, stage, e), stage.radii
    error = run(vectors.largest, run(circles.errors, stage, b)) / r
    exists = error <= _CLOSED * library.eps * (r + run(vectors.largest, lengths))
    exists = exists & (run(vectors.least, lengths) > 0.0)
    if is_near:
        before = run(circles.balls_at, stage, start)
        sides = [run(wrenches.determinant, *x, stage.axes) for x in ((b, e), (before, start))]
        exists = exists & (sides[0] * sides[1] > 0.0)
    else:
        up = library.together([own.up for own in machine.stages], zero)
        exists = exists & run(circles.is_home_state, b, stage.centres, stage.axes, up)
    motions = run(ball_motions.ball_motions, b, e, stage.axes)

    def correction(b: Any, motions: BallMotions) -> Any:
        return run(ball_motions.velocities, motions, run(ball_motions.stage_errors, b, both))

    b = _with_derivatives(library, b, exists, motions, correction)
    own = library.together([own.balls for own in machine.stages], zero)
    axes, own_axes = run(joint_values.triangle_axes, b), run(joint_values.triangle_axes, own)
    turns, places = run(ball_motions.frame_of_triangle, axes, own_axes, b, own)
    return b, turns, places, library.xp.all(exists, axis=0)


@quietly
def stage_inverse(stage: Stage, normal: Array, height: Array) -> State:
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
    State
        Mode T of `spm_pin.inverse_displacement`; whether it is in the home assembly region is not tested.
    """
    library = library_of(normal=normal, height=height[..., None] if is_array_api_obj(height) else height)
    machine, run = read_machine(library, check_instance(stage, Stage, "stage")), library.run
    (own,), least_rise = machine.stages, max(stage_poses.LEAST_RISE, _TURNED * library.eps)
    height, is_height = library.checked(height, 2.0 * machine.farthest, machine.r)
    constants = run(stage_poses.stage_constants, own.axes, own.pivots, own.balls)
    *pose, b, exists = run(stage_poses.pose_of_tilt, vector_of(normal), least_rise, height, constants)
    ((readings, reaches),) = machine.of_stages(library, readings_of_balls, [b])
    exists = functools.reduce(operator.and_, (reach >= 0.0 for reach in reaches), exists & is_height)
    readings = [x + offset for x, offset in zip(readings, own.offsets, strict=True)]
    zero = library.zeros(readings[0])
    return State._make([*(library.stacked(x, zero) for x in (*pose, b, readings)), exists])


class _Inverse:
    """The six planes of poses, which hold the middle platform."""

    def __init__(self, machine: Any, rotation: Array, translation: Array, near: State | None = None) -> None:
        given = state_arrays(near, "near")
        self.library = library_of(machine=machine, rotation=rotation, translation=translation, **given)
        self.machine = read_machine(self.library, machine)
        turn, is_turn = self.library.checked(rows_of(rotation), 2.0, _LEVEL)
        place, is_near = self.library.checked(vector_of(translation), 2.0 * self.machine.farthest, UP)
        self.pose, self.valid = (turn, place), is_turn & is_near & self.machine.valid
        beside = [] if near is None else [near.middle_joints[..., 0, 0]]
        self.zero = self.library.zeros(self.pose[0][0][0], self.pose[1][0], self.machine.r, *beside)
        self.legs = self.machine.stages[0], self.library.run(leg_planes.carried, self.machine.stages[1], *self.pose)
        # The same, without derivatives.
        self._machine, self._pose, self._legs = self.library.constant((self.machine, self.pose, self.legs))

    def nominal_branches(self, families: Any, least: float) -> tuple[Any, Any]:
        """Return the balls (2 n, ...) of the branches + and - of families of the nominal machine, and which are real.

        A discriminant below `least` times r² is taken for that.
        """
        library, run, r = self.library, self.library.run, self._machine.r
        frame = run(branches.pose_frame, *self._pose, r)
        forms = run(branches.families, frame, r)
        form = library.together([forms[k] for k in families for _ in range(2)], self.zero)
        sign = library.together([1.0, -1.0] * len(families), self.zero)
        b = run(branches.branch_balls, form, sign, frame, self._pose[1], r, least * r * r)
        is_real = run(branches.discriminant, form) >= 0.0
        is_real = is_real & ~run(branches.is_continuous, form, frame.noise) & ~frame.is_vertical
        return b, is_real & self.valid

    def closed(self, start: Any) -> tuple[Any, Any]:
        """Return the balls to which Newton's method leads from others, and where they are a solution."""
        library, run, (lower, upper), machine = self.library, self.library.run, self._legs, self._machine
        planes, longest = (lower, upper, machine.weights, machine.stages[0].squares), _LONGEST_STEP * machine.r

        def step(b: Any) -> Any:
            return run(ball_motions.moved_balls, b, run(ball_motions.structure_step, b, *planes), longest)

        b = library.repeated(step, mapped(lambda x: x + self.zero, start), _NEWTON_STEPS)
        c = machine.upper_balls(library, b)
        errors = run(ball_motions.structure_errors, b, c, lower, upper, machine.stages[0].squares)
        scale = machine.r + run(vectors.larger, run(vectors.largest, self._pose[1]), machine.r)
        return b, (run(ball_motions.largest_error, errors, machine.r) <= _CLOSED * library.eps * scale) & self.valid

    def side(self, b: Any) -> Any:
        """Return det K."""
        return self.library.run(ball_motions.structure_side, b, self._machine.upper_balls(self.library, b), *self._legs)

    def preferred(self, b: Any, closed: Any) -> tuple[Any, Any]:
        """Return the best of balls (k, ...): physical, within the limits, straightest; and where it is physical."""
        library, machine = self.library, self._machine
        physical, tilts = _physical(library, machine, self._pose, b)
        inside = []
        readings, reach = _readings(library, machine, self._pose, b)
        for reading, *limits in zip(readings, *machine.limits, strict=True):
            low, high = library.run(leg_constants.admitted_readings, *limits)
            inside.append((low <= reading) & (reading <= high))
        inside = functools.reduce(operator.and_, inside)
        rank = library.where(physical & closed & (reach >= 0.0), library.where(inside, 2.0, 1.0) + tilts * 0.0, 0.0)
        best = mapped(lambda x: x[0, ...], (b, rank, tilts))
        for k in range(1, rank.shape[0]):
            other = mapped(lambda x, k=k: x[k, ...], (b, rank, tilts))
            best = library.select(library.run(branches.is_other_preferred, *best[1:], *other[1:]), other, best)
        return best[0], best[1] > 0.0

    def with_derivatives(self, b: Any, exists: Any) -> Any:
        """Return balls with their derivatives by the pose and the machine."""
        library, run, (lower, upper), machine = self.library, self.library.run, self._legs, self._machine
        motions = run(ball_motions.ball_motions, b, upper.axes, lower.axes)

        def correction(b: Any, motions: BallMotions) -> Any:
            c, squares = self.machine.upper_balls(library, b), self.machine.stages[0].squares
            errors = run(ball_motions.structure_errors, b, c, *self.legs, squares)
            if machine.is_nominal:
                return run(ball_motions.velocities, motions, errors)
            return run(ball_motions.structure_velocities, motions, errors, upper.axes, machine.weights)

        return _with_derivatives(library, b, exists, motions, correction)


def _with_derivatives(
    library: Library, b: Any, exists: Any, motions: BallMotions, correction: Callable[[Any, BallMotions], Any]
) -> Any:
    """Return balls with the derivatives of the solution; missing ones get arbitrary finite derivatives.

    `correction` is Newton's step with these motions, which are constants.
    """
    b = library.select(exists, b, _REGULAR)
    if not library.has_derivatives:
        return b
    is_regular = exists & library.xp.isfinite(sum(sum(column) for column in motions.columns))
    motions = library.select(is_regular, motions, _REGULAR_MOTIONS)

    def corrected(b: Any) -> Any:
        step = mapped(lambda x: library.where(is_regular, x - library.constant(x), 0.0), correction(b, motions))
        return mapped(lambda x, y: x - y, b, step)

    return library.repeated(corrected, b, _ORDERS)


def _physical(library: Library, machine: MachineOnArrays, pose: Any, b: Any) -> tuple[Any, Any]:
    balls = _own_balls(library, machine, pose, b)
    readings = [own for own, _ in machine.of_stages(library, readings_of_balls, balls)]
    stages = zip(balls, machine.of_stages(library, circles_of_readings, readings), machine.stages, strict=True)
    lower, upper = (library.run(circles.is_home_state, x, own.centres, own.axes, s.up) for x, own, s in stages)
    return lower & upper, library.run(branches.tilt_cosine_sum, b, pose[0])


def _readings(library: Library, machine: MachineOnArrays, pose: Any, b: Any) -> tuple[list[Any], Any]:
    """Return the readings of balls, and a number that is negative where one is out of reach of its leg."""
    solved = machine.of_stages(library, readings_of_balls, _own_balls(library, machine, pose, b))
    lack = functools.reduce(functools.partial(library.run, vectors.larger), (-x for _, own in solved for x in own))
    stages = zip(solved, machine.stages, strict=True)
    return [x + y for (own, _), stage in stages for x, y in zip(own, stage.offsets, strict=True)], -lack


def rods_of(library: Library, machine: MachineOnArrays, pose: Any, b: Any) -> tuple[list[Any], tuple[Any, Any]]:
    """Return κ of both stages of a manipulator at balls b_i in {B} and a pose, and vectors along the legs in {B}.

    The vectors are those from the circles' centres to lower balls, and from upper balls to the circles' centres.
    """
    balls = _own_balls(library, machine, pose, b)
    readings = [own for own, _ in machine.of_stages(library, readings_of_balls, balls)]
    slopes, (lower, upper) = zip(*machine.of_stages(library, rods_at, balls, readings), strict=True)
    return list(slopes), (lower, mapped(lambda x: -x, library.run(vectors.turned, pose[0], upper)))


def _own_balls(library: Library, machine: MachineOnArrays, pose: Any, b: Any) -> list[Any]:
    """Return the lower balls in {B} and the upper ones in {m}; the former alone for a stage."""
    if len(machine.stages) == 1:
        return [b]
    return [b, library.run(ball_motions.points_from_platform, machine.upper_balls(library, b), *pose)]
