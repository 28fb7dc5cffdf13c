"""A machine in CasADi: its drawing and its six legs as numbers or symbols, and the equations that hold it together.

A ball lies in the plane of its leg, normal to the leg's revolute axis. Its two coordinates there, from the pivot and in
`LegFrame`, are the unknowns: all equations are quadratic in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.formulas import leg_planes, stages, wrenches
from spm_pin.formulas.operations import bind
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import LARGEST, SMALLEST, as_bool, type_and_value
from spm_pin.mechanism.legs import AXES, RADIAL
from spm_pin.mechanism.pose import ORTHONORMALITY_TOLERANCE

FLOOR = 1e-40
"""Least radicand of a square root: its root is far below rounding, and its powers in derivatives are finite."""
UP = np.array([0.0, 0.0, 1.0])
FIELDS = {"dimensions": 3, "axes": 18, "pivots": 18, "balls": 18, "offsets": 6, "minimum": 6, "maximum": 6}
"""How many numbers describe a machine: E, C, d, the six legs and the limits of their readings."""


def sqrt(x: Any) -> Any:
    """Return the square root, that of zero for negative numbers."""
    return ca.sqrt(ca.fmax(x, FLOOR))


def _where(condition: Any, yes: Any, no: Any) -> Any:
    return ca.if_else(condition, yes, no) if isinstance(condition, ca.SX) else (yes if condition else no)


def in_casadi(formula: Any) -> Any:
    """Return a formula of `spm_pin.formulas` as a function of CasADi's expressions."""
    return bind(formula, sqrt=sqrt, where=_where, both=ca.logic_and, either=ca.logic_or)


def parts(vector: Any) -> tuple[Any, Any, Any]:
    """Return the three components, as formulas take a vector."""
    return vector[0], vector[1], vector[2]


def direction(vector: Any) -> Any:
    """Return a vector over its length."""
    return vector / sqrt(ca.dot(vector, vector))


def all_of(conditions: Sequence[Any]) -> Any:
    """Return 1 where all conditions hold, else 0."""
    found = ca.SX(1)
    for condition in conditions:
        found = ca.logic_and(found, condition)
    return found


class LegFrame(NamedTuple):
    """x along a leg's revolute axis, z as near to the normal of {B} or {m} as that allows."""

    x: Any
    y: Any
    z: Any
    pivot: Any

    def coordinates(self, point: Any) -> Any:
        """Return where a point is in the plane of the leg (2,)."""
        return ca.vertcat(ca.dot(self.y, point - self.pivot), ca.dot(self.z, point - self.pivot))

    def point(self, coordinates: Any) -> Any:
        """Return the point of the plane that has these coordinates."""
        return self.pivot + coordinates[0] * self.y + coordinates[1] * self.z


