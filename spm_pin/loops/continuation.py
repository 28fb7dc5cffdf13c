"""Continuation between closed configurations of one assembly mode: Newton's method, each step verified by a theorem.

The path parameter s runs from 0 to 1, the share of the change of the driven joints, or of the pose. The unknowns are
the other joints' values x. The equations c(x, s) = 0 have a Jacobian J of full column rank; it may have more rows than
columns, and rows may be linearly dependent. With A = (Jᵀ J)⁻¹ Jᵀ in one place of a step, or the mean of several, A c(x,
s) = 0 has as many equations as unknowns, and Krawczyk's theorem says where it has one solution. Let x(t) be a curve
from the start to the end of the step, straight or a parabola. Where a box of radii r about it, at every t from 0 to 1,
satisfies

    |A c| + |A J - 1| r <= r,

one branch of solutions leads from the start to the end, J is regular all along, and no other solution is in the box:
neither a fold nor another mode. All quantities are dimensionless, absolute values are of each element. Bounds:

Per unit of a joint j, frame 2 of a closure turns by t_j, zero for a slide, and its point moves by n_j, at that place.
In the order from frame 1 to frame 2, derivatives of p2 by several joints are no larger than the n_j of the last, whose
direction the others only turn. Let u_i and g_i bound the first and second derivatives of x_i(t), and w_i and v_i be
displacements beside the curve. With the sums U, G, W and V of t_i u_i, t_i g_i, t_i w_i and t_i v_i up to j, and

    D_j = derivative of exp(U t + G t² / 2 + W y + V z) at 0, a times by t and up to once by y and by z,

the same derivatives of p2 sum up to at most Σ_j n_j / t_j (D_j - D_(j-1)), and those of the angles to D of all joints;
a slide adds to the first order in what moves it. Away from there, the arms n_j / t_j grow by less than the exponential
of all turns times the sum of all motions. A step is safe

- if bounds from its end alone say so: on a straight line c, zero at both ends, is at most 1/8 of its second derivative,
  and J changes by no more than its first. That costs little, and is enough for a path that is sampled densely;
- or if c in the quarters of a parabola, and J at its ends and in its middle, say so, with the mean of A at both ends
  and bounds of the fifth derivative of c and the third of J. The parabola follows the branch: c is small on it.

J is not computed anew at the end of a step: it is that of one of the last iterates of Newton's method. The distance of
that iterate from the end is added to the radii of the boxes in which J is bounded.

The equation of a joint equality is a polynomial of its driver; with x from 0 to the farthest place of the step,
absolute values of its coefficients bound its derivatives. The theorem holds for hinges and slides, up to rounding
errors, which are estimated. For ball, planar and free joints, whose displacements do not commute, the test is a rule of
thumb. Where c = 0 has rows that depend on others, a solution of A c = 0 is one of c = 0 as long as they do so; that c
is zero is checked at the end of each step.

The functions run in two ways, interpreted and compiled, of which two parts of linear algebra differ.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lapack

from spm_pin.loops import tree_kernel
from spm_pin.loops.kernel import Kernel, compiled_as, jit
from spm_pin.loops.tree_kernel import aim, linearised, moved, residual
from spm_pin.support.arguments import FloatArray

DONE, SINGULAR_START, NO_FURTHER, OPEN_START, UNFINISHED = range(5)
"""Status of a path: target reached, Jacobian singular at the start, end before the target, loops open at the start, and
no steps left."""
LONGEST = 1.0
"""Largest step tried in any joint, dimensionless: in rad, or in units of `ConstraintRows.units`."""
SHORTEST_STEP = 1e-7
"""Size of a step, dimensionless, below which a path ends: rounding errors become comparable to the step."""
SHORTEST_SHARE = 2.0**-36
FAR = 3e-3
"""Size of a correction, dimensionless, after which J is computed anew."""
MOST_CORRECTIONS = 12
CLOSED, ROUNDED = 1e-10, 1e-9
"""Loops are closed if their equations, dimensionless, hold to `CLOSED`; mostly they do so to rounding, a few 1e-16. At
the start of a path, joint values that were rounded are taken for closed to `ROUNDED`."""
ROUNDING, NOISE = 1e-15, 1e-10
"""Errors of c near the origin by rounding, and what they may come to in a correction, at 10,000 times the loop's length
from there. No step as small as that leads past a singularity from a place that is `REGULAR`."""
REGULAR = 1e-7
"""Smallest pivot of a Jacobian of full rank, relative to the largest."""
INNER, QUINTIC = 1.87, 3.0e-5
"""Largest value of a polynomial of degree four that is zero at 0 and 1 and at most 1 in the quarters, and of the
product of the distances from all five, over 5!: parts of c and of its fifth derivative."""
CUBIC = 8.1e-3
"""The same of three distances, over 3!, for what a parabola through 0, 1/2 and 1 leaves of J; it is nowhere larger than
in the middle and at the larger end together."""
SHORT = 0.05
"""Size of a step, dimensionless, from which on bounds from its end alone hardly ever say that it is safe, and a second
correction without J of the end costs less than computing J twice."""
MOST_BOXES, HOPELESS = 8, 3.0
"""Boxes tried, and their largest radius, dimensionless; at turns of 9 rad in all bounds are far beyond it."""


def left_inverse(jacobian: FloatArray) -> tuple[FloatArray, bool]:
    """Return (Jᵀ J)⁻¹ Jᵀ, and whether J (m, p) has full column rank."""
    rows, columns = jacobian.shape
    if not columns:
        return np.zeros((0, rows)), True
    factor, info = lapack.dpotrf(jacobian.T @ jacobian)
    diagonal = factor.diagonal().tolist()
    if info or min(diagonal) <= REGULAR * max(diagonal):
        return np.zeros((columns, rows)), False
    return np.asarray(lapack.dpotrs(factor, jacobian.T)[0]), True


@compiled_as(left_inverse)
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
        if not upper[i, i] > REGULAR * largest:
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


def product(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the product of a matrix and a vector."""
    return np.asarray(matrix.dot(vector))


