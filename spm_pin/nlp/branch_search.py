"""Inverse displacement by multi-start: branches found from random starts, certified, and the chance of missed ones.

Newton's method is the default solver. The loop equations of a pose are a square system without an objective, on which
IPOPT takes Newton steps too, at some eighty times the cost per start; `make bench` measures both beside SciPy's
solvers. IPOPT serves as a second method: its line search and restoration phase end elsewhere, and stop at a measured
infeasibility where nothing solves the equations.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import BRANCHES, Geometry, PoseLike, SolutionSet, Status, as_rigid_transform
from spm_pin.mechanism.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    check_instance,
    choice,
    real_number,
    type_and_value,
    whole_number,
)
from spm_pin.nlp.batched_newton import LoopEquations
from spm_pin.nlp.ipopt_solver import IpoptSolver
from spm_pin.nlp.multistart import MOST_BRANCHES, Multistart

SOLVERS = ("newton", "ipopt")
"""Names of the solvers that run from each start."""


@dataclass(frozen=True)
class Search:
    """Branches found by a multi-start, with statistics of the search; arrays over the batch of poses (...)."""

    solutions: SolutionSet
    """The branches, under the canonical labels. `Status.UNREACHABLE` where none was found and `infeasibility` is not
    rounding; `Status.UNSOLVED` where the search failed, or was interrupted before."""
    starts: IntArray
    """Starts made."""
    hits: IntArray
    """Starts that ended at each branch, shape (..., 8)."""
    continuous: IntArray
    """Starts that ended on a continuous family of solutions."""
    failed: IntArray
    """Starts that ended at no solution."""
    failed_residual: FloatArray
    """Smallest norm of the loop equations where a failed start ended [m]; NaN where none failed."""
    unseen_share: FloatArray
    """Good and Turing's estimate of the share of converging starts that lead to branches not found."""
    unseen_probability: FloatArray
    """Posterior probability that a branch was not found, see `spm_pin.nlp.multistart.unseen_probability`."""
    settled: BoolArray
    """Whether the stopping rule was met."""
    sigma: FloatArray
    """Smallest singular value of the loop equations at each branch, shape (..., 8), dimensionless; zero where two
    branches meet."""
    error_bound: FloatArray
    """A true branch is proved to be this near [m], in the norm of all nine coordinates, shape (..., 8)."""
    isolated: BoolArray
    """Whether it is proved to be the only one there, shape (..., 8)."""
    infeasibility: FloatArray
    """Where no branch was found: the smallest norm of the loop equations that least squares reach [m]."""
    outcomes: Mapping[str, int]
    """Number of times that the solver ended with each status, over all poses."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a search; the poses finished before are kept.

    Attributes
    ----------
    partial : Search
        The result so far, the other poses marked as unsolved.
    """

    def __init__(self, partial: Search) -> None:
        self.partial = partial
        super().__init__("interrupted; .partial holds the poses finished before")


def inverse_displacement(
    geometry: Geometry,
    pose: PoseLike,
    *,
    starts: int | None = None,
    seed: int = 0,
    solver: str = "newton",
    options: Mapping[str, Any] | None = None,
) -> SolutionSet:
    """Find the configurations that hold the platform in a pose, numerically.

    Parameters and errors are those of `search`, which also returns the statistics. The `SolutionSet` has the labels of
    `spm_pin.inverse_displacement`, without discriminants and degeneracy.
    """
    return search(geometry, pose, starts=starts, seed=seed, solver=solver, options=options).solutions


