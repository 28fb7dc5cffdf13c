from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli.running import run

import spm_pin as spm
from spm_pin.crosscheck import METHODS, Method, Paper
from spm_pin.crosscheck.paper import published
from spm_pin.crosscheck.paper.jacobian import Table5Mistakes


def test_all_methods_on_a_few_poses(tmp_path: Path) -> None:
    data, picture = tmp_path / "report.json", tmp_path / "report.svg"
    spm.Manipulator(0.7, 0.35, 0.8).to_yaml(tmp_path / "robot.yaml")
    options = "--machine", tmp_path / "robot.yaml", "--out", data, "--figure", picture
    done = run("crosscheck", "--poses", "4", "--seed", "3", *options)
    assert done.returncode == 0, done.stderr
    assert f"--machine {tmp_path / 'robot.yaml'}" in done.stdout
    assert f"All {len(METHODS)} methods agree." in done.stdout
    content = json.loads(data.read_text(encoding="utf-8"))
    assert content["agrees"] is True
    assert content["outliers"] == []
    assert len(content["poses"]) == 4
    assert {method["name"] for method in content["methods"]} == {name.replace("-", " ") for name in METHODS}
    assert all(pair["worst"] <= pair["tolerance"] for pair in content["differences"])
    assert content["differences"][0]["reproduce"].startswith("spm-pin inverse --translation")
    assert picture.read_text(encoding="utf-8").startswith("<?xml")


def test_the_printed_lever_arm_fails_and_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def printed(geometry: spm.Manipulator) -> Method:
        return Paper(geometry, mistakes=Table5Mistakes(printed_lever_arm=True))

    monkeypatch.setitem(METHODS, "paper", printed)
    data = tmp_path / "report.json"
    chosen = [word for name in ("closed-form", "paper", "pinocchio") for word in ("--method", name)]
    done = run("crosscheck", "--poses", "6", *chosen, "--out", str(data))
    assert done.returncode == 1
    assert "paper is wrong: the others agree." in done.stdout
    assert json.loads(data.read_text(encoding="utf-8"))["outliers"] == ["paper"]


def test_a_method_that_cannot_be_imported_is_mentioned(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(geometry: spm.Manipulator) -> Method:
        raise ImportError("pinocchio")

    monkeypatch.setitem(METHODS, "pinocchio", missing)
    monkeypatch.setitem(METHODS, "ipopt", missing)
    done = run("crosscheck", "--poses", "2")
    assert done.returncode == 0
    assert "Left out: pinocchio (its package is not installed), ipopt (its package is not installed)." in done.stdout


def test_reproduce_prints_the_verdict_every_table_and_each_finding() -> None:
    done = run("reproduce", "--cells")
    assert done.returncode == 0, done.stderr
    for words in ("Table 1:", "Table 4:", "Table 5:", "105 of the 120 cells of Tables 1 to 5", "Eq. (17)"):
        assert words in done.stdout.replace("\n", " "), words


def test_reproduce_fails_on_a_difference_nothing_explains(monkeypatch: pytest.MonkeyPatch) -> None:
    first = ("116.1501", *published.TABLE_4[0][1:])
    monkeypatch.setattr(published, "TABLE_4", (first, *published.TABLE_4[1:]))
    done = run("reproduce", "--table", "4")
    assert done.returncode == 1
    assert "not all others are explained: 1 misprinted, 1 left empty, 1 unexplained" in done.stdout
    assert "1 printed value" in done.stderr
