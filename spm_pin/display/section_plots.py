"""Sections through the workspace: the paper's shell against what is reached, and the two sides of a singularity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from spm_pin.display.figure_files import new_figure
from spm_pin.display.shell_plots import FAMILY_COLOURS, check_shell, patch_symbol, style_axes
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array, real_number
from spm_pin.workspace.table_6.shell import Shell

if TYPE_CHECKING:
    import trimesh
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Plane", "draw_section", "sections_figure"]

# Cells with one sign, with the other, with both, and where no sign is known.
_FILL = {"negative": "#CFDDED", "positive": "#F3DCCB", "both": "#8C8A93", "reached": "#DCDEE2"}
_GAP = 3
_TRUTH: dict[str, Any] = {"colors": "#222428", "linewidths": 1.0, "linestyles": "dashed"}


@dataclass(frozen=True)
class Plane:
    """A plane to cut with, given by a point of it in {B} [m], and orthogonal unit vectors in {B}."""

    name: str  # the title of its picture
    origin: tuple[float, float, float]  # becomes the origin of the picture
    across: tuple[float, float, float]  # to the right in the picture
    up: tuple[float, float, float]
    labels: tuple[str, str]  # of the two axes

    @classmethod
    def level(cls, height: float) -> Plane:
        """Return the plane Z = height [m]."""
        return cls(f"Z = {height:g} m", (0.0, 0.0, height), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("X [m]", "Y [m]"))

    @classmethod
    def upright(cls, azimuth: float) -> Plane:
        """Return the plane through the Z axis and the horizontal direction of an azimuth [rad] in {B}."""
        across = (math.cos(azimuth), math.sin(azimuth), 0.0)
        degrees = f"{math.degrees(azimuth):g}"
        labels = (f"along azimuth {degrees}° [m]", "Z [m]")
        return cls(f"upright, azimuth {degrees}°", (0.0, 0.0, 0.0), across, (0.0, 0.0, 1.0), labels)

    @property
    def normal(self) -> FloatArray:
        """Unit normal in {B}, shape (3,)."""
        return np.cross(self.across, self.up)

    def project(self, points: FloatArray) -> FloatArray:
        """Return coordinates (..., 2) in the picture [m] of points (..., 3) in {B}."""
        return np.asarray((points - np.array(self.origin)) @ np.stack([self.across, self.up], axis=-1))


def draw_section(
    shell: Shell,
    plane: Plane,
    *,
    ax: Axes | None = None,
    reached: npt.ArrayLike | None = None,
    aspect: npt.ArrayLike | None = None,
    boundary: trimesh.Trimesh | None = None,
    cell: float = 0.02,
) -> Axes:
    """Draw a section of a shell, and of what is reached.

    Parameters
    ----------
    shell : Shell
        Cut lines have the colours of their families, see `spm_pin.display.shell_plots.FAMILY_COLOURS`.
    plane : Plane
        Where to cut.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if not given: ``ax.figure``.
    reached : array_like, shape (N, 3), optional
        Positions of o that are reached, in {B} [m], as `spm_pin.workspace.table_6.sampling` draws them. Cells of the
        plane are filled that have one of them nearer than half a cell.
    aspect : array_like, shape (N,), optional
        A number for each, of which only the sign counts: cells where both signs occur are darker. With the sign of
        det K those are positions that are reached on both sides of an inverse singularity.
    boundary : trimesh.Trimesh, optional
        The boundary of what is reached [m], drawn as a line.
    cell : float
        Size of the cells [m].

    Raises
    ------
    ArgumentError
        If `shell` is no Shell, `reached` is not of that shape or not finite, `aspect` has another length or comes
        alone, or `cell` is not positive.
    """
    check_shell(shell)
    real_number(cell, "cell", "a positive size in metres", above=0.0)
    points, signs = _read_reached(reached, aspect)
    if ax is None:
        ax = new_figure(4.0, 4.0, layout="constrained").add_subplot()
    from matplotlib.collections import LineCollection

    near = np.abs((points - np.array(plane.origin)) @ plane.normal) < cell / 2.0
    flat, signs = plane.project(points[near]), signs[near]
    outline, faces = _cut(shell.mesh, plane)
    truth = np.empty((0, 2, 2)) if boundary is None else _cut(boundary, plane)[0]
    everything = np.concatenate([flat, outline.reshape(-1, 2), truth.reshape(-1, 2)])
    if not len(everything):
        raise ArgumentError("plane", "a plane through the shell", plane.name, "Metres are meant")
    if len(flat):
        _fill(ax, flat, signs, cell)
    ax.add_collection(LineCollection(list(truth), **_TRUTH))
    families = np.repeat([patch.family for patch in shell.patches], [len(patch.faces) for patch in shell.patches])
    colours = [FAMILY_COLOURS[family] for family in families[faces]]
    ax.add_collection(LineCollection(list(outline), colors=colours, linewidths=2.0, capstyle="round"))
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * float((high - low).max())
    ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    ax.set_title(plane.name, fontsize=10.0)
    style_axes(ax, plane.labels)
    return ax


def _read_reached(reached: npt.ArrayLike | None, aspect: npt.ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    """Return positions (N, 3) and their signs (N,), NaN where none is known."""
    if reached is None:
        if aspect is not None:
            raise ArgumentError("aspect", "None, for there are no positions reached", type(aspect).__name__)
        return np.empty((0, 3)), np.empty(0)
    points = real_array(reached, "reached", (3,), "positions in metres").reshape(-1, 3)
    if aspect is None:
        return points, np.full(len(points), np.nan)
    signs = np.sign(real_array(aspect, "aspect", (), "numbers whose sign counts")).ravel()
    if len(signs) != len(points):
        raise ArgumentError("aspect", f"a number for each of {len(points)} positions", f"{len(signs)} numbers")
    return points, signs


def _cut(mesh: trimesh.Trimesh, plane: Plane) -> tuple[FloatArray, npt.NDArray[np.intp]]:
    """Return the segments (n, 2, 2) in which a plane cuts a mesh, and the face of each."""
    from trimesh.intersections import mesh_plane

    segments, faces = mesh_plane(mesh, plane.normal, plane.origin, return_faces=True)
    return plane.project(np.asarray(segments).reshape(-1, 2, 3)), faces


def _fill(ax: Axes, points: FloatArray, signs: FloatArray, cell: float) -> None:
    """Fill the cells of the plane in which there are points (n, 2)."""
    from matplotlib.colors import ListedColormap

    low, high = np.floor(points.min(axis=0) / cell), np.floor(points.max(axis=0) / cell) + 1.0
    edges = [cell * np.arange(low[k], high[k] + 1.0) for k in (0, 1)]
    negative, positive, any_ = (
        np.histogram2d(points[chosen, 0], points[chosen, 1], edges)[0].T > 0.0
        for chosen in (signs < 0.0, signs > 0.0, np.ones(len(points), dtype=bool))
    )
    kind = np.select([negative & positive, positive, negative], [2, 1, 0], 3)
    # Gaps of a few cells in a random sample are filled like the cell nearest to them.
    gaps, _ = ndimage.label(~any_)
    small = (gaps > 0) & (np.bincount(gaps.ravel()) <= _GAP)[gaps]
    like = ndimage.distance_transform_edt(~any_, return_distances=False, return_indices=True)
    ax.imshow(
        np.ma.masked_where(~(any_ | small), kind[tuple(like)]),
        extent=(edges[0][0], edges[0][-1], edges[1][0], edges[1][-1]),
        origin="lower",
        cmap=ListedColormap(list(_FILL.values())),
        vmin=0,
        vmax=3,
        interpolation="nearest",
    )


def sections_figure(
    shell: Shell,
    planes: Sequence[Plane] | None = None,
    *,
    reached: npt.ArrayLike | None = None,
    aspect: npt.ArrayLike | None = None,
    boundary: trimesh.Trimesh | None = None,
    cell: float = 0.02,
) -> Figure:
    """Draw several sections of a shell, and of what is reached, with a legend.

    Parameters
    ----------
    shell, reached, aspect, boundary, cell
        As for `draw_section`.
    planes : sequence of Plane, optional
        Where to cut; three level ones and two upright ones if not given.

    Raises
    ------
    ArgumentError
        If there are no planes, or `draw_section` would raise it.
    """
    check_shell(shell)
    if planes is None:
        bottom, top = float(shell.vertices[:, 2].min()), float(shell.vertices[:, 2].max())
        heights = [float(f"{bottom + share * (top - bottom):.2g}") for share in (0.21, 0.36, 0.65)]
        planes = [*map(Plane.level, heights), Plane.upright(0.0), Plane.upright(0.5 * math.pi)]
    if not planes:
        raise ArgumentError("planes", "at least one plane", "none")
    columns = min(len(planes), 3)
    rows = -(-len(planes) // columns)
    figure = new_figure(3.4 * columns, 3.0 * rows, layout="constrained")
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch as Swatch

    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, plane in zip(panels, planes, strict=False):
        draw_section(shell, plane, ax=ax, reached=reached, aspect=aspect, boundary=boundary, cell=cell)
    # Rows as high as what is in them.
    shapes = np.zeros(rows * columns)
    shapes[: len(planes)] = [np.ptp(ax.get_ylim()) / np.ptp(ax.get_xlim()) for ax in panels[: len(planes)]]
    heights = 2.8 * shapes.reshape(rows, columns).max(axis=1)
    panels[0].get_gridspec().set_height_ratios(heights + 0.5)
    figure.set_size_inches(3.4 * columns, float(heights.sum()) + 0.7 * rows + 0.3)
    handles: list[Line2D | Swatch] = [
        Line2D([], [], color=colour, linewidth=2.0, label=f"shell, {patch_symbol(family)}")
        for family, colour in FAMILY_COLOURS.items()
    ]
    if boundary is not None:
        handles.append(Line2D([], [], color=_TRUTH["colors"], linestyle="dashed", label="boundary of what is reached"))
    if aspect is not None:
        words = {"negative": "reached, det K < 0", "positive": "reached, det K > 0", "both": "reached, either sign"}
        handles += [Swatch(facecolor=_FILL[kind], label=text) for kind, text in words.items()]
    elif reached is not None:
        handles.append(Swatch(facecolor=_FILL["reached"], label="reached"))
    empty = panels[len(planes) :]
    for ax in empty:
        ax.axis("off")
    if len(empty):
        empty[0].legend(handles=handles, loc="center", frameon=False, fontsize=9.0)
    else:
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9.0)
    return figure
