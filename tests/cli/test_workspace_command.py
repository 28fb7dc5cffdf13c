"""`spm-pin workspace`, and `sweep`, in this process and in one of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
import xarray
from cli.running import COMMAND, run
from stores import contents, records

import spm_pin as spm
from spm_pin.sweeps import METRICS, leg_sample, pose_grid

FEW = ["workspace", "--paper", "--resolution", "6"]


def test_workspace_prints_the_patches_the_volume_and_its_convergence() -> None:
    done = run(*FEW, "--limits", "110", "150", "--unit", "cm")
    assert done.returncode == 0, done.stderr
    out = done.stdout
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line.strip().startswith("S")}
    assert len(rows) == 24
    assert rows["St3"][:6] == ["max", "min~max", "min~max", "max", "max", "max"]
    assert float(rows["St1"][6]) == pytest.approx(8473.9, rel=1e-2)
    assert "misprints read: r_b1 of St3, r_b3 of Sm3, r_b3 of Sm5" in out
    (volume,) = [line for line in out.splitlines() if line.startswith("volume")]
    _, value, _, error, unit = volume.split()
    assert float(value) == pytest.approx(1.653e6, rel=1e-3)
    assert 0.0 < float(error) < 1e3
    assert unit == "cm³"


def test_workspace_finds_what_this_machine_reaches(tmp_path: Path) -> None:
    machine, path = spm.Manipulator.paper().perturbed(1, length=5e-3, angle=5e-3), tmp_path / "built.yaml"
    machine.to_yaml(path)
    options = ["--machine", str(path), "--unit", "cm", "--spacing", "80"]
    done = run("workspace", *options, "--out", str(tmp_path / "reached.stl"), "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    boundary = spm.workspace.reachable_boundary(machine, spacing=0.4)
    mesh = trimesh.load_mesh(tmp_path / "reached.stl")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(boundary.volume, rel=1e-5)
    assert content["volume"] == pytest.approx(1e6 * boundary.volume, abs=1.1e6 * content["volume_error"] / 1e6 + 1.0)
    assert content["limits"]["maximum"] == pytest.approx([150.0] * 6)
    assert "misprints" not in done.stdout


def test_limits_from_the_file_of_the_machine(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    machine = spm.Manipulator(0.7, 0.35, 0.8)
    machine.to_yaml(path)
    done = run(*FEW, "--machine", path)
    assert done.returncode == 2
    assert done.message.startswith("error: --limits: ")
    limits = spm.LegLimits([1.1] * 3 + [1.2] * 3, [1.5] * 3 + [1.4] * 3)
    spm.Manipulator(0.7, 0.35, 0.8, limits).to_yaml(path)
    assert "legs from 1.1, 1.1, 1.1, 1.2, 1.2, 1.2 to 1.5, 1.5, 1.5, 1.4, 1.4, 1.4 m" in run(
        *FEW, "--machine", path
    ).stdout.replace("\n", " ")


POSES = ["--x", "37:44:4", "--y", "-16:-12:3", "--z", "250", "--xyx", "1", "17:20:2", "6", "--unit", "cm"]


def output(*arguments: object) -> str:
    done = run("sweep", *arguments)
    assert done.returncode == 0, done.output
    return " ".join(done.output.split())


def test_a_grid_of_poses_is_that_of_python(tmp_path: Path) -> None:
    out = output(*POSES, "--out", tmp_path / "a", "--workers", 1, "--chunk", 10, "--metric", "branches")
    assert "24 points: x 4, y 3, beta 2" in out
    grid = pose_grid(
        (0.37, 0.44, 4),
        (-0.16, -0.12, 3),
        2.5,
        xyx=[float(np.deg2rad(1)), (float(np.deg2rad(17)), float(np.deg2rad(20)), 2), float(np.deg2rad(6))],
    )
    expected = spm.sweeps.run_sweep(spm.Manipulator.paper(), grid, ["branches"], tmp_path / "b", workers=1).load()
    found = xarray.open_zarr(tmp_path / "a").load()
    np.testing.assert_array_equal(found.branches, expected.branches)
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-15)
    np.testing.assert_allclose(found.beta, expected.beta, rtol=1e-15)


def test_lengths_in_the_wrong_unit_are_noticed(tmp_path: Path) -> None:
    poses = ["--x", 37, "--y", -16, "--z", "250:251:2", "--xyx", 1, 17, 6]
    assert "--x, --y, --z was read in m: 251 m" in output(*poses, "--out", tmp_path / "map", "--workers", 1)
    done = run("sweep", *poses, "--limits", 110, 150, "--out", tmp_path / "limited", "--workers", 1)
    assert done.returncode == 2
    assert "--limits was read in m: 150 m" in done.stderr
    assert "--unit cm" in done.stderr
    assert "--unit" not in output(*POSES, "--out", tmp_path / "right", "--workers", 1)


def test_parameters_of_metrics(tmp_path: Path) -> None:
    output(
        *[*POSES, "--out", tmp_path / "a", "--workers", 1, "--limits", 115, 145],
        *["--metric", "payload", "--metric", "payload_down", "--metric", "least_stiffness", "--metric", "conditioning"],
        *["--leg-force", 900, "--leg-stiffness", 2e7, "--length", 50],
    )
    stored = xarray.open_zarr(tmp_path / "a")
    definition = json.loads(stored.attrs["spm_pin_sweep"])
    expected = [
        METRICS["conditioning"](length=0.5),
        METRICS["least_stiffness"](leg_stiffness=2e7),
        METRICS["payload"](push=900.0),
        METRICS["payload_down"](push=900.0),
    ]
    assert definition["metrics"] == [metric.definition() for metric in expected]
    assert definition["geometry"]["leg_limits"] == [1.15, 1.45]


def test_samples_of_leg_lengths(tmp_path: Path) -> None:
    ranges = [1.1, 1.2, (1.1, 1.3), 1.1, 1.2, 1.3]
    options = [part for text in ("110", "120", "110:130", "110", "120", "130") for part in ("--legs", text)]
    out = output(
        *[*options, "--samples", 30, "--seed", 7, "--unit", "cm", "--metric", "o_z"],
        *["--out", tmp_path / "map", "--workers", 1],
    )
    assert "30 points: sample 30" in out
    found = xarray.open_zarr(tmp_path / "map").load()
    expected = leg_sample(30, ranges[:3], ranges[3:], seed=7).points((0,), (30,))
    legs_found = np.stack([np.broadcast_to(found[leg], 30) for leg in spm.machine.LEGS], axis=-1)
    np.testing.assert_allclose(legs_found, expected, rtol=1e-15)


def test_resume_and_status(tmp_path: Path) -> None:
    store = tmp_path / "map"
    output(*POSES, "--out", store, "--workers", 1, "--chunk", 8)
    whole = contents(store)
    for record in records(store)[:2]:
        record.unlink()
    out = output("--out", store, "--status")
    assert "2 of 4 chunks complete" in out
    assert f"go on with: spm-pin sweep --out {store}" in out
    found = json.loads(output("--out", store, "--status", "--json"))
    assert (found["done"], found["total"], found["points"], found["complete"]) == (2, 4, 24, False)
    assert found["shape"] == {"x": 4, "y": 3, "beta": 2}
    found = json.loads(output("--out", store, "--workers", 1, "--json"))
    assert found["complete"]
    assert contents(store) == whole


def test_ctrl_c_says_how_to_go_on(tmp_path: Path) -> None:
    store = tmp_path / "map.zarr"
    legs = ["--legs", "1.1:1.5:6", "--chunk", "200", "--workers", "1", "--metric", "conditioning"]
    command = [*COMMAND, "sweep", *legs, "--out", str(store)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        deadline = time.monotonic() + 300
        while len(records(store)) < 2 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        errors = " ".join(process.communicate(timeout=300)[1].split())
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "interrupted." in errors
    assert f"go on with: spm-pin sweep --out {store}" in errors
    assert json.loads(output("--out", store, "--status", "--json"))["done"] >= 2


def test_a_sweep_of_a_stage(tmp_path: Path) -> None:
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2)).perturbed(1)
    stage.to_yaml(tmp_path / "stage.yaml")
    given = ["--machine", tmp_path / "stage.yaml", "--workers", 1, "--unit", "mm"]
    tilts = ["--height", "100:140:3", "--tilt", "0:30:4", "--azimuth", 20]
    out = output(*given, *tilts, "--metric", "reachable", "--out", tmp_path / "tilts")
    assert "12 points: height 3, tilt 4" in out
    found = xarray.open_zarr(tmp_path / "tilts").load()
    heights = np.linspace(0.1, 0.14, 3)[:, None]
    states = spm.inverse_physical(stage, heights, tilt=np.radians([0, 10, 20, 30]), azimuth=np.radians(20))
    np.testing.assert_array_equal(found.reachable, states.exists & (states.limit_excess == 0.0).all(axis=-1))
    options = ["--legs", "-10:40", "--samples", 20, "--limits", -5, 50, "--metric", "reachable"]
    output(*given, *options, "--out", tmp_path / "legs")
    drawn = xarray.open_zarr(tmp_path / "legs").load()
    readings = np.stack([drawn[leg] for leg in spm.machine.STAGE_LEGS], axis=-1)
    np.testing.assert_array_equal(drawn.reachable, (readings >= np.radians(-5)).all(axis=-1))
    for wrong, named in (
        (["--x", "0:1:2"], "--x"),
        (["--tilt", "0:10:2"], "--height"),
        (["--legs", "0:1:2", "--legs", "0"], "--legs"),
        (["--height", "100:140:2", "--tilt", "-10:10:2", "--azimuth", 0], "--tilt"),
    ):
        result = run("sweep", *given, *wrong, "--out", tmp_path / "none")
        assert result.returncode == 2
        assert named in result.stderr
    assert "--height" in run("sweep", "--height", "1:2:3", "--out", tmp_path / "none").stderr
