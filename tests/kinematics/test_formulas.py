"""Formulas: the same functions on many kinds of numbers, and derivatives and determinants against plain matrices."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import flint
import mpmath
import numba
import numpy as np
import pytest
from numba.extending import register_jitable
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.formulas import branches, joint_values, leg_planes, operations, stages, vectors, wrenches
from spm_pin.formulas.operations import bind
from spm_pin.kinematics.intervals import Interval
from spm_pin.mechanism.joint_angles import home_leans, home_lengths, joint_angles, leg_placements
from spm_pin.mechanism.legs import axis_directions, triangle_frames, upper_ball_weights

PAPER = spm.Geometry.paper()
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


COMPILED: dict[Any, Any] = {}


def of_numba(formula: Any, *arguments: Any) -> Any:
    """Compile a formula as the kernels do: what it calls is registered with Numba as it stands."""
    if not COMPILED:
        for module in (operations, vectors, stages, branches, wrenches, leg_planes, joint_values):
            for member in vars(module).values():
                if (
                    callable(member)
                    and getattr(member, "__module__", "") == module.__name__
                    and hasattr(member, "__code__")
                ):
                    register_jitable(error_model="numpy")(member)
    if formula not in COMPILED:
        COMPILED[formula] = numba.njit(error_model="numpy")(formula)
    return COMPILED[formula](*arguments)


RUNNERS = {
    "float": Runner(lambda formula, *arguments: formula(*arguments), float, float),
    "NumPy": Runner(
        interpreted(where=np.where, both=np.logical_and, either=np.logical_or),
        lambda x: np.full(2, x),
        lambda x: float(x[1]),
    ),
    "Numba": Runner(of_numba, float, float),
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


MACHINE = PAPER.perturbed(3, length=1e-2, angle=1e-2)
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


def stage_arrays(state: spm.Configuration) -> tuple[Any, ...]:
    """Return the balls, directions and axes of the lower and of the upper stage, and o."""
    directions = state.leg_vectors / state.leg_lengths[:, None]
    arrays = state.balls, directions, state.leg_axes
    return *(rows(a[:3]) for a in arrays), *(rows(a[3:]) for a in arrays), tuple(state.translation.tolist())


def force_rows(forces: np.ndarray, points: np.ndarray, o: np.ndarray) -> np.ndarray:
    return np.concatenate([forces, np.cross(points - o, forces)], axis=-1)


def matrix(twists: Any) -> np.ndarray:
    return np.array([[*linear, *angular] for linear, angular in twists])


@pytest.mark.parametrize("machine", [PAPER, MACHINE], ids=["drawn", "as built"])
def test_wrenches_are_those_of_the_matrices_of_six_forces(machine: spm.Geometry) -> None:
    state = spm.inverse_physical(machine, POSE)
    b, lower, a, c, upper, a_m, o = stage_arrays(state)
    j_b, j_c = (force_rows(np.array(f + s), np.array(p + p), o) for f, s, p in ((lower, a, b), (upper, a_m, c)))
    k = force_rows(np.array(a + a_m), np.array(b + c), o)
    np.testing.assert_allclose(wrenches.determinant(b, lower, a), np.linalg.det(j_b), rtol=1e-12)
    np.testing.assert_allclose(wrenches.determinant(c, upper, a_m), np.linalg.det(j_c), rtol=1e-12)
    carried = [tuple(wrenches.force_row(f, p, o) for f, p in zip(f, p, strict=True)) for f, p in ((a, b), (a_m, c))]
    np.testing.assert_allclose(wrenches.mixed_determinant(*carried), np.linalg.det(k), rtol=1e-10, atol=1e-15)
    twists = wrenches.stage_twists(b, lower, a, o), wrenches.stage_twists(c, upper, a_m, o)
    columns = np.linalg.inv(j_b)[:, :3].T, np.linalg.inv(j_c)[:, :3].T
    for found, expected in zip(twists, columns, strict=True):
        np.testing.assert_allclose(matrix(found), expected, atol=1e-13)
    jacobian = np.concatenate([matrix(m) for m in wrenches.inverse_jacobian(b, c, lower, upper, a, a_m, o)])
    np.testing.assert_allclose(jacobian @ np.concatenate(columns).T, np.eye(6), atol=1e-12)
    if machine is PAPER:
        drawn = wrenches.drawn_inverse_jacobian(b, lower, upper, a, a_m, o)
        np.testing.assert_allclose(np.concatenate([matrix(m) for m in drawn]), jacobian, atol=1e-12)
        in_stage = stages.stage_pairs(*(tuple(x) for x in plane_coordinates(state)), E)
        # The axis of leg 1 has the other sense.
        lengths = state.leg_lengths[[0, 1, 2, 1, 2, 0]] * [-1, 1, 1, 1, 1, -1]
        general = wrenches.pairs(b, wrenches.normals(lower, a))
        np.testing.assert_allclose(np.array(general) * lengths, in_stage, atol=1e-14)
    wrench = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    forces = [x for stage in twists for x in wrenches.stage_forces(stage, wrench)]
    np.testing.assert_allclose(forces, -np.concatenate(columns) @ [1, 2, 3, 4, 5, 6], atol=1e-12)


def test_the_aspect_of_general_legs_is_that_of_a_drawn_stage() -> None:
    solutions = spm.forward_displacement(PAPER, STATE.leg_lengths)
    # The axis of leg 1 has the other sense; the upper stage is a lower one upside down.
    tangents = np.array([[-1.0], [1.0], [1.0], [1.0], [-1.0], [-1.0]])
    outcomes = set()
    for state in solutions.configurations[solutions.exists]:
        vectors, axes = state.balls - state.leg_bases, tangents * state.leg_axes
        stages_of = [(rows(state.balls[s]), rows(vectors[s]), rows(axes[s])) for s in (slice(0, 3), slice(3, 6))]
        general = tuple(
            stages.is_home_aspect(wrenches.pairs(b, wrenches.normals(leg, axis))) for b, leg, axis in stages_of
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


@pytest.mark.parametrize("machine", [PAPER, MACHINE], ids=["drawn", "as built"])
def test_legs_are_carried_and_joint_values_turn_the_rods_into_the_platform(machine: spm.Geometry) -> None:
    state = spm.inverse_physical(machine, POSE)
    b, rotation, o = rows(state.middle_joints), rows(state.rotation), tuple(state.translation.tolist())
    upper = leg_planes.carried(
        leg_planes.StageLegs(rows(machine.legs.axes[3:]), rows(machine.legs.pivots[3:])), rotation, o
    )
    balls = leg_planes.upper_balls(b, rows(upper_ball_weights(machine.legs.balls)))
    np.testing.assert_allclose(np.concatenate([b, balls]), state.balls, atol=4 * EPS)
    np.testing.assert_allclose(upper.pivots, state.leg_bases[3:], atol=4 * EPS)
    np.testing.assert_allclose(upper.axes, state.leg_axes[3:], atol=4 * EPS)

    expected = joint_angles(state)
    axes = joint_values.triangle_axes(b)
    seen = tuple(tuple(state.rotation.T @ axis) for axis in axes)
    corner_axes = triangle_frames(machine.legs.balls[:3]).T @ np.stack(axis_directions(), axis=-1)
    placements, home = leg_placements(machine), home_leans(machine)
    for leg in range(6):
        frame = joint_values.LegFrame(
            rows(placements[leg, :3, :3].T),
            tuple(placements[leg, :3, :3].T @ placements[leg, :3, 3]),
            rows(corner_axes[leg].T),
            math.cos(home[leg]),
            math.sin(home[leg]),
            home_lengths(machine)[leg // 3],
        )
        ball = state.balls[leg] if leg < 3 else state.rotation.T @ (state.balls[leg] - state.translation)
        values = joint_values.leg_values(tuple(ball), frame)
        assert abs(values.plane_distance) < 1e-12
        angles = joint_values.ball_angles(values, frame, axes if leg < 3 else seen, 1.0 if leg < 3 else -1.0)
        found = [math.atan2(*values.hip), *(math.atan2(*angle) for angle in angles), values.slide]
        known = [getattr(expected, name)[leg] for name in ("hip", "ball_x", "ball_y", "ball_z", "slide")]
        np.testing.assert_allclose(found, known, atol=1e-12)


def test_the_quadrics_of_a_machine_as_built_vanish_at_its_configurations() -> None:
    solutions = spm.inverse_displacement(MACHINE, POSE)
    normals = np.concatenate([MACHINE.legs.axes[:3], MACHINE.legs.axes[3:] @ POSE[:3, :3].T])
    heights = (MACHINE.legs.axes * MACHINE.legs.pivots).sum(axis=-1)
    heights[3:] += normals[3:] @ POSE[:3, 3]
    null_space = np.linalg.svd(normals.T)[2][3:]
    planes = [
        leg_planes.StagePlanes(rows(normals[s]), tuple(heights[s]), rows(MACHINE.legs.balls[s]))
        for s in (slice(0, 3), slice(3, 6))
    ]
    for weights in null_space:
        form = leg_planes.quadric(tuple(weights[:3]), tuple(weights[3:]), *planes)
        xx, yy, zz, ww, xy, xz, yz, xw, yw, zw = form
        q = np.array([[xx, xy, xz, xw], [xy, yy, yz, yw], [xz, yz, zz, zw], [xw, yw, zw, ww]])
        for branch in np.flatnonzero(solutions.exists):
            x = solutions.configurations[branch].middle_pose.rotation.as_quat()
            assert abs(x @ q @ x) < 1e-12
    np.testing.assert_allclose(vectors.rotation_of(*x), Rotation.from_quat(x).as_matrix(), atol=4 * EPS)


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
