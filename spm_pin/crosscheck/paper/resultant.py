"""The paper's inverse displacement, Eqs. (5)-(20), with its symbols and its equation numbers.

The ball joints lie on the lines where the planes of their two legs meet, Eq. (11), so three unknowns are left;
the middle platform's sides give three quadratics in them, Eq. (13); eliminating b_3y and b_1y leaves |U| = 0,
Eq. (19), of degree eight in b_2y. The paper does not say how to solve it. Here |U| is sampled at nine Chebyshev
nodes on |b_2y| <= 2r, which holds every real solution, and the roots are the eigenvalues of its colleague matrix
(Trefethen, Approximation Theory and Practice, ch. 18).

Two weaknesses are the route's own: Eq. (10) divides by zero where a line is vertical, and by little near it;
and where two solutions meet, the octic's double root costs half the digits. `spm_pin.kinematics.inverse_displacement`
has neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev

from spm_pin.machine import Manipulator, PoseLike, SolutionSet, as_rigid_transform
from spm_pin.support.arguments import FloatArray

ComplexArray = npt.NDArray[np.complex128]
q = math.sqrt(3.0)

_ORDER = ((0, 1, 5, 4), (1, 2, 4, 5), (0, 2, 4, 5))
"""The two unknowns b_jy and b_ky of Eqs. (13a)-(13c), by their places, and the coefficients p_i of their squares.

Eqs. (13b) and (13c) list b_3y's coefficients first; p_i2 and p_i1 belong to the other order."""

_REAL = 1e-7
"""Largest imaginary part of a real solution, see `inverse_displacement`."""


