"""Pictures and files of the shell: patches where they are seen, named, in files that others read."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from display.pixels import inner_pixels, nearest, off_shade
from error_fields import with_fields

import spm_pin as spm
from spm_pin.crosscheck.paper_shell import workspace_shell
from spm_pin.display.shell_plots import (
    FAMILY_COLOURS,
    VIEWS,
    draw_shell,
    save_mesh,
    shell_figure,
)
from spm_pin.errors import ArgumentError

SHELL = workspace_shell(spm.Manipulator.paper(), resolution=10)
NAMES = [patch.name for patch in SHELL.patches]


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


@pytest.mark.documents
def test_a_figure_has_its_views() -> None:
    views = shell_figure(SHELL, dpi=40)
    assert [ax.get_title() for ax in views.axes] == ["(a) isometric", "(b) top", "(c) front", "(d) bottom"]
