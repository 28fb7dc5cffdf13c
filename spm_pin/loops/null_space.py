"""The joint velocities that closures admit, from the Jacobian of rows that may depend on each other.

With J scaled to be dimensionless and a permutation P of its rows that puts independent ones first,

    Jᵀ P = [Q1 Q2] [R11 R12; 0 0],

the columns of Q2 are all admissible velocities; Q1, R11 and R12 give particular solutions and the forces of the rows.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from spm_pin.support.arguments import FloatArray

INDEPENDENT = 1e-9
"""A row is independent of others if it differs from their span by more than this, relative to the largest row: the axes
of a planar loop are parallel to no more digits than a file has."""


class NullSpace:
    """Solutions of J x = c, of any rank, and forces of its rows; J is the Jacobian (m, nv) of m rows.

    J is taken in units of each row and each joint, which are sizes of order one.

    Attributes
    ----------
    rank : int
        Number of independent rows.
    basis : ndarray, shape (nv, nv - rank)
        Velocities that J maps to zero, orthonormal in units of `units`.
    least : float
        Largest distance of a row from the span of the independent ones, dimensionless: zero to rounding.
    sigma : float
        Distance of the last independent row from the span of those before it, dimensionless.
    """

    def __init__(
        self,
        scaled: FloatArray,
        row_units: FloatArray,
        units: FloatArray,
        tolerance: float,
        rank: int | None = None,
    ) -> None:
        """Factorise J, `scaled` by `row_units` (m,) and `units` (nv,).

        The rank, if it is not given, is the number of rows that are independent to `tolerance`.
        """
        self._row_units, self._units = row_units, units
        rows, nv = scaled.shape
        self.scaled = scaled
        self.rank, self.least, self.sigma = 0, 0.0, 1.0
        rotation = np.eye(nv)
        if rows and nv:
            factors, pivots, tau, *_ = lapack.dgeqp3(scaled.T)
            diagonal = [abs(x) for x in factors.diagonal().tolist()]
            least = max(tolerance, INDEPENDENT) * max(diagonal[0], 1e-300)
            self.rank = rank = sum(x > least for x in diagonal) if rank is None else rank
            self._pivots, self._factors = pivots - 1, factors
            self.least = diagonal[rank] if rank < len(diagonal) else 0.0
            if rank:
                self.sigma = diagonal[rank - 1]
                rotation = np.zeros((nv, nv), order="F")
                rotation[:, :rank] = factors[:, :rank]
                rotation = lapack.dorgqr(rotation, tau[:rank], overwrite_a=1)[0]
        self._range = rotation[:, : self.rank]
        self.basis = units[:, None] * rotation[:, self.rank :]

    def solve(self, right_side: FloatArray) -> tuple[FloatArray, float]:
        """Return the least x (nv,) of J x = c (m,), in units of each joint, and by how much the rows disagree, scaled.

        The disagreement is zero to rounding where the rows that depend on others are compatible with them.
        """
        if not self.rank:
            return np.zeros(len(self._units)), max(map(abs, (right_side / self._row_units).tolist()), default=0.0)
        scaled = right_side / self._row_units
        part = lapack.dtrtrs(self._factors[: self.rank, : self.rank], scaled[self._pivots[: self.rank]], trans=1)[0]
        least = self._range.dot(part)
        missed = self.scaled.dot(least) - scaled if self.rank < len(scaled) else scaled[:0]
        return self._units * least, max(map(abs, missed.tolist()), default=0.0)

    def row_forces(self, forces: FloatArray) -> FloatArray:
        """Return the least λ (m,), in units of each row, with Jᵀ λ = forces (nv,) in the range of Jᵀ."""
        part = np.zeros(len(self._row_units))
        if self.rank:
            along = self._range.T.dot(self._units * forces)
            part[self._pivots] = self._spread(along)
        return part / self._row_units

    def _spread(self, along: FloatArray) -> FloatArray:
        """Return the least solution (m,) of [R11 R12] x = `along` (rank,)."""
        if self._trapezoid is None:
            return np.asarray(lapack.dtrtrs(self._factors[: self.rank, : self.rank], along)[0])
        q, r = self._trapezoid
        return np.asarray(q.dot(lapack.dtrtrs(r, along, trans=1)[0]))

    @cached_property
    def _trapezoid(self) -> tuple[FloatArray, FloatArray] | None:
        """Q and R of [R11 R12]ᵀ; None where all rows are independent."""
        if self.rank == len(self._row_units):
            return None
        upper = np.triu(self._factors[: self.rank])
        return np.linalg.qr(upper.T)
