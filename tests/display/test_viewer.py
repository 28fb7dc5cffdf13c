"""The viewer without a page: drags, notices, slider ranges, cameras, exports and recorded paths."""

from __future__ import annotations

import json
import shlex
import warnings
from unittest.mock import MagicMock

import numpy as np
import problems
import pytest
from balancers import stage_and_height
from cli.running import run
from error_fields import with_fields
from kinds_of_legs import SERVOS_AND_SCREWS
from scipy.spatial.transform import Rotation
from text_files import written

import spm_pin as spm
from spm_pin.capability import wrench_polytope
from spm_pin.description.visuals import visual_parts
from spm_pin.display import Recording, Viewer, read_recording
from spm_pin.display.rendering import robot_solids
from spm_pin.display.viewer.model import (
    ViewerModel,
    pose_coordinates,
    reading_units,
    sampled_states,
)
from spm_pin.display.viewer.panel import forces_table, instruments, status
from spm_pin.display.viewer.robot_scene import (
    RobotScene,
    solid_placements,
)
from spm_pin.display.viewer.stage_model import StageModel
from spm_pin.display.writing import fixed, to_json
from spm_pin.kinematics.forward_displacement import starting_configuration

PAPER = spm.Manipulator.paper()
FREE = spm.Manipulator(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side)
START = starting_configuration(PAPER)


def moved(pose, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    return spm.pose(pose.translation + np.array(shift), rotation=Rotation.from_rotvec(turn) * pose.rotation)


@pytest.mark.parametrize("name", ["paper", "wide base"])
def test_every_machine_has_a_physical_start_the_paper_s_is_its_solution_3(name):
    start = starting_configuration(problems.MANIPULATORS[name])
    state = ViewerModel(start).state
    assert state.is_physical
    if start.machine == PAPER:
        np.testing.assert_allclose(start.leg_lengths, [1.2, 1.2, 1.4, 1.25, 1.2, 1.5], atol=1e-12)
        assert state.label == "TT+"
        assert state.labels == ("TT+", "TT-", "TF+", "TF-", "FF+", "FF-")
        assert not state.warnings + state.notes


def test_a_machine_as_built_is_dragged_on_its_branch_and_stays_within_its_limits():
    machine = problems.as_built(PAPER, 2e-2)
    start = spm.forward_physical(machine, [1.25, 1.2, 1.35, 1.3, 1.2, 1.4])
    model = ViewerModel(start)
    target = moved(start.pose, shift=(0.004, -0.003, 0.005), turn=(0.0, 0.003, 0.0))
    state = model.drag(target)
    assert state.distance == 0.0
    again = spm.forward_physical(machine, state.shown.readings)
    np.testing.assert_allclose(again.pose.as_matrix(), target.as_matrix(), atol=1e-9)
    state = model.drag(moved(target, shift=(0.0, 0.0, 0.8)))
    assert state.shown.machine == machine
    assert machine.limits.margin(state.shown.readings) >= -1e-9
    assert 0.1 < state.distance < 0.8
    assert fixed(float(state.shown.readings[0]), 3) in instruments(state)


def test_selecting_a_branch_keeps_the_pose_and_says_what_is_wrong_with_it():
    model = ViewerModel(START)
    state = model.select("FF+")
    assert state.label == "FF+"
    np.testing.assert_allclose(state.shown.pose.as_matrix(), START.pose.as_matrix(), atol=1e-15)
    assert "Beyond the leg limits: r_b1 by 370.2 mm" in " ".join(state.warnings)
    assert not model.select("TT+").warnings
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="label")):
        model.select("FT+")


def test_limits_are_held_once_the_machine_is_inside_them_and_only_then():
    model = ViewerModel(START)
    target = moved(START.pose, shift=(0.0, 0.0, 0.3))
    state = model.drag(target)
    assert state.warnings
    assert not state.shown.limit_excess.any()
    assert state.distance == pytest.approx(spm.workspace.pose_distance(PAPER, state.shown.pose, target))
    np.testing.assert_array_equal(state.target.as_matrix(), target.as_matrix())
    model.hold_limits = False
    state = model.drag(target)
    assert state.distance == 0.0
    assert "Beyond the leg limits" in " ".join(state.warnings)
    model.hold_limits = True
    assert model.drag(moved(target, shift=(0.0, 0.0, 0.01))).distance == 0.0


