from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli.running import run

import spm_pin as spm
from spm_pin.paper import published

EXAMPLE = ["--translation", "68.89", "49.63", "225.3", "--xyx", "-11.08", "32.97", "-12.88", "--unit", "cm"]


def test_reproduce_prints_the_verdict_every_table_and_each_finding() -> None:
    done = run("reproduce", "--cells")
    assert done.returncode == 0, done.stderr
    for words in (
        "Table 1:",
        "Table 4:",
        "Table 5:",
        "105 of the 120 cells of Tables 1 to 5",
        "a shifted number",
        "Eq. (17)",
    ):
        assert words in done.stdout.replace("\n", " "), words
    assert "…" not in done.stdout, "nothing is cut off at 80 columns"


def test_reproduce_writes_json(tmp_path: Path) -> None:
    target = tmp_path / "tables.json"
    assert run("reproduce", "--table", "3", "--out", str(target)).returncode == 0
    text = target.read_text(encoding="utf-8")
    assert run("reproduce", "--table", "3", "--json").stdout == text
    content = json.loads(text)
    assert {cell["table"] for cell in content["cells"]} == {3}
    assert [cell["column"] for cell in content["cells"] if cell["verdict"] == "misprint"] == ["5"]


def test_reproduce_fails_on_a_difference_nothing_explains(monkeypatch: pytest.MonkeyPatch) -> None:
    first = ("116.1501", *published.TABLE_4[0][1:])
    monkeypatch.setattr(published, "TABLE_4", (first, *published.TABLE_4[1:]))
    done = run("reproduce", "--table", "4")
    assert done.returncode == 1
    assert "not all others are explained: 1 misprinted, 1 left empty, 1 unexplained" in done.stdout
    assert "1 printed value" in done.stderr


def test_inverse_in_every_unit_and_as_json() -> None:
    lengths = {}
    for unit, factor in (("m", 0.01), ("cm", 1.0), ("mm", 10.0)):
        position = [str(x * factor) for x in published.POSITION]
        done = run("inverse", "--translation", *position, *EXAMPLE[4:8], "--unit", unit, "--json")
        content = json.loads(done.stdout)
        assert content["status"] == "ok"
        assert [branch["label"] for branch in content["branches"]] == ["TT+", "TT-", "TF+", "TF-", "FF+", "FF-"]
        lengths[unit] = np.array([branch["leg_lengths"] for branch in content["branches"]]) / factor
    pose = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))
    expected = spm.inverse_displacement(spm.Geometry.paper(), pose)
    for found in lengths.values():
        np.testing.assert_allclose(found, 100 * expected.leg_lengths[expected.exists], rtol=1e-12)


def test_inverse_says_which_branch_is_physical_and_which_leg_is_too_long() -> None:
    out = run("inverse", *EXAMPLE).stdout
    (line,) = [line for line in out.splitlines() if "TT+" in line]
    assert line.split() == ["TT+", "119.982", "119.996", "139.856", "125.012", "120.004", "150.127*", "physical"]
    assert "6 of 8 branches real" in out
    assert "…" not in out


def test_another_geometry_from_yaml(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("base_radius: 0.7\nplatform_radius: 0.35\nmiddle_side: 0.8\n", encoding="utf-8")
    done = run("inverse", *EXAMPLE, "--geometry", str(path), "--json")
    content = json.loads(done.stdout)
    pose = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))
    expected = spm.inverse_displacement(spm.Geometry(0.7, 0.35, 0.8), pose)
    np.testing.assert_allclose(content["branches"][0]["leg_lengths"], 100 * expected.leg_lengths[0], rtol=1e-12)


def test_statics_of_every_branch_and_of_one() -> None:
    load = ["--force", "-20000", "-30000", "-30000", "--moment", "-300", "-300", "1000"]
    motion = ["--velocity", "1", "2", "3", "--angular-velocity", "1", "2", "3"]
    content = json.loads(run("statics", *EXAMPLE, *load, *motion, "--json").stdout)
    assert list(content["branches"]) == ["TT+", "TT-", "TF+", "TF-", "FF+", "FF-"]
    # The true values of Table 5, to four decimals in kN and cm/s.
    reasonable = content["branches"]["TT+"]
    true_forces = [21.5520, -14.8906, 23.8779, 30.7096, -12.8889, 26.9840]
    true_rates = [-0.2932, 8.7198, 48.2731, 4.3340, -4.7388, -38.7021]
    np.testing.assert_allclose(np.array(reasonable["forces"]) / 1e3, true_forces, atol=6e-5)
    np.testing.assert_allclose(reasonable["rates"], true_rates, atol=6e-5)
    table = run("statics", *EXAMPLE, *load, "--branch", "TT+").stdout
    assert "Leg forces" in table
    assert "FF+" not in table
    assert "Leg rates" not in table


def test_singularities_of_each_branch() -> None:
    content = json.loads(run("singularities", *EXAMPLE, "--json").stdout)
    assert list(content["branches"]) == ["TT+", "TT-", "TF+", "TF-", "FF+", "FF-"]
    assert {branch["kind"] for branch in content["branches"].values()} == {"regular"}
    pose = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))
    expected = spm.singularities(spm.inverse_displacement(spm.Geometry.paper(), pose)["TT-"])
    np.testing.assert_allclose(
        list(content["branches"]["TT-"]["scaled_determinants"].values()), expected.scaled_determinants, rtol=1e-12
    )
    table = run("singularities", *EXAMPLE, "--branch", "TT+").stdout
    assert "TT-" not in table
    assert "…" not in table
