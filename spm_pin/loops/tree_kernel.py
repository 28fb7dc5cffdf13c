# mypy: allow-untyped-calls
"""A tree of joints with closures as arrays: placements, equations, their derivatives, and the target of a path.

The functions are interpreted and compiled, once for all robots. A joint is one of seven kinds, by how its configuration
is stored. The equations and their scales are those of `constraint_rows`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from spm_pin.loops.constraint_rows import FORMS, ROTATION, ConstraintRows
from spm_pin.loops.kernel import inlined, jit
from spm_pin.loops.plain_arrays import PlainArrays
from spm_pin.support.arguments import FloatArray, IntArray

HINGE, SLIDE, UNBOUNDED, BALL, FREE, TRANSLATION, PLANAR = range(7)
_KINDS = {"Spherical": BALL, "FreeFlyer": FREE, "Translation": TRANSLATION, "Planar": PLANAR}
_KINDS |= dict.fromkeys(("PX", "PY", "PZ", "PrismaticUnaligned"), SLIDE)
_KINDS |= dict.fromkeys(("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned"), UNBOUNDED)
UNLIMITED = int(np.iinfo(np.int64).max)


def tree_of(
    rows: ConstraintRows, columns: IntArray, driven: IntArray, driven_in_v: IntArray, held: IntArray | tuple[()] = ()
) -> PlainArrays:
    """Return the tree of a model, its equations, and a path to a target, which `aim` writes.

    `columns` (p,) are the unknown velocities, `driven` the places of driven joints in q, and `held` velocities that are
    zero in dynamics. What is not named after an attribute of `ConstraintRows`, `Model` or `Inertia`:

    linear, angular, joints, carriers
        Of each velocity: its unit twist in the joint's own frame, the joint, and the velocity before it on the way from
        the universe, or -1.
    first_columns, loop_columns, loop_signs
        Where the velocities of each closure begin, and which they are, from frame 1 to frame 2.
    first_rows, position_counts, row_counts
        Where the equations of each closure begin, and how many there are, of positions and in all.
    driven_rates, pose_turn
        Change of each driven joint along the whole path, dimensionless, and the angle of the pose [rad].
    steps_left
        Number of steps, in all paths, before one is left unfinished.
    pose_share, drivers
        Share of the path that the current step covers, and values of the drivers of joint equalities at its start.
    """
    model, closures = rows.model, len(rows.closures)
    joints, inertias = list(model.joints)[1:], list(model.inertias)[1:]
    linear, angular = rows.screws
    placements = [model.jointPlacements[joint.id] for joint in joints]
    unknowns = np.full(model.nv, -1)
    unknowns[columns] = np.arange(len(columns))
    # Joints in the order from frame 1 to frame 2.
    orders = [np.r_[np.flatnonzero(sign < 0.0)[::-1], np.flatnonzero(sign > 0.0)] for sign in rows.signs]
    loops, none = rows.forms // FORMS, np.zeros(0)
    counts = np.bincount(loops, minlength=closures)
    ends = [end for pair in rows.placements for end in pair]
    integers: dict[str, Any] = {
        "parents": [model.parents[joint.id] - 1 for joint in joints],
        "kinds": [_KINDS.get(joint.shortname().removeprefix("JointModel"), HINGE) for joint in joints],
        "in_q": [joint.idx_q for joint in joints],
        "in_v": [joint.idx_v for joint in joints],
        "joints": np.repeat(np.arange(len(joints)), [joint.nv for joint in joints]),
        "carriers": model.createData().parents_fromRow,
        "ends": np.reshape(rows.joints, (-1, 2)) - 1,
        "first_columns": np.cumsum([0, *map(len, orders)]),
        "loop_columns": np.concatenate([*orders, none]),
        "forms": rows.forms % FORMS,
        "equality_places": rows.equality_places,
        "columns": columns,
        "unknowns": unknowns,
        "driven": driven,
        "driven_in_v": driven_in_v,
        "first_rows": np.cumsum(counts) - counts,
        "position_counts": np.bincount(loops[rows.forms % FORMS < ROTATION], minlength=closures),
        "row_counts": counts,
        "held": held,
        "steps_left": [UNLIMITED],
    }
    floats: dict[str, Any] = {
        "rotations": _flat(placement.rotation for placement in placements),
        "places": _stacked(placement.translation for placement in placements),
        "linear": linear,
        "angular": angular,
        "units": rows.units,
        "turns": rows.turns,
        "lever_scales": rows.lever_scales,
        "loop_signs": np.concatenate([*(sign[order] for sign, order in zip(rows.signs, orders, strict=True)), none]),
        "row_units": rows.row_units,
        "polynomials": rows.polynomials,
        "zeros": rows.zeros,
        "drivers": np.zeros(len(rows.zeros)),
        "gravity": [model.gravity.linear],
        "masses": [inertia.mass for inertia in inertias],
        "levers": _stacked(inertia.lever for inertia in inertias),
        "inertias": _flat(inertia.inertia for inertia in inertias),
        "armatures": model.armature,
        "end_rotations": _flat(end.rotation for end in ends),
        "end_places": _stacked(end.translation for end in ends),
        "driven_rates": np.zeros(model.nv),
        "values": np.zeros((2, len(driven))),
        "pose_turn": np.zeros(1),
        "pose_share": np.zeros(1),
        "turn": np.zeros(3),
        "pose_rotations": np.zeros((2, 9)),
        "pose_places": np.zeros((2, 3)),
        "pose_axes": np.zeros((1, 9)),
    }
    arrays = {name: np.array(value, dtype=np.int64, order="C") for name, value in integers.items()}
    arrays |= {name: np.array(value, dtype=np.float64, order="C") for name, value in floats.items()}
    return PlainArrays({"pose": rows.pose, **arrays})


def _flat(matrices: Iterable[Any]) -> FloatArray:
    return np.array([matrix.ravel() for matrix in matrices]).reshape(-1, 9)


def _stacked(vectors: Iterable[Any]) -> FloatArray:
    return np.array(list(vectors)).reshape(-1, 3)


@inlined
def vector(array, k):  # type: ignore[no-untyped-def]
    """Return the first three numbers of a row."""
    return array[k, 0], array[k, 1], array[k, 2]


@inlined
def angular_of(array, k):  # type: ignore[no-untyped-def]
    """Return the last three of the six numbers of a row."""
    return array[k, 3], array[k, 4], array[k, 5]


@inlined
def write(array, k, linear, angular):  # type: ignore[no-untyped-def]
    """Write the six numbers of a row."""
    array[k, 0], array[k, 1], array[k, 2] = linear
    array[k, 3], array[k, 4], array[k, 5] = angular


@inlined
def matrix(array, k):  # type: ignore[no-untyped-def]
    """Return a rotation matrix, row by row, of the first nine numbers of a row."""
    m = array
    return m[k, 0], m[k, 1], m[k, 2], m[k, 3], m[k, 4], m[k, 5], m[k, 6], m[k, 7], m[k, 8]


@inlined
def _put(matrix, array, k):  # type: ignore[no-untyped-def]
    for i in range(9):
        array[k, i] = matrix[i]


@inlined
def product(a, b):  # type: ignore[no-untyped-def]
    """Return the product of two rotation matrices."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@inlined