def test_legs_drive_the_platform_and_stop_before_a_singularity():
    model = ViewerModel(START)
    lengths = np.array([1.25, 1.2, 1.35, 1.3, 1.2, 1.45])
    state = model.set_readings(lengths)
    np.testing.assert_array_equal(state.target.as_matrix(), state.shown.pose.as_matrix())
    np.testing.assert_allclose(state.shown.leg_lengths, lengths, atol=1e-12)
    state = model.set_readings([0.2, 3.0, 0.2, 1.3, 1.3, 1.31])
    assert "not reached: a forward singularity is in the way" in " ".join(state.warnings)
    way = np.array([0.2, 3.0, 0.2, 1.3, 1.3, 1.31]) - lengths
    share = ((state.shown.leg_lengths - lengths) / np.where(way == 0.0, np.nan, way))[way != 0.0]
    np.testing.assert_allclose(share, share[0], atol=1e-9)
    assert 0.05 < share[0] < 1.0


def test_equal_legs_have_no_isolated_branch_and_are_left_again():
    model = ViewerModel(START)
    state = model.set_readings([1.3] * 6)
    assert state.label == ""
    assert state.labels == ()
    assert "continuous family" in " ".join(state.notes)
    assert "inverse" in " ".join(state.warnings)
    json.loads(to_json(model.data()))  # singular, yet JSON
    assert model.drag(START.pose).label == "TT+"


def test_a_crossing_is_named():
    model = ViewerModel(START)
    before = model.state.label
    signs = {np.sign(model.state.singularities.scaled_determinants[2])}
    messages = ""
    for k in range(1, 30):
        state = model.set_readings(START.leg_lengths + 0.01 * k * np.array([0, 0, -1, 0, 0, -1]))
        signs.add(np.sign(state.singularities.scaled_determinants[2]))
        messages += " ".join(state.warnings)
        if len(signs) > 1:
            break
    assert f"A singularity was crossed (inverse): {before} became" in messages
    assert "Singularity ahead (inverse)" in messages


def test_measures_are_those_of_the_library():
    wrench = [10.0, 20.0, -500.0, 5.0, 0.0, 1.0]
    state = ViewerModel(START).load(wrench)
    np.testing.assert_array_equal(state.forces, spm.leg_forces(START, wrench))
    expected = spm.singularities(START)
    np.testing.assert_array_equal(state.singularities.sigma, expected.sigma)
    # The travel predicts where a determinant vanishes: go there along its gradient.
    gradient = spm.kinematics.determinant_gradients(START)[2]
    way = -gradient / np.linalg.norm(gradient) * np.sign(expected.determinants[2])
    singular = spm.forward_physical(PAPER, START.leg_lengths + state.travel[2] * way)
    assert abs(spm.singularities(singular).determinants[2]) < 0.1 * abs(expected.determinants[2])


def test_the_page_places_the_solids_where_pictures_have_them():
    machine = problems.as_built(PAPER, 2e-2)
    pose = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45]).pose
    for state in spm.inverse_displacement(machine, pose):
        if state.exists:
            parts = visual_parts(machine)
            for part, solid, position, quaternion, scale in zip(
                parts, robot_solids(state, frames=False), *solid_placements(state), strict=True
            ):
                turned = Rotation.from_quat(quaternion, scalar_first=True).apply(part.vertices * scale)
                np.testing.assert_allclose(turned + position, solid.vertices, atol=1e-12)


def test_slider_ranges_span_reachable_poses_around_the_state():
    assert (PAPER.limits.margin(sampled_states(PAPER).leg_lengths) >= -1e-12).all()
    model = ViewerModel(START)
    now, ranges = pose_coordinates(START.pose), model.pose_ranges("X-Y-X")
    assert (ranges[:, 0] <= now).all()
    assert (now <= ranges[:, 1]).all()
    assert (np.ptp(ranges, axis=1) < [1.0, 1.0, 1.0, 90.0, 90.0, 90.0]).all()
    assert (np.ptp(ranges, axis=1) > [0.3, 0.3, 0.3, 10.0, 10.0, 10.0]).all()
    np.testing.assert_allclose(model.reading_ranges(), np.tile([1.1, 1.5], (6, 1)), atol=1e-12)
    free = ViewerModel(spm.inverse_displacement(FREE, START.pose).physical()).reading_ranges()
    for k in range(6):
        for end in free[k]:
            assert spm.forward_physical(FREE, np.where(np.arange(6) == k, end, START.leg_lengths)).exists


