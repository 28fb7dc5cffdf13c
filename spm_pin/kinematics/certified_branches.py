"""Branches with proof: whether each family is real, and how far from the computed joints the exact ones can be.

A discriminant above the bound of its rounding error has the computed sign; the others are computed without rounding,
see `spm_pin.kinematics.exact_discriminants`. For the joints, joint i moves on the line of its two leg planes, and the
distances of the joints are three quadratic equations f + J t + q(t) = 0 in their places t on these lines, counted from
the computed ones. By the theorem of Newton and Kantorovich they have a solution with |t| <= 2η, and no other one with
|t| <= 1/(8β), if 16 β η <= 1, where η bounds |J⁻¹ f| and β bounds |J⁻¹|: |q(t)| <= 4 |t|² for lines in unit steps.
All bounds are computed with outward rounding. See `docs/theory/proofs.md`.

In a machine as built the coordinates x of the lower legs' three balls are unknown, and the equations, of degree two,
are their three distances and the six leg planes, the upper legs' balls being combinations of the lower ones. With A an
approximate inverse of the Jacobian J, the map δ -> δ - A F(x + δ) contracts a cube into itself if the bounds of |A F|,
of |1 - A J| and of the quadratic part allow it, and has then one fixed point there, the only solution.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mpmath
import numpy as np

from spm_pin.kinematics.batches import with_batch_shape
from spm_pin.kinematics.exact_discriminants import BITS, ExactPose, largest_component, quaternions, scaled_rotation
from spm_pin.kinematics.intervals import SQRT_3, Interval
from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.mechanism.branches import physical, tilt_cosine_sum
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solutions import SolutionSet

_SAFE = 1.0 + 1e-12
"""Factor for the rounding of a few products of bounds."""
_CHUNK = 1 << 15
"""Branches whose radii are computed at once."""
_COS_30 = float(np.sqrt(0.75))


def certify_branches(branches: SolutionSet) -> SolutionSet:
    """Decide the families that are not `certain`, and bound the error of all joints, in `radius`.

    The families that are decided are written anew in the memory of `branches`.
    """
    from spm_pin.kinematics.kernels.branch_kernels import VERTICAL

    assert branches.memory is not None
    if branches.degeneracy is None:  # of a machine as built, which has no families
        return replace(branches, radius=_radii_of_six_legs(branches))
    rotation, position, joints, _, _, _, status, flagged = branches.memory
    certain, shape, geometry = np.asarray(branches.certain).reshape(-1, 4), branches.shape, branches.geometry
    vertical = (flagged & VERTICAL) > 0
    undecided = ~certain & ~branches.degeneracy.families.reshape(-1, 4) & ~vertical[:, None]
    radius = _existence_radii(rotation, position, joints, geometry.middle_side)
    decided, precise = _decide_families(geometry, branches.memory, undecided)
    radius = np.where(np.repeat(undecided, 2, axis=-1), precise, radius)
    proved, radius = with_batch_shape((certain | decided, radius), shape)
    return replace(branches, status=status.reshape(shape), proved=proved, radius=radius)


def _decide_families(geometry: Geometry, solved: tuple[Any, ...], undecided: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Decide the families of N poses whose discriminants may have the wrong sign, and compute their branches anew.

    The results of `kernels.branch_kernels.all_branches` are corrected for the families `undecided` (N, 4). Returned is
    for which families (N, 4) it is proved that they are real, or not, as their joints now say: not for continuous ones;
    and the `_existence_radii` (N, 8) of the branches computed anew, NaN of others.
    """
    rotation, position, joints, lengths, discriminants, hint, status, _ = solved
    decided, radii = np.zeros_like(undecided), np.full((len(position), 8), np.nan)
    for n in np.flatnonzero(undecided.any(axis=-1)):
        exact = ExactPose(rotation[n], position[n], geometry.middle_side)
        for family in np.flatnonzero(undecided[n]).tolist():
            sign = exact.sign(family)
            if sign is None:
                continue
            pair = slice(2 * family, 2 * family + 2)
            decided[n, family], discriminants[n, family] = True, exact.discriminant(family)
            joints[n, pair], lengths[n, pair] = np.nan, np.nan
            if sign >= 0:
                for branch in (2 * family, 2 * family + 1):
                    joints[n, branch], radii[n, branch] = _precise_joints(exact, branch)
        branches = Configuration.from_arrays(
            geometry, np.broadcast_to(rotation[n], (8, 3, 3)), np.broadcast_to(position[n], (8, 3)), joints[n]
        )
        lengths[n] = np.where(np.repeat(decided[n], 2)[:, None], branches.leg_lengths, lengths[n])
        if status[n] < 2:
            status[n] = 0 if branches.exists.any() else 1
        if decided[n, 0]:
            hint[n, :2] = physical(branches[:2])
            tilts = tilt_cosine_sum(branches[:2])
            hint[n, 2] = tilts[1] > tilts[0]
    return decided, radii


