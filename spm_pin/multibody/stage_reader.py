"""A tripod that somebody described, in MJCF, URDF or SDF, as a `Stage`: its dimensions are measured in its home."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.loops.closed_chain import ClosedChain as LoopChain
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.leg_kinds import KINDS, PRS, RPS, RRS, LegKind
from spm_pin.machine.legs import RADIAL, LegLimits, Legs
from spm_pin.machine.stage import Stage
from spm_pin.multibody.tripod_legs import LETTERS, LegJoint, Tripod, find_legs
from spm_pin.support.arguments import FloatArray, frozen, real_array, real_number
from spm_pin.support.pose import PoseLike, as_rigid_transform

_STRAIGHT = 1e-3
"""Sine of the angle between crank and rod, or cosine of that between slide and rod, below which the working mode is
not clear."""
_LEVEL = 0.05
"""Rise of a slide up to which its readings increase outwards instead of upwards."""
_CLEAR = 0.1
"""Least difference of two singular values of the hinges' axes for which a normal to the axes is clear."""
_UPRIGHT = 1e-3
"""Sine of the angle between a hinge's axis and z of {B} up to which the leg's plane is level."""
_FAR = 10.0
"""Limits of slides beyond this many times the size of the stage stand for none in files that must have limits."""
_TURN_ROUNDING = 1e-6
"""Lack of a range of cranks to a full turn that is rounding [rad]."""
_OTHER_MODE = 1e-2
"""Difference of readings in the home, relative to the machine's size or in rad, that is no rounding."""


@dataclass(frozen=True, eq=False)
class MeasuredStage:
    """A stage measured in a closed chain, and how its readings and frames are found there; read-only.

    Joint values are those of `joints` in the file; readings are those of the stage, in the order of its legs 1, 2, 3.

    Attributes
    ----------
    stage : Stage
        The stage, with the limits of the actuated joints. It is nominal if it is to the tolerance. Encoder offsets are
        zero: the readings are those of the legs' own dimensions.
    joints : tuple of str
        Names of the actuated joints, in the order of the file.
    legs : ndarray of int, shape (3,)
        Indices in `joints` of the joints that drive legs 1, 2, 3.
    signs, zeros : ndarray, shape (3,)
        For each leg: reading = sign · (joint value) + zero [m] ([rad] for RRS legs).
    base : RigidTransform
        Pose of the stage's frame {B} in the world.
    platform : str
        Name of the frame of the platform's heaviest body.
    platform_pose : RigidTransform
        Pose of the stage's frame {n} in this frame.
    """

    stage: Stage
    joints: tuple[str, ...]
    legs: npt.NDArray[np.intp]
    signs: FloatArray
    zeros: FloatArray
    base: RigidTransform
    platform: str
    platform_pose: RigidTransform

    def readings(self, values: npt.ArrayLike) -> FloatArray:
        """Return the readings (..., 3) for joint values (..., 3)."""
        array = real_array(values, "values", (3,), "of the actuated joints in rad and m", allow_nan=True)
        return np.asarray(self.signs * array[..., self.legs] + self.zeros)

    def values(self, readings: npt.ArrayLike) -> FloatArray:
        """Return the joint values (..., 3) for readings (..., 3)."""
        array = real_array(readings, "readings", (3,), f"of legs 1, 2, 3 in {self.stage.unit}", allow_nan=True)
        values = np.empty(array.shape)
        values[..., self.legs] = self.signs * (array - self.zeros)
        return values


class _Leg(NamedTuple):
    """A leg in the world, in the chain's home."""

    name: str  # of its actuated joint
    value: float  # of that joint
    motion: FloatArray  # axis of that joint
    axis: FloatArray  # normal of the leg's plane
    pivot: FloatArray  # for PRS legs the knee with the slide at zero
    knee: FloatArray  # centre of the ball's circle
    ball: FloatArray