@dataclass(frozen=True)
class Resultant:
    """Eqs. (6)-(19) of N poses: the lines of the ball joints and the determinant |U|."""

    s: FloatArray
    """s_i1 [m] and s_i2 of Eq. (10), shape (N, 3, 2); NaN where the line of b_i is vertical."""
    d: float
    """Side of the middle platform [m]."""

    @classmethod
    def from_pose(cls, machine: Manipulator, pose: PoseLike) -> Resultant:
        """Set up the lines for a pose, or a batch that is flattened."""
        matrix = as_rigid_transform(pose).as_matrix().reshape(-1, 4, 4)
        R, o = matrix[:, :3, :3], matrix[:, :3, 3]
        x, y = np.moveaxis(R[:, :, 0], -1, 0), np.moveaxis(R[:, :, 1], -1, 0)
        (x_l, x_m, x_n), (y_l, y_m, y_n) = x, y
        c = machine.platform_joints @ np.swapaxes(R, -1, -2) + o[:, None, :]  # Eq. (2a)
        (c_1x, c_1y, c_1z), (c_2x, c_2y, c_2z), (c_3x, c_3y, c_3z) = np.moveaxis(c, 0, -1)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Eq. (10); the line b_3z = s_31 + s_32 b_3y is missing in print.
            s_11 = ((x_l + q * y_l) * c_1x + (x_m + q * y_m) * c_1y + (x_n + q * y_n) * c_1z) / (x_n + q * y_n)
            s_12 = (q * x_l + 3 * y_l - x_m - q * y_m) / (x_n + q * y_n)
            s_21 = (x_l * c_2x + x_m * c_2y + x_n * c_2z) / x_n
            s_22 = -x_m / x_n
            s_31 = ((-x_l + q * y_l) * c_3x - (x_m - q * y_m) * c_3y - (x_n - q * y_n) * c_3z) / (-x_n + q * y_n)
            s_32 = (q * x_l - 3 * y_l + x_m - q * y_m) / (-x_n + q * y_n)
        s = np.stack([s_11, s_12, s_21, s_22, s_31, s_32], axis=-1).reshape(-1, 3, 2)
        return cls(np.where(np.isfinite(s), s, np.nan), machine.middle_side)

    @property
    def p(self) -> FloatArray:
        """p_10..p_15, p_20..p_25, p_30..p_35 of Eq. (13), shape (N, 3, 6)."""
        (s_11, s_12), (s_21, s_22), (s_31, s_32) = np.moveaxis(self.s, 0, -1)
        d = self.d
        with np.errstate(invalid="ignore", over="ignore"):
            p_1 = [(s_11 - s_21) ** 2 - d**2, 2 * s_12 * (s_11 - s_21), -2 * s_22 * (s_11 - s_21)]
            p_1 += [-2 - 2 * s_12 * s_22, 1 + s_22**2, 4 + s_12**2]
            p_2 = [(s_31 - s_21) ** 2 - d**2, -2 * s_22 * (s_31 - s_21), 2 * s_32 * (s_31 - s_21)]
            p_2 += [-2 - 2 * s_32 * s_22, 1 + s_22**2, 4 + s_32**2]
            p_3 = [(s_31 - s_11) ** 2 - d**2, -2 * s_12 * (s_31 - s_11), 2 * s_32 * (s_31 - s_11)]
            p_3 += [4 - 2 * s_32 * s_12, 4 + s_12**2, 4 + s_32**2]
        return np.stack([*p_1, *p_2, *p_3], axis=-1).reshape(-1, 3, 6)

    def determinant(self, b_2y: npt.ArrayLike, *, as_printed: bool = False) -> FloatArray:
        """Return |U| of Eq. (19) at values b_2y (N, m) or (m,) [m], shape (N, m).

        `as_printed` keeps the signs that Eq. (17) has in the paper. Clearing the fraction of Eq. (16) moves a
        product to the other side; its terms kept their signs in print.
        """
        y = np.atleast_1d(np.asarray(b_2y, dtype=np.float64))
        (p_10, p_11, p_12, p_13, p_14, p_15), p_2, p_3 = np.moveaxis(self.p[..., None], (1, 2), (0, 1))
        p_20, p_21, p_22, p_23, p_24, p_25 = p_2
        p_30, p_31, p_32, p_33, p_34, p_35 = p_3
        # Eq. (14)
        k_12, k_11, k_10 = p_15 + 0 * y, p_11 + p_13 * y, p_14 * y**2 + p_12 * y + p_10
        k_22, k_21, k_20 = p_25, p_23 * y + p_22, p_24 * y**2 + p_21 * y + p_20
        k_32 = p_35
        # Eq. (17)
        g = 1.0 if as_printed else -1.0
        t_14 = k_22**2 * p_34**2 + 0 * y
        t_13 = 2 * k_22**2 * p_34 * p_31 + g * k_21 * k_22 * p_33 * p_34
        t_12 = k_22**2 * (p_31**2 + 2 * p_30 * p_34) - p_34 * (2 * k_20 * k_22 * k_32 + g * k_21**2 * k_32)
        t_12 = t_12 + g * (k_21 * k_22 * (p_33 * p_31 + p_32 * p_34) - k_20 * k_22 * p_33**2)
        t_11 = 2 * k_22**2 * p_30 * p_31 - p_31 * (2 * k_20 * k_22 * k_32 + g * k_21**2 * k_32)
        t_11 = t_11 + g * (k_21 * k_22 * (p_33 * p_30 + p_32 * p_31) - 2 * k_20 * k_22 * p_32 * p_33)
        t_11 = t_11 + g * k_20 * k_21 * k_32 * p_33
        t_10 = k_22**2 * p_30**2 - p_30 * (2 * k_20 * k_22 * k_32 + g * k_21**2 * k_32) + k_20**2 * k_32**2
        t_10 = t_10 + g * (k_21 * k_22 * p_32 * p_30 - k_20 * k_22 * p_32**2 + k_20 * k_21 * k_32 * p_32)
        # Eq. (18)
        o = np.zeros_like(t_14)
        U = [
            [o, t_14, t_13, t_12, t_11, t_10],
            [t_14, t_13, t_12, t_11, t_10, o],
            [o, o, o, k_12, k_11, k_10],
            [o, o, k_12, k_11, k_10, o],
            [o, k_12, k_11, k_10, o, o],
            [k_12, k_11, k_10, o, o, o],
        ]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.linalg.det(np.moveaxis(np.array(U), (0, 1), (-2, -1))))

    def roots(self, *, as_printed: bool = False) -> ComplexArray:
        """Return the eight roots b_2y of |U| = 0, shape (N, 8) [m]; NaN where a line is vertical."""
        nodes = chebyshev.chebpts1(9)
        reach = 2.0 * self.d / q
        samples = self.determinant(reach * nodes, as_printed=as_printed)
        series = samples @ chebyshev.chebvander(nodes, 8) * ([1.0 / 9.0] + [2.0 / 9.0] * 8)
        regular = np.isfinite(series).all(axis=-1) & (series[:, -1] != 0.0)
        safe = np.where(regular[:, None], series, np.eye(9)[8])
        # Turned by half a turn, as in NumPy's `chebroots`: eigenvalues are then more accurate.
        colleague = np.reshape([chebyshev.chebcompanion(c)[::-1, ::-1] for c in safe], (-1, 8, 8))
        roots = reach * np.linalg.eigvals(colleague).astype(np.complex128)
        return np.where(regular[:, None], roots, np.nan)

    def unknowns(self, b_2y: ComplexArray) -> ComplexArray:
        """Complete roots b_2y (N, 8) to (b_1y, b_2y, b_3y) (N, 8, 3) [m].

        Eqs. (14a) and (14b) leave two values each for b_1y and b_3y; the pair that fulfils (14c) best is taken.
        """
        (p_10, p_11, p_12, p_13, p_14, p_15), p_2, _ = np.moveaxis(self.p[..., None], (1, 2), (0, 1))
        p_20, p_21, p_22, p_23, p_24, p_25 = p_2
        y = b_2y
        with np.errstate(invalid="ignore", over="ignore"):
            b_1y = _quadratic(p_15, p_11 + p_13 * y, p_14 * y**2 + p_12 * y + p_10)
            b_3y = _quadratic(p_25, p_23 * y + p_22, p_24 * y**2 + p_21 * y + p_20)
            pairs = [np.stack([y_1, y, y_3], axis=-1) for y_1 in b_1y for y_3 in b_3y]
            mismatch = np.stack([np.abs(self.equations(pair)[0][..., 2]) for pair in pairs])
        best = np.where(np.isnan(mismatch), np.inf, mismatch).argmin(axis=0)
        return np.asarray(np.take_along_axis(np.stack(pairs), best[None, ..., None], axis=0)[0])

    def equations(self, unknowns: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the left sides of Eqs. (13a)-(13c) [m²] at (b_1y, b_2y, b_3y), (N, 8, 3), and their Jacobian."""
        values, jacobian = np.empty_like(unknowns), np.zeros((*unknowns.shape, 3), dtype=np.complex128)
        for i, (j, k, jj, kk) in enumerate(_ORDER):
            u, v, p = unknowns[..., j], unknowns[..., k], self.p[:, i, :, None]
            linear = p[:, 1] * u + p[:, 2] * v + p[:, 0]
            values[..., i] = p[:, jj] * u**2 + p[:, kk] * v**2 + p[:, 3] * u * v + linear
            jacobian[..., i, j] = 2 * p[:, jj] * u + p[:, 3] * v + p[:, 1]
            jacobian[..., i, k] = 2 * p[:, kk] * v + p[:, 3] * u + p[:, 2]
        return values, jacobian

    def refined(self, unknowns: ComplexArray, steps: int) -> ComplexArray:
        """Take Newton steps on Eq. (13) from (b_1y, b_2y, b_3y), (N, 8, 3)."""
        for _ in range(steps):
            value, jacobian = self.equations(unknowns)
            # A vertical line gives NaN, a double root a singular matrix: no step is taken there.
            good = np.asarray(np.isfinite(jacobian).all(axis=(-1, -2)) & np.isfinite(value).all(axis=-1))
            good &= np.abs(np.linalg.det(np.where(good[..., None, None], jacobian, 0.0))) > 0.0
            jacobian = np.where(good[..., None, None], jacobian, np.eye(3))
            step = np.linalg.solve(jacobian, np.where(good[..., None], value, 0.0)[..., None])[..., 0]
            unknowns = unknowns - step
        return unknowns

    def middle_joints(self, unknowns: ComplexArray) -> ComplexArray:
        """Return b_1, b_2, b_3 as rows in {B} [m], (N, 8, 3, 3). Eqs. (7) and (11)."""
        b_1y, b_2y, b_3y = np.moveaxis(unknowns, -1, 0)
        (s_11, s_12), (s_21, s_22), (s_31, s_32) = np.moveaxis(self.s[..., None], 0, -2)
        with np.errstate(invalid="ignore"):
            b_1 = [-q * b_1y, b_1y, s_11 + s_12 * b_1y]
            b_2 = [0 * b_2y, b_2y, s_21 + s_22 * b_2y]
            b_3 = [q * b_3y, b_3y, s_31 + s_32 * b_3y]
        return np.moveaxis(np.array([b_1, b_2, b_3], dtype=np.complex128), (0, 1), (-2, -1))

    def solutions(self, refine: int) -> ComplexArray:
        """Return b_1, b_2, b_3 [m], (N, 8, 3, 3): the whole procedure, then Newton steps on Eq. (13)."""
        return self.middle_joints(self.refined(self.unknowns(self.roots()), refine))


def _quadratic(a: FloatArray, b: ComplexArray, c: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    root = np.sqrt(b * b - 4 * a * c)
    return (-b + root) / (2 * a), (-b - root) / (2 * a)


def solve(machine: Manipulator, pose: PoseLike) -> ComplexArray:
    """Return all eight solutions of poses (...) as the paper finds them, real or complex.

    Rows b_i (..., 8, 3, 3) in {B} [m], in no particular order; NaN where Eq. (10) divides by zero.
    """
    transform = as_rigid_transform(pose)
    return Resultant.from_pose(machine, transform).solutions(0).reshape(*transform.shape, 8, 3, 3)


def inverse_displacement(machine: Manipulator, pose: PoseLike, *, refine: int = 4) -> SolutionSet:
    """Return the paper's real solutions under the canonical labels, without discriminants.

    `refine` Newton steps on Eq. (13) are taken. A solution is real if no imaginary part of its joint positions exceeds
    1e-7 d (1 + s), with s the largest slope of the three lines; real solutions whose joint positions differ by no more
    than this are merged. The status is `Status.UNSOLVED` where a
    line is vertical, or so steep that the solutions contradict one another.
    """
    transform = as_rigid_transform(pose)
    resultant = Resultant.from_pose(machine, transform)
    joints = resultant.solutions(refine).reshape(*transform.shape, 8, 3, 3)
    slopes = np.abs(resultant.s[..., 1]).max(axis=-1)
    # A steep line magnifies what is left of an error in the y coordinates.
    bound = (_REAL * machine.middle_side * (1.0 + slopes)).reshape(*transform.shape, 1)
    with np.errstate(invalid="ignore"):
        real = np.abs(joints.imag).max(axis=(-1, -2)) <= bound
        points = joints.real
        gaps = np.abs(points[..., :, None, :, :] - points[..., None, :, :, :]).max(axis=(-1, -2))
    same = (gaps <= bound[..., None]) & real[..., :, None] & real[..., None, :]
    repeated = np.tril(same, -1).any(axis=-1)
    # Each side right to the tolerance: what Newton left unconverged is no solution.
    sides = np.sqrt(((points - np.roll(points, -1, axis=-2)) ** 2).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        closed = np.abs(sides - machine.middle_side).max(axis=-1) <= bound
    keep = real & closed & ~repeated
    solved = np.isfinite(joints).all(axis=(-1, -2, -3))
    return SolutionSet.from_unordered(machine, transform, np.where(keep[..., None, None], points, np.nan), solved)
