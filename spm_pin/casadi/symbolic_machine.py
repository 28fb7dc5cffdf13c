"""A machine in CasADi: its drawing and its six legs as numbers or symbols, and the equations that hold it together.

A ball lies in the plane of its leg, normal to the leg's revolute axis: on a circle where the reading is known, else
with two coordinates, x and z of `planar_legs`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import fields
from typing import Any, Literal

import casadi as ca
import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.formulas import (
    ball_motions,
    branches,
    circles,
    joint_values,
    leg_constants,
    leg_planes,
    planar_legs,
    stages,
    vectors,
    wrenches,
)
from spm_pin.formulas.operations import bind
from spm_pin.formulas.planar_legs import MOST_TURNED, LegPlane
from spm_pin.formulas.stage_numbers import (
    circles_of_readings,
    readings_of_balls,
    relative_slopes,
    rods_at,
    stage_numbers,
)
from spm_pin.machine import FAMILIES, LegKind, Machine, Manipulator
from spm_pin.machine.joint_angles import joint_names
from spm_pin.machine.leg_kinds import BOUNDS, drawn_numbers
from spm_pin.machine.legs import AXES, RADIAL
from spm_pin.machine.machine import ALONE
from spm_pin.support.arguments import LARGEST, SMALLEST, as_bool, type_and_value
from spm_pin.support.pose import ORTHONORMALITY_TOLERANCE

FLOOR = 1e-40
"""Least radicand of a square root: its root is far below rounding, and its powers in derivatives are finite."""
FIELDS = {"dimensions": 3, "axes": 18, "pivots": 18, "balls": 18, "offsets": 6, "minimum": 6, "maximum": 6}
"""Number of parameters of a machine with RPS legs: E, C, d, the six legs and the limits of their readings."""


def sqrt(x: Any) -> Any:
    """Return the square root, that of zero for negative numbers."""
    return ca.sqrt(ca.fmax(x, FLOOR))


def _arctan2(y: Any, x: Any) -> Any:
    """Return the angle of a vector; zero for a zero vector, where derivatives are finite too."""
    return ca.atan2(y, ca.if_else(x * x + y * y > 0.0, x, 1.0))


def _where(condition: Any, yes: Any, no: Any) -> Any:
    return ca.if_else(condition, yes, no) if isinstance(condition, ca.SX) else (yes if condition else no)


def in_casadi(formula: Any) -> Any:
    """Return a formula of `spm_pin.formulas` as a function of CasADi's expressions."""
    operations = {"sqrt": sqrt, "cos": ca.cos, "sin": ca.sin, "arctan2": _arctan2, "where": _where}
    return bind(formula, both=ca.logic_and, either=ca.logic_or, magnitude=ca.fabs, **operations)


def fields_of(kinds: Sequence[LegKind]) -> dict[str, int]:
    """Return how many numbers describe a machine of these legs: `FIELDS`, and those that are fixed in the legs."""
    stages = zip(("lower", "upper"), kinds, strict=True)
    numbers = {f"{stage}_{kind.name.lower()}": kind.numbers.size for stage, kind in stages}
    return FIELDS | {name: count for name, count in numbers.items() if count}


def parts(vector: Any) -> tuple[Any, Any, Any]:
    """Return the three components, as formulas take a vector."""
    return vector[0], vector[1], vector[2]


def columns(rows: Sequence[Any]) -> list[Any]:
    """Return the vectors of a formula as columns (3,)."""
    return [ca.vertcat(*row) for row in rows]


def rows(vectors: Sequence[Any]) -> Any:
    """Return three vectors as formulas take them."""
    return tuple(map(parts, vectors))


