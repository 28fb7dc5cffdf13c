"""`spm-pin workspace`: the paper's workspace as numbers, a picture or a mesh."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.display.shell_plots import MESH_FORMATS, save_mesh, shell_figure
from spm_pin.display.writing import FORMATS, Style, save_figure
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism import LEGS, LegLimits
from spm_pin.workspace.paper_shell import ERRATA, Shell, workspace_shell


@outputs.name_options(limits="--limits")
def workspace(
    limits: options.Limits = None,
    resolution: Annotated[int, Option(help="Increments of a varying leg, at least 2.")] = 40,
    out: Annotated[
        Path | None,
        Option(metavar="FILE", help="Picture (.png, .svg, .pdf) or mesh in metres (.stl, .ply, .obj, .glb)."),
    ] = None,
    sections: Annotated[bool, Option("--sections", help="Draw sections, with what is reached, instead.")] = False,
    samples: Annotated[int, Option(min=1, help="Random sets of leg lengths for --sections.")] = 2_000_000,
    style: outputs.PictureStyle = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Construct the workspace of the paper: the 24 surfaces of Table 6, joined to a closed shell.

    Example: spm-pin workspace --limits 110 150 --unit cm --out fig2.png

    The shell is not the whole boundary of what can be reached; --sections shows where it is not. With --out a summary
    is printed, else the tables of all surfaces. --out needs the extra "plots".
    """
    if out is None and sections:
        raise ArgumentError("--sections", "a picture to draw them in", "no --out FILE")
    if out is not None:
        cause = "Maps over many poses are for spm-pin sweep" if out.suffix == ".zarr" else ""
        outputs.check_output(out, "--out", FORMATS if sections else (*FORMATS, *MESH_FORMATS), cause)
        require_extra("plots")
    dimensions = options.read_geometry(geometry)
    box = None if limits is None else LegLimits(*(length / unit.per_metre for length in limits))
    try:
        shell = workspace_shell(dimensions, box, resolution=resolution)
    except ArgumentError as error:
        hint = "" if limits is None else options.unit_hint("--limits", limits[1], unit, dimensions)
        if not hint:
            raise
        raise ArgumentError("--limits", error.expected, error.received, hint) from error
    if out is not None:
        _write(shell, out, samples if sections else None, style)
    if json:
        outputs.write_json(_content(shell, unit))
    else:
        if out is None:
            _print_tables(shell, unit)
        outputs.print_lines(_remarks(shell, unit))


def _write(shell: Shell, out: Path, samples: int | None, style: Style | None) -> None:
    """Write a mesh, a picture of the shell, or of its sections with what `samples` sets of leg lengths reach."""
    if out.suffix.lower() in MESH_FORMATS:
        save_mesh(shell, out)
    elif samples is None:
        save_figure(shell_figure(shell), out, style=style)
    else:
        from spm_pin.display.shell_plots import sections_figure
        from spm_pin.workspace.sampling import sample_positions_near_limits

        with outputs.stderr.status("drawing leg lengths"):
            reached, aspect = sample_positions_near_limits(shell.geometry, shell.limits, count=samples)
        save_figure(sections_figure(shell, reached, aspect), out, style=style)
    outputs.note(f"wrote {out}")


def _print_tables(shell: Shell, unit: LengthUnit) -> None:
    settings = {leg: lambda patch, k=k: patch.settings[k].value for k, leg in enumerate(LEGS)}
    area = {"area": lambda patch: outputs.significant(patch.area * unit.per_metre**2)}
    columns = {"patch": lambda patch: patch.name, **settings, **area}
    title = f"The surfaces: leg settings, area in {unit}²"
    outputs.print_table(title, columns, shell.patches, left=LEGS, group=lambda patch: patch.family)
    scale, convergence = unit.per_metre**3, shell.convergence
    columns = {
        "increments": lambda row: str(row[0]),
        "volume": lambda row: outputs.significant(row[1] * scale, digits=8),
        "short of the limit by": lambda row: outputs.significant((convergence.limit - row[1]) * scale, digits=2),
    }
    rows = zip(convergence.resolutions, convergence.volumes, strict=True)
    outputs.print_table(f"The volume as the mesh gets finer, in {unit}³", columns, rows)


def _remarks(shell: Shell, unit: LengthUnit) -> list[str]:
    scale = unit.per_metre**3
    vertices, faces = len(shell.vertices), len(shell.faces)
    edges = vertices + faces - shell.euler_characteristic
    low, high = (_range(ends, unit) for ends in (shell.limits.minimum, shell.limits.maximum))
    # As many digits as the error leaves, and one more.
    digits = max(0, 1 - math.floor(math.log10(shell.volume_error * scale))) if shell.volume_error else 0
    volume, error = shell.volume * scale, shell.volume_error * scale
    return [
        f"legs from {low} to {high} {unit}",
        f"volume {volume:.{digits}f} ± {error:.1g} {unit}³",
        f"order of convergence {shell.convergence.order:.3f}",
        f"V - E + F = {vertices} - {edges} + {faces} = {shell.euler_characteristic}",
        "misprints read: " + ", ".join(f"{leg} of {name}" for name, leg in ERRATA),
    ]


def _range(ends: tuple[float, ...], unit: LengthUnit) -> str:
    return ", ".join(f"{end * unit.per_metre:g}" for end in (ends[:1] if len(set(ends)) == 1 else ends))


def _content(shell: Shell, unit: LengthUnit) -> dict[str, Any]:
    length, area, volume = (unit.per_metre**power for power in (1, 2, 3))
    return {
        "unit": str(unit),
        "limits": {end: np.multiply(getattr(shell.limits, end), length) for end in ("minimum", "maximum")},
        "resolution": shell.resolution,
        "vertices": len(shell.vertices),
        "faces": len(shell.faces),
        "euler_characteristic": shell.euler_characteristic,
        "area": shell.area * area,
        "volume": shell.volume * volume,
        "volume_error": shell.volume_error * volume,
        "convergence": [
            {"resolution": n, "volume": value * volume}
            for n, value in zip(shell.convergence.resolutions, shell.convergence.volumes, strict=True)
        ],
        "patches": [
            {
                "name": patch.name,
                "settings": {leg: setting.value for leg, setting in zip(LEGS, patch.settings, strict=True)},
                "area": patch.area * area,
            }
            for patch in shell.patches
        ],
    }
