"""Proof by subdivision that a stage meets no singularity between limits of its readings.

A state in mode T is the vector part (x, y) of the middle platform's quaternion (x0, x, y, 0), x0 = √(1 - x² - y²), and
the height Z of its centre. With r = d/√3, corner k has the radius ρ_k and the height z_k,

    ρ_1, ρ_3 = r (1 - 2y² ∓ 2√3 xy),   z_1, z_3 = Z - r x0 (x ± √3 y),
    ρ_2 = r (1 - 3x² + y²),             z_2 = Z + 2 r x0 x,

its ball the place (ρ_k - ρ, z_k) from the pivot, where ρ is E or C, from which its reading and the centre (s_k, h_k) of
its circle follow. The stage is forward singular where

    D = m12 m23 m31 + m21 m32 m13 = 0,   m_ij = (z_i - h_i) (ρ + s_i + ρ_j / 2) + (z_j - h_i) (ρ_i - ρ - s_i).

The centre is the pivot of an RPS leg. For other legs it is enclosed from the reading, the reading from the box of
states and the limits, and κ has to keep the sign of the working mode. In a machine with errors the quaternion has a
small fourth component x3, and each of these numbers differs by what is bounded over all machines.

The cube of the states (x, y, Z) is divided into eight again and again: boxes without readings within the limits are
dropped; boxes where D and κ keep their signs are proved; of the others only those joined to a given state, through
touching boxes, are divided further. That one state has the readings in the middle of the limits is proved by
subdivision, until Krawczyk's test succeeds. Derivation and theorem: `docs/theory/proofs.md`.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from decimal import ROUND_FLOOR, Context
from functools import cached_property, partial, reduce
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.formulas.operations import bind
from spm_pin.formulas.planar_legs import Circle
from spm_pin.formulas.stages import pair_determinant
from spm_pin.formulas.vectors import combined, matrix_product, minus, times
from spm_pin.kinematics.intervals import INTERVALS, SQRT_3, Interval, as_interval
from spm_pin.machine import Configuration
from spm_pin.machine.branch_of_state import stage_coordinates
from spm_pin.machine.leg_kinds import KINDS, RPS, LegKind
from spm_pin.support.arguments import BoolArray, FloatArray

Int64Array = npt.NDArray[np.int64]

_FIRST_LEVEL = 4
"""The subdivision begins with cells of 1/16 of the cube's edge."""
_SEARCH = 30_000
"""Number of boxes after which a singular state is looked for, again after four times as many, and so on."""
_ROUNDING = 1e-9
"""Uncertainty of the start, in units of the cube's edges."""
_STARTS, _STEPS = 2_000, 60
"""Boxes in which Newton's method towards a singular state starts, and its steps."""
_ROUNDS, _MOST_BOXES = 30, 20_000
"""Divisions until Krawczyk's test must succeed, and boxes at most."""


_MIRROR = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
"""The upper stage is the same upside down, mirrored at the terminal platform."""

ZERO = Interval.from_numbers(0.0)
_PLANE_TURN = 2.5
"""Most by which an axis of a leg's plane moves per `angle_error`."""
_UP = 1.0 + 1e-12
"""Covers the rounding of a bound of errors, a few operations."""


@dataclass(frozen=True)
class ErrorBounds:
    """Bounds of the changes that errors of a machine make in one stage, see `docs/theory/proofs.md`."""

    length: Interval
    """A coordinate of a pivot, or a reading [m]."""
    pivot: Interval
    """A pivot in a horizontal direction [m]."""
    leaning: Interval
    """A ball's distance from the nominal plane of its leg that goes through its pivot [m]."""
    sideways: Interval
    """√3/2 times a ball's distance from the nominal plane of its leg through the centre [m]."""
    radius: Interval
    """A ball's radius without torsion [m]."""
    height: Interval
    """A ball's height without torsion [m]."""
    factor: Interval
    """m_ij, by the direction of the axis [m²]."""
    torsion: FloatArray
    """|x0 x3|."""


class LegEnclosure(NamedTuple):
    """Bounds for a leg in states, for all machines; its numbers and those of `StageValues` are arrays."""

    reading: Interval
    x: Interval  # of the circle's centre from the nominal pivot, radially
    z: Interval  # and towards the middle platform
    is_beyond: BoolArray  # no reading is within the limits
    slope: FloatArray  # lower bound of κ, with the sign by which it is positive in the working mode


