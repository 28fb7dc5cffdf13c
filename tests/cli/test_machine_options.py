"""A machine by its file or by numbers, for every command, and the same commands for a manipulator and for a stage."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli import running
from cli.running import run

import spm_pin as spm

ROBOT = ["--base", "70", "--platform", "35", "--middle", "80", "--unit", "cm"]
SIZES = ["--base", "80", "--platform", "90", "--crank", "50", "--rod", "110", "--unit", "mm"]
STAGE = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "spm_pin", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"spm-pin {spm.__version__}"


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ([*ROBOT, "--limits", "110", "150"], spm.Manipulator(0.7, 0.35, 0.8, spm.LegLimits(1.1, 1.5))),
        (
            ["--base", "30", "--platform", "25", "--middle", "40", "--crank", "15", "--rod", "35", "--unit", "cm"],
            spm.Manipulator(0.3, 0.25, 0.4, legs=(spm.RRS(crank=0.15, rod=0.35),) * 2),
        ),
        (
            [*SIZES, "--limits", "-30", "40,50,60"],
            spm.Stage(0.08, 0.09, STAGE.kind, np.radians([[-30] * 3, [40, 50, 60]])),
        ),
    ],
)
def test_numbers_describe_a_machine_and_a_file_keeps_it(
    command: list[str], expected: spm.machine.Machine, tmp_path: Path
) -> None:
    file = tmp_path / "machine.yaml"
    assert run("write", *command, "--out", file).returncode == 0
    assert type(expected).from_yaml(file) == expected


def test_a_command_for_the_other_kind_is_named(tmp_path: Path) -> None:
    STAGE.to_yaml(tmp_path / "stage.yaml")
    commands = (["inverse", *running.POSE], ["draw", "--out", tmp_path / "x.png"])
    for command, machine in itertools.product(commands, (["--machine", tmp_path / "stage.yaml"], SIZES)):
        done = run(*command, *machine)
        assert done.returncode == 2
        assert "expected a manipulator, got a stage. For a stage: spm-pin stage" in done.message


def test_forces_and_rates_of_a_stage() -> None:
    state = spm.inverse_physical(STAGE, 0.12, tilt=np.radians(10.0), azimuth=0.0)
    place = ["--height", "120", "--tilt", "10"]
    load = ["--force", "1", "2", "-5", "--velocity", "0", "0", "3", "--angular-velocity", "4", "5", "0"]
    content = json.loads(run("stage", "statics", *SIZES, *place, *load, "--json").stdout)
    branch = content["branches"]["T"]
    np.testing.assert_allclose(branch["forces"], spm.leg_forces(state, [1, 2, -5, 0, 0, 0]), rtol=1e-9)
    rates = spm.leg_rates(state, [3e-3, *np.radians([4.0, 5.0])])
    np.testing.assert_allclose(branch["rates"], np.degrees(rates), rtol=1e-9)
    by_readings = ["--legs", *map(repr, np.degrees(state.readings).tolist())]
    again = json.loads(run("stage", "statics", *SIZES, *by_readings, *load, "--json").stdout)
    np.testing.assert_allclose(again["branches"]["T"]["forces"], branch["forces"], rtol=1e-6)
    refused = run("stage", "statics", *SIZES, "--velocity", "1", "0", "0")
    assert "expected a velocity along Z and turns about X and Y" in refused.message


def test_the_nearest_tilt_of_a_stage_is_reached() -> None:
    limits = ["--limits", "-35", "70"]
    done = run("stage", "nearest", *SIZES, *limits, "--height", "120", "--tilt", "40")
    assert done.returncode == 0
    options = done.stdout.partition("pose: ")[2].split()
    reached = json.loads(run("stage", "inverse", *SIZES[:8], *limits, *options, "--json").stdout)["branches"][0]
    tilt, azimuth = np.radians([reached["tilt"], reached["azimuth"]])
    cosine = np.sin(tilt) * np.cos(azimuth) * np.sin(np.radians(40.0)) + np.cos(tilt) * np.cos(np.radians(40.0))
    assert float(done.stdout.partition("distance: ")[2].partition("°")[0]) == pytest.approx(
        np.degrees(np.arccos(cosine)), abs=0.01
    )
    wanted = json.loads(run("stage", "nearest", *SIZES, *limits, "--height", "120", "--tilt", "10", "--json").stdout)
    assert (wanted["tilt"], wanted["distance"]) == (pytest.approx(10.0, abs=1e-9), 0.0)


@pytest.mark.parametrize("height", ["300", "45", "-120"])
def test_heights_that_are_not_reached_have_one_that_is(height: str) -> None:
    done = run("stage", "nearest", *SIZES, "--height", height, "--tilt", "20")
    assert done.returncode == 0
    options = done.stdout.partition("pose: ")[2].split()
    assert run("stage", "inverse", *SIZES[:8], *options).returncode == 0


def test_a_stage_moves_between_tilts_by_their_options() -> None:
    ends = ["--from-height", "120", "--to-height", "120", "--to-tilt", "5", "--limits", "5", "45"]
    done = run("stage", "move", *SIZES, *ends, "--leg-acceleration", "100", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    expected = spm.inverse_physical(STAGE, 0.12, tilt=np.radians([0.0, 5.0]), azimuth=0.0).readings
    found = np.array([content[name] for name in STAGE.legs.names])[:, [0, -1]].T
    np.testing.assert_allclose(found, expected, atol=1e-9)
