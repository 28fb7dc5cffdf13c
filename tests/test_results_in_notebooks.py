"""Results in notebooks: well-formed HTML tables of states and sets of states, and pictures."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.display import draw, path_figure

pytestmark = pytest.mark.documents

MACHINE = spm.Manipulator.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
LEGS = [1.2, 1.2, 1.4, 1.25, 1.2, 1.5]
PNG = b"\x89PNG"


def shown(result) -> ElementTree.Element:
    """Return what a result shows, which must be well-formed."""
    return ElementTree.fromstring(result._repr_html_())


def rows(result) -> list[list[str]]:
    return [[cell.text or "" for cell in row] for row in shown(result).iter("tr")]


def test_branches_show_their_legs() -> None:
    branches = spm.inverse_displacement(MACHINE, POSE)
    header, *lines = rows(branches)
    assert header == ["branch", "r_b1 [m]", "r_b2 [m]", "r_b3 [m]", "r_c1 [m]", "r_c2 [m]", "r_c3 [m]"]
    assert [line[0] for line in lines] == ["TT+, physical", "TT-", "TF+", "TF-", "FF+", "FF-"]
    assert np.array(lines)[:, 1:].astype(float) == pytest.approx(branches.readings[branches.exists], abs=5e-5)


def test_states_of_a_stage_show_their_legs_in_their_units() -> None:
    stage = spm.Stage(0.1, 0.1, spm.RRS(crank=0.05, rod=0.12))
    modes = spm.inverse_displacement(stage, 0.1, roll=0.1)
    legs = [f"{leg} [rad]" for leg in stage.legs.names]
    header, *lines = rows(modes)
    assert header == ["branch", *legs]
    assert [line[0] for line in lines] == [
        modes.labels[k] + ", physical" * (k == 0) for k in range(2) if modes.exists[k]
    ]
    assert np.array(lines)[:, 1:].astype(float) == pytest.approx(modes.readings[modes.exists], abs=5e-5)
    header, line = rows(modes.physical())
    assert header == ["o in {B} [m]", "roll, pitch, yaw [°]", *legs]
    assert np.array(line[2:], dtype=np.float64) == pytest.approx(modes[0].readings, abs=5e-5)


def test_assembly_modes_show_their_poses() -> None:
    modes = spm.forward_displacement(MACHINE, LEGS)
    header, *lines, more = rows(modes)
    assert header == ["mode", "x [m]", "y [m]", "z [m]", "roll [°]", "pitch [°]", "yaw [°]"]
    places = np.flatnonzero(modes.exists)[: len(lines)]
    assert np.array(lines)[:, 1:4].astype(float) == pytest.approx(modes.translation[places], abs=5e-5)
    # An angle about z alone is the yaw.
    turned = spm.Configuration(MACHINE, spm.pose([0, 0, 2], xyx=[0, 0, 0]), modes[0].middle_joints)
    assert rows(turned)[1][:2] == ["0.0000, 0.0000, 2.0000", "0.00, 0.00, 0.00"]
    assert more == [f"and {modes.count - len(lines)} more"]


def test_a_batch_shows_its_first_states() -> None:
    states = spm.forward_physical(MACHINE, [[LEGS, [9.0, 1.0, 1.0, 1.0, 1.0, 1.0]]] * 10)
    header, *lines, more = rows(states)
    assert header[:2] == ["index", "o in {B} [m]"]
    assert len(lines) == 16
    assert lines[2][0] == "1, 0"
    assert np.array(lines[2][3:], dtype=np.float64) == pytest.approx(LEGS)
    assert lines[3][:2] == ["1, 1", "does not exist"]
    assert more == ["and 4 more"]


def test_drawings_show_themselves() -> None:
    path = spm.follow(MACHINE, [LEGS, [1.45, 1.15, 1.30, 1.20, 1.52, 1.35]], samples=20)
    assert len(path_figure(path).axes) == 2
    ax = draw(path.configurations[0], dpi=40.0)
    for picture in (path_figure(path), ax, ax.figure):
        assert picture._repr_png_().startswith(PNG)
