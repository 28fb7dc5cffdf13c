"""A shell as a mesh file, for CAD programs and viewers."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np

from spm_pin.display.scene import plots_extra
from spm_pin.display.shell_plots import FAMILY_COLOURS
from spm_pin.mechanism.arguments import file_path, writing
from spm_pin.workspace.table_6.shell import Patch, Shell

__all__ = ["MESH_FORMATS", "save_mesh"]

MESH_FORMATS = (".stl", ".ply", ".obj", ".glb")
"""File types that shells are written in."""

_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def save_mesh(shell: Shell, path: str | Path) -> Path:
    """Write a shell's mesh, lengths in metres.

    STL and OBJ hold one closed mesh, PLY the same with the colours of the families. GLB holds each patch as a mesh of
    its own, named and coloured, and has its y axis upward, as that format requires.

    Raises
    ------
    ArgumentError
        If the name does not end in one of `MESH_FORMATS`, or the file cannot be written.
    """
    path = file_path(path, suffixes=MESH_FORMATS)
    with plots_extra():
        content = _patchwork(shell) if path.suffix.lower() == ".glb" else _whole(shell, path.suffix.lower()[1:])
    with writing(path):
        path.write_bytes(content)
    return path


def _rgba(patch: Patch) -> list[int]:
    return [*(round(255 * channel) for channel in FAMILY_COLOURS[patch.family]), 255]


def _whole(shell: Shell, kind: str) -> bytes:
    import trimesh

    colours = [np.tile(_rgba(patch), (len(patch.faces), 1)) for patch in shell.patches]
    mesh = trimesh.Trimesh(
        shell.vertices, shell.faces, face_colors=np.concatenate(colours) if kind == "ply" else None, process=False
    )
    content = mesh.export(file_type=kind)
    return content.encode() if isinstance(content, str) else cast("bytes", content)


def _patchwork(shell: Shell) -> bytes:
    import trimesh

    scene = trimesh.Scene()
    for patch in shell.patches:
        material = trimesh.visual.material.PBRMaterial(
            name=patch.family, baseColorFactor=_rgba(patch), metallicFactor=0.0, roughnessFactor=0.8
        )
        mesh = trimesh.Trimesh(shell.vertices, shell.faces[patch.faces], process=False)
        mesh.remove_unreferenced_vertices()
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=patch.name, geom_name=patch.name, transform=_Y_UP)
    return cast("bytes", scene.export(file_type="glb"))