class Machine:
    """A machine, and the inputs that functions of it have beside their own.

    Parameters
    ----------
    geometry : Geometry, "symbolic" or None
        As for `spm_pin.symbolic.inverse_physical`.
    parameters : bool
        Whether the 54 parameters of the legs are an input.
    """

    def __init__(self, geometry: Geometry | Literal["symbolic"] | None = None, parameters: bool = False) -> None:
        self.inputs: list[Any] = []
        parameters = as_bool(parameters, "parameters")
        self.is_drawn = not parameters
        self.minimum, self.maximum = ca.SX.zeros(6), ca.SX(6 * [np.inf])
        if isinstance(geometry, str) and geometry == "symbolic" and not parameters:
            self.inputs = [ca.SX.sym("dimensions", 3)]
            self._draw(*ca.vertsplit(self.inputs[0]))
            return
        if not isinstance(geometry, Geometry | None):
            raise ArgumentError("geometry", 'a Geometry, "symbolic" or None', type_and_value(geometry))
        machine = Geometry.paper() if geometry is None else geometry
        if machine.limits is not None:
            self.minimum, self.maximum = ca.SX(machine.limits.minimum), ca.SX(machine.limits.maximum)
        self._draw(*machine.nominal.dimensions)
        if parameters:
            self.inputs = [ca.SX.sym("parameters", 54)]
            self._set_legs(*_legs_of_parameters(self.inputs[0]))
        elif not machine.is_nominal:
            self.is_drawn = False
            axes, pivots, balls = ([ca.SX(v) for v in array] for array in machine.legs.arrays[:3])
            self._set_legs(axes, pivots, balls, ca.SX(machine.legs.offsets))

    @classmethod
    def of_symbols(cls) -> Machine:
        """Return a machine whose `FIELDS` are the inputs, vectors leg by leg; axes may be off unit length."""
        machine, fields = cls(), {name: ca.SX.sym(name, count) for name, count in FIELDS.items()}
        machine.inputs, machine.is_drawn = list(fields.values()), False
        machine._draw(*ca.vertsplit(fields["dimensions"]))
        axes, pivots, balls = (ca.vertsplit(fields[name], 3) for name in ("axes", "pivots", "balls"))
        machine._set_legs([direction(x) for x in axes], pivots, balls, fields["offsets"])
        machine.minimum, machine.maximum = fields["minimum"], fields["maximum"]
        return machine

    def _draw(self, base: Any, platform: Any, side: Any) -> None:
        self.base, self.platform, self.side, self.r = base, platform, side, side / np.sqrt(3.0)
        self.valid = all_of([ca.logic_and(x >= SMALLEST, x <= LARGEST) for x in (base, platform, side)])
        corners = [self.r * ca.SX(v) for v in RADIAL]
        pivots = [radius * ca.SX(v) for radius in (base, platform) for v in RADIAL]
        self._set_legs([ca.SX(v) for v in (*AXES, *AXES)], pivots, corners + corners, ca.SX.zeros(6))

    def _set_legs(self, axes: list[Any], pivots: list[Any], balls: list[Any], offsets: Any) -> None:
        self.axes, self.pivots, self.balls, self.offsets = axes, pivots, balls, offsets
        self.frames = []
        for x, pivot in zip(axes, pivots, strict=True):
            z = direction(ca.SX(UP) - x[2] * x)
            self.frames.append(LegFrame(x, ca.cross(z, x), z, pivot))

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

    def sides(self, stage: int) -> list[Any]:
        """Return the distances of the balls 12, 23, 31 of the lower stage, 0, or of the upper, 1."""
        b = self.balls[3 * stage : 3 * stage + 3]
        return [sqrt(ca.sumsqr(b[i] - b[(i + 1) % 3])) for i in range(3)]

    def ball_weights(self) -> list[tuple[Any, Any, Any]]:
        """Return the weights of `spm_pin.formulas.leg_planes.upper_balls`."""
        if self.is_drawn:
            return [(0.0, 0.0, 0.0)] * 3
        first, second = self.balls[1] - self.balls[0], self.balls[2] - self.balls[0]
        normal, weights = ca.cross(first, second), []
        for lower, upper in zip(self.balls[:3], self.balls[3:], strict=True):
            arm = upper - lower
            u, v = ca.dot(ca.cross(arm, second), normal), ca.dot(ca.cross(first, arm), normal)
            weights.append(tuple(x / ca.sumsqr(normal) for x in (u, v, ca.dot(arm, normal))))
        return weights

    def all_balls(self, b: Sequence[Any]) -> list[Any]:
        """Return the six balls from those of the lower legs, seen from the same frame."""
        upper = in_casadi(leg_planes.upper_balls)([parts(x) for x in b], self.ball_weights())
        return [*b, *(ca.vertcat(*x) for x in upper)]

    def home_lengths(self) -> list[Any]:
        """Return the leg length at home of both stages [m]; see `spm_pin.mechanism.joint_angles.home_lengths`."""
        found = []
        for k, radius in enumerate((self.base, self.platform)):
            low, high = ca.mmax(self.minimum[3 * k : 3 * k + 3]), ca.mmin(self.maximum[3 * k : 3 * k + 3])
            middle, reach = 0.5 * (low + high), ca.fabs(self.r - radius)
            stands = all_of([low < high, reach < middle, middle < np.inf])
            found.append(ca.if_else(stands, middle, low + sqrt(reach**2 + (self.r + radius) ** 2)))
        return found


