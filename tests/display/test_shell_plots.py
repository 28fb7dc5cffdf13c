"""Pictures, files and sections of the shell: patches where they are seen, named, in files that others read."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from display.pixels import inner_pixels, nearest, off_shade
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.crosscheck.paper_shell import workspace_shell
from spm_pin.display.shell_plots import (
    FAMILY_COLOURS,
    VIEWS,
    Plane,
    draw_section,
    draw_shell,
    save_mesh,
    sections_figure,
    shell_figure,
)
from spm_pin.display.writing import save_figure
from spm_pin.errors import ArgumentError

SHELL = workspace_shell(spm.Manipulator.paper(), resolution=10)
NAMES = [patch.name for patch in SHELL.patches]
LEVEL = Plane.level(2.1)


def first_hits(view: tuple[float, float], points: np.ndarray) -> np.ndarray:
    return nearest([(SHELL.vertices, SHELL.faces[patch.faces]) for patch in SHELL.patches], view, points)


@pytest.mark.parametrize("name", ["isometric", "bottom"])
def test_every_pixel_shows_the_nearest_patch_in_its_familys_colour(name: str) -> None:
    view = VIEWS[name]
    picture = draw_shell(SHELL, view=view, labels=False, dpi=60).images[0]
    colours, seen = inner_pixels(picture, 800, 1.2, lambda points: first_hits(view, points))
    assert len(set(seen)) > 6
    for colour, k in zip(colours, seen, strict=True):
        assert colour[3] == (k >= 0)
        if k >= 0:
            assert off_shade(colour[:3], FAMILY_COLOURS[SHELL.patches[k].family]) < 5e-3


def test_names_stand_on_their_patches_and_all_are_there_from_above_and_below() -> None:
    found = set()
    for name in VIEWS:
        for text in draw_shell(SHELL, view=VIEWS[name], dpi=30).texts:
            patch = text.get_text().replace("$", "").replace("_{", "").replace("}", "")
            # A ray through a vertex may slip between its faces.
            around = np.array(text.get_position()) + 1e-4 * np.array([[1.0, 0.3], [-0.3, 1.0], [-1.0, -0.3]])
            assert {NAMES[k] for k in first_hits(VIEWS[name], around)} == {patch}
            found.add((name, patch))
    assert {patch for name, patch in found if name == "top"} == {n for n in NAMES if n[:2] in ("St", "Sc")}
    assert {patch for name, patch in found if name == "bottom"} == {n for n in NAMES if n[:2] in ("Sm", "Sl")}


def test_family_colours_differ_for_every_colour_vision() -> None:
    # Machado, Oliveira and Fernandes 2009, complete dichromacy, https://doi.org/10.1109/TVCG.2009.113, in linear RGB.
    deficiencies = {
        "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    }
    linear = np.array(list(FAMILY_COLOURS.values())) ** 2.2
    for matrix in deficiencies.values():
        seen = np.clip(linear @ np.array(matrix).T, 0.0, 1.0) ** (1.0 / 2.2)
        apart = np.linalg.norm(seen[:, None] - seen, axis=-1) + 9.0 * np.eye(4)
        assert apart.min() > 0.15


def test_the_figure_has_four_views_and_a_legend(tmp_path) -> None:
    figure = shell_figure(SHELL, dpi=40)
    assert [ax.get_title() for ax in figure.axes] == ["(a) isometric", "(b) top", "(c) front", "(d) bottom"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][1] == r"$S_{c1}$ – $S_{c9}$"
    path = save_figure(figure, tmp_path / "fig2.png", dpi=50)
    with Image.open(path) as picture:
        assert picture.size == (450, 370)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_meshes_that_others_read_are_closed(tmp_path, suffix: str) -> None:
    mesh = trimesh.load_mesh(save_mesh(SHELL, tmp_path / f"shell{suffix}"))
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert mesh.volume == pytest.approx(SHELL.mesh.volume, rel=1e-5)
    if suffix == ".ply":
        colours = {tuple(c) for c in mesh.visual.face_colors[:, :3].tolist()}
        assert colours == {tuple(round(255 * x) for x in c) for c in FAMILY_COLOURS.values()}


def test_glb_holds_named_patches_with_y_upward(tmp_path) -> None:
    scene = trimesh.load_scene(save_mesh(SHELL, tmp_path / "shell.glb"))
    assert sorted(scene.geometry) == sorted(NAMES)
    joined = scene.to_mesh()
    low, high = SHELL.vertices.min(axis=0), SHELL.vertices.max(axis=0)
    np.testing.assert_allclose(joined.bounds, [[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]], atol=1e-6)
    joined.merge_vertices(merge_norm=True, merge_tex=True)
    assert joined.volume == pytest.approx(SHELL.mesh.volume, rel=1e-5)
    assert joined.area == pytest.approx(SHELL.area, rel=1e-5)


@pytest.mark.parametrize(("name", "says"), [("shell.step", "ending in .stl, .ply"), ("folder.stl", "Is a directory")])
def test_mesh_files_that_cannot_be_written(tmp_path, name: str, says: str) -> None:
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(ArgumentError, match=says) as caught:
        save_mesh(SHELL, tmp_path / name)
    assert caught.value.argument == "path"


def test_arguments_that_are_no_shell_or_axes_are_refused() -> None:
    with pytest.raises(ArgumentError, match="a Shell, got Trimesh"):
        draw_shell(SHELL.mesh)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="a Shell"):
        sections_figure(SHELL.mesh, np.empty((0, 3)), np.empty(0, np.int8))  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="two-dimensional"):
        draw_shell(SHELL, ax=Figure().add_subplot(projection="3d"))
    with pytest.raises(ArgumentError, match=r"a plane through the shell, got Z = 210 m\. Is it in metres"):
        drawn(Plane.level(210.0))


def drawn(plane: Plane, reached: np.ndarray | None = None, aspect: np.ndarray | None = None, **options: float) -> Axes:
    points = np.empty((0, 3)) if reached is None else reached
    ax = Figure().add_subplot()
    draw_section(ax, SHELL, plane, points, np.ones(len(points), np.int8) if aspect is None else aspect, **options)
    return ax


@pytest.mark.parametrize("plane", [LEVEL, Plane.level(2.5), Plane.upright(0.0), Plane.upright(0.7)])
def test_the_outline_separates_inside_from_outside(plane: Plane) -> None:
    (outline,) = drawn(plane).collections
    segments = np.array(outline.get_segments())
    middles = segments.mean(axis=1)
    tangents = segments[:, 1] - segments[:, 0]
    long = np.linalg.norm(tangents, axis=-1) > 1e-3
    normals = tangents[long, ::-1] * [1.0, -1.0] / np.linalg.norm(tangents[long], axis=-1, keepdims=True)
    sides = [SHELL.contains(plane.origin + (middles[long] + step * normals) @ plane.axes) for step in (1e-5, -1e-5)]
    np.testing.assert_array_equal(sides[0], ~sides[1])
    # Every line goes on: its ends come in pairs.
    counts = np.unique(segments.reshape(-1, 2).round(7), axis=0, return_counts=True)[1]
    assert set(counts) == {2}


def test_lines_have_their_families_colours() -> None:
    (outline,) = drawn(Plane.upright(np.pi / 2)).collections
    colours = {tuple(colour[:3]) for colour in outline.get_colors()}
    assert colours == {tuple(float(x) for x in colour) for colour in FAMILY_COLOURS.values()}
    top = np.array(outline.get_segments())[:, :, 1].max(axis=1).argmax()
    assert tuple(outline.get_colors()[top][:3]) == FAMILY_COLOURS["St"]


def test_cells_are_filled_where_points_are_near_the_plane() -> None:
    rng = np.random.default_rng(0)
    square = np.column_stack([rng.uniform(0.0, 0.5, 5000), rng.uniform(-0.2, 0.2, 5000), np.full(5000, 2.1)])
    beside = square + np.array([0.5, 0.0, 0.06])
    (image,) = drawn(LEVEL, np.concatenate([square, beside]), cell=0.1).images
    assert image.get_extent() == pytest.approx((0.0, 0.5, -0.2, 0.2))
    assert image.get_array().shape == (4, 5)
    assert image.get_array().count() == 20
    assert set(image.get_array().compressed()) == {1}


def test_signs_decide_the_shade_and_both_together_another() -> None:
    x = np.arange(0.05, 1.0, 0.1)
    points = np.column_stack([x, np.full(10, 0.05), np.full(10, 2.1)])
    signs = np.concatenate([np.where(x < 0.5, -1, 1), [1, -1]])
    (image,) = drawn(LEVEL, np.concatenate([points, points[4:6]]), signs, cell=0.1).images
    assert image.get_array().tolist() == [[0, 0, 0, 0, 2, 2, 1, 1, 1, 1]]


def test_small_gaps_in_a_sample_are_filled_and_large_ones_are_not() -> None:
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2)
    hole = (np.abs(grid - [5, 5]).max(axis=1) == 0) | (np.abs(grid - [13, 13]).max(axis=1) <= 1)
    points = np.column_stack([0.1 * grid[~hole] + 0.05, np.full((~hole).sum(), 2.1)])
    array = drawn(LEVEL, points, cell=0.1).images[0].get_array()
    assert np.ma.count_masked(array) == 9
    assert array.mask[12:15, 12:15].all()


def test_axes_are_those_of_the_plane() -> None:
    upright = Plane.upright(np.pi / 2)
    np.testing.assert_allclose(upright.project(np.array([[0.1, 0.2, 0.3]])), [[0.2, 0.3]], atol=1e-15)
    np.testing.assert_allclose(upright.normal, [1.0, 0.0, 0.0], atol=1e-15)
    ax = drawn(upright)
    assert (ax.get_xlabel(), ax.get_aspect()) == ("along azimuth 90° [m]", 1.0)
    assert ax.get_ylim()[0] < SHELL.vertices[:, 2].min() < SHELL.vertices[:, 2].max() < ax.get_ylim()[1]


def test_the_figure_has_a_panel_per_plane_and_names_what_is_there() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(SHELL.vertices.min(axis=0), SHELL.vertices.max(axis=0), (4000, 3))
    figure = sections_figure(SHELL, points, np.sign(points[:, 0]).astype(np.int8))
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert titles == ["Z = 1.9 m", "Z = 2.1 m", "Z = 2.5 m", "upright, azimuth 0°", "upright, azimuth 90°"]
    legend = figure.axes[-1].get_legend()
    words = [text.get_text() for text in legend.get_texts()]
    assert words[0] == "shell, $S_{t}$"
    assert words[4:] == ["reached, det K < 0", "reached, det K > 0", "reached, either sign"]
    assert to_rgb(FAMILY_COLOURS["Sl"]) == legend.get_lines()[3].get_color()