def _existence_radii(rotation: FloatArray, position: FloatArray, joints: FloatArray, side: float) -> FloatArray:
    """Return radii (N, 8) [m] around computed joints within which exact joints exist, and are the only ones.

    NaN where nothing is proved. The joints (N, 8, 3, 3) [m] are those of the kernels, NaN where a branch is not real.
    """
    found = np.full(joints.shape[:2], np.nan)
    poses, branches = np.nonzero(~np.isnan(joints[..., 0, 0]))
    for first in range(0, len(poses), _CHUNK):
        n, k = poses[first : first + _CHUNK], branches[first : first + _CHUNK]
        along = joints[n, k, :, 1] * np.array([-2.0, 1.0, -2.0])
        matrix = _enclosed_matrix(rotation[n])
        origin = [Interval.of(column) for column in position[n].T]
        radial, upward = ([Interval.of(column) for column in array.T] for array in (along, joints[n, k, :, 2]))
        # The joints are in their lower planes but for the rounding of cos 30°.
        aside = 2.0**-51 * np.abs(along).max(axis=-1)
        found[n, k] = _radius(matrix, origin, side, SQRT_3, radial, upward, aside)
    return found


def _precise_joints(exact: ExactPose, branch: int) -> tuple[FloatArray, float]:
    """Return the joints of a branch (3, 3), computed with more digits, and their radius of existence."""
    radial, upward = exact.middle_joints(branch)
    rounded = np.array([[float(x) for x in radial], [float(z) for z in upward]])
    joints = np.stack([rounded[0] * [_COS_30, 0.0, -_COS_30], rounded[0] * [-0.5, 1.0, -0.5], rounded[1]], axis=-1)
    iv = mpmath.iv
    iv.prec = BITS
    with mpmath.workprec(BITS):
        apart = max(float(abs(a - float(a))) + float(abs(b - float(b))) for a, b in zip(radial, upward, strict=True))
        matrix = [[iv.mpf(entry) / exact.norm for entry in row] for row in exact.matrix]
        origin = [iv.mpf(o) / exact.one for o in exact.position]
        side = iv.mpf(exact.side) / exact.one
        ends = [iv.mpf(x) for x in radial], [iv.mpf(z) for z in upward]
        aside = _SAFE * apart + 2.0**-51 * float(np.abs(rounded[0]).max())
        return joints, float(_radius(matrix, origin, side, iv.sqrt(3), *ends, aside))


def _enclosed_matrix(rotation: FloatArray) -> list[list[Interval]]:
    """Return enclosures of σR (N,), R the rotation of the quaternion that the kernels take from the matrices."""
    entries = [Interval.of(entry) for entry in rotation.reshape(-1, 9).T]
    largest = largest_component(rotation)
    chosen = [
        Interval(np.choose(largest, [x.low for x in component]), np.choose(largest, [x.high for x in component]))
        for component in zip(*quaternions(entries, 1.0), strict=True)
    ]
    return scaled_rotation(chosen, Interval.square)


