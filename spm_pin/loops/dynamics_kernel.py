"""Forward dynamics of any closed chain, compiled once for all: the same as `StateKinematics.accelerations`.

Twists, accelerations and wrenches are linear first, along the axes of the world and about the origin of the first
joint's frame, so that masses far from the world's origin lose no digits. Velocities span the columns S of the joints,
bodies are the ten numbers m, m c and the inertia about that origin. `null_space` has the equations of the
factorisation, `constraint_rows` those of the rows.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.loops import null_space, state_kinematics, tree_kernel
from spm_pin.loops.kernel import Kernel, inlined, jit
from spm_pin.loops.null_space import INDEPENDENT
from spm_pin.loops.state_kinematics import AGREEMENT, COMPATIBLE, DEPENDENCE
from spm_pin.loops.tree_kernel import (
    angular_of,
    axes_of,
    cross,
    left_side,
    linearised_at,
    matrix,
    minus,
    placed,
    plus,
    point_of,
    product,
    scaled,
    times,
    transposed,
    vector,
    write,
)


@inlined
def _dot(x, y):  # type: ignore[no-untyped-def]
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@inlined
def _add_multiple(array, k, factor, other, i):  # type: ignore[no-untyped-def]
    for n in range(6):
        array[k, n] += factor * other[i, n]


@inlined
def _wrench(bodies, k, linear, angular):  # type: ignore[no-untyped-def]
    """Return the inertia of a body times a twist."""
    b, moment = bodies, (bodies[k, 1], bodies[k, 2], bodies[k, 3])
    force = plus(scaled(linear, b[k, 0]), cross(angular, moment))
    turning = (
        b[k, 4] * angular[0] + b[k, 5] * angular[1] + b[k, 6] * angular[2],
        b[k, 5] * angular[0] + b[k, 7] * angular[1] + b[k, 8] * angular[2],
        b[k, 6] * angular[0] + b[k, 8] * angular[1] + b[k, 9] * angular[2],
    )
    return force, plus(turning, cross(moment, linear))


@inlined
def _turned(column, turning, w, w1, w2):  # type: ignore[no-untyped-def]
    """Return the second derivative of a column of R = R1ᵀ R2, where frame 2 turns against frame 1 at w = w2 - w1."""
    fixed = plus(cross(turning, column), cross(w, cross(w2, column)))
    return minus(fixed, cross(w1, cross(w, column)))


@jit
def _motion(tree, rotations, origins, v, columns, twists, drifts, bodies):  # type: ignore[no-untyped-def]
    """Write the columns S (nv, 6), and twists, accelerations of v alone and inertias of all bodies."""
    zero, center, k = (0.0, 0.0, 0.0), vector(origins, 0), 0
    for joint in range(len(tree.kinds)):
        parent, rotation = tree.parents[joint], matrix(rotations, joint)
        arm = minus(vector(origins, joint), center)
        linear, angular = zero, zero
        while k < len(v) and tree.joints[k] == joint:
            w = times(rotation, vector(tree.angular, k))
            along = plus(times(rotation, vector(tree.linear, k)), cross(arm, w))
            write(columns, k, along, w)
            linear, angular = plus(linear, scaled(along, v[k])), plus(angular, scaled(w, v[k]))
            k += 1
        if parent >= 0:
            old_linear, old_angular = vector(twists, parent), angular_of(twists, parent)
            turned = plus(cross(old_angular, linear), cross(old_linear, angular))
            drift = plus(vector(drifts, parent), turned)
            drift_angular = plus(angular_of(drifts, parent), cross(old_angular, angular))
            linear, angular = plus(old_linear, linear), plus(old_angular, angular)
            write(drifts, joint, drift, drift_angular)
        else:
            write(drifts, joint, zero, zero)
        write(twists, joint, linear, angular)
        mass, c = tree.masses[joint], plus(times(rotation, vector(tree.levers, joint)), arm)
        own = product(product(rotation, matrix(tree.inertias, joint)), transposed(rotation))
        bodies[joint, 0] = mass
        bodies[joint, 1], bodies[joint, 2], bodies[joint, 3] = scaled(c, mass)
        bodies[joint, 4] = own[0] + mass * (c[1] * c[1] + c[2] * c[2])
        bodies[joint, 5], bodies[joint, 6] = own[1] - mass * c[0] * c[1], own[2] - mass * c[0] * c[2]
        bodies[joint, 7] = own[4] + mass * (c[0] * c[0] + c[2] * c[2])
        bodies[joint, 8] = own[5] - mass * c[1] * c[2]
        bodies[joint, 9] = own[8] + mass * (c[0] * c[0] + c[1] * c[1])


@inlined
def _of_body(array, joint):  # type: ignore[no-untyped-def]
    """Return the parts of the twist of a body, zero for the universe."""
    if joint >= 0:
        return vector(array, joint), angular_of(array, joint)
    return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@jit
def _bias(tree, q, rates, rotations, origins, twists, drifts, bias):  # type: ignore[no-untyped-def]
    """Write J̇ v of all rows but those of joints that are held, in units of the rows."""
    center, row = vector(origins, 0), 0
    for loop in range(len(tree.ends)):
        first, second = tree.ends[loop, 0], tree.ends[loop, 1]
        axes = transposed(axes_of(tree, rotations, loop, 0))
        v1, w1 = _of_body(twists, first)
        v2, w2 = _of_body(twists, second)
        drift1, turning1 = _of_body(drifts, first)
        drift2, turning2 = _of_body(drifts, second)
        v, w = minus(v2, v1), minus(w2, w1)
        drift, turning = minus(drift2, drift1), minus(turning2, turning1)
        p = minus(point_of(tree, rotations, origins, loop, 1), center)
        gap = plus(drift, cross(turning, p))
        gap = plus(gap, cross(w, plus(v2, cross(w2, p))))
        gap = times(axes, minus(gap, cross(w1, plus(v, cross(w, p)))))
        r = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        if tree.position_counts[loop] < tree.row_counts[loop]:
            r = product(axes, axes_of(tree, rotations, loop, 1))
            turns = times(axes, turning), times(axes, w), times(axes, w1), times(axes, w2)
            x, y, z = _turned(r[0::3], *turns), _turned(r[1::3], *turns), _turned(r[2::3], *turns)
            r = (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])
        for _ in range(tree.row_counts[loop]):
            bias[row] = left_side(tree.forms[row], gap, r) / tree.row_units[row]
            row += 1
    for k in range(len(tree.zeros)):
        driver = tree.equality_places[k, 2]
        curvature = 0.0
        if driver >= 0:
            for power in range(tree.polynomials.shape[1] - 1, 1, -1):
                curvature = curvature * (q[driver] - tree.zeros[k, 1])
                curvature += power * (power - 1) * tree.polynomials[k, power]
            rate = rates[tree.equality_places[k, 3]]
            curvature *= rate * rate
        bias[row + k] = -curvature / tree.row_units[row + k]


@jit
def _factorise(a, order, factors, norms, w, tolerance, rank):  # type: ignore[no-untyped-def]
    """Factorise in place the transposed rows (nv, m) by Householder's reflections with pivoting; return the rank.

    A nonnegative `rank` is used as given; otherwise it is the number of rows that are independent to `tolerance`. Norms
    (m,) are zero, and w (m,) is memory.
    """
    nv, rows = a.shape
    least, k = 0.0, 0
    for i in range(nv):
        for j in range(rows):
            norms[j] += a[i, j] * a[i, j]
    while k < min(nv, rows) and (rank < 0 or k < rank):
        pivot = k
        for j in range(k + 1, rows):
            if norms[j] > norms[pivot]:
                pivot = j
        size = math.sqrt(norms[pivot])
        if k == 0:
            least = tolerance * max(size, 1e-300)
        if rank < 0 and not size > least:
            break
        if pivot != k:
            norms[pivot] = norms[k]
            order[k], order[pivot] = order[pivot], order[k]
            for i in range(nv):
                a[i, k], a[i, pivot] = a[i, pivot], a[i, k]
        beta = -size if a[k, k] > 0.0 else size
        factor, factors[k] = 1.0, 0.0
        if size > 0.0:
            factor, factors[k] = 1.0 / (a[k, k] - beta), (beta - a[k, k]) / beta
        a[k, k] = beta
        for j in range(k + 1, rows):
            w[j] = a[k, j]
        for i in range(k + 1, nv):
            a[i, k] *= factor
            if a[i, k] != 0.0:
                for j in range(k + 1, rows):
                    w[j] += a[i, k] * a[i, j]
        for j in range(k + 1, rows):
            w[j] *= factors[k]
            a[k, j] -= w[j]
            norms[j] = 0.0
        for i in range(k + 1, nv):
            if a[i, k] != 0.0:
                for j in range(k + 1, rows):
                    a[i, j] -= a[i, k] * w[j]
            for j in range(k + 1, rows):
                norms[j] += a[i, j] * a[i, j]
        k += 1
    return k


@jit
def _reflect(a, factors, rank, x):  # type: ignore[no-untyped-def]
    """Replace x (nv, any) by Q x."""
    nv, count = x.shape
    w = np.empty(count)
    for k in range(rank - 1, -1, -1):
        for d in range(count):
            w[d] = x[k, d]
        for i in range(k + 1, nv):
            if a[i, k] != 0.0:
                for d in range(count):
                    w[d] += a[i, k] * x[i, d]
        for d in range(count):
            w[d] *= factors[k]
            x[k, d] -= w[d]
        for i in range(k + 1, nv):
            if a[i, k] != 0.0:
                for d in range(count):
                    x[i, d] -= a[i, k] * w[d]


@jit
def _project(tree, columns, twists, drifts, bodies, x, a, moved, forces):  # type: ignore[no-untyped-def]
    """Subtract the forces of accelerations a from `forces` (nv,), and write M x (nv, dof) to `moved`.

    Inertias of bodies become the composite ones, with all bodies that they carry.
    """
    count, free = len(tree.kinds), x.shape[1] - 1
    wrenches, nv = drifts, len(a)  # each is read before it is written
    for k in range(nv):
        # Accelerations of bodies; those of parents are complete.
        joint = tree.joints[k]
        if k == tree.in_v[joint] and tree.parents[joint] >= 0:
            _add_multiple(columns, nv + joint, 1.0, columns, nv + tree.parents[joint])
        _add_multiple(columns, nv + joint, a[k], columns, k)
    for joint in range(count):
        linear, angular = vector(twists, joint), angular_of(twists, joint)
        force, turning = _wrench(bodies, joint, linear, angular)
        rate, rate_angular = vector(drifts, joint), angular_of(drifts, joint)
        rate = minus(plus(rate, vector(columns, nv + joint)), vector(tree.gravity, 0))
        rate_angular = plus(rate_angular, angular_of(columns, nv + joint))
        wrench, moment = _wrench(bodies, joint, rate, rate_angular)
        wrench = plus(wrench, cross(angular, force))
        moment = plus(plus(moment, cross(angular, turning)), cross(linear, force))
        write(wrenches, joint, wrench, moment)
    k = nv - 1
    for joint in range(count - 1, -1, -1):
        parent = tree.parents[joint]
        while k >= 0 and tree.joints[k] == joint:
            along, w = vector(columns, k), angular_of(columns, k)
            wrench, moment = vector(wrenches, joint), angular_of(wrenches, joint)
            forces[k] -= _dot(along, wrench) + _dot(w, moment) + tree.armatures[k] * a[k]
            force, turning = _wrench(bodies, joint, along, w)
            mass = _dot(along, force) + _dot(w, turning) + tree.armatures[k]
            for d in range(free):
                moved[k, d] += mass * x[k, d]
            i = tree.carriers[k]
            while i >= 0:
                mass = _dot(vector(columns, i), force) + _dot(angular_of(columns, i), turning)
                for d in range(free):
                    moved[k, d] += mass * x[i, d]
                    moved[i, d] += mass * x[k, d]
                i = tree.carriers[i]
            k -= 1
        if parent >= 0:
            _add_multiple(wrenches, parent, 1.0, wrenches, joint)
            for n in range(10):
                bodies[parent, n] += bodies[joint, n]


@jit
def _solve(matrix, x):  # type: ignore[no-untyped-def]
    """Solve a positive definite system in place by Cholesky's factorisation; return whether it is positive definite."""
    count = len(x)
    for i in range(count):
        for k in range(i):
            matrix[i, i] -= matrix[i, k] * matrix[i, k]
            x[i] -= matrix[i, k] * x[k]
        if not matrix[i, i] > 0.0:
            return False
        matrix[i, i] = math.sqrt(matrix[i, i])
        x[i] /= matrix[i, i]
        for j in range(i + 1, count):
            for k in range(i):
                matrix[j, i] -= matrix[j, k] * matrix[i, k]
            matrix[j, i] /= matrix[i, i]
    for i in range(count - 1, -1, -1):
        for j in range(i + 1, count):
            x[i] -= matrix[j, i] * x[j]
        x[i] /= matrix[i, i]
    return True