def transposed(a):  # type: ignore[no-untyped-def]
    """Return the transpose of a rotation matrix."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@inlined
def times(a, x):  # type: ignore[no-untyped-def]
    """Return a rotation matrix times a vector."""
    return (
        a[0] * x[0] + a[1] * x[1] + a[2] * x[2],
        a[3] * x[0] + a[4] * x[1] + a[5] * x[2],
        a[6] * x[0] + a[7] * x[1] + a[8] * x[2],
    )


@inlined
def plus(x, y):  # type: ignore[no-untyped-def]
    """Return the sum of two vectors."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@inlined
def minus(x, y):  # type: ignore[no-untyped-def]
    """Return the difference of two vectors."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


@inlined
def scaled(x, k):  # type: ignore[no-untyped-def]
    """Return a multiple of a vector."""
    return k * x[0], k * x[1], k * x[2]


@inlined
def cross(x, y):  # type: ignore[no-untyped-def]
    """Return the cross product of two vectors."""
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


@inlined
def length(x):  # type: ignore[no-untyped-def]
    """Return the length of a vector."""
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@inlined
def _about(axis, c, s):  # type: ignore[no-untyped-def]
    """Return the rotation matrix about a unit vector by an angle of cosine c and sine s."""
    x, y, z = axis
    b = 1.0 - c
    return (
        c + b * x * x,
        b * x * y - s * z,
        b * x * z + s * y,
        b * x * y + s * z,
        c + b * y * y,
        b * y * z - s * x,
        b * x * z - s * y,
        b * y * z + s * x,
        c + b * z * z,
    )


@inlined
def _of_quaternion(x, y, z, w):  # type: ignore[no-untyped-def]
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - z * w),
        2.0 * (x * z + y * w),
        2.0 * (x * y + z * w),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - x * w),
        2.0 * (x * z - y * w),
        2.0 * (y * z + x * w),
        1.0 - 2.0 * (x * x + y * y),
    )


@jit
def placed(tree, q):  # type: ignore[no-untyped-def]
    """Return rotation matrices (joints, 9) and origins (joints, 3) of the joints' frames in the world."""
    count = len(tree.kinds)
    rotations, origins = np.empty((count, 9)), np.empty((count, 3))
    for joint in range(count):
        kind, at, v, parent = tree.kinds[joint], tree.in_q[joint], tree.in_v[joint], tree.parents[joint]
        base, place = matrix(tree.rotations, joint), vector(tree.places, joint)
        if parent >= 0:
            carrier = matrix(rotations, parent)
            place = plus(times(carrier, place), vector(origins, parent))
            base = product(carrier, base)
        if kind == HINGE:
            base = product(base, _about(vector(tree.angular, v), math.cos(q[at]), math.sin(q[at])))
        elif kind == SLIDE:
            place = plus(place, times(base, scaled(vector(tree.linear, v), q[at])))
        elif kind == UNBOUNDED:
            base = product(base, _about(vector(tree.angular, v), q[at], q[at + 1]))
        elif kind == PLANAR:
            place = plus(place, times(base, (q[at], q[at + 1], 0.0)))
            base = product(base, _about((0.0, 0.0, 1.0), q[at + 2], q[at + 3]))
        else:
            if kind != BALL:
                place = plus(place, times(base, (q[at], q[at + 1], q[at + 2])))
                at += 3
            if kind != TRANSLATION:
                base = product(base, _of_quaternion(q[at], q[at + 1], q[at + 2], q[at + 3]))
        _put(base, rotations, joint)
        origins[joint, 0], origins[joint, 1], origins[joint, 2] = place
    return rotations, origins


