"""The multi-start at one pose: random starts, hits of each solution, and the stopping rule.

A start is a middle platform of the right size in a random orientation, placed where it violates the six leg planes
least. Orientations are uniform on SO(3), which is compact, and every solution is itself such a start: every branch has
a neighbourhood of starts that lead to it, and no box has to be chosen to search in.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solution_status import Status
from spm_pin.nlp.batched_newton import LoopEquations, RootCertificate, certify_root, isolated, newton
from spm_pin.nlp.ipopt_solver import IpoptSolver

MOST_BRANCHES = 8
"""Largest number of branches of a pose: the degree of Eq. (19)."""

_ITERATIONS = 60
"""Steps of Newton's method from each start at most."""
_FIRST_BATCH, _LARGEST_BATCH = 64, 512
"""Starts made together: at first, doubled each time, and at most."""
_MOST_STARTS = 4096
"""Starts at most where the stopping rule is not met."""
_LEAST_SQUARES = 12
"""Starts of the least squares where no start led to a solution."""
_DOUBLE_ROOTS = 4
"""Double roots of a pose at most, one in each family; more solutions that are not isolated are a continuous family."""


@dataclass
class Multistart:
    """State of the multi-start at one pose."""

    equations: LoopEquations
    """The loop equations of the machine."""
    matrix: FloatArray
    """The pose of {m} in {B}, shape (4, 4)."""
    certificates: list[RootCertificate] = field(default_factory=list)
    """The solutions found, each with what is proved about it."""
    hits: list[int] = field(default_factory=list)
    """Starts that ended at each of them."""
    starts: int = 0
    """Starts made."""
    failed: int = 0
    """Starts that ended at no solution."""
    failed_residual: float = np.nan
    """Smallest norm of the loop equations where a failed start ended [m]; NaN where none failed."""
    infeasibility: float = np.nan
    """Smallest norm of the loop equations that least squares found [m]; NaN where they were not needed."""
    settled: bool = False
    """True if the stopping rule was met."""
    outcomes: Counter[str] = field(default_factory=Counter)
    """Starts by the solver's own verdict."""

    def run(self, method: IpoptSolver | None, starts: int | None, risk: float, rng: np.random.Generator) -> None:
        """Make `starts` starts, or until the stopping rule is met; `method` None means Newton's method."""
        size = _FIRST_BATCH
        last = _MOST_STARTS if starts is None else starts
        while self.starts < last and not (starts is None and self.settled):
            count = min(size, last - self.starts)
            self._extend(method, random_starts(self.equations.geometry, self.matrix, count, rng))
            seen_once = any(self.hits[k] == 1 for k in self.kept)
            self.settled = self.unseen_probability <= risk and not seen_once
            size = min(2 * size, _LARGEST_BATCH)
        if not self.certificates:
            self._minimize_residual(random_starts(self.equations.geometry, self.matrix, _LEAST_SQUARES, rng))

    def _extend(self, method: IpoptSolver | None, starts: FloatArray) -> None:
        self.starts += len(starts)
        if method is None:
            ends, converged = newton(self.equations, starts, self.matrix, _ITERATIONS)
            self.outcomes.update(converged=int(converged.sum()), diverged=int((~converged).sum()))
        else:
            ends, outcomes = method(starts, self.matrix)
            self.outcomes.update(outcomes)
            # IPOPT's tolerance is absolute; full accuracy is one or two Newton steps away.
            polished, converged = newton(self.equations, ends, self.matrix, 3)
            ends = np.where(converged[:, None], polished, ends)
        self._count_hits(ends[converged])
        self.failed += int((~converged).sum())
        if not converged.all():
            with np.errstate(over="ignore", invalid="ignore"):
                norms = np.linalg.norm(self.equations(ends[~converged], self.matrix)[0], axis=-1)
            self.failed_residual = float(np.fmin(self.failed_residual, np.nanmin(norms)))

    def _count_hits(self, ends: FloatArray) -> None:
        """Count each end point (n, 9) as a hit of its solution, adding solutions not seen before."""
        for k, known in enumerate(self.certificates):
            same = np.linalg.norm(ends - known.b, axis=-1) <= known.apart
            self.hits[k] += int(same.sum())
            ends = ends[~same]
        if self.continuous and len(ends):
            ends = ends[isolated(self.equations, ends, self.matrix)]
        while len(ends):
            new = certify_root(self.equations, ends[0], self.matrix)
            same = np.linalg.norm(ends - new.b, axis=-1) <= new.apart
            same[0] = True
            self.certificates.append(new)
            self.hits.append(int(same.sum()))
            ends = ends[~same]

    def _minimize_residual(self, starts: FloatArray) -> None:
        """Minimise the residual by least squares, for the infeasibility or a solution that no start led to."""

        def value(b: FloatArray) -> FloatArray:
            return np.asarray(self.equations(b[None], self.matrix)[0][0])

        def slope(b: FloatArray) -> FloatArray:
            return np.asarray(self.equations(b[None], self.matrix)[1][0])

        ends = np.array([least_squares(value, start, slope, method="lm").x for start in starts])
        polished, converged = newton(self.equations, ends, self.matrix, 3)
        self._count_hits(polished[converged])
        self.infeasibility = min(float(np.linalg.norm(value(end))) for end in ends)

    @property
    def continuous(self) -> bool:
        """True if more solutions are not isolated than there can be double roots: then they form a continuum."""
        return sum(not certificate.isolated for certificate in self.certificates) > _DOUBLE_ROOTS

    @property
    def kept(self) -> list[int]:
        """Indices of the solutions that are not on a continuous family."""
        return [k for k, certificate in enumerate(self.certificates) if certificate.isolated or not self.continuous]

    @property
    def unseen_probability(self) -> float:
        """Posterior probability that a branch was not found."""
        return unseen_probability(len(self.kept), self.starts)

    @property
    def status(self) -> Status:
        """Status of the pose."""
        if self.continuous:
            return Status.DEGENERATE
        if self.certificates:
            return Status.OK
        rounding = float(self.equations.rounding(self.matrix[None, :3, 3], self.matrix)[0])
        return Status.UNREACHABLE if self.infeasibility > 3.0 * rounding else Status.UNSOLVED


