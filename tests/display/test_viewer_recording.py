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
TIMES = np.array([2.0, 3.0, 5.0])


def csv(names, *columns):
    rows = np.column_stack(columns)
    return "\n".join([names, *(", ".join(map(repr, map(float, row))) for row in rows)])


R = ", ".join(spm.mechanism.LEGS)
FILES = {
    "legs": "# a comment\n" + csv(f"{R}, t", LEGS, TIMES),
    "angles": csv("x, y, z, alpha_deg, beta_deg, lambda_deg, t", STATES.translation, XYX, TIMES),
    "turns": csv("t, x, y, z, qx, qy, qz, qw", TIMES, STATES.translation, STATES.pose.rotation.as_quat()),
}


@pytest.mark.parametrize("name", FILES)
def test_all_columns_give_the_same_states(tmp_path, name):
    recording = read_recording(written(tmp_path / "path.csv", FILES[name]))
    np.testing.assert_allclose(recording.times, [0.0, 1.0, 3.0])
    playback = recording.follow(PAPER)
    assert playback.path.complete
    assert playback.duration == 3.0
    for time, state in zip(recording.times, STATES, strict=True):
        np.testing.assert_allclose(playback.state_at(float(time)).leg_lengths, state.leg_lengths, atol=1e-9)


def test_without_times_a_path_takes_ten_seconds_and_time_runs_along_it(tmp_path):
    playback = read_recording(written(tmp_path / "legs.csv", csv(R, LEGS))).follow(PAPER)
    assert playback.duration == 10.0
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
        ("path.csv", "", "a header of the columns"),
        ("path.csv", "x, y, z\n1, 2, 3\n1, 2, 4", "expected the columns"),
        ("path.csv", "x, y, phi\n1, 2, 3", "a header of the columns"),
        ("path.csv", "r_b1, r_b2\n1, 2, 3", "rows or more of 2 finite numbers"),
        ("path.csv", "r_b1, r_b2\n1, two", "then numbers only"),
        ("path.csv", csv(R, LEGS[:1]), "two rows or more"),
        ("path.csv", csv(R, [[np.nan] * 6, [1.0] * 6]), "finite"),
        ("path.csv", csv(f"{R}, t", LEGS, [0.0, 1.0, 1.0]), "growing times"),
        ("path.csv", csv("x, y, z, qx, qy, qz, qw", np.ones((2, 7))), "unit quaternions"),
        ("path.csv", None, "No such file"),
    ],
)
def test_files_that_are_no_paths(tmp_path, name, text, says):
    path = tmp_path / name if text is None else written(tmp_path / name, text)
    with pytest.raises(spm.ArgumentError, match=says):
        read_recording(path)