def search(
    geometry: Geometry,
    pose: PoseLike,
    *,
    starts: int | None = None,
    risk: float = 1e-3,
    seed: int = 0,
    solver: str = "newton",
    options: Mapping[str, Any] | None = None,
) -> Search:
    """Find the branches of a pose by multi-start, with statistics of the search.

    Parameters
    ----------
    geometry : Geometry
        The manipulator; its leg limits are not applied.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of {m} in {B}, translation in metres; one, or a batch of shape (...).
    starts : int, optional
        Starts per pose. If not given, starts are made until `unseen_probability` is at most `risk` and every
        branch found was hit twice; after 4096 the pose is left unsettled.
    risk : float
        Probability of a branch not found that is accepted; without meaning if `starts` is given.
    seed : int
        Seed of the random starts. A pose's result depends on the seed and the pose only, not on its batch.
    solver : str
        "newton" or "ipopt". With either, solutions are polished by Newton's method and certified.
    options : mapping, optional
        Options of IPOPT, as `casadi.nlpsol` takes them: ``{"ipopt.max_iter": 50}``.

    Returns
    -------
    Search
        The solutions and the statistics of the search.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    ArgumentError
        If another argument is not what it should be, or an option is refused.
    Interrupted
        By Ctrl-C; `.partial` holds the poses that were finished.

    Notes
    -----
    The rule is tested against certified counts of branches, 200 poses in leg space and 50 on all of SO(3) with ten
    seeds each: at the default risk 0 of 2500 searches missed a branch, that is at most 0.15 % with 95 % confidence.
    """
    check_instance(geometry, Geometry, "geometry")
    if starts is not None:
        starts = whole_number(starts, "starts", "a positive whole number, or None for the stopping rule", least=1)
    risk = real_number(risk, "risk", "a probability between 0 and 1", above=0.0, below=1.0)
    seed = whole_number(seed, "seed", "a whole number, not negative", most=1 << 128)
    choice(solver, "solver", SOLVERS)
    if options is not None:
        options = _options(options, solver)
    transform = as_rigid_transform(pose)
    matrices = transform.as_matrix().reshape(-1, 4, 4)
    method = IpoptSolver(geometry, options) if options else _ipopt(geometry) if solver == "ipopt" else None
    equations = loop_equations_of(geometry)
    found: list[Multistart] = []
    try:
        for matrix in matrices:
            started = Multistart(equations, matrix)
            started.run(method, starts, risk, np.random.default_rng(seed))
            found.append(started)
    except KeyboardInterrupt:
        found += [Multistart(equations, matrix) for matrix in matrices[len(found) :]]
        raise Interrupted(_collect(geometry, transform, found)) from None
    return _collect(geometry, transform, found)


loop_equations_of = functools.lru_cache(maxsize=32)(LoopEquations)
_ipopt = functools.lru_cache(maxsize=32)(IpoptSolver)


def _options(options: Mapping[str, Any], solver: str) -> dict[str, Any]:
    if not isinstance(options, Mapping) or not all(isinstance(name, str) for name in options):
        raise ArgumentError("options", "a mapping such as {'ipopt.max_iter': 50}", type_and_value(options))
    if options and solver != "ipopt":
        cause = "Did you mean solver='ipopt'?"
        raise ArgumentError("options", f"none for the solver {solver}", ", ".join(options), cause)
    return dict(options)


def _collect(geometry: Geometry, transform: Any, found: list[Multistart]) -> Search:
    """Gather the searches of all poses into arrays of the batch's shape."""
    shape = transform.shape
    joints = np.full((len(found), MOST_BRANCHES, 9), np.nan)
    solved = [len(run.kept) <= MOST_BRANCHES and run.status is not Status.UNSOLVED for run in found]
    for n, run in enumerate(found):
        for place, k in enumerate(run.kept[:MOST_BRANCHES]):
            joints[n, place] = run.certificates[k].b
    by_place = joints.reshape(*shape, MOST_BRANCHES, 3, 3)
    ordered = SolutionSet.from_unordered(geometry, transform, by_place, np.array(solved, dtype=bool).reshape(shape))
    branches = ordered.middle_joints.reshape(joints.shape)
    hits = np.zeros((len(found), MOST_BRANCHES), dtype=int)
    sigma, error = np.full(hits.shape, np.nan), np.full(hits.shape, np.nan)
    isolated = np.zeros(hits.shape, dtype=bool)
    for n, run in enumerate(found):
        for k in run.kept:
            at = n, (branches[n] == run.certificates[k].b).all(axis=-1)
            hits[at], isolated[at] = run.hits[k], run.certificates[k].isolated
            sigma[at], error[at] = run.certificates[k].sigma, run.certificates[k].error
    continuous = np.array([run.continuous for run in found], dtype=bool).reshape(shape)
    status = np.where(continuous, Status.DEGENERATE, ordered.status)
    outcomes: Counter[str] = sum((run.outcomes for run in found), Counter())

    def of(values: list[Any], kind: Any = np.float64) -> Any:
        return np.array(values, dtype=kind).reshape(shape)

    converged = hits.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        unseen_share = np.where(converged > 0, (hits == 1).sum(axis=-1) / converged, np.nan)
    return Search(
        solutions=SolutionSet(ordered.configurations, BRANCHES, status),
        starts=of([run.starts for run in found], int),
        hits=hits.reshape(*shape, MOST_BRANCHES),
        continuous=of([run.starts - run.failed - sum(run.hits[k] for k in run.kept) for run in found], int),
        failed=of([run.failed for run in found], int),
        failed_residual=of([run.failed_residual for run in found]),
        unseen_share=unseen_share.reshape(shape),
        unseen_probability=of([run.unseen_probability for run in found]),
        settled=of([run.settled for run in found], bool),
        sigma=sigma.reshape(*shape, MOST_BRANCHES),
        error_bound=error.reshape(*shape, MOST_BRANCHES),
        isolated=isolated.reshape(*shape, MOST_BRANCHES),
        infeasibility=of([run.infeasibility for run in found]),
        outcomes=dict(outcomes),
    )
