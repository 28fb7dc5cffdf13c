"""Closing the loops, completing the passive joints, reaching poses, and trajectories of all joints."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from error_fields import with_fields
from multibody.chains import EPS, MACHINES, NAMES, PAPER, POSE, chain, placed, random_q, rounding

import spm_pin as spm
from spm_pin.errors import (
    ArgumentError,
    ClosureError,
    PoseError,
    SingularConfigurationError,
    SpmError,
    UnreachableError,
)
from spm_pin.multibody.trajectory import PlatformMotion, PlatformPath

pytest.importorskip("pinocchio")

LENGTHS = [
    [1.20, 1.20, 1.40, 1.25, 1.20, 1.45],
    [1.25, 1.23, 1.40, 1.25, 1.22, 1.45],
    [1.22, 1.20, 1.42, 1.24, 1.18, 1.42],
]
WAYPOINTS = spm.forward_physical(PAPER, LENGTHS).pose


def test_poses_are_reached_in_the_branch_started_from() -> None:
    """Two of the six branches end on this way of a third of a millimetre: they meet in an inverse singularity."""
    robot = chain()
    moved = np.array([1.5e-4, -3e-4, 3e-4])
    target = spm.pose(POSE.translation + moved, rotation=POSE.rotation)
    begin, end = spm.inverse_displacement(PAPER, POSE), spm.inverse_displacement(PAPER, target)
    assert (begin.count, end.count) == (6, 4)
    for label in np.array(begin.labels)[begin.exists]:
        q = robot.joint_values(begin[label])
        if end[label].exists:
            found = robot.inverse_kinematics(target, q)
            # Near a fold, legs move as the root of what the pose moves.
            allowed = 64 * EPS / robot.state(found).singular_values().inverse ** 2
            assert np.abs(robot.leg_lengths(found) - end[label].leg_lengths).max() <= allowed
            assert np.abs(robot.state(found).configuration().pose.as_matrix() - target.as_matrix()).max() <= 1e-13
            continue
        with pytest.raises(ClosureError, match="an inverse singularity, or out of reach") as caught:
            robot.inverse_kinematics(target, q)
        share = float(re.findall(r"No further than (\S+) %", str(caught.value))[0]) / 100.0
        around = POSE.translation + np.array([[share - 2e-3], [share + 2e-3]]) * moved
        assert list(spm.inverse_displacement(PAPER, spm.pose(around, rotation=POSE.rotation)).count) == [6, 4]


def test_unreachable_targets() -> None:
    robot = chain()
    q = robot.forward_kinematics([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    with pytest.raises(ClosureError, match=r"No further than \d+\.?\d* % of the way: a forward singularity"):
        robot.forward_kinematics([1.2, 1.2, 1.2, 1.2, 1.2, 9.0], q)
    with pytest.raises(ClosureError, match=r"At batch index \(1,\)\. No further than"):
        robot.forward_kinematics([[1.2, 1.2, 1.4, 1.25, 1.2, 1.4], [1.2, 1.2, 1.2, 1.2, 1.2, 9.0]], q)
    with pytest.raises(ClosureError, match="out of reach"):
        robot.inverse_kinematics(spm.pose([0.0, 0.0, 9.0], xyx=[0.1, 0.2, 0.3]), q)
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")):
        robot.inverse_kinematics(POSE, np.zeros(18))
    with pytest.raises(ClosureError, match="0 iterations"):
        robot.forward_kinematics(np.full(6, 1.3), q + 1e-2)
    with pytest.raises(ArgumentError, check=with_fields(argument="readings")):
        robot.forward_kinematics([1.2, 1.2, 1.4, 1.25, 1.2, -1.0], q)
    assert robot.forward_kinematics(np.empty((0, 6)), q).shape == (0, 18)


@pytest.mark.parametrize("ease", [False, True])
def test_twists_and_accelerations_are_derivatives_of_the_pose(ease: bool) -> None:
    path, h = PlatformPath([0.5, 1.0, 2.0], WAYPOINTS, ease=ease), 1e-4
    times = np.linspace(0.63, 1.93, 14)
    ahead, here, behind = path(times + h), path(times), path(times - h)
    velocity = (ahead.pose.translation - behind.pose.translation) / (2 * h)
    turning = (ahead.pose.rotation * behind.pose.rotation.inv()).as_rotvec() / (2 * h)
    assert np.allclose(here.twist, np.concatenate([velocity, turning], axis=-1), atol=1e-7)
    # Cubic splines: accelerations have corners at the waypoints, which none of these times is next to.
    assert np.allclose(here.acceleration, (ahead.twist - behind.twist) / (2 * h), atol=1e-6)


def test_eased_paths_rest_at_both_ends_and_others_meet_their_poses() -> None:
    times = np.array([0.5, 1.0, 2.0])
    met = PlatformPath(times, WAYPOINTS)(times).pose.as_matrix()
    assert np.allclose(met, WAYPOINTS.as_matrix(), atol=1e-14)
    ends = PlatformPath(times, WAYPOINTS, ease=True)([0.5, 2.0])
    assert np.allclose(ends.pose.as_matrix(), WAYPOINTS[[0, 2]].as_matrix(), atol=1e-14)
    assert np.abs(ends.twist).max() == np.abs(ends.acceleration).max() == 0.0
    assert PlatformPath(times, WAYPOINTS).duration == 1.5
    assert PlatformPath(times, WAYPOINTS)(np.zeros((2, 0))).twist.shape == (2, 0, 6)


def test_invalid_paths_and_trajectories_are_refused() -> None:
    path = PlatformPath([0.0, 1.0, 2.0], WAYPOINTS)
    for times in ([0.0, 0.0, 1.0], [0.0]):
        with pytest.raises(ArgumentError, check=with_fields(argument="times")):
            PlatformPath(times, WAYPOINTS)
    with pytest.raises(PoseError, check=with_fields(argument="poses")):
        PlatformPath([0.0, 1.0], WAYPOINTS)
    with pytest.raises(ArgumentError, check=with_fields(argument="times")):
        path([0.0, 2.1])
    robot = chain()
    q = robot.joint_values(spm.inverse_displacement(PAPER, WAYPOINTS[0]).physical())
    motions = PlatformMotion(POSE, np.zeros(3), np.zeros(6)), None, (POSE, np.zeros(6))
    for wrong in (WAYPOINTS, lambda: None, lambda t, q: None, *(lambda t, motion=motion: motion for motion in motions)):
        with pytest.raises(ArgumentError, check=with_fields(argument="path", index="")):
            robot.joint_trajectory(wrong, [0.0, 1.0], q)
    away = PlatformPath([0.0, 1.0], spm.pose([POSE.translation, [0.0, 0.0, 9.0]], xyx=[[0.1, 0.2, 0.3]] * 2))
    with pytest.raises(ClosureError, match=r"At batch index \(\d+,\)"):
        robot.joint_trajectory(away, np.linspace(0.0, 1.0, 5), q)
    with pytest.raises(ArgumentError, check=with_fields(argument="times")):
        robot.joint_trajectory(path, [0.0, 3.0], q)
    up = WAYPOINTS[0].translation + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]])
    beyond = PlatformPath([0.0, 1.0], spm.pose(up, rotation=np.stack([WAYPOINTS[0].rotation.as_matrix()] * 2)))
    with pytest.raises(UnreachableError, check=with_fields(argument="path")) as caught:
        robot.joint_trajectory(beyond, np.linspace(0.0, 1.0, 51), q)
    assert caught.value.received.startswith("r_b3 of 1.50")


def test_all_joints_of_a_platform_path() -> None:
    robot = chain()
    q = robot.joint_values(spm.inverse_displacement(PAPER, WAYPOINTS[0]).physical())
    path, times = PlatformPath([0.0, 1.0, 2.0], WAYPOINTS, ease=True), np.linspace(0.0, 2.0, 201)
    found = robot.joint_trajectory(path, times, q)
    assert found.joint_names == robot.joint_names
    assert np.abs(robot.state(found.positions).closure_gap()).max() <= 1e-12
    reached = robot.state(found.positions).configuration().pose.as_matrix()
    assert np.abs(reached - path(times).pose.as_matrix()).max() <= 1e-12
    # Legs as the closed form has them, in the branch of the start.
    legs = spm.inverse_displacement(PAPER, path(times).pose)["TT+"].leg_lengths
    assert np.abs(robot.leg_lengths(found.positions) - legs).max() <= 1e-9
    h = times[1]
    for values, rates in ((found.positions, found.velocities), (found.velocities, found.accelerations)):
        slope = (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * h)
        # The waypoint between is a corner of the accelerations.
        smooth = np.abs(path(times).pose.translation[2:-2] - WAYPOINTS[1].translation).max(axis=-1) > 5e-3
        assert np.abs(slope - rates[2:-2])[smooth].max() <= 2e-4 * np.abs(rates).max()
    forces = robot.state(found.positions, found.velocities).inverse_dynamics(found.accelerations)
    assert np.allclose(found.efforts[:, robot.leg_indices], forces, rtol=1e-9)
    assert not np.delete(found.efforts, robot.leg_indices, axis=1).any()
    # A function of one time serves as well, at any rate.
    slow = robot.joint_trajectory(lambda t: path(t), times[::50], q)
    assert np.allclose(slow.positions, found.positions[::50], atol=1e-10)


def test_a_trajectory_in_files(tmp_path: Path) -> None:
    robot = chain()
    q = robot.joint_values(spm.inverse_displacement(PAPER, WAYPOINTS[0]).physical())
    found = robot.joint_trajectory(PlatformPath([3.0, 4.0, 5.0], WAYPOINTS), [3.0, 3.25, 4.999999999], q)
    rows = list(csv.reader(io.StringIO(found.to_csv(tmp_path / "all.csv"))))
    assert (tmp_path / "all.csv").read_text(encoding="utf-8") == found.to_csv()
    assert len(rows) == 4
    names = ["time", *spm.machine.LEGS, "x", "y", "z", "qx", "qy", "qz", "qw"]
    assert rows[0][:15] == [*names, f"{robot.joint_names[0]}.position"]
    table = np.array(rows[1:], dtype=float)
    parts = [found.times[:, None], robot.readings(found.positions), table[:, 7:14]]
    parts += [found.positions, found.velocities, found.accelerations, found.efforts]
    assert np.array_equal(table, np.concatenate(parts, axis=1))
    poses = robot.state(found.positions).configuration().pose
    expected = [poses.translation, poses.rotation.as_quat()]
    np.testing.assert_allclose(table[:, 7:14], np.concatenate(expected, axis=1), atol=1e-12)
    message = json.loads(found.to_json(tmp_path / "all.json"))
    assert json.loads((tmp_path / "all.json").read_text(encoding="utf-8")) == message == found.to_dict()
    assert message["joint_names"] == list(robot.joint_names)
    assert [p["time_from_start"] for p in message["points"]] == [
        {"sec": 0, "nanosec": 0},
        {"sec": 0, "nanosec": 250_000_000},
        {"sec": 1, "nanosec": 999_999_999},
    ]
    for key, values in (("positions", found.positions), ("velocities", found.velocities), ("effort", found.efforts)):
        assert [point[key] for point in message["points"]] == values.tolist()


def test_a_path_that_ends_at_a_fold_is_not_completed_in_another_mode() -> None:
    begin = [0.684323687731267, 1.5724122184620153, 0.9033743064577988]
    begin += [0.7089082670062409, 0.7536839372978562, 0.6860272440464935]
    end = [0.6822367053271448, 1.753103485743987, 0.9020521723520921]
    end += [0.6342860269226885, 0.5528705330271455, 0.7360498750791851]
    q = chain().joint_values(spm.forward_displacement(PAPER, begin)["T2+/T1+"])
    with pytest.raises(ClosureError, match="a forward singularity, or the end of this assembly mode") as caught:
        chain().forward_kinematics(end, near=q)
    # A constraint singularity comes first, at 0.6085; without it the path would end at a fold at 0.7265.
    share = float(re.findall(r"No further than (\S+) %", str(caught.value))[0]) / 100.0
    assert 0.55 < share <= 0.7265


def test_random_modes_arrive_where_fine_steps_lead() -> None:
    """Paths from random modes, in one call and in a hundred steps."""
    robot, rng, arrived, tried = chain(), np.random.default_rng(411), 0, 0
    while tried < 25:
        begin = rng.uniform(0.5, 2.0, 6)
        end = begin + rng.normal(0.0, 0.1, 6)
        modes = spm.forward_displacement(PAPER, begin)
        if not modes.exists.any():
            continue
        tried += 1
        q = robot.joint_values(modes.configurations[int(rng.choice(np.flatnonzero(modes.exists)))])
        try:
            coarse = robot.forward_kinematics(end[None], near=q)[-1]
        except SpmError:
            continue
        # What arrives in one call arrives in fine steps, too, and in the same place.
        fine = robot.forward_kinematics(begin + np.linspace(0.0, 1.0, 101)[1:, None] * (end - begin), near=q)[-1]
        assert np.abs(coarse - fine).max() < 1e-6
        arrived += 1
    assert arrived >= 5


def test_targets_that_no_physical_mode_has_are_refused_or_nan() -> None:
    readings = np.array([[1.3] * 6, [1.2, 1.2, 1.2, 1.2, 1.2, 9.0]])
    home, away = spm.pose([0.0, 0.0, 2.3], xyx=[0.0, 0.0, 0.0]), spm.pose([0.1, 0.2, 9.0], xyx=[0.1, 0.2, 0.3])
    forward, inverse = chain().forward_kinematics, chain().inverse_kinematics
    for call, target, argument, cause in (
        (forward, readings[1], "readings", "With these readings no configuration is reached from the home"),
        (inverse, home, "pose", "A level platform over the axis of the base"),
        (inverse, away, "pose", "Out of reach: no solution is real. For the nearest pose"),
    ):
        with pytest.raises(ArgumentError, check=with_fields(argument=argument)) as caught:
            call(target)
        assert caught.value.cause.startswith(cause)
        assert "Pass a closed q as near" in caught.value.cause
    for call, targets in ((forward, readings), (inverse, np.stack([POSE.as_matrix(), away.as_matrix()]))):
        found = call(targets)
        assert np.array_equal(found[0], call(targets[0]))
        assert np.isnan(found[1]).all()


def test_the_physical_branch_is_that_of_all_branches() -> None:
    machine, robot = MACHINES["as built"], chain("as built")
    readings = robot.readings(np.zeros(18)) * np.random.default_rng(415).uniform(0.98, 1.02, (20, 6))
    poses = spm.forward_physical(machine, readings).pose
    together = robot.inverse_kinematics(poses)
    assert np.array_equal(together, robot.joint_values(spm.inverse_displacement(machine, poses).physical()))
    assert robot.inverse_kinematics(poses[:0]).shape == (0, 18)
    # The same by continuation from beside it.
    followed = robot.inverse_kinematics(poses[7], robot.forward_kinematics(readings[7] + 1e-4))
    assert np.abs(np.exp(1j * followed) - np.exp(1j * together[7])).max() <= 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_a_perturbed_q_is_closed(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(131)
    units = np.ones(18)
    units[robot.leg_indices] = robot.machine.middle_side
    for _, q in placed(name, 25, seed=132):
        if robot.state(q).singular_values().constraint < 0.05:
            continue
        off = 0.01 * units * rng.uniform(-1, 1, 18)
        off[robot.leg_indices] = np.maximum(off[robot.leg_indices], -0.5 * robot.leg_lengths(q))
        found = robot.project(q + off)
        assert np.abs(robot.state(found).closure_gap()).max() <= rounding(robot, q)
        assert robot.state(found).configuration().closure_residual <= rounding(robot, q)
        # It goes to a point near by: to first order none is nearer, and q is one.
        assert np.linalg.norm((found - q - off) / units) <= 1.5 * np.linalg.norm(off / units)


def test_starts_that_do_not_converge() -> None:
    """Whatever the start: a closed q or an error, and both kinds occur."""
    robot, rng = chain(), np.random.default_rng(137)
    residuals_left = []
    for _ in range(40):
        q = 2 * random_q(robot, rng)
        if (robot.leg_lengths(np.zeros(18)) + q[robot.leg_indices] < 0).any():
            continue
        try:
            found = robot.project(q)
        except ClosureError as error:
            residuals_left.append(error.residual)
        else:
            assert np.abs(robot.state(found).closure_gap()).max() <= 10 * rounding(robot, found)
            assert (robot.leg_lengths(found) >= 0).all()
    assert 0 < len(residuals_left) < 40
    assert min(residuals_left) > 1e-6