def test_angles_are_shown_as_roll_pitch_yaw_too():
    rpy = "roll, pitch, yaw"
    model, numbers = ViewerModel(START), pose_coordinates(START.pose, rpy)
    np.testing.assert_allclose(spm.pose(numbers[:3], rpy=np.deg2rad(numbers[3:])).as_matrix(), START.pose.as_matrix())
    np.testing.assert_allclose(model.pose_of(numbers, rpy).as_matrix(), START.pose.as_matrix(), atol=1e-12)
    ranges = model.pose_ranges(rpy)
    assert (ranges[:, 0] <= numbers).all()
    assert (numbers <= ranges[:, 1]).all()
    text = status(model.state, rpy)
    assert f"roll, pitch, yaw = ({', '.join(fixed(x, 1) for x in numbers[3:])})" in text


def test_the_exported_command_and_the_exported_json_hold_the_state():
    chain = spm.ClosedChain.from_urdf()
    model = ViewerModel(START)
    model.load([0.0, 0.0, -500.0, 0.0, 0.0, 0.0])
    content = json.loads(to_json(model.data()))
    np.testing.assert_array_equal(np.array(content["pose"]), START.pose.as_matrix())
    pose = spm.pose(content["translation"], xyx=content["xyx"])
    np.testing.assert_allclose(pose.as_matrix(), START.pose.as_matrix(), atol=1e-14)
    assert np.abs(chain.state(np.array([content["q"][name] for name in chain.joint_names])).closure_gap()).max() < 1e-12
    assert content["branch"] == "TT+"
    assert content["leg_forces"]["r_b1"] == pytest.approx(spm.leg_forces(START, [0, 0, -500, 0, 0, 0])[0])
    words = shlex.split(content["command"])
    assert words[:2] == ["spm-pin", "inverse"]
    branches = {branch["label"]: branch for branch in json.loads(run(*words[1:], "--json").stdout)["branches"]}
    np.testing.assert_allclose(branches["TT+"]["leg_lengths"], START.leg_lengths, atol=1e-12)


def test_arrows_of_loads_point_outwards_where_a_leg_pushes():
    robot, arrows = RobotScene(scene := MagicMock(), PAPER, MagicMock()), {}
    scene.add_arrows.side_effect = lambda name, *_, **__: arrows.setdefault(name, MagicMock())
    robot = RobotScene(scene, PAPER, MagicMock())
    state = ViewerModel(START).load([0.0, 0.0, -500.0, 0.0, 0.0, 0.0])
    robot.show_forces(state)
    begin, end = np.moveaxis(np.asarray(arrows["/load/legs"].points, float), 1, 0)
    out = np.repeat(state.forces[np.abs(state.forces) > 0.02 * np.abs(state.forces).max()] > 0.0, 2)
    # Both arrows of a leg that pushes begin in one point, those of one that pulls end in one.
    apart = [np.linalg.norm(points[::2] - points[1::2], axis=-1) for points in (begin, end)]
    np.testing.assert_array_equal(apart[0] < 1e-6, out[::2])
    np.testing.assert_array_equal(apart[1] < 1e-6, ~out[::2])


def test_the_viewer_shows_what_legs_of_equal_strength_hold():
    robot = RobotScene(scene := MagicMock(), PAPER, MagicMock())
    robot._show_held_forces(START)
    assert not [call for call in scene.add_mesh_simple.call_args_list if call.args[0] == "/forces"]
    robot.layers["forces"] = True
    robot._show_held_forces(START)
    name, points, faces = scene.add_mesh_simple.call_args.args
    assert name == "/forces"
    forces = (np.asarray(points, float) - START.translation) / robot.size
    held = wrench_polytope(START, 1.0)
    assert held.contains(np.pad(0.9999 * forces, ((0, 0), (0, 3)))).all()
    assert not held.contains(np.pad(1.001 * forces, ((0, 0), (0, 3)))).any()
    assert faces.max() == len(points) - 1
    # Gone where the layer is switched off, and where the legs do not hold the platform.
    robot.layers["forces"] = False
    robot._show_held_forces(START)
    scene.remove_by_name.assert_called_once_with("/forces")


