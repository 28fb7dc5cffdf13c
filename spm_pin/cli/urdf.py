"""`spm-pin urdf`: the description expanded for a geometry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from spm_pin.cli.console import stderr
from spm_pin.cli.options import GeometryFile, read_geometry
from spm_pin.errors import ArgumentError

__all__ = ["urdf"]


def urdf(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where to write; standard output if not given.")
    ] = None,
    prefix: Annotated[str, typer.Option(help="Put before every name, such as left_.")] = "",
    geometry: GeometryFile = None,
) -> None:
    """Write the URDF: an open tree of eighteen joints, assembled at zero, its four loops closed by Drake's tags.

    Other loaders pass over those tags; `spm-pin export` writes the closed robot for them.
    """
    from spm_pin.description.expand import expand

    text = expand(read_geometry(geometry), prefix=prefix)
    if out is None:
        typer.echo(text, nl=False)
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ArgumentError("--out", "a file that can be written", out, str(error.strerror)) from error
    stderr.print(f"wrote {escape(str(out))}")
