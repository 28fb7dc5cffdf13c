"""`spm-pin reproduce`, `inverse`, `forward`, `statics` and `singularities`."""

from __future__ import annotations

import json
import re
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from cli import running
from cli.running import run

import spm_pin as spm
from spm_pin.crosscheck.paper import published
from spm_pin.workspace import poses

EXAMPLE, LEGS = [*running.POSE, "--unit", "cm"], [*running.LEGS, "--unit", "cm"]


def test_inverse_in_every_unit_and_as_json() -> None:
    pose = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))
    expected = spm.inverse_displacement(spm.Manipulator.paper(), pose)
    for unit, per_metre in (("m", 1.0), ("cm", 100.0), ("mm", 1000.0)):
        position = [str(per_metre * x / 100.0) for x in published.POSITION]
        done = run("inverse", "--translation", *position, *EXAMPLE[4:8], "--unit", unit, "--json")
        content = json.loads(done.stdout)
        assert content["status"] == "ok"
        assert [branch["label"] for branch in content["branches"]] == ["TT+", "TT-", "TF+", "TF-", "FF+", "FF-"]
        lengths = [branch["leg_lengths"] for branch in content["branches"]]
        np.testing.assert_allclose(lengths, per_metre * expected.leg_lengths[expected.exists], rtol=1e-12)
    shown = run("inverse", *EXAMPLE).stdout
    (line,) = [line for line in shown.splitlines() if "TT+" in line]
    assert line.split() == ["TT+", "119.982", "119.996", "139.856", "125.012", "120.004", "150.127*", "physical"]


def test_singularities_of_each_branch() -> None:
    content = json.loads(run("singularities", *EXAMPLE, "--json").stdout)
    assert list(content["branches"]) == ["TT+", "TT-", "TF+", "TF-", "FF+", "FF-"]
    assert {branch["kind"] for branch in content["branches"].values()} == {"regular"}
    pose = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))
    expected = spm.singularities(spm.inverse_displacement(spm.Manipulator.paper(), pose)["TT-"])
    np.testing.assert_allclose(
        list(content["branches"]["TT-"]["scaled_determinants"].values()), expected.scaled_determinants, rtol=1e-12
    )
    assert "TT-" not in run("singularities", *EXAMPLE, "--branch", "TT+").stdout


@pytest.mark.parametrize("command", [["statics", "--force", "0", "0", "-100"], ["singularities"]])
def test_every_answer_marks_the_physical_branch_and_those_beyond_the_limits(command: list[str]) -> None:
    done = run(*command, *EXAMPLE)
    ends = [line.split()[-1] for line in done.stdout.splitlines() if line.startswith((" T", " F"))]
    assert (done.returncode, ends) == (5, ["physical*", *"*****"])
    assert "* a leg beyond the limits; of the physical branch: r_c3" in done.stdout
    content = json.loads(run(*command, *EXAMPLE, "--json").stdout)["branches"]
    assert [label for label, row in content.items() if row["physical"]] == ["TT+"]
    assert (content["TT+"]["within_limits"], content["TT+"]["beyond_limits"]) == (False, [5])
    # Leg lengths within the limits, whose pose they are, and those of the level home, whose pose has no branches.
    for legs in (LEGS, ["--legs", *["1.3"] * 6]):
        given = run(*command, *legs)
        assert (given.returncode, given.stdout.count("physical"), "*" in given.stdout) == (0, 1, False)
    for wrong in ([], [*EXAMPLE, *LEGS[:7]]):
        assert "--legs: expected readings or a pose" in run(*command, *wrong).message
    far = run(*command, "--legs", *"111911")
    assert (far.returncode, "A stage cannot be closed" in far.stdout) == (3, True)


@pytest.mark.parametrize("command", [["inverse"], ["statics", "--force", "0", "0", "-100"], ["singularities"]])
def test_a_pose_that_is_not_reached_has_the_nearest_one_and_its_unit_of_angles(command: list[str]) -> None:
    with patch.object(poses, "nearest_reachable_pose", wraps=poses.nearest_reachable_pose) as search:
        done = run(*command, "--translation", "0.1", "0", "2.4", "--rpy", "0.1", "0.2", "0")
    assert search.call_count == 1
    text = done.stdout + done.stderr
    assert done.returncode == 3
    assert "It is turned by 0.22° only: angles are in degrees." in text
    nearest = text[text.index("The nearest pose within the limits is") :].splitlines()[1].split()
    there = run("inverse", *nearest, "--json")
    assert (there.returncode, json.loads(there.stdout)["nearest"]) == (0, None)


@pytest.mark.parametrize(("option", "count"), [("--rpy", 3), ("--quat", 4)])
def test_forward_prints_an_orientation_as_inverse_reads_it(option: str, count: int) -> None:
    out = forward(*LEGS, option)
    (line,) = [line for line in out.splitlines() if line.endswith("physical")]
    numbers = line.split()[1:-1]
    assert len(numbers) == 3 + count
    back = run("inverse", "--translation", *numbers[:3], option, *numbers[3:], "--unit", "cm")
    (row,) = [line for line in back.stdout.splitlines() if line.endswith("physical")]
    np.testing.assert_allclose(
        [float(x.strip("*")) for x in row.split()[1:7]], [float(x) for x in LEGS[1:7]], atol=5e-3
    )
    assert re.search(r"closure residual up to \S+ cm", out)
    assert "--xyx and --quat" in run("forward", *LEGS, "--xyx", "--quat").message


def forward(*arguments: str, code: int = 0) -> str:
    done = run("forward", *arguments)
    assert done.returncode == code, done.stderr
    return done.stdout


def test_forward_as_json_and_in_centimetres() -> None:
    readings, factor = np.array([1.2, 1.2, 1.4, 1.25, 1.2, 1.5]), 100.0
    command = ["--legs", *map(str, factor * readings), "--unit", "cm", "--json"]
    content = json.loads(forward(*command, "--all"))
    assert (content["unit"], content["status"], content["count"]) == ("cm", "ok", 144)
    assert len(content["modes"]) == 144
    # By another way to the same configuration: as many digits as a pose has.
    (alone,) = json.loads(forward(*command))["modes"]
    assert [mode["label"] for mode in content["modes"] if mode["physical"]] == [alone["label"]]
    expected = spm.forward_displacement(spm.Manipulator.paper(), readings)
    for mode in (*content["modes"], alone):
        state = expected[mode["label"]]
        for key in ("translation", "middle_joints"):
            np.testing.assert_allclose(mode[key], factor * getattr(state, key), rtol=0, atol=1e-13 * factor)
        for written in ({"rotation": mode["rotation"]}, {"rpy": np.deg2rad(mode["rpy"])}, {"quat": mode["quat"]}):
            matrix = spm.pose([0, 0, 1], **written).rotation.as_matrix()
            np.testing.assert_allclose(matrix, state.rotation, rtol=0, atol=1e-13)


def test_a_continuous_family_is_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("base_radius: 1.0\nplatform_radius: 0.7\nmiddle_side: 2.0\n", encoding="utf-8")
    out = " ".join(forward("--legs", "1", "3", "1", "2", "2", "2", "--machine", str(path), code=4).split())
    assert "status: degenerate" in out
    assert "continuous family of dimension 1" in out
