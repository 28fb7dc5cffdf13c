"""Inverse and forward displacement on arrays.

Solutions are computed without derivatives. Then two steps of Newton's method are taken from them whose matrix is held
constant and of which only the derivatives are kept: by the implicit function theorem these are the derivatives of the
solutions, the first ones after one step, the second ones after two.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from spm_pin.arrays.library import Array, Library, Machine, library_of, quietly, read_machine, state_arrays
from spm_pin.errors import ArgumentError
from spm_pin.formulas import ball_motions, branches, joint_values, leg_constants, leg_planes, vectors
from spm_pin.formulas.ball_motions import BallMotions
from spm_pin.formulas.leg_constants import AXES, UP, drawn_triangle
from spm_pin.formulas.operations import bind, mapped, rows_of, vector_of
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.branch_of_state import FAMILIES

_NEWTON_STEPS = 16
_LONGEST_STEP = 0.4
"""Longest displacement of a ball in a step of Newton's method, in units of r."""
_CLOSED = 2000.0
"""Largest error of a solution, in roundings of the lengths in it."""
_APART = (0.0, 1e-3, 1e-1)
"""Discriminants, in units of r², at least as large as which those of the drawing are taken for starts: beside its folds
a machine as built has branches elsewhere, or where the drawing has none."""
_ORDERS = 2
"""Orders of derivatives."""
_LEVEL = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), UP
_REGULAR = bind(drawn_triangle, sqrt=math.sqrt)(1.0)
_REGULAR_MOTIONS = bind(ball_motions.ball_motions, sqrt=math.sqrt)(_REGULAR, (UP, UP, UP), AXES)
"""Any balls and their motions: they take the place of those that do not exist, so that all numbers are finite."""


class Branches(NamedTuple):
    """The eight branches of poses (...), in the order of `spm_pin.mechanism.BRANCHES`."""

    middle_joints: Array
    """b_i in {B} [m], shape (..., 8, 3, 3)."""
    leg_lengths: Array
    """[m], shape (..., 8, 6)."""
    exists: Array
    """Which branches are real, shape (..., 8). The numbers of the others are finite and mean nothing."""


class State(NamedTuple):
    """States (...) of a machine."""

    rotation: Array
    """From {m} to {B}, shape (..., 3, 3)."""
    translation: Array
    """o in {B} [m], shape (..., 3)."""
    middle_joints: Array
    """b_i in {B} [m], shape (..., 3, 3)."""
    readings: Array
    """Readings of the encoders [m], shape (..., 6): leg lengths of a drawn machine."""
    exists: Array
    """Where there is such a state, shape (...). Elsewhere all is finite, and all derivatives with it."""


@quietly
def inverse_displacement(geometry: Geometry | Array, rotation: Array, translation: Array) -> Branches:
    """Compute all branches of the inverse displacement of a drawn machine, in closed form.

    Parameters
    ----------
    geometry : Geometry or array, shape (..., 3)
        A drawn machine, or dimensions E, C, d [m].
    rotation : array, shape (..., 3, 3)
        From {m} to {B}. It is not checked.
    translation : array, shape (..., 3)
        o in {B} [m].
    """
    problem = _Inverse(geometry, rotation, translation)
    library = problem.library
    if not problem.machine.is_drawn:
        cause = "Its eight roots have no closed form: inverse_physical takes it. Pass dimensions E, C, d of a drawn one"
        raise ArgumentError("geometry", "a machine as drawn", "one as built, as 54 parameters always count", cause)
    b, exists = problem.drawn_branches(range(len(FAMILIES)), 0.0)
    b = problem.with_derivatives(b, exists)
    zero, lengths = library.zeros(b[0][0]), _readings(library, problem.machine, problem.legs, b)
    arrays = library.stacked(b, zero), library.stacked(lengths, zero), exists
    return Branches(*(library.xp.moveaxis(x, 0, problem.zero.ndim) for x in arrays))


