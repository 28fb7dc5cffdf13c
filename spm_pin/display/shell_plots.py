"""Pictures and meshes of the workspace: the reachable set, and the paper's 24 surfaces, Fig. 2."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from spm_pin.crosscheck.paper_shell import Patch, Shell
from spm_pin.display.plots import INK, draw_solids
from spm_pin.display.rendering import VIEW, Colour, Rendering, Solid, camera_axes
from spm_pin.display.writing import legend_below, new_figure, write_name
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.support.arguments import type_and_value
from spm_pin.support.files import file_path, write_files
from spm_pin.workspace.boundary import Boundary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Light colours of Okabe and Ito for surfaces, https://jfly.uni-koeln.de/color/.
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
"""File types of meshes."""
_REACHED: Colour = (0.337, 0.706, 0.914)
"""Colour of the boundary of the reachable set."""
_MAKE = "Make one with workspace.reachable_boundary(machine) or crosscheck.workspace_shell(machine)"
_EDGE = 0.6  # width of edges in points
_FONT = 9.0
_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


class _Part(NamedTuple):
    name: str
    family: str
    colour: Colour
    faces: npt.NDArray[np.intp]


def _parts(shell: Shell | Boundary) -> list[_Part]:
    if isinstance(shell, Boundary):
        return [_Part("boundary", "reached", _REACHED, shell.faces)]
    return [
        _Part(patch.name, patch.family, FAMILY_COLOURS[patch.family], shell.faces[patch.faces])
        for patch in shell.patches
    ]


def _check_mesh(shell: Shell | Boundary) -> None:
    if not isinstance(shell, Shell | Boundary):
        raise ArgumentError("shell", "a Boundary or a Shell", type_and_value(shell), _MAKE)


def draw_shell(
    shell: Shell | Boundary,
    *,
    ax: Axes | None = None,
    view: tuple[float, float] = VIEW,
    labels: bool = True,
    dpi: float = 200.0,
) -> Axes:
    """Draw the boundary of the reachable set, or a shell, into 2-D matplotlib Axes.

    Every patch of a shell has the colour of its family. Parameters are those of `spm_pin.display.draw`, with the
    `Boundary` or `Shell` for the configuration; `labels` names the patches that are sufficiently visible.
    """
    _check_mesh(shell)
    camera = camera_axes(view)
    # The renderer shows the faces towards the viewer, which are all visible faces of a closed mesh.
    solids = [Solid(part.name, part.colour, shell.vertices, part.faces) for part in _parts(shell)]
    ax, _, rendering = draw_solids(solids, camera, (0.03, 0.03), ax=ax, dpi=dpi, edge=_EDGE)
    if labels and isinstance(shell, Shell):
        for patch, place in _places(shell, rendering, 0.6 * _FONT / 72.0 * dpi):
            write_name(ax, place, _as_tex(patch.name), _FONT, INK, 0.25)
    return ax


def _as_tex(name: str) -> str:
    return f"${name[0]}_{{{name[1:]}}}$"


def _places(shell: Shell, seen: Rendering, room: float) -> list[tuple[Patch, tuple[float, float]]]:
    """Return positions for patches' names, in the visible part of each, if farther than `room` pixels from the rest."""
    left, _, _, top = seen.extent
    pixel = (seen.extent[1] - left) / seen.solid.shape[1]
    places = []
    for k, patch in enumerate(shell.patches):
        clearance = ndimage.distance_transform_edt(np.pad(seen.solid == k, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(int(clearance.argmax()), clearance.shape)
        if clearance[row, column] > room:
            places.append((patch, (left + (int(column) + 0.5) * pixel, top - (int(row) + 0.5) * pixel)))
    return places


def shell_figure(shell: Shell | Boundary, *, dpi: float = 200.0) -> Figure:
    """Draw the boundary of the reachable set, or a shell, from all sides, after the paper's Fig. 2, and from below.

    Parameters are those of `draw_shell`.
    """
    _check_mesh(shell)
    figure = new_figure(9.0, 7.4, layout="constrained")
    from matplotlib.patches import Patch as Swatch

    upwards = {"top": "Y", "front": "Z", "bottom": "\N{MINUS SIGN}Y"}
    for letter, (name, view), ax in zip("abcd", VIEWS.items(), figure.subplots(2, 2).ravel(), strict=True):
        draw_shell(shell, ax=ax, view=view, dpi=dpi)
        ax.set_title(f"({letter}) {name}", fontsize=10.0)
        if name in upwards:
            ax.set_xlabel("X [m]", fontsize=8.0)
            ax.set_ylabel(f"{upwards[name]} [m]", fontsize=8.0)
            ax.tick_params(labelsize=8.0)
            ax.spines[["top", "right"]].set_visible(False)
        else:
            ax.axis("off")
    if isinstance(shell, Boundary):
        return figure
    swatches = []
    for family, colour in FAMILY_COLOURS.items():
        members = [_as_tex(patch.name) for patch in shell.patches if patch.family == family]
        swatches.append(Swatch(facecolor=colour, edgecolor=INK, label=f"{members[0]} \N{EN DASH} {members[-1]}"))
    legend_below(figure, swatches, fontsize=9.0)
    return figure


def save_mesh(shell: Shell | Boundary, path: str | Path) -> Path:
    """Write the boundary of the reachable set, or a shell, as .stl, .ply, .obj or .glb, lengths in metres.

    STL and OBJ contain one closed mesh, PLY the same with its colours. GLB contains each patch of a shell as a separate
    mesh, named and coloured, with the y axis upwards, as that format requires.
    """
    _check_mesh(shell)
    path = file_path(path, suffixes=MESH_FORMATS)
    require_extra("plots", "trimesh")
    import trimesh

    kind, parts = path.suffix.lower()[1:], _parts(shell)
    colours = [[*(round(255 * channel) for channel in part.colour), 255] for part in parts]
    if kind == "glb":
        scene = trimesh.Scene()
        for part, colour in zip(parts, colours, strict=True):
            material = trimesh.visual.material.PBRMaterial(
                name=part.family, baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=0.8
            )
            mesh = trimesh.Trimesh(shell.vertices, part.faces, process=False)
            mesh.remove_unreferenced_vertices()
            mesh.visual = trimesh.visual.TextureVisuals(material=material)
            scene.add_geometry(mesh, node_name=part.name, geom_name=part.name, transform=_Y_UP)
        content = scene.export(file_type=kind)
    else:
        of_faces = np.repeat(colours, [len(part.faces) for part in parts], axis=0) if kind == "ply" else None
        mesh = trimesh.Trimesh(shell.vertices, shell.faces, face_colors=of_faces, process=False)
        content = mesh.export(file_type=kind)
    write_files({path: cast("str | bytes", content)})
    return path
