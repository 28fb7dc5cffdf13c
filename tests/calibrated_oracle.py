"""All branches of a machine as built, certified in ball arithmetic (python-flint), from the loop equations themselves.

Unknown are the nine coordinates of the lower legs' balls, the equations are the six leg planes and the three distances;
the package's quaternions, quadrics and elimination take no part. Krawczyk's test proves a root near each answer, and
the only one there. Eight such regions without common points hold all roots, for no isolated ones are more than eight:
the planes are linear in the position, which leaves three quadrics in the quaternion.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from flint import acb, acb_mat, arb, arb_mat, ctx
from oracle import cross, dot

import spm_pin as spm

Matrix = list[list[Any]]


def certified_real_branches(
    machine: spm.Manipulator,
    rotation: npt.NDArray[np.float64],
    position: npt.NDArray[np.float64],
    joints: npt.NDArray[np.complex128],
) -> int | None:
    """Return how many roots of a pose are real if the answers (8, 3, 3) are proved to be all of them, else None."""
    ctx.prec = 160
    planes = _planes(machine, rotation, position)
    weights = _weights(machine)
    sides = [_squared(machine.legs.balls[i], machine.legs.balls[(i + 1) % 3]) for i in range(3)]
    regions = []
    for answer in joints:
        region = _proved(answer.reshape(9), planes, weights, sides)
        if region is None:
            return None
        regions.append(region)
    for i, first in enumerate(regions):
        for second in regions[:i]:
            if all(a.overlaps(b) for a, b in zip(first, second, strict=True)):
                return None
    real = 0
    for answer, region in zip(joints, regions, strict=True):
        if (answer.imag == 0.0).all():
            # The region is its own mirror image, so the only root in it is.
            real += 1
        elif all(coordinate.imag.contains(0) for coordinate in region):
            return None
    return real


def _planes(machine: spm.Manipulator, rotation: Any, position: Any) -> list[tuple[list[Any], Any]]:
    """Return normal and height of the six planes, the given floats taken as exact."""
    found = []
    for i in range(6):
        normal = [arb(float(c)) for c in machine.legs.axes[i]]
        pivot = [arb(float(c)) for c in machine.legs.pivots[i]]
        if i >= 3:
            rows = [[arb(c) for c in row] for row in rotation]
            normal = [dot(row, normal) for row in rows]
            pivot = [dot(row, pivot) + arb(o) for row, o in zip(rows, position, strict=True)]
        found.append((normal, dot(normal, pivot)))
    return found


def _squared(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> Any:
    gap = [arb(float(x)) - arb(float(y)) for x, y in zip(a, b, strict=True)]
    return dot(gap, gap)


def _weights(machine: spm.Manipulator) -> Matrix:
    """Return the upper balls in the basis of two sides of the lower triangle and their cross product, (3, 3)."""
    balls = [[arb(float(c)) for c in ball] for ball in machine.legs.balls]
    e = [[a - b for a, b in zip(balls[k], balls[0], strict=True)] for k in (1, 2)]
    basis = [*e, cross(e[0], e[1])]
    matrix = arb_mat(3, 3, [basis[j][i] for i in range(3) for j in range(3)])
    right = arb_mat(3, 3, [balls[3 + j][i] - balls[0][i] for i in range(3) for j in range(3)])
    solved = matrix.solve(right)
    return [[solved[i, j] for i in range(3)] for j in range(3)]


def _equations(x: list[Any], planes: list[Any], weights: Matrix, sides: list[Any]) -> tuple[list[Any], Matrix]:
    """Return the nine equations and their derivatives."""
    b = [x[0:3], x[3:6], x[6:9]]
    zero = acb(0)
    values, rows = [], []
    for i in range(3):
        normal, height = planes[i]
        values.append(dot(normal, b[i]) - height)
        rows.append([normal[c] if k == i else zero for k in range(3) for c in range(3)])
    first = [b[1][c] - b[0][c] for c in range(3)]
    second = [b[2][c] - b[0][c] for c in range(3)]
    across = cross(first, second)
    for i in range(3):
        normal, height = planes[3 + i]
        u, v, w = weights[i]
        ball = [b[0][c] + u * first[c] + v * second[c] + w * across[c] for c in range(3)]
        values.append(dot(normal, ball) - height)
        # n · (δ1 x e2 + e1 x δ2) = δ1 · (e2 x n) + δ2 · (n x e1)
        by_first = [u * normal[c] + w * y for c, y in enumerate(cross(second, normal))]
        by_second = [v * normal[c] + w * y for c, y in enumerate(cross(normal, first))]
        rows.append([*(normal[c] - by_first[c] - by_second[c] for c in range(3)), *by_first, *by_second])
    for i in range(3):
        j = (i + 1) % 3
        gap = [b[i][c] - b[j][c] for c in range(3)]
        values.append(dot(gap, gap) - sides[i])
        row = [zero] * 9
        for c in range(3):
            row[3 * i + c], row[3 * j + c] = 2 * gap[c], -2 * gap[c]
        rows.append(row)
    return values, rows


def _proved(
    answer: npt.NDArray[np.complex128], planes: list[Any], weights: Matrix, sides: list[Any]
) -> list[Any] | None:
    """Return a region with exactly one root, around an answer; None if Krawczyk's test fails."""
    middle = [acb(float(z.real), float(z.imag)) for z in answer]
    real = bool((answer.imag == 0.0).all())
    values, rows = _equations(middle, planes, weights, sides)
    inverse = acb_mat(9, 9, [entry for row in rows for entry in row]).inv()
    # The midpoints alone: exact, and as near to the inverse as needed.
    inverse = acb_mat(
        9, 9, [acb(inverse[i, j].real.mid(), inverse[i, j].imag.mid()) for i in range(9) for j in range(9)]
    )
    step = inverse * acb_mat(9, 1, values)
    size = max(float(abs(step[i, 0]).mid()) for i in range(9))
    unit = max(float(side.mid()) for side in sides) ** 0.5
    for radius in (4.0 * size + 1e-18 * unit, 1e-13 * unit, 1e-11 * unit, 1e-9 * unit):
        if radius < 2.0 * size:
            continue
        ball = arb(0, radius)
        box = [z + acb(ball, 0 if real else ball) for z in middle]
        _, slopes = _equations(box, planes, weights, sides)
        spread = acb_mat([[acb(1 if i == j else 0) for j in range(9)] for i in range(9)]) - inverse * acb_mat(slopes)
        image = spread * acb_mat(9, 1, [acb(ball, 0 if real else ball)] * 9)
        inside = all(
            abs((image[i, 0] - step[i, 0]).real).upper() < radius
            and (real or abs((image[i, 0] - step[i, 0]).imag).upper() < radius)
            for i in range(9)
        )
        if inside:
            return box
    return None