def read_stage(chain: LoopChain, *, base: PoseLike | None = None, tolerance: float = 1e-9) -> MeasuredStage:
    """Measure the tripod of a chain, such as ``loops.ClosedChain.from_mjcf("tripod.xml")``, and return a `Stage`.

    Legs may stand in any order and direction; axes have either sense, points anywhere along them. A ball is a ball
    joint, a point that closes a loop, or three hinges that meet. Working modes are those of the home, `chain.close()`.

    Parameters
    ----------
    chain : spm_pin.loops.ClosedChain
        A chain with three legs RPS, PRS or RRS between the world and one platform, the first P or R actuated but for
        RPS the P. Other bodies, such as a ball on the plate, are left out.
    base : PoseLike, optional
        Pose of {B} in the world. By default z is normal to the plane of the pivots, of PRS legs to the axes of the
        hinges, towards the platform; the origin is where the legs' planes meet at the height of the pivots; leg 1 is
        the one of the first actuator, and x is such that the legs are at -30, 90 and 210 degrees on average.
    tolerance : float
        Rounding of the numbers in the file, relative to the size or in rad: errors up to it are neglected.

    Returns
    -------
    MeasuredStage
        The stage, and the relation of its readings and frames to those of the chain.

    Raises
    ------
    DescriptionError
        No such tripod; the error says what was found instead.
    GeometryError
        No `Stage` has these dimensions or limits.
    """
    if not isinstance(chain, LoopChain):
        received = f"{type(chain).__module__}.{type(chain).__name__}"
        raise ArgumentError(
            "chain", "a ClosedChain of spm_pin.loops", received, "Its from_mjcf and from_urdf read files"
        )
    rounding = real_number(tolerance, "tolerance", "a number above 0, at most 0.1", above=0.0, most=0.1)
    q = chain.close()
    size = chain.rows.size
    tripod = find_legs(chain, q, rounding * size)
    kinds = {"".join(LETTERS[joint.kind] for joint in leg) for leg in tripod.legs}
    if len(kinds) > 1:
        raise DescriptionError("chain", "three legs of one kind", ", ".join(sorted(kinds)))
    kind = KINDS[kinds.pop()]
    legs = [_measured(kind, leg, chain, q, rounding, size) for leg in tripod.legs]
    legs.sort(key=lambda leg: chain.actuated.index(leg.name))
    joints = tuple(leg.name for leg in legs)
    placed = _fitted_base(kind, legs) if base is None else _checked_pose(base)
    order = _order(placed, legs, None if base is None else RADIAL)
    legs = [legs[k] for k in order]
    if base is None:
        placed = _turned_about_z(placed, _mean_turn(RADIAL, _outward(placed, legs)))
    plate, radius = _plate(placed, legs)
    stage, signs, zeros = _stage(kind, placed, plate, radius, legs, chain, rounding)
    platform, pose = _platform(chain, q, tripod)
    platform_pose = pose.inv() * placed * plate
    found = MeasuredStage(stage, joints, frozen(np.array(order)), signs, zeros, placed, platform, platform_pose)
    _check_home(found, legs, plate)
    return found


def _measured(
    kind: type[LegKind], joints: tuple[LegJoint, ...], chain: LoopChain, q: FloatArray, rounding: float, size: float
) -> _Leg:
    """Return the points of a leg, all in the plane through its ball; raise `DescriptionError` if it is not planar."""
    first, second, ball = joints[0], joints[1], joints[2].point
    motion = second if kind is RPS else first
    value = float(q[chain.indices_in_q(motion.name)[0]])

    def in_plane(hinge: LegJoint) -> FloatArray:
        return np.asarray(hinge.point + hinge.axis * (hinge.axis @ (ball - hinge.point)))

    rounded = "Rounded numbers in the file? The argument tolerance admits them"
    if kind is RRS:
        turn = float(np.linalg.norm(np.cross(first.axis, second.axis)))
        if turn > rounding:
            expected = f"parallel axes of {first.name!r} and {second.name!r}"
            raise DescriptionError("chain", expected, f"an angle of {math.asin(min(turn, 1.0)):.3g} rad", rounded)
        return _Leg(first.name, value, first.axis, first.axis, in_plane(first), in_plane(second), ball)
    hinge = first if kind is RPS else second
    rise = float(motion.axis @ hinge.axis)
    if abs(rise) > rounding:
        expected = f"the axis of {hinge.name!r} perpendicular to the slide {motion.name!r}"
        raise DescriptionError("chain", expected, f"{math.asin(min(abs(rise), 1.0)):.3g} rad beside that", rounded)
    knee = in_plane(hinge)
    if kind is PRS:
        return _Leg(first.name, value, motion.axis, hinge.axis, knee - value * motion.axis, knee, ball)
    beside = float(np.linalg.norm(np.cross(motion.axis, ball - knee)))
    if beside > rounding * size:
        expected = f"a ball that the slide {motion.name!r} moves straight away from the axis of {hinge.name!r}"
        raise DescriptionError("chain", expected, f"a line that passes {beside:.3g} m beside the axis", rounded)
    return _Leg(motion.name, value, motion.axis, hinge.axis, knee, knee, ball)


