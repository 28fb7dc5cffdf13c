"""`spm-pin certify`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli.running import run

import spm_pin as spm

LIMITS = ["--min", "110", "--max", "150", "--unit", "cm"]


def test_limits_that_are_proved_are_exit_code_0() -> None:
    done = run("certify", *LIMITS)
    assert done.returncode == 0, done.stderr
    assert "Proved: no configuration joined to the home" in done.stdout


def test_errors_of_the_machine_are_in_the_unit_and_in_radians() -> None:
    errors = "--length-error", "0.01", "--angle-error", "1e-4"
    done = run("certify", *LIMITS, *errors, "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["holds"] is True
    assert content["errors"] == {"length": pytest.approx(1e-4), "angle": 1e-4}
    assert "within 0.1 mm and 0.1 mrad" in run("certify", *LIMITS, *errors).stdout


def test_the_file_of_a_machine_as_built(tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    nominal = spm.Geometry.paper().nominal
    nominal.perturbed(0, length=1e-4, angle=1e-4).to_yaml(file)
    done = run("certify", *LIMITS, "--geometry", str(file))
    assert done.returncode == 0, done.stderr
    assert "For all machines" in done.stdout
    done = run("certify", *LIMITS, "--geometry", str(file), "--inverse")
    assert done.returncode == 2
    assert "--inverse" in done.message


def test_inverse_singularities_are_shown_where_they_are() -> None:
    done = run("certify", *LIMITS, "--inverse")
    assert done.returncode == 1
    assert "inverse singular with legs" in done.stdout
    content = json.loads(run("certify", *LIMITS, "--inverse", "--json").stdout)
    assert content["holds"] is True
    assert content["inverse"]["holds"] is False
    assert len(content["inverse"]["witness"]["leg_lengths"]) == 6


def test_limits_with_a_forward_singularity_are_exit_code_1() -> None:
    done = run("certify", "--min", "0.5", "--max", "1.9", "--boxes", "2000")
    assert done.returncode == 1