class StageValues(NamedTuple):
    """Bounds for states of a stage, for all machines."""

    readings: list[Interval]  # without offsets
    squares: list[Interval]  # of the distances from the circles' centres to the balls [m²]
    determinant: Interval  # D [m⁶]
    is_beyond: BoolArray  # no readings are within the limits
    slope: FloatArray  # lower bound of κ of all legs, positive in the working mode


@dataclass(frozen=True)
class StageRegion:
    """The searched states of a stage, for one machine or for all machines within errors.

    For N stages at once, with N boxes, numbers are arrays (N,), and limits arrays (3, N).
    """

    leg_base_radius: float | FloatArray
    """Distance of the legs' revolute joints from the axis: E or C [m]."""
    side: float | FloatArray
    """Side of the middle platform's triangle [m]."""
    minimum: FloatArray
    """Least readings, shape (3,)."""
    maximum: FloatArray
    """Largest readings, shape (3,)."""
    legs: LegKind = RPS()  # noqa: RUF009  # frozen
    """Kind of the legs, equal in the stage."""
    length_error: float = 0.0
    """Largest error of each coordinate of a pivot and of a ball, of a rod and a crank, and of a reading [m]."""
    angle_error: float = 0.0
    """Largest turn of a revolute axis about either direction perpendicular to it, of a slide, of a reading [rad]."""
    up: float = 1.0
    """Sign of D at home: -1 if the platform hangs below the centres of the circles."""

    @cached_property
    def numbers(self) -> tuple[tuple[Interval, ...], ...]:
        """The constant numbers of each leg, for all machines."""
        spread = {"direction": self.angle_error, "sign": 0.0}
        errors = [spread.get(field.name, self.length_error) for field in fields(self.legs)]
        return tuple(
            tuple(Interval.from_numbers(x) + Interval.within(e) if e else Interval.from_numbers(x) for x, e in pairs)
            for pairs in (zip(row, errors, strict=True) for row in self.legs.numbers)
        )

    @cached_property
    def readings(self) -> list[Interval]:
        """Readings within the limits, without their offsets."""
        error = self.angle_error if self.legs.unit == "rad" else self.length_error
        within = Interval(self.minimum, self.maximum)
        within = within + Interval.within(error) if error else within
        return [Interval(np.asarray(low), np.asarray(high)) for low, high in zip(within.low, within.high, strict=True)]

    @cached_property
    def circles(self) -> list[Circle]:
        """Circles of all balls with readings within the limits, as intervals."""
        formula = _ON_INTERVALS[type(self.legs)].circle
        return [formula(*leg) for leg in zip(self.readings, self.numbers, strict=True)]

    @cached_property
    def radii(self) -> list[Interval]:
        """Distances from the circles' centres to the balls of legs whose readings are within the limits [m]."""
        radii = [as_interval(circle.radius) for circle in self.circles]
        return [Interval(np.maximum(radius.low, 0.0), radius.high) for radius in radii]

    @cached_property
    def longest(self) -> FloatArray:
        """Bound of the distance from pivot to ball [m]."""
        reaches = [sum(_largest(part) for part in circle) for circle in self.circles]
        return np.asarray(reduce(np.maximum, reaches) * _UP)

    @property
    def height(self) -> FloatArray:
        """Bound of |Z| [m]: the mean of the z_k is Z but for errors of the balls, and none exceeds its leg."""
        return np.asarray((self.longest + 3.0 * self.length_error) * _UP)

    @cached_property
    def error_bounds(self) -> ErrorBounds:
        """Bounds of all quantities that depend on the errors."""
        pivot, ball = np.sqrt([2.0, 3.0]) * self.length_error * _UP
        leaning = np.sqrt(2.0) * self.angle_error * self.longest * _UP
        corner = (leaning + pivot + ball) * _UP
        return ErrorBounds(
            length=Interval.within(self.length_error),
            pivot=Interval.within(pivot),
            leaning=Interval.within(leaning),
            sideways=Interval.within(np.sqrt(0.75) * (leaning + pivot) * _UP),
            radius=Interval.within((np.sqrt(4.0 / 3.0) * corner + ball) * _UP),
            height=Interval.within(ball),
            factor=Interval.within(leaning * (self.side + 2.0 * ball) * _UP),
            torsion=np.asarray(np.sqrt(0.75) * corner / self.side * _UP),
        )

    def corners(self, x: Interval, y: Interval, z: Interval) -> tuple[list[Interval], list[Interval]]:
        """Return radii and heights of the balls [m] in states with |x3| <= x0."""
        r = Interval.from_numbers(self.side) * SQRT_3.reciprocal()
        x_2, y_2 = x.square(), y.square()
        mixed = 2.0 * SQRT_3 * (x * y)
        remainder = 1.0 - (x_2 + y_2)
        # x0² + x3² is the remainder, of which x3² is at most half, and |x0 x3| is bounded.
        most = 2.0 * self.error_bounds.torsion**2 * _UP / np.maximum(remainder.low, 1e-300)
        twist = Interval(np.zeros_like(most), np.clip(most, 0.0, np.maximum(0.5 * remainder.high, 0.0)))
        common = 1.0 - 2.0 * twist
        radii = [common - 2.0 * y_2 - mixed, common - 3.0 * x_2 + y_2, common - 2.0 * y_2 + mixed]
        lever, turned = r * (remainder - twist).root(), r * Interval.within(twist.root().high)
        cross = SQRT_3 * y
        heights = [
            z - lever * (x + cross) + turned * (SQRT_3 * x - y),
            z + 2.0 * (lever * x) + 2.0 * (turned * y),
            z - lever * (x - cross) - turned * (SQRT_3 * x + y),
        ]
        return [r * radius + self.error_bounds.radius for radius in radii], [
            h + self.error_bounds.height for h in heights
        ]

    def evaluate(self, x: Interval, y: Interval, z: Interval) -> StageValues:
        """Return bounds for states."""
        bounds = self.error_bounds
        radii, heights = self.corners(x, y, z)
        base = Interval.from_numbers(self.leg_base_radius) + bounds.pivot
        places = [(radius - base, height + bounds.length) for radius, height in zip(radii, heights, strict=True)]
        legs = [self._leg(k, *place) for k, place in enumerate(places)]
        # Balls from the centres of their circles.
        slopes = [_less(x, leg.x) for (x, _), leg in zip(places, legs, strict=True)]
        rises = [_less(z, leg.z) for (_, z), leg in zip(places, legs, strict=True)]
        squares = [s.square() + h.square() + bounds.leaning.square() for s, h in zip(slopes, rises, strict=True)]

        def m(i: int, j: int) -> Interval:
            centre = base if legs[i].x is ZERO else base + legs[i].x
            upward = rises[i] * (centre + 0.5 * radii[j] + bounds.sideways)
            return upward + _less(places[j][1], legs[i].z) * slopes[i] + bounds.factor

        pairs: Any = m(0, 1), m(1, 2), m(2, 0), m(1, 0), m(2, 1), m(0, 2)
        determinant: Any = pair_determinant(pairs)  # an Interval, as its arguments
        determinant = determinant if self.up > 0.0 else -determinant
        missed = [
            leg.is_beyond | square.misses(radius.square())
            for leg, square, radius in zip(legs, squares, self.radii, strict=True)
        ]
        works = reduce(np.minimum, (leg.slope for leg in legs))
        return StageValues([leg.reading for leg in legs], squares, determinant, reduce(np.logical_or, missed), works)

    def _leg(self, leg: int, x: Interval, z: Interval) -> LegEnclosure:
        """Return bounds for a leg whose ball is at x and z of its nominal plane."""
        if isinstance(self.legs, RPS):
            return LegEnclosure((x.square() + z.square()).root(), ZERO, ZERO, np.asarray(False), np.asarray(1.0))
        formulas, numbers, limits = _ON_INTERVALS[type(self.legs)], self.numbers[leg], self.readings[leg]
        # By the turn of the leg's plane, see `docs/theory/proofs.md`.
        turned = Interval.within(_PLANE_TURN * self.angle_error * self.longest * _UP)
        x, z = x + turned, z + turned
        middle = Interval.from_numbers(0.5 * (self.minimum[leg] + self.maximum[leg]))
        reading = formulas.reading(x, z, middle, numbers)
        beyond = np.isnan(reading.low) | reading.misses(limits)
        within = Interval(
            np.where(beyond, reading.low, np.maximum(reading.low, limits.low)),
            np.where(beyond, reading.high, np.minimum(reading.high, limits.high)),
        )
        circle, slope = formulas.circle(within, numbers), formulas.slope(x, z, within, numbers)
        slope = slope * -numbers[-1]
        return LegEnclosure(reading, circle.x + turned, circle.z + turned, beyond, slope.low)


