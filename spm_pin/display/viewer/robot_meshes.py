"""The solids of the description, joined where they move as one and have one colour, and where a state puts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.description.visuals import VisualPart, part_placements, visual_parts
from spm_pin.mechanism import LEGS, Configuration, Geometry
from spm_pin.mechanism.arguments import FloatArray

_STRETCHED = ("tube", "gland")
"""Meshes of a leg with placements of their own, which depend on its length."""


@dataclass(frozen=True, eq=False)
class MovingMesh:
    """A mesh of one colour that moves as one."""

    name: str
    """Name of the first of its parts, see `VisualPart`."""
    leg: int | None
    """Index in `LEGS` of the leg that it belongs to; None for the platforms."""
    colour: tuple[int, int, int]
    """Red, green and blue in sRGB, from 0 to 255."""
    vertices: npt.NDArray[np.float32]
    """Vertices in the frame of its body [m], shape (n, 3)."""
    faces: npt.NDArray[np.uint32]
    """Triangles, shape (m, 3)."""
    part: int
    """Index of the part whose placement it has."""


@dataclass(frozen=True)
class Placements:
    """Placements of meshes in {B}."""

    positions: FloatArray
    """Origins in {B} [m], shape (..., 3)."""
    quaternions: FloatArray
    """Unit quaternions, scalar first, shape (..., 4)."""
    scales: FloatArray
    """Scales along the axes of the mesh, shape (..., 3)."""


class RobotMeshes:
    """The meshes of a manipulator; read-only, so any number of sessions may share them."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        groups: dict[tuple[str, tuple[int, int, int], str], list[tuple[int, VisualPart]]] = {}
        for k, part in enumerate(visual_parts(geometry)):
            red, green, blue = (round(255.0 * x) for x in part.colour)
            separate = part.name if part.mesh in _STRETCHED else ""
            groups.setdefault((part.body, (red, green, blue), separate), []).append((k, part))
        self.meshes = tuple(_joined(colour, body, members) for (body, colour, _), members in groups.items())
        self._parts = [mesh.part for mesh in self.meshes]

    def placements(self, configuration: Configuration) -> Placements:
        """Return positions, rotations and scales of the meshes in configurations (...): arrays of shape (..., n, k)."""
        matrices = part_placements(configuration)[..., self._parts, :, :]
        scales = np.linalg.norm(matrices[..., :3, :3], axis=-2)
        rotations = matrices[..., :3, :3] / scales[..., None, :]
        turns = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
        return Placements(matrices[..., :3, 3], turns.reshape(*rotations.shape[:-2], 4), scales)


def _joined(colour: tuple[int, int, int], body: str, members: list[tuple[int, VisualPart]]) -> MovingMesh:
    starts = np.cumsum([0, *(len(part.vertices) for _, part in members)])
    vertices = np.concatenate([part.vertices for _, part in members])
    faces = np.concatenate([part.faces + start for (_, part), start in zip(members, starts, strict=False)])
    leg = f"r_{body.partition('_')[2][:2]}"
    return MovingMesh(
        name=members[0][1].name.replace(" ", "_"),
        leg=LEGS.index(leg) if leg in LEGS else None,
        colour=colour,
        vertices=np.asarray(vertices, np.float32),
        faces=np.asarray(faces, np.uint32),
        part=members[0][0],
    )
