"""A spanning tree with closures: the constraints, and the kinematics of the tree at one q.

With Jm the Jacobian of the terminal platform m at o, Jc that of the closures and S the selection of the six legs,
all joint velocities v of the mechanism that the closures admit solve, for a twist t of m or for leg rates ṙ,

    K v = (t, 0),    K = [Jm; Jc],        N v = (ṙ, 0),    N = [S; Jc],

of which N comes down to the columns of the passive joints in Jc.

Singular values need one unit: lengths are in units of d, the middle platform's side. And they should not depend on
how the tree describes a ball joint: its three rates are replaced by the angular velocity across it. Such velocities u
are of order one together, v = C u, and the scaled matrices are

    K̂ = [A Jm C; Jc C / d],    N̂ = [Ŝ; Jc C / d],    A = diag(1/d, 1/d, 1/d, 1, 1, 1),    S C = d Ŝ.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from spm_pin.description.closures import Closure
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.joint_layout import JointLayout

__all__ = ["SINGULAR", "ConstrainedModel", "Factors", "SingularValues", "TreeKinematics"]

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


class ConstrainedModel:
    """A Pinocchio model that holds the mechanism's tree, perhaps with another robot, and its closures; immutable.

    The closures are of kind "point", their frames in the model.
    """

    def __init__(self, model: Any, layout: JointLayout, closures: Iterable[Closure]) -> None:
        self.model, self.layout, self.closures = model, layout, tuple(closures)
        for closure in self.closures:
            if closure.kind != "point":
                raise ArgumentError("closures", "closures of kind point", repr(closure.kind))
        pairs = [[int(model.getFrameId(name)) for name in (c.frame_a, c.frame_b)] for c in self.closures]
        # A frame that several closures share is evaluated once.
        self.frames = list(dict.fromkeys(frame for pair in pairs for frame in pair))
        self.ends = np.array([[self.frames.index(frame) for frame in pair] for pair in pairs]).reshape(-1, 2)
        # A product takes a third of the time of picking rows and subtracting, and gives the same bits.
        unit = np.eye(len(self.frames))
        self._signs = unit[self.ends[:, 1]] - unit[self.ends[:, 0]]
        self.actuated = np.concatenate([layout.others, layout.v[layout.legs]])

    def differences(self, points: FloatArray) -> FloatArray:
        """Return, of an array over `frames`, the difference `frame_b` less `frame_a` for each closure."""
        found = self._signs.dot(points.reshape(len(self.frames), -1))
        return np.asarray(found.reshape(-1, *points.shape[1:]))

    def rigid_constraints(self) -> Any:
        """Return the closures in the form that `pinocchio.constraintDynamics` takes; they hold gains."""
        constraints = pin.StdVec_RigidConstraintModel()
        for pair in self.ends:
            a, b = (self.model.frames[self.frames[k]] for k in pair)
            places = a.parentJoint, a.placement, b.parentJoint, b.placement
            constraints.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self.model, *places, pin.LOCAL))
        return constraints


class Factors(NamedTuple):
    """The LU factorisation of a regular matrix, as of LAPACK's dgetrf."""

    lu: FloatArray
    pivots: Any

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


