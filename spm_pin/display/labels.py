"""Names of joints, legs and frames in a picture, placed where they can be read."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from spm_pin.description.visuals import visual_parts
from spm_pin.display.rendering import Extent, Image
from spm_pin.display.scene import AXIS_COLOURS, TRIAD, Colour
from spm_pin.mechanism import LEGS, Configuration
from spm_pin.mechanism.arguments import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK = (0.13, 0.15, 0.18)


@dataclass
class LabelPlacer:
    """Places labels where they are clear of edges, dark colours and one another, as far as there is room."""

    ax: Axes
    """Where the labels are written."""
    darkness: Image
    """How much is in the way at each pixel, from 0 to 1, shape (height, width)."""
    extent: Extent
    """Place of `darkness` in the picture [m]."""
    height: float
    """Height of the font [m]."""
    points: float
    """Height of the font in points."""
    taken: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    """Centres and half sizes of the labels written [m], each of shape (2,)."""

    def put(self, text: str, colour: Colour, places: FloatArray, dislike: FloatArray, letters: float = 1.8) -> None:
        """Write `text` at the best of `places` (n, 2), given a penalty (n,) of about 1 for a bad one."""
        from matplotlib.patheffects import withStroke

        half = np.array([0.28 * letters, 0.55]) * self.height
        scores = [bad + self._crowding(place, half) for place, bad in zip(places, dislike, strict=True)]
        x, y = best = places[int(np.argmin(scores))]
        self.taken.append((best, half))
        written = self.ax.text(x, y, text, color=colour, fontsize=self.points, ha="center", va="center")
        written.set_path_effects([withStroke(linewidth=0.3 * self.points, foreground="white", alpha=0.85)])

    def _crowding(self, place: FloatArray, half: FloatArray) -> float:
        left, right, bottom, top = self.extent
        rows, columns = self.darkness.shape
        across = (place[0] + np.array([-half[0], half[0]]) - left) / (right - left) * columns
        down = (top - place[1] + np.array([-half[1], half[1]])) / (top - bottom) * rows
        (left, right), (top, bottom) = np.clip(across, 0, columns).astype(int), np.clip(down, 0, rows).astype(int)
        under = self.darkness[top:bottom, left:right]
        # Where the label reaches beyond the image there is nothing, and nothing is dark.
        area = float(np.ptp(across) * np.ptp(down))
        mean, square = float(under.sum()) / area, float((under**2).sum()) / area
        gaps = [(np.abs(place - other) - half - their).max() / self.height for other, their in self.taken]
        clash = sum(5.0 if gap < 0.0 else 1.0 - gap for gap in gaps if gap < 1.0)
        return 2.0 * mean + 10.0 * math.sqrt(max(square - mean**2, 0.0)) + clash


def label(configuration: Configuration, placer: LabelPlacer, camera: FloatArray, size: float) -> None:
    """Name the frames' axes, the joints and the legs."""
    flat, h = camera[:2].T, placer.height
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rotation, origin = configuration.rotation, configuration.translation
    for frame, axes, centre, letters in (("B", np.eye(3), np.zeros(3), "XYZ"), ("m", rotation, origin, "xyz")):
        tips = (centre + TRIAD * size * axes.T) @ flat
        start = centre @ flat
        for letter, tip, name in zip(letters, tips, "xyz", strict=True):
            out = tip - start
            place = tip + 0.75 * h * out / max(float(np.linalg.norm(out)), 1e-9)
            placer.put(f"${letter}$", AXIS_COLOURS[name], place[None], np.zeros(1), 1.0)
        arrows = (tips - start) / np.linalg.norm(tips - start, axis=-1, keepdims=True).clip(1e-9)
        placer.put(rf"$\{{{frame}\}}$", _INK, start + 1.3 * h * around, (around @ arrows.T).max(axis=-1), 2.0)

    joints = np.stack([configuration.geometry.base_joints, configuration.middle_joints, configuration.platform_joints])
    flattened = joints @ flat
    rings = np.array([1.3, 1.8, 2.4, 3.1])
    for letter, points in zip("abc", flattened, strict=True):
        for i, point in enumerate(points):
            out = point - points.mean(axis=0)
            out = out / max(float(np.linalg.norm(out)), 1e-9)
            places = point + (rings[:, None, None] * h * around).reshape(-1, 2)
            dislike = np.add.outer(0.7 * rings, 0.25 * (1.0 - around @ out)).ravel()
            # Nearer to another joint, it would seem to name that.
            distances = np.linalg.norm(places[:, None] - flattened.reshape(-1, 2), axis=-1)
            dislike += distances.min(axis=-1) < np.linalg.norm(places - point, axis=-1) - 1e-9
            placer.put(f"${letter}_{i + 1}$", _INK, places, dislike)

    colours = {part.body: part.colour for part in visual_parts(configuration.geometry) if part.mesh == "tube"}
    along = np.linspace(0.2, 0.8, 25)
    sides = np.array([-2.0, -1.5, 1.5, 2.0])
    for leg, hip, ball in zip(LEGS, flattened[[0, 2]].reshape(6, 2), np.tile(flattened[1], (2, 1)), strict=True):
        line = ball - hip
        across = np.array([-line[1], line[0]]) / max(float(np.linalg.norm(line)), 1e-9)
        outward = np.sign(((hip + ball) / 2.0 - flattened.mean(axis=(0, 1))) @ across)
        places = (hip + along[:, None] * line)[:, None] + sides[:, None] * h * across
        dislike = np.add.outer(np.abs(along - 0.45), 0.6 * np.abs(sides) + 0.3 * (sides * outward < 0.0)).ravel()
        red, green, blue = colours[f"leg_{leg[2:]}_cylinder"]
        dark = (0.75 * red, 0.75 * green, 0.75 * blue)
        placer.put(f"$r_{{{leg[2:]}}}$", dark, places.reshape(-1, 2), dislike, 2.6)