def _fitted_base(kind: type[LegKind], legs: list[_Leg]) -> RigidTransform:
    """Return {B} in the world, but for its rotation about z."""
    axes, pivots = (np.array([getattr(leg, name) for leg in legs]) for name in ("axis", "pivot"))
    if kind is PRS:
        # Pivots are anywhere on their slides.
        _, sizes, rows = np.linalg.svd(axes)
        if sizes[1] - sizes[2] < _CLEAR:
            received = "none, by the singular values " + ", ".join(f"{size:.3g}" for size in sizes)
            cause = "Without it z of {B} is not clear: give the argument base"
            raise DescriptionError("chain", "one normal to the axes of the three hinges", received, cause)
        z = rows[2]
    else:
        z = _normal(pivots, "pivots")
    if sum(float(z @ (leg.ball - leg.knee)) for leg in legs) < 0.0:
        z = -z
    middle = pivots.mean(axis=0)
    level = axes - (axes @ z)[:, None] * z
    centre = middle + np.linalg.lstsq(level, (level * (pivots - middle)).sum(axis=-1), rcond=1e-6)[0]
    x = np.cross(np.eye(3)[int(np.abs(z).argmin())], z)
    return _frame(centre, x / np.linalg.norm(x), z)


def _frame(origin: FloatArray, x: FloatArray, z: FloatArray) -> RigidTransform:
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, np.cross(z, x), z, origin], axis=-1)
    return RigidTransform.from_matrix(matrix)


def _checked_pose(base: PoseLike) -> RigidTransform:
    pose = as_rigid_transform(base, "base")
    if pose.shape:
        raise ArgumentError("base", "a single pose", f"shape {pose.shape}")
    return pose


def _normal(points: FloatArray, what: str) -> FloatArray:
    """Return the unit normal of three points, about which they are counterclockwise."""
    sides = points[1] - points[0], points[2] - points[0]
    normal = np.cross(*sides)
    length = float(np.linalg.norm(normal))
    if length <= 1e-6 * max(float(side @ side) for side in sides):
        raise DescriptionError("chain", f"three {what} that form a triangle", f"{what} on one line")
    return np.asarray(normal / length)


def _outward(base: RigidTransform, legs: list[_Leg]) -> FloatArray:
    """Return the horizontal unit vectors of the legs' planes away from z, in {B}, as rows (3, 3)."""
    axes, ends = base.rotation.inv().apply([leg.axis for leg in legs]), [(leg.pivot, leg.ball) for leg in legs]
    outward = np.stack([-axes[:, 1], axes[:, 0], np.zeros(3)], axis=-1)
    if (np.linalg.norm(outward, axis=-1) < _UPRIGHT).any():
        raise DescriptionError(
            "chain", "axes of hinges that are not parallel to z of {B}", "an axis along z", "A planar mechanism?"
        )
    points = base.inv().apply(np.reshape(ends, (6, 3))).reshape(3, 2, 3).sum(axis=1)
    outward *= np.sign((outward * points).sum(axis=-1))[:, None]
    return np.asarray(outward / np.linalg.norm(outward, axis=-1)[:, None])


def _order(base: RigidTransform, legs: list[_Leg], towards: FloatArray | None) -> list[int]:
    """Return the legs counterclockwise about z, from the first on, or those nearest to three directions."""
    outward = _outward(base, legs)
    azimuths = np.arctan2(outward[:, 1], outward[:, 0])
    order = np.argsort(np.mod(azimuths - azimuths[0], 2.0 * np.pi)).tolist()
    turned = [order[k:] + order[:k] for k in range(3)]
    return turned[0] if towards is None else max(turned, key=lambda x: float((towards * outward[x]).sum()))


