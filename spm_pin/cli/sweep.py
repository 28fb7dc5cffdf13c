"""`spm-pin sweep`: indices over any number of poses or leg lengths, resumed wherever it stopped."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from spm_pin.cli.console import stderr, stdout, to_json
from spm_pin.cli.options import AsJson, GeometryFile, LengthUnit, Unit, read_geometry
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Geometry, LegLimits
from spm_pin.sweeps.domains import Domain, Method
from spm_pin.sweeps.grids import leg_grid, leg_sample, pose_grid, pose_sample
from spm_pin.sweeps.metric import Index
from spm_pin.sweeps.metrics import INDICES, conditioning, isotropy, payload, payload_down, stiffness
from spm_pin.sweeps.runner import CHUNK, SweepStatus, resume_sweep, sweep_status
from spm_pin.sweeps.runner import sweep as run

__all__ = ["sweep"]

_DEFAULT = ("reachable", "branches", "conditioning")
_RANGE = "START:STOP:COUNT"

Range = float | tuple[float, ...]


def sweep(
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Store of the results, in Zarr v3.")],
    x: Annotated[str | None, typer.Option(metavar=_RANGE, help="X of o in {B}, in --unit, or one number.")] = None,
    y: Annotated[str | None, typer.Option(metavar=_RANGE, help="Y, likewise.")] = None,
    z: Annotated[str | None, typer.Option(metavar=_RANGE, help="Z, likewise.")] = None,
    xyx: Annotated[
        tuple[str, str, str] | None,
        typer.Option(metavar="ALPHA BETA LAMBDA", help="X-Y-X angles in degrees, each a range or one number."),
    ] = None,
    legs: Annotated[
        list[str] | None,
        typer.Option(
            metavar=_RANGE,
            help="Leg lengths instead of poses: once for all six, twice for lower and upper, or six times.",
        ),
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Draw so many points instead; ranges are then START:STOP.")
    ] = None,
    method: Annotated[str, typer.Option(help="How to draw them: sobol or uniform.")] = "sobol",
    seed: Annotated[int, typer.Option(min=0, help="Of the drawing.")] = 0,
    index: Annotated[
        list[str] | None,
        typer.Option(help=f"May be repeated; {', '.join(_DEFAULT)} if not given. One of {', '.join(INDICES)}."),
    ] = None,
    limits: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MIN MAX", help="Limits of all six legs, in --unit; the geometry's if not given."),
    ] = None,
    length: Annotated[
        float | None,
        typer.Option(help="Characteristic length of conditioning and isotropy, in --unit; the platform's radius."),
    ] = None,
    leg_force: Annotated[float, typer.Option(help="Largest force of a leg, for the payloads [N].")] = 1.0,
    leg_stiffness: Annotated[float, typer.Option(help="Stiffness of a leg, for the stiffness [N/m].")] = 1.0,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, such as tcp://head:8786.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes on this machine; one per processor if not given.")
    ] = None,
    chunk: Annotated[int, typer.Option(min=1, help="Points computed, stored and lost together.")] = CHUNK,
    status: Annotated[bool, typer.Option("--status", help="Only say how much is done.")] = False,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    json: AsJson = False,
) -> None:
    """Map indices over poses or leg lengths, in parallel, into a Zarr store.

    Example: spm-pin sweep --x -0.5:0.5:101 --y -0.5:0.5:101 --z 2.5 --xyx 30 35 -30 --out map.zarr

    Killed or interrupted it loses nothing: the same command goes on, and so does spm-pin sweep --out FOLDER alone.
    """
    if not status:
        domain = _domain(x, y, z, xyx, legs, samples, method, seed, unit)
        others: dict[str, Any] = {"scheduler": scheduler, "workers": workers}
        with _bar() as bar:
            task = bar.add_task(out.name, total=None)

            def progress(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total)

            try:
                if domain is None:
                    _refuse({"--samples": samples, "--index": index, "--limits": limits, "--length": length})
                    resume_sweep(out, progress=progress, **others)
                else:
                    chosen = _indices(index or _DEFAULT, length, unit, leg_force, leg_stiffness)
                    machine = _limited(read_geometry(geometry), limits, unit)
                    run(machine, domain, chosen, out, chunk=chunk, progress=progress, **others)
            except KeyboardInterrupt as interrupt:
                bar.stop()
                notes = getattr(interrupt, "__notes__", ["interrupted before it began"])
                stderr.print(*notes)
                stderr.print(f"go on with: spm-pin sweep --out {out}")
                raise typer.Exit(130) from None
    found = sweep_status(out)
    if json:
        typer.echo(to_json(dataclasses.asdict(found) | {"complete": found.complete, "store": str(out)}))
        return
    for line in _remarks(found, out):
        stdout.print(line, soft_wrap=True)


def _domain(
    x: str | None,
    y: str | None,
    z: str | None,
    xyx: tuple[str, str, str] | None,
    legs: list[str] | None,
    samples: int | None,
    method: str,
    seed: int,
    unit: LengthUnit,
) -> Domain | None:
    """Return what the options describe; None where there is none of them."""
    pose = {"--x": x, "--y": y, "--z": z, "--xyx": xyx}
    missing = [option for option, given in pose.items() if given is None]
    if legs and len(missing) < len(pose):
        raise ArgumentError("--legs", "poses or leg lengths, not both", "both")
    if not legs and len(missing) == len(pose):
        return None
    drawn: dict[str, Any] = {"method": _method(method), "seed": seed}
    scale = 1.0 / unit.per_metre
    if legs:
        if len(legs) not in (1, 2, 6):
            raise ArgumentError("--legs", "one range, two, or six", f"{len(legs)}")
        ranges = [_range("--legs", text, scale) for text in legs]
        six = ranges * 6 if len(ranges) == 1 else [r for r in ranges for _ in range(3)] if len(ranges) == 2 else ranges
        return leg_grid(six[:3], six[3:]) if samples is None else leg_sample(samples, six[:3], six[3:], **drawn)
    if x is None or y is None or z is None or xyx is None:
        raise ArgumentError(", ".join(missing), "a range or a number for every coordinate of a pose", "none")
    position = _range("--x", x, scale), _range("--y", y, scale), _range("--z", z, scale)
    angles = [_range("--xyx", text, np.pi / 180.0) for text in xyx]
    return pose_grid(*position, xyx=angles) if samples is None else pose_sample(samples, *position, xyx=angles, **drawn)


def _method(name: str) -> Method:
    if name == "sobol":
        return "sobol"
    if name == "uniform":
        return "uniform"
    raise ArgumentError("--method", "sobol or uniform", name)


def _range(option: str, text: str, scale: float) -> Range:
    """Read a number, START:STOP or START:STOP:COUNT; which of them is right is not known here."""
    parts = text.split(":")
    try:
        numbers = [float(part) for part in parts]
        counts = [int(part) for part in parts[2:]]
    except ValueError:
        raise ArgumentError(option, f"a number, START:STOP or {_RANGE}", repr(text)) from None
    scaled = [number * scale for number in numbers[:2]]
    return scaled[0] if len(numbers) == 1 else (*scaled, *counts)


def _limited(geometry: Geometry, limits: tuple[float, float] | None, unit: LengthUnit) -> Geometry:
    if limits is None:
        return geometry
    return dataclasses.replace(geometry, limits=LegLimits(*(end / unit.per_metre for end in limits)))


def _indices(
    names: tuple[str, ...] | list[str], length: float | None, unit: LengthUnit, force: float, stiff: float
) -> list[str | Index]:
    characteristic = None if length is None else length / unit.per_metre
    adapted = {
        "conditioning": lambda: conditioning(characteristic),
        "isotropy": lambda: isotropy(characteristic),
        "payload": lambda: payload(force),
        "payload_down": lambda: payload_down(force),
        "stiffness": lambda: stiffness(stiff),
    }
    return [adapted[name]() if name in adapted else name for name in names]


def _refuse(options: dict[str, Any]) -> None:
    given = [option for option, value in options.items() if value]
    if given:
        cause = "To go on with a sweep, give --out alone."
        raise ArgumentError("--x, --y, --z, --xyx or --legs", f"ranges beside {', '.join(given)}", "none", cause)


class _Rate(ProgressColumn):
    """Points per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.finished_speed or task.speed or 0.0:,.0f} points/s", style="progress.data.speed")


def _bar() -> Progress:
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        _Rate(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=stderr, transient=True)


def _remarks(status: SweepStatus, out: Path) -> list[str]:
    shape = ", ".join(f"{name} {length}" for name, length in status.shape.items())
    lines = [
        f"{status.points} points: {shape}",
        f"indices: {', '.join(status.indices)}",
        f"{status.done} of {status.total} chunks complete",
    ]
    if status.complete:
        lines.append(f'open with: xarray.open_zarr("{out}")')
    else:
        lines.append(f"go on with: spm-pin sweep --out {out}")
    return lines
