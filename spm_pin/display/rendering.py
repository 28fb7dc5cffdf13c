"""Solids of the manipulator, and an orthographic rendering of them with a depth buffer.

The 3-D axes of matplotlib order whole surfaces by their mean depth, and so draw hidden legs over what hides them.
Here a depth buffer finer than the pixels decides, also where solids intersect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.description.visuals import part_placements, section_size, visual_parts
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.machine import Configuration
from spm_pin.machine.configuration import check_configuration
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray

Colour = tuple[float, float, float]
"""Red, green and blue in sRGB, from 0 to 1."""
Image = npt.NDArray[np.float32]
"""Pixels (height, width, 4): red, green, blue and opacity, each from 0 to 1."""
Extent = tuple[float, float, float, float]
"""Left, right, bottom and top of an image [m]."""

AXIS_COLOURS: dict[str, Colour] = {"x": (0.835, 0.369, 0.0), "y": (0.0, 0.62, 0.451), "z": (0.353, 0.247, 0.69)}
"""Colours of the axes of {B} and {m}."""
TRIAD = 0.7
"""Length of a frame's arrows over the size of the robot's sections, `section_size`."""

VIEW = (math.radians(15.0), math.radians(25.0))
"""The azimuth and the elevation [rad] from which pictures are taken."""

_SIDES = 24  # of an arrow
_NEARER = 0.4  # over the size of the sections: arrows of a frame lie in its plate, and are drawn on its surface
_SAMPLES = 3  # per pixel and direction
_TOGETHER = 4_000_000  # pixels of triangles drawn in one step
_CREASE = math.radians(50.0)  # a sharper turn between two faces is an edge


@dataclass(frozen=True)
class Solid:
    """One closed surface in {B}."""

    name: str  # the link and the mesh, "base_a1 clevis", or the frame and the axis, "{B} x"
    colour: Colour
    vertices: FloatArray  # in {B} [m], shape (n, 3)
    faces: npt.NDArray[np.signedinteger]  # triangles, counter-clockwise seen from outside, shape (m, 3)
    nearer: float = 0.0  # distance towards the viewer by which it is drawn in front of its position [m]


def robot_solids(configuration: Configuration, *, frames: bool = True) -> list[Solid]:
    """Return the solids of a state in the URDF, and with `frames` arrows for the {B} and {m} of a manipulator."""
    machine = check_configuration(configuration, single=True, existing=True).machine
    lengths = np.linalg.norm(configuration.leg_vectors, axis=-1)
    if not (lengths > 0.0).all():
        raise ArgumentError("configuration", "legs of positive length that reach their balls", lengths)
    if not np.isfinite(configuration.middle_pose.as_matrix()).all():
        raise ArgumentError("configuration", "balls that span a plane", configuration.balls.tolist())
    size, parts = section_size(machine), zip(visual_parts(machine), part_placements(configuration), strict=True)
    solids = [
        Solid(part.name, part.colour, part.vertices @ pose[:3, :3].T + pose[:3, 3], part.faces) for part, pose in parts
    ]
    triads = (("{B}", np.eye(3), np.zeros(3)), ("{m}", configuration.rotation, configuration.translation))
    for name, rotation, origin in triads if frames and not machine.is_stage else ():
        for k, (axis, colour) in enumerate(AXIS_COLOURS.items()):
            # Columns in cyclic order keep the handedness.
            turned = np.roll(rotation, 2 - k, axis=1)
            solids.append(arrow(f"{name} {axis}", colour, turned, origin, TRIAD * size, _NEARER * size))
    return solids


def arrow(name: str, colour: Colour, axes: FloatArray, origin: FloatArray, length: float, nearer: float = 0.0) -> Solid:
    """Return an arrow from `origin` along the third column of a rotation matrix `axes`, lengths in metres."""
    require_extra("plots", "trimesh")
    import trimesh

    outline = [(0.0, 0.0), (0.04, 0.0), (0.04, 0.72), (0.11, 0.72), (0.0, 1.0)]  # distance from the axis, and along it
    mesh = trimesh.creation.revolve(outline, sections=_SIDES)
    return Solid(name, colour, length * mesh.vertices @ axes.T + origin, mesh.faces, nearer)


class Rendering(NamedTuple):
    """An image of solids, transparent around them."""

    image: Image
    extent: Extent  # place of the image in the picture plane [m]
    solid: IntArray  # index of the solid that each pixel shows, -1 for none, shape (height, width)


def camera_axes(view: tuple[float, float]) -> FloatArray:
    """Return the unit vectors to the right, up and towards the viewer as rows (3, 3), in {B}."""
    array = np.asarray(view, dtype=np.float64)
    expected = "azimuth and elevation in radians"
    if array.shape != (2,) or not np.isfinite(array).all():
        raise ArgumentError("view", expected, view)
    azimuth, elevation = array
    if abs(azimuth) > 2.0 * math.pi or abs(elevation) > math.pi / 2.0:
        raise ArgumentError("view", f"{expected}, at most 2π and π/2", view, "Is it in degrees? Use numpy.deg2rad")
    return view_axes(azimuth, elevation)


def bounds(
    solids: Sequence[Solid], camera: FloatArray, margins: tuple[float, float] = (0.0, 0.0)
) -> tuple[FloatArray, FloatArray]:
    """Return the lower left and upper right corner [m] of solids in view; margins are relative to their longer side."""
    points = np.concatenate([solid.vertices for solid in solids]) @ camera[:2].T
    low, high = points.min(axis=0), points.max(axis=0)
    border = float((high - low).max()) * np.array(margins)
    return low - border, high + border


def render(
    solids: Sequence[Solid],
    camera: FloatArray,
    resolution: float,
    edge: float,
    window: tuple[FloatArray, FloatArray] | None = None,
) -> Rendering:
    """Render solids at `resolution` pixels per metre, with dark edges that are `edge` pixels wide.

    `window` is the lower left and the upper right corner [m] of a part of the picture plane that contains all of them;
    the frames of a film have the same one.
    """
    triangles, colours, regions, count = [], [], [], 0
    for solid in solids:
        normals, smooth = _normals_and_regions(solid.vertices, solid.faces)
        normals = normals @ camera.T
        front = normals[:, 2] > 0.0
        seen = solid.vertices[solid.faces[front]] @ camera.T
        seen[..., 2] += solid.nearer
        triangles.append(seen)
        colours.append(_shade(solid.colour, normals[front]))
        # Edges are drawn where regions meet.
        regions.append(smooth[front] + count)
        count += len(front)
    corners = np.concatenate(triangles)
    low, high = bounds(solids, camera) if window is None else window
    width, height = (int(n) for n in np.ceil((high - low) * resolution) + 2)
    left, top = float(low[0]) - 1.0 / resolution, float(high[1]) + 1.0 / resolution
    corners[..., 0] = (corners[..., 0] - left) * resolution * _SAMPLES - 0.5
    corners[..., 1] = (top - corners[..., 1]) * resolution * _SAMPLES - 0.5
    face, depth = _nearest_faces(corners, (height * _SAMPLES, width * _SAMPLES))
    region = np.append(np.concatenate(regions), -1).astype(np.int32)[face]
    owner = np.append(np.repeat(np.arange(len(colours)), [len(part) for part in colours]), -1)
    shown = owner[face[_SAMPLES // 2 :: _SAMPLES, _SAMPLES // 2 :: _SAMPLES]]
    edges = _edges(region, depth, max(1, round(edge * _SAMPLES)))
    del region, depth
    # One gather: the faces' colours, the same for edges, and last, at index -1, transparent.
    lit = np.concatenate(colours)
    palette = np.zeros((2 * len(lit) + 1, 4), dtype=np.float32)
    palette[:-1, :3], palette[:-1, 3] = np.concatenate([lit, 0.4 * lit]), 1.0
    face[edges] += len(lit)
    image = np.empty((height, width, 4), dtype=np.float32)
    for row in range(height):  # all samples' colours together would take most of the memory
        samples = palette[face[row * _SAMPLES : (row + 1) * _SAMPLES]]
        image[row] = samples.reshape(_SAMPLES, width, _SAMPLES, 4).mean(axis=(0, 2))
    image[..., :3] /= np.maximum(image[..., 3:], 1e-9)
    return Rendering(image, (left, left + width / resolution, top - height / resolution, top), shown)


def _normals_and_regions(vertices: FloatArray, faces: npt.NDArray[np.signedinteger]) -> tuple[FloatArray, IntArray]:
    """Return the unit normals (m, 3) of faces, and numbers (m,) that faces joined without a crease share."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < _CREASE]
    return mesh.face_normals, trimesh.graph.connected_component_labels(smooth, node_count=len(faces))


