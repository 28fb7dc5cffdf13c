"""`spm-pin workspace`, where a manipulator's platform can be, and `reach`, how far a stage's platform tilts."""

from __future__ import annotations

import math
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from spm_pin.cli import outputs
from spm_pin.cli.options import Picture
from spm_pin.cli.outputs import Part, Report, Table
from spm_pin.cli.units import MachineInUnits
from spm_pin.crosscheck.paper_shell import ERRATA, Shell, workspace_shell
from spm_pin.display.figures import reach_figure
from spm_pin.display.shell_plots import MESH_FORMATS, save_mesh, shell_figure
from spm_pin.display.writing import FORMATS, fixed
from spm_pin.errors import require_extra
from spm_pin.machine import LEGS
from spm_pin.machine.manipulator import check_manipulator
from spm_pin.workspace import ReachEnd, best_height, height_range
from spm_pin.workspace import reach as largest_tilts
from spm_pin.workspace.boundary import Boundary, reachable_boundary
from spm_pin.workspace.positions import Estimate


def workspace(
    typed: MachineInUnits,
    spacing: Annotated[float | None, Option(help="Spacing of the grid, in --unit; default: a twentieth.")] = None,
    out: Annotated[
        Path | None,
        Option(metavar="FILE", help="Picture (.png, .svg, .pdf) or mesh in metres (.stl, .ply, .obj, .glb)."),
    ] = None,
    paper: Annotated[bool, Option("--paper", help="The 24 surfaces of the paper's Table 6, for RPS legs.")] = False,
    resolution: Annotated[int, Option(help="Increments of a varying leg for --paper, at least 2.")] = 40,
) -> Report:
    """Compute where the platform's centre can be, in some orientation: boundary and volume of the reachable set.

    Example: spm-pin workspace --limits 110 150 --unit cm --out reached.png

    It takes the file of a calibrated machine as well. The volume is extrapolated from two meshes, with the spacing and
    half of it. --paper computes the paper's shell, which is not the whole boundary. It needs the extra
    "workspace", and --out "plots".
    """
    if out is not None:
        cause = "Maps over many poses are for spm-pin sweep" if out.suffix == ".zarr" else ""
        outputs.check_output(out, "--out", (*FORMATS, *MESH_FORMATS), cause)
        require_extra("plots")
    machine, unit = check_manipulator(typed.machine, for_stage="For a stage see spm-pin stage reach"), typed.unit
    mesh: Shell | Boundary
    if paper:
        mesh = workspace_shell(machine, resolution=resolution)
        report = Report(*_of_shell(mesh, typed, has_tables=out is None))
    else:
        require_extra("workspace")
        with outputs.progress_bar() as progress:
            coarse_spacing = None if spacing is None else spacing / unit.per_metre
            coarse = reachable_boundary(machine, spacing=coarse_spacing, progress=progress)
            mesh = reachable_boundary(machine, spacing=0.5 * coarse.spacing, progress=progress)
        report = Report(*_of_boundary(mesh, Estimate.from_meshes(coarse, mesh), typed))
    if out is not None and out.suffix.lower() in MESH_FORMATS:
        save_mesh(mesh, out)
        outputs.note(f"wrote {out}")
    else:
        outputs.write_figure(out, shell_figure, mesh)
    return report


def _of_mesh(mesh: Shell | Boundary, volume: float, error: float, typed: MachineInUnits) -> tuple[Any, list[str]]:
    """Return the JSON content of a mesh of either kind, and lines on its limits and its volume."""
    length, scale = typed.unit.per_metre, typed.unit.per_metre**3
    content = {
        **typed.content(),
        "limits": {end: getattr(mesh.limits, end) * typed.scale for end in ("minimum", "maximum")},
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "area": mesh.area * length**2,
        "volume": volume * scale,
        "volume_error": error * scale,
    }
    ends = mesh.limits.ends * typed.scale
    least, most = (", ".join(f"{x:g}" for x in (end[:1] if (end == end[0]).all() else end)) for end in ends)
    # The volume has one digit more than its error justifies.
    digits = 1 - math.floor(math.log10(error * scale)) if error else 0
    size, off = (f"{round(x * scale, n):.{max(0, n)}f}" for x, n in ((volume, digits), (error, digits - 1)))
    return content, [f"legs from {least} to {most} {typed.heading}", f"volume {size} ± {off} {typed.unit}³"]