@inlined
def axes_of(tree, rotations, loop, which):  # type: ignore[no-untyped-def]
    """Return the rotation matrix of frame 1 or 2 of a closure in the world."""
    joint, own = tree.ends[loop, which], matrix(tree.end_rotations, 2 * loop + which)
    return product(matrix(rotations, joint), own) if joint >= 0 else own


@inlined
def point_of(tree, rotations, origins, loop, which):  # type: ignore[no-untyped-def]
    """Return the origin of frame 1 or 2 of a closure in the world."""
    joint, own = tree.ends[loop, which], vector(tree.end_places, 2 * loop + which)
    return plus(times(matrix(rotations, joint), own), vector(origins, joint)) if joint >= 0 else own


@inlined
def left_side(form, gap, r):  # type: ignore[no-untyped-def]
    """Return the left side of one of the eight equations that a closure can have, by R and R1ᵀ (p2 - p1)."""
    if form == 0:
        return gap[0]
    if form == 1:
        return gap[1]
    if form == 2:
        return gap[2]
    if form == 3:
        return 0.5 * (r[7] - r[5])
    if form == 4:
        return 0.5 * (r[2] - r[6])
    if form == 5:
        return 0.5 * (r[3] - r[1])
    return r[2] if form == 6 else r[5]


@inlined
def _turning(form, w, r):  # type: ignore[no-untyped-def]
    """Return the rate of a left side, not of a position, where frame 2 turns against frame 1 at w."""
    if form == 3:
        return 0.5 * ((r[4] + r[8]) * w[0] - r[1] * w[1] - r[2] * w[2])
    if form == 4:
        return 0.5 * ((r[0] + r[8]) * w[1] - r[3] * w[0] - r[5] * w[2])
    if form == 5:
        return 0.5 * ((r[0] + r[4]) * w[2] - r[6] * w[0] - r[7] * w[1])
    return w[1] * r[8] - w[2] * r[5] if form == 6 else w[2] * r[2] - w[0] * r[8]


