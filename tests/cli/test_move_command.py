"""`spm-pin certify` and `move`."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from cli.running import run

import spm_pin as spm
from spm_pin.description import actuated_joints

SLIDES = actuated_joints()
LIMITS = ["--limits", "129", "131", "--unit", "cm"]


def test_errors_of_the_machine_are_in_the_unit_and_in_radians() -> None:
    errors = "--length-error", "0.01", "--angle-error", "1e-4"
    done = run("certify", *LIMITS, *errors, "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["holds"] is True
    assert content["errors"] == {"length": pytest.approx(1e-4), "angle": 1e-4}
    shown = run("certify", *LIMITS, *errors).stdout
    assert "Proved: no configuration joined to the home" in shown
    assert "within 0.1 mm and 0.1 mrad" in shown
    assert run("certify", "--limits", "0.5", "1.9", "--boxes", "100").returncode == 1


def test_the_file_of_a_machine_as_built(tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    nominal = spm.Manipulator.paper().nominal
    nominal.perturbed(0, length=1e-4, angle=1e-4).to_yaml(file)
    done = run("certify", *LIMITS, "--machine", str(file))
    assert done.returncode == 0, done.stderr
    assert "For all machines" in done.stdout
    done = run("certify", *LIMITS, "--machine", str(file), "--inverse")
    assert (done.returncode, "--inverse" in done.message) == (2, True)
    done = run("certify", *LIMITS, "--inverse", "--json")
    content = json.loads(done.stdout)
    assert (done.returncode, content["holds"], content["inverse"]["holds"]) == (1, True, False)
    assert len(content["inverse"]["witness"]["readings"]) == 6


START, GOAL = ["120", "120", "140", "125", "120", "150"], ["140", "120", "120", "120", "150", "125"]
ENDS = ["--from", *START, "--to", *GOAL, "--unit", "cm"]


def test_the_csv_has_the_motion_and_the_viewer_reads_it(tmp_path: Path) -> None:
    from spm_pin.display import read_recording

    out, plot = tmp_path / "motion.csv", tmp_path / "motion.png"
    done = run("move", *ENDS, "--leg-force", "1500", "--leg-rate", "0.5", "--out", str(out), "--plot", str(plot))
    assert done.returncode == 0, done.stderr
    assert "proved to be free of forward singularities" in done.stdout
    assert ["r_b1", "120.000", "140.000"] in [line.split()[:3] for line in done.stdout.splitlines()]
    with out.open() as file:
        rows = list(csv.DictReader(file))
    lengths = np.array([[float(rows[k][f"r_{leg}"]) for leg in ("b1", "b2", "b3", "c1", "c2", "c3")] for k in (0, -1)])
    np.testing.assert_allclose(lengths, [[1.2, 1.2, 1.4, 1.25, 1.2, 1.5], [1.4, 1.2, 1.2, 1.2, 1.5, 1.25]], atol=1e-9)
    assert max(abs(float(row[f"{SLIDES[2]}.effort"])) for row in rows) == pytest.approx(1500.0, rel=0.01)
    recording = read_recording(out)
    assert recording.times[-1] == pytest.approx(float(rows[-1]["time"]))
    assert recording.follow(spm.Manipulator.paper()).path.complete
    assert plot.stat().st_size > 10_000


def test_states_are_passed_on_the_way_and_each_leg_has_its_limits() -> None:
    via = "130,140,120,130,130,130"
    limits = ["--limits", "110,110,110,110,110,110", "150,150,150,150,150,151"]
    limits += ["--clearance", "10", "--hip", "-60", "60"]
    forces = "1500,1500,1200,1500,1500,1500"
    done = run("move", *ENDS, "--via", via, *limits, "--leg-force", forces, "--leg-jerk", "90", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    lengths = np.array([content[leg] for leg in spm.machine.LEGS]).T
    state = np.array([float(part) for part in via.split(",")]) / 100.0
    assert np.abs(lengths - state).max(axis=-1).min() < 5e-3  # to the length of a step
    used = np.abs([content[f"{slide}.effort"] for slide in SLIDES]).max(axis=-1)
    assert (used <= np.array([1500.0, 1500.0, 1200.0, 1500.0, 1500.0, 1500.0]) * (1.0 + 1e-6)).all()
    assert content["certified"] is True


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (ENDS[:-2], "is it 150 cm?"),
        ([*ENDS, "--limits", "110", "140"], "--from: expected a state that the plan may pass"),
        ([*ENDS, "--via", "130,140,120,130,130,155"], "--via[0]: expected a state that the plan may pass"),
        ([*ENDS, "--hip", "-1", "1"], "--from: expected a state that the plan may pass, got a passive joint"),
        (
            [*ENDS[:7], "--unit", "cm", "--to-translation", "0", "0", "900", "--to-rpy", "9", "9", "0"],
            "error: --to-translation: expected a pose with a physical branch",
        ),
    ],
)
def test_a_state_that_is_not_reached_is_exit_code_3(arguments: list[str], text: str) -> None:
    done = run("move", *arguments, "--leg-force", "1500")
    assert done.returncode == 3
    assert text in " ".join(done.stderr.split())


def test_no_path_is_exit_code_3() -> None:
    """From a tilt to the opposite one in a straight line of poses: level in between."""
    first, last = ["130", "130", "140"] * 2, ["140", "140", "130"] * 2
    tilts = ["--from", *first, "--to", *last, "--unit", "cm"]
    done = run("move", *tilts, "--straight", "--leg-force", "1500")
    assert done.returncode == 3
    assert "no path" in done.stderr
