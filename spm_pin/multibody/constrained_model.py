"""A spanning tree with closures: where joints and frames are in the model, and the kinematics of the tree at one q.

With Jm the Jacobian of the platform m at o, Jc that of the closures and S the selection of the legs, all joint
velocities v of the mechanism that the closures admit solve, for a twist t of m or for leg rates ṙ,

    K v = (W t, 0),    K = [W Jm; Jc],        N v = (ṙ, 0),    N = [S; Jc],

of which N comes down to the columns of the passive joints in Jc. W selects the freedoms: all six of a manipulator's
platform; for a stage the velocity along z and the angular velocities about the axes x and y of the platform, which turn
its normal. The parasitic motion follows from them. The closures' rows and Jc are those of any chain of
`spm_pin.loops`; that N and K are square is the machine's.

Singular values need one unit: lengths are in units of d, the middle platform's side. And they should not depend on
how the tree describes a ball joint: its three rates are replaced by the angular velocity across it. Such velocities u
are of order one together, v = C u, and the scaled matrices are, with Ŝ u the legs' rates, of lengths in units of d,

    K̂ = [W A Jm C; Jc C / d],    N̂ = [Ŝ; Jc C / d],    A = diag(1/d, 1/d, 1/d, 1, 1, 1).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from spm_pin.description.source_files import Closure
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.loops.closed_chain import ClosedChain as LoopChain
from spm_pin.loops.closures import Anchor
from spm_pin.loops.closures import Closure as LoopClosure
from spm_pin.loops.state_kinematics import StateKinematics
from spm_pin.loops.state_kinematics import read_vectors as read_any_vectors
from spm_pin.machine.joint_angles import actuated_joints, home_readings, joint_names
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import FloatArray, IntArray, frozen

SINGULAR = 64.0 * float(np.finfo(np.float64).eps)
"""A matrix is singular to rounding where its smallest singular value is at most this times its largest.

