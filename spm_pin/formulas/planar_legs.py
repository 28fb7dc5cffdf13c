"""Planar legs: the reading of a leg from the position of its ball, and the circle of the ball for a given reading.

A planar leg has two joints that move in one plane, and a ball at its end. One joint is actuated: the reading is the
length of an RPS leg [m], the position of a PRS leg's carriage on its slide [m], the angle of an RRS leg's crank [rad],
without the encoder's offset. `x` and `z` [m] are the ball's coordinates in the plane from the leg's pivot, radially
outwards and towards the middle platform. With the actuator locked the ball moves on a circle, see `Circle`. The slope κ
is the speed of the ball away from the circle's centre per unit rate of the reading; where it is zero the leg itself is
singular: `docs/theory/planar_legs.md`.

Each kind has the same formulas. `numbers` are the constants of a leg: RPS has none; PRS the rod's length, the direction
of the slide, an angle from x towards z, and the working mode; RRS the lengths of crank and rod, and the working mode.
Of the angles of a crank that differ by turns the reading is the one nearest to `middle`, see `crank_middle`, which the
other kinds ignore. The working mode is the sign, +1 or -1, of the square root in the reading. `reach` is the number
under that root: negative for a ball out of the leg's reach, as is the `room`, which is a distance.

Two formulas serve the values of the joints, `spm_pin.formulas.joint_values`. `home` is the reading at home of a leg
without limits, from the ball's x, the stage's height and the least reading; `passive` turns a direction (x, z) into the
frame of the body that carries the passive joint.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.leg_constants import UP
from spm_pin.formulas.operations import INFINITY, RIGHT_ANGLE, arctan2, both, cos, sin, sqrt, where
from spm_pin.formulas.vectors import Vector, combined, cross, direction, dot, larger, magnitude, minus, scaled

Numbers = tuple[float, ...]

RPS_LEGS, PRS_LEGS, RRS_LEGS = 0, 1, 2
"""Numbers of the kinds of legs, by which kernels choose their formulas."""
LONGEST_CHORD = 0.1
"""Largest rotation of a crank [rad] in which its end may move along the chord when a state is followed."""
MOST_TURNED = 6.3
"""Largest reading of a crank without its offset, and largest azimuth [rad]: a turn; more is probably degrees."""


class Circle(NamedTuple):
    """A circle in the plane of a leg."""

    x: float  # of its centre
    z: float
    radius: float


class Room(NamedTuple):
    """Distance of a ball from the leg's own singularities, negative out of the leg's reach, and its gradient."""

    distance: float
    x: float  # of the gradient
    z: float


class LegState(NamedTuple):
    """The state of a leg from its ball's position; out of reach, from the nearest position within reach."""

    room: Room
    reading: float
    direction: tuple[float, float]  # the unit vector from the circle's centre to the ball, x and z
    curvature: float  # of the circle, one over its radius
    gain: float  # 1/κ, bounded
    centre_rate: tuple[float, float]  # of the circle's centre, x and z, per unit rate of the reading


class LegRates(NamedTuple):
    """Rates of a leg's state while its ball moves."""

    reading: float
    turn: float  # of the direction, from z towards x
    room: float


_WITHIN = 1e-10
"""A leg whose ball is out of reach is evaluated this far within, over its length: κ is then 1e-5 of its largest."""


_LEAST_SLOPE = 0.01
"""Fraction of the largest κ below which the gain 1/κ of a `LegState` decreases again: with larger gains a search
could hardly leave the neighbourhood of a singularity of the leg."""


class LegPlane(NamedTuple):
    """The plane of a leg: its pivot, and the unit vectors radially outwards and towards the middle platform."""

    pivot: Vector
    outward: Vector
    forward: Vector


def plane_axes(axis: Vector, tangent_sign: float, up: float) -> tuple[Vector, Vector]:
    """Return the unit vectors radially outwards and towards the middle platform in the plane normal to a leg's axis.

    `tangent_sign` is the leg's of `leg_constants.TANGENT_SIGNS`, `up` +1 for a lower leg and -1 for an upper.
    """
    outward = direction(scaled(-tangent_sign, cross(UP, axis)))
    return outward, scaled(up * tangent_sign, cross(outward, axis))


def place_in_plane(point: Vector, plane: LegPlane) -> tuple[float, float]:
    """Return x and z of a point."""
    arm = minus(point, plane.pivot)
    return dot(plane.outward, arm), dot(plane.forward, arm)


def point_of_plane(x: float, z: float, plane: LegPlane) -> Vector:
    """Return the point at x and z."""
    return combined(combined(plane.pivot, x, plane.outward), z, plane.forward)


def rps_reach(x: float, z: float, numbers: Numbers) -> float:
    """Return a positive number: an RPS leg reaches every ball."""
    return 1.0


def rps_reading(x: float, z: float, middle: float, numbers: Numbers) -> float:
    """Return the length of an RPS leg."""
    return sqrt(x * x + z * z)


def rps_circle(reading: float, numbers: Numbers) -> Circle:
    """Return the circle of an RPS leg of this length."""
    return Circle(0.0, 0.0, reading)


