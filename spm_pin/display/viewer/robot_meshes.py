"""The robot as its URDF draws it: meshes, one for each moving part and colour, and where they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import MissingExtraError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

if TYPE_CHECKING:
    from spm_pin.multibody.chain import ClosedChain

__all__ = ["Part", "Robot"]


@dataclass(frozen=True)
class Part:
    """What moves as one and has one colour.

    Attributes
    ----------
    name : str
        Of its first shape in the URDF.
    joint : int
        The joint of the Pinocchio model that carries it; 0 does not move.
    colour : tuple of three ints
        sRGB, from 0 to 255.
    vertices : ndarray of float32, shape (n, 3)
        In the frame of the joint [m].
    faces : ndarray of uint32, shape (m, 3)
        Triangles.
    """

    name: str
    joint: int
    colour: tuple[int, int, int]
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.uint32]


class Robot:
    """The visual shapes of the description, through Pinocchio; read-only, so any number of sessions may share one.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.

    Raises
    ------
    MissingExtraError
        If trimesh is not installed.
    """

    def __init__(self, geometry: Geometry) -> None:
        from spm_pin.multibody.chain import ClosedChain

        self.geometry = geometry
        self.chain: ClosedChain = ClosedChain.from_urdf(geometry=geometry)
        self.parts = _parts(self.chain.visual_model)
        self._joints = [part.joint for part in self.parts]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        return self.chain.joint_names

    def q(self, configuration: Configuration) -> FloatArray:
        """Return the joint values (18,) of a configuration, in Pinocchio's order; see `ClosedChain.joint_values`."""
        return self.chain.joint_values(configuration)

    def placements(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the parts are in {B} for joint values q (18,).

        Returns
        -------
        positions : ndarray, shape (n, 3)
            Of the parts' frames [m].
        quaternions : ndarray, shape (n, 4)
            Their orientations, scalar first.
        """
        import pinocchio as pin

        data = self.chain.model.createData()
        pin.forwardKinematics(self.chain.model, data, q)
        positions = np.array([data.oMi[joint].translation for joint in self._joints])
        matrices = np.array([data.oMi[joint].rotation for joint in self._joints])
        return positions, np.asarray(Rotation.from_matrix(matrices).as_quat(scalar_first=True))


def _parts(visuals: Any) -> tuple[Part, ...]:
    try:
        import trimesh
    except ModuleNotFoundError as missing:
        raise MissingExtraError("viewer", "trimesh") from missing

    groups: dict[tuple[int, tuple[int, int, int]], list[tuple[str, Any]]] = {}
    for shape in visuals.geometryObjects:
        red, green, blue = (round(255 * float(x)) for x in shape.meshColor[:3])
        mesh = _mesh(shape.geometry).apply_transform(shape.placement.homogeneous)
        groups.setdefault((int(shape.parentJoint), (red, green, blue)), []).append((shape.name, mesh))
    parts = []
    for (joint, colour), members in groups.items():
        whole: Any = trimesh.util.concatenate([mesh for _, mesh in members])
        vertices, faces = np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.uint32)
        parts.append(Part(members[0][0], joint, colour, vertices, faces))
    return tuple(parts)


def _mesh(shape: Any) -> Any:
    import trimesh

    triangles = [shape.tri_indices(k) for k in range(shape.num_tris)]
    return trimesh.Trimesh(shape.vertices(), [[t[0], t[1], t[2]] for t in triangles], process=False)
