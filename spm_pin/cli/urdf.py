"""`spm-pin urdf`: the description expanded for a geometry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from spm_pin.cli import options, outputs


@outputs.name_options()
def urdf(
    out: Annotated[Path | None, outputs.file_option("Where to write; standard output if not given.")] = None,
    prefix: Annotated[str, options.PREFIX] = "",
    geometry: options.AnyGeometryFile = None,
) -> None:
    """Write the URDF: an open tree of eighteen joints, its four loops closed by Drake's tags.

    Other loaders pass over those tags; `spm-pin export` writes the closed robot for them. At zero the tree of a drawing
    is assembled. With --out, the meshes are put beside the file, into a folder `meshes`, and named relative to it;
    Pinocchio finds them if it is told the file's folder, package_dirs=".". A URDF on standard output names them by
    their whole paths.
    """
    from spm_pin.description import urdf_text

    text = urdf_text(options.read_any_geometry(geometry), prefix=prefix, meshes="meshes" if out else None)
    outputs.write_model(text, out)
