"""The program of a configuration of LinuxCNC, read as G-code: what `test_linuxcnc.py` runs where LinuxCNC is."""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.export import linuxcnc_configuration, linuxcnc_export
from spm_pin.export.ros_export import travel

ROBOT = spm.Manipulator.paper()
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-1.2, 1.4))


@pytest.mark.parametrize("machine", [ROBOT, BALANCER])
def test_the_program_goes_round_a_circle_of_tilts_within_the_limits(
    machine: spm.Manipulator | spm.Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(linuxcnc_export, "c_sources", lambda _: defaultdict(str))  # which take seconds to generate
    lines = [line.split()[1:] for line in linuxcnc_configuration(machine)["demo.ngc"].splitlines() if line[:3] == "G1 "]
    rows = np.array([[float(word[1:]) for word in line] for line in lines])
    if isinstance(machine, spm.Stage):
        assert "".join(word[0] for word in lines[0]) == "ZAB"
        angles = np.radians(rows[:, 1:])
        states = spm.inverse_physical(machine, rows[:, 0] / 1e3, roll=angles[:, 0], pitch=angles[:, 1])
    else:
        assert "".join(word[0] for word in lines[0]) == "XYZABC"
        states = spm.inverse_physical(machine, spm.pose(rows[:, :3] / 1e3, rpy=np.radians(rows[:, 3:])))
    assert states.exists.all()
    low, high = machine.limits.ends
    assert ((low < states.readings) & (states.readings < high)).all()
    np.testing.assert_array_equal(rows[0], rows[-1])
    normals = states.pose.as_matrix()[..., :2, 2]
    # The home is level; around it, or through it, each step has the same direction of turning.
    around = normals[1:-1] - normals[1:-1].mean(axis=0)
    assert len(around) >= 11
    steps = np.diff(np.unwrap(np.arctan2(around[:, 1], around[:, 0])))
    assert (np.sign(steps) == np.sign(steps[0])).all()
    assert np.abs(steps.sum()) > 1.5 * np.pi


def test_a_calibrated_robot_without_limits_moves_where_cylinders_have_a_length(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(linuxcnc_export, "c_sources", lambda _: defaultdict(str))
    machine = replace(ROBOT, limits=None).perturbed(3, length=0.02)
    assert machine.legs.offsets.max() > 0.0
    low, high = travel(machine)
    assert (low >= machine.legs.offsets).all()
    ini = linuxcnc_configuration(machine)["spm.ini"]
    home = np.array(re.findall(r"^HOME = (\S+)$", ini, re.MULTILINE), dtype=float) / 1e3
    assert ((low < home) & (home < high)).all()
    assert spm.forward_physical(machine, home).exists
    ends = np.array(re.findall(r"(?:MIN|MAX)_LIMIT = (\S+)", ini), dtype=float).reshape(6, 2)  # of the axes alone
    assert (ends[:, 0] < ends[:, 1]).all()
