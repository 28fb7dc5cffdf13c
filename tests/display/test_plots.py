"""Pictures: hidden surfaces at every pixel, labels, refusals."""

from __future__ import annotations

import sys

import numpy as np
import problems
import pytest
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.capability import wrench_polytope
from spm_pin.display.plots import draw, draw_capability, save_gallery, save_picture
from spm_pin.display.rendering import camera_axes, robot_solids
from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.mechanism.notebook import VIEW

PAPER = spm.Geometry.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
SOLUTIONS = spm.inverse_displacement(PAPER, POSE)
STATE = SOLUTIONS.physical()
HOME = problems.in_leg_space(PAPER, 1, seed=0, legs=np.full((1, 6), 1.2)).configuration[0]
COLOURS = {solid.name: solid.colour for solid in robot_solids(STATE)}
PLATES = (("base", "base"), ("middle_platform", "middle"), ("terminal_platform", "terminal"))


def looking(view):
    """The view's axes to the right, up and towards the viewer, as rows, from elementary rotations."""
    azimuth, elevation = view
    turn = np.array([[np.cos(azimuth), np.sin(azimuth), 0], [-np.sin(azimuth), np.cos(azimuth), 0], [0, 0, 1]])
    nod = np.array([[np.cos(elevation), 0, np.sin(elevation)], [0, 1, 0], [-np.sin(elevation), 0, np.cos(elevation)]])
    return (nod @ turn)[[1, 2, 0]]


def nearest_solids(solids, view, points):
    """Which solid a viewer sees at each point (n, 2), -1 for none, by trimesh's rays."""
    right, up, near = looking(view)
    whole = trimesh.util.concatenate([trimesh.Trimesh(solid.vertices, solid.faces) for solid in solids])
    owner = np.append(np.repeat(np.arange(len(solids)), [len(solid.faces) for solid in solids]), -1)
    origins = points[:, :1] * right + points[:, 1:] * up + 10.0 * near
    return owner[whole.ray.intersects_first(origins, np.tile(-near, (len(points), 1)))]


def off_shade(pixel, colour):
    """Return the distance of a pixel from a colour in some light, in which the channels keep their proportion."""
    factor = np.dot(pixel, colour) / np.dot(colour, colour)
    return np.abs(pixel - factor * np.asarray(colour)).max()


@pytest.mark.parametrize(
    ("label", "view"), [("TT+", VIEW), ("FF+", (-2.1, 0.1)), ("FF+", (1.0, -0.6)), ("TT+", (0.0, np.pi / 2))]
)
def test_every_pixel_shows_the_nearest_solid(label, view):
    state = SOLUTIONS[label]
    picture = draw(state, view=view, labels=False, dpi=90).images[0]
    image, (left, right, _, top) = np.asarray(picture.get_array()), picture.get_extent()
    rows, columns = image.shape[:2]
    rng = np.random.default_rng(8)
    row, column = rng.integers(2, rows - 2, 600), rng.integers(2, columns - 2, 600)
    step = (right - left) / columns
    points = np.stack([left + (column + 0.5) * step, top - (row + 0.5) * step], axis=-1)
    solids = robot_solids(state, frames=False)
    around = [
        nearest_solids(solids, view, points + 0.8 * step * np.array(d)) for d in ((-1, -1), (-1, 1), (1, -1), (1, 1))
    ]
    seen = nearest_solids(solids, view, points)
    inner = np.all([seen == other for other in around], axis=0)
    assert len({solids[i].name for i in seen[inner & (seen >= 0)]}) > 15
    for r, c, i in zip(row[inner], column[inner], seen[inner], strict=True):
        assert image[r, c, 3] == (i >= 0)
        if i >= 0:
            assert off_shade(image[r, c, :3], solids[i].colour) < 2e-3, (solids[i].name, r, c)


def pixel(ax, point):
    """The colour that Agg gives a figure at a point of its data coordinates."""
    canvas = FigureCanvasAgg(ax.figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())
    x, y = ax.transData.transform(point)
    return picture[picture.shape[0] - 1 - int(y), int(x), :3] / 255.0


