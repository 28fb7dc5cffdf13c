"""Pictures: the solids of the URDF in their places, hidden surfaces at every pixel, labels, refusals."""

from __future__ import annotations

from pathlib import Path

import kinds_of_legs
import numpy as np
import problems
import pytest
import trimesh
from description.kinematic_tree import KinematicTree, origin, vector
from display.pixels import inner_pixels, nearest, off_shade
from error_fields import with_fields
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.capability import wrench_polytope
from spm_pin.description import urdf_text
from spm_pin.description.robot import read_robot
from spm_pin.description.tree import joint_values
from spm_pin.description.visuals import read_obj, visual_parts
from spm_pin.display.plots import draw, draw_capability, save_gallery, save_picture
from spm_pin.display.rendering import VIEW, camera_axes, robot_solids
from spm_pin.errors import ArgumentError

PAPER = spm.Manipulator.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
SOLUTIONS = spm.inverse_displacement(PAPER, POSE)
STATE = SOLUTIONS.physical()


@pytest.mark.parametrize(("label", "view"), [("TT+", VIEW), ("FF+", (1.0, -0.6))])
def test_every_pixel_shows_the_nearest_solid(label, view):
    state = SOLUTIONS[label]
    solids = robot_solids(state, frames=False)
    parts = [(solid.vertices, solid.faces) for solid in solids]
    picture = draw(state, view=view, labels=False, dpi=90).images[0]
    colours, seen = inner_pixels(picture, 600, 0.8, lambda points: nearest(parts, view, points))
    assert len({solids[i].name for i in seen[seen >= 0]}) > 15
    for colour, i in zip(colours, seen, strict=True):
        assert colour[3] == (i >= 0)
        if i >= 0:
            assert off_shade(colour[:3], solids[i].colour) < 2e-3, solids[i].name


def test_labels_name_all_joints_legs_and_frames_within_the_picture():
    ax = draw(STATE, dpi=60)
    texts = {text.get_text() for text in ax.texts}
    assert {f"${letter}_{i}$" for letter in "abc" for i in (1, 2, 3)} <= texts
    assert {f"$r_{{{leg[2:]}}}$" for leg in spm.machine.LEGS} <= texts
    assert {f"${axis}$" for axis in "XYZxyz"} | {r"$\{B\}$", r"$\{m\}$"} <= texts
    FigureCanvasAgg(ax.figure).draw()
    boxes = [text.get_window_extent() for text in ax.texts if not text.get_path_effects()]  # without the halos
    assert all(ax.bbox.contains(*box.min) and ax.bbox.contains(*box.max) for box in boxes)
    assert not any(a.shrunk(0.8, 0.8).overlaps(b.shrunk(0.8, 0.8)) for a in boxes for b in boxes if a is not b)
    assert not draw(STATE, labels=False, dpi=40).texts


def test_a_picture_has_the_width_asked_for_on_white(tmp_path):
    path = tmp_path / "mechanism.png"
    assert save_picture(STATE, str(path), width=240) == path
    with Image.open(path) as picture:
        assert picture.width == 240 < picture.height
        assert picture.getpixel((0, 0)) == (255, 255, 255, 255)


def test_a_section_is_drawn_at_o_in_its_scale_into_the_given_axes():
    section = wrench_polytope(STATE, 1000.0).section("linear")
    ax = Figure().add_subplot()
    assert draw_capability(STATE, section, scale=5e-4, ax=ax, dpi=100.0) is ax
    robot, shape = ax.images
    points = (STATE.translation + 5e-4 * section.vertices) @ camera_axes(VIEW)[:2].T
    left, right, bottom, top = shape.get_extent()
    np.testing.assert_allclose([left, bottom, right, top], [*points.min(axis=0), *points.max(axis=0)], atol=0.02)
    assert ax.get_ylim()[1] > top
    assert ax.get_ylim()[0] < robot.get_extent()[2]
    with pytest.raises(ArgumentError, check=with_fields(argument="section")):
        draw_capability(STATE, section.vertices)


@pytest.mark.parametrize("view", [(20.0, 20.0), 0.3, (0.0, np.nan), (0.0, 0.0, 0.0)])
def test_views_that_are_not_two_angles_in_radians(view):
    with pytest.raises(ArgumentError, check=with_fields(argument="view")):
        draw(STATE, view=view)


