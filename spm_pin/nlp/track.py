"""Following a path of poses within limits: where a limit is met, the pose gives way as little as it can.

At a given pose a branch is a point and limits can only accept or refuse it. Here the pose may move as well, so
the platform stays as near to the path as leg limits and joint ranges let it, which the closed form has no answer to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry, LegLimits
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.nlp import loop_equations
from spm_pin.nlp.batched_newton import newton
from spm_pin.nlp.branch_search import Interrupted, loop_equations_of
from spm_pin.nlp.solvers import build, status_of

__all__ = ["JointRanges", "Track", "track"]

HELD = "Held"
_SOLVED = (HELD, "Solve_Succeeded", "Solved_To_Acceptable_Level")
_POLISH = 5


@dataclass(frozen=True)
class JointRanges:
    """How far the passive joints turn.

    Parameters
    ----------
    inclination : tuple of two floats, optional
        Least and greatest angle [rad] of every leg from the normal of the platform its revolute joint is on, in
        its plane, positive outward. None means unlimited.
    ball : float, optional
        Greatest angle [rad] between a leg and the middle platform's normal: the cone of the compound ball joints.
        None means unlimited.

    Raises
    ------
    ArgumentError
        If an angle is out of (-π/2, π/2), or a minimum not below its maximum.
    """

    inclination: tuple[float, float] | None = None
    ball: float | None = None

    def __post_init__(self) -> None:
        quarter = np.pi / 2.0
        if self.inclination is not None and not -quarter < self.inclination[0] < self.inclination[1] < quarter:
            raise ArgumentError("inclination", "-π/2 < minimum < maximum < π/2 in radians", self.inclination)
        if self.ball is not None and not 0.0 < self.ball < quarter:
            raise ArgumentError("ball", "an angle between 0 and π/2 in radians", self.ball, "Degrees?")


@dataclass(frozen=True)
class Track:
    """A path as it could be followed, arrays over its N poses.

    Attributes
    ----------
    configurations : Configuration
        Batch of shape (N,): states that close and respect every limit; NaN where the solver failed and after an
        interrupt.
    shift : ndarray, shape (N, 3)
        Position of o minus that asked for, in {B} [m]; zero where the pose was held.
    turn : ndarray, shape (N,)
        Angle between the rotation and that asked for [rad].
    limited : ndarray of bool, shape (N,)
        Where the pose had to give way.
    crossed : ndarray of bool, shape (N,)
        Where the state is on the other side of an inverse singularity than the seed: no machine gets there by
        this path without passing one.
    outcomes : tuple of str
        "Held" where the pose was held, else how IPOPT ended; none after an interrupt.
    """

    configurations: Configuration
    shift: FloatArray
    turn: FloatArray
    limited: npt.NDArray[np.bool_]
    crossed: npt.NDArray[np.bool_]
    outcomes: tuple[str, ...]

    @property
    def solved(self) -> npt.NDArray[np.bool_]:
        """Which poses have a configuration, shape (N,)."""
        return self.configurations.exists


def track(
    path: PoseLike,
    seed: Configuration,
    *,
    limits: LegLimits | None = None,
    ranges: JointRanges | None = None,
    options: Mapping[str, Any] | None = None,
) -> Track:
    """Follow a path of poses on the branch of a seed, within leg limits and joint ranges.

    Parameters
    ----------
    path : pose of shape (N,)
        Poses of {m} in {B}, in order; steps small against the distance between branches.
    seed : Configuration
        A single state near the first pose; it says which branch, and brings the geometry.
    limits : LegLimits, optional
        The geometry's own if not given; without either, none.
    ranges : JointRanges, optional
        Ranges of the passive joints; unlimited if not given.
    options : mapping, optional
        For IPOPT, as of `casadi.nlpsol`.

    Returns
    -------
    Track
        At each pose the state that minimises |shift|²/d² + |turn|², started from the state before.

    Raises
    ------
    PoseError
        If `path` is not rigid transforms of finite numbers.
    ArgumentError
        If `path` is not a sequence, `seed` not a single state that exists, or an option is refused.
    Interrupted
        By Ctrl-C; `.partial` holds the poses that were finished.

    Notes
    -----
    Held poses are solved to rounding; elsewhere the pose is optimal to IPOPT's tolerance, 1e-10, and the loops
    close to rounding.
    """
    transform = as_rigid_transform(path, "path")
    if len(transform.shape) != 1:
        raise ArgumentError("path", "poses of shape (N,)", f"shape {transform.shape}")
    if not isinstance(seed, Configuration) or seed.shape or not seed.exists:
        raise ArgumentError("seed", "a single Configuration that exists", repr(seed))
    problem = _Problem(seed.geometry, limits or seed.geometry.limits, ranges or JointRanges(), options)
    matrices = transform.as_matrix()
    placed = np.full((len(matrices), 4, 4), np.nan)
    placed[:, 3] = [0.0, 0.0, 0.0, 1.0]
    joints = np.full((len(matrices), 3, 3), np.nan)
    shift, turn = np.full((len(matrices), 3), np.nan), np.full(len(matrices), np.nan)
    crossed = np.zeros(len(matrices), dtype=bool)
    outcomes: list[str] = []

    def result() -> Track:
        placed[np.isnan(joints[:, 0, 0]), :3] = matrices[np.isnan(joints[:, 0, 0]), :3]
        states = Configuration.from_arrays(seed.geometry, placed[:, :3, :3], placed[:, :3, 3], joints)
        limited = np.array([outcome in _SOLVED[1:] for outcome in outcomes] + [False] * (len(joints) - len(outcomes)))
        return Track(states, shift, turn, limited, crossed, tuple(outcomes))

    state = np.concatenate([seed.middle_joints.ravel(), np.zeros(6)])
    side = problem.side(state[:9], seed.pose.as_matrix())
    try:
        for k, matrix in enumerate(matrices):
            solution, outcome = problem.solve(matrix, state, side)
            if outcome in _SOLVED:
                state = solution
                placed[k], joints[k], shift[k], turn[k] = problem.read(matrix, solution)
                crossed[k] = problem.side(joints[k].ravel(), placed[k]) != side
            outcomes.append(outcome)
    except KeyboardInterrupt:
        raise Interrupted(result()) from None
    return result()


class _Problem:
    """The NLP in b, the shift over d, and the turn as Cayley's parameters: tan(angle/2) times the axis."""

    def __init__(
        self, geometry: Geometry, limits: LegLimits | None, ranges: JointRanges, options: Mapping[str, Any] | None
    ) -> None:
        self.geometry = geometry
        self._options = options
        x, pose = ca.SX.sym("x", 15), ca.SX.sym("pose", 12)
        b, shift, cayley = x[:9], x[9:12], x[12:]
        cross = ca.skew(cayley)
        turn = ca.SX.eye(3) + 2.0 / (1.0 + ca.sumsqr(cayley)) * (cross + cross @ cross)
        rotation = turn @ ca.reshape(pose[:9], 3, 3)
        translation = pose[9:] + geometry.middle_side * shift
        rows = [loop_equations.equations(geometry, b, rotation, translation)]
        low, high = [np.zeros(9)], [np.zeros(9)]
        legs = loop_equations.leg_vectors(geometry, b, rotation, translation)
        lengths = [ca.norm_2(leg) for leg in legs]
        if limits is not None:
            rows += lengths
            low.append(np.array(limits.minimum))
            high.append(np.array(limits.maximum))
        for row in _range_rows(geometry, ranges, b, rotation, legs, lengths):
            rows.append(row)
            low.append(np.zeros(1))
            high.append(np.array([np.inf]))
        self._bounds = np.concatenate(low), np.concatenate(high)
        objective = ca.sumsqr(shift) + 4.0 * ca.sumsqr(cayley)
        self._rows = ca.Function("rows", [x, pose], [ca.vertcat(*rows)])
        self._solver = build(
            "track",
            {"x": x, "p": pose, "f": objective, "g": ca.vertcat(*rows)},
            options,
            # The default widens every bound by 1e-8; limits are meant as they stand.
            {"ipopt.tol": 1e-10, "ipopt.bound_relax_factor": 0.0, "ipopt.honor_original_bounds": "yes"},
        )
        self._polish = loop_equations_of(geometry)

    def side(self, b: FloatArray, matrix: FloatArray) -> float:
        """Return on which side of the inverse singularities b (9,) is: the sign of the loop equations' determinant."""
        return float(np.linalg.slogdet(self._polish(b[None], matrix)[1][0])[0])

    def solve(self, matrix: FloatArray, state: FloatArray, side: float) -> tuple[FloatArray, str]:
        """Solve for one pose (4, 4) from the unknowns (15,) of the state before."""
        low, high = self._bounds
        pose = np.concatenate([matrix[:3, :3].T.ravel(), matrix[:3, 3]])
        start = state
        b, converged = newton(self._polish, state[None, :9], matrix, _POLISH)
        if converged[0] and self.side(b[0], matrix) == side:
            start = np.concatenate([b[0], np.zeros(6)])
            rows = np.asarray(self._rows(start, pose)).ravel()[9:]
            if (rows >= low[9:]).all() and (rows <= high[9:]).all():
                # The objective is zero, and it cannot be less.
                return start, HELD
        found = np.asarray(self._solver(x0=start, p=pose, lbg=low, ubg=high)["x"]).ravel()
        return found, status_of(self._solver, self._options)

    def read(self, matrix: FloatArray, solution: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return the pose (4, 4), b (3, 3) [m], the shift (3,) [m] and the turn [rad] of a solution."""
        shift, cayley = self.geometry.middle_side * solution[9:12], solution[12:]
        x, y, z = cayley
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        placed = matrix.copy()
        placed[:3, :3] = (np.eye(3) + 2.0 / (1.0 + cayley @ cayley) * (cross + cross @ cross)) @ matrix[:3, :3]
        placed[:3, 3] += shift
        b, _ = newton(self._polish, solution[None, :9], placed, _POLISH)
        return placed, b[0].reshape(3, 3), shift, 2.0 * float(np.arctan(np.linalg.norm(cayley)))


def _range_rows(
    geometry: Geometry, ranges: JointRanges, b: ca.SX, rotation: ca.SX, legs: list[ca.SX], lengths: list[ca.SX]
) -> list[ca.SX]:
    """Return expressions that are not negative within the ranges, dimensionless."""
    rows = []
    up = loop_equations.vector([0.0, 0.0, 1.0])
    radial = [loop_equations.vector(direction) for direction in geometry.radial_directions]
    if ranges.inclination is not None:
        least, greatest = np.tan(ranges.inclination[0]), np.tan(ranges.inclination[1])
        lower = [(ca.dot(leg, u), ca.dot(leg, up)) for leg, u in zip(legs[:3], radial, strict=True)]
        # From c_i an upper leg points down, and outward along -leg.
        upper = [
            (-ca.dot(leg, rotation @ u), ca.dot(leg, rotation @ up)) for leg, u in zip(legs[3:], radial, strict=True)
        ]
        for (outward, along), length in zip(lower + upper, lengths, strict=True):
            rows += [(outward - least * along) / length, (greatest * along - outward) / length]
    if ranges.ball is not None:
        first, second, third = (b[3 * i : 3 * i + 3] for i in range(3))
        normal = ca.cross(second - first, third - first)
        scale = ca.norm_2(normal)
        rows += [
            ca.dot(leg, normal) / (length * scale) - np.cos(ranges.ball)
            for leg, length in zip(legs, lengths, strict=True)
        ]
    return rows