def root_near(machine: spm.Manipulator, rotation: Any, position: Any, joints: npt.NDArray[np.float64]) -> list[arb]:
    """Return the nine coordinates that Newton's method with 160 bits leads to, for a pose of floats or of balls."""
    ctx.prec = 160
    planes, weights = _planes(machine, rotation, position), _weights(machine)
    sides = [_squared(machine.legs.balls[i], machine.legs.balls[(i + 1) % 3]) for i in range(3)]
    x, size = [acb(float(c)) for c in joints.reshape(9)], 1.0
    for _ in range(8):
        values, rows = _equations(x, planes, weights, sides)
        inverse = acb_mat(9, 9, [entry for row in rows for entry in row]).inv()
        step = inverse * acb_mat(9, 1, values)
        size = max(float(abs(step[i, 0]).mid()) for i in range(9))
        x = [acb((x[i] - step[i, 0]).real.mid()) for i in range(9)]
    assert size < 1e-30, "Newton's method has not converged"
    return [z.real for z in x]


def distance_to_root(
    machine: spm.Manipulator,
    rotation: npt.NDArray[np.float64],
    position: npt.NDArray[np.float64],
    joints: npt.NDArray[np.float64],
) -> float:
    """Return the largest distance [m] of a joint from that of the root that it leads to."""
    root = root_near(machine, rotation, position, joints)
    gaps = [float((a - float(b)).mid()) for a, b in zip(root, joints.reshape(9), strict=True)]
    return float(np.linalg.norm(np.reshape(gaps, (3, 3)), axis=-1).max())