@pytest.mark.parametrize(
    "save", [save_picture, lambda state, *args, **options: save_gallery({"one": state}, *args, **options)]
)
@pytest.mark.parametrize("options", [{"width": 4}, {"width": 100000}, {"width": 500.5}])
def test_impossible_pictures_are_refused(tmp_path, save, options):
    with pytest.raises(ArgumentError, check=with_fields(argument=next(iter(options)))):
        save(STATE, tmp_path / "mechanism.png", **options)
    assert not list(tmp_path.iterdir())


def solids(state, **options):
    return {solid.name: solid for solid in robot_solids(state, **options)}


def along(vertices, start, end):
    """Nearest and farthest vertex along a line [m], and the largest distance from it."""
    direction = (end - start) / np.linalg.norm(end - start)
    lengths = (vertices - start) @ direction
    across = vertices - start - lengths[:, None] * direction
    return lengths.min(), lengths.max(), np.linalg.norm(across, axis=-1).max()


@pytest.mark.parametrize("name", ["paper", "wide base"])
def test_every_machine_in_every_family_makes_closed_solids(name):
    for family in spm.machine.FAMILIES:
        built = robot_solids(problems.random_branches(problems.MANIPULATORS[name], family, 1, seed=5).configuration[0])
        assert len({solid.name for solid in built}) == len(built)
        for solid in built:
            mesh = trimesh.Trimesh(solid.vertices, solid.faces)
            assert mesh.is_watertight, solid.name
            assert mesh.is_winding_consistent, solid.name
            assert mesh.volume > 0.0, solid.name


@pytest.mark.parametrize("name", ["paper", "as built"])
def test_solids_are_those_of_the_urdf_where_its_joints_put_them(name):
    machine = problems.MANIPULATORS.get(name, problems.as_built(PAPER, 5e-2))
    tree = KinematicTree(urdf_text(machine))
    colours = {m.get("name"): vector(m.find("color").get("rgba"))[:3] for m in tree.root.findall("material")}
    if machine.is_nominal:
        state = problems.random_branches(machine, "TT", 1, seed=2).configuration[0]
    else:
        state = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    frames, built = tree.frames(joint_values(state)), solids(state, frames=False)
    count = 0
    for link, element in tree.links.items():
        for visual in element.findall("visual"):
            file = visual.find("geometry/mesh")
            mesh = trimesh.load(file.get("filename"), process=False, maintain_order=True)
            pose = frames[link] @ origin(visual)
            expected = (mesh.vertices * vector(file.get("scale"))) @ pose[:3, :3].T + pose[:3, 3]
            name_of_mesh = file.get("filename").rpartition("/")[2].removesuffix(".obj")
            solid = built[f"{link} {name_of_mesh}"]
            np.testing.assert_allclose(solid.colour, colours[visual.find("material").get("name")])
            count += 1
            if name_of_mesh in ("tube", "gland"):  # as long as the leg needs: tested below
                continue
            np.testing.assert_allclose(solid.vertices.min(axis=0), expected.min(axis=0), atol=1e-9)
            np.testing.assert_allclose(solid.vertices.max(axis=0), expected.max(axis=0), atol=1e-9)
    assert count == len(built)


@pytest.mark.parametrize("label", ["TT+", "FF+"])
@pytest.mark.parametrize("limits", [None, spm.LegLimits(1.1, 1.5), spm.LegLimits(0.3, 3.0)])
def test_a_leg_is_one_leg_whatever_its_length(label, limits):
    """The real branches have legs from 0.6 to 2 m; the rod begins inside the barrel and ends in the ball."""
    machine = spm.Manipulator(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side, limits)
    state = SOLUTIONS[label]
    built = solids(spm.Configuration(machine, state.pose, state.middle_joints))
    for leg, hip, ball in zip(spm.machine.LEGS, state.leg_bases, state.balls, strict=True):
        length = np.linalg.norm(ball - hip)
        start, joint, barrel_radius = along(built[f"leg_{leg[2:]}_cylinder tube"].vertices, hip, ball)
        rod_start, end, rod_radius = along(built[f"leg_{leg[2:]}_rod tube"].vertices, hip, ball)
        gland_start, gland_end, _ = along(built[f"leg_{leg[2:]}_cylinder gland"].vertices, hip, ball)
        np.testing.assert_allclose([start, end], [0.0, length], atol=1e-12)
        assert 0.0 < rod_start < joint < length
        assert gland_start < joint < gland_end < length
        assert rod_radius < barrel_radius < 0.1 * length


