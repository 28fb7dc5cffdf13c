"""Certified branches: whether each family is real, and bounds of the distance of computed joints to the exact ones.

A discriminant above the bound of its rounding error has the computed sign. The others are computed by the same formulas
in balls (python-flint), with more digits until the ball leaves zero, and the joints with them. The exact
rotation is that of the quaternion that the kernels compute from a rotation matrix, because a matrix of doubles is
orthogonal to rounding only; pose and legs of a calibrated machine are taken as the exact numbers that are stored.

For the joints, the nine coordinates x of the lower legs' balls are unknown, and the equations, of degree two, are the
six leg planes, the upper legs' balls being combinations of the lower ones, and the three distances. With A an
approximate inverse of the Jacobian J, the map δ -> δ - A F(x + δ) contracts a cube into itself if the bounds of |A F|,
of |1 - A J| and of the quadratic part allow it, and has then one fixed point there, the only solution. All bounds are
computed with outward rounding. See `docs/theory/proofs.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from flint import arb, ctx

from spm_pin.formulas import branches as formulas
from spm_pin.formulas.leg_planes import upper_ball_weights, upper_balls
from spm_pin.formulas.operations import bind
from spm_pin.formulas.stages import cartesian
from spm_pin.formulas.vectors import combined, cross, dot, minus, rotation_of, scaled, times
from spm_pin.kinematics.batches import BuiltBranches, DrawnBranches
from spm_pin.kinematics.intervals import SQRT_3, Interval
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.manipulator import Manipulator
from spm_pin.machine.solutions import Status
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray

Vectors = Any
"""Vectors of intervals or balls instead of numbers, which formulas take as well."""
_SAFE = 1.0 + 1e-12
"""Factor for the rounding of a few products of bounds."""
_CHUNK = 1 << 14
"""Number of branches whose radii are computed together."""
_BITS = 400, 1600, 6400
"""Precisions in which a discriminant is computed; one that is zero in the last is left undecided."""


def certify_branches(machine: Manipulator, solved: DrawnBranches | BuiltBranches) -> FloatArray:
    """Return bounds (N, 8) of the error of all joints; decide the families that are not certain, in place."""
    from spm_pin.kinematics.kernels.branch_kernels import VERTICAL

    radius = _radii(machine, solved)
    if isinstance(solved, DrawnBranches):  # a calibrated machine has no families
        flagged = solved.flagged[:, None]
        _decide_families(
            machine, solved, ~solved.certain & (flagged & [1, 2, 4, 8] == 0) & (flagged & VERTICAL == 0), radius
        )
    return radius


def _decide_families(machine: Manipulator, solved: DrawnBranches, undecided: BoolArray, radius: FloatArray) -> None:
    """Compute the families `undecided` (N, 4), and their radii (N, 8), with higher precision."""
    rotation, position, joints, lengths, discriminants, certain, at_home, status, _ = solved
    for n in np.flatnonzero(undecided.any(axis=-1)):
        families = _families_in_balls(rotation[n], position[n], machine.middle_side)
        for family in np.flatnonzero(undecided[n]).tolist():
            if (exact := families[family]) is not None:
                pair = slice(2 * family, 2 * family + 2)
                certain[n, family] = True
                discriminants[n, family], joints[n, pair], radius[n, pair] = exact
        anew = np.repeat(undecided[n] & certain[n], 2)
        # The exact joints are known; they are unique nearby if all other solutions are known to be farther away.
        apart = np.linalg.norm(joints[n][:, None] - joints[n], axis=-1).max(axis=-1)
        far = (apart > _SAFE * (radius[n] + radius[n][:, None])) | np.isnan(apart) | np.eye(8, dtype=np.bool_)
        radius[n, anew & ~(far.all(axis=-1) & (None not in families))] = np.nan
        branches = Configuration.from_arrays(
            machine, np.broadcast_to(rotation[n], (8, 3, 3)), np.broadcast_to(position[n], (8, 3)), joints[n]
        )
        lengths[n] = np.where(anew[:, None], branches.leg_lengths, lengths[n])
        if status[n] in (Status.OK, Status.UNREACHABLE):
            status[n] = Status.OK if branches.exists.any() else Status.UNREACHABLE
        if anew[0]:
            at_home[n, :2] = branches[:2].is_at_home


_ExactFamily = tuple[float, FloatArray, FloatArray]
"""Discriminant of a family over r², joints (2, 3, 3) of its branches [m], and distances to the exact ones."""


def _families_in_balls(rotation: FloatArray, position: FloatArray, side: float) -> list[_ExactFamily | None]:
    """Return the families of a pose from ball arithmetic; None if the sign of a discriminant is not known."""
    solved: list[_ExactFamily | None] = [None] * 4
    entries: Any = [[arb(x) for x in row] for row in rotation.tolist()]
    place: Any = [arb(x) for x in position.tolist()]
    for bits in _BITS:
        with ctx.workprec(bits):
            r: Any = arb(side) / arb(3).sqrt()
            quaternion = formulas.quaternions(entries)[int(_largest_component(rotation))]
            frame = _in_balls(formulas.pose_frame)(quaternion, place, r)
            if frame.is_vertical:
                break
            for k, family in enumerate(_in_balls(formulas.families)(frame, r)):
                discriminant: Any = formulas.discriminant(family)
                if solved[k] is None and (discriminant > 0 or discriminant < 0):
                    joints, errors = np.full((2, 3, 3), np.nan), np.full(2, np.nan)
                    for branch, sign in enumerate((1.0, -1.0) if discriminant > 0 else ()):
                        u, v, square = formulas.root(family, sign, discriminant.sqrt())
                        b = _in_balls(formulas.middle_joints)(u, v, r / square, family, frame, place)
                        joints[branch], errors[branch] = _rounded(_in_balls(cartesian)(*b))
                    solved[k] = float(discriminant / r**2), joints, errors
        if None not in solved:
            break
    return solved


def _in_balls(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Return a formula for balls of the working precision, and for the quaternion of a pose instead of its matrix."""
    return bind(formula, sqrt=arb.sqrt, COS_30=arb(3).sqrt() / 2, quaternion=_normalised)