_ON_INTERVALS = {kind: kind.bound(partial(bind, **INTERVALS)) for kind in KINDS.values()}
"""The formulas of each kind of legs on intervals."""


def rounded_down(bound: float) -> str:
    """Return a proved lower bound as text, rounded down to three digits."""
    return f"{float(Context(prec=3, rounding=ROUND_FLOOR).create_decimal(float(bound))):.3g}"


def _less(value: Interval, other: Interval) -> Interval:
    """Return a difference; a subtrahend `ZERO` costs no operation."""
    return value if other is ZERO else value - other


def _largest(value: Interval | float) -> FloatArray:
    """Return the largest magnitude."""
    value = as_interval(value)
    return np.maximum(np.abs(value.low), np.abs(value.high))


def region_coordinates(configuration: Configuration) -> FloatArray:
    """Return the states (x, y, Z [m]) of the stages, shape (..., stages, 3); NaN for states not in mode T."""
    coordinates = stage_coordinates(configuration)
    return _MIRROR[: coordinates.shape[-2]] * coordinates


def configuration_at(machine: Any, states: FloatArray) -> Configuration:
    """Return the configuration of the states (stages, 3) of a nominal machine."""
    (_, r), poses = machine.stage_radii[0], []
    for x, y, z in _MIRROR[: len(states)] * states:
        rotation = Rotation.from_quat([x, y, 0.0, np.sqrt(max(1.0 - x * x - y * y, 0.0))])
        poses.append(RigidTransform.from_components([-2.0 * r * x * y, r * (y * y - x * x), z], rotation))
    if len(poses) == 1:
        return Configuration(machine, poses[0])
    joints = poses[0].apply(r * machine.radial_directions)
    return Configuration(machine, poses[0] * poses[1].inv(), joints)