LEGS = np.array(
    [[1.20, 1.20, 1.40, 1.25, 1.20, 1.45], [1.25, 1.20, 1.35, 1.25, 1.20, 1.45], [1.3, 1.2, 1.3, 1.3, 1.2, 1.4]]
)
STATES = spm.forward_physical(PAPER, LEGS)
TIMES = np.array([2.0, 3.0, 5.0])


def csv(names, *columns):
    rows = np.column_stack(columns)
    return "\n".join([names, *(", ".join(map(repr, map(float, row))) for row in rows)])


R, POSES = ", ".join(spm.machine.LEGS), np.hstack([STATES.translation, STATES.pose.rotation.as_quat()])
FILES = ["# a comment\n" + csv(f"{R}, time", LEGS, TIMES), csv("time, x, y, z, qx, qy, qz, qw", TIMES, POSES)]


@pytest.mark.parametrize("text", FILES, ids=["legs", "poses"])
def test_all_columns_give_the_same_states(tmp_path, text):
    recording = read_recording(written(tmp_path / "path.csv", text))
    np.testing.assert_allclose(recording.times, [0.0, 1.0, 3.0])
    playback = recording.follow(PAPER)
    assert playback.path.complete
    for time, state in zip(recording.times, STATES, strict=True):
        np.testing.assert_allclose(playback.state_at(float(time)).leg_lengths, state.leg_lengths, atol=1e-9)


def test_without_times_a_path_takes_ten_seconds_and_time_runs_along_it(tmp_path):
    playback = read_recording(written(tmp_path / "legs.csv", csv(R, LEGS))).follow(PAPER)
    assert playback.times[-1] == 10.0
    assert playback.time(0.25) == pytest.approx(2.5)
    np.testing.assert_allclose(playback.state_at(2.5).leg_lengths, LEGS[:2].mean(axis=0), atol=1e-9)
    assert "configurations of" in playback.report(0.0)[0]


def test_the_branch_is_followed_from_the_one_named():
    recording = Recording(STATES.pose, np.array([0.0, 1.0, 2.0]))
    playback = recording.follow(PAPER, "FF+")
    assert set(playback.path.labels) == {"FF+"}
    with pytest.raises(spm.ArgumentError, match="real where the path begins"):
        recording.follow(PAPER, "FT+")


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("path.txt", "", "ending in .csv"),
        ("path.csv", "", "a heading that names the columns"),
        ("path.csv", "x, y, z\n1, 2, 3\n1, 2, 4", "expected the columns r_b1, .*; or x, .*, qw, got positions alone"),
        ("path.csv", "r_b1, r_b2\n1, 2, 3", r"csv:2: expected 2 values, one per column of the heading, got 3"),
        (
            "path.csv",
            "1, 2, 3\n1, 2, 4",
            r"csv:1: .*names the columns.*The first line looks like numbers: is the heading missing\?",
        ),
        ("path.csv", "r_b1, r_b2\n1, 2", "got a heading without r_b3, r_c1, r_c2, r_c3"),
        ("path.csv", csv(R, LEGS[:1]), "at least two rows"),
        ("path.csv", csv(f"{R}, time", LEGS, [0.0, 1.0, 1.0]), "column time in .*csv:4: expected increasing times"),
        ("path.csv", csv("x, y, z, qx, qy, qz, qw", np.ones((2, 7))), "a quaternion of length 1, got length 2"),
        ("path.csv", None, "No such file"),
    ],
)
def test_files_that_are_no_paths(tmp_path, name, text, says):
    path = tmp_path / name if text is None else written(tmp_path / name, text)
    with pytest.raises(spm.ArgumentError, match=says):
        read_recording(path)


def test_a_path_in_millimetres_is_refused_under_the_name_typed(tmp_path):
    file = written(tmp_path / "path.csv", csv(R, 1e3 * LEGS))
    with pytest.raises(spm.ArgumentError, match=r"lengths in metres, got values up to 1450.* is it 1450 mm\?"):
        read_recording(file).follow(PAPER)
    assert "--path: expected lengths in metres, got values up to 1450" in run("view", "--path", file).message


