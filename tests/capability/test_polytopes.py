"""Polytopes of wrenches, twists and accelerations, against pycapacity, linear programming and Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from scipy.spatial import ConvexHull

import spm_pin as spm
from spm_pin.capability import acceleration_polytope, joint_reactions, velocity_polytope, wrench_polytope
from spm_pin.kinematics import platform_jacobian

PAPER = spm.Manipulator.paper()
MACHINE = PAPER.perturbed(2, length=0.01, angle=0.02)
LENGTHS = np.random.default_rng(0).uniform(1.15, 1.45, (100, 6))
STATES = spm.forward_physical(MACHINE, LENGTHS)
STATE = spm.forward_physical(PAPER, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
LOWER = np.array([-400.0, -500.0, -600.0, -700.0, -300.0, -450.0])
UPPER = np.array([900.0, 800.0, 750.0, 1000.0, 950.0, 850.0])
LIMITS = np.stack([LOWER, UPPER])
LOAD = np.array([10.0, -20.0, -90.0, 3.0, -2.0, 1.0])


def ordered(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(np.round(points, 6).T)]


@pytest.mark.parametrize("index", range(4))
def test_vertices_and_facets_are_those_of_pycapacity(index: int) -> None:
    pycapacity = pytest.importorskip("pycapacity.robot")
    state = STATES[index]
    g = platform_jacobian(state)
    # Its wrench is what the robot exerts: the opposite of the one it holds.
    held = wrench_polytope(state, LIMITS)
    expected = pycapacity.force_polytope(g, UPPER, LOWER).vertices
    size = np.abs(expected).max()
    np.testing.assert_allclose(ordered(-held.vertices / size), ordered(expected.T / size), rtol=0, atol=1e-12)

    moved = velocity_polytope(state, LIMITS / 1000.0)
    theirs = pycapacity.velocity_polytope(g, UPPER / 1000.0, LOWER / 1000.0)
    mine, their = (
        np.column_stack([rows, ends]) / np.linalg.norm(rows, axis=-1, keepdims=True)
        for rows, ends in (moved.half_spaces, (np.asarray(theirs.H), np.asarray(theirs.d).reshape(-1, 1)))
        for ends in (ends.reshape(-1, 1),)
    )
    assert their.shape == (12, 7)
    np.testing.assert_allclose(ordered(mine), ordered(their), rtol=0, atol=1e-12)


def test_balls_touch_a_facet_and_are_inside() -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    for part, columns in (("linear", slice(3)), ("angular", slice(3, 6))):
        held = wrench_polytope(STATE, LIMITS, load=LOAD)
        directions = np.zeros((len(points), 6))
        directions[:, columns] = points
        extents, radius = held.extent(directions), held.ball(part)
        assert extents.min() >= radius * (1.0 - 1e-12)
        assert extents.min() == pytest.approx(radius, rel=2e-3)
    # The metric "payload" of sweeps is the same number, by a formula of its own.
    payload = spm.sweeps.METRICS["payload"](push=900.0, pull=400.0).evaluate(spm.sweeps.Points(PAPER, "legs", LENGTHS))
    balls = wrench_polytope(spm.forward_physical(PAPER, LENGTHS), np.repeat([[-400.0], [900.0]], 6, axis=1)).ball()
    np.testing.assert_allclose(balls, payload, rtol=1e-12)


@pytest.mark.parametrize("part", ["linear", "angular"])
def test_ellipsoids_are_sections_of_the_image_of_the_ball_in_the_box_of_the_legs(part: str) -> None:
    held = wrench_polytope(STATE, LIMITS, load=LOAD)
    centre, axes, directions = held.ellipsoid(part)
    sphere = np.random.default_rng(3).normal(size=(5000, 3))
    sphere /= np.linalg.norm(sphere, axis=-1, keepdims=True)
    wrenches = np.zeros((len(sphere), 6))
    wrenches[:, slice(3) if part == "linear" else slice(3, 6)] = centre + (sphere * axes) @ directions
    forces = spm.leg_forces(STATE, wrenches + LOAD)
    shares = ((forces - 0.5 * (LOWER + UPPER)) / (0.5 * (UPPER - LOWER))) ** 2
    np.testing.assert_allclose(shares.sum(axis=-1), 1.0, rtol=1e-9)
    assert held.contains(wrenches).all()
    assert (np.diff(axes) <= 0.0).all()


def test_the_section_is_the_hull_of_the_forces_that_are_held_without_a_moment() -> None:
    held = wrench_polytope(STATE, LIMITS, load=LOAD)
    vertices, faces = held.section("linear")
    assert held.contains(np.pad(vertices * (1.0 - 1e-9), ((0, 0), (0, 3)))).all()
    for vertex in vertices:
        values = held.rows @ np.pad(vertex, (0, 3))
        assert (np.minimum(np.abs(values - held.lower), np.abs(values - held.upper)) < 1e-6).sum() >= 3
    corners = vertices[faces]
    volume = np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(ConvexHull(vertices).volume, rel=1e-9)
    drawn = np.random.default_rng(4).uniform(vertices.min(axis=0), vertices.max(axis=0), (20_000, 3))
    share = held.contains(np.pad(drawn, ((0, 0), (0, 3)))).mean()
    assert volume == pytest.approx(share * np.prod(np.ptp(vertices, axis=0)), rel=0.03)


def test_accelerations_are_those_of_the_dynamics() -> None:
    chain = spm.ClosedChain.from_urdf()
    q = chain.joint_values(STATE)
    v = chain.state(q).joint_velocities([0.1, -0.2, 0.1, 0.3, 0.2, -0.1])
    dynamics = chain.state(q, v).platform_dynamics()
    load = -dynamics.bias - dynamics.gravity
    polytope = acceleration_polytope(STATE, 5.0 * LIMITS, dynamics.mass, load)
    state = chain.state(q, v)
    for corner in (0, 21, 63):
        forces = 5.0 * np.where((corner >> np.arange(6)) & 1, UPPER, LOWER)
        expected = state.platform_acceleration(state.forward_dynamics(forces))
        np.testing.assert_allclose(polytope.vertices[corner], expected, rtol=1e-8, atol=1e-6)


def test_singular_sets_have_no_end() -> None:
    """At the level home some wrenches need no leg, and others none of the legs' facets."""
    home = spm.forward_physical(PAPER, [1.3] * 6)
    held = wrench_polytope(home, 1000.0)
    assert np.isfinite(held.half_spaces.A).all()
    values, vectors = np.linalg.eigh(held.rows.T @ held.rows)
    assert values[0] < 1e-12
    assert held.extent(vectors[:, 0]) > 1e12
    with pytest.raises(spm.SingularConfigurationError, check=with_fields(kind="inverse")):
        _ = held.vertices
    with pytest.raises(spm.SingularConfigurationError, check=with_fields(kind="inverse")):
        velocity_polytope(home, 0.1)