@dataclass(frozen=True)
class StageProof:
    """Outcome of the subdivision of one stage."""

    bound: float
    """Proved lower bound of |det J| [m³] over the component of the start; 0 where something is undecided."""
    undecided: FloatArray
    """Boxes of (x, y, Z) [-, -, m] joined to the start in which D may be zero: low and high ends, (N, 3, 2)."""
    proved: FloatArray
    """The other boxes that meet the component of the start, (M, 3, 2); D is positive in each."""
    singular: FloatArray | None
    """A forward singular state (x, y, Z) within the limits, in a box joined to the start; None if none was found."""
    boxes: int
    """Number of boxes looked at."""


Boxes = npt.NDArray[np.void]
_BOX = np.dtype(
    [("stage", np.int64), ("level", np.int64), ("position", np.int64, 3), ("bound", np.float64), ("centre", np.float64)]
)
"""A dyadic box of the cube of a stage: its level of division, its integer position, a lower bound of |det J|, and
|det J| at its centre, infinity where that has no readings within the limits."""

DEEPEST = 14
_CORNERS = np.array(list(product((0, 1), repeat=3)))
_NEIGHBOURS = np.array(list(product((-1, 0, 1), repeat=3)))


def prove_stage(region: StageRegion, start: FloatArray, *, most: int = 300_000) -> StageProof:
    """Divide the cube of states until D is proved positive on the component of `start`, or `most` boxes were seen.

    `start` is a state (x, y, Z) within the limits, known to rounding; a box that is not divided further has
    2⁻ⁿ of the cube's edge, n = `DEEPEST`.
    """
    scale, cells = edges(region), first_boxes(_FIRST_LEVEL)
    kept, at_start = _measure(region, scale, cells), float(_value(region, [Interval.from_numbers(x) for x in start]))
    seen, singular, search_at = len(cells), None, _SEARCH
    while True:
        kept = kept[joined(scale, kept, start)]
        # A proved box is divided again while its bound is far below the least value met, so that the bound is useful.
        least = float(kept["centre"][kept["bound"] > 0.0].min(initial=at_start))
        unfinished = (kept["bound"] <= 0.5 * least) & (kept["level"] < DEEPEST)
        count = int(unfinished.sum())
        if seen >= search_at or not count or seen + 8 * count > most:
            singular = _singular_state(region, _ends(scale, kept[kept["bound"] <= 0.0]))
            search_at = 4 * seen
        if singular is not None or not count or seen + 8 * count > most:
            break
        kept = np.concatenate([kept[~unfinished], _measure(region, scale, halves(kept[unfinished]))])
        seen += 8 * count
    positive = kept["bound"] > 0.0
    proved = _ends(scale, kept[positive])
    complete = len(proved) > 0 and bool(positive.all()) and has_one_state(region, proved)
    return StageProof(
        bound=float(kept["bound"].min()) if complete else 0.0,
        undecided=_ends(scale, kept[~positive]),
        proved=proved,
        singular=singular,
        boxes=seen,
    )


