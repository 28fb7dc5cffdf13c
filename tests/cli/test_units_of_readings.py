"""Readings of servos in degrees and of screws in --unit, as commands take and show them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli.running import run

import spm_pin as spm
from spm_pin.machine import PRS, RRS, Stage

MACHINE = spm.Manipulator.of_stages(
    Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(0.1, 0.9)),
    Stage(0.20, 0.25, PRS(rod=0.30), limits=(0.0, 0.2)),
)
READINGS = np.array([0.4, 0.5, 0.6, 0.10, 0.12, 0.14])
TYPED = [f"{x:.9f}" for x in (*np.rad2deg(READINGS[:3]), *1e3 * READINGS[3:])]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("servos") / "servos.yaml"
    MACHINE.to_yaml(path)
    return path


def test_readings_lead_to_a_pose_and_back(file: Path) -> None:
    done = run("forward", "--legs", *TYPED, "--unit", "mm", "--machine", file, "--quat", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["reading_units"] == ["deg"] * 3 + ["mm"] * 3
    mode = content["modes"][0]
    expected = spm.forward_physical(MACHINE, READINGS)
    np.testing.assert_allclose(mode["translation"], 1e3 * expected.translation, atol=1e-5)
    pose = ["--translation", *map(repr, mode["translation"]), "--quat", *map(repr, mode["quat"])]
    back = run("inverse", *pose, "--unit", "mm", "--machine", file)
    assert back.returncode == 0, back.stderr
    assert "Real branches: readings in degrees (r_b1 to r_b3) and mm (r_c1 to r_c3)" in back.stdout
    row = next(line for line in back.stdout.splitlines() if "physical" in line).split()
    np.testing.assert_allclose(np.array(row[1:7], dtype=float), np.array(TYPED, dtype=float), atol=6e-3)
    branches = json.loads(run("inverse", *pose, "--unit", "mm", "--machine", file, "--json").stdout)["branches"]
    physical = next(branch for branch in branches if branch["physical"])
    np.testing.assert_allclose(physical["readings"], np.array(TYPED, dtype=float), atol=1e-4)
    np.testing.assert_allclose(physical["leg_lengths"], 1e3 * expected.leg_lengths, atol=1e-4)


def test_efforts_are_torques_and_rates_degrees_per_second(file: Path) -> None:
    load = ["--force", "0", "0", "-50", "--angular-velocity", "0", "5", "0"]
    done = run("statics", "--legs", *TYPED, *load, "--unit", "mm", "--machine", file)
    assert done.returncode == 0, done.stderr
    assert "Efforts in N m (r_b1 to r_b3) and N (r_c1 to r_c3): positive increases the reading" in done.stdout
    assert "Rates of the readings per second, in degrees (r_b1 to r_b3) and mm (r_c1 to r_c3)" in done.stdout
    content = json.loads(run("statics", "--legs", *TYPED, *load, "--unit", "mm", "--machine", file, "--json").stdout)
    (branch,) = content["branches"].values()
    state = spm.forward_physical(MACHINE, READINGS)
    np.testing.assert_allclose(branch["forces"], spm.leg_forces(state, [0, 0, -50, 0, 0, 0]), rtol=1e-6)
    rates = spm.leg_rates(state, [0, 0, 0, 0, np.deg2rad(5.0), 0]) * np.repeat([180.0 / np.pi, 1e3], 3)
    np.testing.assert_allclose(branch["rates"], rates, rtol=1e-6)


def test_a_unit_of_length_is_hinted_at_by_lengths_alone(file: Path) -> None:
    wrong = [*TYPED[:3], *(f"{x:.6f}" for x in 1e3 * READINGS[3:])]
    done = run("statics", "--legs", *wrong, "--force", "0", "0", "-9", "--machine", file)
    assert done.returncode == 3
    assert "--legs was read in m: 140 m" in done.stdout
    # Ten degrees are no ten metres.
    near = run("forward", "--legs", "25", "27", "29", "0.1", "0.12", "0.14", "--machine", file)
    assert near.returncode == 0, near.stdout


def test_no_unit_of_length_is_hinted_at_by_limits_of_cranks(tmp_path: Path) -> None:
    servos = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35))
    spm.Manipulator.of_stages(servos, servos).to_yaml(tmp_path / "servos.yaml")
    ends = ("--from", *["30"] * 6, "--to", *["40"] * 6, "--leg-force", "9", "--machine", tmp_path / "servos.yaml")
    for command in (("move", *ends, "--limits", "5", "20"), ("workspace", *ends[-2:], "--limits", "50", "5")):
        assert "cm" not in run(*command).message


def test_what_is_outside_the_limits_is_starred_in_its_own_unit(file: Path) -> None:
    done = run("forward", "--legs", "60", *TYPED[1:], "--unit", "mm", "--machine", file)
    assert done.returncode == 5
    assert "* r_b1 beyond the limits" in done.stdout