def test_a_leg_that_does_not_move_is_not_stopped_by_a_limit_of_zero() -> None:
    """Straight up the upper legs of a drawn machine keep their lengths, to rounding of either sign."""
    states = spm.forward_physical(
        PAPER, [STATE.readings, [1.25, 1.15, 1.4, 1.3, 1.2, 1.4], [1.3, 1.2, 1.2, 1.4, 1.3, 1.2]]
    )
    rates = np.array([0.2, 0.2, 0.2, 0.2, 0.0, 0.2])
    shortening = velocity_polytope(states, [[-0.2] * 6, rates.tolist()])
    for up in (1.0, -1.0):
        direction = [0.0, 0.0, up, 0.0, 0.0, 0.0]
        expected = velocity_polytope(states, 0.2).extent(direction)
        np.testing.assert_allclose(shortening.extent(direction), expected, rtol=1e-12)
        assert shortening.contains(0.9 * expected[:, None] * direction).all()
        assert not shortening.contains(1.1 * expected[:, None] * direction).any()


def test_batches_hold_absent_members_and_overloaded_ones() -> None:
    states = spm.forward_physical(PAPER, [STATE.readings, [1.2, 1.2, 9.0, 1.2, 1.2, 1.2]])
    held = wrench_polytope(states, 1000.0)
    assert held.vertices.shape == (2, 64, 6)
    assert np.isnan(held.ball()).tolist() == [False, True]
    assert np.isnan(held.extent(LOAD)).tolist() == [False, True]
    assert np.isnan(held.ellipsoid().semi_axes[1]).all()
    assert held.contains(LOAD).tolist() == [True, False]
    np.testing.assert_allclose(held.ball()[0], wrench_polytope(STATE, 1000.0).ball(), rtol=1e-12)
    too_much = wrench_polytope(STATE, 1.0, load=[0.0, 0.0, -1e4, 0.0, 0.0, 0.0])
    assert too_much.ball() == too_much.extent(LOAD) == 0.0
    too_much = wrench_polytope(STATE, 1.0, load=[0.0, 0.0, 0.0, 1e4, 0.0, 0.0])
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="polytope")):
        too_much.section()
    loads = wrench_polytope(STATE, 1000.0, load=np.zeros((3, 6)))
    assert loads.ball().shape == (3,)
    with pytest.raises(spm.ArgumentError, match="parallelotope"):
        _ = held.within(np.ones((1, 6)), 5.0).vertices
    with pytest.raises(spm.ArgumentError, match="single state"):
        held.section()


