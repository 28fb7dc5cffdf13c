"""Paths of the description's files, in a checkout and in an installed package."""

from __future__ import annotations

from pathlib import Path

from spm_pin.errors import DescriptionError
from spm_pin.mechanism.arguments import writing
from spm_pin.mechanism.geometry import config_directory

# Names of files; `spm_pin.description` says what each is.
ENTRY = "spm.urdf.xacro"
URDF = "spm.urdf"
SRDF = "spm.srdf"
MJCF = "spm.xml"
SDF = "spm.sdf"
EXTENDED_URDF = "spm_closures.yaml"
MESHES = "meshes"
"""The folder of the solids that are drawn, OBJ files without unit: the URDF scales them."""
CLOSURES = "config/closures.yaml"
"""The closures as this package reads them."""


def description_directory() -> Path:
    """Return the folder of the description: `urdf` in a checkout, `share/spm_description` in an installed package."""
    return config_directory().parent


def description_file(name: str) -> Path:
    """Return the path of one description file, by its path relative to the description's folder, such as `URDF`.

    Raises
    ------
    DescriptionError
        If there is no such file.
    """
    path = description_directory() / name
    if not path.is_file():
        raise DescriptionError("name", "a file of the description", str(path), "An incomplete installation?")
    return path


def copy_meshes(folder: Path) -> None:
    """Copy the meshes into the folder `MESHES` of a folder, for a file there that names them relative to itself.

    Raises
    ------
    DescriptionError
        If one cannot be written, or a file of the same name has another content: it is left as it is.
    """
    target = folder / MESHES
    for source in sorted((description_directory() / MESHES).iterdir()):
        copy, content = target / source.name, source.read_bytes()
        with writing(copy, "out", error=DescriptionError):
            if copy.exists() and copy.read_bytes() != content:
                cause = "Of another version? Move it away"
                raise DescriptionError("out", "no other meshes beside the file", str(copy), cause)
            target.mkdir(exist_ok=True)
            copy.write_bytes(content)
