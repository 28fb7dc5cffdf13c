"""Results in notebooks: well-formed HTML that has their numbers, and pictures."""

from __future__ import annotations

import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.display import draw, path_figure
from spm_pin.support.notebook import curves, stick_figure, view_axes

pytestmark = pytest.mark.documents

GEOMETRY = spm.Manipulator.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
LEGS = [1.2, 1.2, 1.4, 1.25, 1.2, 1.5]
PNG = b"\x89PNG"


def shown(result) -> ElementTree.Element:
    """Return what a result shows, which must be well-formed."""
    return ElementTree.fromstring(result._repr_html_())


def rows(result) -> list[list[str]]:
    return [[cell.text or "" for cell in row] for row in shown(result).iter("tr")]


def pictures(result) -> list[ElementTree.Element]:
    return list(shown(result).iter("{http://www.w3.org/2000/svg}svg"))


def test_branches_show_their_legs_and_a_picture_each() -> None:
    branches = spm.inverse_displacement(GEOMETRY, POSE)
    header, *lines = rows(branches)
    assert header == ["branch", "r_b1 [m]", "r_b2 [m]", "r_b3 [m]", "r_c1 [m]", "r_c2 [m]", "r_c3 [m]"]
    assert [line[0] for line in lines] == ["TT+, physical", "TT-", "TF+", "TF-", "FF+", "FF-"]
    assert np.array(lines)[:, 1:].astype(float) == pytest.approx(branches.readings[branches.exists], abs=5e-5)
    assert len(pictures(branches)) == 6
    assert not pictures(spm.inverse_displacement(GEOMETRY, spm.pose([[9, 9, 9]], xyx=[0.1, 0.2, 0.3])))


def test_assembly_modes_show_their_poses() -> None:
    modes = spm.forward_displacement(GEOMETRY, LEGS)
    header, *lines, more = rows(modes)
    assert header == ["mode", "x [m]", "y [m]", "z [m]", "roll [°]", "pitch [°]", "yaw [°]"]
    places = np.flatnonzero(modes.exists)[: len(lines)]
    assert np.array(lines)[:, 1:4].astype(float) == pytest.approx(modes.translation[places], abs=5e-5)
    # An angle about z alone is the yaw.
    turned = spm.Configuration(GEOMETRY, spm.pose([0, 0, 2], xyx=[0, 0, 0]), modes[0].middle_joints)
    assert rows(turned)[1][:2] == ["0.0000, 0.0000, 2.0000", "0.00, 0.00, 0.00"]
    assert more == [f"and {modes.count - len(lines)} more"]


def test_a_batch_shows_its_first_states() -> None:
    states = spm.forward_physical(GEOMETRY, [[LEGS, [9.0, 1.0, 1.0, 1.0, 1.0, 1.0]]] * 10)
    header, *lines, more = rows(states)
    assert header[:2] == ["index", "o in {B} [m]"]
    assert len(lines) == 16
    assert lines[2][0] == "1, 0"
    assert np.array(lines[2][3:], dtype=np.float64) == pytest.approx(LEGS)
    assert lines[3][:2] == ["1, 1", "does not exist"]
    assert more == ["and 4 more"]


def test_singularities_show_the_numbers_of_each_matrix() -> None:
    found = spm.singularities(spm.forward_physical(GEOMETRY, LEGS))
    _, *lines = rows(found)
    assert [line[0] for line in lines] == ["J_b", "J_c", "K"]
    assert np.array(lines)[:, 2].astype(float) == pytest.approx(found.sigma, rel=5e-3)


def test_singularities_of_a_batch_show_its_first_states() -> None:
    found = spm.singularities(spm.forward_physical(GEOMETRY, [LEGS, [9.0, 1.0, 1.0, 1.0, 1.0, 1.0], [1.3] * 6] * 6))
    header, *lines, more = rows(found)
    assert len(header) == len(lines[0]) == 6
    assert len(lines) == 16
    assert np.array(lines[3][2:5], dtype=np.float64) == pytest.approx(found.sigma[3], rel=5e-3)
    assert [line[1] for line in lines[:3]] == ["regular", "does not exist", "inverse"]  # the last one is level
    assert (lines[0][5], lines[2][5]) == ("6", str(found.mobility[2]))
    assert more == ["and 2 more"]