# The order of sums does not matter, so that the compiler vectorises them.
@compiled_as(product, fastmath={"reassoc", "contract"})
def _product(matrix, vector):  # type: ignore[no-untyped-def]
    """Return the product of a small matrix and a vector, in a fraction of the time of a call to BLAS."""
    result = np.empty(len(matrix))
    for i in range(len(matrix)):
        total = 0.0
        for k in range(len(vector)):
            total += matrix[i, k] * vector[k]
        result[i] = total
    return result


@jit
def _largest(vector):  # type: ignore[no-untyped-def]
    return np.abs(vector).max() if len(vector) else 0.0


@jit
def _point(x, bend, t):  # type: ignore[no-untyped-def]
    """Return a point of a parabola from 0 to x, which is beside the chord by `bend` in its middle."""
    return t * x + 4.0 * t * (1.0 - t) * bend


@jit
def _derivative(u, g, w, v, a, b):  # type: ignore[no-untyped-def]
    """Return the derivative of exp(u t + g t² / 2 + w y + v z) at 0, a times by t and by the first b of y, z."""
    last, result = 0.0, 1.0
    for k in range(a):
        last, result = result, u * result + k * g * last
    return result if b == 0 else result * w if b == 1 else result * w * v


@jit
def _of_polynomial(tree, k, u, g, w, v, a, b):  # type: ignore[no-untyped-def]
    """Return the bound that `bounds` writes for a joint equality; its driver is at `drivers[k]` at the start."""
    driver = tree.equality_places[k, 3]
    if driver < 0:
        return 0.0
    unit, total, share = tree.units[driver], 0.0, 1.0
    rate, bend, beside, further = unit * u[driver], unit * g[driver], unit * w[driver], unit * v[driver]
    far = abs(tree.drivers[k]) + rate + further
    for twice in range(a // 2 + 1):
        # Faà di Bruno's formula for a polynomial of x(t), whose third derivative is zero.
        order, slope = a - twice + b, 0.0
        for power in range(tree.polynomials.shape[1] - 1, order - 1, -1):
            factor = abs(tree.polynomials[k, power])
            for i in range(order):
                factor *= power - i
            slope = slope * far + factor
        total += share * slope * rate ** (a - 2 * twice) * bend**twice
        share *= (a - 2 * twice) * (a - 2 * twice - 1) / (2.0 * (twice + 1))
    total *= 1.0 if b == 0 else beside if b == 1 else beside * further
    return total / tree.row_units[len(tree.forms) + k]


@jit
def _bounds(tree, levers, path, w, a, b, reach, found):  # type: ignore[no-untyped-def]
    """Write bounds (n,) of derivatives of positions, angles and equalities: a times by t, by the first b of w.

    `path` (2, nv) has u and g, `w` (2, nv) displacements beside the curve. Levers are those at a share `reach` of
    the curve, and at the second w, from where bounds are to hold.
    """
    u, g, w, v, loops = path[0], path[1], w[0], w[1], len(tree.first_rows)
    for k in range(loops):
        total, motion, all_u, all_g, all_w, all_v = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if k == tree.pose:
            # A pose to be reached turns like one joint more; it does not move the frame's place.
            all_u = tree.pose_turn[0] * tree.pose_share[0]
        before = _derivative(all_u, all_g, all_w, all_v, a, b)
        for place in range(tree.first_columns[k], tree.first_columns[k + 1]):
            j = tree.loop_columns[place]
            turn, lever = tree.turns[k, j], levers[k, j]
            if turn > 0.0:
                motion += lever * turn * (reach * u[j] + v[j])
                all_u, all_g = all_u + turn * u[j], all_g + turn * g[j]
                all_w, all_v = all_w + turn * w[j], all_v + turn * v[j]
                after = _derivative(all_u, all_g, all_w, all_v, a, b)
                total += lever * (after - before)
                before = after
            else:
                # Without a turn before, a slide has no part in higher derivatives.
                motion += lever * (reach * u[j] + v[j])
                if a > 0:
                    total += lever * a * _derivative(all_u, all_g, all_w, all_v, a - 1, b) * u[j]
                if a > 1:
                    total += lever * (a * (a - 1) // 2) * _derivative(all_u, all_g, all_w, all_v, a - 2, b) * g[j]
                if b == 1:
                    total += lever * _derivative(all_u, all_g, all_w, all_v, a, 0) * w[j]
                if b == 2:
                    total += lever * _derivative(all_u, all_g, all_w, all_v, a, 0) * (w[j] * all_v + v[j] * all_w)
        found[k] = total + math.exp(min(reach * all_u + all_v, 9.0)) * motion * before
        found[loops + k] = before
    for k in range(len(tree.zeros)):
        found[2 * loops + k] = _of_polynomial(tree, k, u, g, w, v, a, b)


@jit
def _sizes_of(tree, inverse):  # type: ignore[no-untyped-def]
    """Return sizes (p, n) of the parts of A that multiply positions and angles of closures, and equalities."""
    count, loops = len(tree.columns), len(tree.first_rows)
    sizes = np.zeros((count, 2 * loops + len(tree.zeros)))
    for i in range(count):
        for k in range(loops):
            first, squares = tree.first_rows[k], 0.0
            between = first + tree.position_counts[k]
            for row in range(first, between):
                squares += inverse[i, row] * inverse[i, row]
            sizes[i, k] = math.sqrt(squares)
            for row in range(between, first + tree.row_counts[k]):
                sizes[i, loops + k] += abs(inverse[i, row])
        for k in range(len(tree.zeros)):
            sizes[i, 2 * loops + k] = abs(inverse[i, len(tree.forms) + k])
    return sizes


@jit
def _box(tree, sizes, levers, path, eta, change, weight, power, reach, off):  # type: ignore[no-untyped-def]
    """Return whether some radii satisfy the inequality, and by which factor a step may be longer or be shorter.

    `change` bounds |A J - 1| on the curve, beside what `weight` times derivatives, `power` times by t, add; it is
    empty where A J = 1. J and levers are those at a distance of up to `off` from there.
    """
    w, radii = np.zeros(path.shape), 1.5 * eta + 0.01 * eta.max()
    fits, last, first, second = False, np.inf, 0.0, 0.0
    bound = np.empty(sizes.shape[1])
    for _ in range(MOST_BOXES):
        for i in range(len(radii)):
            w[0, tree.columns[i]], w[1, tree.columns[i]] = radii[i], radii[i] + off
        _bounds(tree, levers, path, w, power, 1, reach, bound)
        linear = product(sizes, bound)
        linear *= weight
        if len(change) > 0:
            linear += product(change, radii)
        _bounds(tree, levers, path, w, 0, 2, reach, bound)
        square = product(sizes, bound)
        used, widest = 0.0, 0.0
        for i in range(len(radii)):
            total = eta[i] + linear[i] + square[i]
            widest = max(widest, total)
            # NaN stays.
            if used == used and not total <= used * radii[i]:
                # Linear and quadratic part in the length of the step, of the row with the least margin.
                used, first, second = total / radii[i], linear[i] / radii[i], square[i] / radii[i] + 1e-9
            linear[i] = 1.2 * total
        fits = used <= 1.0
        if fits or not used < last or not widest < HOPELESS:
            break
        last, radii = used, linear
    return fits, 1.2 / (first + math.sqrt(first * first + 2.4 * second))


@jit
def _safety(tree, q, done, end, x, size, jacobian, at_start, at_end, inverse, levers, off):  # type: ignore[no-untyped-def]
    """Return whether a step is safe, and the factor of the next one.

    J is of places at a distance of up to `off`, dimensionless, from the start and the end of the step.
    """
    count = len(tree.columns)
    path, w = np.zeros((2, len(tree.driven_rates))), np.zeros((2, len(tree.driven_rates)))
    path[0] = np.abs(tree.driven_rates) * (end - done)
    tree.pose_share[0] = end - done
    for i in range(count):
        path[0, tree.columns[i]], w[1, tree.columns[i]] = abs(x[i]), off
    for k in range(len(tree.zeros)):
        place = tree.equality_places[k, 2]
        tree.drivers[k] = q[place] - tree.zeros[k, 1] if place >= 0 else 0.0
    bound = np.empty(2 * len(tree.first_rows) + len(tree.zeros))
    if size <= SHORT:
        sizes = _sizes_of(tree, inverse)
        _bounds(tree, levers, path, w, 2, 0, 1.0, bound)
        eta = 0.125 * product(sizes, bound) + ROUNDING
        fits, factor = _box(tree, sizes, levers, path, eta, np.empty((0, 0)), 1.0, 1, 1.0, off)
        if fits:
            return fits, factor
    half, mean = 0.5 * (done + end), 0.5 * (at_start + inverse)
    bend = -product(mean, residual(tree, moved(tree, q, half, 0.5 * x), half))
    for i in range(count):
        path[0, tree.columns[i]] += 4.0 * abs(bend[i])
        path[1, tree.columns[i]] = 8.0 * abs(bend[i])
    c, middle, levers = linearised(tree, moved(tree, q, half, _point(x, bend, 0.5)), half)
    errors = np.abs(product(mean, c))
    for t in (0.25, 0.75):
        s = done + t * (end - done)
        along = product(mean, residual(tree, moved(tree, q, s, _point(x, bend, t)), s))
        errors = np.maximum(errors, np.abs(along))
    sizes = _sizes_of(tree, mean)
    _bounds(tree, levers, path, w, 5, 0, 0.5, bound)
    eta = INNER * errors + QUINTIC * product(sizes, bound) + ROUNDING
    first, between, last = mean @ jacobian, mean @ middle, mean @ at_end
    for i in range(count):
        first[i, i] -= 1.0
        between[i, i] -= 1.0
        last[i, i] -= 1.0
    change = np.maximum(np.abs(first), np.abs(last)) + np.abs(between)
    return _box(tree, sizes, levers, path, eta, change, CUBIC, 3, 0.5, off)


@jit
def _step(tree, q, done, end, jacobian, inverse, off):  # type: ignore[no-untyped-def]
    """Return whether a step is safe, q, J, A and their distance at its end, its size, and the next one's factor."""
    x = np.zeros(len(tree.columns))
    tried = moved(tree, q, end, x)
    change = -product(inverse, residual(tree, tried, end))
    size = _largest(change)
    if not size <= LONGEST:
        return False, q, jacobian, inverse, off, size, 0.5 * LONGEST / size
    # A whole turn of a driven joint changes no other, and is a long step all the same.
    extent = max(size, (end - done) * max(_largest(tree.driven_rates), tree.pose_turn[0]))
    x += change
    tried, last = moved(tree, tried, end, change), max(size, 1e-300)
    if size > SHORT:
        change = -product(inverse, residual(tree, tried, end))
        if not _largest(change) <= 0.5 * size:
            return False, q, jacobian, inverse, off, extent, 0.5
        x += change
        tried = moved(tree, tried, end, change)
    c, at_end, levers = linearised(tree, tried, end)
    new, regular = left_inverse(at_end)
    if not regular:
        return False, q, jacobian, inverse, off, extent, 0.5
    converged, away = False, 0.0
    for _ in range(MOST_CORRECTIONS):
        change = -product(new, c)
        correction = _largest(change)
        shrinks = correction <= 0.5 * last
        if not (shrinks or correction <= NOISE):
            break
        x += change
        away += correction
        tried = moved(tree, tried, end, change)
        # The next correction is smaller by as much again: below rounding it is left out.
        if not shrinks or correction * min(1.0, correction / last) <= ROUNDING:
            c += product(at_end, change)
            converged = _largest(c) <= CLOSED
            break
        last = max(correction, 1e-300)
        if correction > FAR:
            c, at_end, levers = linearised(tree, tried, end)
            new, regular = left_inverse(at_end)
            if not regular:
                break
            away = 0.0
        else:
            c = residual(tree, tried, end)
    if not converged:
        return False, q, jacobian, inverse, off, extent, 0.5
    if extent <= NOISE or len(x) == 0:
        return True, tried, at_end, new, away, extent, 4.0
    safe, factor = _safety(tree, q, done, end, x, size, jacobian, inverse, at_end, new, levers, max(off, away))
    return safe, tried, at_end, new, away, extent, factor


@jit
def _go_on(tree, q, jacobian, inverse, off):  # type: ignore[no-untyped-def]
    """Return q, J, A, the distance of J and A from q, the status, the share reached and the number of steps.

    J and A at the start are known, at a distance of up to `off`. Those returned can begin the next path.
    """
    done, share, steps = 0.0, 1.0, 0
    while done < 1.0:
        if tree.steps_left[0] == 0:
            return q, jacobian, inverse, off, UNFINISHED, done, steps
        tree.steps_left[0] -= 1
        end = done + share
        if end > 1.0 - 1e-12:
            end = 1.0
        accepted, reached, at_end, new, away, size, factor = _step(tree, q, done, end, jacobian, inverse, off)
        steps += 1
        if accepted:
            q, jacobian, inverse, off, done = reached, at_end, new, away, end
            share *= max(0.5, min(4.0, factor))
            continue
        share *= max(0.1, min(0.7, factor)) if factor == factor else 0.1
        if share < SHORTEST_SHARE or size < SHORTEST_STEP:
            return q, jacobian, inverse, off, NO_FURTHER, done, steps
    return q, jacobian, inverse, off, DONE, done, steps


@jit
def _begin(tree, q):  # type: ignore[no-untyped-def]
    """Return the status of a start, and J and A there."""
    c, jacobian, _ = linearised(tree, q, 0.0)
    inverse, regular = left_inverse(jacobian)
    if not _largest(c) <= ROUNDED:
        return OPEN_START, jacobian, inverse
    return DONE if regular else SINGULAR_START, jacobian, inverse


def _run(tree, starts, targets, is_path, results):  # type: ignore[no-untyped-def]
    """Write q of all targets; return the number of those reached, and the status, share and steps of the last path."""
    q, off, jacobian = starts[0], 0.0, np.empty((0, 0))
    inverse = jacobian
    for k in range(len(targets)):
        if not is_path:
            q = starts[k]
        aim(tree, q, targets[k])
        if k == 0 or tree.pose >= 0 or not (is_path or (q == starts[k - 1]).all()):
            status, jacobian, inverse = _begin(tree, q)
            off = 0.0
            if status != DONE:
                results[k] = q
                return k, status, 0.0, 0
        q, at_end, new, away, status, done, steps = _go_on(tree, q, jacobian, inverse, off)
        results[k] = q
        if status != DONE:
            return k, status, done, steps
        if is_path:
            jacobian, inverse, off = at_end, new, away
    return len(targets), DONE, 1.0, 0


run = Kernel(_run, str(tree_kernel.__file__), __file__)
