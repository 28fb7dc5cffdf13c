"""`spm-pin forward`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli.running import run as run_command

import spm_pin as spm

LEGS = ["--legs", "120", "120", "140", "125", "120", "150", "--unit", "cm"]


def run(*arguments: str, code: int = 0) -> str:
    done = run_command("forward", *arguments)
    assert done.returncode == code, done.stderr
    return done.stdout


def test_the_papers_lengths_give_its_pose() -> None:
    out = run(*LEGS)
    (line,) = [line for line in out.splitlines() if "T1+/T1+" in line]
    mode, *numbers, word = line.split()
    assert (mode, word) == ("T1+/T1+", "physical")
    np.testing.assert_allclose(
        [float(x) for x in numbers], [68.8872, 49.6307, 225.3025, -11.0818, 32.9691, -12.8831], atol=1.01e-4
    )
    assert "144 of 256 assembly modes real" in out


def test_all_modes_fit_into_80_columns() -> None:
    out = run(*LEGS, "--all")
    rows = [line for line in out.splitlines() if line.strip().startswith(("T", "F")) and "/" in line]
    assert len(rows) == 144
    assert sum("physical" in row for row in rows) == 1
    assert "…" not in out


@pytest.mark.parametrize(("unit", "factor"), [("m", 0.01), ("cm", 1.0), ("mm", 10.0)])
def test_json_in_every_unit(unit: str, factor: float) -> None:
    legs = [str(float(x) * factor) for x in LEGS[1:7]]
    content = json.loads(run("--legs", *legs, "--unit", unit, "--all", "--json"))
    assert (content["unit"], content["status"], content["count"]) == (unit, "ok", 144)
    assert len(content["modes"]) == 144
    first = content["modes"][0]
    assert first["physical"]
    np.testing.assert_allclose(np.array(first["translation"]) / factor, [68.88715, 49.63068, 225.30253], atol=1e-5)
    state = spm.Configuration(
        spm.Geometry.paper(),
        spm.pose(np.array(first["translation"]) / factor / 100, rotation=first["rotation"]),
        np.array(first["middle_joints"]) / factor / 100,
    )
    np.testing.assert_allclose(100 * state.leg_lengths, [float(x) for x in LEGS[1:7]], rtol=1e-12)
    for written in ({"rpy": np.deg2rad(first["rpy"])}, {"quat": first["quat"]}):
        np.testing.assert_allclose(spm.pose([0, 0, 1], **written).rotation.as_matrix(), first["rotation"], atol=1e-14)
    only = json.loads(run("--legs", *legs, "--unit", unit, "--json"))
    (alone,) = only["modes"]
    assert [alone[key] for key in ("label", "physical")] == [first[key] for key in ("label", "physical")]
    # By another way to the same configuration: as many digits as a pose has.
    for key in ("translation", "rotation", "middle_joints"):
        np.testing.assert_allclose(alone[key], first[key], rtol=0, atol=1e-13 * factor)


def test_unreachable_lengths_hint_at_the_unit() -> None:
    out = run(*LEGS[:-2], code=3)
    assert "0 of 256" in out
    assert "--legs was read in m: 150 m, on a machine of 2.64 m. In cm it would be in proportion: --unit cm." in out
    assert "--unit" not in run("--legs", "1.2", "0.1", "1.2", "1.2", "1.2", "1.2", code=3)


def test_a_continuous_family_is_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("base_radius: 1.0\nplatform_radius: 0.7\nmiddle_side: 2.0\n", encoding="utf-8")
    out = " ".join(run("--legs", "1", "3", "1", "2", "2", "2", "--geometry", str(path), code=4).split())
    assert "status: degenerate" in out
    assert "continuous family of dimension 1" in out
