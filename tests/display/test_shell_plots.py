"""Pictures, files and sections of the shell: patches where they are seen, named, in files that others read."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from display.pixels import inner_pixels, nearest, off_shade
from error_fields import with_fields
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
from spm_pin.errors import ArgumentError

SHELL = workspace_shell(spm.Manipulator.paper(), resolution=10)
NAMES = [patch.name for patch in SHELL.patches]
LEVEL = Plane.level(2.1)


def first_hits(view: tuple[float, float], points: np.ndarray) -> np.ndarray:
    return nearest([(SHELL.vertices, SHELL.faces[patch.faces]) for patch in SHELL.patches], view, points)


def test_every_pixel_shows_the_nearest_patch_in_its_familys_colour() -> None:
    view = VIEWS["isometric"]
    picture = draw_shell(SHELL, view=view, labels=False, dpi=60).images[0]
    colours, seen = inner_pixels(picture, 800, 1.2, lambda points: first_hits(view, points))
    assert len(set(seen)) > 6
    for colour, k in zip(colours, seen, strict=True):
        assert colour[3] == (k >= 0)
        if k >= 0:
            assert off_shade(colour[:3], FAMILY_COLOURS[SHELL.patches[k].family]) < 5e-3


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_meshes_that_others_read_are_closed(tmp_path, suffix: str) -> None:
    mesh = trimesh.load_mesh(save_mesh(SHELL, tmp_path / f"shell{suffix}"))
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert mesh.volume == pytest.approx(SHELL.mesh.volume, rel=1e-5)
    with pytest.raises(ArgumentError, check=with_fields(argument="path")):
        save_mesh(SHELL, tmp_path / "shell.step")
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


def drawn(plane: Plane, reached: np.ndarray | None = None, aspect: np.ndarray | None = None, **options: float) -> Axes:
    points = np.empty((0, 3)) if reached is None else reached
    ax = Figure().add_subplot()
    draw_section(ax, SHELL, plane, points, np.ones(len(points), np.int8) if aspect is None else aspect, **options)
    return ax


@pytest.mark.parametrize("plane", [LEVEL, Plane.upright(0.7)])
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


@pytest.mark.documents
def test_figures_have_their_views_and_planes() -> None:
    views, cuts = shell_figure(SHELL, dpi=40), sections_figure(SHELL, np.empty((0, 3)), np.empty(0, np.int8))
    assert [ax.get_title() for ax in views.axes] == ["(a) isometric", "(b) top", "(c) front", "(d) bottom"]
    titles = ["Z = 1.9 m", "Z = 2.1 m", "Z = 2.5 m", "upright, azimuth 0°", "upright, azimuth 90°"]
    assert [ax.get_title() for ax in cuts.axes if ax.get_title()] == titles
