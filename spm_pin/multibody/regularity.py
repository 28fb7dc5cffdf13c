"""LU factorisations with a test of regularity, thresholds, and smallest singular values."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import lapack

from spm_pin.mechanism.arguments import FloatArray

SINGULAR = 64.0 * float(np.finfo(np.float64).eps)
"""A matrix is singular to rounding where its smallest singular value is at most this times its largest.

Ten joints lie between {B} and m, each adds a rounding or two of eps times an arm to an entry; some hundred entries
that are not zero make a matrix off by a few hundred eps in the Frobenius norm, of a largest singular value of about
five: a smaller singular value may as well be zero.
"""

SUSPECT = 1e-9
"""Reciprocal condition number below which a factorisation is checked by singular values: they take longer."""


class SingularValues(NamedTuple):
    """Smallest singular values at a configuration, dimensionless; each is named after what its zero means.

    Lengths are in units of the middle platform's side, the rates of a ball joint are its angular velocity. Arrays (...)
    for a batch.
    """

    inverse: Any
    """Smallest singular value of K, the twist of {m} and the closures' rates: zero where the platform's twist does not
    determine the rates of the legs."""
    forward: Any
    """Smallest singular value of [S; Jc], the rates of the legs and of the closures: zero where the legs do not hold
    the platform."""
    constraint: Any
    """Smallest singular value of Jc, the rates of the closures: zero where the revolute joints of a stage do not
    constrain its platform. Then the other two are zero as well."""


class Factors(NamedTuple):
    """The LU factorisation of a matrix, as of LAPACK's dgetrf."""

    lu: FloatArray
    pivots: Any
    zero_pivot: bool
    """True if a pivot is exactly zero: `solve` has no meaning."""

    @classmethod
    def of(cls, matrix: FloatArray) -> Factors:
        """Factorise a square matrix."""
        lu, pivots, info = lapack.dgetrf(matrix)
        return cls(lu, pivots, info > 0)

    def is_regular(self, matrix: FloatArray) -> bool:
        """Return whether the reciprocal condition number of the matrix that was factorised is above `SUSPECT`."""
        if self.zero_pivot:
            return False
        flat, others = matrix.ravel(), len(matrix) - 1
        square = float(flat.dot(flat))
        # All but the smallest singular value multiply to at most (F²/(n - 1))^((n - 1)/2), F the Frobenius norm:
        # quicker than LAPACK's estimate, and nearly always enough.
        size = abs(math.prod(self.lu.diagonal().tolist()))
        if size * (others / square) ** (0.5 * others) > SUSPECT * math.sqrt(square):
            return True
        norm = lapack.dlange("1", matrix)  # type: ignore[call-arg]
        return bool(lapack.dgecon(self.lu, norm)[0] > SUSPECT)

    def determinant(self) -> float:
        """Return the determinant."""
        swaps = sum(place != k for k, place in enumerate(self.pivots.tolist()))
        return float(math.prod(self.lu.diagonal().tolist()) * (-1.0) ** swaps)

    def solve(self, right_side: FloatArray) -> FloatArray:
        """Return A⁻¹ b, for one or several columns b."""
        if right_side.ndim > 1:
            # One by one: for several, OpenBLAS waits for threads, which may take milliseconds.
            return np.stack([self.solve(column) for column in right_side.T], axis=-1)
        return np.asarray(lapack.dgetrs(self.lu, self.pivots, right_side)[0])

    def solve_transposed(self, right_side: FloatArray) -> FloatArray:
        """Return A⁻ᵀ b."""
        return np.asarray(lapack.dgetrs(self.lu, self.pivots, right_side, trans=1)[0])
