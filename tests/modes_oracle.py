"""All ways to place a triangle on three circles, by another elimination with a hundred digits."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt
from flint import acb, acb_poly, arb, ctx

Array = npt.NDArray[Any]


def real_modes(axes: Array, centres: Array, balls: Array, radii: Array) -> Array:
    """Balls (n, 3, 3) of all real modes of three circles, with a hundred digits and python-flint's roots.

    `balls` (3, 3) are in the platform's frame.

    Unknown is the tangent of half the first leg's angle. The other two angles follow from the sides 12 and 31, each in
    two ways, and the side 23 of the four pairs multiplied is interpolated from 33 points of a circle.
    """
    with ctx.workdps(100):
        rows = lambda array: [[arb(float(x)) for x in row] for row in array]  # noqa: E731
        axes, pivots, balls = rows(axes), rows(centres), rows(balls)
        dot = lambda a, b: sum((x * y for x, y in zip(a, b, strict=True)), arb(0))  # noqa: E731
        cross = lambda a, b: [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]  # noqa: E731
        frames = []
        for axis, length in zip(axes, radii, strict=True):
            up = cross(axis, [arb(1) / 3, arb(2) / 7, arb(1)])  # any direction serves as angle zero
            size, reach = dot(up, up).sqrt(), arb(float(length)) / dot(axis, axis).sqrt()
            p = [x / size * arb(float(length)) for x in up]
            frames.append((p, [x * reach / arb(float(length)) for x in cross(axis, p)]))

        def ball(i, c, s):
            p, q = frames[i]
            return [pivots[i][k] + c * p[k] + s * q[k] for k in range(3)]

        def gap(a, b, i, j):
            side = [x - y for x, y in zip(balls[i], balls[j], strict=True)]
            apart = [x - y for x, y in zip(a, b, strict=True)]
            return sum((x * x for x in apart), acb(0)) - dot(side, side)

        def angles(b, i, j):
            """Pairs (cos, sin) of leg j that fit the ball b of leg i."""
            zero = gap(b, ball(j, 0, 0), i, j)
            p, q = frames[j]
            n = zero + dot(p, p)
            a, c = (
                -2 * sum(((x - y) * z for x, y, z in zip(b, pivots[j], way, strict=True)), acb(0)) for way in (p, q)
            )
            m = a * a + c * c
            w = (m - n * n).sqrt()
            return [((-n * a - sign * c * w) / m, (-n * c + sign * a * w) / m) for sign in (1, -1)]

        def product(z):
            c, s = (z + 1 / z) / 2, (z - 1 / z) / acb(0, 2)
            b = ball(0, c, s)
            total = acb(1)
            for second, third in itertools.product(angles(b, 0, 1), angles(b, 0, 2)):
                total *= gap(ball(1, *second), ball(2, *third), 1, 2)
            for j in (1, 2):
                p, q = frames[j]
                a, e = (sum(((x - y) * v for x, y, v in zip(b, pivots[j], way, strict=True)), acb(0)) for way in (p, q))
                total *= (a * a + e * e) ** 2
            return total * z**8

        points = [(acb(2 * k) / 33).exp_pi_i() * acb(9) / 8 for k in range(33)]
        values = [product(z) for z in points]
        coefficients = [
            sum((v * z ** (-j) for v, z in zip(values, points, strict=True)), acb(0)) / 33 for j in range(33)
        ]
        scale = max(float(abs(x).mid()) for x in coefficients)
        assert all(float(abs(x).mid()) < 1e-25 * scale for x in coefficients[17:]), "the degree is 16"
        found = []
        for z in acb_poly([acb(x.real.mid(), x.imag.mid()) for x in coefficients[:17]]).roots(tol=1e-40):
            if abs(float(abs(z).mid()) - 1.0) > 1e-12:
                continue
            c, s = arb(z.real.mid()), arb(z.imag.mid())
            b = ball(0, c, s)
            pairs = itertools.product(angles(b, 0, 1), angles(b, 0, 2))
            errors = [
                (float(abs(gap(ball(1, *x), ball(2, *y), 1, 2)).mid()), ball(1, *x), ball(2, *y)) for x, y in pairs
            ]
            error, second, third = min(errors, key=lambda x: x[0])
            assert error < 1e-15
            found.append([[float(acb(x).real.mid()) for x in point] for point in (b, second, third)])
        return np.array(found).reshape(-1, 3, 3)
