"""`spm-pin calibrate` and `tolerance`, and the file of a machine as built given to other commands."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from calibration.measured import PAPER, measure, position_errors
from cli import running
from cli.running import run
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics.random_states import random_states

POSE, LEGS = [*running.POSE, "--unit", "cm"], [*running.LEGS, "--unit", "cm"]
MACHINE = PAPER.perturbed(3)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("calibrate") / "measured.csv"
    poses, readings = measure(MACHINE, 1)
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    heading = "x,y,z,qx,qy,qz,qw,r_b1,r_b2,r_b3,r_c1,r_c2,r_c3"
    rows = np.concatenate([poses[:, :3, 3], quaternions, readings], axis=1)
    np.savetxt(file, rows, delimiter=",", header=heading, comments="", fmt="%.9f")
    return file


def test_a_machine_is_identified_and_written(measured: Path, tmp_path: Path) -> None:
    out, figure = tmp_path / "machine.yaml", tmp_path / "errors.png"
    done = run("calibrate", str(measured), "--out", str(out), "--figure", str(figure))
    assert done.returncode == 0, done.stderr
    assert "48 of 54 combinations of parameters identified from 40 measurements" in done.stdout
    assert position_errors(spm.Manipulator.from_yaml(out), MACHINE).max() < 5e-5
    assert figure.stat().st_size > 10_000
    # r_c3, drawn at its limit of 1.5 m, is 0.8 mm beyond it in this machine.
    for code, words, *command in (
        (5, "TT+", "inverse", *POSE),
        (5, "physical*", "singularities", *POSE),
        (0, "physical", "forward", *LEGS),
    ):
        other = run(*command, "--machine", out)
        assert other.returncode == code, other.stderr
        assert words in other.stdout
    pose = json.loads(run("forward", *LEGS, "--machine", out, "--json").stdout)["modes"][0]["translation"]
    expected = spm.forward_physical(spm.Manipulator.from_yaml(out), [float(x) / 100.0 for x in running.LEGS[1:]])
    np.testing.assert_allclose(pose, 100.0 * expected.translation, atol=1e-10)
    again = run("calibrate", str(measured), "--machine", str(out), "--identify", "offset", "--json")
    content = json.loads(again.stdout)
    assert content["identified"] == 6
    assert content["rms"]["position"]["before"] < 3e-5


def test_numbers_of_the_table_are_in_brackets_unless_they_are_known(tmp_path: Path) -> None:
    """A machine made to 0.3 mm, and a tracker twice as noisy as it is said to be: what is not in brackets is near."""
    machine, rng = PAPER.perturbed(2, length=3e-4, angle=3e-4), np.random.default_rng(4)
    states = random_states(machine, 40, rng)
    position, turn = 2e-5 * rng.normal(size=(2, 40, 3))
    quaternions = (Rotation.from_rotvec(turn) * Rotation.from_matrix(states.rotation)).as_quat()
    heading = "x,y,z,qx,qy,qz,qw,r_b1,r_b2,r_b3,r_c1,r_c2,r_c3"
    rows = np.concatenate([states.translation + position, quaternions, states.readings], axis=1)
    np.savetxt(tmp_path / "measured.csv", rows, delimiter=",", header=heading, comments="", fmt="%.17g")
    done = run("calibrate", tmp_path / "measured.csv")
    assert done.returncode == 0, done.stderr
    cells = [line.split()[1:] for line in done.stdout.splitlines() if re.match(r"\W*r_[bc]\d", line)]
    true = 1e3 * (machine.parameters - PAPER.parameters).reshape(6, 9)
    shown = [[cell for cell in row if re.search(r"\d", cell)] for row in cells]
    errors = [
        abs(float(cell) - x) for row, known in zip(shown, true, strict=True) for cell, x in zip(row, known, strict=True)
        if "(" not in cell
    ]  # fmt: skip
    assert 20 < len(errors) < 50
    assert max(errors) < 1.0
    assert "--tolerance SIGMA" in done.stdout
    assert "--tolerance SIGMA" not in run("calibrate", tmp_path / "measured.csv", "--tolerance", "3e-4").stdout


def test_what_is_for_nominal_machines_refuses_a_calibrated_one(tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    MACHINE.to_yaml(file)
    done = run("workspace", "--paper", "--machine", file)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"--machine {file}: expected a nominal machine" in done.stderr


def test_a_file_that_cannot_be_written_after_all_is_named_by_its_option(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr("spm_pin.cli.outputs.check_output", lambda *_: None)
    done = run("calibrate", measured, "--out", tmp_path / "file/built.yaml")
    assert (done.returncode, done.stdout) == (2, "")
    assert "error: --out: expected a file that can be written" in done.message


def test_exchanged_columns_end_with_a_line_on_stderr(measured: Path, tmp_path: Path) -> None:
    wrong, out = tmp_path / "wrong.csv", tmp_path / "machine.yaml"
    wrong.write_text(measured.read_text(encoding="utf-8").replace("r_b1,r_b2", "r_b2,r_b1"), encoding="utf-8")
    done = run("calibrate", wrong, "--out", out)
    assert (done.returncode, out.exists()) == (1, False)
    assert "r_b1 holds r_b2, r_b2 holds r_b1" in done.stderr


def test_a_machine_that_the_measurements_do_not_fit_is_not_written(measured: Path, tmp_path: Path) -> None:
    lines = measured.read_text(encoding="utf-8").splitlines()
    cells = lines[6].split(",")
    cells[9] = str(float(cells[9]) + 0.3)
    lines[6] = ",".join(cells)
    wrong, out = tmp_path / "outlier.csv", tmp_path / "machine.yaml"
    wrong.write_text("\n".join(lines), encoding="utf-8")
    done = run("calibrate", str(wrong), "--out", str(out))
    assert done.returncode == 1
    assert "the measurements do not fit one machine: outlier in row 5. Look at this row" in done.message
    assert "1 outlier (row 5: line 7 of outlier.csv)" in done.stdout
    assert not out.exists()
    forced = run("calibrate", str(wrong), "--out", str(out), "--force", "--json")
    assert forced.returncode == 0
    content = json.loads(forced.stdout)
    assert content["status"] == "outliers"
    assert content["reason_rows"] == content["outliers"] == [5]
    assert position_errors(spm.Manipulator.from_yaml(out), MACHINE).max() < 5e-5


@pytest.fixture(scope="module")
def balancer(tmp_path_factory: pytest.TempPathFactory) -> tuple[spm.Stage, Path]:
    """A stage whose servos are set badly, and a file of what an IMU shows, and a ruler at every other tilt."""
    file = tmp_path_factory.mktemp("calibrate") / "seen.csv"
    parameters = spm.Stage.from_data(BALANCER).parameters
    parameters[8::9][:3] += [0.05, -0.03, 0.02]
    built = spm.Stage.from_data(BALANCER).from_parameters(parameters)
    readings = np.random.default_rng(3).uniform(-0.5, 1.0, (40, 3))
    states = spm.forward_physical(built, readings)
    states = states[states.exists]
    roll, pitch, _ = states.pose.rotation.as_euler("xyz").T
    rows = zip(roll, pitch, states.height, *states.readings.T, strict=True)
    lines = [",".join(f"{x:.6f}" for x in row) for row in rows]
    lines[::2] = [",".join([*line.split(",")[:2], "", *line.split(",")[3:]]) for line in lines[::2]]
    file.write_text("\n".join(["roll,pitch,height,r_1,r_2,r_3", *lines]), encoding="utf-8")
    return built, file


BALANCER = {
    "base_radius": 0.08,
    "platform_radius": 0.09,
    "legs": {"kind": "RRS", "crank": 0.05, "rod": 0.11},
    "limits": [-0.6, 1.2],
}
NUMBERS = ["--base", "80", "--platform", "90", "--crank", "50", "--rod", "110", "--unit", "mm"]


def test_a_stage_is_identified_and_written(balancer: tuple[spm.Stage, Path], tmp_path: Path) -> None:
    built, file = balancer
    out, figure = tmp_path / "built.yaml", tmp_path / "errors.png"
    command = "stage", "calibrate", file, "--identify", "offset"
    done = run(*command, *NUMBERS, "--out", out, "--figure", figure)
    assert done.returncode == 0, done.stderr
    assert "3 of 3 combinations of parameters identified" in done.stdout
    found = spm.Stage.from_yaml(out)
    np.testing.assert_allclose(found.legs.offsets, built.legs.offsets, atol=1e-5)
    assert figure.stat().st_size > 10_000
    again = run("stage", "forward", "--stage", out, "--readings", "20", "30", "10", "--json")
    state = spm.forward_physical(built, np.radians([20, 30, 10]))
    assert json.loads(again.stdout)["modes"][0]["tilt"] == pytest.approx(np.degrees(state.tilt), abs=1e-3)
    frames = json.loads(run(*command, "--stage", out, "--frames", "--json").stdout)
    assert (frames["status"], frames["identified"]) == ("fits", 12)
    np.testing.assert_allclose(frames["base"], np.eye(4), atol=1e-3)


def test_tolerances_of_some_dimensions_hold_them(balancer: tuple[spm.Stage, Path]) -> None:
    built, file = balancer
    typed = "--tolerance", "1e-6", "--tolerance", "offset=0.05"
    content = json.loads(run("stage", "calibrate", file, *NUMBERS, *typed, "--json").stdout)
    assert content["status"] == "fits"
    expected = dict(zip(built.parameter_names, built.parameters, strict=True))
    for name, value in content["parameters"].items():
        assert value == pytest.approx(expected[name], abs=1e-3 if name.endswith("offset") else 5e-6)


@pytest.mark.parametrize("is_stage", [False, True])
def test_tolerances_are_weighed(is_stage: bool, tmp_path: Path) -> None:
    machine = spm.Stage.from_data(BALANCER) if is_stage else PAPER
    machine.to_yaml(tmp_path / "machine.yaml")
    command = [*["stage"] * is_stage, "tolerance", "--machine", tmp_path / "machine.yaml", "--samples", "0"]
    content = json.loads(run(*command, "--by", "leg", "--json").stdout)
    kinds = ("direction", "pivot", "ball", "offset", "rod", "crank")
    table = dict.fromkeys(kinds if is_stage else kinds[:4], 1e-4)
    expected = spm.calibration.tolerance(machine, table, samples=0, rng=0)
    assert content["rms"]["position"] == pytest.approx(expected.rms[0])
    assert content["shares"] == pytest.approx(dict(expected.ranking("leg")))
    shown = run(*command, "--by", "kind", "--offset", "0").stdout
    assert next(line for line in shown.splitlines() if "offset" in line).split() == ["offset", "0.0%"]
    assert run(*command, "--by", "machine").returncode == 2