def _turned_about_z(frame: RigidTransform, angle: float) -> RigidTransform:
    x, y, z = frame.rotation.as_matrix().T
    return _frame(frame.translation, math.cos(angle) * x + math.sin(angle) * y, z)


def _mean_turn(directions: FloatArray, turned: FloatArray) -> float:
    """Return the angle about z from vectors to others that are turned, both as rows (3, 3)."""
    return math.atan2(float(np.cross(directions, turned)[:, 2].sum()), float((directions * turned).sum()))


def _plate(base: RigidTransform, legs: list[_Leg]) -> tuple[RigidTransform, float]:
    """Return {n} in {B}, at the centre of the circle through the balls, and the radius of this circle."""
    balls = base.inv().apply([leg.ball for leg in legs])
    a, b, z = balls[0] - balls[2], balls[1] - balls[2], _normal(balls, "balls")
    c = np.cross(a, b)
    arm = np.cross(float(a @ a) * b - float(b @ b) * a, c) / (2.0 * float(c @ c))
    radius = float(np.linalg.norm(arm))
    frame = _frame(balls[2] + arm, -arm / radius, z)
    return _turned_about_z(frame, _mean_turn(_outward(base, legs), frame.inv().apply(balls))), radius


def _stage(
    kind: type[LegKind],
    base: RigidTransform,
    plate: RigidTransform,
    radius: float,
    legs: list[_Leg],
    chain: LoopChain,
    rounding: float,
) -> tuple[Stage, FloatArray, FloatArray]:
    """Return the stage, nominal if it is to rounding, and the signs and zeros of its readings."""
    to_base = base.inv()
    pivots, knees, balls = (to_base.apply([getattr(leg, x) for leg in legs]) for x in ("pivot", "knee", "ball"))
    axes, motions = (to_base.rotation.apply([getattr(leg, x) for leg in legs]) for x in ("axis", "motion"))
    values, own_balls = np.array([leg.value for leg in legs]), plate.inv().apply(balls)
    # Only for the planes of legs, which have the same x and z in every kind.
    outward, forward = Legs(axes, pivots, own_balls, np.zeros(3), (RPS(),)).planes

    def in_planes(vectors: FloatArray) -> FloatArray:
        return np.stack([(vectors * outward).sum(axis=-1), (vectors * forward).sum(axis=-1)], axis=-1)

    arms, rods, slides = in_planes(knees - pivots), in_planes(balls - knees), in_planes(motions)
    lengths = np.linalg.norm(rods, axis=-1)
    numbers: tuple[Any, ...] = ()
    if kind is RPS:
        signs = np.sign((slides * rods).sum(axis=-1))
        zeros = lengths - signs * values
    elif kind is PRS:
        signs = np.where(np.abs(slides[:, 1]) > _LEVEL, np.sign(slides[:, 1]), np.sign(slides[:, 0]))
        slides, along = slides * signs[:, None], motions * signs[:, None]
        modes = _modes(-(rods * slides).sum(axis=-1) / lengths, legs)
        numbers = lengths, np.arctan2(slides[:, 1], slides[:, 0]), modes
        # Pivots are moved along the slides to places that are alike in the three legs; their mean stays.
        zeros = (pivots * along).sum(axis=-1)
        zeros -= zeros.mean()
        zeros[np.abs(zeros) <= rounding * lengths.max()] = 0.0
        pivots = pivots - zeros[:, None] * along
    else:
        cranks = np.linalg.norm(arms, axis=-1)
        beside = rods[:, 0] * arms[:, 1] - rods[:, 1] * arms[:, 0]
        modes = _modes(beside / (cranks * lengths), legs)
        numbers = cranks, lengths, modes
        signs = np.sign((motions * np.cross(outward, forward)).sum(axis=-1))
        zeros = np.arctan2(arms[:, 1], arms[:, 0]) - signs * values
    measured = Legs(axes, pivots, own_balls, np.zeros(3), (kind(*map(tuple, numbers)),))
    stage = Stage(float(in_planes(pivots)[:, 0].mean()), radius, measured)
    zeros, limits = _limits(stage, legs, chain, signs, zeros)
    return _simplest(replace(stage, limits=limits), rounding), frozen(signs), frozen(zeros)