def edges(region: StageRegion) -> FloatArray:
    """Return half the edges of the cube, shape (..., 3)."""
    height = 2.0 ** np.ceil(np.log2(region.height))
    return np.stack([np.ones_like(height), np.ones_like(height), height], axis=-1)


def first_boxes(level: int) -> Boxes:
    """Return all boxes of a level."""
    side = np.arange(1 << level)
    cells = np.zeros(len(side) ** 3, _BOX)
    cells["level"] = level
    cells["position"] = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    return cells


def halves(boxes: Boxes) -> Boxes:
    """Return the eight boxes that each of N is divided into."""
    parts = np.repeat(boxes, 8)
    parts["level"] += 1
    parts["position"] = 2 * parts["position"] + np.tile(_CORNERS, (len(boxes), 1))
    return parts


def _ends(scale: FloatArray, boxes: Boxes) -> FloatArray:
    """Return the low and high ends of boxes, shape (N, 3, 2): exact, so that neighbours share theirs."""
    size, position = np.ldexp(1.0, 1 - boxes["level"])[:, None], boxes["position"]
    return np.stack([(position * size - 1.0) * scale, ((position + 1) * size - 1.0) * scale], axis=-1)


def _measure(region: StageRegion, scale: FloatArray, boxes: Boxes) -> Boxes:
    """Return the boxes that may hold readings within the limits, with bounds of |det J| in them."""
    boxes = examine(region, scale, boxes)
    boxes["centre"] = _value(region, [Interval.from_numbers(x) for x in _ends(scale, boxes).mean(axis=-1).T])
    return boxes


def examine(region: StageRegion, scale: FloatArray, boxes: Boxes) -> Boxes:
    """Return the boxes that may hold readings within the limits, with lower bounds of |det J| in them."""
    x, y, z = columns(_ends(scale, boxes))
    tilt = x.square() + y.square()
    values, limits = region.evaluate(x, y, z), [radius.square() for radius in region.radii]
    # |det J| is |D| over the product of the radii, and these do not exceed their limits.
    longest = [np.minimum(square.high, limit.high) for square, limit in zip(values.squares, limits, strict=True)]
    product_of_radii = _product([Interval.from_numbers(square).root() for square in longest]).high
    # Where x0² + x3² exceeds twice the bound of |x0 x3|, x0² and x3² differ.
    proved = ((1.0 - tilt).low > 2.0 * region.error_bounds.torsion) & (values.slope > 0.0)
    bound = np.nextafter(values.determinant.low / product_of_radii, -np.inf)
    boxes["bound"] = np.maximum(np.where(proved, bound, 0.0), 0.0)
    return boxes[~((tilt.low > 1.0) | values.is_beyond)]


def _value(region: StageRegion, state: Sequence[Interval]) -> FloatArray:
    """Return |det J| of states of one number each, infinity where they have no readings within the limits."""
    values = region.evaluate(*state)
    with np.errstate(divide="ignore", invalid="ignore"):
        determinants = np.maximum(values.determinant.low, 0.0) / np.sqrt(_product(values.squares).high)
    return np.where(values.is_beyond, np.inf, determinants)


def _product(factors: Sequence[Interval]) -> Interval:
    return reduce(operator.mul, factors)


def joined(scale: FloatArray, boxes: Boxes, start: FloatArray) -> BoolArray:
    """Return which boxes are joined, through boxes of their stage that touch, to one that may hold `start`."""
    if not len(boxes):
        return np.zeros(0, dtype=np.bool_)
    pairs = _touching(boxes)
    graph = coo_array((np.ones(len(pairs), dtype=np.bool_), pairs.T), shape=(len(boxes),) * 2)
    component = connected_components(graph, directed=False)[1]
    ends = _ends(scale, boxes)
    near = _ROUNDING * scale
    holds = ((ends[..., 0] <= start + near) & (ends[..., 1] >= start - near)).all(axis=-1)
    return np.isin(component, component[holds])