def _radius(
    matrix: list[list[Any]], origin: list[Any], side: Any, root_3: Any, radial: list[Any], upward: list[Any], aside: Any
) -> FloatArray:
    """Return the radius around joints at radii and heights in their lower planes; numbers are intervals of any kind.

    `matrix` is any multiple of R, `aside` [m] what to add for the distance of the joints proper from these points.
    """
    half_root = 0.5 * root_3
    directions, lines, squares, gaps = [], [], [], []
    for i, (ux, uy) in enumerate(((half_root, -0.5), (0.0, 1.0), (-half_root, -0.5))):
        normal = [row[1] * ux - row[0] * uy for row in matrix]
        across, height = normal[0] * ux + normal[1] * uy, normal[2]
        offset = normal[0] * origin[0] + normal[1] * origin[1] + normal[2] * origin[2]
        square = across * across + height * height
        gap = (across * radial[i] + height * upward[i] - offset) * (1.0 / square)
        directions.append((-height, across))
        lines.append((radial[i] - gap * across, upward[i] - gap * height))
        squares.append(square)
        gaps.append(gap * gap * square)
    slopes, errors = {}, []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        (p, z), (q, w) = lines[i], lines[j]
        rise = z - w
        errors.append(p * p + q * q + p * q + rise * rise - side * side)
        slopes[i, j] = (2.0 * p + q) * directions[i][0] + 2.0 * rise * directions[i][1]
        slopes[j, i] = (2.0 * q + p) * directions[j][0] - 2.0 * rise * directions[j][1]
    a, b, c, e, h, g = (slopes[pair] for pair in ((0, 1), (1, 0), (1, 2), (2, 1), (2, 0), (0, 2)))
    # The equations 12, 23, 31 have the Jacobian [[a, b, 0], [0, c, e], [g, 0, h]].
    adjugate = ((c * h, -(b * h), b * e), (e * g, a * h, -(a * e)), (-(c * g), b * g, a * c))
    with np.errstate(all="ignore"):
        determinant = _least(a * c * h + b * e * g)
        shift = [row[0] * errors[0] + row[1] * errors[1] + row[2] * errors[2] for row in adjugate]
        eta = np.maximum.reduce([_most(x) for x in shift]) / determinant * _SAFE
        beta = np.maximum.reduce([sum(_most(x) for x in row) for row in adjugate]) / determinant * _SAFE
        longest, shortest = (reduce([f(x) for x in squares]) for reduce, f in _EXTREMES)
        radius = _SAFE * (2.0 * eta * np.sqrt(longest) + np.sqrt(np.maximum.reduce([_most(x) for x in gaps])) + aside)
        unique = radius / np.sqrt(shortest) * 8.0 * beta * longest * _SAFE <= 1.0
        proved = unique & (16.0 * beta * longest * eta * _SAFE <= 1.0)
        return np.where(proved, radius, np.nan)


def _most(x: Any) -> Any:
    """Return an upper bound of the magnitudes of an interval's numbers."""
    if isinstance(x, Interval):
        return np.maximum(np.abs(x.low), np.abs(x.high))
    return np.nextafter(max(abs(float(x.a)), abs(float(x.b))), np.inf)


def _least(x: Any) -> Any:
    """Return a lower bound of the magnitudes of an interval's numbers, 0 if it contains zero."""
    if isinstance(x, Interval):
        return x.least()
    return np.nextafter(max(float(x.a), -float(x.b), 0.0), 0.0)


_EXTREMES = ((np.maximum.reduce, _most), (np.minimum.reduce, _least))


Vector = list[Interval]


def _radii_of_six_legs(branches: SolutionSet) -> FloatArray:
    """Return what `_existence_radii` does of any machine, shape (..., 8): numbers of pose and legs taken as exact."""
    states, legs = branches.configurations, branches.geometry.legs
    shape, unit = states.shape, branches.geometry.middle_side
    joints = states.middle_joints.reshape(-1, 3, 3)
    exists = ~np.isnan(joints[:, 0, 0])
    radius = np.full(len(joints), np.nan)
    if not exists.any():
        return radius.reshape(shape)
    b = [_point(joints[exists, i]) for i in range(3)]
    rows = [_point(states.rotation.reshape(-1, 3, 3)[exists, i]) for i in range(3)]
    o = _point(states.translation.reshape(-1, 3)[exists])
    p, q = _minus(b[1], b[0]), _minus(b[2], b[0])
    n, weights = _cross(p, q), _ball_weights(legs.balls)
    errors: Vector = []
    slopes = [[Interval.of(np.zeros(len(o[0].low))) for _ in range(9)] for _ in range(9)]
    quadratic = np.zeros((len(o[0].low), 9))

    def add(equation: int, ball: int, direction: Vector) -> None:
        for k in range(3):
            slopes[equation][3 * ball + k] = slopes[equation][3 * ball + k] + direction[k]

    for i in range(6):
        axis, pivot = _point(legs.axes[i]), _point(legs.pivots[i])
        ball, corner = b[i % 3], i % 3
        if i >= 3:
            axis, pivot = [_dot(row, axis) for row in rows], _plus([_dot(row, pivot) for row in rows], o)
            u, v, w = weights[corner]
            ball = _plus(ball, _plus(_plus(_scaled(u, p), _scaled(v, q)), _scaled(w, n)))
            along_p = _plus(_scaled(u, axis), _scaled(w, _cross(q, axis)))
            along_q = _plus(_scaled(v, axis), _scaled(w, _cross(axis, p)))
            for other, direction in ((1, along_p), (2, along_q)):
                add(i, other, direction)
                add(i, 0, [-x for x in direction])
            # |δp| and |δq| are at most √12 in units of the cube's half edge, and the axis is a unit vector to 1e-6.
            quadratic[:, i] = 12.1 * _most(w)
        add(i, corner, axis)
        errors.append(_dot(axis, _minus(ball, pivot)))
    for k, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        edge, drawn = _minus(b[i], b[j]), _minus(_point(legs.balls[i]), _point(legs.balls[j]))
        errors.append((_dot(edge, edge) - _dot(drawn, drawn)) * (1.0 / unit))
        twice = [2.0 / unit * x for x in edge]
        add(6 + k, i, twice)
        add(6 + k, j, [-x for x in twice])
        quadratic[:, 6 + k] = 12.1 / unit
    with np.errstate(all="ignore"):
        radius[exists] = _contraction_radii(errors, slopes, quadratic)
    return radius.reshape(shape)