def _modes(sines: FloatArray, legs: list[_Leg]) -> tuple[int, ...]:
    """Return the signs of the working modes."""
    if np.abs(sines).min() < _STRAIGHT:
        name = legs[int(np.abs(sines).argmin())].name
        expected = "a home away from the singularities of the legs, which shows their working modes"
        raise DescriptionError("chain", expected, f"the leg of {name!r} at one", "A keyframe sets the home")
    return tuple(int(x) for x in np.sign(sines))


def _limits(
    stage: Stage, legs: list[_Leg], chain: LoopChain, signs: FloatArray, zeros: FloatArray
) -> tuple[FloatArray, LegLimits | None]:
    """Return the zeros of the readings, for cranks in the turn of their limits, and the limits."""
    places, kind = chain.indices_in_q(*(leg.name for leg in legs)), stage.kind
    ends = np.array([chain.model.lowerPositionLimit[places], chain.model.upperPositionLimit[places]])
    for leg, low, high in zip(legs, *ends, strict=True):
        if not low < high:
            received = f"[{low:g}, {high:g}]"
            raise DescriptionError("chain", f"limits of {leg.name!r}, lower < upper", received, "Are they missing?")
    limits = np.sort(signs * ends + zeros, axis=0)
    if isinstance(kind, RRS):
        # A crank that turns all around has no limits.
        limits[:, np.ptp(limits, axis=0) > 2.0 * np.pi - _TURN_ROUNDING] = np.array([[-np.inf], [np.inf]])
        home = signs * np.array([leg.value for leg in legs]) + zeros
        middles = np.where(np.isfinite(limits).all(axis=0), limits, home).mean(axis=0)
        turns = 2.0 * np.pi * np.round((middles - np.pi / 2.0) / (2.0 * np.pi))
        zeros, limits = zeros - turns, limits - turns
    else:
        limits[np.abs(limits) > _FAR * stage.size] *= np.inf
    limits[0] = np.maximum(limits[0], kind.least_reading)
    are_free = (limits[0] == kind.least_reading).all() and np.isinf(limits[1]).all()
    return zeros, None if are_free else LegLimits(limits[0].tolist(), limits[1].tolist())


def _platform(chain: LoopChain, q: FloatArray, tripod: Tripod) -> tuple[str, RigidTransform]:
    """Return the name of the platform's heaviest body, and its pose in the world."""
    model, data = chain.model, chain.model.createData()
    pin.framesForwardKinematics(model, data, q)
    bodies = [k for k, x in enumerate(model.frames) if x.parentJoint in tripod.platform]
    bodies = [k for k in bodies if model.frames[k].type == pin.FrameType.BODY] or bodies
    heaviest = max(bodies, key=lambda k: float(model.frames[k].inertia.mass))
    return str(model.frames[heaviest].name), RigidTransform.from_matrix(data.oMf[heaviest].homogeneous)


def _simplest(stage: Stage, rounding: float) -> Stage:
    """Return the stage with equal numbers in its legs, or the nominal one, if it is that to rounding."""
    alike = stage.kind.nominal
    if not alike.has_equal_legs or np.abs(stage.kind.numbers - alike.numbers).max(initial=0.0) > rounding * min(
        stage.size, 1.0
    ):
        return stage
    legs = Legs(*stage.legs.arrays, (alike,))
    angles, *lengths = legs.deviations(stage.nominal.legs)
    worst = max(float(angles.max()), *(float(x.max()) / stage.size for x in lengths))
    return stage.nominal if worst <= rounding else replace(stage, legs=legs)


def _check_home(found: MeasuredStage, legs: list[_Leg], pose: RigidTransform) -> None:
    """Raise `DescriptionError` unless the home is a physical state of the stage with the readings of the chain."""
    state, expected = Configuration(found.stage, pose), np.empty(3)
    expected[found.legs] = [leg.value for leg in legs]
    apart = np.abs(state.readings - found.readings(expected)) / (1.0 if found.stage.unit == "rad" else found.stage.size)
    if not (bool(state.is_at_home) and apart.max() <= _OTHER_MODE):
        wanted = "a home in the physical assembly mode, to which the level platform tilts without a singularity"
        cause = "Another home, by a keyframe? Or, with the argument base, z away from the platform?"
        raise DescriptionError("chain", wanted, f"readings {found.readings(expected).round(4).tolist()}", cause)
