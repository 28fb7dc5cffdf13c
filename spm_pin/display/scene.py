"""The manipulator as a scene: the description's solids in {B}, and the arrows of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from spm_pin.description.visuals import part_placements, section_size, visual_parts
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration, check_configuration

Colour = tuple[float, float, float]
"""Red, green and blue in sRGB, from 0 to 1."""

AXIS_COLOURS: dict[str, Colour] = {"x": (0.835, 0.369, 0.0), "y": (0.0, 0.62, 0.451), "z": (0.353, 0.247, 0.69)}
"""Colours of the axes of {B} and {m}."""

TRIAD = 0.7
"""Length of a frame's arrows over `Scene.size`."""

_SIDES = 24  # of an arrow


@dataclass(frozen=True)
class Solid:
    """One closed surface of a scene."""

    name: str  # the link and the mesh, "base_a1 clevis", or the frame and the axis, "{B} x"; unique in its scene
    kind: Literal["robot", "frame"]
    """Part of the machine, or arrow of a frame."""
    colour: Colour  # red, green and blue in sRGB, from 0 to 1
    vertices: FloatArray  # vertices in {B} [m], shape (n, 3)
    faces: npt.NDArray[np.signedinteger]  # triangles, counter-clockwise seen from outside, shape (m, 3)


@dataclass(frozen=True)
class Scene:
    """The solids of one picture."""

    solids: tuple[Solid, ...]  # the surfaces, those of the machine before the frames
    size: float  # length that the cross-sections of the robot are in proportion to [m]


def scene(configuration: Configuration, *, frames: bool = True) -> Scene:
    """Return the solids of a configuration, those of the URDF; see `spm_pin.description.visuals`.

    With `frames` also arrows for the axes of {B} and {m}: ``"{B} x"`` and so on.
    """
    check_configuration(configuration, single=True, existing=True)
    if not (configuration.leg_lengths > 0.0).all():
        raise ArgumentError("configuration", "legs of positive length", configuration.leg_lengths)
    if not np.isfinite(configuration.middle_pose.as_matrix()).all():
        raise ArgumentError("configuration", "middle joints that span a plane", configuration.middle_joints.tolist())
    parts = visual_parts(configuration.geometry)
    solids = [
        Solid(part.name, "robot", part.colour, part.vertices @ pose[:3, :3].T + pose[:3, 3], part.faces)
        for part, pose in zip(parts, part_placements(configuration), strict=True)
    ]
    size = section_size(configuration.geometry)
    if frames:
        solids += _triad("{B}", np.eye(3), np.zeros(3), TRIAD * size)
        solids += _triad("{m}", configuration.rotation, configuration.translation, TRIAD * size)
    return Scene(tuple(solids), size)


def _triad(frame: str, rotation: FloatArray, origin: FloatArray, length: float) -> list[Solid]:
    """Return three arrows along the axes of a frame."""
    turns = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    rings = [np.column_stack([r * circle, np.full(_SIDES, z)]) for r, z in ((0.04, 0.0), (0.04, 0.72), (0.11, 0.72))]
    arrow = length * np.concatenate([*rings, [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    here = np.arange(_SIDES)
    there, foot, tip = np.roll(here, -1), 3 * _SIDES, 3 * _SIDES + 1
    strips = [(there, here, np.full(_SIDES, foot)), (here + 2 * _SIDES, there + 2 * _SIDES, np.full(_SIDES, tip))]
    for low, high in ((0, _SIDES), (_SIDES, 2 * _SIDES)):
        strips += [(low + here, low + there, high + there), (low + here, high + there, high + here)]
    faces = np.concatenate([np.stack(strip, axis=-1) for strip in strips])
    return [
        # The local z axis becomes the arrow's; columns in cyclic order keep the handedness.
        Solid(f"{frame} {axis}", "frame", AXIS_COLOURS[axis], arrow @ rotation[:, order].T + origin, faces)
        for axis, order in (("x", [1, 2, 0]), ("y", [2, 0, 1]), ("z", [0, 1, 2]))
    ]