def test_rows_within_limits_count_a_load_that_is_there_besides() -> None:
    """A wrench is inside if the reactions to it and the payload together keep their limits."""
    payload = np.array([[0.0, 0.0, -300.0, 0.0, 0.0, 0.0], [50.0, 0.0, -100.0, 5.0, 0.0, 0.0]])
    bending = joint_reactions(STATE).bending
    held = wrench_polytope(STATE, 3000.0, load=payload)
    limited = held.within(bending, 250.0, load=payload)
    direction = np.array([1.0, -0.5, -0.3, 0.0, 0.0, 0.0])
    for k, most in enumerate(limited.extent(direction)):
        moments = np.abs(bending @ (most * direction + payload[k]))
        assert moments.max() == pytest.approx(250.0, rel=1e-9)
    alone = wrench_polytope(STATE, 3000.0).within(bending, 250.0, load=payload)
    assert alone.ball().shape == (2,)
    np.testing.assert_allclose(alone.ball(), limited.ball(), rtol=1e-12)
    # One row is a row as well.
    one = held.within(bending[0], 250.0, load=payload)
    np.testing.assert_array_equal(one.lower, held.within(bending[:1], 250.0, load=payload).lower)
    with pytest.raises(spm.ArgumentError, match="load"):
        limited.within(bending, 250.0, load=np.zeros((3, 6)))


def test_sections_without_end_and_masses_that_are_none_are_refused() -> None:
    home = wrench_polytope(spm.forward_physical(PAPER, [1.3] * 6), 1000.0)
    with pytest.raises(spm.ArgumentError, match="without end"):
        home.section("angular")
    assert len(home.section("linear").vertices) > 3
    masses = np.stack([np.eye(6), np.full((6, 6), np.nan), np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -2.0])])
    with pytest.raises(spm.ArgumentError, match=r"positive definite matrices, got an eigenvalue of -2"):
        acceleration_polytope(STATE, 1000.0, masses)
    assert np.isnan(acceleration_polytope(STATE, 1000.0, masses[:2]).ball()).tolist() == [False, True]
    with pytest.raises(spm.ArgumentError, match=r"got -5"):
        wrench_polytope(STATE, -5.0)


def test_nothing_left_is_zero_without_a_sign() -> None:
    held = wrench_polytope(STATE, np.stack([np.full(6, -900.0), np.zeros(6)]))
    assert not np.signbit(held.ball())
    assert not np.signbit(held.extent(-np.linalg.solve(held.rows, -np.ones(6)))).any()


def test_sections_have_the_shape_of_their_limits_whatever_the_size() -> None:
    expected = wrench_polytope(STATE, 1.0).section()
    for size in (1e-90, 1e-30, 1e40, 1e90):
        vertices = wrench_polytope(STATE, size).section().vertices
        np.testing.assert_allclose(
            sorted(vertices.tolist()), size * np.array(sorted(expected.vertices.tolist())), rtol=1e-6, atol=1e-9 * size
        )
    # One leg that hardly holds anything leaves a flat section of the others.
    for weakest in (1e-3, 1e-10):
        flat = wrench_polytope(STATE, [weakest, *[1000.0] * 5])
        vertices = flat.section().vertices
        values = vertices @ flat.rows[0, :3]
        np.testing.assert_allclose(np.abs(values), weakest, rtol=1e-2)
    empty = wrench_polytope(STATE, 1.0, load=[0.0, 0.0, -1e4, 0.0, 0.0, 1e4])
    with pytest.raises(spm.ArgumentError, match="empty, or flat"):
        empty.section()