def _contraction_radii(errors: Vector, slopes: list[Vector], quadratic: FloatArray) -> FloatArray:
    """Return radii around points at which nine equations have these errors, slopes and bounds of their second order."""
    count = len(quadratic)
    entries = [x for row in slopes for x in row]
    low, high = (
        np.stack([np.broadcast_to(x, count) for x in ends], axis=-1).reshape(count, 9, 9)
        for ends in ([x.low for x in entries], [x.high for x in entries])
    )
    middle = 0.5 * (low + high)
    regular = np.isfinite(middle).all(axis=(-1, -2)) & (np.linalg.matrix_rank(np.nan_to_num(middle)) == 9)
    inverse = np.linalg.inv(np.where(regular[:, None, None], middle, np.eye(9)))
    size, spread = np.abs(inverse), np.maximum(high - middle, middle - low) * _SAFE
    # A sum of nine products is off by less than 10 eps of the sum of their magnitudes.
    rounding = 1e-14
    lengths = np.stack([_most(x) for x in errors], axis=-1)
    value = np.stack([0.5 * (x.low + x.high) for x in errors], axis=-1)
    width = np.stack([np.maximum(x.high - x.low, 0.0) for x in errors], axis=-1)
    shift = np.abs((inverse @ value[..., None])[..., 0]) + (size @ (rounding * lengths + width)[..., None])[..., 0]
    eta = shift.max(axis=-1) * _SAFE
    defect = np.abs(np.eye(9) - inverse @ middle) + size @ (rounding * np.abs(middle) + spread)
    kappa = defect.sum(axis=-1).max(axis=-1) * _SAFE
    beta = (size @ quadratic[..., None])[..., 0].max(axis=-1) * _SAFE
    half_edge = 2.0 * eta / (1.0 - kappa) * _SAFE
    radius = np.sqrt(3.0) * half_edge * _SAFE
    # Into itself the cube is mapped if 4 β η <= (1 - κ)²; unique is the solution in the cube around the radius too.
    proved = regular & (kappa < 0.5) & (kappa + 2.0 * beta * radius < 0.99)
    return np.where(proved, radius, np.nan)


def _ball_weights(balls: FloatArray) -> list[tuple[Interval, Interval, Interval]]:
    """Return enclosures of `upper_ball_weights`."""
    corners = [_point(ball) for ball in balls]
    p, q = _minus(corners[1], corners[0]), _minus(corners[2], corners[0])
    n = _cross(p, q)
    square, weights = _dot(n, n), []
    for i in range(3):
        apart = _minus(corners[3 + i], corners[i])
        parts = _dot(_cross(apart, q), n), _dot(_cross(p, apart), n), _dot(apart, n)
        weights.append((parts[0] / square, parts[1] / square, parts[2] / square))
    return weights


def _point(array: FloatArray) -> Vector:
    return [Interval.of(array[..., k]) for k in range(3)]


def _plus(a: Vector, b: Vector) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def _minus(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def _scaled(factor: Interval, a: Vector) -> Vector:
    return [factor * x for x in a]


def _dot(a: Vector, b: Vector) -> Interval:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
