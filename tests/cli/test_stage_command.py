"""`spm-pin stage`: a stage of numbers that a ruler gives, or of a file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli.running import run

import spm_pin as spm

SIZES = ["--base", "80", "--platform", "90", "--crank", "50", "--rod", "110", "--unit", "mm"]
METRES = ["--base", "0.08", "--platform", "0.09", "--crank", "0.05", "--rod", "0.11"]
STAGE = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))


def test_readings_of_a_tilt_and_the_way_back() -> None:
    done = run("stage", "inverse", *SIZES, "--height", "120", "--roll", "8", "--pitch", "-5", "--json")
    content = json.loads(done.stdout)
    expected = spm.inverse_physical(STAGE, 0.12, roll=np.radians(8), pitch=np.radians(-5))
    (mode,) = content["branches"]
    assert content["reading_units"] == ["deg"] * 3
    np.testing.assert_allclose(mode["readings"], np.degrees(expected.readings), atol=1e-9)
    np.testing.assert_allclose(mode["shift"], 1e3 * expected.shift, atol=1e-9)
    back = run("stage", "forward", *SIZES, "--readings", *map(str, mode["readings"]), "--json")
    (state,) = json.loads(back.stdout)["modes"]
    np.testing.assert_allclose([state["roll"], state["pitch"], state["height"]], [8.0, -5.0, 120.0], atol=1e-9)
    wound = run("stage", "inverse", *SIZES, "--height", "120", "--roll", "-352", "--pitch", "355", "--json")
    np.testing.assert_allclose(json.loads(wound.stdout)["branches"][0]["readings"], mode["readings"], atol=1e-9)
    every = run("stage", "forward", *SIZES, "--readings", *map(str, mode["readings"]), "--all").stdout
    assert "T2+" in every
    assert f"Tilt and height of the platform at {', '.join(f'{x:.3f}' for x in mode['readings'])} degrees" in every
    done = run("stage", "forward", *SIZES, "--readings", "0", "0", "400")
    assert "--legs: expected angles of cranks in degrees, of at most one turn, got 400" in done.message
    assert every.count("physical") == 1


def test_what_is_not_reached_has_the_nearest_tilt() -> None:
    done = run("stage", "inverse", *SIZES, "--height", "120", "--tilt", "40", "--azimuth", "30")
    out = done.stdout
    assert done.returncode == 3
    assert "out of reach of r_3" in out
    words, tilt = out.splitlines()[-2:]
    assert words.startswith("The nearest tilt that is reached is 13.648° away:")
    assert tilt.startswith("  --height 120 --tilt 26.351")
    assert " --azimuth 30.00" in tilt or " --azimuth 29.99" in tilt
    limits = ["--limits", "-20", "40"]
    done = run("stage", "inverse", *SIZES, *limits, "--height", "120", "--tilt", "20", "--azimuth", "30")
    out = done.stdout
    assert done.returncode == 5
    assert "59.904*" in out
    assert "* r_3 beyond the limits" in out
    nearest = run("stage", "inverse", *SIZES[:8], *limits, *out.splitlines()[-1].split(), "--json")
    assert nearest.returncode == 0
    assert max(json.loads(nearest.stdout)["branches"][0]["readings"]) == pytest.approx(40.0, abs=0.01)
    forward = run("stage", "forward", *SIZES, "--readings", "100", "100", "100")
    assert forward.returncode == 5
    assert "without a forward or leg singularity. Assembly modes that are real are shown by --all." in forward.stdout


@pytest.mark.parametrize("wanted", [("0", "0"), ("25", "60")])
def test_the_nearest_tilt_is_reached_as_printed_where_the_level_platform_is_not(
    wanted: tuple[str, str], tmp_path: Path
) -> None:
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))
    middle = spm.inverse_physical(stage, 0.12, tilt=0.45, azimuth=0.5).readings
    file, limits = tmp_path / "tilted.yaml", spm.LegLimits(middle - 0.1, middle + 0.1)
    spm.Stage(0.08, 0.09, stage.kind, limits).to_yaml(file)
    done = run("stage", "inverse", "--stage", file, "--height", "0.12", "--tilt", wanted[0], "--azimuth", wanted[1])
    assert done.returncode in (3, 5)
    assert run("stage", "inverse", "--stage", file, *done.stdout.splitlines()[-1].split()).returncode == 0


def test_heights_below_the_pivots_and_in_metres_for_millimetres_have_the_cause() -> None:
    done = run("stage", "inverse", *SIZES, "--height", "-120")
    assert done.returncode == 5
    assert "No mode is physical" in done.stdout
    assert "The height is negative: below the pivots." in done.stdout
    assert " --tilt 0 --azimuth 0 --unit mm" in done.stdout
    for sizes, height in ((SIZES, "0.12"), (["--base", "80", "--platform", "90", "--unit", "mm"], "0.12")):
        assert (
            "In m it would be in proportion: --unit m, for all lengths."
            in run("stage", "inverse", *sizes, "--height", height).stdout
        )


def test_a_file_a_reach_and_pictures(tmp_path: Path) -> None:
    stage = spm.Stage(0.35, 0.2, spm.PRS(rod=0.4), limits=(-0.05, 0.3)).perturbed(1)
    stage.to_yaml(tmp_path / "head.yaml")
    file = ["--stage", str(tmp_path / "head.yaml")]
    content = json.loads(run("stage", "reach", *file, "--directions", "12", "--json").stdout)
    np.testing.assert_allclose(content["height_range"], spm.workspace.height_range(stage))
    expected = spm.workspace.reach(stage, directions=12)
    np.testing.assert_allclose([x["all_round"] for x in content["heights"]], np.degrees(expected.all_round))
    table = run("stage", "reach", *file, "--height", "0.5", "--out", str(tmp_path / "reach.png")).stdout
    assert "limit" in table
    assert (tmp_path / "reach.png").stat().st_size > 10_000
    height, tilt = spm.workspace.best_height(stage, directions=72)
    assert f"best height: {height:.5f} m, {np.degrees(tilt):.2f}° in every direction" in table
    wide = run("stage", "reach", *file, "--height", "2", "--json")
    assert json.loads(wide.stdout)["best_tilt"] == pytest.approx(np.degrees(tilt))
    assert "F " in run("stage", "inverse", "--base", "0.7", "--platform", "0.46", "--height", "1.1").stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (SIZES[:6] + SIZES[8:], "--rod: expected the length of the rods together with --crank"),
        (SIZES[:2], "--platform: expected a radius, or --machine with a file"),
        ([*SIZES, "--slide", "90"], "error: --slide cannot be used with --crank"),
        ([*SIZES, "--sign", "0"], "--sign: expected +1 or -1, the working mode"),
        ([*SIZES, "--limits", "70", "-30"], "--limits: expected minimum < maximum"),
        ([*SIZES, "--azimuth", "10"], "--tilt: expected a tilt together with --azimuth"),
        ([*SIZES, "--tilt", "10", "--pitch", "2"], "expected only one of: tilt and azimuth; roll and pitch; normal"),
        ([*SIZES, "--normal", "0", "0", "0"], "--normal: expected normals of the platform"),
        ([*SIZES, "--limits", "-30", "400"], "--limits: expected angles of cranks in degrees"),
        (METRES, "--height: expected heights in metres"),
        ([*SIZES, "--tilt", "-10", "--azimuth", "0"], "--tilt: expected an angle in degrees, from 0 to less than 180"),
        ([*SIZES, "--stage", "no.yaml"], "error: --machine cannot be used with --base, --platform, --crank, --rod"),
        (["--stage", "no.yaml"], "--machine"),
    ],
)
def test_what_is_wrong_is_named_as_it_was_typed(options: list[str], message: str) -> None:
    done = run("stage", "inverse", *options, "--height", "120")
    assert done.returncode == 2
    assert message in done.message


@pytest.mark.parametrize("place", [["--tilt", "10"], ["--pitch", "10"], ["--normal", "0.17632698", "0", "1"]])
def test_a_tilt_towards_x_of_a_picture_and_of_readings(place: list[str], tmp_path: Path) -> None:
    done = run("stage", "draw", *SIZES, *place, "--out", str(tmp_path / "stage.svg"))
    assert done.returncode == 0, done.message
    home = spm.workspace.home_height(STAGE)
    assert f"height {1e3 * home:.1f} mm" in (tmp_path / "stage.svg").read_text(encoding="utf-8")
    (mode,) = json.loads(run("stage", "inverse", *SIZES, *place, "--json").stdout)["branches"]
    expected = spm.inverse_physical(STAGE, home, tilt=np.radians(10.0), azimuth=0.0)
    np.testing.assert_allclose(mode["readings"], np.degrees(expected.readings), atol=1e-6)


@pytest.mark.parametrize("command", [["view", "--no-open"], ["draw", "--out", "no.png"]])
def test_a_picture_of_what_is_not_reached_is_refused_with_the_nearest(command: list[str]) -> None:
    done = run("stage", command[0], *SIZES, "--tilt", "80", *command[1:])
    assert done.returncode == 2
    assert "--height, --tilt: expected a height and a tilt that the stage reaches" in done.message
    assert "The ball is out of" in done.message
    nearest = done.message.rpartition("The nearest: ")[2]
    assert run("stage", "inverse", *SIZES[:8], *nearest.split()).returncode == 0


def test_readings_typed_in_metres_are_named_where_they_were_read_in_millimetres() -> None:
    done = run("stage", "forward", "--base", "120", "--platform", "115", "--unit", "mm", "--readings", *["0.125"] * 3)
    assert done.returncode == 3
    assert "--legs was read in mm: 0.125 mm, on a machine of 235 mm. In m it would be" in done.stdout


def test_limits_of_a_stage_are_proved(tmp_path: Path) -> None:
    picture = tmp_path / "boxes.png"
    done = run("stage", "certify", *SIZES, "--limits", "18", "22", "--json", "--out", str(picture))
    content = json.loads(done.stdout)
    assert (done.returncode, content["holds"], list(content["bounds"])) == (0, True, ["J"])
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), np.radians([18, 22]))
    assert content["bounds"]["J"] == spm.certify(stage).bounds[0]
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert run("stage", "certify", *SIZES, "--limits", "-90", "170", "--boxes", "100").returncode == 1
    assert run("stage", "certify", *SIZES).returncode == 2