@inlined
def _largest(vector):  # type: ignore[no-untyped-def]
    size = 0.0
    for x in vector:
        # NaN stays.
        if not abs(x) <= size:
            size = abs(x)
    return size


@jit
def _accelerate(tree, q, v, forces, rank, regular):  # type: ignore[no-untyped-def]
    """Replace forces (nv,) by accelerations, and return True; or return False if an error is perhaps to be raised."""
    nv, count, held = len(v), len(tree.kinds), len(tree.held)
    rotations, origins = placed(tree, q)
    residual, jacobian, _ = linearised_at(tree, q, rotations, origins)
    first = len(residual)
    rows, gap = first + held, _largest(residual)
    if not gap <= AGREEMENT:
        return False
    # Rows as columns, the last ones of joints that are held.
    factored, order, memory = np.zeros((nv, rows)), np.arange(rows), np.zeros((5, rows))
    opening, bias, factors, norms, w = memory[0], memory[1], memory[2], memory[3], memory[4]
    speed = 0.0
    for k in range(nv):
        rate = v[k] / tree.units[k]
        speed = max(speed, abs(rate))
        for row in range(first):
            factored[k, row] = jacobian[row, k]
            opening[row] += jacobian[row, k] * rate
    for k in range(held):
        factored[tree.held[k], first + k] = 1.0
        opening[first + k] = v[tree.held[k]] / tree.units[tree.held[k]]
    if not _largest(opening) <= AGREEMENT * speed:
        return False
    rank = _factorise(factored, order, factors, norms, w, max(DEPENDENCE * gap, INDEPENDENT), rank)
    if rank < rows and nv - rank > regular:
        return False
    # One array costs less than four.
    memory = np.zeros((nv + 4 * count, 10))
    columns, bodies = memory[: nv + count], memory[nv + count : nv + 2 * count]
    twists, drifts = memory[nv + 2 * count : nv + 3 * count], memory[nv + 3 * count :]
    _motion(tree, rotations, origins, v, columns, twists, drifts, bodies)
    _bias(tree, q, v, rotations, origins, twists, drifts, bias)
    # The least accelerations are the last column, beside the basis.
    free = nv - rank
    x, a = np.zeros((nv, free + 1)), np.empty(nv)
    for k in range(rank):
        part = -bias[order[k]]
        for i in range(k):
            part -= factored[i, k] * x[i, free]
        x[k, free] = part / factored[k, k]
    for d in range(free):
        x[rank + d, d] = 1.0
    _reflect(factored, factors, rank, x)
    if rank < rows:
        missed = 0.0
        for row in range(first):
            total = bias[row]
            for k in range(nv):
                total += jacobian[row, k] * x[k, free]
            missed = max(missed, abs(total))
        for k in range(held):
            missed = max(missed, abs(x[tree.held[k], free]))
        if not missed <= COMPATIBLE * (_largest(bias) + speed * speed):
            return False
    for k in range(nv):
        for d in range(free + 1):
            x[k, d] *= tree.units[k]
        a[k] = x[k, free]
    moved, rest = np.zeros((nv, free)), forces.copy()
    _project(tree, columns, twists, drifts, bodies, x, a, moved, rest)
    mass, solution = np.zeros((free, free)), np.zeros(free)
    for k in range(nv):
        for d in range(free):
            solution[d] += x[k, d] * rest[k]
            for e in range(free):
                mass[d, e] += x[k, d] * moved[k, e]
    if not _solve(mass, solution):
        return False
    for k in range(nv):
        for d in range(free):
            a[k] += x[k, d] * solution[d]
        forces[k] = a[k]
    return True


def _run(tree, q, v, forces, rank, regular):  # type: ignore[no-untyped-def]
    """Replace the forces of all members by their accelerations; return False at the first that perhaps has an error.

    q, v and forces are those of one member or several, flat. The rank of the rows is computed if it is negative;
    `regular` is the number of degrees of freedom in regular configurations: a larger one is a singularity.
    """
    nv = len(tree.units)
    members = len(v) // nv
    nq = len(q) // max(members, 1)
    for k in range(members):
        begin, end = k * nv, (k + 1) * nv
        if not _accelerate(tree, q[k * nq : (k + 1) * nq], v[begin:end], forces[begin:end], rank, regular):
            return False
    return True


accelerate = Kernel(_run, *(str(module.__file__) for module in (tree_kernel, null_space, state_kinematics)), __file__)