def _touching(boxes: Boxes) -> Int64Array:
    """Return the pairs of boxes that have a point in common, shape (N, 2)."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    stage, level, position = boxes["stage"], boxes["level"], np.ascontiguousarray(boxes["position"])
    levels = np.unique(level)
    ordered = {}
    for size in levels:
        members = np.flatnonzero(level == size)
        keys = _keys(stage[members], position[members], size)
        order = np.argsort(keys)
        ordered[size] = members[order], keys[order]
    for fine in levels:
        members = ordered[fine][0]
        for coarse in levels[levels <= fine]:
            # Of boxes of the same size only half are compared, since pairs are symmetric. Larger boxes are at the
            # corners.
            steps = _NEIGHBOURS[14:] if coarse == fine else 2 * _CORNERS - 1
            around = position[members][:, None, :] + steps
            inside = ((around >= 0) & (around < 1 << int(fine))).all(axis=-1)
            sources = np.broadcast_to(members[:, None], inside.shape)[inside]
            targets, keys = ordered[coarse]
            wanted = _keys(stage[sources], around[inside] >> int(fine - coarse), coarse)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = keys[place] == wanted
            pairs.append(np.stack([sources[hit], targets[place[hit]]], axis=-1))
    return np.concatenate(pairs)


def _keys(stage: Int64Array, position: Int64Array, level: int) -> Int64Array:
    x, y, z = position.T
    return np.asarray((((((stage << int(level)) + x) << int(level)) + y) << int(level)) + z)


def _singular_state(region: StageRegion, boxes: FloatArray) -> FloatArray | None:
    """Find the state (x, y, Z) with D = 0 in the boxes (N, 3, 2) whose readings are farthest within the limits."""
    if not len(boxes):
        return None
    region = replace(region, length_error=0.0, angle_error=0.0)
    chosen = boxes[np.linspace(0, len(boxes) - 1, min(len(boxes), _STARTS)).astype(np.intp)]
    states = chosen.mean(axis=-1)
    states = states[(states[:, :2] ** 2).sum(axis=1) < 1.0]
    # Newton's method towards D = 0 along its gradient.
    for _ in range(_STEPS):
        value, gradient = _determinant(region, states)
        slope = (gradient**2).sum(axis=1)
        step = np.where(slope > 0.0, value / np.where(slope > 0.0, slope, 1.0), 0.0)[:, None] * gradient
        size = np.linalg.norm(step, axis=1, keepdims=True)
        states = states - step * np.minimum(1.0, 0.1 / np.maximum(size, 0.1))
        tilt = np.sqrt((states[:, :2] ** 2).sum(axis=1, keepdims=True))
        states[:, :2] /= np.maximum(1.0, tilt / 0.999)
    value, gradient = _determinant(region, states)
    arrived = np.abs(value) <= 1e-12 * np.linalg.norm(gradient, axis=1)
    readings, _ = _evaluate(region, states)
    inside = np.minimum(readings - region.minimum, region.maximum - readings).min(axis=1)
    inside[~arrived | np.isnan(inside)] = -np.inf
    # Those in other boxes are not joined to the start.
    for best in np.argsort(-inside):
        if not inside[best] >= 0.0:
            break
        state = states[best]
        if are_in_boxes(state, boxes):
            return np.asarray(state)
    return None


def are_in_boxes(states: FloatArray, boxes: FloatArray) -> BoolArray:
    """Return which states (..., 3) lie in one of the boxes (M, 3, 2), shape (...)."""
    inside = [
        ((boxes[..., 0] <= state) & (state <= boxes[..., 1])).all(axis=-1).any() for state in states.reshape(-1, 3)
    ]
    return np.array(inside, dtype=np.bool_).reshape(states.shape[:-1])


def _evaluate(region: StageRegion, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the readings (N, 3) and D (N,)."""
    values = region.evaluate(*map(Interval.from_numbers, states.T))
    *readings, value = (0.5 * (x.low + x.high) for x in (*values.readings, values.determinant))
    return np.stack(readings, axis=1), value