def _normalised(quaternion: Vectors) -> Vectors:
    length = sum(x * x for x in quaternion).sqrt()
    return tuple(x / length for x in quaternion)


def _rounded(points: Vectors) -> tuple[FloatArray, float]:
    """Return the doubles nearest to three points, and the largest distances of the points from them."""
    doubles = np.array([[float(x) for x in point] for point in points])
    squares = [
        sum((x - y) ** 2 for x, y in zip(*pair, strict=True)) for pair in zip(points, doubles.tolist(), strict=True)
    ]
    return doubles, max(float(np.nextafter(float(square.abs_upper().sqrt()), np.inf)) for square in squares)


def _largest_component(rotation: FloatArray) -> IntArray:
    """Return which of `branches.quaternions` kernels use for matrices (..., 3, 3): that of the largest component."""
    a, b, c = np.moveaxis(np.diagonal(rotation, axis1=-2, axis2=-1), -1, 0)
    return np.asarray(np.argmax([a + b + c, c, b, a], axis=0))


def _radii(machine: Manipulator, solved: DrawnBranches | BuiltBranches) -> FloatArray:
    """Return radii (N, 8) [m] around joints in which exactly one solution exists; NaN if not proved."""
    joints = solved.joints.reshape(-1, 3, 3)
    radius = np.full(len(joints), np.nan)
    legs, enclosed = (_nominal_legs, _enclosed_rotation) if machine.is_nominal else (_legs, _rows)
    pieces = legs(machine)
    existing = np.flatnonzero(np.isfinite(joints[:, 0, 0]))
    for first in range(0, len(existing), _CHUNK):
        some = existing[first : first + _CHUNK]
        poses = some // 8
        state = _rows(joints[some]), enclosed(solved.rotation[poses]), _vector(solved.position[poses])
        with np.errstate(all="ignore"):
            radius[some] = _radii_of_equations(*pieces, machine.middle_side, *state)
    return radius.reshape(-1, 8)


def _legs(machine: Manipulator) -> tuple[Vectors, Vectors, Vectors, Vectors]:
    """Return axes and pivots of the six legs, enclosures of `upper_ball_weights`, and the squared distances."""
    legs = machine.legs
    axes, pivots, balls = ([_vector(row) for row in array] for array in (legs.axes, legs.pivots, legs.balls))
    edges = [minus(balls[i], balls[(i + 1) % 3]) for i in range(3)]
    lower_and_upper: Vectors = balls[:3], balls[3:]
    return axes, pivots, upper_ball_weights(*lower_and_upper), [dot(edge, edge) for edge in edges]


def _nominal_legs(machine: Manipulator) -> tuple[Vectors, Vectors, Vectors, Vectors]:
    """Return `_legs` for a nominal machine, exactly: all leg planes contain the Z axis of their platform."""
    root, side = 0.5 * SQRT_3, Interval.from_numbers(machine.middle_side)
    half, one, zero = _vector(np.array([0.5, 1.0, 0.0]))
    axes = [(half, root, zero), (one, zero, zero), (-half, root, zero)]
    return 2 * axes, 6 * [(zero,) * 3], 3 * [(zero,) * 3], 3 * [side.square()]


def _enclosed_rotation(rotation: FloatArray) -> Vectors:
    """Return enclosures of R (N,), the rotation of the quaternion that the kernels compute from each matrix."""
    quaternions: Any = formulas.quaternions(_rows(rotation))
    largest = _largest_component(rotation)
    x0, x1, x2, x3 = (
        Interval(*(np.choose(largest, ends) for ends in ([x.low for x in component], [x.high for x in component])))
        for component in zip(*quaternions, strict=True)
    )
    components: Vectors = x1, x2, x3, x0
    return rotation_of(*components)


