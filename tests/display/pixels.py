"""Pixels of pictures of solids, and what rays from a viewer meet there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from matplotlib.image import AxesImage


def looking(view: tuple[float, float]) -> np.ndarray:
    """The view's axes to the right, up and towards the viewer, as rows, from elementary rotations."""
    azimuth, elevation = view
    turn = np.array([[np.cos(azimuth), np.sin(azimuth), 0], [-np.sin(azimuth), np.cos(azimuth), 0], [0, 0, 1]])
    nod = np.array([[np.cos(elevation), 0, np.sin(elevation)], [0, 1, 0], [-np.sin(elevation), 0, np.cos(elevation)]])
    return (nod @ turn)[[1, 2, 0]]


def nearest(
    parts: Sequence[tuple[np.ndarray, np.ndarray]], view: tuple[float, float], points: np.ndarray
) -> np.ndarray:
    """Which of parts (vertices, faces) a viewer sees at points (n, 2) of a picture, -1 for none, by trimesh's rays."""
    right, up, near = looking(view)
    whole = trimesh.util.concatenate([trimesh.Trimesh(*part, process=False) for part in parts])
    owner = np.append(np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts]), -1)
    origins = points[:, :1] * right + points[:, 1:] * up + 10.0 * near
    return owner[whole.ray.intersects_first(origins, np.tile(-near, (len(points), 1)))]


def inner_pixels(
    picture: AxesImage, count: int, margin: float, seen_at: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return colours (n, 4) of random pixels and what is seen there, those with an edge within a margin left out."""
    image, (left, right, _, top) = np.asarray(picture.get_array()), picture.get_extent()
    rows, columns = image.shape[:2]
    rng = np.random.default_rng(8)
    row, column = rng.integers(2, rows - 2, count), rng.integers(2, columns - 2, count)
    step = (right - left) / columns
    points = np.stack([left + (column + 0.5) * step, top - (row + 0.5) * step], axis=-1)
    seen = seen_at(points)
    around = [seen_at(points + margin * step * np.array(d)) for d in ((-1, -1), (-1, 1), (1, -1), (1, 1))]
    inner = np.all([seen == other for other in around], axis=0)
    return image[row, column][inner], seen[inner]


def off_shade(pixel: np.ndarray, colour: Sequence[float]) -> float:
    """Return the distance of a pixel from a colour in some light, in which the channels keep their proportion."""
    factor = np.dot(pixel, colour) / np.dot(colour, colour)
    return float(np.abs(pixel - factor * np.asarray(colour)).max())