def test_a_geometry_shows_its_dimensions_and_how_far_it_is_from_nominal() -> None:
    _, *lines = rows(GEOMETRY)
    assert lines[1:] == [
        ["C, platform radius", "0.34641 m"],
        ["d, middle side", "0.8 m"],
        ["leg limits", "1.1 to 1.5 m"],
    ]
    assert rows(spm.Manipulator(0.7, 0.3, 0.8))[-1] == ["leg limits", "none"]
    limits = spm.LegLimits.stages((1.1, 1.4), (1.2, 1.5))
    errors = np.zeros((6, 9))  # two of the direction, three each of pivot and ball, offset
    errors[4, :2], errors[1, 3], errors[5, 7], errors[0, 8] = (3e-3, 4e-3), -2e-3, 1e-3, -5e-4
    built = spm.Manipulator(*GEOMETRY.dimensions, limits).from_parameters(GEOMETRY.parameters + errors.ravel())
    assert "Calibrated machine" in "".join(shown(built).itertext())
    table = dict(rows(built)[1:])
    assert (table["limits of r_b3"], table["limits of r_c1"]) == ("1.1 to 1.4 m", "1.2 to 1.5 m")
    deviations = {name: table[f"{name} minus nominal"] for name in ("axes", "pivots", "balls", "offsets")}
    assert deviations == {
        "axes": "up to 5 mrad, r_c2",
        "pivots": "up to 2 mm, r_b2",
        "balls": "up to 1 mm, r_c3",
        "offsets": "up to 0.5 mm, r_b1",
    }


def test_a_stick_figure_has_joints_where_the_camera_sees_them() -> None:
    state = spm.forward_physical(GEOMETRY, LEGS)
    svg = ElementTree.fromstring(stick_figure(state.leg_bases, state.balls, "a < b"))
    assert svg[-1].text == "a < b"
    legs = [line.attrib for line in svg if line.tag.endswith("line")]
    drawn = np.array([[float(line[name]) for name in ("x2", "y2")] for line in legs[:3]])
    seen = state.middle_joints @ view_axes(np.deg2rad(15.0), np.deg2rad(25.0))[:2].T
    scale = np.linalg.norm(drawn[1] - drawn[0]) / np.linalg.norm(seen[1] - seen[0])
    assert drawn - drawn[0] == pytest.approx((seen - seen[0]) * [scale, -scale], abs=0.11)


def test_curves_end_at_their_values() -> None:
    x = np.linspace(0.0, 2.0, 5)
    svg = curves(x, np.stack([x, -3.0 * x], axis=-1), "a", [1.0])
    texts = [node.text for node in ElementTree.fromstring(svg) if node.tag.endswith("text")]
    assert texts == ["a", "2", "-6", "0", "2"]
    assert len(re.findall("<polyline", svg)) == 2


def test_paths_plans_motions_and_drawings_show_themselves() -> None:
    path = spm.follow(GEOMETRY, [LEGS, [1.45, 1.15, 1.30, 1.20, 1.52, 1.35]], samples=20)
    assert [line[1] for line in rows(path)[1:]] == [str(event.kind) for event in path.events]
    assert path.events
    assert len(path_figure(path).axes) == 2
    plan = spm.plan(GEOMETRY, LEGS, [1.21, 1.2, 1.4, 1.25, 1.2, 1.5])
    assert len(list(pictures(plan)[0].iter("{http://www.w3.org/2000/svg}polyline"))) == 6
    chain, start = spm.ClosedChain.from_urdf(), path.configurations[0]
    poses = spm.pose(start.translation + np.array([[0, 0, 0], [0, 0, 0.02]]), rotation=np.stack([start.rotation] * 2))
    times = np.linspace(0.0, 1.0, 5)
    motion = chain.joint_trajectory(spm.PlatformPath([0.0, 1.0], poses, ease=True), times, chain.joint_values(start))
    assert len(pictures(motion)) == 2
    ax = draw(start, dpi=40.0)
    for picture in (path_figure(path), ax, ax.figure):
        assert picture._repr_png_().startswith(PNG)


def test_the_first_column_names_what_the_numbers_are_of() -> None:
    readings = np.random.default_rng(0).uniform(1.1, 1.5, (30, 6))
    certificate = spm.certify(GEOMETRY, spm.LegLimits(1.29, 1.31))
    tolerances = spm.calibration.tolerance(GEOMETRY, np.full(54, 1e-4), 3, samples=0, rng=0)
    machine = spm.calibration.identify(GEOMETRY, spm.forward_physical(GEOMETRY, readings).pose, readings)
    for result, names in (
        (certificate, ["lower", "upper"]),
        (tolerances, [name for name, _ in tolerances.ranking("component")]),
        (machine, ["before", "after", "reduced χ²", "outliers"]),
    ):
        assert [line[0] for line in rows(result)[1:]] == names
    assert "Proved" in "".join(shown(certificate).itertext())


def test_tables_need_no_drawing_library() -> None:
    program = """
import sys
sys.modules["matplotlib"] = None
import spm_pin as spm
print(len(spm.forward_physical(spm.Manipulator.paper(), [1.2, 1.2, 1.4, 1.25, 1.2, 1.5])._repr_html_()))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 500