def _legs_of_parameters(parameters: Any) -> tuple[list[Any], list[Any], list[Any], Any]:
    """Return axes, pivots, balls and offsets of 54 parameters; see `Geometry.parameters`."""
    rows = [parameters[9 * i : 9 * i + 9] for i in range(6)]
    axes = []
    for row, axis in zip(rows, (*AXES, *AXES), strict=True):
        square = row[0] ** 2 + row[1] ** 2
        angle, small = ca.sqrt(ca.fmax(square, 1e-8)), square < 1e-8
        cosine = ca.if_else(small, 1.0 - square / 2.0 + square**2 / 24.0, ca.cos(angle))
        sinc = ca.if_else(small, 1.0 - square / 6.0 + square**2 / 120.0, ca.sin(angle) / angle)
        axes.append(cosine * ca.SX(axis) + sinc * (row[0] * ca.SX(np.cross(UP, axis)) + row[1] * ca.SX(UP)))
    return axes, [row[2:5] for row in rows], [row[5:8] for row in rows], ca.vertcat(*(row[8] for row in rows))


class State:
    """The six legs in {B} of a state: b_i, the rows of `joints` (3, 3), with the rotation and the position of {m}."""

    def __init__(self, machine: Machine, joints: Any, rotation: Any, position: Any) -> None:
        self.machine, self.rotation, self.position = machine, rotation, position
        self.joints = [joints[i, :].T for i in range(3)]
        self.balls = machine.all_balls(self.joints)
        self.bases = [*machine.pivots[:3], *(position + rotation @ p for p in machine.pivots[3:])]
        self.axes = [*machine.axes[:3], *(rotation @ a for a in machine.axes[3:])]
        self.vectors = [self.balls[i] - self.bases[i] for i in range(3)]
        self.vectors += [self.bases[i] - self.balls[i] for i in range(3, 6)]
        self.lengths = ca.vertcat(*(sqrt(ca.sumsqr(v)) for v in self.vectors))
        self.readings = self.lengths + machine.offsets
        # Where the wrenches and twists below are taken, and what makes their arms numbers of order one.
        self.centre = (self.joints[0] + self.joints[1] + self.joints[2]) / 3.0

    def in_planes(self) -> tuple[Any, Any]:
        """Return the coordinates (6,) of the lower balls in their legs' planes, and of the upper ones."""
        seen = [*self.balls[:3], *(self.rotation.T @ (b - self.position) for b in self.balls[3:])]
        found = [frame.coordinates(p) for frame, p in zip(self.machine.frames, seen, strict=True)]
        return ca.vertcat(*found[:3]), ca.vertcat(*found[3:])

    def force_rows(self, directions: Sequence[Any]) -> Any:
        """Return forces of size one through the six balls as rows (f, (b - p) x f / d), p the `centre`."""
        arms = [(b - self.centre) / self.machine.side for b in self.balls]
        return ca.vertcat(*(ca.vertcat(f, ca.cross(a, f)).T for f, a in zip(directions, arms, strict=True)))

    def is_physical(self) -> tuple[Any, Any]:
        """Return whether the state is physical, leg limits aside, and the sum of the cosines of both stages' tilts."""
        up, seen = self.rotation[:, 2], [self.rotation @ ca.SX(v) for v in RADIAL]
        conditions = [ca.dot(UP, self.centre) > 0.0, ca.dot(self.position - self.centre, up) > 0.0]
        for k, radial in ((0, [ca.SX(v) for v in RADIAL]), (3, seen)):
            outwards = sum(ca.dot(v, b) for v, b in zip(radial, self.joints, strict=True))
            at_home = is_at_home(self.axes[k : k + 3], self.vectors[k : k + 3], self.balls[k : k + 3])
            conditions += [outwards > 0.0, at_home]
        b1, b2, b3 = self.joints
        normal = direction(ca.cross(b1 - b3, 2.0 * b2 - b1 - b3))
        return all_of(conditions), normal[2] + ca.dot(normal, up)


def is_at_home(axes: Sequence[Any], legs: Sequence[Any], balls: Sequence[Any]) -> Any:
    """Return whether an upright stage is in the aspect of its home; see `mechanism.branch_of_state.physical`."""
    # The axes as tangents of their platform, counterclockwise.
    normals = [parts(ca.cross(sign * a, leg)) for sign, a, leg in zip((1.0, -1.0, -1.0), axes, legs, strict=True)]
    pairs = in_casadi(wrenches.pairs)([parts(b) for b in balls], normals)
    return in_casadi(stages.is_home_aspect)(pairs)