def _of_boundary(boundary: Boundary, estimate: Estimate, typed: MachineInUnits) -> tuple[Any, list[str]]:
    unit, length = typed.unit, typed.unit.per_metre
    content, lines = _of_mesh(boundary, estimate.value, estimate.high - estimate.value, typed)
    low, high = boundary.vertices.min(axis=0) * length, boundary.vertices.max(axis=0) * length
    content |= {"spacing": boundary.spacing * length, "extent": {"minimum": low, "maximum": high}}
    lines += [f"{axis} from {a:.4g} to {b:.4g} {unit}" for axis, a, b in zip("XYZ", low, high, strict=True)]
    lines.append(f"mesh of {len(boundary.vertices)} vertices, spacing {boundary.spacing * length:.3g} {unit}")
    return content, lines


def _of_shell(shell: Shell, typed: MachineInUnits, *, has_tables: bool) -> tuple[Any, list[Part]]:
    unit, scale, convergence = typed.unit, typed.unit.per_metre**3, shell.convergence
    content, lines = _of_mesh(shell, shell.volume, shell.volume_error, typed)
    content |= {"resolution": shell.resolution, "euler_characteristic": shell.euler_characteristic}
    content["convergence"] = [
        {"resolution": n, "volume": value * scale, "short": (convergence.limit - value) * scale}
        for n, value in zip(convergence.resolutions, convergence.volumes, strict=True)
    ]
    content["patches"] = patches = [
        {
            "name": patch.name,
            "settings": {leg: setting.value for leg, setting in zip(LEGS, patch.settings, strict=True)},
            "area": patch.area * unit.per_metre**2,
            "family": patch.family,
        }
        for patch in shell.patches
    ]
    settings: dict[str, Any] = {leg: lambda row, leg=leg: row["settings"][leg] for leg in LEGS}
    columns: dict[str, Any] = {
        "patch": itemgetter("name"),
        **settings,
        "area": lambda row: outputs.significant(row["area"]),
    }
    title = f"The surfaces: leg settings, area in {unit}²"
    surfaces = Table(title, columns, patches, left=LEGS, group=itemgetter("family"))
    columns = {
        "increments": lambda row: str(row["resolution"]),
        "volume": lambda row: outputs.significant(row["volume"], digits=8),
        "short of the limit by": lambda row: outputs.significant(row["short"], digits=2),
    }
    volumes = Table(f"The volume as the mesh gets finer, in {unit}³", columns, content["convergence"])
    vertices, faces = len(shell.vertices), len(shell.faces)
    edges = vertices + faces - shell.euler_characteristic
    lines.append(f"order of convergence {convergence.order:.3f}")
    lines.append(f"V - E + F = {vertices} - {edges} + {faces} = {shell.euler_characteristic}")
    lines.append("misprints read: " + ", ".join(f"{leg} of {name}" for name, leg in ERRATA))
    return content, [*([surfaces, volumes] if has_tables else []), *lines]


def reach(
    typed: MachineInUnits,
    heights: Annotated[
        list[float] | None, Option("--height", metavar="LENGTH", help="In --unit; repeatable; default: nine heights.")
    ] = None,
    directions: Annotated[int, Option(metavar="N", help="Number of directions of the largest tilt.")] = 72,
    out: Picture = None,
) -> Report:
    """Compute how far a stage's platform tilts at each height and in each direction, and what limits the tilt.

    Example: spm-pin stage reach --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --out reach.png
    """
    stage, unit = typed.machine, typed.unit
    levels = None if heights is None else np.array(heights) / unit.per_metre
    found = largest_tilts(stage, levels, directions=directions)
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
