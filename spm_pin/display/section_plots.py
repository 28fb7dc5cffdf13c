"""Sections through the workspace: the paper's shell against what is reached, and the two sides of a singularity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from spm_pin.display.figure_files import new_figure
from spm_pin.display.shell_plots import FAMILY_COLOURS, patch_symbol, style_axes
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, check_instance
from spm_pin.workspace.paper_shell import Shell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FILL = {"det K < 0": "#CFDDED", "det K > 0": "#F3DCCB", "either sign": "#8C8A93"}
"""Colours of cells reached on one side of an inverse singularity, on the other, and on both."""
_GAP = 3


@dataclass(frozen=True)
class Plane:
    """A plane to cut with, given by a point of it in {B} [m], and orthogonal unit vectors in {B}."""

    name: str
    """Title of its picture."""
    origin: tuple[float, float, float]
    """Point of the plane in {B} [m]; the origin of the picture."""
    across: tuple[float, float, float]
    """Unit vector in {B}, to the right in the picture."""
    up: tuple[float, float, float]
    """Unit vector in {B}, upwards in the picture."""
    labels: tuple[str, str]
    """Labels of the two axes of the picture."""

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
    ax: Axes, shell: Shell, plane: Plane, reached: FloatArray, aspect: npt.NDArray[np.int8], cell: float = 0.02
) -> None:
    """Draw a section of a shell into axes, in the colours of its families, and of what is reached.

    `reached` are positions of o (N, 3) [m], `aspect` the sign of det K in each state (N,), see
    `spm_pin.workspace.sampling`. Cells of the plane of the size `cell` [m] are filled that have a
    position nearer than half of it; those that are reached on both sides of an inverse singularity are darker. A plane
    that meets nothing is an `ArgumentError`.
    """
    from matplotlib.collections import LineCollection
    from trimesh.intersections import mesh_plane

    near = np.abs((reached - np.array(plane.origin)) @ plane.normal) < cell / 2.0
    flat, signs = plane.project(reached[near]), aspect[near]
    segments, faces = mesh_plane(shell.mesh, plane.normal, plane.origin, return_faces=True)
    outline = plane.project(np.asarray(segments).reshape(-1, 2, 3))
    everything = np.concatenate([flat, outline.reshape(-1, 2)])
    if not len(everything):
        raise ArgumentError("plane", "a plane through the shell", plane.name, "Metres are meant")
    if len(flat):
        _fill(ax, flat, signs, cell)
    families = np.repeat([patch.family for patch in shell.patches], [len(patch.faces) for patch in shell.patches])
    colours = [FAMILY_COLOURS[family] for family in families[faces]]
    ax.add_collection(LineCollection(list(outline), colors=colours, linewidths=2.0, capstyle="round"))
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * float((high - low).max())
    ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    ax.set_title(plane.name, fontsize=10.0)
    style_axes(ax, plane.labels)


def _fill(ax: Axes, points: FloatArray, signs: npt.NDArray[np.int8], cell: float) -> None:
    """Fill the cells of the plane in which there are points (n, 2)."""
    from matplotlib.colors import ListedColormap

    low, high = np.floor(points.min(axis=0) / cell), np.floor(points.max(axis=0) / cell) + 1.0
    edges = [cell * np.arange(low[k], high[k] + 1.0) for k in (0, 1)]
    negative, positive = (
        np.histogram2d(points[chosen, 0], points[chosen, 1], edges)[0].T > 0.0 for chosen in (signs < 0, signs >= 0)
    )
    known = negative | positive
    kind = np.select([negative & positive, positive], [2, 1], 0)
    # Gaps of a few cells in a random sample are filled like the cell nearest to them.
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
    """Draw three level sections of a shell and two upright ones, and of what is reached, with a legend.

    `reached` and `aspect` are those of `draw_section`.
    """
    check_instance(shell, Shell, "shell", "Make one with workspace.workspace_shell(geometry)")
    bottom, top = float(shell.vertices[:, 2].min()), float(shell.vertices[:, 2].max())
    heights = [float(f"{bottom + share * (top - bottom):.2g}") for share in (0.21, 0.36, 0.65)]
    planes = [*map(Plane.level, heights), Plane.upright(0.0), Plane.upright(0.5 * math.pi)]
    figure = new_figure(10.2, 6.0, layout="constrained")
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch as Swatch

    *panels, last = figure.subplots(2, 3).ravel()
    for ax, plane in zip(panels, planes, strict=True):
        draw_section(ax, shell, plane, reached, aspect)
    # Rows as high as what is in them.
    shapes = [np.ptp(ax.get_ylim()) / np.ptp(ax.get_xlim()) for ax in panels]
    rows = 2.8 * np.array([max(shapes[:3]), max(shapes[3:])])
    last.get_gridspec().set_height_ratios(rows + 0.5)
    figure.set_size_inches(10.2, float(rows.sum()) + 1.7)
    handles: list[Line2D | Swatch] = [
        Line2D([], [], color=colour, linewidth=2.0, label=f"shell, {patch_symbol(family)}")
        for family, colour in FAMILY_COLOURS.items()
    ]
    handles += [Swatch(facecolor=colour, label=f"reached, {sign}") for sign, colour in _FILL.items()]
    last.axis("off")
    last.legend(handles=handles, loc="center", frameon=False, fontsize=9.0)
    return figure
