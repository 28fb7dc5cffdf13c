"""Expanding the xacro sources to a URDF, for any geometry."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

import yaml

from spm_pin.description.paths import ENTRY, MESHES, description_directory, description_file
from spm_pin.description.xml_nodes import check_prefix
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.geometry_files import as_data

# xacro keeps its state in module globals.
_XACRO = threading.Lock()


def expand(geometry: Geometry | None = None, *, prefix: str = "", meshes: str | None = None) -> str:
    """Return the URDF of a manipulator.

    Parameters
    ----------
    geometry : Geometry, optional
        By default the paper's.
    prefix : str
        Put before the name of every link, joint, transmission, actuator and material, so that several robots
        can share a model.
    meshes : str
        The folder of the meshes as the URDF is to name it: ``"meshes"`` beside the URDF, or
        ``"package://spm_description/meshes"``. By default the absolute path of this installation's.

    Returns
    -------
    str
        The text of the URDF; its numbers have the digits that float64 needs.

    Raises
    ------
    DescriptionError
        If `prefix` cannot begin a name.
    """
    import xacro

    check_prefix(prefix)
    data = as_data(Geometry.paper() if geometry is None else geometry)
    with tempfile.TemporaryDirectory() as folder, _XACRO:
        path = Path(folder) / "geometry.yaml"
        path.write_text(yaml.safe_dump(data), encoding="utf-8")
        folder_of_meshes = (description_directory() / MESHES).as_posix() if meshes is None else meshes
        mappings = {"prefix": prefix, "geometry": str(path), "meshes": folder_of_meshes}
        document = xacro.process_file(str(description_file(ENTRY)), mappings=mappings)
    # xacro's banner holds the path of this machine's copy; the source's own comment stays.
    while document.firstChild is not document.documentElement:
        document.removeChild(document.firstChild).unlink()
    banner = f" Expanded from {ENTRY}, which is the place for changes. "
    document.insertBefore(document.createComment(banner), document.documentElement)
    return str(document.toprettyxml(indent="  "))