def random_starts(geometry: Geometry, matrix: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw starts b (count, 9) [m] for a pose (4, 4)."""
    axes = geometry.revolute_axes
    platform_axes = axes @ matrix[:3, :3].T
    local = geometry.middle_radius * geometry.radial_directions
    turned = local @ np.swapaxes(Rotation.random(count, rng=rng).as_matrix(), -1, -2)
    # Relative to the point half way between the platforms: a direction that the normals leave free keeps that value.
    half = matrix[:3, 3] / 2.0
    normals = np.concatenate([axes, platform_axes])
    wanted = np.concatenate([-axes @ half, platform_axes @ half])
    offsets = np.concatenate([(turned * axes).sum(axis=-1), (turned * platform_axes).sum(axis=-1)], axis=-1)
    centre = half + (wanted - offsets) @ np.linalg.pinv(normals).T
    return np.asarray((turned + centre[:, None, :]).reshape(count, 9))


def unseen_probability(branches: int, starts: int) -> float:
    """Return the probability that a pose has branches that no start has found, of `starts` made, failed ones included.

    The posterior probability after Boender and Rinnooy Kan, Bayesian stopping rules for multistart global optimization
    methods, Math. Program. 37 (1987): each number of branches equally likely beforehand, and then every division of the
    starts among the branches and failures. They allow any number; here it is 0, 2, 4, 6 or 8, because the non-real
    roots of a real polynomial come in pairs. K branches of which w are found in n starts weigh
    K!/(K - w)! · K!/(n + K)!; the hits of each do not matter.
    """
    if branches % 2 or branches > MOST_BRANCHES:
        return 1.0
    weights = [
        math.exp(
            2.0 * math.lgamma(k + 1)
            - math.lgamma(k - branches + 1)
            - math.lgamma(starts + k + 1)
            + math.lgamma(starts + branches + 1)
        )
        for k in range(branches, MOST_BRANCHES + 1, 2)
    ]
    return math.fsum(weights[1:]) / math.fsum(weights)
