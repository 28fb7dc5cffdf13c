"""Sections: lines where the plane cuts the shell, cells where something is reached."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import spm_pin as spm
from spm_pin.display.shell_plots import FAMILY_COLOURS, Plane, draw_section, sections_figure
from spm_pin.errors import ArgumentError
from spm_pin.workspace.paper_shell import workspace_shell

SHELL = workspace_shell(spm.Geometry.paper(), resolution=12)
LEVEL = Plane.level(2.1)


def drawn(plane: Plane, reached: np.ndarray | None = None, aspect: np.ndarray | None = None, **options: float) -> Axes:
    points = np.empty((0, 3)) if reached is None else reached
    ax = Figure().add_subplot()
    draw_section(ax, SHELL, plane, points, np.ones(len(points), np.int8) if aspect is None else aspect, **options)
    return ax


def outline_of(ax: Axes) -> LineCollection:
    (outline,) = ax.collections
    assert isinstance(outline, LineCollection)
    return outline


@pytest.mark.parametrize("plane", [LEVEL, Plane.level(2.5), Plane.upright(0.0), Plane.upright(0.7)])
def test_the_outline_separates_inside_from_outside(plane: Plane) -> None:
    segments = np.array(outline_of(drawn(plane)).get_segments())
    to_space = np.array([plane.across, plane.up])
    middles = segments.mean(axis=1)
    tangents = segments[:, 1] - segments[:, 0]
    long = np.linalg.norm(tangents, axis=-1) > 1e-3
    normals = tangents[long, ::-1] * [1.0, -1.0] / np.linalg.norm(tangents[long], axis=-1, keepdims=True)
    sides = [SHELL.contains(plane.origin + (middles[long] + step * normals) @ to_space) for step in (1e-5, -1e-5)]
    np.testing.assert_array_equal(sides[0], ~sides[1])
    # Every line goes on: its ends come in pairs.
    counts = np.unique(segments.reshape(-1, 2).round(7), axis=0, return_counts=True)[1]
    assert set(counts) == {2}


def test_lines_have_their_families_colours() -> None:
    outline = outline_of(drawn(Plane.upright(np.pi / 2)))
    colours = {tuple(colour[:3]) for colour in outline.get_colors()}
    assert colours == {tuple(float(x) for x in colour) for colour in FAMILY_COLOURS.values()}
    top = np.array(outline.get_segments())[:, :, 1].max(axis=1).argmax()
    assert tuple(outline.get_colors()[top][:3]) == FAMILY_COLOURS["St"]


def cells(ax: Axes) -> tuple[np.ma.MaskedArray, tuple[float, ...]]:
    (image,) = ax.images
    return image.get_array(), image.get_extent()


def test_cells_are_filled_where_points_are_near_the_plane() -> None:
    rng = np.random.default_rng(0)
    square = np.column_stack([rng.uniform(0.0, 0.5, 5000), rng.uniform(-0.2, 0.2, 5000), np.full(5000, 2.1)])
    beside = square + np.array([0.5, 0.0, 0.06])
    array, extent = cells(drawn(LEVEL, np.concatenate([square, beside]), cell=0.1))
    assert extent == pytest.approx((0.0, 0.5, -0.2, 0.2))
    assert array.shape == (4, 5)
    assert array.count() == 20
    assert set(array.compressed()) == {1}


def test_signs_decide_the_shade_and_both_together_another() -> None:
    x = np.arange(0.05, 1.0, 0.1)
    points = np.column_stack([x, np.full(10, 0.05), np.full(10, 2.1)])
    both = np.concatenate([points, points[4:6]])
    signs = np.concatenate([np.where(x < 0.5, -1, 1), [1, -1]])
    array, _ = cells(drawn(LEVEL, both, signs, cell=0.1))
    assert array.tolist() == [[0, 0, 0, 0, 2, 2, 1, 1, 1, 1]]


def test_small_gaps_in_a_sample_are_filled_and_large_ones_are_not() -> None:
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2)
    hole = (np.abs(grid - [5, 5]).max(axis=1) == 0) | (np.abs(grid - [13, 13]).max(axis=1) <= 1)
    points = np.column_stack([0.1 * grid[~hole] + 0.05, np.full((~hole).sum(), 2.1)])
    array, _ = cells(drawn(LEVEL, points, cell=0.1))
    assert np.ma.count_masked(array) == 9
    assert array.mask[12:15, 12:15].all()


def test_axes_are_those_of_the_plane() -> None:
    upright = Plane.upright(np.pi / 2)
    np.testing.assert_allclose(upright.project(np.array([[0.1, 0.2, 0.3]])), [[0.2, 0.3]], atol=1e-15)
    np.testing.assert_allclose(upright.normal, [1.0, 0.0, 0.0], atol=1e-15)
    ax = drawn(upright)
    assert ax.get_xlabel() == "along azimuth 90° [m]"
    assert ax.get_aspect() == 1.0
    low, high = ax.get_ylim()
    assert low < SHELL.vertices[:, 2].min()
    assert high > SHELL.vertices[:, 2].max()


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


def test_planes_that_meet_nothing() -> None:
    with pytest.raises(ArgumentError, match=r"a plane through the shell, got Z = 210 m\. Metres"):
        drawn(Plane.level(210.0))
    with pytest.raises(ArgumentError, match="a Shell"):
        sections_figure(SHELL.mesh, np.empty((0, 3)), np.empty(0, np.int8))  # type: ignore[arg-type]