Each of the ten joints between {B} and m adds a rounding or two to an entry: matrices are off by a few hundred eps, of a
largest singular value of about five.
"""
SUSPECT = 1e-9
"""Reciprocal condition number below which a factorisation is checked by singular values: they take longer."""
_MEANINGS = {
    **dict.fromkeys(("q", "q0", "near"), "joint values in rad and m in Pinocchio's order"),
    **dict.fromkeys(("v", "v0", "a"), "rates of the joints in Pinocchio's order"),
    **dict.fromkeys(("other", "chain"), "in Pinocchio's order"),
    "readings": "of the legs in m, for RRS legs in rad",
    "leg_rates": "of the legs in m/s, for RRS legs in rad/s",
    "leg_accelerations": "of the legs in m/s², for RRS legs in rad/s²",
    "forces": "of the actuators in N and N m",
    "twist": "(v, ω) at o in {B} in m/s and rad/s, for a stage (v_z, ω_x, ω_y)",
    "acceleration": "of o in m/s², angular in rad/s², in {B}, for a stage of (v_z, ω_x, ω_y)",
    "wrench": "(f, m) in N and N m in the axes of {B}",
}
"""Meaning of each argument, for messages."""


def read_vectors(value: npt.ArrayLike, argument: str, size: int, *, single: bool = False) -> FloatArray:
    """Return vectors (..., size) as float64, or one (size,), or raise `ArgumentError`."""
    array = read_any_vectors(value, argument, size, _MEANINGS[argument])
    if single and array.ndim != 1:
        raise ArgumentError(argument, f"shape ({size},), {_MEANINGS[argument]}", f"shape {array.shape}")
    return array


def widest(gap: FloatArray) -> float:
    """Return the largest distance of two points that a closure holds together [m], from the rows (3 n,) of all."""
    return float(np.linalg.norm(gap.reshape(-1, 3), axis=-1).max())


class SingularValues(NamedTuple):
    """Smallest singular values at a configuration, dimensionless; each is named after what its zero means.

    Lengths are in units of the middle platform's side, the rates of a ball joint are its angular velocity. Arrays (...)
    for a batch.
    """

    inverse: Any
    """That of K̂, twist of {m} and rates of the closures: zero where the twist does not determine the leg rates."""
    forward: Any
    """That of N̂, rates of the legs and of the closures: zero where the legs do not hold the platform."""
    constraint: Any
    """That of Jc C / d, rates of the closures: zero where the revolute joints of a stage do not constrain its platform.
    Then the other two are zero as well."""


class Factors(NamedTuple):
    """The LU factorisation of a matrix as of LAPACK's dgetrf; a tenth of the time of SciPy's `lu_solve` each."""

    lu: FloatArray
    pivots: Any
    zero_pivot: bool  # a pivot is exactly zero: `solve` has no meaning

    def is_regular(self, matrix: FloatArray) -> bool:
        """Return whether the reciprocal condition number of the matrix that was factorised is above `SUSPECT`."""
        norm = lapack.dlange("1", matrix)  # type: ignore[call-arg]
        return not self.zero_pivot and bool(lapack.dgecon(self.lu, norm)[0] > SUSPECT)

    def solve(self, right_side: FloatArray) -> FloatArray:
        """Return A⁻¹ b, for one or several columns b."""
        if right_side.ndim > 1:
            # One by one: for several, OpenBLAS waits for threads, which may take milliseconds.
            return np.stack([self.solve(column) for column in right_side.T], axis=-1)
        return np.asarray(lapack.dgetrs(self.lu, self.pivots, right_side)[0])

    def solve_transposed(self, right_side: FloatArray) -> FloatArray:
        """Return A⁻ᵀ b."""
        return np.asarray(lapack.dgetrs(self.lu, self.pivots, right_side, trans=1)[0])


class ConstrainedModel:
    """A Pinocchio model that holds the mechanism's tree, perhaps with another robot's, and its closures; immutable.

    The joints of the mechanism, eighteen or nine, are counted in Pinocchio's order, which is that of a chain's own q.
    `prefix` is prepended to the names of its links and joints in the model. `freedoms` are the rows of a twist that a
    caller gives: all six, or v_z, ω_x and ω_y of a stage.
    """

    def __init__(self, model: Any, closures: tuple[Closure, ...], machine: Machine, prefix: str) -> None:
        self.closures, self.machine = closures, machine
        self.is_stage = machine.is_stage
        self.freedoms = np.array([2, 3, 4] if self.is_stage else range(6), dtype=np.intp)
        joints = {name: model.joints[model.getJointId(prefix + name)] for name in joint_names(machine)}
        names = sorted(joints, key=lambda name: joints[name].idx_q)
        self.names, self._prefix = tuple(prefix + name for name in names), prefix
        # Indices of the joints in the model's q and v, and of all other degrees of freedom in v.
        self.in_q = np.array([joints[name].idx_q for name in names], dtype=np.intp)
        self.in_v = np.array([joints[name].idx_v for name in names], dtype=np.intp)
        self.others = np.setdiff1d(np.arange(model.nv), self.in_v)
        # Among them: the actuated joints in the order of the legs, the passive ones, and those of each ball.
        self.legs = frozen(self.joint_indices(*actuated_joints(machine)))
        corners = [leg[2:] for leg in machine.legs.names[::3]]
        orders = [[f"ball_{leg}_{axis}" for axis in axes] for leg, axes in zip(corners, ("xyz", "zyx"), strict=False)]
        self.balls = tuple(self.joint_indices(*ball) for ball in orders)
        self.passive_in_v = self.in_v[np.setdiff1d(np.arange(len(names)), self.legs)]
        self.legs_in_v = self.in_v[self.legs]
        # Indices of the actuators in v: all of another robot, then the legs.
        self.actuated = frozen(np.concatenate([self.others, self.legs_in_v]))
        self._actuated_in_q = self.in_q[self.legs]
        # Without offsets; RPS legs have no negative length.
        self.home_readings = home_readings(machine)
        self.least_readings = machine.legs.least_readings
        # d [m].
        self.side = machine.ball_side
        # Units of a step of order one in each joint: 1 rad, or d.
        self.units = np.ones(len(names))
        self.units[self.legs[np.array(machine.legs.units) == "m"]] = self.side
        self.platform = prefix + ("platform" if self.is_stage else "terminal_platform")
        self.platform_frame = int(model.getFrameId(self.platform))
        # A stage's corners follow from the pose of its platform.
        self.corner_frames = [int(model.getFrameId(f"{prefix}middle_b{i}")) for i in "123" if not self.is_stage]
        self.pairs = [[int(model.getFrameId(name)) for name in (c.frame_a, c.frame_b)] for c in closures]
        ends = [LoopClosure("point", Anchor(c.frame_a), Anchor(c.frame_b), c.name) for c in closures]
        self.loops = LoopChain(model, ends, [self.names[k] for k in self.legs])
        # It has copied the model.
        self.model = self.loops.model

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return type(self), (self.model, self.closures, self.machine, self._prefix)

    def joint_indices(self, *names: str) -> IntArray:
        """Return the indices (n,) of joints among the mechanism's, with or without prefix."""
        place = {name.removeprefix(self._prefix): k for k, name in enumerate(self.names)}
        bare = [name.removeprefix(self._prefix) for name in names]
        unknown = [name for name in bare if name not in place]
        if unknown:
            raise ArgumentError("names", f"joints: {', '.join(place)}", ", ".join(map(repr, unknown)))
        return np.array([place[name] for name in bare], dtype=np.intp)

    def readings(self, q: FloatArray) -> FloatArray:
        """Return the readings (..., legs), offsets aside, in q (..., nq)."""
        return np.asarray(self.home_readings + q.take(self._actuated_in_q, axis=-1))

    def check_readings(self, readings: FloatArray, argument: str, cause: str) -> None:
        """Raise `ArgumentError` where readings (..., legs), offsets aside, are of legs of negative length."""
        short = readings - self.least_readings
        if (min(short.tolist()) if short.ndim == 1 else short.min(initial=0.0)) < 0.0:
            worst = np.unravel_index(int(short.argmin()), short.shape)
            received = f"{readings[worst]:g} m in {self.machine.legs.names[worst[-1]]}"
            raise ArgumentError(argument, "legs of no negative length", received, cause)

    def read_q(self, q: npt.ArrayLike, argument: str = "q", *, single: bool = False) -> FloatArray:
        """Return joint values (..., nq) as an array, or raise `ArgumentError`."""
        array = read_vectors(q, argument, self.model.nq, single=single)
        cause = "The value of a slide is the leg's length minus its length at home"
        self.check_readings(self.readings(array), argument, cause)
        return array


