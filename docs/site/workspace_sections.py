"""Draw sections of the paper's shell and of what is reached: `python docs/site/workspace_sections.py`, a minute.

Needs `pip install ".[plots]"`. Cells with a position near the plane are filled; those reached on both sides of an
inverse singularity are darker.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from figures import save
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch as Swatch
from scipy import ndimage
from scipy.spatial.transform import Rotation
from trimesh.intersections import mesh_plane

import spm_pin as spm
from spm_pin.display.shell_plots import FAMILY_COLOURS

COUNT, CELL, GAP = 2_000_000, 0.02, 3
"""Sets of leg lengths, size of a cell [m], and cells of a gap in the sample that is filled."""
FILL = {"det K < 0": "#C9DCF0", "det K > 0": "#F3DCCB", "either sign": "#8681A8"}
Array = npt.NDArray[Any]


class Plane(NamedTuple):
    """A cutting plane: its title, a point and two unit vectors in {B} [m], and the labels of the picture's axes."""

    name: str
    origin: Array
    axes: Array
    labels: tuple[str, str]


def level(height: float) -> Plane:
    """Return the plane Z = height [m]."""
    return Plane(f"Z = {height:g} m", np.array([0.0, 0.0, height]), np.eye(3)[:2], ("X [m]", "Y [m]"))


def upright(azimuth: float) -> Plane:
    """Return the plane through the Z axis and the horizontal direction of an azimuth [rad]."""
    degrees = f"{math.degrees(azimuth):g}°"
    axes = np.array([[math.cos(azimuth), math.sin(azimuth), 0.0], [0.0, 0.0, 1.0]])
    return Plane(f"upright, azimuth {degrees}", np.zeros(3), axes, (f"along azimuth {degrees} [m]", "Z [m]"))


def sample(machine: spm.Manipulator) -> tuple[Array, Array]:
    """Return positions of o (N, 3) [m] from leg lengths often at their limits, and the sign of det K (N,)."""
    low, high = machine.limits.ends
    rng = np.random.default_rng(0)
    share = np.sin(0.5 * np.pi * rng.random((COUNT, 6))) ** 2
    share = np.where(rng.random(share.shape) < 0.35, share.round(), share)
    states = spm.forward_physical(machine, (1.0 - share) * low + share * high)
    states = states[states.exists]
    positions, sign = states.translation, np.sign(spm.determinants(states)[:, 2]).astype(int)
    # A mirror changes the sign of det K, turns by 0, 120 and 240 degrees do not.
    positions = np.concatenate([positions, positions * [-1.0, 1.0, 1.0]])
    turns = Rotation.from_euler("z", [[0.0], [120.0], [240.0]], degrees=True)
    return np.concatenate([turn.apply(positions) for turn in turns]), np.tile(np.concatenate([sign, -sign]), 3)


def draw(ax: Axes, shell: spm.crosscheck.Shell, plane: Plane, reached: Array, sign: Array) -> None:
    """Draw a section of the shell, in the colours of its families, and the cells that are reached."""
    normal = np.cross(*plane.axes)
    near = np.abs((reached - plane.origin) @ normal) < CELL / 2.0
    fill(ax, (reached[near] - plane.origin) @ plane.axes.T, sign[near])
    segments, faces = mesh_plane(shell.mesh, normal, plane.origin, return_faces=True)
    outline = (np.asarray(segments).reshape(-1, 2, 3) - plane.origin) @ plane.axes.T
    families = np.repeat([patch.family for patch in shell.patches], [len(patch.faces) for patch in shell.patches])
    colours = [FAMILY_COLOURS[family] for family in families[faces]]
    ax.add_collection(LineCollection(list(outline), colors=colours, linewidths=2.0, capstyle="round"))
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel=plane.labels[0], ylabel=plane.labels[1])
    ax.set_title(plane.name, fontsize=10)
    ax.spines[["top", "right"]].set_visible(False)


def fill(ax: Axes, points: Array, sign: Array) -> None:
    """Fill the cells of the plane that contain points (n, 2); small gaps are filled like the nearest cell."""
    low, high = np.floor(points.min(axis=0) / CELL), np.floor(points.max(axis=0) / CELL) + 1.0
    edges = [CELL * np.arange(low[k], high[k] + 1.0) for k in (0, 1)]
    negative, positive = (np.histogram2d(*points[sign == s].T, edges)[0].T > 0.0 for s in (-1, 1))
    known = negative | positive
    kind = np.select([negative & positive, positive], [2, 1], 0)
    gaps, _ = ndimage.label(~known)
    small = (gaps > 0) & (np.bincount(gaps.ravel()) <= GAP)[gaps]
    like = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    shown = np.ma.masked_where(~(known | small), kind[tuple(like)])
    extent = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
    ax.imshow(shown, extent=extent, origin="lower", cmap=ListedColormap(list(FILL.values())), vmin=0, vmax=2)


def main() -> None:
    """Draw three level sections and two upright ones into docs/images."""
    machine = spm.Manipulator.paper()
    shell, (reached, sign) = spm.crosscheck.workspace_shell(machine), sample(machine)
    planes = [*map(level, (1.9, 2.1, 2.5)), upright(0.0), upright(0.5 * math.pi)]
    figure = Figure(figsize=(10.2, 6.4), layout="constrained")
    *panels, last = figure.subplots(2, 3, height_ratios=(3, 2)).ravel()
    for ax, plane in zip(panels, planes, strict=True):
        draw(ax, shell, plane, reached, sign)
    lines = [Line2D([], [], color=colour, lw=2.0, label=f"shell, {name}") for name, colour in FAMILY_COLOURS.items()]
    cells = [Swatch(facecolor=colour, label=f"reached, {name}") for name, colour in FILL.items()]
    last.axis("off")
    last.legend(handles=[*lines, *cells], loc="center", frameon=False, fontsize=9)
    save(figure, "workspace_sections")


if __name__ == "__main__":
    main()
