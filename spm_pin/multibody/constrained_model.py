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
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.description.tree import Closure
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray, broadcastable
from spm_pin.multibody.joint_layout import JointLayout
from spm_pin.multibody.regularity import SINGULAR, Factors, SingularValues
from spm_pin.multibody.vector_arguments import NO_WRENCHES, Wrenches, WrenchLike, read_vector, read_vectors


class ConstrainedModel:
    """A Pinocchio model that holds the mechanism's tree, perhaps with another robot, and its closures; immutable.

    The closures have their frames in the model.
    """

    def __init__(self, model: Any, layout: JointLayout, closures: Iterable[Closure]) -> None:
        self.model, self.layout, self.closures = model, layout, tuple(closures)
        pairs = [[int(model.getFrameId(name)) for name in (c.frame_a, c.frame_b)] for c in self.closures]
        # A frame that several closures share is evaluated once.
        self.frames = list(dict.fromkeys(frame for pair in pairs for frame in pair))
        self.ends = np.array([[self.frames.index(frame) for frame in pair] for pair in pairs]).reshape(-1, 2)
        # A product takes a third of the time of picking rows and subtracting, and gives the same bits.
        unit = np.eye(len(self.frames))
        self._signs = unit[self.ends[:, 1]] - unit[self.ends[:, 0]]
        # Where the actuators are in v: all of another robot, then the six legs.
        self.actuated = np.concatenate([layout.others, layout.v[layout.legs]])

    def checked(self, q: npt.ArrayLike, argument: str = "q", *, single: bool = False) -> FloatArray:
        """Return joint values (..., nq) as an array, or raise `ArgumentError`."""
        array = (read_vector if single else read_vectors)(q, argument, self.model.nq)
        self.layout.require_distances(array, argument)
        return array

    def read_wrenches(self, wrench: WrenchLike, *, single: bool = False) -> Wrenches:
        """Return wrenches that act onto frames of the model, one without a name onto m, or raise `ArgumentError`.

        `Wrenches` have been read, and are returned as they are.
        """
        if wrench is None:
            return NO_WRENCHES
        if isinstance(wrench, Wrenches):
            return wrench
        read = read_vector if single else read_vectors
        if not isinstance(wrench, Mapping):
            return Wrenches(read(wrench, "wrench", 6), [self.layout.platform_frame])
        unknown = [name for name in wrench if not (isinstance(name, str) and self.model.existFrame(name))]
        if unknown:
            cause = "The names of links, with the prefix"
            raise ArgumentError("wrench", "frames of the model", ", ".join(map(repr, unknown)), cause)
        arrays = [read(value, "wrench", 6) for value in wrench.values()]
        shape: tuple[int, ...] = ()
        for array in arrays:
            shape = broadcastable("wrench", array.shape[:-1], "the other wrenches", shape)
        spread = (np.broadcast_to(array, (*shape, 6)) for array in arrays)
        together = np.concatenate([np.empty((*shape, 0)), *spread], axis=-1)
        return Wrenches(together, [int(self.model.getFrameId(name)) for name in wrench])

    def differences(self, vectors: FloatArray) -> FloatArray:
        """Return, of vectors of `frames` side by side, that of `frame_b` less that of `frame_a` per closure, (n, 3)."""
        return np.asarray(self._signs.dot(vectors.reshape(-1, 3)))

    def linear_differences(self, spatial: Sequence[FloatArray]) -> FloatArray:
        """Return `differences` of the linear part of spatial vectors (6,) or matrices (6, m), (3 n,) or (3 n, m)."""
        rows = np.concatenate(spatial)
        found = self._signs.dot(rows.reshape(len(self.frames), -1)).reshape(-1, 6, *rows.shape[1:])
        return np.asarray(found[:, :3].reshape(-1, *rows.shape[1:]))

    def rigid_constraints(self) -> Any:
        """Return the closures in the form that `pinocchio.constraintDynamics` takes; they hold gains."""
        constraints = pin.StdVec_RigidConstraintModel()
        for pair in self.ends:
            a, b = (self.model.frames[self.frames[k]] for k in pair)
            places = a.parentJoint, a.placement, b.parentJoint, b.placement
            constraints.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self.model, *places, pin.LOCAL))
        return constraints


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
        self._twist_scale = np.array([1.0 / self.layout.side] * 3 + [1.0] * 3)
        self._unit_twists = self.in_one_unit(np.eye(6), np.zeros((len(self.layout.v) - 6, 6)))
        # Where the balls' middle angles are in q.
        self._middles = [int(self.layout.q[ball[1]]) for ball in self.layout.balls]
        # Pinocchio updates these in place: no look-up at each q.
        self._points = [self.data.oMf[frame].translation for frame in constrained.frames]
        # The mechanism's own columns; without other joints there is nothing to pick.
        self._own: Any = self.layout.v if len(self.layout.others) else slice(None)

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
        """From the origin of `frame_a` to that of `frame_b` of each closure, in the universe's axes [m], (n, 3)."""
        return self.constrained.differences(np.concatenate(self._points))

    @cached_property
    def constraint_jacobian(self) -> FloatArray:
        """Jc: joint velocities (nv,) to the rates of the gaps, shape (3 n, nv); exact at any q, closed or not."""
        model, data, frames = self.model, self.data, self.constrained.frames
        jacobians = [pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in frames]
        return self.constrained.linear_differences(jacobians)

    def widest_gap(self) -> float:
        """Return the largest distance of two frames that a closure holds together [m]."""
        return math.sqrt(max(x * x + y * y + z * z for x, y, z in self.gap.tolist()))

    def gap_rate_bound(self, v: FloatArray) -> float:
        """Return the largest rate of a gap if all that joint velocities contribute to its ends had one sign [m/s]."""
        rates = np.abs(v)
        bound = float(max(np.abs(self.constraint_jacobian).dot(rates).tolist()))
        others, model, data = self.layout.others, self.model, self.data
        if not len(others):
            return bound
        # Another robot moves both ends of a gap alike: what is left of the difference is rounding of their speeds.
        ends = (pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in self.constrained.frames)
        return bound + max(float(np.abs(end[:3, others]).dot(rates[others]).max()) for end in ends)

    @cached_property
    def chain_constraint_jacobian(self) -> FloatArray:
        """Jc's columns of the mechanism's own joints, shape (3 n, 18)."""
        return np.asarray(self.constraint_jacobian[:, self._own])

    @cached_property
    def platform_jacobian(self) -> FloatArray:
        """Jm: velocities of the mechanism's joints to the twist (v, ω) of m at o, shape (6, 18)."""
        jacobian = pin.getFrameJacobian(self.model, self.data, self.layout.platform_frame, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(jacobian[:, self._own])

    def terminal_pose(self) -> tuple[FloatArray, FloatArray]:
        """Return copies of the rotation (3, 3) and the translation (3,) of m."""
        terminal = self.data.oMf[self.layout.platform_frame]
        return terminal.rotation.copy(), terminal.translation.copy()

    def configuration_arrays(self) -> tuple[FloatArray, ...]:
        """Return copies of the rotation (3, 3) and the translation (3,) of m, and b_1, b_2 and b_3 as rows (3, 3)."""
        corners = [self.data.oMf[frame].translation for frame in self.layout.corner_frames]
        return *self.terminal_pose(), np.array(corners)

    @cached_property
    def velocity_scale(self) -> FloatArray:
        """C: scaled velocities u (18,) to joint velocities, shape (18, 18)."""
        scale = np.diag(self.layout.units)
        for ball in self.layout.balls:
            scale[np.ix_(ball, ball)] = np.linalg.inv(self.platform_jacobian[3:, ball])
        return scale

    def inverse_matrix(self) -> FloatArray:
        """Return K̂, shape (18, 18)."""
        scale = self.velocity_scale
        return self.in_one_unit(self.platform_jacobian @ scale, self.chain_constraint_jacobian @ scale)

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
        return self._factors(self.in_one_unit(self.platform_jacobian, self.chain_constraint_jacobian), "inverse")

    def in_one_unit(self, platform: FloatArray, closures: FloatArray) -> FloatArray:
        """Return [A p; c / d] of rows p of the platform (6, ...) and c of the closures (3 n, ...)."""
        return np.concatenate([(self._twist_scale * platform.T).T, closures / self.layout.side])

    def velocities_of_twists(self) -> FloatArray:
        """Return X = K⁻¹ [I; 0]: twists of m to velocities of the mechanism's joints, shape (18, 6)."""
        return self.inverse_factors.solve(self._unit_twists)

    def velocities_of_legs(self, leg_rates: FloatArray, closing: FloatArray | float = 0.0) -> FloatArray:
        """Return N⁻¹ (ṙ, -c): leg rates (6,), and c (3 n,) by which gaps close, to velocities of the joints (18,)."""
        v = np.empty(len(self.layout.v))
        v[self.layout.legs] = leg_rates
        opening = self.chain_constraint_jacobian[:, self.layout.legs] @ leg_rates + closing
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
        factors = Factors.of(matrix)
        if not factors.is_regular(matrix):
            scaled = self.forward_matrix() if kind == "forward" else self.inverse_matrix()
            for concerned, name in ((self.scaled_constraint_jacobian(), "constraint"), (scaled, kind)):
                values = np.linalg.svd(concerned, compute_uv=False)
                if values[-1] <= SINGULAR * values[0] or (name == kind and factors.zero_pivot):
                    raise SingularConfigurationError(name, float(values[-1]))
        return factors


_CACHED = {name for name, member in vars(TreeKinematics).items() if isinstance(member, cached_property)}
