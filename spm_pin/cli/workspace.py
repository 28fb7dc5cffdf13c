"""`spm-pin workspace`, where a manipulator's platform can be, and `reach`, how far a stage's platform tilts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from spm_pin.cli import outputs
from spm_pin.cli.outputs import Report, Table
from spm_pin.cli.units import MachineInUnits
from spm_pin.crosscheck.paper_shell import ERRATA, Shell, sample_positions_near_limits, workspace_shell
from spm_pin.display.figures import reach_figure
from spm_pin.display.shell_plots import MESH_FORMATS, save_mesh, sections_figure, shell_figure
from spm_pin.display.writing import FORMATS, fixed, save_figure
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.machine import LEGS, LegLimits, Manipulator
from spm_pin.machine.manipulator import check_manipulator
from spm_pin.workspace import ReachEnd, best_height, height_range
from spm_pin.workspace import reach as largest_tilts
from spm_pin.workspace.boundary import Boundary, reachable_boundary
from spm_pin.workspace.positions import Estimate


def workspace(
    typed: MachineInUnits,
    spacing: Annotated[
        float | None, Option(help="Spacing of the grid, in --unit; default: a twentieth of the reachable set.")
    ] = None,
    out: Annotated[
        Path | None,
        Option(metavar="FILE", help="Picture (.png, .svg, .pdf) or mesh in metres (.stl, .ply, .obj, .glb)."),
    ] = None,
    paper: Annotated[
        bool, Option("--paper", help="The 24 surfaces of the paper's Table 6 instead, for nominal RPS legs.")
    ] = False,
    resolution: Annotated[int, Option(help="Increments of a varying leg for --paper, at least 2.")] = 40,
    sections: Annotated[bool, Option("--sections", help="Draw sections of --paper, with reachable points.")] = False,
    samples: Annotated[int, Option(min=1, help="Random sets of leg lengths for --sections.")] = 2_000_000,
) -> Report:
    """Compute where the platform's centre can be, in some orientation: boundary and volume of the reachable set.

    Example: spm-pin workspace --limits 110 150 --unit cm --out reached.png

    It takes the file of a calibrated machine as well. The volume is extrapolated from two meshes, with the spacing and
    half of it. --paper computes the paper's shell, which is not the whole boundary: --sections shows where. It needs
    the extra "workspace", and --out "plots".
    """
    if sections and (out is None or not paper):
        lacking = "no --out FILE" if paper else "no --paper"
        raise ArgumentError("--sections", "--paper and a picture to draw them in", lacking)
    if out is not None:
        cause = "Maps over many poses are for spm-pin sweep" if out.suffix == ".zarr" else ""
        outputs.check_output(out, "--out", FORMATS if sections else (*FORMATS, *MESH_FORMATS), cause)
        require_extra("plots")
    machine, unit = check_manipulator(typed.machine, for_stage="For a stage see spm-pin stage reach"), typed.unit
    shell: Shell | Boundary
    if paper:
        shell = workspace_shell(machine, resolution=resolution)
    else:
        require_extra("workspace")
        shell, volume = _reached(machine, None if spacing is None else spacing / unit.per_metre)
    if out is not None and out.suffix.lower() in MESH_FORMATS:
        save_mesh(shell, out)
    elif isinstance(shell, Shell) and sections and out is not None:
        with outputs.stderr.status("drawing leg lengths"):
            reached, aspect = sample_positions_near_limits(shell.machine, shell.limits, count=samples)
        save_figure(sections_figure(shell, reached, aspect), out)
    elif out is not None:
        save_figure(shell_figure(shell), out)
    if out is not None:
        outputs.note(f"wrote {out}")
    if isinstance(shell, Boundary):
        return _reached_report(shell, volume, typed)
    return Report(_content(shell, typed), [*(_tables(shell, typed) if out is None else []), *_remarks(shell, typed)])


def _reached(machine: Manipulator, spacing: float | None) -> tuple[Boundary, Estimate]:
    """Return the boundary of the reachable set, with half the spacing, and its volume."""
    with outputs.progress_bar() as progress:
        coarse = reachable_boundary(machine, spacing=spacing, progress=progress)
        fine = reachable_boundary(machine, spacing=0.5 * coarse.spacing, progress=progress)
    return fine, Estimate.from_meshes(coarse, fine)


def _measures(mesh: Shell | Boundary, volume: float, error: float, typed: MachineInUnits) -> dict[str, Any]:
    """Return the JSON content of a mesh of either kind."""
    length = typed.unit.per_metre
    return {
        **typed.content(),
        "limits": {end: getattr(mesh.limits, end) * typed.scale for end in ("minimum", "maximum")},
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "area": mesh.area * length**2,
        "volume": volume * length**3,
        "volume_error": error * length**3,
    }


def _measure_lines(mesh: Shell | Boundary, volume: float, error: float, typed: MachineInUnits) -> list[str]:
    """Return the limits and the volume, which has one digit more than its error justifies."""
    scale = typed.unit.per_metre**3
    digits = 1 - math.floor(math.log10(error * scale)) if error else 0
    size, off = (f"{round(x * scale, n):.{max(0, n)}f}" for x, n in ((volume, digits), (error, digits - 1)))
    return [*_limit_lines(mesh.limits, typed), f"volume {size} ± {off} {typed.unit}³"]


def _reached_report(boundary: Boundary, estimate: Estimate, typed: MachineInUnits) -> Report:
    unit, length = typed.unit, typed.unit.per_metre
    volume = estimate.value, estimate.high - estimate.value
    low, high = boundary.vertices.min(axis=0) * length, boundary.vertices.max(axis=0) * length
    own = {"spacing": boundary.spacing * length, "extent": {"minimum": low, "maximum": high}}
    extent = (f"{axis} from {a:.4g} to {b:.4g} {unit}" for axis, a, b in zip("XYZ", low, high, strict=True))
    mesh = f"mesh of {len(boundary.vertices)} vertices, spacing {boundary.spacing * length:.3g} {unit}"
    lines = [*_measure_lines(boundary, *volume, typed), *extent, mesh]
    return Report(_measures(boundary, *volume, typed) | own, lines)


def _limit_lines(limits: LegLimits, typed: MachineInUnits) -> list[str]:
    """Return the limits in words, in one line if all legs have the same unit."""
    units, lines = typed.reading_units, []
    stages = {"lower legs": slice(0, 3), "upper legs": slice(3, 6)}
    for place, legs in stages.items() if len(set(units)) > 1 else [("legs", slice(0, 6))]:
        ends = (limits.ends * typed.scale)[:, legs]
        least, most = (", ".join(f"{x:g}" for x in (end[:1] if (end == end[0]).all() else end)) for end in ends)
        lines.append(f"{place} from {least} to {most} {units[legs.start]}")
    return lines


def _tables(shell: Shell, typed: MachineInUnits) -> list[Table]:
    unit = typed.unit
    settings = {leg: lambda patch, k=k: patch.settings[k].value for k, leg in enumerate(LEGS)}
    area = {"area": lambda patch: outputs.significant(patch.area * unit.per_metre**2)}
    columns = {"patch": lambda patch: patch.name, **settings, **area}
    title = f"The surfaces: leg settings, area in {unit}²"
    patches = Table(title, columns, shell.patches, left=LEGS, group=lambda patch: patch.family)
    scale, convergence = unit.per_metre**3, shell.convergence
    columns = {
        "increments": lambda row: str(row[0]),
        "volume": lambda row: outputs.significant(row[1] * scale, digits=8),
        "short of the limit by": lambda row: outputs.significant((convergence.limit - row[1]) * scale, digits=2),
    }
    rows = zip(convergence.resolutions, convergence.volumes, strict=True)
    return [patches, Table(f"The volume as the mesh gets finer, in {unit}³", columns, rows)]


def _remarks(shell: Shell, typed: MachineInUnits) -> list[str]:
    vertices, faces = len(shell.vertices), len(shell.faces)
    edges = vertices + faces - shell.euler_characteristic
    return [
        *_measure_lines(shell, shell.volume, shell.volume_error, typed),
        f"order of convergence {shell.convergence.order:.3f}",
        f"V - E + F = {vertices} - {edges} + {faces} = {shell.euler_characteristic}",
        "misprints read: " + ", ".join(f"{leg} of {name}" for name, leg in ERRATA),
    ]


def _content(shell: Shell, typed: MachineInUnits) -> dict[str, Any]:
    unit = typed.unit
    return _measures(shell, shell.volume, shell.volume_error, typed) | {
        "resolution": shell.resolution,
        "euler_characteristic": shell.euler_characteristic,
        "convergence": [
            {"resolution": n, "volume": value * unit.per_metre**3}
            for n, value in zip(shell.convergence.resolutions, shell.convergence.volumes, strict=True)
        ],
        "patches": [
            {
                "name": patch.name,
                "settings": {leg: setting.value for leg, setting in zip(LEGS, patch.settings, strict=True)},
                "area": patch.area * unit.per_metre**2,
            }
            for patch in shell.patches
        ],
    }


def reach(
    typed: MachineInUnits,
    height: Annotated[
        list[float] | None,
        Option(metavar="LENGTH", help="Height of the platform's centre, in --unit; may be repeated; default: nine."),
    ] = None,
    directions: Annotated[int, Option(metavar="N", help="Number of directions of the largest tilt.")] = 72,
    out: Annotated[Path | None, outputs.picture_option("Picture of the largest tilts to write.")] = None,
) -> Report:
    """Compute how far a stage's platform tilts at each height and in each direction, and what limits the tilt.

    Example: spm-pin stage reach --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --out reach.png
    """
    stage, unit = typed.machine, typed.unit
    heights = None if height is None else np.array(height) / unit.per_metre
    found = largest_tilts(stage, heights, directions=directions)
    records = [
        {
            "height": level * unit.per_metre,
            "all_round": np.degrees(tilts.min()),
            "largest": np.degrees(tilts.max()),
            "ends": [str(ReachEnd(end)) for end in np.unique(ends)],
        }
        for level, tilts, ends in zip(found.heights, found.tilts, found.ends, strict=True)
    ]
    low, high = (x * unit.per_metre for x in height_range(stage))
    best, tilt = best_height(stage, directions=directions)
    best, tilt = best * unit.per_metre, math.degrees(tilt)
    content = {"unit": unit, "height_range": [low, high], "best_height": best, "best_tilt": tilt, "heights": records}
    columns: dict[str, Any] = {
        f"height [{unit}]": lambda row: unit.text(row["height"]),
        "all round [°]": lambda row: fixed(row["all_round"], 2).replace("nan", "–"),
        "largest [°]": lambda row: fixed(row["largest"], 2).replace("nan", "–"),
        "ends at": lambda row: ", ".join(row["ends"]),
    }
    table = Table("Largest tilts, in every direction and in the best one", columns, records, left=["ends at"])
    level = f"level from {unit.text(low)} to {unit.text(high)} {unit}"
    at_best = f"best height: {unit.text(best)} {unit}, {fixed(tilt, 2)}° in every direction"
    outputs.write_figure(out, reach_figure, found)
    return Report(content, [table, *([level, at_best] if math.isfinite(best) else ["level at no height"])])