class TreeKinematics:
    """Gaps, Jacobians and their factorisations of a `ConstrainedModel` at one q, each computed on first use.

    `q` (nq,) are the joint values of the last `evaluate`, `data`, a pinocchio.Data, has the joint placements, Jacobians
    and frames there; other algorithms may work in it at the same q.
    """

    def __init__(self, constrained: ConstrainedModel) -> None:
        self.constrained, self.layout, self.model = constrained, constrained.layout, constrained.model
        self.data = self.model.createData()
        self.q = np.zeros(0)
        self._values: bytes | None = None
        self.still = np.zeros(self.model.nv)
        # The diagonal of A.
        self.twist_scale = np.array([1.0 / self.layout.side] * 3 + [1.0] * 3)
        # Where the balls' middle angles are in q.
        self._middles = [int(self.layout.q[ball[1]]) for ball in self.layout.balls]
        # Pinocchio updates these in place: no look-up at each q.
        self._points = [self.data.oMf[frame].translation for frame in constrained.frames]
        # Without other joints there is nothing to pick.
        self._chain = self.layout.v if len(self.layout.others) else None

    def evaluate(self, q: FloatArray) -> None:
        """Set the joint values (nq,) of the model; nothing is computed again for the last ones."""
        values, self.q = q.tobytes(), q
        if values == self._values:
            return
        self._values = None
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        self._values = values
        known = self.__dict__
        for name in _CACHED:
            known.pop(name, None)

    @cached_property
    def gap(self) -> FloatArray:
        """From the origin of `frame_a` to that of `frame_b` of each closure, in the universe's axes [m], (n, 3)."""
        return self.constrained.differences(np.concatenate(self._points).reshape(-1, 3))

    @cached_property
    def constraint_jacobian(self) -> FloatArray:
        """Jc: joint velocities (nv,) to the rates of the gaps, shape (3 n, nv); exact at any q, closed or not."""
        model, data, frames = self.model, self.data, self.constrained.frames
        rows = np.concatenate([pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in frames])
        return self.constrained.differences(rows.reshape(-1, 6, model.nv))[:, :3].reshape(-1, model.nv)

    def widest_gap(self) -> float:
        """Return the largest distance of two frames that a closure holds together [m]."""
        return math.sqrt(max(x * x + y * y + z * z for x, y, z in self.gap.tolist()))

    def gap_rate_bound(self, v: FloatArray) -> float:
        """Return the largest rate of a gap if all that joint velocities contribute to its ends had one sign [m/s]."""
        rates = np.abs(v)
        bound = float(max(np.abs(self.constraint_jacobian).dot(rates).tolist()))
        if self._chain is None:
            return bound
        # Another robot moves both ends of a gap alike: what is left of the difference is rounding of their speeds.
        others, model, data = self.layout.others, self.model, self.data
        ends = (pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in self.constrained.frames)
        return bound + max(float(np.abs(end[:3, others]).dot(rates[others]).max()) for end in ends)

    @property
    def chain_constraint_jacobian(self) -> FloatArray:
        """Jc's columns of the mechanism's own joints, shape (3 n, 18)."""
        jacobian = self.constraint_jacobian
        return jacobian if self._chain is None else jacobian[:, self._chain]

    @cached_property
    def platform_jacobian(self) -> FloatArray:
        """Jm: velocities of the mechanism's joints to the twist (v, ω) of m at o, shape (6, 18)."""
        jacobian = pin.getFrameJacobian(self.model, self.data, self.layout.platform_frame, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(jacobian if self._chain is None else jacobian[:, self._chain])

    def terminal_pose(self) -> tuple[FloatArray, FloatArray]:
        """Return copies of the rotation (3, 3) and the translation (3,) of m."""
        terminal = self.data.oMf[self.layout.platform_frame]
        return terminal.rotation.copy(), terminal.translation.copy()

    def corners(self) -> FloatArray:
        """Return b_1, b_2 and b_3 as rows (3, 3)."""
        return np.array([self.data.oMf[frame].translation for frame in self.layout.corner_frames])

    @cached_property
    def velocity_scale(self) -> FloatArray:
        """C: scaled velocities u (18,) to joint velocities, shape (18, 18)."""
        scale = np.diag(self.layout.units)
        for ball in self.layout.balls:
            scale[np.ix_(ball, ball)] = np.linalg.inv(self.platform_jacobian[3:, ball])
        return scale

    def inverse_matrix(self) -> FloatArray:
        """Return K̂, shape (18, 18)."""
        platform = self.twist_scale[:, None] * (self.platform_jacobian @ self.velocity_scale)
        return np.concatenate([platform, self.scaled_constraint_jacobian()])

    def forward_matrix(self) -> FloatArray:
        """Return N̂, shape (18, 18)."""
        return np.concatenate([np.eye(len(self.layout.v))[self.layout.legs], self.scaled_constraint_jacobian()])

    def scaled_constraint_jacobian(self) -> FloatArray:
        """Return Jc C / d, shape (12, 18)."""
        return np.asarray(self.chain_constraint_jacobian @ self.velocity_scale) / self.layout.side

    def singular_values(self) -> SingularValues:
        """Return the smallest singular values of K̂, N̂ and Jc C / d."""
        self.require_ball_angles()
        matrices = self.inverse_matrix(), self.forward_matrix(), self.scaled_constraint_jacobian()
        return SingularValues(*(float(np.linalg.svd(m, compute_uv=False)[-1]) for m in matrices))

    @cached_property
    def forward_factors(self) -> Factors:
        """Factors of Jc's columns of the passive joints (12, 12), regular where N is; else raises."""
        return self._factors(self.chain_constraint_jacobian.take(self.layout.passive, axis=1), "forward")

    @cached_property
    def inverse_factors(self) -> Factors:
        """Factors of [A Jm; Jc / d] (18, 18), K with rows of one unit; raises where it is singular."""
        rows = self.twist_scale[:, None] * self.platform_jacobian, self.chain_constraint_jacobian / self.layout.side
        return self._factors(np.concatenate(rows), "inverse")

    def velocities_of_twists(self) -> FloatArray:
        """Return X = K⁻¹ [I; 0]: twists of m to velocities of the mechanism's joints, shape (18, 6)."""
        unit = np.eye(len(self.layout.v), 6)
        unit[:6] *= self.twist_scale
        return self.inverse_factors.solve(unit)

    def velocities_of_legs(self, leg_rates: FloatArray) -> FloatArray:
        """Return N⁻¹ (ṙ, 0): leg rates (6,) to velocities of the mechanism's joints (18,)."""
        v = np.empty(len(self.layout.v))
        v[self.layout.legs] = leg_rates
        opening = self.chain_constraint_jacobian[:, self.layout.legs] @ leg_rates
        v[self.layout.passive] = -self.forward_factors.solve(opening)
        return v

    def forward_determinant(self) -> float:
        """Return the determinant of N in scaled velocities, but for a constant factor of the model."""
        return self.forward_factors.determinant() / self._ball_determinant()

    def inverse_determinant(self) -> float:
        """Return the determinant of K in scaled velocities, but for a constant factor of the model."""
        return self.inverse_factors.determinant() / self._ball_determinant()

    def _ball_determinant(self) -> float:
        """Return the determinant of what maps rates of the balls' joints to angular velocities, but for its sign."""
        return math.prod(math.cos(self.q.item(place)) for place in self._middles)

    def require_constrained(self) -> None:
        """Raise `SingularConfigurationError` where the closures lose rank."""
        try:
            # Regular with the legs held: of full rank. That is the case nearly everywhere, and cached.
            _ = self.forward_factors
        except SingularConfigurationError as error:
            if error.kind == "constraint":
                raise

    def require_ball_angles(self) -> None:
        """Raise `ArgumentError` where a ball joint's middle angle is ±90°."""
        for ball, place in zip(self.layout.balls, self._middles, strict=True):
            angle = self.q.item(place)
            if abs(math.cos(angle)) <= SINGULAR:
                expected = f"{self.layout.names[ball[1]]} away from ±90°"
                cause = "The axes of x and z coincide there, and the tree loses a rotation that the robot has"
                raise ArgumentError("q", expected, f"{math.degrees(angle):.9g}°", cause)

    def _factors(self, matrix: FloatArray, kind: str) -> Factors:
        self.require_ball_angles()
        lu, pivots, info = lapack.dgetrf(matrix)
        factors = Factors(lu, pivots)
        if info > 0 or not _is_regular(matrix, factors):
            scaled = self.forward_matrix() if kind == "forward" else self.inverse_matrix()
            for concerned, name in ((self.scaled_constraint_jacobian(), "constraint"), (scaled, kind)):
                values = np.linalg.svd(concerned, compute_uv=False)
                if values[-1] <= SINGULAR * values[0] or (name == kind and info > 0):
                    raise SingularConfigurationError(name, float(values[-1]))
        return factors


def _is_regular(matrix: FloatArray, factors: Factors) -> bool:
    """Return whether the reciprocal condition number of a matrix is above `SUSPECT`."""
    flat, others = matrix.ravel(), len(matrix) - 1
    square = float(flat.dot(flat))
    # All but the smallest singular value multiply to at most (F²/(n - 1))^((n - 1)/2), F the Frobenius norm: quicker
    # than LAPACK's estimate, and nearly always enough.
    size = abs(math.prod(factors.lu.diagonal().tolist()))
    if size * (others / square) ** (0.5 * others) > SUSPECT * math.sqrt(square):
        return True
    norm = lapack.dlange("1", matrix)  # type: ignore[call-arg]
    return bool(lapack.dgecon(factors.lu, norm)[0] > SUSPECT)


_CACHED = {name for name, member in vars(TreeKinematics).items() if isinstance(member, cached_property)}
