"""Formulas: the same functions on many kinds of numbers, and derivatives against complex steps and differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import flint
import mpmath
import numpy as np
import pytest

import spm_pin as spm
from spm_pin.formulas import branches, circles, leg_planes, stages, vectors, wrenches
from spm_pin.formulas.operations import bind
from spm_pin.kinematics.intervals import Interval

PAPER = spm.Manipulator.paper()
MACHINE = PAPER.perturbed(3, length=1e-2, angle=1e-2)
R, E, C = PAPER.middle_radius, PAPER.base_radius, PAPER.platform_radius
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88])).as_matrix()
BRANCHES = spm.inverse_displacement(PAPER, POSE)
STATE = spm.inverse_physical(PAPER, POSE)
EPS = np.finfo(float).eps


def rows(matrix: Any) -> Any:
    return tuple(map(tuple, np.asarray(matrix).tolist()))


def flat(value: Any) -> list[Any]:
    return [x for item in value for x in flat(item)] if isinstance(value, tuple) else [value]


def mapped(convert: Callable[[float], Any], value: Any) -> Any:
    if not isinstance(value, tuple):
        return convert(value)
    items = [mapped(convert, item) for item in value]
    return type(value)(*items) if hasattr(value, "_fields") else tuple(items)


@dataclass
class Runner:
    """A kind of number: how formulas are run on it, and how it is made of a float and read."""

    run: Callable[..., Any]
    convert: Callable[[float], Any]
    read: Callable[[Any], float]


def interpreted(**own: Any) -> Callable[..., Any]:
    return lambda formula, *arguments: bind(formula, **own)(*arguments)


def of_casadi(formula: Any, *arguments: Any) -> Any:
    """Trace a formula with symbols, then evaluate it."""
    numbers = [float(x) for x in flat(arguments)]
    symbols = iter(ca.vertsplit(ca.SX.sym("x", len(numbers))))
    inputs = mapped(lambda _: next(symbols), arguments)
    own = {"sqrt": ca.sqrt, "where": ca.if_else, "both": ca.logic_and, "either": ca.logic_or}
    result = bind(formula, **own)(*inputs)
    outputs = ca.Function("f", [ca.vertcat(*flat(inputs))], [ca.vertcat(*flat(result))])(numbers)
    values = iter(np.asarray(outputs).ravel().tolist())
    return mapped(lambda _: next(values), result)


# Compiled, they run in the kernels: `test_compiling.py` compares those with the interpreter, bit by bit.
RUNNERS = {
    "float": Runner(lambda formula, *arguments: formula(*arguments), float, float),
    "NumPy": Runner(
        interpreted(where=np.where, both=np.logical_and, either=np.logical_or),
        lambda x: np.full(2, x),
        lambda x: float(x[1]),
    ),
    "CasADi": Runner(of_casadi, float, float),
    "mpmath": Runner(interpreted(sqrt=mpmath.sqrt, COS_30=mpmath.sqrt(3) / 2), mpmath.mpf, float),
    "arb": Runner(interpreted(sqrt=lambda x: x.sqrt(), COS_30=flint.arb(3).sqrt() / 2), flint.arb, float),
}
PHYSICAL = 0  # TT+, of the pose above


@pytest.mark.parametrize("name", RUNNERS)
def test_all_branches_on_every_kind_of_number(name: str) -> None:
    runner = RUNNERS[name]
    rotation, position = mapped(runner.convert, rows(POSE[:3, :3])), mapped(runner.convert, tuple(POSE[:3, 3].tolist()))
    r, e, c = map(runner.convert, (R, E, C))
    frame = runner.run(branches.pose_frame, rotation, position, r)
    corners = runner.run(branches.platform_corners, rotation, position, c)
    families = runner.run(branches.families, frame, r)
    discriminants = [runner.run(branches.discriminant, family) for family in families]
    np.testing.assert_allclose([runner.read(x) / R**2 for x in discriminants], BRANCHES.discriminants, rtol=1e-12)
    for k in np.flatnonzero(BRANCHES.exists):
        family = families[k // 2]
        sign, square_root = runner.convert(1.0 - 2.0 * (k % 2)), math.sqrt(runner.read(discriminants[k // 2]))
        u, v, square = runner.run(branches.root, family, sign, runner.convert(square_root))
        radii, heights = runner.run(branches.middle_joints, u, v, r / square, family, frame, position)
        b = [runner.read(x) for x in flat(runner.run(stages.cartesian, radii, heights))]
        np.testing.assert_allclose(b, BRANCHES.middle_joints[k].ravel(), rtol=0, atol=1e-13)
        lengths = runner.run(branches.leg_lengths, radii, heights, corners, e)
        np.testing.assert_allclose([runner.read(x) for x in lengths], BRANCHES.leg_lengths[k], rtol=1e-12)
        if k < 2:
            home, _ = runner.run(branches.stands_at_home, radii, heights, rotation, position, e, c)
            assert bool(runner.read(home)) == (k == PHYSICAL)


LENGTHS = (1.2, 1.25, 1.4)
NEAR_STATE = (0.97, 0.1, np.sqrt(1.0 - 0.97**2 - 0.01), 1.3)


@pytest.mark.parametrize("name", [name for name in RUNNERS if name != "float"])
def test_a_stage_on_every_kind_of_number(name: str) -> None:
    def newton(runner: Runner) -> list[float]:
        lengths, state = mapped(runner.convert, LENGTHS), mapped(runner.convert, NEAR_STATE)
        stage = runner.run(stages.stage_equations, *lengths, runner.convert(E / R))
        columns, singular = runner.run(stages.inverse, runner.run(stages.jacobian, stage, state))
        assert not runner.read(singular)
        step = runner.run(vectors.weighted, runner.run(stages.residual, stage, state), columns)
        near = runner.run(stages.moved, state, runner.run(stages.damped, step, runner.convert(0.3)))
        by_legs = runner.run(stages.residual_by_legs, stage, state)
        return [runner.read(x) for x in flat((near, by_legs))]

    np.testing.assert_allclose(newton(RUNNERS[name]), newton(RUNNERS["float"]), rtol=1e-13)


def test_the_residual_of_a_stage_has_its_derivatives_and_vanishes_at_a_solution() -> None:
    lengths = tuple((STATE.leg_lengths[:3] / R).tolist())
    stage = stages.stage_equations(*lengths, E / R)
    # Each derivative is that along a complex step.
    rows_of_derivatives = np.array(stages.derivatives(stage, NEAR_STATE))
    for k in range(4):
        moved = tuple(x + 1e-30j * (j == k) for j, x in enumerate(NEAR_STATE))
        np.testing.assert_allclose(
            np.imag(stages.residual(stage, moved)) / 1e-30, rows_of_derivatives[:, k], rtol=1e-13
        )
    along = np.array(stages.jacobian(stage, NEAR_STATE))
    h = 1e-6
    for k in range(3):
        steps = [tuple(sign * h * (j == k) for j in range(3)) for sign in (1.0, -1.0)]
        ahead, behind = (np.array(stages.residual(stage, stages.moved(NEAR_STATE, step))) for step in steps)
        np.testing.assert_allclose((ahead - behind) / (2 * h), along[:, k], atol=1e-8)
    np.testing.assert_allclose(
        stages.residual(stage, NEAR_STATE), stages.residual_by_legs(stage, NEAR_STATE), rtol=0, atol=16 * EPS
    )
    # The state of the configuration above, from its middle platform.
    x, y, z, w = STATE.middle_pose.rotation.as_quat()
    height = STATE.middle_joints[:, 2].mean() / R
    solution = (w, x, y, height)
    assert abs(z) < 4 * EPS
    assert np.abs(stages.residual(stage, solution)).max() < 32 * EPS
    radii, heights = stages.corners(w, x, y, 0.0, height)
    np.testing.assert_allclose(R * np.array(stages.cartesian(radii, heights)), STATE.middle_joints, atol=8 * EPS)


def test_the_aspect_of_general_legs_is_that_of_a_drawn_stage() -> None:
    solutions = spm.forward_displacement(PAPER, STATE.leg_lengths)
    # The axis of leg 1 has the other sense; the upper stage is a lower one upside down.
    tangents = np.array([[-1.0], [1.0], [1.0], [1.0], [-1.0], [-1.0]])
    outcomes = set()
    for state in solutions.configurations[solutions.exists]:
        legs, axes = state.balls - state.leg_bases, tangents * state.leg_axes
        stages_of = [(rows(state.balls[s]), rows(legs[s]), rows(axes[s])) for s in (slice(0, 3), slice(3, 6))]
        general = tuple(
            stages.is_home_aspect(wrenches.pairs(b, vectors.crosses(leg, axis))) for b, leg, axis in stages_of
        )
        b = rows(state.middle_joints)
        below = branches.seen_from_platform(b, rows(state.rotation), tuple(state.translation.tolist()))
        known = stages.in_home_aspect(*map(tuple, plane_coordinates(state)), E), stages.in_home_aspect(*below, C)
        assert general == known
        outcomes.add(general)
    assert len(outcomes) == 4


def plane_coordinates(state: spm.Configuration) -> tuple[list[float], list[float]]:
    joints = state.middle_joints
    return (joints * PAPER.radial_directions).sum(axis=-1).tolist(), joints[:, 2].tolist()


def test_intervals_hold_what_floats_give() -> None:
    widths = np.array([1e-3, 0.1])

    def box(x: float) -> Interval:
        return Interval(x - widths, x + widths)

    own = {"sqrt": Interval.root}
    radii, heights = (tuple(x) for x in plane_coordinates(STATE))
    exact = stages.pair_determinant(stages.stage_pairs(radii, heights, E))
    boxes = mapped(box, (radii, heights))
    bound = bind(stages.pair_determinant, **own)(bind(stages.stage_pairs, **own)(*boxes, E))
    assert ((bound.low < exact) & (exact < bound.high)).all()
    assert bound.low[0] > 0.0


def test_a_bound_formula_leaves_the_formula_as_it_is() -> None:
    many = bind(vectors.direction, sqrt=mpmath.sqrt)
    third = mpmath.mpf(1) / 3
    with mpmath.workdps(50):
        assert abs(vectors.dot(many((third, third, third)), many((third, third, third))) - 1) < 1e-48
    assert isinstance(vectors.direction((1.0, 2.0, 2.0))[0], float)


@pytest.mark.parametrize("name", RUNNERS)
def test_what_is_physical_on_every_kind_of_number(name: str) -> None:
    runner = RUNNERS[name]
    known = spm.inverse_physical(MACHINE, POSE)
    for k, state in enumerate([known, *spm.inverse_displacement(MACHINE, POSE).configurations]):
        if not state.exists:
            continue
        b, rotation = mapped(runner.convert, rows(state.middle_joints)), mapped(runner.convert, rows(state.rotation))
        physical = True
        centres, axes = state.own_circle_centres.reshape(2, 3, 3), MACHINE.legs.axes.reshape(2, 3, 3)
        for own, up in zip(zip(state.balls_of_stages, centres, axes, strict=True), MACHINE.legs.stage_ups, strict=True):
            stage = (mapped(runner.convert, rows(x)) for x in own)
            physical &= bool(runner.read(runner.run(circles.is_home_state, *stage, runner.convert(float(up)))))
        is_same = np.allclose(state.middle_joints, known.middle_joints, atol=1e-9)
        assert physical == (k == 0 or is_same)
        b1, b2, b3 = state.middle_joints
        normal = np.cross(b2 - b1, b3 - b1) / np.linalg.norm(np.cross(b2 - b1, b3 - b1))
        normal *= np.sign(normal @ state.middle_pose.as_matrix()[:3, 2])
        tilts = runner.read(runner.run(branches.tilt_cosine_sum, b, rotation))
        assert tilts == pytest.approx(normal[2] + normal @ state.rotation[:, 2], abs=1e-14)
    balls = MACHINE.legs.balls
    weights = runner.run(
        leg_planes.upper_ball_weights, *(mapped(runner.convert, rows(b)) for b in (balls[:3], balls[3:]))
    )
    sides = balls[1] - balls[0], balls[2] - balls[0]
    for weight, arm in zip(weights, balls[3:] - balls[:3], strict=True):
        numbers = [runner.read(x) for x in weight]
        np.testing.assert_allclose(numbers @ np.stack([*sides, np.cross(*sides)]), arm, rtol=0, atol=1e-16)


def test_the_slope_of_the_determinant_of_pairs() -> None:
    pairs, slopes = (tuple(x) for x in np.random.default_rng(0).normal(size=(2, 6)).tolist())

    def along(t: mpmath.mpf) -> mpmath.mpf:
        return stages.pair_determinant(tuple(c + t * slope for c, slope in zip(pairs, slopes, strict=True)))

    expected = mpmath.diff(along, 0)
    assert stages.pair_determinant_slope(pairs, slopes) == pytest.approx(float(expected), rel=1e-14)