def test_within_its_limits_a_leg_is_that_of_the_urdf():
    """Rod and barrel of fixed lengths overlap, from the shortest leg to the longest, and no rod leaves its hip."""
    for limits in (PAPER.limits, spm.LegLimits(1.0, 1.9), spm.LegLimits([0.9] * 3 + [0.5] * 3, [1.6] * 3 + [0.9] * 3)):
        machine = spm.Manipulator(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side, limits)
        tubes = {part.name: np.ptp(part.vertices[:, 2]) for part in visual_parts(machine) if part.mesh == "tube"}
        for k, leg in enumerate(spm.machine.LEGS):
            barrel, rod = (tubes[f"leg_{leg[2:]}_{half} tube"] for half in ("cylinder", "rod"))
            assert barrel + rod > limits.maximum[k]
            assert max(barrel, rod) < limits.minimum[k]


def test_pins_lie_on_the_revolute_axes_and_legs_go_from_pivots_to_balls():
    """The legs are as long as the distance of pivot and ball, whatever the offsets of the encoders."""
    machine = problems.as_built(PAPER, 5e-2)
    assert np.abs(machine.legs.offsets).max() > 0.02
    state = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    built = solids(state)
    place = state.pose.as_matrix()
    for k, leg in enumerate(spm.machine.LEGS):
        pivot, axis = machine.legs.pivots[k], machine.legs.axes[k]
        if k >= 3:
            pivot, axis = place[:3, :3] @ pivot + place[:3, 3], place[:3, :3] @ axis
        link = f"{'base_a' if k < 3 else 'terminal_c'}{k % 3 + 1}"
        low, high, radius = along(built[f"{link} pin"].vertices, pivot, pivot + axis)
        assert low == pytest.approx(-high)
        assert high > 2.0 * radius
        ball = built[f"leg_{leg[2:]}_tip ball"].vertices
        radii = np.linalg.norm(ball - state.balls[k], axis=-1)
        np.testing.assert_allclose(radii, radii[0], rtol=1e-4)
        start, _, _ = along(built[f"leg_{leg[2:]}_cylinder tube"].vertices, pivot, state.balls[k])
        _, end, _ = along(built[f"leg_{leg[2:]}_rod tube"].vertices, pivot, state.balls[k])
        assert start == pytest.approx(0.0, abs=1e-9)
        assert end == pytest.approx(state.readings[k] - machine.legs.offsets[k], abs=1e-9)


def test_solids_of_carriages_and_cranks_are_where_the_urdf_has_them():
    state = kinds_of_legs.states(kinds_of_legs.machine_of_kinds("PRS", "RRS", built=True))[0]
    robot = read_robot(state.machine)
    frames, found = robot.frames(joint_values(state)), iter(robot_solids(state, frames=False))
    seen = set()
    for name, link in robot.links.items():
        for shape in link.visuals:
            solid, (vertices, _) = next(found), read_obj(Path(shape.mesh))
            pose = frames[name] @ shape.placement.matrix
            expected = (vertices * shape.size) @ pose[:3, :3].T + pose[:3, 3]
            # The middle platform of a machine as built is where its lower balls are.
            np.testing.assert_allclose(solid.vertices, expected, atol=1e-12, err_msg=solid.name)
            seen.add(solid.name.partition(" ")[2])
    assert next(found, None) is None
    assert {"servo", "rail", "carriage", "eye", "clevis", "tube", "ball"} <= seen
    assert draw(state).images


@pytest.mark.parametrize(
    "state",
    [
        SOLUTIONS,
        SOLUTIONS.configurations,
        SOLUTIONS["FT+"],
        spm.Configuration(PAPER, POSE, PAPER.base_joints),
        spm.Configuration(PAPER, POSE, [[0.0, 0.0, 1.0], [0.0, 0.1, 1.0], [0.0, 0.2, 1.0]]),
    ],
)
def test_what_cannot_be_shown_is_refused(state):
    with pytest.raises(ArgumentError, check=with_fields(argument="configuration")):
        robot_solids(state)
