"""Rates, forces, singularities and reach of a stage alone."""

from __future__ import annotations

import numpy as np
import pytest
from balancers import MACHINES, STAGES, existing_states, stage_and_height
from error_fields import with_fields
from finite_differences import extrapolated

import spm_pin as spm
from spm_pin.kinematics import MOTION, SingularityKind
from spm_pin.kinematics.random_states import random_states
from spm_pin.machine import Stage
from spm_pin.workspace import ReachEnd

STRETCHED = Stage(0.6, 0.5, spm.RRS(crank=0.3, rod=0.4))
"""With its cranks level the rods lie in line with them, and the platform in the plane of its pivots."""
BALANCER = Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))


def states(machine: str, count: int = 12) -> spm.Configuration:
    stage, height = stage_and_height(machine)
    found = existing_states(stage, height, 3 * count)
    regular = (np.abs(found.slopes) > 0.2 * stage.legs.largest_slopes).all(axis=-1)
    return found[regular & (spm.singularities(found).forward > 0.1)][:count]


@pytest.mark.parametrize("machine", MACHINES)
def test_the_twists_are_differences_of_poses(machine: str) -> None:
    found = states(machine)
    jacobian = spm.kinematics.platform_jacobian(found)
    for leg in range(3):

        def central(h: float, leg: int = leg) -> np.ndarray:
            steps = h * np.eye(3)[leg], -h * np.eye(3)[leg]
            a, b = (spm.forward_physical(found.machine, found.readings + step, found) for step in steps)
            angular = (a.pose.rotation * b.pose.rotation.inv()).as_rotvec()
            return np.concatenate([a.translation - b.translation, angular], axis=-1) / (2.0 * h)

        np.testing.assert_allclose(jacobian[..., leg], extrapolated(central, 2e-4), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("machine", MACHINES)
def test_rates_both_ways_and_the_parasitic_motion_agree(machine: str) -> None:
    found = states(machine)
    jacobian, inverse = spm.kinematics.platform_jacobian(found), spm.inverse_jacobian(found)
    np.testing.assert_allclose(inverse @ jacobian[:, MOTION], np.broadcast_to(np.eye(3), inverse.shape), atol=1e-11)
    parasitic = spm.kinematics.parasitic_jacobian(found)
    np.testing.assert_allclose(parasitic @ jacobian[:, MOTION], jacobian, atol=1e-11 * np.abs(jacobian).max())
    motion = [0.1, -0.2, 0.3]
    twists = np.einsum("nki,ni->nk", jacobian, spm.leg_rates(found, motion))
    np.testing.assert_allclose(twists[:, MOTION], np.tile(motion, (len(found), 1)), atol=1e-11)


@pytest.mark.parametrize("machine", MACHINES)
def test_what_the_joints_carry_is_in_equilibrium(machine: str) -> None:
    found, wrench = states(machine), np.array([3.0, -2.0, -50.0, 0.4, -0.6, 0.8])
    loads = spm.kinematics.joint_loads(found, wrench)
    np.testing.assert_allclose(loads.balls.sum(axis=-2), np.tile(-wrench[:3], (len(found), 1)), atol=1e-11)
    arms = found.balls - found.translation[:, None]
    moments = np.cross(arms, loads.balls).sum(axis=-2)
    np.testing.assert_allclose(moments, np.tile(-wrench[3:], (len(found), 1)), atol=1e-11)
    forces = spm.leg_forces(found, wrench)
    np.testing.assert_allclose(loads.efforts, forces, atol=1e-11)
    if found.machine.unit == "rad":
        # The crank's actuator balances the moment of the ball's force about its axis: a turn that leads outwards.
        about = (loads.moments * np.cross(*found.machine.legs.planes)).sum(axis=-1)
        np.testing.assert_allclose(np.abs(about), np.abs(forces), atol=1e-11)


@pytest.mark.parametrize("legs", [(spm.RPS(), spm.RPS()), (spm.RPS(), spm.RRS(crank=0.15, rod=0.35))])
def test_the_joints_of_both_stages_of_a_manipulator_are_in_equilibrium(legs: object) -> None:
    machine = spm.Manipulator(0.5, 0.4, 0.6, legs=legs)
    found, wrench = random_states(machine, 20, np.random.default_rng(0)), np.array([3.0, -2.0, -50.0, 0.4, -0.6, 0.8])
    loads = spm.kinematics.joint_loads(found, wrench)
    arms = found.balls - found.translation[:, None]
    for stage in (slice(3), slice(3, 6)):
        forces = loads.balls[:, stage]
        tolerance = 1e-12 * np.abs(forces).max()
        np.testing.assert_allclose(forces.sum(axis=-2), np.tile(-wrench[:3], (20, 1)), atol=tolerance)
        moments = np.cross(arms[:, stage], forces).sum(axis=-2)
        np.testing.assert_allclose(moments, np.tile(-wrench[3:], (20, 1)), atol=tolerance)
    np.testing.assert_allclose(loads.efforts, spm.leg_forces(found, wrench), rtol=1e-9)


def test_a_level_tripod_carries_a_third_in_each_leg() -> None:
    level = spm.inverse_physical(Stage(0.46, 0.46), 1.0)
    np.testing.assert_allclose(spm.leg_forces(level, [0, 0, -30.0, 0, 0, 0]), 10.0)
    loads = spm.kinematics.joint_loads(level, [0, 0, 0, 0, 0, 9.0])
    np.testing.assert_allclose(np.abs(loads.across), 9.0 / 3.0 / 0.46)
    np.testing.assert_allclose(loads.rods, 0.0, atol=1e-14)


def test_singularities_of_all_sorts() -> None:
    assert spm.singularities(states("RPS")).kind.max() == 0
    # A flat tripod moves with its actuators locked.
    flat = spm.inverse_displacement(STAGES["RPS"], 0.0)["T"]
    assert spm.singularities(flat).kind & SingularityKind.FORWARD
    with pytest.raises(spm.SingularConfigurationError, check=with_fields(kind="forward")):
        spm.kinematics.platform_jacobian(flat)
    # A crank and a rod in line.
    reach = np.hypot(0.16, 0.0)
    line = spm.inverse_displacement(STAGES["RRS"], float(np.sqrt(reach**2 - 0.01**2)) - 1e-15)["T"]
    assert spm.singularities(line, tolerance=1e-6).kind == SingularityKind.LEG
    # Straight up: a platform on its edge has no torsion of its own.
    normals = np.array([[np.sin(t), 0.0, np.cos(t)] for t in (0.1, 1.0, 2.0, 3.0, 3.14)])
    distance = spm.singularities(spm.inverse_displacement(STAGES["RPS"], 1.0, normal=normals)["T"]).inverse
    assert (np.diff(distance) < 0.0).all()
    gained = spm.singularities(flat).gained_twist
    np.testing.assert_allclose(np.abs(gained[:2]), 0.0, atol=1e-12)


def test_the_reach_is_where_states_stop_to_count() -> None:
    found = spm.workspace.reach(BALANCER, 0.12, directions=12)
    assert (found.ends == ReachEnd.LIMIT).all()
    for beyond, counts in ((-1e-9, True), (1e-9, False)):
        state = spm.inverse_physical(BALANCER, 0.12, tilt=found.tilts[0] + beyond, azimuth=found.azimuths)
        np.testing.assert_array_equal((state.limit_excess == 0.0).all(axis=-1), counts)
    low, high = spm.workspace.height_range(BALANCER)
    for height, reading in ((low, -0.6), (high, 1.2)):
        np.testing.assert_allclose(spm.inverse_physical(BALANCER, height).readings, reading, atol=1e-7)
    assert np.isnan(spm.workspace.reach(BALANCER, high + 1e-6).tilts).all()
    assert (spm.workspace.reach(BALANCER, high + 1e-6).ends == ReachEnd.NOT_LEVEL).all()
    # By symmetry of the drawing, every third of a turn is alike.
    np.testing.assert_allclose(found.tilts[0, :4], found.tilts[0, 4:8], atol=1e-9)
    unlimited = spm.workspace.reach(STAGES["RRS"], 0.12, directions=12)
    assert (unlimited.tilts > found.tilts).all()
    most = np.degrees(found.tilts.min())
    assert repr(found) == f"<StageReach: 1 heights, {most:.1f}° in every direction at 0.12 m; what ends tilts: limit>"
    assert repr(spm.workspace.reach(BALANCER, high + 1e-6)) == "<StageReach: 1 heights, level at none>"
    assert set(unlimited.ends.flat) <= {ReachEnd.LEG, ReachEnd.FORWARD}


def test_at_the_best_height_the_platform_tilts_farther_all_round_than_at_any_other() -> None:
    height, tilt = spm.workspace.best_height(BALANCER, directions=12)
    heights = np.linspace(*spm.workspace.height_range(BALANCER), 401)
    others = spm.workspace.reach(BALANCER, heights, directions=12).all_round
    assert -1e-4 < tilt - np.nanmax(others) < 0.01
    assert abs(height - heights[np.nanargmax(others)]) <= heights[1] - heights[0]
    assert spm.workspace.reach(BALANCER, height, directions=12).all_round[0] == pytest.approx(tilt, abs=1e-5)
    nowhere = spm.Stage(0.35, 0.2, limits=(0.1, 0.14))
    assert np.isnan(spm.workspace.best_height(nowhere)).all()


def limited_to_tilts() -> Stage:
    """Return the stage with limits that exclude the level platform."""
    middle = spm.inverse_physical(BALANCER, 0.12, tilt=0.45, azimuth=0.5).readings
    limits = spm.LegLimits(middle - 0.1, middle + 0.1)
    return Stage(BALANCER.base_radius, BALANCER.platform_radius, BALANCER.kind, limits)


@pytest.mark.parametrize(
    ("stage", "tilts", "azimuths", "wanted"),
    [
        (BALANCER, (0.0, 0.7, 141), (-np.pi, np.pi, 361), [(0.6, 0.9)]),
        (limited_to_tilts(), (0.3, 0.6, 301), (0.3, 0.7, 201), [(0.7, 0.5), (0.0, 0.0), (0.45, 1.2)]),
    ],
)
def test_the_nearest_reachable_tilt_is_no_farther_than_any_of_a_grid(
    stage: Stage, tilts: tuple[float, float, int], azimuths: tuple[float, float, int], wanted: list[tuple[float, float]]
) -> None:
    grid = np.meshgrid(np.linspace(*tilts), np.linspace(*azimuths))
    states = spm.inverse_physical(stage, 0.12, tilt=grid[0], azimuth=grid[1])
    counts = states.exists & (states.limit_excess == 0.0).all(axis=-1)
    for tilt, azimuth in wanted:
        nearest = spm.workspace.nearest_reachable_pose(stage, 0.12, tilt=tilt, azimuth=azimuth).configuration
        assert not nearest.limit_excess.any()
        assert nearest.height == pytest.approx(0.12)
        target = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
        least = np.arccos((states.normal @ target)[counts]).min()
        assert least - 5e-3 < np.arccos(nearest.normal @ target) <= least + 1e-6


def test_the_nearest_state_to_heights_that_are_out_of_reach_and_to_what_is_reached() -> None:
    nearest_reachable_pose = spm.workspace.nearest_reachable_pose
    inside = nearest_reachable_pose(BALANCER, 0.12, tilt=0.1, azimuth=0.9).configuration
    np.testing.assert_allclose([inside.tilt, inside.azimuth], [0.1, 0.9])
    nothing = spm.Stage(0.08, 0.09, BALANCER.kind, limits=(3.0, 3.1))
    assert spm.inverse_physical(nothing, 0.1).exists
    assert not nearest_reachable_pose(nothing, 0.1).configuration.exists
    low = nearest_reachable_pose(BALANCER, 0.01, roll=0.1).configuration
    np.testing.assert_allclose(low.height, spm.workspace.height_range(BALANCER)[0])
    # At a height without any state it is the one of the readings in the middle.
    tilted = limited_to_tilts()
    assert np.isnan(spm.workspace.height_range(tilted)).all()
    assert nearest_reachable_pose(tilted, 0.3, tilt=0.2, azimuth=0.5).configuration.height == pytest.approx(0.12)


def test_limits_narrower_than_the_heights_tried_have_their_range() -> None:
    # Legs of equal radii are vertical where the platform is level: its height is their length.
    mirror = spm.Stage(0.05, 0.05, spm.RPS(), limits=(0.09997, 0.10003))
    np.testing.assert_allclose(spm.workspace.height_range(mirror), (0.09997, 0.10003), rtol=2e-8)
    height, tilt = spm.workspace.best_height(mirror, directions=12)
    np.testing.assert_allclose(height, 0.1, atol=1e-8)
    # To first order the least stroke of a ball at the radius r, ±r θ, is the limits' half width.
    np.testing.assert_allclose(tilt, 0.00003 / 0.05, rtol=1e-4)
    assert spm.workspace.nearest_reachable_pose(mirror, 0.1, roll=0.01, pitch=0.0).configuration.exists


def test_a_home_is_regular_and_exact() -> None:
    """Of a stage that is singular with level cranks it is in the middle of the heights, from there to all upright."""
    height = spm.workspace.home_height(STRETCHED)
    # Highest are cranks and rods in line: sqrt(0.7² - 0.1²).
    assert height == pytest.approx(0.5 * np.sqrt(0.48), abs=1e-7)
    home = spm.inverse_physical(STRETCHED, height)
    assert spm.singularities(home).forward > 0.1
    expected = 0.05 * np.sin(0.3) + np.sqrt(0.11**2 - (0.01 - 0.05 * np.cos(0.3)) ** 2)
    assert spm.workspace.home_height(BALANCER) == pytest.approx(expected, abs=1e-14)
    again = spm.forward_physical(STRETCHED, home.readings)
    assert again.height == pytest.approx(height, abs=1e-14)


def test_a_leg_of_no_length_leaves_the_rest_of_a_batch() -> None:
    flat = spm.Stage(0.05, 0.05)
    states = spm.inverse_displacement(flat, [0.0, 0.1])["T"]
    singular = spm.singularities(states)
    assert singular.kind[0] == SingularityKind.FORWARD
    assert singular.forward[0] == 0.0
    assert singular.kind[1] == 0
    assert singular.forward[1] > 1.0
    jacobian = spm.kinematics.platform_jacobian(states)
    assert np.isnan(jacobian[0]).all()
    np.testing.assert_allclose(jacobian[1] @ np.ones(3), [0, 0, 1, 0, 0, 0], atol=1e-14)