@jit
def _aim_pose(tree, s):  # type: ignore[no-untyped-def]
    """Move the pose that is to be reached to its place at a share of the path."""
    end = 2 * tree.pose
    rotation = matrix(tree.pose_rotations, 1)
    for i in range(3):
        tree.end_places[end, i] = tree.pose_places[1, i]
    if s != 1.0:
        angle = tree.pose_turn[0]
        axis = scaled((tree.turn[0], tree.turn[1], tree.turn[2]), 1.0 / angle if angle > 0.0 else 0.0)
        rotation = product(_about(axis, math.cos(s * angle), math.sin(s * angle)), matrix(tree.pose_rotations, 0))
        for i in range(3):
            start = tree.pose_places[0, i]
            tree.end_places[end, i] = start + s * (tree.pose_places[1, i] - start)
    _put(rotation, tree.pose_axes, 0)


@jit
def _equalities(tree, q, c):  # type: ignore[no-untyped-def]
    first = len(tree.forms)
    for k in range(len(tree.zeros)):
        joint, _, driver, _ = tree.equality_places[k]
        x, value = 0.0, 0.0
        if driver >= 0:
            x = q[driver] - tree.zeros[k, 1]
        for power in range(tree.polynomials.shape[1] - 1, -1, -1):
            value = value * x + tree.polynomials[k, power]
        c[first + k] = (q[joint] - tree.zeros[k, 0] - value) / tree.row_units[first + k]


@inlined
def _turning_axes(tree, loop, axes):  # type: ignore[no-untyped-def]
    """Return the rotation matrix to the axes of the equations of rotation: for a pose to those of the target."""
    return transposed(matrix(tree.pose_axes, 0)) if loop == tree.pose else axes


@inlined
def _left_sides(tree, rotations, origins, loop, axes, p2, c):  # type: ignore[no-untyped-def]
    """Write the left sides of the equations of a closure, and return the rotation matrix of frame 2 in frame 1."""
    gap = times(axes, minus(p2, point_of(tree, rotations, origins, loop, 0)))
    r = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if tree.position_counts[loop] < tree.row_counts[loop]:
        r = product(_turning_axes(tree, loop, axes), axes_of(tree, rotations, loop, 1))
    first = tree.first_rows[loop]
    for row in range(first, first + tree.row_counts[loop]):
        c[row] = left_side(tree.forms[row], gap, r) / tree.row_units[row]
    return r


@jit
def residual(tree, q, s):  # type: ignore[no-untyped-def]
    """Return the equations' left sides c (m,), dimensionless, at a share s of the path, from 0 to 1."""
    if tree.pose >= 0:
        _aim_pose(tree, s)
    rotations, origins = placed(tree, q)
    c = np.empty(len(tree.row_units))
    for loop in range(len(tree.ends)):
        axes, p2 = transposed(axes_of(tree, rotations, loop, 0)), point_of(tree, rotations, origins, loop, 1)
        _left_sides(tree, rotations, origins, loop, axes, p2, c)
    _equalities(tree, q, c)
    return c


@jit
def linearised(tree, q, s):  # type: ignore[no-untyped-def]
    """Return c (m,), its Jacobian J (m, p) and levers (closures, nv) at a share of the path."""
    if tree.pose >= 0:
        _aim_pose(tree, s)
    rotations, origins = placed(tree, q)
    return linearised_at(tree, q, rotations, origins)


