"""Rates of a spanning tree with closures, and how near it is to a singularity.

With Jm the Jacobian of the terminal platform m at o, Jc that of the closures and S the selection of the six legs,
all joint velocities v that the closures admit solve, for a twist t of m,

    K v = (t, 0),    K = [Jm; Jc],    J_f = S K⁻¹ [I; 0].

Singular values need one unit: lengths are in units of d, the middle platform's side. And they should know nothing
of how the tree describes a ball joint: its three rates are replaced by the angular velocity across it, in {B}. Such
velocities u are of order one together, v = C u, and the scaled matrices are

    K̂ = [A Jm C; Jc C / d],    N̂ = [Ŝ; Jc C / d],    A = diag(1/d, 1/d, 1/d, 1, 1, 1),    S C = d Ŝ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.placement import Placement

__all__ = ["BALLS", "SINGULAR", "Linearization", "SingularValues"]

BALLS = (("ball_b1_x", "ball_b1_y", "ball_b1_z"), ("ball_c1_z", "ball_c1_y", "ball_c1_x"))
"""The joints that stand for one ball joint each."""

SINGULAR = 64.0 * float(np.finfo(np.float64).eps)
"""A matrix is singular to rounding where its smallest singular value is at most this times its largest.

Ten joints lie between {B} and m, each adds a rounding or two of eps times an arm to an entry; some hundred entries
that are not zero make a matrix off by a few hundred eps in the Frobenius norm, of a largest singular value of about
five: a smaller singular value may as well be zero.
"""


@dataclass(frozen=True)
class SingularValues:
    """Smallest singular values at a configuration, dimensionless; each is named after what its zero means.

    Lengths are in units of the middle platform's side, the rates of a ball joint are its angular velocity. Arrays (...)
    for a batch.

    Attributes
    ----------
    inverse : float or ndarray
        Of K, the twist of m and the closures' rates: zero where the platform's twist does not determine the rates
        of the legs.
    forward : float or ndarray
        Of [S; Jc], the rates of the legs and of the closures: zero where the legs do not hold the platform.
    constraint : float or ndarray
        Of Jc, the rates of the closures: zero where the revolute joints of a stage do not constrain its platform.
        Then the other two are zero as well.
    """

    inverse: Any
    forward: Any
    constraint: Any


@dataclass(frozen=True)
class Linearization:
    """The velocities of a chain at one q.

    Attributes
    ----------
    platform : ndarray, shape (6, 18)
        Jm: joint velocities to the twist (v, ω) of m at o, in {B}.
    closures : ndarray, shape (12, 18)
        Jc: joint velocities to the rates of the gaps, in {B}.
    columns : ndarray, shape (18, 18)
        C, see the module.
    legs : ndarray of int, shape (6,)
        Where the legs are among the joint velocities.
    side : float
        d [m].
    """

    platform: FloatArray
    closures: FloatArray
    columns: FloatArray
    legs: npt.NDArray[np.intp]
    side: float

    @classmethod
    def at(
        cls, q: FloatArray, placement: Placement, constraints: ClosureConstraints, workspace: Workspace
    ) -> Linearization:
        """Evaluate the chain at q (18,); raises `ArgumentError` where a ball joint is at ±90°."""
        closures = constraints.evaluate(q, workspace)[1]
        pin.updateFramePlacement(placement.model, workspace.data, placement.platform)
        platform = pin.getFrameJacobian(placement.model, workspace.data, placement.platform, pin.LOCAL_WORLD_ALIGNED)
        side = placement.geometry.middle_side
        columns = np.eye(len(q))
        columns[placement.legs, placement.legs] = side
        for names in BALLS:
            ball = placement.indices(*names)
            axes = platform[3:, ball]
            if abs(np.linalg.det(axes)) <= SINGULAR:
                expected = f"{names[1]} away from ±90°"
                cause = "The axes of x and z coincide there, and the tree loses a rotation that the robot has"
                raise ArgumentError("q", expected, f"{np.rad2deg(q[ball[1]]):.9g}°", cause)
            columns[np.ix_(ball, ball)] = np.linalg.inv(axes)
        return cls(platform, closures, columns, placement.legs, side)

    @property
    def twist_scale(self) -> FloatArray:
        """The diagonal of A, shape (6,)."""
        return np.array([1.0 / self.side] * 3 + [1.0] * 3)

    def scaled_closures(self) -> FloatArray:
        """Return Jc C / d, shape (12, 18)."""
        return np.asarray(self.closures @ self.columns) / self.side

    def scaled_platform(self) -> FloatArray:
        """Return A Jm C, shape (6, 18)."""
        return self.twist_scale[:, None] * (self.platform @ self.columns)

    def motion(self) -> FloatArray:
        """Return K̂, shape (18, 18)."""
        return np.concatenate([self.scaled_platform(), self.scaled_closures()])

    def held(self) -> FloatArray:
        """Return N̂, shape (18, 18)."""
        return np.concatenate([np.eye(self.platform.shape[1])[self.legs], self.scaled_closures()])

    def joint_velocities(self) -> FloatArray:
        """Return K⁻¹ [I; 0], shape (18, 6), or raise at an inverse or constraint singularity."""
        inverse = self.regular_inverse(self.motion(), "inverse")
        return np.asarray(self.columns @ inverse[:, :6] * self.twist_scale)

    def regular_inverse(self, matrix: FloatArray, kind: str) -> FloatArray:
        """Return the inverse of K̂ or N̂, or raise `SingularConfigurationError`."""
        try:
            inverse = np.linalg.inv(matrix)
        except np.linalg.LinAlgError:
            inverse = np.full_like(matrix, np.inf)
        # σ_min is at least 1 / |A⁻¹|_F and σ_max at most |A|_F: most matrices are known to be regular.
        suspect = not np.linalg.norm(matrix) * np.linalg.norm(inverse) < 1e-3 / SINGULAR
        if suspect:
            for concerned, name in ((self.scaled_closures(), "constraint"), (matrix, kind)):
                values = np.linalg.svd(concerned, compute_uv=False)
                if values[-1] <= SINGULAR * values[0]:
                    raise SingularConfigurationError(name, float(values[-1]))
        return np.asarray(inverse)

    def singular_values(self) -> SingularValues:
        """Return the smallest singular values of K̂, N̂ and Jc C / d."""
        matrices = (self.motion(), self.held(), self.scaled_closures())
        return SingularValues(*(float(np.linalg.svd(m, compute_uv=False)[-1]) for m in matrices))