def rps_slope(x: float, z: float, reading: float, numbers: Numbers) -> float:
    """Return κ of an RPS leg."""
    return 1.0


def rps_home(x: float, height: float, least: float, numbers: Numbers) -> float:
    """Return the length of an RPS leg in the home: the minimum plus the length with the ball at this height."""
    return least + sqrt(x * x + height * height)


def rps_passive(x: float, z: float, reading: float) -> tuple[float, float]:
    """Return a direction in the frame of the plate, which has the passive joint of an RPS leg."""
    return x, z


def rps_largest_slope(numbers: Numbers) -> float:
    """Return the κ of an RPS leg that is largest in magnitude, with the sign of its working mode."""
    return 1.0


def rps_room(x: float, z: float, numbers: Numbers) -> Room:
    """Return the room of an RPS leg: its length."""
    length = sqrt(x * x + z * z)
    return Room(length, x / length, z / length)


def rps_state(x: float, z: float, numbers: Numbers) -> LegState:
    """Return the state of an RPS leg."""
    room = rps_room(x, z, numbers)
    return LegState(room, room.distance, (room.x, room.z), 1.0 / room.distance, 1.0, (0.0, 0.0))


def prs_reach(x: float, z: float, numbers: Numbers) -> float:
    """Return the square of the rod's component along the slide of a PRS leg, negative if the rod is too short."""
    rod, direction, _ = numbers
    across = cos(direction) * z - sin(direction) * x
    return (rod - across) * (rod + across)


def prs_reading(x: float, z: float, middle: float, numbers: Numbers) -> float:
    """Return the place of a PRS leg's carriage along its slide, NaN where the rod is too short."""
    _, direction, sign = numbers
    return cos(direction) * x + sin(direction) * z + sign * sqrt(prs_reach(x, z, numbers))


def prs_circle(reading: float, numbers: Numbers) -> Circle:
    """Return the circle of a PRS leg's ball about its carriage."""
    rod, direction, _ = numbers
    return Circle(reading * cos(direction), reading * sin(direction), rod)


def prs_slope(x: float, z: float, reading: float, numbers: Numbers) -> float:
    """Return κ of a PRS leg: the cosine of the angle between slide and rod."""
    rod, direction, _ = numbers
    return (cos(direction) * x + sin(direction) * z - reading) / rod


def prs_up(first: Numbers, second: Numbers, third: Numbers) -> float:
    """Return -1 if the carriages of a stage are ahead of the balls on slides that rise, the platform hanging, else 1.

    The arguments are the numbers of the three legs. Slides that rise by less than 0.05 rad on average are level: errors
    of manufacture must not turn a stage over.
    """
    ahead = first[2] * sin(first[1]) + second[2] * sin(second[1]) + third[2] * sin(third[1])
    return where(ahead > 0.15, -1.0, 1.0)


def prs_home(x: float, height: float, least: float, numbers: Numbers) -> float:
    """Return the position of a PRS leg's carriage in the home: the pivot."""
    return 0.0


def prs_passive(x: float, z: float, reading: float) -> tuple[float, float]:
    """Return a direction in the frame of a PRS leg's carriage, which does not turn."""
    return x, z


def prs_largest_slope(numbers: Numbers) -> float:
    """Return the κ of a PRS leg that is largest in magnitude, with the sign of its working mode."""
    _, _, sign = numbers
    return -sign


def prs_room(x: float, z: float, numbers: Numbers) -> Room:
    """Return the room of a PRS leg: the rod's length minus the ball's distance from the slide."""
    rod, direction, _ = numbers
    cosine, sine = cos(direction), sin(direction)
    across = cosine * z - sine * x
    side = where(across < 0.0, -1.0, 1.0)
    return Room(rod - magnitude(across), side * sine, -side * cosine)


def prs_state(x: float, z: float, numbers: Numbers) -> LegState:
    """Return the state of a PRS leg."""
    room = prs_room(x, z, numbers)
    x, z = _within(x, z, room, numbers[0])
    reading, slide = prs_reading(x, z, 0.0, numbers), (cos(numbers[1]), sin(numbers[1]))
    gain = _gain(prs_slope(x, z, reading, numbers), 1.0)
    return _on_circle(room, reading, x, z, prs_circle(reading, numbers), gain, slide)


def rrs_reach(x: float, z: float, numbers: Numbers) -> float:
    """Return 16 times the squared area of the triangle of crank, rod and ball, negative if these make no triangle."""
    crank, rod, _ = numbers
    square, longest, shortest = x * x + z * z, crank + rod, crank - rod
    return (longest * longest - square) * (square - shortest * shortest)


def rrs_crank(x: float, z: float, numbers: Numbers) -> tuple[float, float]:
    """Return x² + z² times cosine and sine of the angle of an RRS leg's crank; NaN out of its reach."""
    crank, rod, sign = numbers
    # Coordinates of the knee along the line from pivot to ball, and perpendicular, times that line's length.
    along = (x * x + z * z + (crank + rod) * (crank - rod)) / (2.0 * crank)
    beside = sign * sqrt(rrs_reach(x, z, numbers)) / (2.0 * crank)
    return x * along - z * beside, z * along + x * beside