@jit
def linearised_at(tree, q, rotations, origins):  # type: ignore[no-untyped-def]
    """Return c (m,), J (m, p) and levers (closures, nv), the speeds of p2 by each velocity, for joints that are placed.

    A velocity that turns has its lever over its entry of `turns`.
    """
    nv, loops = len(tree.units), len(tree.ends)
    c, jacobian = np.empty(len(tree.row_units)), np.zeros((len(tree.row_units), len(tree.columns)))
    levers, screws = np.zeros((loops, nv)), np.empty((nv, 6))
    for column in range(nv):
        rotation, scale = matrix(rotations, tree.joints[column]), tree.units[column]
        v, w = scaled(vector(tree.linear, column), scale), scaled(vector(tree.angular, column), scale)
        write(screws, column, times(rotation, v), times(rotation, w))
    for loop in range(loops):
        axes, p2 = transposed(axes_of(tree, rotations, loop, 0)), point_of(tree, rotations, origins, loop, 1)
        r = _left_sides(tree, rotations, origins, loop, axes, p2, c)
        start = tree.first_rows[loop]
        between, end = start + tree.position_counts[loop], start + tree.row_counts[loop]
        for k in range(tree.first_columns[loop], tree.first_columns[loop + 1]):
            column = tree.loop_columns[k]
            w = angular_of(screws, column)
            arm = minus(p2, vector(origins, tree.joints[column]))
            v = plus(vector(screws, column), cross(w, arm))
            levers[loop, column] = length(v) * tree.lever_scales[loop, column]
            unknown = tree.unknowns[column]
            if unknown < 0:
                continue
            v = times(axes, scaled(v, tree.loop_signs[k]))
            for row in range(start, between):
                jacobian[row, unknown] = v[0] if tree.forms[row] == 0 else v[1] if tree.forms[row] == 1 else v[2]
            if between < end:
                w = times(_turning_axes(tree, loop, axes), scaled(w, tree.loop_signs[k]))
                for row in range(between, end):
                    jacobian[row, unknown] = _turning(tree.forms[row], w, r)
            for row in range(start, end):
                jacobian[row, unknown] /= tree.row_units[row]
    _equalities(tree, q, c)
    for k in range(len(tree.zeros)):
        row = len(tree.forms) + k
        _, joint, driver, driver_in_v = tree.equality_places[k]
        if tree.unknowns[joint] >= 0:
            jacobian[row, tree.unknowns[joint]] = tree.units[joint] / tree.row_units[row]
        if driver >= 0 and tree.unknowns[driver_in_v] >= 0:
            x, slope = q[driver] - tree.zeros[k, 1], 0.0
            for power in range(tree.polynomials.shape[1] - 1, 0, -1):
                slope = slope * x + power * tree.polynomials[k, power]
            jacobian[row, tree.unknowns[driver_in_v]] -= slope * tree.units[driver_in_v] / tree.row_units[row]
    return c, jacobian, levers


@jit
def _turn_quaternion(q, at, w):  # type: ignore[no-untyped-def]
    """Turn a quaternion, x y z w, in place by a rotation vector in its own frame."""
    angle = length(w)
    a = 0.5 - angle * angle / 48.0
    if angle > 1e-4:
        a = math.sin(0.5 * angle) / angle
    x, y, z, c = a * w[0], a * w[1], a * w[2], math.cos(0.5 * angle)
    i, j, k, s = q[at], q[at + 1], q[at + 2], q[at + 3]
    q[at], q[at + 1] = s * x + i * c + j * z - k * y, s * y - i * z + j * c + k * x
    q[at + 2], q[at + 3] = s * z + i * y - j * x + k * c, s * c - i * x - j * y - k * z
    norm = math.sqrt(q[at] ** 2 + q[at + 1] ** 2 + q[at + 2] ** 2 + q[at + 3] ** 2)
    for n in range(4):
        q[at + n] /= norm


@inlined
def _step(tree, x, v):  # type: ignore[no-untyped-def]
    """Return the displacement of one velocity [rad, m]."""
    unknown = tree.unknowns[v]
    return x[unknown] * tree.units[v] if unknown >= 0 else 0.0


@inlined
def _steps(tree, x, v):  # type: ignore[no-untyped-def]
    return _step(tree, x, v), _step(tree, x, v + 1), _step(tree, x, v + 2)


