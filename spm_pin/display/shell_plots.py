"""Pictures and meshes of the workspace: the reachable set, and the paper's 24 surfaces, Fig. 2 and sections."""

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
from spm_pin.support.arguments import FloatArray, check_instance, type_and_value
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
_FILL = {"det K < 0": "#C9DCF0", "det K > 0": "#F3DCCB", "either sign": "#8681A8"}
"""Colours of cells reached on one side of an inverse singularity, on the other, and on both."""
_GAP = 3  # cells: larger gaps in a sample are not filled


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


def _style_axes(ax: Axes, x: str, y: str) -> None:
    ax.set_xlabel(x, fontsize=8.0)
    ax.set_ylabel(y, fontsize=8.0)
    ax.tick_params(labelsize=8.0)
    ax.spines[["top", "right"]].set_visible(False)


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
            _style_axes(ax, "X [m]", f"{upwards[name]} [m]")
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


class Plane(NamedTuple):
    """A cutting plane."""

    name: str  # title of its picture
    origin: FloatArray  # a point of the plane in {B} [m], the origin of the picture
    axes: FloatArray  # unit vectors to the right and upwards in the picture, as rows (2, 3) in {B}
    labels: tuple[str, str]  # of the two axes of the picture

    @classmethod
    def level(cls, height: float) -> Plane:
        """Return the plane Z = height [m]."""
        return cls(f"Z = {height:g} m", np.array([0.0, 0.0, height]), np.eye(3)[:2], ("X [m]", "Y [m]"))

    @classmethod
    def upright(cls, azimuth: float) -> Plane:
        """Return the plane through the Z axis and the horizontal direction of an azimuth [rad]."""
        degrees = f"{math.degrees(azimuth):g}°"
        axes = np.array([[math.cos(azimuth), math.sin(azimuth), 0.0], [0.0, 0.0, 1.0]])
        return cls(f"upright, azimuth {degrees}", np.zeros(3), axes, (f"along azimuth {degrees} [m]", "Z [m]"))

    @property
    def normal(self) -> FloatArray:
        """Unit normal in {B}, shape (3,)."""
        return np.cross(*self.axes)

    def project(self, points: FloatArray) -> FloatArray:
        """Return coordinates (..., 2) in the picture [m] of points (..., 3) in {B}."""
        return np.asarray((points - self.origin) @ self.axes.T)


def draw_section(
    ax: Axes, shell: Shell, plane: Plane, reached: FloatArray, aspect: npt.NDArray[np.int8], cell: float = 0.02
) -> None:
    """Draw a section of a shell into axes, in the colours of its families, and of the reachable set.

    `reached` are positions of o (N, 3) [m], `aspect` the signs (N,) of det K there. Cells of the size `cell` [m] are
    filled that have a position nearer to the plane than half of it; those reached on both sides of an inverse
    singularity are darker.
    """
    from matplotlib.collections import LineCollection
    from trimesh.intersections import mesh_plane

    near = np.abs((reached - plane.origin) @ plane.normal) < cell / 2.0
    flat, signs = plane.project(reached[near]), aspect[near]
    segments, faces = mesh_plane(shell.mesh, plane.normal, plane.origin, return_faces=True)
    outline = plane.project(np.asarray(segments).reshape(-1, 2, 3))
    everything = np.concatenate([flat, outline.reshape(-1, 2)])
    if not len(everything):
        raise ArgumentError("plane", "a plane through the shell", plane.name, "Is it in metres?")
    if len(flat):
        _fill(ax, flat, signs, cell)
    families = np.repeat([patch.family for patch in shell.patches], [len(patch.faces) for patch in shell.patches])
    colours = [FAMILY_COLOURS[family] for family in families[faces]]
    ax.add_collection(LineCollection(list(outline), colors=colours, linewidths=2.0, capstyle="round"))
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * float((high - low).max())
    ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    ax.set_title(plane.name, fontsize=10.0)
    _style_axes(ax, *plane.labels)


def _fill(ax: Axes, points: FloatArray, signs: npt.NDArray[np.int8], cell: float) -> None:
    """Fill the cells of the plane that contain points (n, 2)."""
    from matplotlib.colors import ListedColormap

    low, high = np.floor(points.min(axis=0) / cell), np.floor(points.max(axis=0) / cell) + 1.0
    edges = [cell * np.arange(low[k], high[k] + 1.0) for k in (0, 1)]
    negative, positive = (
        np.histogram2d(points[chosen, 0], points[chosen, 1], edges)[0].T > 0.0 for chosen in (signs < 0, signs >= 0)
    )
    known = negative | positive
    kind = np.select([negative & positive, positive], [2, 1], 0)
    # Gaps of a few cells in a random sample are filled like the nearest cell.
    gaps, _ = ndimage.label(~known)
    small = (gaps > 0) & (np.bincount(gaps.ravel()) <= _GAP)[gaps]
    like = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    ax.imshow(
        np.ma.masked_where(~(known | small), kind[tuple(like)]),
        extent=(edges[0][0], edges[0][-1], edges[1][0], edges[1][-1]),
        origin="lower",
        cmap=ListedColormap(list(_FILL.values())),
        vmin=0,
        vmax=2,
        interpolation="nearest",
    )


def sections_figure(shell: Shell, reached: FloatArray, aspect: npt.NDArray[np.int8]) -> Figure:
    """Draw three level sections of a shell and two upright ones, and of the reachable set, with a legend.

    `reached` and `aspect` are those of `draw_section`.
    """
    check_instance(shell, Shell, "shell", _MAKE)
    bottom, top = float(shell.vertices[:, 2].min()), float(shell.vertices[:, 2].max())
    heights = [float(f"{bottom + share * (top - bottom):.2g}") for share in (0.21, 0.36, 0.65)]
    planes = [*map(Plane.level, heights), Plane.upright(0.0), Plane.upright(0.5 * math.pi)]
    figure = new_figure(10.2, 6.0, layout="constrained")
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch as Swatch

    *panels, last = figure.subplots(2, 3).ravel()
    for ax, plane in zip(panels, planes, strict=True):
        draw_section(ax, shell, plane, reached, aspect)
    # Rows as high as their contents.
    shapes = [np.ptp(ax.get_ylim()) / np.ptp(ax.get_xlim()) for ax in panels]
    rows = 2.8 * np.array([max(shapes[:3]), max(shapes[3:])])
    last.get_gridspec().set_height_ratios(rows + 0.5)
    figure.set_size_inches(10.2, float(rows.sum()) + 1.7)
    handles: list[Line2D | Swatch] = [
        Line2D([], [], color=colour, linewidth=2.0, label=f"shell, {_as_tex(family)}")
        for family, colour in FAMILY_COLOURS.items()
    ]
    handles += [Swatch(facecolor=colour, label=f"reached, {sign}") for sign, colour in _FILL.items()]
    last.axis("off")
    last.legend(handles=handles, loc="center", frameon=False, fontsize=9.0)
    return figure
