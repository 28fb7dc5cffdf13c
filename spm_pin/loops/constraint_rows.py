"""The scalar equations of closures and joint equalities at a configuration, and their derivatives, from Pinocchio.

A closure holds frame 2, at p2 with the axes R2, on frame 1, at p1 with the axes R1. With R = R1ᵀ R2 its equations are

    position    R1ᵀ (p2 - p1) = 0                             point, hinge, weld; x and y for planar
    axis        x and y of the third column of R = 0          hinge
    rotation    half the skew part of R, sin θ u = 0          weld

of which each has an exact derivative: where the joints move frame 2 against frame 1 at (v, ω), v at p2, all in the axes
R1, the left sides change at v, at ω x (third column of R) and at (tr(R) I - R) ω / 2. Joints that carry both frames
move them alike and do not contribute. Angles of 180° solve the equations of axis and rotation too, so
`ConstraintRows.is_reversed` says where an axis or a frame is the wrong way round.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.loops.closures import Anchor, Closure, JointEquality, find_frame
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, likely_names

POSITION, ROTATION, AXIS, FORMS = 0, 3, 6, 8
"""First index of the equations of each form among the eight of a closure, and their number."""
_FORMS_OF_KIND = {"point": (0, 1, 2), "hinge": (0, 1, 2, 6, 7), "planar": (0, 1), "weld": (0, 1, 2, 3, 4, 5)}
_TURNING = ("RX", "RY", "RZ", "RevoluteUnaligned", "PX", "PY", "PZ", "PrismaticUnaligned", "RUBX", "RUBY", "RUBZ")
SCALAR_JOINTS = "hinges and slides, whose value is one number"
_JOINT_KINDS = (*_TURNING, "RevoluteUnboundedUnaligned", "Spherical", "Translation", "Planar", "FreeFlyer")


class ConstraintRows:
    """Equations of a model's closures and joint equalities; immutable.

    Attributes
    ----------
    count : int
        Number m of equations.
    labels : tuple of str
        Name of the loop or joint equality of each equation.
    row_units : ndarray, shape (m,)
        Size of each equation's left side: a fourth of the loop's length [m], or 1 for angles.
    units : ndarray, shape (nv,)
        Size of a step of order one of each velocity: 1 rad, or a fourth of a loop's length [m].
    moves, signs : ndarray, shapes (closures, 2, nv) and (closures, nv)
        1 for velocities that move frames 1 and 2, otherwise 0, and the second less the first.
    turns : ndarray, shape (closures, nv)
        Angular speed of frame 2 against frame 1 that each velocity brings about; it is the same in any configuration.
    lever_scales : ndarray, shape (closures, nv)
        Factors from the speeds of p2, dimensionless, to the levers of `tree_kernel.linearised`.
    screws : ndarray, shape (2, nv, 3)
        Velocities and angular velocities of the joints, in their own frames.
    are_lengths : ndarray of bool, shape (m,)
        True for equations in m, False in rad.
    size : float
        Length of the longest loop [m].
    """

    def __init__(
        self,
        model: Any,
        closures: Sequence[Closure],
        equalities: Sequence[JointEquality],
        q: FloatArray,
        pose: tuple[str, Sequence[int]] | None = None,
    ) -> None:
        """Read the anchors; `q` is a configuration of typical size, from which loops are measured.

        `pose`, a frame and components, adds equations of a weld between this frame and the universe. Those of the
        position are along the axes of the world, those of the rotation along the axes of the target.
        """
        for joint in list(model.joints)[1:]:
            if joint.shortname().removeprefix("JointModel") not in _JOINT_KINDS:
                expected = "joints that are hinges, slides, balls, planar or free"
                raise ArgumentError("model", expected, f"{joint.shortname()} {model.names[joint.id]!r}")
        self.model, self.closures, self.equalities = model, tuple(closures), tuple(equalities)
        self.pose = -1
        forms_of_pose: tuple[int, ...] = ()
        if pose is not None:
            self.pose, forms_of_pose = len(self.closures), tuple(pose[1])
            self.closures += (Closure("weld", Anchor("universe"), Anchor(pose[0]), f"pose of {pose[0]}"),)
        self.joints, self.placements, names = [], [], []
        for k, closure in enumerate(self.closures):
            names.append(closure.name or f"{closure.kind} of {closure.first.frame} and {closure.second.frame}")
            ends = [self._anchor(anchor, names[k]) for anchor in (closure.first, closure.second)]
            if ends[0][0] == ends[1][0]:
                cause = "Fixed joints alone hold them together: the loop has no joint that moves"
                received = f"{closure.first.frame!r} and {closure.second.frame!r}"
                raise ArgumentError(
                    f"closure {names[k]!r}", "frames of two links that move against each other", received, cause
                )
            self.joints.append([joint for joint, _ in ends])
            self.placements.append([placement for _, placement in ends])
        self.moves = np.zeros((len(self.closures), 2, model.nv))
        for moves, carriers in zip(self.moves, self.joints, strict=True):
            for moved, end in zip(moves, carriers, strict=True):
                for joint in (model.joints[k] for k in _support(model, end)):
                    moved[joint.idx_v : joint.idx_v + joint.nv] = 1.0
        self.signs = self.moves[:, 1] - self.moves[:, 0]
        kinds = [forms_of_pose if k == self.pose else _FORMS_OF_KIND[c.kind] for k, c in enumerate(self.closures)]
        self.forms: IntArray = np.array([FORMS * k + form for k, forms in enumerate(kinds) for form in forms], np.intp)
        self._form_signs = self.signs[self.forms // FORMS]
        self._has_angles = bool((self.forms % FORMS >= ROTATION).any())
        self._read_equalities()
        self.count = len(self.forms) + len(self.equalities)
        self.names = tuple(names)
        self.labels = tuple(names[form // FORMS] for form in self.forms)
        self.labels += tuple(equality.name or f"equality of {equality.joint}" for equality in self.equalities)
        self._measure(q)

    def _anchor(self, anchor: Any, loop: str) -> tuple[int, Any]:
        frame = find_frame(self.model, anchor.frame)
        if frame is None:
            cause = likely_names(anchor.frame, [frame.name for frame in self.model.frames])
            raise ArgumentError(f"closure {loop!r}", "links or frames of the model", repr(anchor.frame), cause)
        found = self.model.frames[frame]
        return int(found.parentJoint), pin.SE3(found.placement * anchor.placement)

    def _read_equalities(self) -> None:
        """Note where the joints of equalities are, and their polynomials, lowest power first."""
        model, places = self.model, []
        for equality in self.equalities:
            joint = scalar_joint(model, equality.joint, "equalities")
            driver = None if equality.driver is None else scalar_joint(model, equality.driver, "equalities")
            places.append([joint.idx_q, joint.idx_v, driver.idx_q if driver else -1, driver.idx_v if driver else -1])
        self.equality_places: IntArray = np.array(places, dtype=np.intp).reshape(-1, 4)
        degree = max((len(e.coefficients) for e in self.equalities), default=1)
        self.polynomials = np.zeros((len(self.equalities), max(degree, 1)))
        for row, equality in zip(self.polynomials, self.equalities, strict=True):
            row[: len(equality.coefficients)] = equality.coefficients
        self.zeros = np.array([[e.zero, e.driver_zero] for e in self.equalities]).reshape(-1, 2)

    def _measure(self, q: FloatArray) -> None:
        """Measure the loops at q: their lengths are the units of equations and slides."""
        model, data = self.model, self.model.createData()
        pin.forwardKinematics(model, data, q)
        lengths = []
        for sign, (first, second), (at_first, at_second) in zip(self.signs, self.joints, self.placements, strict=True):
            total, origin = 0.0, {}
            for end, placement in ((first, at_first), (second, at_second)):
                point = (data.oMi[end] * placement).translation
                for joint in reversed([j for j in _support(model, end) if sign[model.joints[j].idx_v]]):
                    total += float(np.linalg.norm(point - data.oMi[joint].translation))
                    point = data.oMi[joint].translation.copy()
                origin[end] = point
            lengths.append(total + float(np.linalg.norm(np.subtract(*origin.values()))))
        self.size = max(lengths, default=0.0) or 1.0
        self.loop_lengths = np.maximum(lengths, 1e-3 * self.size)
        self.screws = _screws(model)
        angular = self.screws[1]
        is_slide = (angular == 0.0).all(axis=1)
        self.units = np.ones(model.nv)
        for column in np.flatnonzero(is_slide):
            loops = self.loop_lengths[self.signs[:, column] != 0.0]
            self.units[column] = 0.25 * (loops.min() if len(loops) else self.size)
        self.turns = np.abs(self.signs) * np.linalg.norm(angular, axis=1) * self.units
        self.lever_scales = 4.0 / self.loop_lengths[:, None] / np.where(self.turns > 0.0, self.turns, 1.0)
        units = [0.25 * self.loop_lengths[f // FORMS] if f % FORMS < ROTATION else 1.0 for f in self.forms.tolist()]
        self.row_units = np.array([*units, *self.units[self.equality_places[:, 1]]])
        self.are_lengths = np.concatenate([self.forms % FORMS < ROTATION, is_slide[self.equality_places[:, 1]]])

    @property
    def are_points(self) -> bool:
        """True if `point_closures.PointRows` has all equations."""
        kinds = {closure.kind for closure in self.closures}
        return self.pose < 0 and not self.equalities and kinds == {"point"}

    def concerns(self) -> BoolArray:
        """Return which velocities (nv,) the equations depend on."""
        involved = (self.signs != 0.0).any(axis=0)
        involved[self.equality_places[:, [1, 3]][self.equality_places[:, [0, 2]] >= 0]] = True
        return np.asarray(involved)

    def coupled_with_pose(self) -> BoolArray:
        """Return which velocities (nv,) the pose depends on, directly or by loops that share joints."""
        groups = [np.flatnonzero(sign) for sign in self.signs]
        groups += [places[places >= 0] for places in self.equality_places[:, [1, 3]]]
        coupled = self.signs[self.pose] != 0.0
        for _ in groups:
            for group in groups:
                coupled[group] |= coupled[group].any()
        return np.asarray(coupled)

    def placements_of(self, data: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return R1 (closures, 3, 3), p2 (closures, 3) and the homogeneous matrices of frames 2 in frames 1."""
        first, tip, relative = np.empty((len(self.joints), 3, 3)), np.empty((len(self.joints), 3)), []
        for k, ((a, b), (at_a, at_b)) in enumerate(zip(self.joints, self.placements, strict=True)):
            one, two = data.oMi[a] * at_a, data.oMi[b] * at_b
            first[k], tip[k] = one.rotation, two.translation
            relative.append(one.actInv(two).homogeneous)
        return first, tip, np.array(relative).reshape(-1, 4, 4)

    def left_sides(self, q: FloatArray, relative: FloatArray) -> FloatArray:
        """Return the left sides (m,) in m and rad of the frames 2 in frames 1 (closures, 4, 4)."""
        r = relative[:, :3, :3]
        skew = [r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]]
        forms = [*relative[:, :3, 3].T, *(0.5 * part for part in skew), r[:, 0, 2], r[:, 1, 2]]
        closures = np.array(forms).T.ravel()[self.forms]
        if not len(self.equalities):
            return np.asarray(closures)
        joints = q[self.equality_places[:, 0]] - self.zeros[:, 0]
        return np.concatenate([closures, joints - self.curves(q, 0)])

    def curves(self, q: FloatArray, order: int) -> FloatArray:
        """Return the derivatives of an order of the equalities' polynomials by their drivers (equalities,)."""
        places = self.equality_places[:, 2]
        x = np.where(places >= 0, q[places] - self.zeros[:, 1], 0.0)
        coefficients = np.polynomial.polynomial.polyder(self.polynomials, order, axis=1)
        values = np.polynomial.polynomial.polyval(x, coefficients.T, tensor=False)
        return np.asarray(np.where((places >= 0) | (order == 0), values, 0.0))

    def wrenches(self, placed: tuple[FloatArray, ...]) -> FloatArray:
        """Return the wrench about the world's origin (closures' equations, 6) that each equation exerts on frame 2.

        Times the twist of frame 2 against frame 1, about the world's origin too, it is the rate of the left side.
        """
        first, tip, relative = placed
        axes, r = first.swapaxes(1, 2), relative[:, :3, :3]
        wrenches = np.zeros((len(r), FORMS, 6))
        wrenches[:, :3, :3] = axes
        # The moment of a force n at p is p x n: rows of forces times the transpose of p's cross product matrix.
        arms = np.zeros((len(r), 3, 3))
        arms[:, [1, 2, 0], [2, 0, 1]], arms[:, [2, 0, 1], [1, 2, 0]] = tip, -tip
        wrenches[:, :3, 3:] = axes @ arms
        if self._has_angles:
            maps = np.zeros((len(r), FORMS - ROTATION, 3))
            maps[:, :3] = -0.5 * r
            maps[:, [0, 1, 2], [0, 1, 2]] += 0.5 * np.trace(r, axis1=1, axis2=2)[:, None]
            maps[:, 3, 1], maps[:, 3, 2] = r[:, 2, 2], -r[:, 1, 2]
            maps[:, 4, 2], maps[:, 4, 0] = r[:, 0, 2], -r[:, 2, 2]
            wrenches[:, ROTATION:, 3:] = maps @ axes
        return np.asarray(wrenches.reshape(-1, 6)[self.forms])

    def jacobian(self, q: FloatArray, data: Any, placed: tuple[FloatArray, ...]) -> FloatArray:
        """Return the derivatives (m, nv); `data` has the joint Jacobians at q, `placed` is of `placements_of` there."""
        rows = self.wrenches(placed) @ data.J * self._form_signs
        if not len(self.equalities):
            return np.asarray(rows)
        follow = np.zeros((len(self.equalities), self.model.nv))
        for row, (_, joint, _, driver), slope in zip(follow, self.equality_places, self.curves(q, 1), strict=True):
            row[joint] = 1.0
            row[driver] -= slope
        return np.concatenate([rows, follow])

    def is_reversed(self, relative: FloatArray) -> list[str]:
        """Return the names of hinges and welds that hold the wrong way round: by 180°."""
        reversed_axes = []
        for closure, name, r in zip(self.closures, self.names, relative[:, :3, :3], strict=True):
            if (closure.kind == "hinge" and r[2, 2] < 0.0) or (closure.kind == "weld" and np.trace(r) < 1.0):
                reversed_axes.append(name)
        return reversed_axes

    def widest(self, sides: FloatArray) -> tuple[float, str, str]:
        """Return the distance or angle by which the worst loop or equality is open, its unit and name.

        `sides` (m,) are the left sides in m and rad, others may follow.
        """
        if not self.count:
            return 0.0, "m", ""
        sides = np.abs(sides[: self.count])
        worst = int(np.argmax(sides / self.row_units))
        owners = np.concatenate([self.forms // FORMS, -1 - np.arange(len(self.equalities))])
        is_length = bool(self.are_lengths[worst])
        alike = (owners == owners[worst]) & (self.are_lengths == is_length)
        return float(np.linalg.norm(sides[alike])), "m" if is_length else "rad", self.labels[worst]


def _screws(model: Any) -> FloatArray:
    """Return velocities and angular velocities (2, nv, 3) of all joints, in their own frames."""
    linear, angular = screws = np.zeros((2, model.nv, 3))
    data = model.createData()
    for joint, state in list(zip(model.joints, data.joints, strict=True))[1:]:
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        linear[columns], angular[columns] = state.S[:3].T, state.S[3:].T
    return screws


def joint_of(model: Any, name: str, argument: str) -> Any:
    """Return a joint by its name, or raise `ArgumentError`."""
    names = list(model.names)[1:]
    if name not in names:
        cause = likely_names(name, names, f"Its joints: {tuple(names)}")
        raise ArgumentError(argument, "names of joints", repr(name), cause)
    return model.joints[model.getJointId(name)]


def scalar_joint(model: Any, name: str, argument: str) -> Any:
    """Return a joint of one degree of freedom by its name, or raise `ArgumentError`."""
    joint = joint_of(model, name, argument)
    if joint.nq != 1:
        raise ArgumentError(argument, SCALAR_JOINTS, repr(name))
    return joint


def _support(model: Any, joint: int) -> list[int]:
    """Return the joints from the universe to a joint, without the universe."""
    return list(model.supports[joint])[1:]