@jit
def moved(tree, q, s, x):  # type: ignore[no-untyped-def]
    """Return q with the unknown joints moved by x (p,), and the driven ones at their values for a share of the path."""
    q = q.copy()
    for joint in range(len(tree.kinds)):
        kind, at, v = tree.kinds[joint], tree.in_q[joint], tree.in_v[joint]
        if kind <= SLIDE:
            q[at] += _step(tree, x, v)
        elif kind == UNBOUNDED:
            angle = _step(tree, x, v)
            c, sine = math.cos(angle), math.sin(angle)
            a, b = q[at] * c - q[at + 1] * sine, q[at] * sine + q[at + 1] * c
            norm = math.sqrt(a * a + b * b)
            q[at], q[at + 1] = a / norm, b / norm
        elif kind == PLANAR:
            # Half of the turn before the move and half after: right to second order, which is all that steps need.
            move = _steps(tree, x, v)
            half = math.atan2(q[at + 3], q[at + 2]) + 0.5 * move[2]
            q[at] += math.cos(half) * move[0] - math.sin(half) * move[1]
            q[at + 1] += math.sin(half) * move[0] + math.cos(half) * move[1]
            q[at + 2], q[at + 3] = math.cos(half + 0.5 * move[2]), math.sin(half + 0.5 * move[2])
        else:
            # A free joint makes half of its turn before the move and half after.
            move, share = _steps(tree, x, v), 1.0
            if kind == FREE:
                v, share = v + 3, 0.5
                _turn_quaternion(q, at + 3, scaled(_steps(tree, x, v), share))
                move = times(_of_quaternion(q[at + 3], q[at + 4], q[at + 5], q[at + 6]), move)
            if kind != BALL:
                q[at], q[at + 1], q[at + 2] = plus((q[at], q[at + 1], q[at + 2]), move)
                at += 3
            if kind != TRANSLATION:
                _turn_quaternion(q, at, scaled(_steps(tree, x, v), share))
    for k in range(len(tree.driven)):
        begin, end = tree.values[0, k], tree.values[1, k]
        q[tree.driven[k]] = end if s == 1.0 else begin + s * (end - begin)
    return q


@jit
def _rotation_vector(r, vector):  # type: ignore[no-untyped-def]
    """Write the rotation vector of a rotation matrix, by the largest element of its quaternion."""
    q, i = np.empty(4), 0
    for k in range(1, 3):
        if r[4 * k] > r[4 * i]:
            i = k
    if r[0] + r[4] + r[8] > r[4 * i]:
        q[0], q[1], q[2], q[3] = r[7] - r[5], r[2] - r[6], r[3] - r[1], 1.0 + r[0] + r[4] + r[8]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i], q[3] = 1.0 + r[4 * i] - r[4 * j] - r[4 * k], r[3 * k + j] - r[3 * j + k]
        q[j], q[k] = r[3 * i + j] + r[3 * j + i], r[3 * i + k] + r[3 * k + i]
    if q[3] < 0.0:
        q *= -1.0
    size = length(q)
    scale = 2.0 / q[3] if size < 1e-12 * q[3] else 2.0 * math.atan2(size, q[3]) / size
    for k in range(3):
        vector[k] = scale * q[k]


@jit
def aim(tree, q, target):  # type: ignore[no-untyped-def]
    """Set the path from q to a target: values of the driven joints, or the 16 numbers of a pose's matrix."""
    if tree.pose < 0:
        for k in range(len(tree.driven)):
            tree.values[0, k], tree.values[1, k] = q[tree.driven[k]], target[k]
            column = tree.driven_in_v[k]
            tree.driven_rates[column] = (target[k] - q[tree.driven[k]]) / tree.units[column]
        return
    rotations, origins = placed(tree, q)
    start, place = axes_of(tree, rotations, tree.pose, 1), point_of(tree, rotations, origins, tree.pose, 1)
    _put(start, tree.pose_rotations, 0)
    tree.pose_places[0, 0], tree.pose_places[0, 1], tree.pose_places[0, 2] = place
    for i in range(3):
        for j in range(3):
            tree.pose_rotations[1, 3 * i + j] = target[4 * i + j]
        tree.pose_places[1, i] = target[4 * i + 3]
    _rotation_vector(product(matrix(tree.pose_rotations, 1), transposed(start)), tree.turn)
    tree.pose_turn[0] = length(tree.turn)
