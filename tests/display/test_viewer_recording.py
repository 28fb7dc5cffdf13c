"""Recorded paths in a viewer: valid and invalid files, and playback."""

from __future__ import annotations

import numpy as np
import pytest
from text_files import written

import spm_pin as spm
from spm_pin.display import Recording, read_recording

PAPER = spm.Geometry.paper()
LEGS = np.array(
    [[1.20, 1.20, 1.40, 1.25, 1.20, 1.45], [1.25, 1.20, 1.35, 1.25, 1.20, 1.45], [1.3, 1.2, 1.3, 1.3, 1.2, 1.4]]
)
STATES = spm.forward_physical(PAPER, LEGS)
TIMES = np.array([2.0, 3.0, 5.0])


def csv(names, *columns):
    rows = np.column_stack(columns)
    return "\n".join([names, *(", ".join(map(repr, map(float, row))) for row in rows)])


R = ", ".join(spm.mechanism.LEGS)
FILES = {
    "legs": "# a comment\n" + csv(f"{R}, time", LEGS, TIMES),
    "turns": csv("time, x, y, z, qx, qy, qz, qw", TIMES, STATES.translation, STATES.pose.rotation.as_quat()),
}


@pytest.mark.parametrize("name", FILES)
def test_all_columns_give_the_same_states(tmp_path, name):
    recording = read_recording(written(tmp_path / "path.csv", FILES[name]))
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
        ("path.csv", "u, v, phi\n1, 2, 3", "got neither"),
        ("path.csv", "r_b1, r_b2\n1, 2, 3", r"csv:2: expected 2 values, one per column of the heading, got 3"),
        (
            "path.csv",
            "1, 2, 3\n1, 2, 4",
            r"csv:1: .*names the columns.*The first line looks like numbers: no heading\?",
        ),
        ("path.csv", csv("x, y, z, qx, qy, qz, qw", np.zeros((2, 7))), r"a quaternion of length 1, got length 0$"),
        ("path.csv", "r_b1, r_b2\n1, 2", "got one without r_b3, r_c1, r_c2, r_c3"),
        ("path.csv", csv(R, LEGS[:1]), "two rows or more"),
        ("path.csv", csv(R, [[np.nan] * 6, [1.0] * 6]), "column r_b1 in .*csv:2: expected a finite number, got 'nan'"),
        ("path.csv", csv(f"{R}, time", LEGS, [0.0, 1.0, 1.0]), "column time in .*csv:4: expected increasing times"),
        ("path.csv", csv("x, y, z, qx, qy, qz, qw", np.ones((2, 7))), "a quaternion of length 1, got length 2"),
        ("path.csv", None, "No such file"),
    ],
)
def test_files_that_are_no_paths(tmp_path, name, text, says):
    path = tmp_path / name if text is None else written(tmp_path / name, text)
    with pytest.raises(spm.ArgumentError, match=says) as error:
        read_recording(path)
    assert len(str(error.value).replace(str(path), "path.csv")) < 3 * 80


def test_a_path_in_millimetres_is_refused(tmp_path):
    recording = read_recording(written(tmp_path / "path.csv", csv(R, 1e3 * LEGS)))
    with pytest.raises(spm.ArgumentError, match=r"lengths in metres, got values up to 1450.* is it 1450 mm\?"):
        recording.follow(PAPER)


def test_the_motion_of_a_chain_is_read_back(tmp_path):
    chain = spm.ClosedChain.from_urdf()
    poses = STATES.pose
    motion = chain.joint_trajectory(spm.PlatformPath(TIMES, poses), TIMES, chain.joint_values(STATES[0]))
    motion.to_csv(tmp_path / "new folder" / "motion.csv")
    recording = read_recording(tmp_path / "new folder" / "motion.csv")
    np.testing.assert_allclose(recording.points, LEGS, atol=1e-12)
    np.testing.assert_array_equal(recording.times, TIMES - TIMES[0])
    measured, readings = spm.calibration.read_measurements(tmp_path / "new folder" / "motion.csv")
    np.testing.assert_allclose(measured.as_matrix(), poses.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(readings, recording.points)