def _shade(colour: Colour, normals: FloatArray) -> FloatArray:
    """Return sRGB colours (n, 3) of faces with unit normals (n, 3) to the right, up and towards the viewer.

    Lambert's law for a lamp above the viewer's left shoulder, in an ambient light that is brighter from above;
    together at most 1, so that no channel saturates and colours keep their hue.
    """
    lamp = np.array([-0.35, 0.5, 0.8])
    direct = np.clip(normals @ (lamp / np.linalg.norm(lamp)), 0.0, None)
    light = 0.44 + 0.1 * normals[:, 1:2] + 0.5 * direct[:, None]
    # Light is additive in linear intensities, not in sRGB.
    return np.asarray(np.asarray(colour) * light ** (1.0 / 2.2))


def _nearest_faces(triangles: FloatArray, shape: tuple[int, int]) -> tuple[npt.NDArray[np.int32], Image]:
    """Return the triangle that each pixel shows, -1 for none, and its nearness.

    `triangles` (n, 3, 3) are column, row and nearness of each corner; pixel centres are integers.
    """
    index, depth = np.full(shape, -1, dtype=np.int32), np.full(shape, -np.inf, dtype=np.float32)
    height, width = shape
    boxes = np.ceil(triangles[..., :2].min(axis=1)), np.floor(triangles[..., :2].max(axis=1))
    low, high = (np.clip(box, 0, [width - 1, height - 1]).astype(int) for box in boxes)
    corners = np.swapaxes(triangles, 1, 2).copy()
    corners[:, 2] = 1.0
    visible = np.flatnonzero(np.abs(np.linalg.det(corners)) > 1e-12)
    pixels = np.cumsum((high - low + 1)[visible].prod(axis=1))
    for part in np.split(visible, np.searchsorted(pixels, np.arange(_TOGETHER, pixels.max(initial=0), _TOGETHER))):
        # Three barycentric coordinates and the nearness, each linear in (column, row, 1).
        shares = np.linalg.inv(corners[part])
        nearness = (triangles[part, None, :, 2] @ shares)[:, 0]
        face, row = _ranges(low[part, 1], high[part, 1])
        slope, down, constant = np.moveaxis(shares[face], -1, 0)
        # A pixel on the common side of two faces must not be missed by both.
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (down * row[:, None] + constant + 1e-9) / np.abs(slope)
        left = np.fmax.reduce(np.where(slope >= 0.0, -ends, 0.0), axis=1)
        right = np.fmin.reduce(np.where(slope < 0.0, ends, width), axis=1)
        span, column = _ranges(np.ceil(np.clip(left, 0, width)), np.floor(np.clip(right, -1, width - 1)))
        face, row = face[span], row[span]
        near = (nearness[face, 0] * column + nearness[face, 1] * row + nearness[face, 2]).astype(np.float32)
        np.maximum.at(depth, (row, column), near)
        seen = near == depth[row, column]
        index[row[seen], column[seen]] = part[face[seen]]
    return index, depth


def _ranges(first: npt.NDArray[Any], last: npt.NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Return the whole numbers from each `first` to its `last` (n,) one after another, and before them which of n."""
    counts = (last - first + 1).clip(0).astype(int)
    which = np.repeat(np.arange(len(counts)), counts)
    return which, np.arange(len(which)) + (first.astype(int) - np.cumsum(counts) + counts)[which]


def _edges(region: npt.NDArray[np.int32], depth: Image, width: int) -> BoolArray:
    """Return which pixels are within `width` of the border of their region, on the nearer side of that border."""
    edge = np.zeros(region.shape, dtype=bool)
    for axis in (0, 1):
        for step in range(1, width + 1):
            first, second = (np.s_[step:], np.s_[:-step]) if axis == 0 else (np.s_[:, step:], np.s_[:, :-step])
            border = region[first] != region[second]
            front = depth[first] >= depth[second]
            edge[first] |= border & front
            edge[second] |= border & ~front
    return edge


def view_axes(azimuth: float, elevation: float) -> FloatArray:
    """Return the unit vectors to the right, up and towards the viewer as rows (3, 3), in {B}; angles in radians."""
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    level = math.cos(elevation)
    near = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    return np.stack([right, np.cross(near, right), near])
