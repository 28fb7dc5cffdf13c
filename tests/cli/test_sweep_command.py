"""`spm-pin sweep`, in this process and in one of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli.running import run
from stores import contents, records

import spm_pin as spm
from spm_pin.sweeps import METRICS, leg_sample, pose_grid

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
    expected = spm.sweeps.run_sweep(spm.Geometry.paper(), grid, ["branches"], tmp_path / "b", workers=1).load()
    found = xarray.open_zarr(tmp_path / "a").load()
    np.testing.assert_array_equal(found.branches, expected.branches)
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-15)
    np.testing.assert_allclose(found.beta, expected.beta, rtol=1e-15)


def test_lengths_in_the_wrong_unit_are_noticed(tmp_path: Path) -> None:
    poses = ["--x", 37, "--y", -16, "--z", "250:251:2", "--xyx", 1, 17, 6, "--limits", 110, 150]
    out = output(*poses, "--out", tmp_path / "map", "--workers", 1)
    assert "--x, --y, --z was read in m: 251 m" in out
    assert "--limits was read in m: 150 m" in out
    assert "--unit cm" in out
    assert "--unit" not in output(*POSES, "--out", tmp_path / "right", "--workers", 1)


def test_default_metrics_are_used(tmp_path: Path) -> None:
    out = output(*POSES, "--out", tmp_path / "map", "--workers", 1)
    assert "metrics: branches, conditioning, reachable" in out
    assert "1 of 1 chunks complete open with: xarray.open_zarr(" in out


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
    assert definition["geometry"]["limits"] == [[1.15] * 6, [1.45] * 6]


@pytest.mark.parametrize(
    ("legs", "ranges"),
    [
        (["110:150"], [(1.1, 1.5)] * 6),
        (["110:150", "120"], [(1.1, 1.5)] * 3 + [1.2] * 3),
        (["110", "120", "110:130", "110", "120", "130"], [1.1, 1.2, (1.1, 1.3), 1.1, 1.2, 1.3]),
    ],
)
def test_samples_of_leg_lengths(legs: list[str], ranges: list[float], tmp_path: Path) -> None:
    options = [part for text in legs for part in ("--legs", text)]
    out = output(
        *[*options, "--samples", 30, "--seed", 7, "--unit", "cm", "--metric", "o_z"],
        *["--out", tmp_path / "map", "--workers", 1],
    )
    assert "30 points: sample 30" in out
    found = xarray.open_zarr(tmp_path / "map").load()
    expected = leg_sample(30, ranges[:3], ranges[3:], seed=7).points((0,), (30,))
    legs_found = np.stack([np.broadcast_to(found[leg], 30) for leg in spm.mechanism.LEGS], axis=-1)
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
    code = "from spm_pin.cli import main; main()"
    legs = ["--legs", "1.1:1.5:6", "--chunk", "200", "--workers", "1", "--metric", "conditioning"]
    command = [sys.executable, "-c", code, "sweep", *legs, "--out", str(store)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        deadline = time.monotonic() + 120
        while len(records(store)) < 2 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        errors = " ".join(process.communicate(timeout=60)[1].split())
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "interrupted." in errors
    assert f"go on with: spm-pin sweep --out {store}" in errors
    assert json.loads(output("--out", store, "--status", "--json"))["done"] >= 2
