# mypy: allow-untyped-calls
"""Paths of any closed chain, compiled once for all: tree, closures and target are arrays.

The functions are those of `following` over Pinocchio, for the same `continuation`. A joint is one of seven kinds, by
how its configuration is stored.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
from numba.core import event, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_jitable,
    register_model,
    typeof_impl,
    unbox,
)
from numba.np.arrayobj import populate_array

from spm_pin.loops import continuation
from spm_pin.loops.constraint_rows import FORMS
from spm_pin.support.arguments import FloatArray, IntArray
from spm_pin.support.compiling import COMPILING

HINGE, SLIDE, UNBOUNDED, BALL, FREE, TRANSLATION, PLANAR = range(7)
_KINDS = {"Spherical": BALL, "FreeFlyer": FREE, "Translation": TRANSLATION, "Planar": PLANAR}
_KINDS |= dict.fromkeys(("PX", "PY", "PZ", "PrismaticUnaligned"), SLIDE)
_KINDS |= dict.fromkeys(("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned"), UNBOUNDED)
_LOG = logging.getLogger("spm_pin")

# Without wrappers for C, which nothing calls, compiling takes a tenth less.
jit: Any = register_jitable(error_model="numpy", no_cfunc_wrapper=True)
summing: Any = register_jitable(error_model="numpy", no_cfunc_wrapper=True, fastmath={"reassoc", "contract"})
"""For sums whose order does not matter, so that the compiler vectorises them."""
inlined: Any = register_jitable(error_model="numpy", no_cfunc_wrapper=True, forceinline=True)
"""For small functions of small arrays, of which the compiler then keeps the elements in registers."""


def tree_of(problem: Any, held: IntArray | tuple[()] = ()) -> SimpleNamespace:
    """Return a `following.Problem` as arrays, and the masses of its bodies; `_aim` writes the last ones.

    `held` are velocities that are zero in dynamics.
    """
    rows, joints, inertias = problem.rows, list(problem.rows.model.joints)[1:], list(problem.rows.model.inertias)[1:]
    linear, angular = rows.screws
    placements = [rows.model.jointPlacements[joint.id] for joint in joints]
    unknowns = np.full(rows.model.nv, -1)
    unknowns[problem.columns] = np.arange(len(problem.columns))
    orders = np.split(problem.loop_columns, problem.first_columns[1:-1]) if len(rows.signs) else []

    def whole(values: Any) -> IntArray:
        return np.array(values, dtype=np.int64, order="C")

    def stacked(values: Any, *shape: int) -> FloatArray:
        return np.array(values, dtype=np.float64, order="C").reshape(-1, *shape).copy()

    return SimpleNamespace(
        parents=whole([rows.model.parents[joint.id] - 1 for joint in joints]),
        kinds=whole([_KINDS.get(joint.shortname().removeprefix("JointModel"), HINGE) for joint in joints]),
        in_q=whole([joint.idx_q for joint in joints]),
        in_v=whole([joint.idx_v for joint in joints]),
        rotations=stacked([placement.rotation for placement in placements], 9),
        places=stacked([placement.translation for placement in placements], 3),
        linear=stacked(linear, 3),
        angular=stacked(angular, 3),
        joints=whole(np.repeat(np.arange(len(joints)), [joint.nv for joint in joints])),
        carriers=whole(rows.model.createData().parents_fromRow),
        units=stacked(rows.units),
        ends=whole(rows.joints).reshape(-1, 2) - 1,
        turns=np.array(rows.turns, order="C"),
        lever_scales=np.array(rows.lever_scales, order="C"),
        first_columns=whole(problem.first_columns),
        loop_columns=whole(problem.loop_columns),
        loop_signs=stacked(
            np.concatenate([sign[order] for sign, order in zip(rows.signs, orders, strict=True)] or [np.zeros(0)])
        ),
        forms=whole(rows.forms % FORMS),
        row_units=stacked(rows.row_units),
        equality_places=whole(rows.equality_places),
        polynomials=np.array(rows.polynomials, order="C"),
        zeros=np.array(rows.zeros, order="C"),
        drivers=np.zeros(len(rows.zeros)),
        columns=whole(problem.columns),
        unknowns=whole(unknowns),
        driven=whole(problem.driven),
        driven_in_v=whole(problem.driven_in_v),
        pose=problem.pose,
        most_steps=-1,
        first_rows=whole(problem.first_rows),
        position_counts=whole(problem.position_counts),
        row_counts=whole(problem.row_counts),
        gravity=stacked(rows.model.gravity.linear, 3),
        masses=stacked([inertia.mass for inertia in inertias]),
        levers=stacked([inertia.lever for inertia in inertias], 3),
        inertias=stacked([inertia.inertia for inertia in inertias], 9),
        armatures=stacked(rows.model.armature),
        held=whole(held),
        end_rotations=stacked([end.rotation for ends in rows.placements for end in ends], 9),
        end_places=stacked([end.translation for ends in rows.placements for end in ends], 3),
        driven_rates=np.zeros(rows.model.nv),
        values=np.zeros((2, len(problem.driven))),
        pose_turn=np.zeros(1),
        pose_share=np.zeros(1),
        turn=np.zeros(3),
        pose_rotations=np.zeros((2, 9)),
        pose_places=np.zeros((2, 3)),
        pose_axes=np.zeros((1, 9)),
    )


class PlainTree:
    """A tree for compiled functions: a table of pointers and shapes, which an argument costs nothing to pass.

    Numba passes a tuple array by array, each counted as a reference wherever a function is called.
    """

    def __init__(self, tree: SimpleNamespace) -> None:
        self.fields = vars(tree)
        arrays = [
            (x.ctypes.data, *x.shape, 0)[:3] if isinstance(x, np.ndarray) else (x, 0, 0) for x in vars(tree).values()
        ]
        self._table = np.array(arrays)
        self.address = self._table.ctypes.data


class _PlainType(types.Type):
    def __init__(self, fields: dict[str, Any]) -> None:
        self.fields = {name: (3 * k, numba.typeof(value)) for k, (name, value) in enumerate(fields.items())}
        super().__init__(f"PlainTree({self.fields})")


register_model(_PlainType)(models.OpaqueModel)


@typeof_impl.register(PlainTree)
def _type_of(value, _):  # type: ignore[no-untyped-def]
    return _PlainType(value.fields)


@unbox(_PlainType)
def _unbox(_, value, c):  # type: ignore[no-untyped-def]
    number = c.pyapi.object_getattr_string(value, "address")
    pointer = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(pointer)


@infer_getattr
class _Fields(AttributeTemplate):
    key = _PlainType

    def generic_resolve(self, kind, name):  # type: ignore[no-untyped-def, override]
        """Return the type of a field."""
        return kind.fields[name][1]


@lower_getattr_generic(_PlainType)
def _load(context, builder, kind, tree, name):  # type: ignore[no-untyped-def]
    (place, field), integer = kind.fields[name], context.get_value_type(types.intp)
    table = builder.bitcast(tree, integer.as_pointer())

    def number(k):  # type: ignore[no-untyped-def]
        result = builder.load(builder.gep(table, [integer(place + k)]))
        # The table never changes, so that a loop may keep what is read before it.
        result.set_metadata("invariant.load", builder.module.add_metadata([]))
        return result

    if not isinstance(field, types.Array):
        return number(0)
    array, item = context.make_array(field)(context, builder), field.dtype.bitwidth // 8
    shape = [number(1 + k) for k in range(field.ndim)]
    strides = [integer(item)] if field.ndim == 1 else [builder.mul(shape[1], integer(item)), integer(item)]
    data = builder.inttoptr(number(0), array.data.type)
    populate_array(array, data, shape, strides, integer(item), meminfo=None)
    return array._getvalue()


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
    """Move the pose that is to be reached to its place at a share of the path, as `Problem.place` does."""
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
    gap = times(axes, plus(p2, scaled(point_of(tree, rotations, origins, loop, 0), -1.0)))
    r = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if tree.position_counts[loop] < tree.row_counts[loop]:
        r = product(_turning_axes(tree, loop, axes), axes_of(tree, rotations, loop, 1))
    first = tree.first_rows[loop]
    for row in range(first, first + tree.row_counts[loop]):
        c[row] = left_side(tree.forms[row], gap, r) / tree.row_units[row]
    return r


@jit
def _residual(tree, q, s):  # type: ignore[no-untyped-def]
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
def _linearised(tree, q, s):  # type: ignore[no-untyped-def]
    if tree.pose >= 0:
        _aim_pose(tree, s)
    rotations, origins = placed(tree, q)
    return linearised_at(tree, q, rotations, origins)


@jit
def linearised_at(tree, q, rotations, origins):  # type: ignore[no-untyped-def]
    """Return c (m,), J (m, p), and levers and turns (closures, nv) of joints that are placed."""
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
            arm = plus(p2, scaled(vector(origins, tree.joints[column]), -1.0))
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
    return c, jacobian, levers, tree.turns


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
def _moved(tree, q, s, x):  # type: ignore[no-untyped-def]
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
def _left_inverse(jacobian):  # type: ignore[no-untyped-def]
    """Return (Jᵀ J)⁻¹ Jᵀ by Cholesky's factorisation UᵀU, and whether J has full column rank.

    The inner loops add multiples of rows, which the compiler vectorises, and leave out those of zero, which are many.
    """
    rows, columns = jacobian.shape
    inverse, upper, largest = jacobian.T.copy(), np.zeros((columns, columns)), 0.0
    for row in range(rows):
        for i in range(columns):
            if jacobian[row, i] != 0.0:
                for k in range(i, columns):
                    upper[i, k] += jacobian[row, i] * jacobian[row, k]
    for i in range(columns):
        if not upper[i, i] > 0.0:
            return inverse, False
        pivot = math.sqrt(upper[i, i])
        largest, factor = max(largest, pivot), 1.0 / pivot
        for k in range(i, columns):
            upper[i, k] *= factor
        for row in range(rows):
            inverse[i, row] *= factor
        for j in range(i + 1, columns):
            factor = upper[i, j]
            if factor != 0.0:
                for k in range(j, columns):
                    upper[j, k] -= factor * upper[i, k]
                for row in range(rows):
                    inverse[j, row] -= factor * inverse[i, row]
    for i in range(columns - 1, -1, -1):
        if not upper[i, i] > continuation.REGULAR * largest:
            return inverse, False
        for j in range(i + 1, columns):
            factor = upper[i, j]
            if factor != 0.0:
                for row in range(rows):
                    inverse[i, row] -= factor * inverse[j, row]
        factor = 1.0 / upper[i, i]
        for row in range(rows):
            inverse[i, row] *= factor
    return inverse, True


@summing
def _matrix_times(matrix, vector):  # type: ignore[no-untyped-def]
    """Return the product of a small matrix and a vector, in a fraction of the time of a call to BLAS."""
    result = np.empty(len(matrix))
    for i in range(len(matrix)):
        total = 0.0
        for k in range(len(vector)):
            total += matrix[i, k] * vector[k]
        result[i] = total
    return result


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
def _aim(tree, q, target):  # type: ignore[no-untyped-def]
    """Set the path from q to a target, as `Problem.aim` does."""
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


_begin, _go_on = continuation.make_follower(_residual, _linearised, _moved, _left_inverse, _matrix_times, jit)


def _run(tree, starts, targets, is_path, results):  # type: ignore[no-untyped-def]
    """Write q of all targets; return the number of those reached, and the status, share and steps of the last path."""
    q, off, jacobian = starts[0], 0.0, np.empty((0, 0))
    inverse = jacobian
    for k in range(len(targets)):
        if not is_path:
            q = starts[k]
        _aim(tree, q, targets[k])
        if k == 0 or tree.pose >= 0 or not (is_path or (q == starts[k - 1]).all()):
            status, jacobian, inverse = _begin(tree, q)
            off = 0.0
            if status != continuation.DONE:
                results[k] = q
                return k, status, 0.0, 0
        q, at_end, new, away, status, done, steps = _go_on(tree, q, jacobian, inverse, off)
        results[k] = q
        if status != continuation.DONE:
            return k, status, done, steps
        if is_path:
            jacobian, inverse, off = at_end, new, away
    return len(targets), continuation.DONE, 1.0, 0


class _Announcement(event.Listener):
    """Log that Numba begins to compile, not that it loads what is kept."""

    def __init__(self) -> None:
        self._announced = False

    def on_start(self, event: Any) -> None:
        if not self._announced:
            _LOG.warning("spm_pin: compiling the loops of closed chains for this machine, once (about half a minute)")
        self._announced = True

    def on_end(self, event: Any) -> None:
        pass


class Kernel:
    """A function, `call`, that is compiled or loaded from Numba's cache at its first call."""

    def __init__(self, function: Callable[..., Any], *modules: str) -> None:
        """`modules` are the files that the function is compiled from."""
        self._function, self._modules = function, modules
        self.is_loaded = False  # whether a call starts at once
        self.call: Callable[..., Any] = self._first_call

    def _first_call(self, *arguments: Any) -> Any:
        with COMPILING:
            if not self.is_loaded:
                # Numba's cache looks at one file alone: the name that is kept has a digest of all that is compiled.
                digest = hashlib.sha256(b"".join(Path(module).read_bytes() for module in self._modules)).hexdigest()
                self._function.__qualname__ = f"{self._function.__name__}_{digest[:16]}"
                signature = tuple(map(numba.typeof, arguments))
                compiled: Any
                try:
                    with event.install_listener("numba:compile", _Announcement()):
                        compiled = numba.njit(signature, error_model="numpy", nogil=True, cache=True)(self._function)
                except Exception as error:  # nowhere to keep it, or a damaged file, which may raise anything
                    _LOG.warning("spm_pin: Numba's cache cannot be used, see NUMBA_CACHE_DIR: %r", error)
                    compiled = numba.njit(signature, error_model="numpy", nogil=True)(self._function)
                # The function behind the dispatcher, which looks for the types of all arguments in a microsecond.
                self.call, self.is_loaded = next(iter(compiled.overloads.values())).entry_point, True
        return self.call(*arguments)


run = Kernel(_run, __file__, str(continuation.__file__))
