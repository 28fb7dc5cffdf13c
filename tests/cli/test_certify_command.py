"""`spm-pin certify`."""

from __future__ import annotations

import json

import pytest
from cli.running import run

LIMITS = ["--min", "110", "--max", "150", "--unit", "cm"]


def test_limits_that_are_proved_are_exit_code_0() -> None:
    done = run("certify", *LIMITS)
    assert done.returncode == 0, done.stderr
    assert "Proved: no configuration joined to the home" in done.stdout


def test_the_dimension_error_is_in_the_unit() -> None:
    done = run("certify", *LIMITS, "--dimension-error", "0.1", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["holds"] is True
    done = run("certify", *LIMITS, "--dimension-error", "0.1")
    assert "within 1 mm of the nominal ones" in done.stdout


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


@pytest.mark.parametrize(
    ("arguments", "option"),
    [(["--min", "1.1"], "--min and --max"), (["--dimension-error", "-1"], "--dimension-error")],
)
def test_wrong_options_are_named(arguments: list[str], option: str) -> None:
    done = run("certify", *arguments)
    assert done.returncode == 2
    assert option in done.message
