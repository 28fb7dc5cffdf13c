"""The shell of the workspace: the paper's Fig. 2, from four sides with its 24 patches named, and mesh files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy import ndimage

from spm_pin.display.figure_files import new_figure
from spm_pin.display.plots import draw_solids
from spm_pin.display.rendering import VIEW, Rendering, camera_axes
from spm_pin.display.scene import Colour, Scene, Solid
from spm_pin.errors import require_extra
from spm_pin.mechanism.arguments import check_instance, file_path, writing
from spm_pin.workspace.paper_shell import Patch, Shell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's, light ones for surfaces, https://jfly.uni-koeln.de/color/.
FAMILY_COLOURS: dict[str, Colour] = {
    "St": (0.337, 0.706, 0.914),
    "Sc": (0.902, 0.624, 0.0),
    "Sm": (0.0, 0.62, 0.451),
    "Sl": (0.8, 0.475, 0.655),
}
"""Colours of the patches St1 to St3, Sc1 to Sc9, Sm1 to Sm9 and Sl1 to Sl3."""
VIEWS: dict[str, tuple[float, float]] = {
    "isometric": (math.radians(-60.0), math.asin(1.0 / math.sqrt(3.0))),
    "top": (-0.5 * math.pi, 0.5 * math.pi),
    "front": (-0.5 * math.pi, 0.0),
    "bottom": (-0.5 * math.pi, -0.5 * math.pi),
}
"""Azimuth and elevation [rad] of the panels of `shell_figure`."""
MESH_FORMATS = (".stl", ".ply", ".obj", ".glb")
"""File types that shells are written in."""
_EDGE = 0.6  # width of edges in points
_FONT = 9.0
_INK = (0.13, 0.15, 0.18)
_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def draw_shell(
    shell: Shell, *, ax: Axes | None = None, view: tuple[float, float] = VIEW, labels: bool = True, dpi: float = 200.0
) -> Axes:
    """Draw a shell into a 2-D matplotlib Axes, in orthographic projection.

    Every pixel shows the nearest patch, in the colour of its family, see `FAMILY_COLOURS`. Data coordinates are metres
    to the right of O and above it as the viewer sees it.

    Parameters are those of `spm_pin.display.plots.draw`, with the shell for the configuration; `labels` names the
    patches that are seen well enough.

    Raises
    ------
    ArgumentError
        If `shell` is no Shell, `ax` is three-dimensional, or `view` is not two angles.
    """
    check_instance(shell, Shell, "shell", "Make one with workspace.workspace_shell(geometry)")
    camera = camera_axes(view)
    solids = [
        # The renderer shows what faces the viewer, and that is all one sees of a closed shell.
        Solid(patch.name, "robot", FAMILY_COLOURS[patch.family], shell.vertices, shell.faces[patch.faces])
        for patch in shell.patches
    ]
    ax, _, rendering = draw_solids(Scene(tuple(solids), 1.0), camera, (0.03, 0.03), ax=ax, dpi=dpi, edge=_EDGE)
    if labels:
        from matplotlib.patheffects import withStroke

        for patch, (x, y) in _places(shell, rendering, 0.6 * _FONT / 72.0 * dpi):
            written = ax.text(x, y, patch_symbol(patch.name), fontsize=_FONT, color=_INK, ha="center", va="center")
            written.set_path_effects([withStroke(linewidth=0.25 * _FONT, foreground="white", alpha=0.7)])
    return ax


def style_axes(ax: Axes, labels: tuple[str, str]) -> None:
    """Give the axes of a panel names, small numbers, and lines on two sides."""
    ax.set_xlabel(labels[0], fontsize=8.0)
    ax.set_ylabel(labels[1], fontsize=8.0)
    ax.tick_params(labelsize=8.0)
    ax.spines[["top", "right"]].set_visible(False)


def patch_symbol(name: str) -> str:
    """Return the name of a patch or a family as TeX."""
    return f"${name[0]}_{{{name[1:]}}}$"


def _places(shell: Shell, seen: Rendering, room: float) -> list[tuple[Patch, tuple[float, float]]]:
    """Return the places of patches' names, amid what is seen of each, if farther than `room` pixels from the rest."""
    left, _, _, top = seen.extent
    pixel = (seen.extent[1] - left) / seen.solid.shape[1]
    found = []
    for k, patch in enumerate(shell.patches):
        clearance = ndimage.distance_transform_edt(np.pad(seen.solid == k, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(int(clearance.argmax()), clearance.shape)
        if clearance[row, column] > room:
            found.append((patch, (left + (int(column) + 0.5) * pixel, top - (int(row) + 0.5) * pixel)))
    return found


def shell_figure(shell: Shell, *, labels: bool = True, dpi: float = 200.0) -> Figure:
    """Draw a shell from all sides, after the paper's Fig. 2.

    The isometric, the top and the front view, and for what those hide the one from below; a legend names the families.

    Parameters and errors are those of `draw_shell`.
    """
    figure = new_figure(9.0, 7.4, layout="constrained")
    from matplotlib.patches import Patch as Swatch

    panels = zip("abcd", VIEWS.items(), figure.subplots(2, 2).ravel(), strict=True)
    names = {"top": "Y", "front": "Z", "bottom": "\N{MINUS SIGN}Y"}
    for letter, (name, view), ax in panels:
        draw_shell(shell, ax=ax, view=view, labels=labels, dpi=dpi)
        ax.set_title(f"({letter}) {name}", fontsize=10.0)
        if name in names:
            style_axes(ax, ("X [m]", f"{names[name]} [m]"))
        else:
            ax.axis("off")
    swatches = []
    for family, colour in FAMILY_COLOURS.items():
        members = [patch.name for patch in shell.patches if patch.family == family]
        ends = f"{patch_symbol(members[0])} \N{EN DASH} {patch_symbol(members[-1])}"
        swatches.append(Swatch(facecolor=colour, edgecolor=_INK, label=ends))
    figure.legend(handles=swatches, loc="outside lower center", ncols=4, frameon=False, fontsize=9.0)
    return figure


def save_mesh(shell: Shell, path: str | Path) -> Path:
    """Write a shell's mesh, lengths in metres.

    STL and OBJ hold one closed mesh, PLY the same with the colours of the families. GLB holds each patch as a mesh of
    its own, named and coloured, and has its y axis upward, as that format requires.

    Raises
    ------
    ArgumentError
        If the name does not end in one of `MESH_FORMATS`, or the file cannot be written.
    MissingExtraError
        If trimesh is not installed.
    """
    path = file_path(path, suffixes=MESH_FORMATS)
    require_extra("plots", "trimesh")
    content = _patchwork(shell) if path.suffix.lower() == ".glb" else _whole(shell, path.suffix.lower()[1:])
    with writing(path):
        path.write_bytes(content)
    return path


def _rgba(patch: Patch) -> list[int]:
    return [*(round(255 * channel) for channel in FAMILY_COLOURS[patch.family]), 255]


def _whole(shell: Shell, kind: str) -> bytes:
    import trimesh

    colours = [np.tile(_rgba(patch), (len(patch.faces), 1)) for patch in shell.patches]
    mesh = trimesh.Trimesh(
        shell.vertices, shell.faces, face_colors=np.concatenate(colours) if kind == "ply" else None, process=False
    )
    content = mesh.export(file_type=kind)
    return content.encode() if isinstance(content, str) else cast("bytes", content)


def _patchwork(shell: Shell) -> bytes:
    import trimesh

    scene = trimesh.Scene()
    for patch in shell.patches:
        material = trimesh.visual.material.PBRMaterial(
            name=patch.family, baseColorFactor=_rgba(patch), metallicFactor=0.0, roughnessFactor=0.8
        )
        mesh = trimesh.Trimesh(shell.vertices, shell.faces[patch.faces], process=False)
        mesh.remove_unreferenced_vertices()
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=patch.name, geom_name=patch.name, transform=_Y_UP)
    return cast("bytes", scene.export(file_type="glb"))