@pytest.mark.parametrize(
    ("elevation", "radius", "name"),
    [(0.5, 0.12, "terminal_platform"), (-0.5, 0.25, "base"), (0.5, 0.17, "middle_platform")],
)
def test_plates_hide_one_another_from_above_and_below(elevation, radius, name):
    # Opposite leg 1 the terminal platform ends 0.15 m from the middle, the middle one 0.19 m, the base 0.30 m.
    right, up, _ = looking((0.0, elevation * np.pi))
    point = -radius * HOME.geometry.radial_directions[0]
    colour = pixel(draw(HOME, view=(0.0, elevation * np.pi), labels=False, dpi=60), (point @ right, point @ up))
    plates = {body: COLOURS[f"{body} {mesh}_plate"] for body, mesh in PLATES}
    assert min(plates, key=lambda plate: off_shade(colour, plates[plate])) == name
    assert off_shade(colour, plates[name]) < 1.0 / 255.0


def test_labels_name_all_joints_legs_and_frames_within_the_picture():
    ax = draw(STATE, dpi=60)
    texts = {text.get_text() for text in ax.texts}
    assert {f"${letter}_{i}$" for letter in "abc" for i in (1, 2, 3)} <= texts
    assert {f"$r_{{{leg[2:]}}}$" for leg in spm.mechanism.LEGS} <= texts
    assert {f"${axis}$" for axis in "XYZxyz"} | {r"$\{B\}$", r"$\{m\}$"} <= texts
    FigureCanvasAgg(ax.figure).draw()
    boxes = [text.get_window_extent() for text in ax.texts if not text.get_path_effects()]  # without the halos
    assert all(ax.bbox.contains(*box.min) and ax.bbox.contains(*box.max) for box in boxes)
    assert not any(a.shrunk(0.8, 0.8).overlaps(b.shrunk(0.8, 0.8)) for a in boxes for b in boxes if a is not b)
    assert not draw(STATE, labels=False, dpi=40).texts


def test_a_picture_has_the_width_asked_for_and_no_background(tmp_path):
    path = tmp_path / "mechanism.png"
    assert save_picture(STATE, str(path), width=240, background="none") == path
    with Image.open(path) as picture:
        assert picture.width == 240 < picture.height
        assert picture.getpixel((0, 0))[3] == 0


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
    with pytest.raises(ArgumentError, match="section"):
        draw_capability(STATE, section.vertices)


@pytest.mark.parametrize("view", [(20.0, 20.0), (0.0, 2.0), 0.3, (0.0, np.nan), (0.0, 0.0, 0.0)])
def test_views_that_are_not_two_angles_in_radians(view):
    with pytest.raises(ArgumentError, match="azimuth and elevation in radians"):
        draw(STATE, view=view)


def test_three_dimensional_axes_are_refused():
    with pytest.raises(ArgumentError, match="projection='3d'"):
        draw(STATE, ax=Figure().add_subplot(projection="3d"))


@pytest.mark.parametrize(
    "save", [save_picture, lambda state, *args, **kwargs: save_gallery({"one": state}, *args, **kwargs)]
)
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"width": 4}, "width: expected at least [12]00 pixels, a whole number, got 4"),
        ({"width": 100000}, "width: expected at most 6000 pixels, a whole number, got 100000"),
        ({"width": 500.5}, "width: expected at most 6000 pixels, a whole number, got 500.5"),
        ({"background": "notacolour"}, "background: expected a colour of matplotlib"),
    ],
)
def test_impossible_pictures_are_refused(tmp_path, save, options, says):
    with pytest.raises(ArgumentError, match=says):
        save(STATE, tmp_path / "mechanism.png", **options)
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_the_error_tells_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r'this needs matplotlib.*pip install "\.\[plots\]"') as caught:
        draw(STATE)
    assert isinstance(caught.value, ImportError)
