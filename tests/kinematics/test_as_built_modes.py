"""All assembly modes of machines as built: none missed, none extra, with the labels of the drawn machine."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from flint import acb, acb_poly, arb, ctx
from problems import PAPER, as_built

import spm_pin as spm


def real_modes(geometry: spm.Geometry, first: int, lengths: np.ndarray) -> np.ndarray:
    """Balls (n, 3, 3) of all real modes of a stage, with a hundred digits and python-flint's roots.

    Unknown is the tangent of half the first leg's angle. The other two angles follow from the sides 12 and 31, each in
    two ways, and the side 23 of the four pairs multiplied is interpolated from 33 points of a circle.
    """
    with ctx.workdps(100):
        legs = range(first, first + 3)
        rows = lambda array: [[arb(float(x)) for x in array[i]] for i in legs]  # noqa: E731
        axes, pivots, balls = rows(geometry.legs.axes), rows(geometry.legs.pivots), rows(geometry.legs.balls)
        dot = lambda a, b: sum((x * y for x, y in zip(a, b, strict=True)), arb(0))  # noqa: E731
        cross = lambda a, b: [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]  # noqa: E731
        frames = []
        for axis, length in zip(axes, lengths, strict=True):
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


@pytest.mark.parametrize("size", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize(
    "count",
    [3, pytest.param(60, marks=pytest.mark.slow)],
)
def test_all_modes_and_no_others(size: float, count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(count):
        dimensions = rng.uniform(0.2, 1.5, 2) * PAPER.middle_side
        drawn = spm.Geometry(*dimensions, PAPER.middle_side)
        machine = as_built(drawn, size, seed=int(rng.integers(1000))) if size else drawn
        reach = drawn.middle_radius + dimensions.repeat(3)
        lengths = reach * rng.uniform(0.6, 1.3) * (1.0 + 0.15 * rng.normal(size=6)).clip(0.3)
        modes = spm.forward_displacement(machine, lengths + machine.legs.offsets)
        assert modes.status is not spm.Status.UNSOLVED
        lower, upper = (real_modes(machine, first, lengths[first : first + 3]) for first in (0, 3))
        assert modes.count == len(lower) * len(upper)
        states = modes.configurations[modes.exists]
        seen = (states.balls[:, 3:] - states.translation[:, None]) @ states.rotation
        for found, expected in ((states.balls[:, :3], lower), (seen, upper)):
            gaps = np.abs(found[:, None] - expected).max(axis=(-1, -2))
            if gaps.size:
                assert gaps.min(axis=1).max() < 1e-9
                assert gaps.min(axis=0).max() < 1e-9


@pytest.mark.parametrize("size", [1e-5, 1e-3])
def test_labels_are_carried_while_the_errors_grow(size: float) -> None:
    """As in two hundred small steps from the drawn machine, each from a mode to the nearest."""
    machine = as_built(PAPER, size)
    lengths = np.random.default_rng(4).uniform(1.1, 1.5, (6, 6))
    modes = spm.forward_displacement(machine, lengths + machine.legs.offsets)
    before = spm.forward_displacement(PAPER, lengths)
    points, labelled = before.middle_joints, before.exists
    drawn, built = PAPER.legs, machine.legs
    for share in np.linspace(0.0, 1.0, 201)[1:]:
        axes = drawn.axes + share * (built.axes - drawn.axes)
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        arrays = (a + share * (b - a) for a, b in zip(drawn.arrays[1:3], built.arrays[1:3], strict=True))
        legs = spm.mechanism.Legs(axes, *arrays, np.zeros(6))
        between = spm.forward_displacement(spm.Geometry(*PAPER.dimensions, legs=legs), lengths)
        gaps = np.linalg.norm(between.middle_joints[:, None] - points[:, :, None], axis=-1).max(axis=-1)
        nearest = np.nan_to_num(gaps, nan=np.inf).argmin(axis=-1)
        moved = np.take_along_axis(between.middle_joints, nearest[..., None, None], axis=1)
        labelled &= np.linalg.norm(moved - points, axis=-1).max(axis=-1) < 0.05
        points = np.where(labelled[..., None, None], moved, np.nan)
    carried = modes.exists & ~modes.merged
    assert carried.mean() > 0.5
    np.testing.assert_allclose(modes.middle_joints[carried], points[carried], atol=1e-9)
    assert carried.sum() >= 0.99 * (labelled & modes.exists).sum()


def test_modes_of_a_machine_as_built_are_a_set_like_any_other() -> None:
    machine = as_built(PAPER, 1e-3)
    readings = np.random.default_rng(2).uniform(0.6, 2.0, (40, 6))
    modes, state = spm.forward_displacement(machine, readings), spm.forward_physical(machine, readings)
    assert not (modes.status == spm.Status.UNSOLVED).any()
    chosen = modes.physical()
    np.testing.assert_array_equal(chosen.exists, state.exists)
    assert 3 < state.exists.sum() < 37
    np.testing.assert_allclose(chosen.translation, state.translation, atol=1e-13)
    errors = np.abs(modes.readings - readings[:, None])[modes.exists]
    assert errors.max() < 1e-13
    assert np.nanmax(modes.residual) < 1e-14
    alone = spm.forward_displacement(machine, readings[0])
    np.testing.assert_array_equal(alone.middle_joints, modes[0].middle_joints)
    assert spm.forward_displacement(machine, [0.1] * 6).status is spm.Status.UNREACHABLE
    # Legs that are sixty times as long as the middle platform leave too few digits.
    far = spm.forward_displacement(machine, [50.0] * 6)
    assert far.status is spm.Status.UNSOLVED
    assert not far.exists.any()