class TreeKinematics(StateKinematics):
    """Kinematics of the loops of a `ConstrainedModel`, with the terminal platform and the angles of the balls."""

    remedy = "The method project closes the loops"

    def __init__(self, constrained: ConstrainedModel) -> None:
        super().__init__(constrained.loops, constrained.actuated)
        self.constrained, self._side = constrained, constrained.side
        # The diagonal of W A.
        self._twist_scale = np.array([1.0 / self._side] * 3 + [1.0] * 3)[constrained.freedoms]
        self._unit_twists = np.eye(len(self._twist_scale) + len(self.row_units))[:, : len(self._twist_scale)]
        self._unit_twists *= self._twist_scale
        # The balls' middle angles in q, and their names.
        self._middles = [(int(constrained.in_q[ball[1]]), constrained.names[ball[1]]) for ball in constrained.balls]

    def in_universe(self, rows: FloatArray, *, back: bool = False) -> FloatArray:
        """Return rows of the closures (3 n, ...), which are along the axes of `frame_a`, in the universe's, or back."""
        axes = np.array([self.data.oMf[a].rotation for a, _ in self.constrained.pairs])
        axes = axes.swapaxes(1, 2) if back else axes
        return np.asarray((axes @ rows.reshape(len(axes), 3, -1)).reshape(rows.shape))

    @cached_property
    def platform_jacobian(self) -> FloatArray:
        """Jm: velocities of the mechanism's joints to the twist (v, ω) of m at o, shape (6, joints)."""
        return self.frame_jacobian(self.constrained.platform_frame).take(self.constrained.in_v, axis=1)

    def platform_drift(self, v: FloatArray) -> FloatArray:
        """Return the acceleration of m (6,) where no joint accelerates."""
        return self.frame_acceleration(self.constrained.platform_frame, v, self.zero_velocity)

    def terminal_pose(self) -> tuple[FloatArray, FloatArray]:
        """Return copies of the rotation (3, 3) and the translation (3,) of m."""
        terminal = self.data.oMf[self.constrained.platform_frame]
        return terminal.rotation.copy(), terminal.translation.copy()

    def nondimensional(self, platform: FloatArray) -> FloatArray:
        """Return W A p of vectors p of the platform (6, ...)."""
        if self.constrained.is_stage:
            axes = self.data.oMf[self.constrained.platform_frame].rotation[:, :2]
            platform = np.concatenate([platform[2:3], axes.T @ platform[3:]])
        return (self._twist_scale * platform.T).T

    @cached_property
    def forward_factors(self) -> Factors:
        """Factors of Jc's columns of the passive joints (3 n, 3 n), regular where N is; else raises."""
        return self._factors(self.jacobian.take(self.constrained.passive_in_v, axis=1), "forward")

    @cached_property
    def inverse_factors(self) -> Factors:
        """Factors of [W A Jm; Jc / d], K with rows of one unit; raises where it is singular."""
        rows = self.nondimensional(self.platform_jacobian), self.jacobian / self._side
        return self._factors(np.concatenate(rows), "inverse")

    def _factors(self, matrix: FloatArray, kind: str) -> Factors:
        self.check_ball_angles()
        lu, pivots, info = lapack.dgetrf(matrix)
        factors = Factors(lu, pivots, info > 0)
        if not factors.is_regular(matrix):
            matrices = self.scaled_matrices()._asdict()
            for name in ("constraint", kind):
                values = np.linalg.svd(matrices[name], compute_uv=False)
                if values[-1] <= SINGULAR * values[0] or (name == kind and factors.zero_pivot):
                    raise SingularConfigurationError(name, float(values[-1]))
        return factors

    @property
    def are_independent(self) -> bool:
        """True, or raises `SingularConfigurationError` where the closures lose rank: those of regular q never do."""
        try:
            # Regular with the legs held, as nearly everywhere: of full rank.
            _ = self.forward_factors
        except SingularConfigurationError as error:
            if error.kind == "constraint":
                raise
        return True

    def accelerate(self, q: FloatArray, v: FloatArray, forces: FloatArray) -> bool:
        """Do the same as the base, but leave a ball at ±90° to `check_ball_angles`."""
        angles = [angle for place, _ in self._middles for angle in q[place :: self.model.nq].tolist()]
        if any(abs(math.cos(angle)) <= SINGULAR for angle in angles):
            return False
        return super().accelerate(q, v, forces)

    def velocities_along(self, platform: FloatArray, opening: FloatArray | None = None) -> FloatArray:
        """Return K⁻¹ (W p, c), with p (6,) of the platform and c (3 n,) of the closures, by default zero, as rates."""
        closures = np.zeros(len(self.row_units)) if opening is None else opening / self._side
        return self.inverse_factors.solve(np.concatenate([self.nondimensional(platform), closures]))

    def velocities_of_legs(self, rates: FloatArray, opening: FloatArray | float = 0.0) -> FloatArray:
        """Return N⁻¹ (ṙ, c): leg rates, and c (3 n,) of the closures, to velocities of the joints."""
        v, constrained = np.empty(len(self.constrained.names)), self.constrained
        v[constrained.legs_in_v] = rates
        missing = opening - self.jacobian.take(constrained.legs_in_v, axis=1).dot(rates)
        v[constrained.passive_in_v] = self.forward_factors.solve(missing)
        return v

    def balance(self, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return leg forces, and forces of the rows (3 n,), that give generalized forces (nv,) of the machine's joints.

        The actuators do not act on the passive joints: their rows give λ, and the rows of the legs what remains.
        """
        legs = self.constrained.legs_in_v
        rows = self.forward_factors.solve_transposed(forces.take(self.constrained.passive_in_v))
        return forces.take(legs) - rows.dot(self.jacobian.take(legs, axis=1)), rows

    @cached_property
    def velocities_of_twists(self) -> FloatArray:
        """Map X from twists of m, or (v_z, ω_x, ω_y) for a stage, to joint velocities, shape (joints, n)."""
        velocities = self.inverse_factors.solve(self._unit_twists)
        if not self.constrained.is_stage:
            return velocities
        freedoms = (self.platform_jacobian @ velocities)[self.constrained.freedoms]
        # v_z is an argument of both; ω_x and ω_y hardly determine the turn of the normal of a steep platform.
        sigma = float(np.linalg.svd(freedoms[1:, 1:], compute_uv=False)[-1])
        if sigma <= SINGULAR:
            raise SingularConfigurationError("inverse", sigma)
        return np.asarray(velocities @ np.linalg.inv(freedoms))

    @cached_property
    def velocity_scale(self) -> FloatArray:
        """C: scaled velocities u to joint velocities, shape (joints, joints)."""
        scale = np.diag(self.constrained.units)
        for ball in self.constrained.balls:
            scale[np.ix_(ball, ball)] = np.linalg.inv(self.platform_jacobian[3:, ball])
        return scale

    def scaled_constraint_jacobian(self) -> FloatArray:
        """Return Jc C / d, shape (3 n, joints)."""
        return np.asarray(self.jacobian.take(self.constrained.in_v, axis=1) @ self.velocity_scale) / self._side

    def scaled_matrices(self) -> SingularValues:
        """Return K̂, N̂ and Jc C / d in place of their smallest singular values."""
        legs, closures = np.eye(len(self.constrained.names))[self.constrained.legs], self.scaled_constraint_jacobian()
        platform = self.nondimensional(self.platform_jacobian @ self.velocity_scale)
        return SingularValues(np.concatenate([platform, closures]), np.concatenate([legs, closures]), closures)

    def singular_values(self) -> SingularValues:
        """Return the smallest singular values of K̂, N̂ and Jc C / d."""
        self.check_ball_angles()
        return SingularValues(*(float(np.linalg.svd(m, compute_uv=False)[-1]) for m in self.scaled_matrices()))

    def check_ball_angles(self) -> None:
        """Raise `ArgumentError` where a ball joint's middle angle is ±90°."""
        for place, name in self._middles:
            angle = self.q.item(place)
            if abs(math.cos(angle)) <= SINGULAR:
                cause = "The axes of x and z coincide there, and the tree loses a rotation that the robot has"
                raise ArgumentError("q", f"{name} away from ±90°", f"{math.degrees(angle):.9g}°", cause)