def _radii_of_equations(
    axes: Vectors,
    pivots: Vectors,
    weights: Vectors,
    squares: Vectors,
    unit: float,
    b: Vectors,
    rows: Vectors,
    o: Vectors,
) -> FloatArray:
    """Return the radii around balls `b` of poses with these rows of R and positions."""
    count = len(o[0].low)
    p, q, upper = minus(b[1], b[0]), minus(b[2], b[0]), upper_balls(b, weights)
    errors: list[Any] = []
    slopes = [[Interval.from_numbers(np.zeros(count)) for _ in range(9)] for _ in range(9)]
    quadratic = np.zeros((count, 9))

    def add(equation: int, ball: int, direction: Vectors) -> None:
        for k in range(3):
            slopes[equation][3 * ball + k] = slopes[equation][3 * ball + k] + direction[k]

    for i in range(6):
        axis: Vectors = axes[i]
        corner = i % 3
        arm: Vectors = minus(b[corner], pivots[i])
        if i >= 3:
            axis, arm = times(rows, axis), minus(minus(upper[corner], o), times(rows, pivots[i]))
            u, v, w = weights[corner]
            along_p = combined(scaled(u, axis), w, cross(q, axis))
            along_q = combined(scaled(v, axis), w, cross(axis, p))
            for other, direction in ((1, along_p), (2, along_q)):
                add(i, other, direction)
                add(i, 0, [-x for x in direction])
            # |δp| and |δq| are at most √12 in units of the cube's half edge.
            quadratic[:, i] = 12.1 * _most(w) * np.linalg.norm([_most(x) for x in axis], axis=0)
        add(i, corner, axis)
        errors.append(dot(axis, arm))
    for k, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        edge = minus(b[i], b[j])
        errors.append((dot(edge, edge) - squares[k]) * (1.0 / unit))
        twice = scaled(2.0 / unit, edge)
        add(6 + k, i, twice)
        add(6 + k, j, [-x for x in twice])
        quadratic[:, 6 + k] = 12.1 / unit
    return _contraction_radii(errors, slopes, quadratic)


def _contraction_radii(errors: list[Interval], slopes: list[list[Interval]], quadratic: FloatArray) -> FloatArray:
    """Return radii around points at which nine equations have these errors, slopes and bounds of their second order."""
    count = len(quadratic)
    entries = [x for row in slopes for x in row]
    low, high = (
        np.stack([np.broadcast_to(x, count) for x in ends], axis=-1).reshape(count, 9, 9)
        for ends in ([x.low for x in entries], [x.high for x in entries])
    )
    middle = 0.5 * (low + high)
    regular = np.isfinite(middle).all(axis=(-1, -2)) & (np.linalg.det(middle) != 0.0)
    inverse = np.linalg.inv(np.where(regular[:, None, None], middle, np.eye(9)))
    size, spread = np.abs(inverse), np.maximum(high - middle, middle - low) * _SAFE
    # A sum of nine products is off by less than 10 eps of the sum of their magnitudes.
    rounding = 1e-14
    sizes = np.stack([_most(x) for x in errors], axis=-1)
    value = np.stack([0.5 * (x.low + x.high) for x in errors], axis=-1)
    width = np.stack([np.maximum(x.high - x.low, 0.0) for x in errors], axis=-1)
    shift = np.abs((inverse @ value[..., None])[..., 0]) + (size @ (rounding * sizes + width)[..., None])[..., 0]
    eta = shift.max(axis=-1) * _SAFE
    defect = np.abs(np.eye(9) - inverse @ middle) + size @ (rounding * np.abs(middle) + spread)
    kappa = defect.sum(axis=-1).max(axis=-1) * _SAFE
    beta = (size @ quadratic[..., None])[..., 0].max(axis=-1) * _SAFE
    half_edge = 2.0 * eta / (1.0 - kappa) * _SAFE
    radius = np.sqrt(3.0) * half_edge * _SAFE
    # Into itself the cube is mapped if 4 β η <= (1 - κ)²; unique is the solution in the cube around the radius too.
    proved = regular & (kappa < 0.5) & (kappa + 2.0 * beta * radius < 0.99)
    return np.where(proved, radius, np.nan)


def _most(x: Interval) -> FloatArray:
    """Return an upper bound of the magnitudes of an interval's numbers."""
    return np.maximum(np.abs(x.low), np.abs(x.high))


def _vector(array: FloatArray) -> Vectors:
    return tuple(Interval.from_numbers(column) for column in np.moveaxis(array, -1, 0))


def _rows(array: FloatArray) -> Vectors:
    return tuple(_vector(row) for row in np.moveaxis(array, -2, 0))