def test_the_motion_of_a_chain_is_read_back(tmp_path):
    chain = spm.ClosedChain.from_urdf()
    poses = STATES.pose
    motion = chain.joint_trajectory(spm.PlatformPath(TIMES, poses), TIMES, chain.joint_values(STATES[0]))
    motion.to_csv(tmp_path / "new folder" / "motion.csv")
    recording = read_recording(tmp_path / "new folder" / "motion.csv")
    np.testing.assert_allclose(recording.points, LEGS, atol=1e-12)
    np.testing.assert_array_equal(recording.times, TIMES - TIMES[0])
    with pytest.warns(UserWarning, match="columns that are not used: time, leg_b1_hip"):
        measured, readings = spm.calibration.read_measurements(tmp_path / "new folder" / "motion.csv")
    np.testing.assert_allclose(measured.as_matrix(), poses.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(readings, recording.points)


def test_servos_are_shown_in_degrees_and_screws_in_metres():
    machine = SERVOS_AND_SCREWS
    model = ViewerModel(spm.forward_physical(machine, [0.4, 0.5, 0.6, 0.10, 0.12, 0.14]))
    np.testing.assert_allclose(model.reading_ranges(), [[-0.5, 1.5]] * 3 + [[-0.05, 0.25]] * 3)
    units = reading_units(machine)
    assert [unit.name for unit in units] == ["°"] * 3 + ["m"] * 3
    assert units[0].factor * np.pi == pytest.approx(180.0)
    state = model.set_readings([-0.6, 0.5, 0.6, 0.10, 0.12, 0.26])
    assert "Beyond the leg limits: r_b1 by 5.7°, r_c3 by 10.0 mm." in " ".join(state.warnings)
    assert "-34.4°" in instruments(state)
    assert "in N m and N" in forces_table(model.load([0.0, 0.0, -50.0, 0.0, 0.0, 0.0]))


BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=np.radians([-35, 70]))
ROLL, TILT = StageModel.conventions


def of_stage():
    return StageModel(spm.inverse_physical(BALANCER, spm.workspace.home_height(BALANCER)))


def test_the_platform_of_a_stage_is_dragged_in_tilt_and_height():
    model = of_stage()
    expected = spm.inverse_physical(BALANCER, 0.12, roll=np.radians(8), pitch=np.radians(-5))
    target = model.pose_of(np.array([120.0, 8.0, -5.0]), ROLL)
    # Wherever it is dragged sideways, and however it is turned about its normal.
    beside = moved(target, shift=(0.03, -0.02, 0.0), turn=0.5 * expected.normal)
    for wanted in (target, beside):
        state = model.drag(wanted)
        assert state.distance == 0.0
        assert not state.warnings
        np.testing.assert_allclose(state.shown.readings, expected.readings, atol=1e-12)
    np.testing.assert_allclose(model.coordinates(state.target, ROLL), [120.0, 8.0, -5.0], atol=1e-12)
    angles = np.degrees([expected.tilt, expected.azimuth])
    np.testing.assert_allclose(model.coordinates(state.target, TILT), [120.0, *angles], atol=1e-12)
    for convention in (ROLL, TILT):
        ranges, now = model.pose_ranges(convention), model.coordinates(state.target, convention)
        assert ((ranges[:, 0] < now) & (now < ranges[:, 1])).all()
    assert "height 120.0 mm, tilt 9.4°, azimuth" in status(state, TILT)


