"""`spm-pin urdf`: the description expanded for a geometry."""

from __future__ import annotations

from spm_pin.cli.options import GeometryFile, Prefix, TextFile, read_geometry
from spm_pin.cli.outputs import check_output, name_options, write_model

__all__ = ["urdf"]


@name_options(prefix="--prefix", out="--out")
def urdf(
    out: TextFile = None,
    prefix: Prefix = "",
    geometry: GeometryFile = None,
) -> None:
    """Write the URDF: an open tree of eighteen joints, assembled at zero, its four loops closed by Drake's tags.

    Other loaders pass over those tags; `spm-pin export` writes the closed robot for them. With --out, the meshes are
    put beside the file, into a folder `meshes`, and named relative to it; Pinocchio finds them if it is told the
    file's folder, package_dirs=".". A URDF on standard output names them by their whole paths.
    """
    from spm_pin.description.expand import expand
    from spm_pin.description.paths import MESHES

    check_output(out)
    write_model(expand(read_geometry(geometry), prefix=prefix, meshes=MESHES if out else None), out)