def stages_of(vectors: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Return six vectors as formulas take them: those of the lower legs, and those of the upper."""
    return [parts(x) for x in vectors[:3]], [parts(x) for x in vectors[3:]]


def all_of(conditions: Sequence[Any]) -> Any:
    """Return 1 where all conditions hold, else 0."""
    every = ca.SX(1)
    for condition in conditions:
        every = ca.logic_and(every, condition)
    return every


def in_plane(point: Any, plane: LegPlane) -> Any:
    """Return x and z (2,) of a point (3,) in the plane of a leg."""
    return ca.vertcat(*in_casadi(planar_legs.place_in_plane)(parts(point), plane))


def point_in(coordinates: Any, plane: LegPlane) -> Any:
    """Return the point (3,) of the plane of a leg at x and z (2,)."""
    return ca.vertcat(*in_casadi(planar_legs.point_of_plane)(*ca.vertsplit(coordinates), plane))


class MachineInCasadi:
    """A machine, and the inputs that functions of it have beside their own.

    Parameters
    ----------
    machine : Manipulator, "symbolic" or None
        As for `spm_pin.casadi.inverse_physical`.
    parameters : bool
        Whether the parameters of the legs are an input.
    """

    def __init__(
        self,
        machine: Machine | Literal["symbolic"] | None = None,
        parameters: bool = False,
        *,
        of: tuple[type[Machine], ...] = (Manipulator,),
    ) -> None:
        self.inputs: list[Any] = []
        self.valid: Any = 1
        parameters = as_bool(parameters, "parameters")
        self.is_nominal = not parameters
        if isinstance(machine, str) and machine == "symbolic" and not parameters:
            self._set_kinds(Manipulator(1.0, 1.0, 1.0))
            self.inputs = [ca.SX.sym("dimensions", 3)]
            base, platform, side = ca.vertsplit(self.inputs[0])
            self._draw((base, platform), side)
            return
        if not (machine is None or isinstance(machine, of)):
            cause = ALONE * isinstance(machine, Machine)
            raise ArgumentError("machine", 'a Manipulator, "symbolic" or None', type_and_value(machine), cause)
        machine = machine or Manipulator.paper()
        self._set_kinds(machine)
        self._draw(tuple(radius for radius, _ in machine.stage_radii), machine.ball_side)
        if parameters:
            self.inputs = [ca.SX.sym("parameters", len(machine.parameters))]
            first = 9 * len(self.numbers)
            further = ca.vertsplit(self.inputs[0][first:])
            for leg, own in enumerate(self.numbers):
                count = len(self.kinds[leg // 3].identified)
                self.numbers[leg], further = (*further[:count], *own[count:]), further[count:]
            self._check_numbers()
            self._set_legs(*_legs_of_parameters(self.inputs[0][:first]))
        elif not machine.is_nominal:
            self.is_nominal = False
            axes, pivots, balls = ([ca.SX(v) for v in array] for array in machine.legs.arrays[:3])
            self._set_legs(axes, pivots, balls, ca.SX(machine.legs.offsets))

    @classmethod
    def of_symbols(cls, machine: Manipulator) -> MachineInCasadi:
        """Return a machine whose `fields_of` are the inputs, vectors leg by leg; axes may be off unit length.

        It has the kinds of legs of `machine`.
        """
        symbolic, kinds = cls(), machine.legs.kinds
        symbols = {name: ca.SX.sym(name, count) for name, count in fields_of(kinds).items()}
        symbolic.inputs, symbolic.is_nominal = list(symbols.values()), False
        symbolic._set_kinds(machine)
        numbers = ca.vertsplit(ca.vertcat(*symbolic.inputs[len(FIELDS) :]))
        for leg, fixed in enumerate(symbolic.numbers):
            symbolic.numbers[leg], numbers = tuple(numbers[: len(fixed)]), numbers[len(fixed) :]
        symbolic.minimum, symbolic.maximum = symbols["minimum"], symbols["maximum"]
        base, platform, side = ca.vertsplit(symbols["dimensions"])
        symbolic._draw((base, platform), side)
        symbolic._check_numbers()
        axes, pivots, balls = (ca.vertsplit(symbols[name], 3) for name in ("axes", "pivots", "balls"))
        units = [ca.vertcat(*in_casadi(vectors.direction)(parts(x))) for x in axes]
        symbolic._set_legs(units, pivots, balls, symbols["offsets"])
        return symbolic

    def nominal(self) -> MachineInCasadi:
        """Return a machine whose axes, pivots and balls are nominal, and all else this one's."""
        drawn = copy(self)
        drawn.is_nominal = True
        drawn._draw(self.radii, self.side)
        drawn.offsets, drawn.valid = self.offsets, self.valid
        return drawn

    def _set_kinds(self, machine: Machine) -> None:
        self.kinds = kinds = machine.legs.kinds
        self.joint_names = joint_names(machine)
        limits = machine.limits or machine.legs.free_limits
        self.minimum, self.maximum = ca.SX(limits.minimum), ca.SX(limits.maximum)
        self.formulas = [kind.bound(in_casadi) for kind in kinds]
        self.numbers = [tuple(row) for kind in kinds for row in kind.numbers.tolist()]

    def _check_numbers(self) -> None:
        """Make the machine invalid where a constant of a leg is beyond its bounds."""
        for leg, numbers in enumerate(self.numbers):
            for name, x in zip(fields(self.kinds[leg // 3]), numbers, strict=True):
                low, high = BOUNDS[name.name]
                within = x * x == 1.0 if name.name == "sign" else ca.logic_and(x >= low, x <= high)
                self.valid = ca.logic_and(self.valid, within)

    def _draw(self, radii: tuple[Any, ...], side: Any) -> None:
        self.radii, self.side, self.r = radii, side, side / np.sqrt(3.0)
        self.valid = all_of([ca.logic_and(x >= SMALLEST, x <= LARGEST) for x in (*radii, side)])
        corners = [self.r * ca.SX(v) for v in RADIAL]
        pivots, count = [radius * ca.SX(v) for radius in radii for v in RADIAL], len(radii)
        self._set_legs([ca.SX(v) for v in AXES] * count, pivots, corners * count, ca.SX.zeros(3 * count))

    def _set_legs(self, axes: list[Any], pivots: list[Any], balls: list[Any], offsets: Any) -> None:
        self.axes, self.pivots, self.balls, self.offsets = axes, pivots, balls, offsets
        self.stages = []
        for k, kind in enumerate(self.kinds):
            own = slice(3 * k, 3 * k + 3)
            three = [rows(x[own]) for x in (axes, pivots, balls)]
            ends, numbers = (parts(self.minimum[own]), parts(self.maximum[own])), tuple(self.numbers[own])
            up, side = kind.up_of(in_casadi, numbers), 1.0 - 2.0 * k
            self.stages.append(in_casadi(stage_numbers)(three, parts(offsets[own]), ends, numbers, side, up))

    @property
    def planes(self) -> list[LegPlane]:
        """The planes of the legs."""
        return [plane for stage in self.stages for plane in stage.planes]

    def heights(self) -> list[Any]:
        """Return a_i·(pivot i) of the legs, in {B} or {m}."""
        return [ca.dot(axis, pivot) for axis, pivot in zip(self.axes, self.pivots, strict=True)]

    def function(self, name: str, inputs: list[Any], outputs: dict[str, Any]) -> ca.Function:
        """Make a function; inputs are named as their symbols are."""
        every = [*inputs, *self.inputs]
        names = [x[0].name().rsplit("_", 1)[0] for x in every]
        return ca.Function(name, every, list(outputs.values()), names, list(outputs))

    def takes(self, rotation: Any, position: Any) -> Any:
        """Return 1 where the package accepts a pose and the dimensions, else 0."""
        errors = ca.fabs(rotation.T @ rotation - ca.SX.eye(3))
        rigid = all_of([e <= ORTHONORMALITY_TOLERANCE for e in ca.vertsplit(ca.vec(errors))])
        finite = all_of([ca.fabs(x) < np.inf for x in ca.vertsplit(position)])
        return all_of([self.valid, rigid, finite, ca.det(rotation) > 0.0])

    def sides(self) -> list[Any]:
        """Return the distances of the lower legs' balls 12, 23, 31."""
        return [sqrt(x) for x in in_casadi(circles.squared_sides)(stages_of(self.balls)[0])]

    def ball_weights(self) -> Any:
        """Return the weights of `spm_pin.formulas.leg_planes.upper_balls`."""
        if self.is_nominal:
            return [(0.0, 0.0, 0.0)] * 3
        return in_casadi(leg_planes.upper_ball_weights)(*stages_of(self.balls))

    def all_balls(self, b: Sequence[Any]) -> list[Any]:
        """Return the six balls from those of the lower legs, seen from the same frame."""
        upper = in_casadi(leg_planes.upper_balls)([parts(x) for x in b], self.ball_weights())
        return [*b, *columns(upper)]

    def circles(self, stage: int, readings: Any) -> circles.Circles:
        """Return the circles of the balls of the lower stage, 0, or of the upper, 1, for the readings of all legs."""
        own = parts((readings - self.offsets)[3 * stage : 3 * stage + 3])
        three: circles.Circles = in_casadi(circles_of_readings)(own, self.stages[stage], self.formulas[stage])
        return three

    def slopes_at(self, balls: Sequence[Any], readings: Sequence[Any]) -> list[Any]:
        """Return κ over the largest for balls of each stage, in {B} or {m}, and readings of all legs without offsets.

        Zero where a leg is singular, negative in another working mode.
        """
        stages = zip(balls, self.stages, self.formulas, strict=True)
        relative: list[Any] = []
        for k, (b, *stage) in enumerate(stages):
            slopes, _ = in_casadi(rods_at)(b, readings[3 * k : 3 * k + 3], *stage)
            relative += in_casadi(relative_slopes)(slopes, *stage)
        return relative

    def are_readings(self, own: Sequence[Any]) -> list[Any]:
        """Return where readings of the first legs, without offsets, are finite, and those of cranks within a turn."""
        most = (MOST_TURNED if self.kinds[leg // 3].unit == "rad" else np.inf for leg in range(len(own)))
        return [ca.fabs(reading) < bound for reading, bound in zip(own, most, strict=True)]

    def leg_frames(self, stage: int, own_axes: Any) -> Sequence[joint_values.LegFrame]:
        """Return the constants of a stage's legs; `own_axes` are the axes of the lower balls' triangle in {n}."""
        legs, placed = slice(3 * stage, 3 * stage + 3), self.stages[stage]
        limits, radii = (ca.mmax(self.minimum[legs]), ca.mmin(self.maximum[legs])), (self.radii[stage], self.r)
        drawn, up = drawn_numbers(placed.numbers, len(self.kinds[stage].identified)), 1.0 - 2.0 * stage
        formula, kind = in_casadi(joint_values.stage_frames), self.formulas[stage]
        frames: Sequence[joint_values.LegFrame] = formula(placed, own_axes, radii, limits, drawn, up, kind)
        return frames


def _legs_of_parameters(parameters: Any) -> tuple[list[Any], list[Any], list[Any], Any]:
    """Return axes, pivots, balls and offsets of nine parameters of each leg; see `Manipulator.parameters`."""
    rows, turned = ca.vertsplit(parameters, 9), in_casadi(leg_constants.turned_axis)
    axes = [ca.vertcat(*turned(leg_constants.AXES[i % 3], row[0], row[1])) for i, row in enumerate(rows)]
    return axes, [row[2:5] for row in rows], [row[5:8] for row in rows], ca.vertcat(*(row[8] for row in rows))


class StateInCasadi:
    """The six legs in {B} of a state: b_i, the rows of `joints` (3, 3), with the rotation and the position of {m}.

    The legs' `vectors` and `directions` are those of their rods, from the centres of the balls' circles.
    """

    def __init__(self, machine: MachineInCasadi, joints: Any, rotation: Any, position: Any) -> None:
        self.machine, self.rotation, self.position = machine, rotation, position
        self.joints = [joints[i, :].T for i in range(3)]
        self.balls = machine.all_balls(self.joints)
        self.bases = self._in_base(machine.pivots)
        self.axes = [*machine.axes[:3], *(rotation @ a for a in machine.axes[3:])]
        self._own = [rows(balls) for balls in self.own_balls()]
        stages = zip(self._own, machine.stages, machine.formulas, strict=True)
        own: list[Any] = []
        reaches: list[Any] = []
        rods: list[Any] = []
        self.slopes: list[Any] = []
        for balls, *stage in stages:
            readings, reach = in_casadi(readings_of_balls)(balls, *stage)
            slopes, of_stage = in_casadi(rods_at)(balls, readings, *stage)
            own += readings
            reaches += reach
            rods += columns(of_stage)
            self.slopes += slopes
        self.readings = ca.vertcat(*own) + machine.offsets
        # The least reach of a leg is negative where a ball is out of reach.
        self.reach = ca.mmin(ca.vertcat(*reaches))
        self.vectors = [*rods[:3], *(-rotation @ x for x in rods[3:])]
        (lower, lower_lengths), (upper, upper_lengths) = map(
            in_casadi(vectors.directions_and_lengths), stages_of(self.vectors)
        )
        self.directions = columns([*lower, *upper])
        self.lengths = ca.vertcat(*lower_lengths, *upper_lengths)

    def _in_base(self, points: Sequence[Any]) -> list[Any]:
        """Return points of the lower legs' base and of {m} in {B}."""
        return [*points[:3], *(self.position + self.rotation @ p for p in points[3:])]

    def least_slope(self, readings: Any) -> Any:
        """Return the least κ over the largest of legs with these readings (6,), see `MachineInCasadi.slopes_at`."""
        own = ca.vertsplit(readings - self.machine.offsets)
        return ca.mmin(ca.vertcat(*self.machine.slopes_at(self._own, own)))

    def own_balls(self) -> tuple[list[Any], list[Any]]:
        """Return the lower balls in {B} and the upper ones in {m}."""
        return self.balls[:3], [self.rotation.T @ (b - self.position) for b in self.balls[3:]]

    def in_planes(self) -> Any:
        """Return the coordinates (6,) of the lower balls in their legs' planes."""
        return ca.vertcat(*map(in_plane, self.balls[:3], self.machine.planes))

    def force_rows(self, directions: Sequence[Any]) -> Any:
        """Return forces of size one through the six balls as rows (f, (b - p) x f / d), p the mean of the b_i."""
        balls, rows = stages_of(self.balls), []
        centre = in_casadi(wrenches.mean)(balls[0])
        for f, b in zip(stages_of(directions), balls, strict=True):
            arms = in_casadi(wrenches.arms)(b, centre, self.machine.side)
            rows += in_casadi(wrenches.force_rows)(f, arms, ball_motions.NONE)
        return ca.vertcat(*(ca.horzcat(*force, *moment) for force, moment in rows))

    def is_physical(self) -> tuple[Any, Any]:
        """Return whether the state is physical, leg limits aside, and the sum of the cosines of both stages' tilts."""
        physical = [self.reach >= 0.0]
        for k, (b, stage) in enumerate(zip(self._own, self.machine.stages, strict=True)):
            centres = self.machine.circles(k, self.readings).centres
            physical.append(in_casadi(circles.is_home_state)(b, centres, stage.axes, stage.up))
        turn = [parts(self.rotation[i, :]) for i in range(3)]
        return all_of(physical), in_casadi(branches.tilt_cosine_sum)(rows(self.joints), turn)


class NominalBranches:
    """The closed form of the nominal machine at a pose."""

    def __init__(self, machine: MachineInCasadi, rotation: Any, position: Any) -> None:
        rows = [parts(rotation[i, :]) for i in range(3)]
        self.machine, self._position = machine, parts(position)
        self.frame = in_casadi(branches.pose_frame)(rows, self._position, machine.r)
        families = in_casadi(branches.families)(self.frame, machine.r)
        self.families = dict(zip(FAMILIES, families, strict=True))

    def discriminant(self, family: str) -> Any:
        """Return uv² - uu vv over r²."""
        return in_casadi(branches.discriminant)(self.families[family]) / self.machine.r**2

    def is_degenerate(self, family: str) -> Any:
        """Return whether a family is degenerate, or the Z axes are parallel."""
        vanishes = in_casadi(branches.is_continuous)(self.families[family], self.frame.noise)
        return ca.logic_or(vanishes, self.frame.is_vertical)

    def is_real(self, family: str) -> Any:
        """Return whether the two branches of a family are real and isolated."""
        return ca.logic_and(self.discriminant(family) >= 0.0, ca.logic_not(self.is_degenerate(family)))

    def branch(self, family: str, sign: float, least: float = 0.0) -> Any:
        """Return the b_i (3, 3) of the branch of a sign; a discriminant below `least` times r² is taken for that."""
        form = self.families[family]
        radicand = ca.fmax(in_casadi(branches.discriminant)(form), least * self.machine.r**2)
        u, v, square = in_casadi(branches.root)(form, sign, sqrt(radicand))
        radii, heights = in_casadi(branches.middle_joints)(
            u, v, self.machine.r / square, form, self.frame, self._position
        )
        rows = in_casadi(stages.cartesian)(radii, heights)
        return ca.vertcat(*(ca.horzcat(*row) for row in rows))
