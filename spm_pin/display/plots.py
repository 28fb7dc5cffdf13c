"""Pictures of states of a manipulator or a stage in 2-D matplotlib Axes or in files, alone or side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from spm_pin.capability import Section
from spm_pin.description.visuals import leg_links, section_size, visual_parts
from spm_pin.display.rendering import (
    AXIS_COLOURS,
    TRIAD,
    VIEW,
    Colour,
    Extent,
    Image,
    Rendering,
    Solid,
    bounds,
    camera_axes,
    render,
    robot_solids,
)
from spm_pin.display.writing import (
    FORMATS,
    new_figure,
    save_figure,
    show_in_notebooks,
    write_name,
)
from spm_pin.errors import ArgumentError
from spm_pin.machine import LEGS, Configuration
from spm_pin.support.arguments import FloatArray, check_instance, real_number
from spm_pin.support.files import file_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SECTION: Colour = (0.0, 0.62, 0.451)
INK: Colour = (0.13, 0.15, 0.18)
_EDGE = 0.45  # width of edges in points
_WIDTH = 4.0  # of a new figure, in inches
_WIDEST = 6000  # pixels: such a picture takes 2 GB and a minute
_MARGINS = (0.049, 0.035)  # for labels
NARROWEST = {False: 100, True: 200}
"""Least width of a picture in pixels, without and with labels, which are seven pixels high there."""
_NARROWEST_NAMED_COLUMN = 260
_GALLERY = np.array([2.6, 3.3])  # width and height of one picture, in inches


def draw_solids(
    solids: Sequence[Solid],
    camera: FloatArray,
    margins: tuple[float, float],
    *,
    ax: Axes | None,
    dpi: float,
    edge: float,
) -> tuple[Axes, float, Rendering]:
    """Draw solids into Axes, by default new ones, with edges [points]; return them, metres per inch and the image."""
    low, high = bounds(solids, camera, margins)
    if ax is None:
        width, height = (high - low) / (high - low)[0] * _WIDTH
        figure = new_figure(width, height)
        ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        show_in_notebooks(ax, figure)
        ax.axis("off")
    elif ax.name == "3d":
        cause = "The view is projected by this function: use axes without projection='3d'"
        raise ArgumentError("ax", "two-dimensional axes", "3-D axes", cause)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.apply_aspect()
    inch = float((high - low)[1]) / ax.get_window_extent().transformed(ax.figure.dpi_scale_trans.inverted()).height
    rendering = render(solids, camera, dpi / inch, edge / 72.0 * dpi)
    ax.imshow(rendering.image, extent=rendering.extent, interpolation_stage="rgba")
    return ax, inch, rendering


def draw(
    configuration: Configuration,
    *,
    ax: Axes | None = None,
    view: tuple[float, float] = VIEW,
    labels: bool = True,
    dpi: float = 200.0,
) -> Axes:
    """Draw a state of a manipulator or a stage into 2-D matplotlib Axes.

    Data coordinates are metres to the right of O and above it in the picture.

    Parameters
    ----------
    configuration : Configuration
        A single state that exists.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``ax.figure``.
    view : tuple of two floats
        Azimuth and elevation of the viewer in {B} [rad].
    labels : bool
        Whether joints, legs and the axes of {B} and {m} are labelled; otherwise the frames are left out too. For a
        stage the legs are labelled, and its tilt and height written.
    dpi : float
        Pixels per inch of the solids, at the present size of `ax`.

    Returns
    -------
    matplotlib.axes.Axes
        `ax`, or the new one.
    """
    solids, camera = robot_solids(configuration, frames=labels), camera_axes(view)
    margins = _MARGINS if labels else (0.014, 0.01)
    ax, inch, (image, extent, _) = draw_solids(solids, camera, margins, ax=ax, dpi=dpi, edge=_EDGE)
    ax.axis("off")
    if configuration.machine.is_stage:
        if labels:
            _label_stage(configuration, ax, camera, float(np.ptp(ax.get_xlim())) / inch)
    elif labels:
        size = max(float(np.ptp(ax.get_xlim())), float(np.ptp(ax.get_ylim())))
        font = float(np.clip(1.55 * size / inch, 5.0, 11.0))
        darkness = image[..., 3] * (1.0 - image[..., :3].mean(axis=-1))
        _label(configuration, _LabelPlacer(ax, darkness, extent, font / 72.0 * inch, font), camera)
    return ax


def draw_capability(
    configuration: Configuration,
    section: Section,
    *,
    scale: float | None = None,
    ax: Axes | None = None,
    view: tuple[float, float] = VIEW,
    dpi: float = 200.0,
) -> Axes:
    """Draw a configuration, and a section of a polytope of `spm_pin.capability` with its origin placed at o.

    Parameters
    ----------
    configuration, ax, view, dpi
        As for `draw`.
    section : Section
        Forces, moments, velocities or accelerations, as from ``wrench_polytope(configuration, 1000.0).section()``.
    scale : float, optional
        Metres in the picture per unit of the section; by default its farthest vertex is at a third of the robot's
        size.
    """
    check_instance(section, Section, "section", "wrench_polytope(configuration, limits).section() is one")
    solids, farthest = robot_solids(configuration), float(np.linalg.norm(section.vertices, axis=-1).max())
    size = float(np.ptp(np.concatenate([solid.vertices for solid in solids]), axis=0).max())
    factor = size / (3.0 * farthest) if scale is None else real_number(scale, "scale", "a positive number", above=0.0)
    place = configuration.translation + factor * section.vertices
    # Each face separately, so that all edges of the polyhedron are drawn.
    shape = Solid("section", _SECTION, place, section.faces)
    camera = camera_axes(view)
    ax, inch, _ = draw_solids(solids, camera, _MARGINS, ax=ax, dpi=dpi, edge=_EDGE)
    low, high = bounds([*solids, shape], camera, _MARGINS)
    over = render([shape], camera, dpi / inch, _EDGE / 72.0 * dpi)
    ax.imshow(over.image, extent=over.extent, interpolation_stage="rgba", alpha=0.6)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ax.axis("off")
    return ax


def save_picture(
    configuration: Configuration,
    path: str | Path,
    *,
    view: tuple[float, float] = VIEW,
    labels: bool = True,
    width: int = 1000,
) -> Path:
    """Save a picture of a configuration as .png, .svg or .pdf; an existing file is replaced.

    Parameters
    ----------
    configuration, view, labels
        As for `draw`.
    path : str or Path
        File to write, which is returned.
    width : int
        Width of the picture in pixels; the height follows from the view.
    """
    path = file_path(path, suffixes=FORMATS)
    _check_width(width, NARROWEST[labels])
    dpi = width / _WIDTH
    ax = draw(configuration, view=view, labels=labels, dpi=dpi)
    return save_figure(cast("Figure", ax.figure), path, dpi=dpi)


def _check_width(width: int, narrowest: int) -> None:
    if not isinstance(width, int) or not narrowest <= width <= _WIDEST:
        expected = f"at least {narrowest}" if isinstance(width, int) and width < narrowest else f"at most {_WIDEST}"
        raise ArgumentError("width", f"{expected} pixels, a whole number", width)


def save_gallery(
    configurations: Mapping[str, Configuration],
    path: str | Path,
    *,
    view: tuple[float, float] = VIEW,
    labels: bool = False,
    width: int = 1600,
) -> Path:
    """Save a picture of several configurations, each under its name.

    Parameters
    ----------
    configurations : mapping of str to Configuration
        Single states that exist, by their titles.
    path, view, labels, width
        As for `save_picture`; the width is that of the whole picture.
    """
    path = file_path(path, suffixes=FORMATS)
    if not configurations:
        raise ArgumentError("configurations", "at least one solution that exists", "none", "Is no branch real?")
    count = len(configurations)
    columns = count if count <= 4 else math.ceil(count / 2)
    rows = math.ceil(count / columns)
    narrowest = columns * (_NARROWEST_NAMED_COLUMN if labels else NARROWEST[False])
    _check_width(width, narrowest)
    dpi = width / float(columns * _GALLERY[0])
    figure = new_figure(*(_GALLERY * (columns, rows)))
    for k, (name, configuration) in enumerate(configurations.items()):
        column, row = k % columns, rows - 1 - k // columns
        place = ((column + 0.04) / columns, (row + 0.02) / rows, 0.92 / columns, 0.86 / rows)
        ax = figure.add_axes(place)
        draw(configuration, ax=ax, view=view, labels=labels, dpi=dpi)
        ax.set_title(name, fontsize=11, pad=3)
    return save_figure(figure, path, dpi=dpi)


@dataclass
class _LabelPlacer:
    """Places labels away from edges, dark colours and one another, as far as there is room."""

    ax: Axes
    darkness: Image  # how much is in the way at each pixel, from 0 to 1, shape (height, width)
    extent: Extent  # place of `darkness` in the picture [m]
    height: float  # of the font [m]
    points: float  # height of the font in points
    labels: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)  # centres and half sizes [m]

    def put(self, text: str, colour: Colour, places: FloatArray, dislike: FloatArray, letters: float = 1.8) -> None:
        """Write `text` at the best of `places` (n, 2), given a penalty (n,) of about 1 for a bad one."""
        half = np.array([0.28 * letters, 0.55]) * self.height
        scores = [bad + self._crowding(place, half) for place, bad in zip(places, dislike, strict=True)]
        x, y = best = places[int(np.argmin(scores))]
        self.labels.append((best, half))
        write_name(self.ax, (x, y), text, self.points, colour, 0.3)

    def _crowding(self, place: FloatArray, half: FloatArray) -> float:
        left, right, bottom, top = self.extent
        rows, columns = self.darkness.shape
        across = (place[0] + np.array([-half[0], half[0]]) - left) / (right - left) * columns
        down = (top - place[1] + np.array([-half[1], half[1]])) / (top - bottom) * rows
        (left, right), (top, bottom) = np.clip(across, 0, columns).astype(int), np.clip(down, 0, rows).astype(int)
        under = self.darkness[top:bottom, left:right]
        # Beyond the image nothing is dark.
        area = float(np.ptp(across) * np.ptp(down))
        mean, square = float(under.sum()) / area, float((under**2).sum()) / area
        gaps = [(np.abs(place - centre) - half - size).max() / self.height for centre, size in self.labels]
        clash = sum(5.0 if gap < 0.0 else 1.0 - gap for gap in gaps if gap < 1.0)
        return 2.0 * mean + 10.0 * math.sqrt(max(square - mean**2, 0.0)) + clash


def _label_stage(state: Configuration, ax: Axes, camera: FloatArray, width: float) -> None:
    """Name the legs, and write the tilt and the height above them; `width` of the picture in inches."""
    legs = state.machine.legs
    beside = 0.5 * (state.circle_centres + state.balls) + 0.4 * section_size(state.machine) * legs.planes[0]
    for name, place in zip(legs.names, beside @ camera[:2].T, strict=True):
        write_name(ax, place, f"${name}$", 2.75 * width, "black", 0.3)
    tilt, azimuth = np.degrees([state.tilt, state.azimuth])
    text = f"tilt {tilt:.1f}° towards {azimuth:.0f}°, height {1e3 * float(state.height):.1f} mm"
    ax.text(0.5, 0.995, text, fontsize=2.0 * width, ha="center", va="top", transform=ax.transAxes)


def _label(configuration: Configuration, placer: _LabelPlacer, camera: FloatArray) -> None:
    """Name the frames' axes, the joints and the legs."""
    flat, h = camera[:2].T, placer.height
    triad = TRIAD * section_size(configuration.machine)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    poses = ((np.eye(3), np.zeros(3)), (configuration.rotation, configuration.translation))
    for frame, letters, (axes, origin) in zip("Bm", ("XYZ", "xyz"), poses, strict=True):
        start, tips = origin @ flat, (origin + triad * axes.T) @ flat
        arrows = (tips - start) / np.linalg.norm(tips - start, axis=-1, keepdims=True).clip(1e-9)
        for letter, place, colour in zip(letters, tips + 0.75 * h * arrows, AXIS_COLOURS.values(), strict=True):
            placer.put(f"${letter}$", colour, place[None], np.zeros(1), 1.0)
        placer.put(rf"$\{{{frame}\}}$", INK, start + 1.3 * h * around, (around @ arrows.T).max(axis=-1), 2.0)

    bases = configuration.leg_bases
    joints = np.stack([bases[:3], configuration.middle_joints, bases[3:]])
    flattened = joints @ flat
    rings = np.array([1.3, 1.8, 2.4, 3.1])
    for letter, points in zip("abc", flattened, strict=True):
        for i, point in enumerate(points):
            out = point - points.mean(axis=0)
            out = out / max(float(np.linalg.norm(out)), 1e-9)
            places = point + (rings[:, None, None] * h * around).reshape(-1, 2)
            dislike = np.add.outer(0.7 * rings, 0.25 * (1.0 - around @ out)).ravel()
            # A label closer to another joint would seem to name that one.
            distances = np.linalg.norm(places[:, None] - flattened.reshape(-1, 2), axis=-1)
            dislike += distances.min(axis=-1) < np.linalg.norm(places - point, axis=-1) - 1e-9
            placer.put(f"${letter}_{i + 1}$", INK, places, dislike)

    parts, links = visual_parts(configuration.machine), leg_links(configuration.machine)
    colours = {part.body: part.colour for part in reversed(parts)}
    along = np.linspace(0.2, 0.8, 25)
    sides = np.array([-2.0, -1.5, 1.5, 2.0])
    for leg, (body, _), base, ball in zip(LEGS, links, bases @ flat, configuration.balls @ flat, strict=True):
        line = ball - base
        across = np.array([-line[1], line[0]]) / max(float(np.linalg.norm(line)), 1e-9)
        outward = np.sign(((base + ball) / 2.0 - flattened.mean(axis=(0, 1))) @ across)
        places = (base + along[:, None] * line)[:, None] + sides[:, None] * h * across
        dislike = np.add.outer(np.abs(along - 0.45), 0.6 * np.abs(sides) + 0.3 * (sides * outward < 0.0)).ravel()
        red, green, blue = colours[body]
        dark = (0.75 * red, 0.75 * green, 0.75 * blue)
        placer.put(f"$r_{{{leg[2:]}}}$", dark, places.reshape(-1, 2), dislike, 2.6)