def rrs_reading(x: float, z: float, middle: float, numbers: Numbers) -> float:
    """Return the angle of an RRS leg's crank from x towards z, nearest to `middle`; NaN out of its reach."""
    return _crank_angle(*rrs_crank(x, z, numbers), middle)


def crank_middle(low: float, high: float, offset: float) -> float:
    """Return the angle to which a crank's readings without offset are nearest: the middle of its limits, or π/2."""
    is_limited = both(low > -INFINITY, high < INFINITY)
    middle = 0.5 * (where(is_limited, low, 0.0) + where(is_limited, high, 0.0)) - offset
    return where(is_limited, middle, RIGHT_ANGLE)


def from_middle(cosine: float, sine: float, middle: float) -> tuple[float, float]:
    """Return multiples of cosine and sine of an angle less `middle`, from those of the angle."""
    c, s = cos(middle), sin(middle)
    return c * cosine + s * sine, c * sine - s * cosine


def _crank_angle(cosine: float, sine: float, middle: float) -> float:
    along, across = from_middle(cosine, sine, middle)
    return middle + arctan2(across, along)


def rrs_circle(reading: float, numbers: Numbers) -> Circle:
    """Return the circle of an RRS leg's ball about its knee."""
    crank, rod, _ = numbers
    return Circle(crank * cos(reading), crank * sin(reading), rod)


def rrs_slope(x: float, z: float, reading: float, numbers: Numbers) -> float:
    """Return κ of an RRS leg [m/rad]: the lever arm of the rod about the crank's axis."""
    return _lever_arm(x, z, rrs_circle(reading, numbers))


def _lever_arm(x: float, z: float, circle: Circle) -> float:
    return (z * circle.x - x * circle.z) / circle.radius


def rrs_room(x: float, z: float, numbers: Numbers) -> Room:
    """Return the room of an RRS leg: distance of the ball from the positions with crank and rod in line."""
    crank, rod, _ = numbers
    distance = sqrt(x * x + z * z)
    stretched, folded = crank + rod - distance, distance - magnitude(crank - rod)
    way = where(stretched < folded, -1.0, 1.0) / distance
    return Room(where(stretched < folded, stretched, folded), way * x, way * z)


def rrs_home(x: float, height: float, least: float, numbers: Numbers) -> float:
    """Return the angle of an RRS leg's crank with the ball in the middle of the leg's reach."""
    crank, rod, _ = numbers
    reach = 0.5 * (larger(magnitude(x), magnitude(crank - rod)) + crank + rod)
    return rrs_reading(x, sqrt((reach - x) * (reach + x)), RIGHT_ANGLE, numbers)


def rrs_passive(x: float, z: float, reading: float) -> tuple[float, float]:
    """Return a direction in the frame of an RRS leg's crank."""
    cosine, sine = cos(reading), sin(reading)
    return cosine * x + sine * z, cosine * z - sine * x


def rrs_largest_slope(numbers: Numbers) -> float:
    """Return the κ of an RRS leg [m/rad] that is largest in magnitude, with the sign of its working mode."""
    crank, _, sign = numbers
    return -sign * crank


def rrs_state(x: float, z: float, middle: float, numbers: Numbers) -> LegState:
    """Return the state of an RRS leg."""
    room = rrs_room(x, z, numbers)
    x, z = _within(x, z, room, numbers[0] + numbers[1])
    cosine, sine = rrs_crank(x, z, numbers)
    scale = numbers[0] / (x * x + z * z)
    circle = Circle(scale * cosine, scale * sine, numbers[1])
    gain = _gain(_lever_arm(x, z, circle), numbers[0])
    return _on_circle(room, _crank_angle(cosine, sine, middle), x, z, circle, gain, (-circle.z, circle.x))


def leg_rates(leg: LegState, x: float, z: float) -> LegRates:
    """Return the rates of a leg whose ball moves with the velocity (x, z) in its plane."""
    (ux, uz), (cx, cz) = leg.direction, leg.centre_rate
    reading = leg.gain * (ux * x + uz * z)
    turn = leg.curvature * (uz * (x - cx * reading) - ux * (z - cz * reading))
    return LegRates(reading, turn, leg.room.x * x + leg.room.z * z)


def _on_circle(
    room: Room, reading: float, x: float, z: float, circle: Circle, gain: float, centre_rate: tuple[float, float]
) -> LegState:
    curvature = 1.0 / circle.radius
    direction = curvature * (x - circle.x), curvature * (z - circle.z)
    return LegState(room, reading, direction, curvature, gain, centre_rate)


def _gain(slope: float, largest_slope: float) -> float:
    least = _LEAST_SLOPE * largest_slope
    return slope / larger(slope * slope, least * least)


def _within(x: float, z: float, room: Room, length: float) -> tuple[float, float]:
    """Return a ball's position, or the nearest one within the reach of a leg of this length."""
    lack = larger(_WITHIN * length - room.distance, 0.0)
    return x + lack * room.x, z + lack * room.z