@quietly
def inverse_physical(
    geometry: Geometry | Array, rotation: Array, translation: Array, near: State | None = None
) -> State:
    """Compute the physical branch of the inverse displacement, or the branch beside a state, of any machine.

    Parameters
    ----------
    geometry : Geometry or array, shape (..., 3) or (..., 54)
        A machine, its dimensions E, C, d [m], or the parameters of its legs, see `spm_pin.Geometry.parameters`.
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
    problem = _Inverse(geometry, rotation, translation, near)
    if near is not None:
        start = problem.library.constant(rows_of(near.middle_joints))
        b, exists = problem.closed(start)
        before = _Inverse(geometry, near.rotation, near.translation, near)
        exists = exists & (problem.side(b) * before.side(start) > 0.0) & near.exists
    elif problem.machine.is_drawn:
        b, exists = problem.preferred(*problem.drawn_branches([0], 0.0))
    else:
        starts = [problem.drawn_branches([0], least)[0] for least in _APART]
        starts = mapped(lambda *parts: problem.library.xp.concat(parts), *starts)
        b, exists = problem.preferred(*problem.closed(starts))
    b = problem.with_derivatives(b, exists)
    library = problem.library
    values = *problem.pose, b, _readings(library, problem.machine, problem.legs, b)
    return State._make([*(library.stacked(x, problem.zero) for x in values), exists])


@quietly
def forward_physical(geometry: Geometry | Array, readings: Array, near: State | None = None) -> State:
    """Compute the physical state with these readings, or the state beside another, of any machine.

    Parameters
    ----------
    geometry : Geometry or array, shape (..., 3) or (..., 54)
        As for `inverse_physical`.
    readings : array, shape (..., 6)
        Readings of the encoders [m]: leg lengths of a drawn machine.
    near : State, optional
        From where Newton's method begins: the state to which it leads, if both stages keep the signs of their
        determinants. No proof is given that it has not left the assembly mode where the state is far away.

    Returns
    -------
    State
        Without `near` that of `spm_pin.forward_physical`.
    """
    library = library_of(geometry=geometry, readings=readings, **state_arrays(near, "near"))
    machine, run = read_machine(library, geometry), library.run
    shown, valid = library.checked(tuple(readings[..., i] for i in range(6)), machine.farthest, (machine.r,) * 6)
    lengths = [x - offset for x, offset in zip(shown, machine.offsets, strict=True)]
    zero = library.zeros(*lengths, machine.r, *([] if near is None else [near.translation[..., 0]]))
    halves = tuple(lengths[:3]), tuple(lengths[3:])
    # Both stages are solved together, each seen from its own platform.
    both = library.together(list(zip(machine.legs, halves, machine.squares, strict=True)), zero)
    legs, lengths, _ = fixed = library.constant(both)
    r = library.constant(machine.r)
    if near is None:
        stages = zip(halves, machine.radii, (1.0, -1.0), strict=True)
        starts = [run(ball_motions.level_balls, half, radius, machine.r, up) for half, radius, up in stages]
    else:
        b, pose = rows_of(near.middle_joints), (rows_of(near.rotation), vector_of(near.translation))
        starts = [b, run(ball_motions.points_from_platform, machine.upper_balls(library, b), *pose)]
    start = library.constant(library.together(starts, zero))

    def step(b: Any) -> Any:
        return run(ball_motions.moved_balls, b, run(ball_motions.stage_step, b, *fixed), _LONGEST_STEP * r)

    b = library.repeated(step, start, _NEWTON_STEPS)
    error = run(ball_motions.largest_error, run(ball_motions.stage_errors, b, *fixed), r)
    exists = error <= _CLOSED * library.eps * (r + run(vectors.largest, lengths))
    exists = exists & (run(vectors.least, lengths) > 0.0)
    if near is not None:
        sides = [run(ball_motions.stage_side, x, legs) for x in (b, start)]
        exists = exists & (sides[0] * sides[1] > 0.0)
    f, _ = run(ball_motions.leg_vectors, b, legs.pivots)
    motions = run(ball_motions.ball_motions, b, f, legs.axes)

    def correction(b: Any, motions: BallMotions) -> Any:
        return run(ball_motions.velocities, motions, run(ball_motions.stage_errors, b, *both))

    b = _with_derivatives(library, b, exists, motions, correction)
    # The middle platform seen from {B} and from {m}.
    own = library.together(machine.balls, zero)
    axes, own_axes = run(joint_values.triangle_axes, b), run(joint_values.triangle_axes, own)
    turns, places = run(ball_motions.frame_of_triangle, axes, own_axes, b, own)
    first, second = (mapped(lambda x, i=i: x[i, ...], (turns, places)) for i in range(2))
    pose = run(ball_motions.pose_of_frames, *first, *second)
    exists, joints = exists[0, ...] & exists[1, ...] & valid & machine.valid, mapped(lambda x: x[0, ...], b)
    if near is None:
        exists = exists & _physical(library, *library.constant((machine, pose, joints)))[0]
    else:
        exists = exists & near.exists
    return State._make([*(library.stacked(x, zero) for x in (*pose, joints, shown)), exists])


class _Inverse:
    """The six planes of poses, which hold the middle platform."""

    def __init__(self, geometry: Any, rotation: Array, translation: Array, near: State | None = None) -> None:
        given = state_arrays(near, "near")
        self.library = library_of(geometry=geometry, rotation=rotation, translation=translation, **given)
        self.machine = read_machine(self.library, geometry)
        turn, is_turn = self.library.checked(rows_of(rotation), 2.0, _LEVEL)
        place, is_near = self.library.checked(vector_of(translation), 2.0 * self.machine.farthest, UP)
        self.pose, self.valid = (turn, place), is_turn & is_near & self.machine.valid
        beside = [] if near is None else [near.middle_joints[..., 0, 0]]
        self.zero = self.library.zeros(self.pose[0][0][0], self.pose[1][0], self.machine.r, *beside)
        self.legs = self.machine.legs[0], self.library.run(leg_planes.carried, self.machine.legs[1], *self.pose)
        # The same, without derivatives.
        self._machine, self._pose, self._legs = self.library.constant((self.machine, self.pose, self.legs))

    def drawn_branches(self, families: Any, least: float) -> tuple[Any, Any]:
        """Return the balls (2 n, ...) of the branches + and - of families, and which are real.

        They are those of the drawing, and as if the discriminants were at least `least` times r².
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
        """Return where Newton's method leads from balls, and whether that is a solution."""
        library, run, (lower, upper), machine = self.library, self.library.run, self._legs, self._machine
        planes, longest = (lower, upper, machine.weights, machine.squares[0]), _LONGEST_STEP * machine.r

        def step(b: Any) -> Any:
            return run(ball_motions.moved_balls, b, run(ball_motions.structure_step, b, *planes), longest)

        b = library.repeated(step, mapped(lambda x: x + self.zero, start), _NEWTON_STEPS)
        c = machine.upper_balls(library, b)
        errors = run(ball_motions.structure_errors, b, c, lower, upper, machine.squares[0])
        scale = machine.r + run(vectors.larger, run(vectors.largest, self._pose[1]), machine.r)
        return b, (run(ball_motions.largest_error, errors, machine.r) <= _CLOSED * library.eps * scale) & self.valid

    def side(self, b: Any) -> Any:
        """Return det K."""
        return self.library.run(ball_motions.structure_side, b, self._machine.upper_balls(self.library, b), *self._legs)

    def preferred(self, b: Any, closed: Any) -> tuple[Any, Any]:
        """Return of balls (k, ...) those that are physical, within the limits and straightest, in this order."""
        library, machine = self.library, self._machine
        physical, tilts = _physical(library, machine, self._pose, b)
        inside = []
        for reading, *limits in zip(_readings(library, machine, self._legs, b), *machine.limits, strict=True):
            low, high = library.run(leg_constants.admitted_readings, *limits)
            inside.append((low <= reading) & (reading <= high))
        inside = functools.reduce(operator.and_, inside)
        rank = library.where(physical & closed, library.where(inside, 2.0, 1.0) + tilts * 0.0, 0.0)
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
            c, squares = self.machine.upper_balls(library, b), self.machine.squares[0]
            errors = run(ball_motions.structure_errors, b, c, *self.legs, squares)
            if machine.is_drawn:
                return run(ball_motions.velocities, motions, errors)
            return run(ball_motions.structure_velocities, motions, errors, upper.axes, machine.weights)

        return _with_derivatives(library, b, exists, motions, correction)


def _with_derivatives(
    library: Library, b: Any, exists: Any, motions: BallMotions, correction: Callable[[Any, BallMotions], Any]
) -> Any:
    """Return balls with the derivatives of the solution that they are; any finite ones where they are none.

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


def _physical(library: Library, machine: Machine, pose: Any, b: Any) -> tuple[Any, Any]:
    lower, upper = machine.legs[0], library.run(leg_planes.carried, machine.legs[1], *pose)
    c = machine.upper_balls(library, b)
    legs = library.run(vectors.differences, b, lower.pivots), library.run(vectors.differences, upper.pivots, c)
    physical = library.run(branches.is_physical, b, c, *legs, lower.axes, upper.axes, *pose)
    return physical, library.run(branches.tilt_cosine_sum, b, pose[0])


def _readings(library: Library, machine: Machine, legs: Any, b: Any) -> list[Any]:
    _, lower = library.run(ball_motions.leg_vectors, b, legs[0].pivots)
    _, upper = library.run(ball_motions.leg_vectors, machine.upper_balls(library, b), legs[1].pivots)
    return [length + offset for length, offset in zip((*lower, *upper), machine.offsets, strict=True)]
