"""`spm-pin sweep`: metrics over any number of poses or leg lengths, resumed wherever it stopped."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Option

from spm_pin import sweeps
from spm_pin.cli.options import AsJson, GeometryFile, LengthUnit, Limits, Unit, note_unit, read_geometry
from spm_pin.cli.outputs import name_options, note, print_lines, progress_bar, write_json
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism import LEGS, LegLimits
from spm_pin.sweeps.domains import Domain
from spm_pin.sweeps.runner import CHUNK

_NAMES = {"store": "--out", "count": "--samples", "metrics": "--metric", "push": "--leg-force"}
_NAMES |= {"leg_stiffness": "--leg-stiffness", **dict.fromkeys(LEGS, "--legs")}
_NAMES |= dict.fromkeys(("alpha", "beta", "lambda_"), "--xyx")
_DEFAULT = ("reachable", "branches", "conditioning")
_RANGE = "START:STOP:COUNT"
_LEGS = (
    "Leg lengths as encoders show them, instead of poses: once for all six, twice for lower and upper, or six times."
)
_SAMPLES = "Draw so many points instead; ranges are then START:STOP."
_METRICS = f"May be repeated; {', '.join(_DEFAULT)} if not given. One of {', '.join(sweeps.METRICS)}."
_LENGTH = "Characteristic length of conditioning and isotropy, in --unit; the platform's radius."


@name_options(**_NAMES)
def sweep(
    out: Annotated[Path, Option(metavar="FOLDER", help="Store of the results, in Zarr v3.")],
    x: Annotated[str | None, Option(metavar=_RANGE, help="X of o in {B}, in --unit, or one number.")] = None,
    y: Annotated[str | None, Option(metavar=_RANGE, help="Y, likewise.")] = None,
    z: Annotated[str | None, Option(metavar=_RANGE, help="Z, likewise.")] = None,
    xyx: Annotated[
        tuple[str, str, str] | None,
        Option(metavar="ALPHA BETA LAMBDA", help="X-Y-X angles in degrees, each a range or one number."),
    ] = None,
    legs: Annotated[list[str] | None, Option(metavar=_RANGE, help=_LEGS)] = None,
    samples: Annotated[int | None, Option(min=1, help=_SAMPLES)] = None,
    seed: Annotated[int, Option(min=0, help="Seed of the drawing.")] = 0,
    metric: Annotated[list[str] | None, Option(metavar="NAME", help=_METRICS)] = None,
    limits: Limits = None,
    length: Annotated[float | None, Option(help=_LENGTH)] = None,
    leg_force: Annotated[float, Option(help="Largest force of a leg, for the payloads [N].")] = 1.0,
    leg_stiffness: Annotated[float, Option(help="Stiffness of a leg, for the stiffnesses [N/m].")] = 1.0,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="Dask scheduler: tcp://head:8786.")] = None,
    workers: Annotated[int | None, Option(min=1, help="Processes on this machine; one per processor.")] = None,
    chunk: Annotated[int, Option(min=1, help="Most points per chunk, the unit of work and of storage.")] = CHUNK,
    status: Annotated[bool, Option("--status", help="Only print how much is done.")] = False,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    json: AsJson = False,
) -> None:
    """Map metrics over poses or leg lengths, in parallel, into a Zarr store.

    Example: spm-pin sweep --legs 1.1:1.5 --samples 100000 --out map.zarr

    Killed or interrupted it loses nothing: the same command goes on, and so does spm-pin sweep --out FOLDER alone.
    """
    poses = {"--x": x, "--y": y, "--z": z, "--xyx": xyx}
    drawn: dict[str, Any] = {} if samples is None else {"count": samples, "seed": seed}
    domain = None if status else _domain(poses, legs, drawn, 1.0 / unit.per_metre)
    if status:
        pass
    elif domain is None:
        options = {"--samples": samples, "--metric": metric, "--limits": limits, "--length": length}
        beside = [option for option, value in options.items() if value]
        if beside:
            cause = "To go on with a sweep, give --out alone."
            raise ArgumentError(", ".join((*poses, "--legs")), f"ranges beside {', '.join(beside)}", "none", cause)
        require_extra("cluster")
        with _progress(out) as progress:
            sweeps.resume_sweep(out, scheduler=scheduler, workers=workers, progress=progress)
    else:
        require_extra("cluster")
        machine = read_geometry(geometry)
        longest = max(abs(end) for axis in domain.axes if axis.unit == "m" for end in (axis.start, axis.stop))
        note_unit("--legs" if legs else "--x, --y, --z", longest * unit.per_metre, unit, machine)
        if limits is not None:
            note_unit("--limits", limits[1], unit, machine)
            machine = dataclasses.replace(machine, limits=LegLimits(*(end / unit.per_metre for end in limits)))
        parameters: dict[str, float] = {"push": leg_force, "leg_stiffness": leg_stiffness}
        if length is not None:
            parameters["length"] = length / unit.per_metre
        chosen = [_with_parameters(name, parameters) for name in metric or _DEFAULT]
        with _progress(out) as progress:
            sweeps.run_sweep(
                machine, domain, chosen, out, chunk=chunk, scheduler=scheduler, workers=workers, progress=progress
            )
    stored = sweeps.sweep_status(out)
    if json:
        write_json(dataclasses.asdict(stored) | {"complete": stored.complete, "store": str(out)})
        return
    shape = ", ".join(f"{name} {size}" for name, size in stored.shape.items())
    lines = [f"{stored.points} points: {shape}", f"metrics: {', '.join(stored.metrics)}"]
    lines.append(f"{stored.done} of {stored.total} chunks complete")
    print_lines([*lines, f'open with: xarray.open_zarr("{out}")' if stored.complete else _go_on(out)])


def _domain(poses: dict[str, Any], legs: list[str] | None, drawn: dict[str, Any], scale: float) -> Domain | None:
    """Return the domain that the options describe; None where there is none of them."""
    missing = [option for option, value in poses.items() if value is None]
    if legs and len(missing) < len(poses):
        raise ArgumentError("--legs", "poses or leg lengths, not both", "both")
    if legs:
        if len(legs) not in (1, 2, 6):
            raise ArgumentError("--legs", "one range, two, or six", f"{len(legs)}")
        ranges = [_range("--legs", text, scale) for text in legs]
        six = [interval for interval in ranges for _ in range(6 // len(ranges))]
        return (sweeps.leg_sample if drawn else sweeps.leg_grid)(lower=six[:3], upper=six[3:], **drawn)
    if len(missing) == len(poses):
        return None
    if missing:
        raise ArgumentError(", ".join(missing), "a range or a number for every coordinate of a pose", "none")
    pose: dict[str, Any] = {axis: _range(f"--{axis}", poses[f"--{axis}"], scale) for axis in "xyz"}
    pose["xyx"] = [_range("--xyx", text, np.pi / 180.0) for text in poses["--xyx"]]
    return (sweeps.pose_sample if drawn else sweeps.pose_grid)(**drawn, **pose)


def _range(option: str, text: str, scale: float) -> float | tuple[float, ...]:
    """Read a number, START:STOP or START:STOP:COUNT; which of them is right is not known here."""
    parts = text.split(":")
    try:
        numbers = [float(part) for part in parts]
        counts = [int(part) for part in parts[2:]]
    except ValueError:
        raise ArgumentError(option, f"a number, START:STOP or {_RANGE}", repr(text)) from None
    scaled = [number * scale for number in numbers[:2]]
    return scaled[0] if len(numbers) == 1 else (*scaled, *counts)


def _with_parameters(name: str, parameters: dict[str, float]) -> str | sweeps.Metric:
    metric = sweeps.METRICS.get(name)
    if metric is None:
        return name
    return metric(**{key: value for key, value in parameters.items() if key in metric.parameters})


def _go_on(out: Path) -> str:
    return f"go on with: spm-pin sweep --out {out}"


@contextlib.contextmanager
def _progress(out: Path) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar; after Ctrl-C, print what is kept and how to go on, and exit."""
    try:
        with progress_bar() as bar:
            yield lambda done, total: bar(out.name, done, total)
    except KeyboardInterrupt as interrupt:
        for text in (*getattr(interrupt, "__notes__", ["interrupted before it began"]), _go_on(out)):
            note(text)
        raise typer.Exit(130) from None
