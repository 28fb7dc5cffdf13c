"""A spanning tree with closures: where joints and frames are in the model, and the kinematics of the tree at one q.

With Jm the Jacobian of the platform m at o, Jc that of the closures and S the selection of the legs, all joint
velocities v of the mechanism that the closures admit solve, for a twist t of m or for leg rates ṙ,

    K v = (W t, 0),    K = [W Jm; Jc],        N v = (ṙ, 0),    N = [S; Jc],

of which N comes down to the columns of the passive joints in Jc. W selects the freedoms: all six of a manipulator's
platform; for a stage the velocity along z and the angular velocities about the axes x and y of the platform, which turn
its normal. The parasitic motion follows from them.

Singular values need one unit: lengths are in units of d, the middle platform's side. And they should not depend on
how the tree describes a ball joint: its three rates are replaced by the angular velocity across it. Such velocities u
are of order one together, v = C u, and the scaled matrices are, with Ŝ u the legs' rates, of lengths in units of d,

    K̂ = [W A Jm C; Jc C / d],    N̂ = [Ŝ; Jc C / d],    A = diag(1/d, 1/d, 1/d, 1, 1, 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.linalg import lapack

from spm_pin.description.source_files import Closure
from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.loops.point_dynamics import PointDynamics
from spm_pin.machine.joint_angles import actuated_joints, home_readings, joint_names
from spm_pin.machine.machine import Machine
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import FloatArray, IntArray, frozen, real_array

AGREEMENT = 1e-9
"""Relative difference of lengths up to which it is taken for rounding; above it they are of another robot."""
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
    if (
        type(value) is np.ndarray
        and value.shape == (size,)
        and value.dtype == np.float64
        # For the single vectors of control loops an eighth of the time of NumPy's own tests.
        and (math.isfinite(sum(value.tolist())) or np.isfinite(value).all())
    ):
        return value
    array = real_array(value, argument, (size,), _MEANINGS[argument])
    if single and array.ndim != 1:
        raise ArgumentError(argument, f"shape ({size},), {_MEANINGS[argument]}", f"shape {array.shape}")
    return array


def largest(vector: FloatArray) -> float:
    """Return the largest absolute value of a short vector: quicker than NumPy."""
    return float(max(map(abs, vector.tolist())))


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


class ConstrainedModel:
    """A Pinocchio model that holds the mechanism's tree, perhaps with another robot's, and its closures; immutable.

    The joints of the mechanism, eighteen or nine, are counted in Pinocchio's order, which is that of a chain's own q.
    `prefix` is prepended to the names of its links and joints in the model. `freedoms` are the rows of a twist that a
    caller gives: all six, or v_z, ω_x and ω_y of a stage.
    """

    def __init__(self, model: Any, closures: tuple[Closure, ...], machine: Machine, prefix: str) -> None:
        self.model, self.closures, self.machine = model, closures, machine
        self.is_stage = isinstance(machine, Stage)
        self.freedoms = np.array([2, 3, 4] if self.is_stage else range(6), dtype=np.intp)
        joints = {name: model.joints[model.getJointId(prefix + name)] for name in joint_names(machine)}
        names = sorted(joints, key=lambda name: joints[name].idx_q)
        self.names, self._prefix = tuple(prefix + name for name in names), prefix
        # Indices of the joints in the model's q and v, and of all other degrees of freedom in v.
        self.in_q = np.array([joints[name].idx_q for name in names], dtype=np.intp)
        self.in_v = np.array([joints[name].idx_v for name in names], dtype=np.intp)
        self.others = np.setdiff1d(np.arange(model.nv), self.in_v)
        # Among them: the actuated joints in the order of the legs, the other joints, and those that represent each
        # ball.
        self.legs = frozen(self.joint_indices(*actuated_joints(machine)))
        self.passive = np.setdiff1d(np.arange(len(names)), self.legs)
        corners = [leg[2:] for leg in machine.legs.names[::3]]
        orders = [[f"ball_{leg}_{axis}" for axis in axes] for leg, axes in zip(corners, ("xyz", "zyx"), strict=False)]
        self.balls = tuple(self.joint_indices(*ball) for ball in orders)
        # Indices of the actuators in v: all of another robot, then the legs.
        self.actuated = frozen(np.concatenate([self.others, self.in_v[self.legs]]))
        self._actuated_in_q = self.in_q[self.legs]
        # Without offsets; RPS legs have no negative length.
        self.home_readings = home_readings(machine)
        self.least_readings = machine.legs.least_readings
        # d, and the part of platforms and links in the length of a loop [m].
        self.side = machine.ball_side
        self._fixed_sizes = sum(base for base, _ in machine.stage_radii) + self.side
        self._fixed_sizes += sum(float(kind.links.sum()) for kind in machine.legs.kinds)
        # Units of a step of order one in each joint: 1 rad, or d.
        self._are_lengths = np.array(machine.legs.units) == "m"
        self.units = np.ones(len(names))
        self.units[self.legs[self._are_lengths]] = self.side
        self.platform = prefix + ("platform" if self.is_stage else "terminal_platform")
        self.platform_frame = int(model.getFrameId(self.platform))
        # A stage's corners follow from the pose of its platform.
        self.corner_frames = [int(model.getFrameId(f"{prefix}middle_b{i}")) for i in "123" if not self.is_stage]
        # A frame that several closures share is evaluated once.
        self.pairs = [[int(model.getFrameId(name)) for name in (c.frame_a, c.frame_b)] for c in closures]
        self.frames = list(dict.fromkeys(frame for pair in self.pairs for frame in pair))
        unit = np.eye(len(self.frames))
        self.signs = np.array([unit[self.frames.index(b)] - unit[self.frames.index(a)] for a, b in self.pairs])

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

    def rounding(self, q: FloatArray) -> float:
        """Return the size of a gap that rounding explains [m]: a few eps times the length of the loops."""
        lengths = np.abs(self.readings(q)).sum(where=self._are_lengths)
        return 32.0 * float(np.finfo(np.float64).eps) * float(self._fixed_sizes + lengths)

    def read_q(self, q: npt.ArrayLike, argument: str = "q", *, single: bool = False) -> FloatArray:
        """Return joint values (..., nq) as an array, or raise `ArgumentError`."""
        array = read_vectors(q, argument, self.model.nq, single=single)
        cause = "The value of a slide is the leg's length minus its length at home"
        self.check_readings(self.readings(array), argument, cause)
        return array

    def point_dynamics(self) -> PointDynamics:
        """Return what computes accelerations under forces."""
        frames = [[self.model.frames[frame] for frame in pair] for pair in self.pairs]
        return PointDynamics(self.model, ((a.parentJoint, a.placement, b.parentJoint, b.placement) for a, b in frames))

    def linear_differences(self, spatial: Sequence[FloatArray]) -> FloatArray:
        """Return, per closure, the linear part at `frame_b` less that at `frame_a`, of vectors at `frames`.

        They are spatial vectors (6,) or matrices (6, m); the result is (3 n,) or (3 n, m).
        """
        rows = np.concatenate(spatial)
        differences = self.signs.dot(rows.reshape(len(self.frames), -1)).reshape(-1, 6, *rows.shape[1:])
        return np.asarray(differences[:, :3].reshape(-1, *rows.shape[1:]))


class TreeKinematics:
    """Gaps, Jacobians and their factorisations of a `ConstrainedModel` at one q, each computed on first use.

    `q` (nq,) are the joint values of the last `evaluate`, `data`, a pinocchio.Data, has the joint placements, Jacobians
    and frames there; other algorithms may work in it at the same q.
    """

    def __init__(self, constrained: ConstrainedModel) -> None:
        self.constrained, self.model = constrained, constrained.model
        self.data = self.model.createData()
        self.q = np.zeros(0)
        self.zero_velocity = frozen(np.zeros(self.model.nv))
        self._values: bytes | None = None
        self._side = constrained.side
        # The diagonal of W A.
        self._twist_scale = np.array([1.0 / self._side] * 3 + [1.0] * 3)[constrained.freedoms]
        count = len(constrained.freedoms)
        self._unit_twists = self._scaled(np.eye(count), np.zeros((len(constrained.names) - count, count)))
        # Indices of the balls' middle angles in q.
        self._middles = [int(constrained.in_q[ball[1]]) for ball in constrained.balls]
        # Pinocchio updates these in place: no look-up at each q.
        self._points = [self.data.oMf[frame].translation for frame in constrained.frames]
        # The mechanism's own columns; without other joints there is nothing to pick.
        self._own: Any = constrained.in_v if len(constrained.others) else slice(None)

    def evaluate(self, q: FloatArray) -> None:
        """Evaluate the kinematics at q (nq,), unless q is unchanged."""
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
        """Gaps from the origin of `frame_a` to that of `frame_b`, in the universe's axes [m], (n, 3)."""
        return np.asarray(self.constrained.signs.dot(np.concatenate(self._points).reshape(-1, 3)))

    @cached_property
    def widest_gap(self) -> float:
        """Largest distance of two frames that a closure holds together [m]."""
        return math.sqrt(max(x * x + y * y + z * z for x, y, z in self.gap.tolist()))

    def frame_jacobian(self, frame: int) -> FloatArray:
        """Return the Jacobian (6, nv) of a frame, at its origin in the universe's axes."""
        return np.asarray(pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED))

    @cached_property
    def constraint_jacobian(self) -> FloatArray:
        """Jc: joint velocities (nv,) to the rates of the gaps, shape (3 n, nv); exact at any q, closed or not."""
        return self.constrained.linear_differences([self.frame_jacobian(frame) for frame in self.constrained.frames])

    @cached_property
    def own_constraint_jacobian(self) -> FloatArray:
        """Jc's columns of the mechanism's own joints, shape (3 n, joints)."""
        return np.asarray(self.constraint_jacobian[:, self._own])

    @cached_property
    def platform_jacobian(self) -> FloatArray:
        """Jm: velocities of the mechanism's joints to the twist (v, ω) of m at o, shape (6, joints)."""
        return np.asarray(self.frame_jacobian(self.constrained.platform_frame)[:, self._own])

    def terminal_pose(self) -> tuple[FloatArray, FloatArray]:
        """Return copies of the rotation (3, 3) and the translation (3,) of m."""
        terminal = self.data.oMf[self.constrained.platform_frame]
        return terminal.rotation.copy(), terminal.translation.copy()

    def nondimensional(self, platform: FloatArray, closures: FloatArray) -> FloatArray:
        """Return [W A p; c / d] of rows p of the platform (6, ...) and c of the closures (3 n, ...)."""
        return self._scaled(self.of_freedoms(platform), closures)

    def _scaled(self, freedoms: FloatArray, closures: FloatArray) -> FloatArray:
        return np.concatenate([(self._twist_scale * freedoms.T).T, closures / self._side])

    def of_freedoms(self, platform: FloatArray) -> FloatArray:
        """Return W p of vectors p of the platform (6, ...)."""
        if not self.constrained.is_stage:
            return platform
        axes = self.data.oMf[self.constrained.platform_frame].rotation[:, :2]
        return np.concatenate([platform[2:3], axes.T @ platform[3:]])

    @cached_property
    def velocity_scale(self) -> FloatArray:
        """C: scaled velocities u to joint velocities, shape (joints, joints)."""
        scale = np.diag(self.constrained.units)
        for ball in self.constrained.balls:
            scale[np.ix_(ball, ball)] = np.linalg.inv(self.platform_jacobian[3:, ball])
        return scale

    def scaled_constraint_jacobian(self) -> FloatArray:
        """Return Jc C / d, shape (3 n, joints)."""
        return np.asarray(self.own_constraint_jacobian @ self.velocity_scale) / self._side

    def scaled_matrices(self) -> SingularValues:
        """Return K̂, N̂ and Jc C / d in place of their smallest singular values."""
        scale, legs = self.velocity_scale, np.eye(len(self.constrained.names))[self.constrained.legs]
        inverse = self.nondimensional(self.platform_jacobian @ scale, self.own_constraint_jacobian @ scale)
        closures = self.scaled_constraint_jacobian()
        return SingularValues(inverse, np.concatenate([legs, closures]), closures)

    def singular_values(self) -> SingularValues:
        """Return the smallest singular values of K̂, N̂ and Jc C / d."""
        self.check_ball_angles()
        return SingularValues(*(float(np.linalg.svd(m, compute_uv=False)[-1]) for m in self.scaled_matrices()))

    @cached_property
    def forward_factors(self) -> Factors:
        """Factors of Jc's columns of the passive joints (3 n, 3 n), regular where N is; else raises."""
        return self._factors(self.own_constraint_jacobian.take(self.constrained.passive, axis=1), "forward")

    @cached_property
    def inverse_factors(self) -> Factors:
        """Factors of [W A Jm; Jc / d], K with rows of one unit; raises where it is singular."""
        return self._factors(self.nondimensional(self.platform_jacobian, self.own_constraint_jacobian), "inverse")

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

    def velocities_of_legs(self, leg_rates: FloatArray, closing: FloatArray | float = 0.0) -> FloatArray:
        """Return N⁻¹ (ṙ, -c): leg rates, and c (3 n,) by which gaps close, to velocities of the mechanism's joints."""
        v = np.empty(len(self.constrained.names))
        v[self.constrained.legs] = leg_rates
        opening = self.own_constraint_jacobian[:, self.constrained.legs] @ leg_rates + closing
        v[self.constrained.passive] = -self.forward_factors.solve(opening)
        return v

    def forward_determinant(self) -> float:
        """Return the determinant of N in scaled velocities, but for a constant factor of the model."""
        return self._scaled_determinant(self.forward_factors)

    def inverse_determinant(self) -> float:
        """Return the determinant of K in scaled velocities, but for a constant factor of the model."""
        return self._scaled_determinant(self.inverse_factors)

    def _scaled_determinant(self, factors: Factors) -> float:
        # The cosines are, but for its sign, the determinant of what maps rates of balls' joints to angular velocities.
        return factors.determinant() / math.prod(math.cos(self.q.item(place)) for place in self._middles)

    def mass_matrix(self) -> FloatArray:
        """Return M (nv, nv); Pinocchio fills one triangle."""
        half = np.triu(pin.crba(self.model, self.data, self.q))
        return np.asarray(half + np.triu(half, 1).T)

    def platform_torques(self, wrench: FloatArray) -> FloatArray:
        """Return Jᵀ w (nv,) of a wrench (6,) onto m at o, in the axes of the universe."""
        return np.asarray(self.frame_jacobian(self.constrained.platform_frame).T @ wrench)

    def energies(self, v: FloatArray) -> tuple[float, float]:
        """Return the kinetic and the potential energy of the tree's bodies [J]."""
        kinetic = pin.computeKineticEnergy(self.model, self.data, self.q, v)
        return float(kinetic), float(pin.computePotentialEnergy(self.model, self.data, self.q))

    def check_constrained(self) -> None:
        """Raise `SingularConfigurationError` where the closures lose rank."""
        try:
            # Regular with the legs held, as nearly everywhere: of full rank.
            _ = self.forward_factors
        except SingularConfigurationError as error:
            if error.kind == "constraint":
                raise

    def check_ball_angles(self) -> None:
        """Raise `ArgumentError` where a ball joint's middle angle is ±90°."""
        for ball, place in zip(self.constrained.balls, self._middles, strict=True):
            angle = self.q.item(place)
            if abs(math.cos(angle)) <= SINGULAR:
                expected = f"{self.constrained.names[ball[1]]} away from ±90°"
                cause = "The axes of x and z coincide there, and the tree loses a rotation that the robot has"
                raise ArgumentError("q", expected, f"{math.degrees(angle):.9g}°", cause)

    def check_closed(self, v: FloatArray | None = None, argument: str = "v") -> None:
        """Raise unless q is closed and v keeps it closed, to `AGREEMENT`."""
        gap = self.widest_gap
        if gap > AGREEMENT * self._side:
            raise ClosureError(gap, 0, "Rounded or guessed joint values? The method project closes the loops")
        if v is None:
            return
        opening = largest(self.constraint_jacobian.dot(v))
        # A leg's own rate is part of the speed, along one axis or more: quicker, and mostly enough.
        rate = largest(v.take(self.constrained.in_v[self.constrained.legs]))
        if opening > 0.5 * AGREEMENT * rate and opening > AGREEMENT * self._gap_rate_bound(v):
            expected = "joint velocities that keep the loops closed"
            cause = "joint_velocities makes them from a twist, joint_rates from leg rates"
            raise ArgumentError(argument, expected, f"gaps that open at {opening:.1e} m/s", cause)

    def check_accelerations(self, a: FloatArray, v: FloatArray, drift: FloatArray) -> None:
        """Raise unless the closures allow the accelerations a at v, to `AGREEMENT`; `drift` is J̇c v."""
        opening, size = largest(self.constraint_jacobian.dot(a) + drift), largest(drift)
        if opening <= AGREEMENT * size:
            return
        # The other parts of the size take longer and are rarely needed.
        size += self._gap_rate_bound(a) + self._gap_rate_bound(v) ** 2 / self._side
        if opening > AGREEMENT * size:
            expected = "joint accelerations that keep the loops closed"
            cause = "joint_accelerations makes them from the platform's, at the velocities v"
            raise ArgumentError("a", expected, f"gaps that open at {opening:.1e} m/s²", cause)

    def _gap_rate_bound(self, v: FloatArray) -> float:
        """Return the largest rate of a gap if all that joint velocities contribute to its ends had one sign [m/s]."""
        rates, others = np.abs(v), self.constrained.others
        bound = largest(np.abs(self.constraint_jacobian).dot(rates))
        if len(others):
            # Another robot moves both ends of a gap alike: the remaining difference is rounding of their speeds.
            ends = map(self.frame_jacobian, self.constrained.frames)
            bound += max(largest(np.abs(end[:3, others]).dot(rates[others])) for end in ends)
        return bound


_CACHED = {name for name, member in vars(TreeKinematics).items() if isinstance(member, cached_property)}
