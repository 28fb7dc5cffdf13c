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
XYX = STATES.pose.rotation.as_euler("XYX", degrees=True)


def csv(names, table):
    return "\n".join([", ".join(names), *(", ".join(map(repr, map(float, row))) for row in table)])


def files(tmp_path):
    times = np.array([2.0, 3.0, 5.0])
    position, quaternion = STATES.translation, STATES.pose.rotation.as_quat()
    legs = csv([*spm.mechanism.LEGS, "t"], np.column_stack([LEGS, times]))
    angles = csv(["x", "y", "z", "alpha_deg", "beta_deg", "lambda_deg", "t"], np.column_stack([position, XYX, times]))
    turns = csv(["t", "x", "y", "z", "qx", "qy", "qz", "qw"], np.column_stack([times, position, quaternion]))
    yield written(tmp_path / "legs.csv", "# a comment\n" + legs)
    yield written(tmp_path / "angles.csv", angles)
    yield written(tmp_path / "turns.csv", turns)


def test_all_columns_give_the_same_states(tmp_path):
    paths = list(files(tmp_path))
    assert len(paths) == 3
    for path in paths:
        recording = read_recording(path)
        np.testing.assert_allclose(recording.times, [0.0, 1.0, 3.0])
        playback = recording.follow(PAPER)
        assert playback.path.complete
        assert playback.duration == 3.0
        for time, state in zip(recording.times, STATES, strict=True):
            found, _ = playback.state_at(float(time))
            np.testing.assert_allclose(found.leg_lengths, state.leg_lengths, atol=1e-9)


def test_without_times_a_path_takes_ten_seconds_and_time_runs_along_it(tmp_path):
    path = written(tmp_path / "legs.csv", csv(spm.mechanism.LEGS, LEGS))
    playback = read_recording(path).follow(PAPER)
    assert playback.duration == 10.0
    assert playback.time(0.25) == pytest.approx(2.5)
    halfway, _ = playback.state_at(2.5)
    np.testing.assert_allclose(halfway.leg_lengths, LEGS[:2].mean(axis=0), atol=1e-9)
    assert any("in certified limits" in line for line in playback.report(0.0))


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
        ("path.csv", "", "a header of the columns"),
        ("path.csv", "x, y, z\n1, 2, 3\n1, 2, 4", "expected the columns"),
        ("path.csv", "x, y, phi\n1, 2, 3", "a header of the columns"),
        ("path.csv", "r_b1, r_b2\n1, 2, 3", "rows or more of 2 finite numbers"),
        ("path.csv", "r_b1, r_b2\n1, two", "then numbers only"),
        ("path.csv", csv(spm.mechanism.LEGS, LEGS[:1]), "two rows or more"),
        ("path.csv", csv(spm.mechanism.LEGS, [[np.nan] * 6, [1.0] * 6]), "finite"),
        ("path.csv", csv([*spm.mechanism.LEGS, "t"], np.column_stack([LEGS, [0.0, 1.0, 1.0]])), "growing times"),
        ("path.csv", csv(["x", "y", "z", "qx", "qy", "qz", "qw"], np.ones((2, 7))), "unit quaternions"),
    ],
)
def test_files_that_are_no_paths(tmp_path, name, text, says):
    with pytest.raises(spm.ArgumentError, match=says):
        read_recording(written(tmp_path / name, text))


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(spm.ArgumentError, match="No such file"):
        read_recording(tmp_path / "nothing.csv")
