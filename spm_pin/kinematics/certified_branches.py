"""Branches with proof: whether each family is real, and how far from the computed joints the exact ones can be.

A discriminant above the bound of its rounding error has the computed sign; the others are computed without rounding,
see `spm_pin.kinematics.exact_discriminants`. For the joints, joint i moves on the line of its two leg planes, and the
distances of the joints are three quadratic equations f + J t + q(t) = 0 in their places t on these lines, counted from
the computed ones. By the theorem of Newton and Kantorovich they have a solution with |t| <= 2η, and no other one with
|t| <= 1/(8β), if 16 β η <= 1, where η bounds |J⁻¹ f| and β bounds |J⁻¹|: |q(t)| <= 4 |t|² for lines in unit steps.
All bounds are computed with outward rounding. See `docs/theory/proofs.md`.
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
    rotation, position, joints, _, _, _, status, flagged = branches.memory
    assert branches.degeneracy is not None
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