def test_a_stage_dragged_out_of_reach_shows_the_nearest_tilt():
    model = of_stage()
    tilted = {"roll": np.radians(26), "pitch": np.radians(5)}
    target = model.pose_of(np.array([120.0, 26.0, 5.0]), ROLL)
    state = model.drag(target)
    nearest = spm.workspace.nearest_reachable_pose(BALANCER, 0.12, **tilted).configuration
    np.testing.assert_allclose(state.shown.readings, nearest.readings, atol=1e-12)
    np.testing.assert_allclose(state.target.rotation.as_matrix()[:, 2], target.rotation.as_matrix()[:, 2], atol=1e-12)
    assert not state.shown.limit_excess.any()
    apart = np.linalg.norm(spm.Configuration(BALANCER, state.target).balls - nearest.balls, axis=-1)
    assert state.distance == pytest.approx(np.sqrt((apart**2).mean()))
    assert state.warnings
    model.hold_limits = False
    state = model.drag(target)
    assert state.distance == 0.0
    assert "Beyond the leg limits: r_" in state.warnings[-1]
    model = of_stage()
    state = model.set_readings([0.2, 0.4, 0.6])
    np.testing.assert_allclose(state.shown.balls, spm.forward_physical(BALANCER, [0.2, 0.4, 0.6]).balls, atol=1e-14)
    state = model.set_readings([2.6, 0.4, -1.5])
    assert "a forward singularity is in the way" in state.warnings[0]
    way = (state.shown.readings - [0.2, 0.4, 0.6])[::2] / [2.4, -2.1]
    assert 0.05 < way[0] < 1.0
    assert way[1] == pytest.approx(way[0])


def test_a_page_of_a_stage_refuses_what_it_cannot_show():
    level = spm.inverse_physical(BALANCER, 0.12)
    for start in (spm.inverse_physical(BALANCER, [0.11, 0.12]), spm.inverse_displacement(BALANCER, 0.3)["T"]):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="start")):
            Viewer(start, port=0)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="recording")):
        Viewer(level, port=0, recording=Recording(np.zeros((2, 3)), np.array([0.0, 1.0])))
    # Carriages at their pivots are on the other side of the balls.
    with pytest.raises(spm.GeometryError):
        Viewer(spm.Stage(0.3, 0.2, spm.PRS(rod=0.4, direction=0.0, sign=-1)), port=0)


def test_a_page_that_is_changed_after_its_tab_was_closed_prints_no_warning():
    """As a session does whose client has gone, until it notices."""
    level = spm.inverse_physical(BALANCER, 0.12)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with Viewer(level, port=0) as viewer:
            handle = viewer.server.scene.add_frame("/closed")
        handle.position = (1.0, 2.0, 3.0)
    assert not caught


@pytest.mark.parametrize(
    "stage",
    [BALANCER, spm.Stage(0.15, 0.1, spm.PRS(rod=0.2), limits=(0.05, 0.12))],
    ids=["RRS", "PRS"],
)
def test_what_is_shared_of_a_stage_finds_it_again(stage):
    built = stage.perturbed(1)
    shared = StageModel(spm.inverse_physical(built, spm.workspace.home_height(built))).command()
    assert shared.startswith("spm-pin stage inverse --stage FILE --height ")
    model = StageModel(spm.inverse_physical(stage, spm.workspace.home_height(stage)))
    model.hold_limits = False
    height = 1e3 * float(model.state.shown.height)
    state = model.drag(model.pose_of(np.array([height, -14.0, 5.0]), ROLL))
    content = json.loads(to_json(model.data()))
    np.testing.assert_array_equal(content["pose"], state.shown.pose.as_matrix())
    words = shlex.split(content["command"])
    physical = json.loads(run(*words[1:], "--json").stdout)["branches"][0]
    factor = np.pi / 180.0 if stage.unit == "rad" else 1.0
    np.testing.assert_allclose(factor * np.array(physical["readings"]), state.shown.readings, atol=1e-12)
    assert physical["beyond_limits"] == np.flatnonzero(state.shown.limit_excess).tolist()


@pytest.mark.parametrize("machine", ["PRS inclined", "RRS inwards as built"])
def test_the_solids_of_a_stage_are_those_of_the_robot_that_stands_on_it(machine):
    stage, height = stage_and_height(machine)
    state = spm.inverse_physical(stage, height, roll=0.1, pitch=-0.05)
    above = spm.inverse_physical(stage, height, roll=-0.05)
    robot = spm.Manipulator.of_stages(stage, stage)
    both = spm.forward_physical(robot, [*state.readings, *above.readings[::-1]])
    parts = visual_parts(robot)
    lower = [k for k, part in enumerate(parts) if not part.body.startswith(("leg_c", "terminal"))]
    for alone, whole in zip(solid_placements(state), solid_placements(both), strict=True):
        np.testing.assert_allclose(np.abs(alone), np.abs(whole[lower]), atol=1e-9)