def _determinant(region: StageRegion, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return D (N,) and its gradient (N, 3) by central differences."""
    ends = ((_evaluate(region, states + h)[1], _evaluate(region, states - h)[1]) for h in 1e-6 * np.eye(3))
    return _evaluate(region, states)[1], np.stack([(after - before) / 2e-6 for after, before in ends], axis=1)


def has_one_state(region: StageRegion, boxes: FloatArray) -> bool:
    """Return whether boxes (N, 3, 2) are proved to have exactly one state with the middle readings of the limits."""
    middle_readings = 0.5 * (region.minimum + region.maximum)
    region = replace(region, minimum=middle_readings, maximum=middle_readings, length_error=0.0, angle_error=0.0)
    for _ in range(_ROUNDS):
        boxes = boxes[~region.evaluate(*columns(boxes)).is_beyond]
        if not 0 < len(boxes) <= _MOST_BOXES:
            return False
        if _krawczyk(region, np.stack([boxes[..., 0].min(axis=0), boxes[..., 1].max(axis=0)], axis=-1)):
            return True
        low, middle, high = boxes[:, None, :, 0], boxes.mean(axis=-1)[:, None], boxes[:, None, :, 1]
        halves = np.stack([np.where(_CORNERS, middle, low), np.where(_CORNERS, high, middle)], axis=-1)
        boxes = halves.reshape(-1, 3, 2)
    return False


def columns(boxes: FloatArray) -> list[Interval]:
    """Return the intervals of x, y and Z of boxes (..., 3, 2)."""
    return [Interval(boxes[..., i, 0], boxes[..., i, 1]) for i in range(3)]


def _krawczyk(region: StageRegion, box: FloatArray) -> bool:
    """Return whether Krawczyk's operator maps a box (3, 2), widened by a tenth, into its interior."""
    box = box + (0.1 * (box[:, 1] - box[:, 0]) + 1e-12)[:, None] * [-1.0, 1.0]
    unknowns: Any = columns(box)
    centre = box.mean(axis=-1)
    if not float((unknowns[0].square() + unknowns[1].square()).high) < 1.0:
        return False
    slopes = _slopes(region, *unknowns)
    middle = np.array([[0.5 * float(slope.low + slope.high) for slope in row] for row in slopes])
    if not np.isfinite(middle).all() or np.linalg.matrix_rank(middle) < 3:
        return False
    inverse: Any = np.linalg.inv(middle)
    unit: Any = np.eye(3)
    point: Any = [Interval.from_numbers(value) for value in centre]
    places = _places(region, *point)
    squares = [
        (x - circle.x).square() + (z - circle.z).square() for (x, z), circle in zip(places, region.circles, strict=True)
    ]
    misses: Any = [square - radius.square() for square, radius in zip(squares, region.radii, strict=True)]
    defects: Any = [minus(*rows) for rows in zip(unit, matrix_product(inverse, slopes), strict=True)]
    image: Any = combined(minus(point, times(inverse, misses)), 1.0, times(defects, minus(unknowns, point)))
    return all(x.low > low and x.high < high for x, (low, high) in zip(image, box, strict=True))


def _places(region: StageRegion, x: Interval, y: Interval, z: Interval) -> list[tuple[Interval, Interval]]:
    """Return the positions of the balls from their pivots, radially and towards the middle platform."""
    base = Interval.from_numbers(region.leg_base_radius)
    return [(radius - base, height) for radius, height in zip(*region.corners(x, y, z), strict=True)]


def _slopes(region: StageRegion, x: Interval, y: Interval, z: Interval) -> Any:
    """Return enclosures of the derivatives of the squared distances from the circles' centres by x, y and Z."""
    r = Interval.from_numbers(region.side) * SQRT_3.reciprocal()
    x0 = (1.0 - (x.square() + y.square())).root()
    slopes = []
    # Corner k is at the azimuth (a, b): z_k = Z + 2 r x0 (b x - a y).
    directions = ((0.5 * SQRT_3, -0.5), (Interval.from_numbers(0.0), 1.0), (-0.5 * SQRT_3, -0.5))
    outward = (
        (-2.0 * SQRT_3 * y, -4.0 * y - 2.0 * SQRT_3 * x),
        (-6.0 * x, 2.0 * y),
        (2.0 * SQRT_3 * y, -4.0 * y + 2.0 * SQRT_3 * x),
    )
    legs = zip(directions, outward, _places(region, x, y, z), region.circles, strict=True)
    for (a, b), out, (radial, height), circle in legs:
        lever = b * x - a * y
        up = b * x0 - x * lever / x0, -(a * x0) - y * lever / x0
        across, along = radial - circle.x, height - circle.z
        slope = [2.0 * (r * (across * part + 2.0 * (along * rise))) for part, rise in zip(out, up, strict=True)]
        slopes.append([*slope, 2.0 * along])
    return slopes
