"""`spm-pin sweep`: metrics over many points; `design`: search for dimensions."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.spatial.transform import RigidTransform
from typer import Argument, Option

from spm_pin import sweeps
from spm_pin.cli import outputs
from spm_pin.cli.options import OF_MANIPULATOR, leg_numbers
from spm_pin.cli.outputs import Report, Table
from spm_pin.cli.units import MachineInUnits
from spm_pin.design import VARIABLES, DesignProblem, Front, Task, pareto_front
from spm_pin.display.figures import front_figure
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.machine import Manipulator, Stage
from spm_pin.machine.machine import unit_hint
from spm_pin.support.arguments import FloatArray
from spm_pin.support.motion_table import MotionTable
from spm_pin.sweeps.domains import Domain, coordinate_unit
from spm_pin.sweeps.runner import CHUNK

_DEFAULT = ("reachable", "branches", "conditioning")
_RANGE = "START:STOP:COUNT"
_LEGS = (
    "Readings of the legs, for RRS legs in degrees, instead of poses: once for all six, twice for lower and "
    "upper, or six times; for a stage once for all three, or three times."
)
_SAMPLES = "Number of random points instead of a lattice; ranges are then START:STOP."
_METRICS = f"May be repeated; default: {', '.join(_DEFAULT)}. One of {', '.join(sweeps.METRICS)}."
_LENGTH = "Characteristic length of conditioning and isotropy, in --unit; default: the platform's radius."
_COLUMNS = (
    "volume, footprint, assembled, certified, task_margin or task_effort with --task, or a metric with _mean or _low, "
    "such as payload_low"
)
_NONE = "no machine keeps the bounds"


def sweep(
    typed: MachineInUnits,
    out: Annotated[Path, Option(metavar="FOLDER", help="Store of the results, in Zarr v3.")],
    x: Annotated[
        str | None, Option(metavar=_RANGE, help="X of o in {B}, in --unit, or one number."), OF_MANIPULATOR
    ] = None,
    y: Annotated[str | None, Option(metavar=_RANGE, help="Y, likewise."), OF_MANIPULATOR] = None,
    z: Annotated[str | None, Option(metavar=_RANGE, help="Z, likewise."), OF_MANIPULATOR] = None,
    xyx: Annotated[
        tuple[str, str, str] | None,
        Option(metavar="ALPHA BETA LAMBDA", help="X-Y-X angles in degrees, each a range or one number."),
        OF_MANIPULATOR,
    ] = None,
    height: Annotated[
        str | None, Option(metavar=_RANGE, help="For a stage: height of its platform, in --unit.")
    ] = None,
    tilt: Annotated[str | None, Option(metavar=_RANGE, help="For a stage: its tilt in degrees.")] = None,
    azimuth: Annotated[
        str | None, Option(metavar=_RANGE, help="For a stage: direction in which it is lowest, in degrees.")
    ] = None,
    legs: Annotated[list[str] | None, Option(metavar=_RANGE, help=_LEGS)] = None,
    samples: Annotated[int | None, Option(min=1, help=_SAMPLES)] = None,
    seed: Annotated[int, Option(min=0, help="Seed of the random points.")] = 0,
    metric: Annotated[list[str] | None, Option(metavar="NAME", help=_METRICS)] = None,
    length: Annotated[float | None, Option(help=_LENGTH)] = None,
    leg_force: Annotated[float, Option(help="Largest force of a leg, for the payloads [N].")] = 1.0,
    leg_stiffness: Annotated[float, Option(help="Stiffness of a leg, for the stiffnesses [N/m].")] = 1.0,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="Dask scheduler: tcp://head:8786.")] = None,
    workers: Annotated[int | None, Option(min=1, help="Processes on this machine; default: one per processor.")] = None,
    chunk: Annotated[int, Option(min=1, help="Most points per chunk, the unit of work and of storage.")] = CHUNK,
    status: Annotated[bool, Option("--status", help="Only print how much is done.")] = False,
) -> Report:
    """Map metrics over poses, tilts of a stage, or leg lengths, in parallel, into a Zarr store.

    Example: spm-pin sweep --legs 1.1:1.5 --samples 100000 --out map.zarr

    Example: spm-pin stage sweep --machine stage.yaml --height 0.1:0.14:9 --tilt 0:30:7 --azimuth 0:360:13
    --out tilts.zarr

    If it is interrupted nothing is lost: the same command continues, and so does spm-pin sweep --out FOLDER alone.
    """
    tilts = {"--height": height, "--tilt": tilt, "--azimuth": azimuth}
    poses: dict[str, Any] = {"--x": x, "--y": y, "--z": z, "--xyx": xyx}
    drawn: dict[str, Any] = {} if samples is None else {"count": samples, "seed": seed}
    run: dict[str, Any] = {"scheduler": scheduler, "workers": workers}
    machine, unit = typed.machine, typed.unit
    others, own = (poses, tilts) if machine.is_stage else (tilts, poses)
    if strange := [option for option, value in others.items() if value is not None]:
        kind, other = ("a stage", "a pose") if machine.is_stage else ("a manipulator", "a stage")
        raise outputs.cannot_be_used(", ".join(strange), kind, f"They are coordinates of {other}")
    domain = None if status else _domain(own, legs, drawn, 1.0 / typed.scale, 1.0 / unit.per_metre)
    if domain is not None:
        require_extra("cluster")
        axes = list(zip(domain.axes, map(partial(coordinate_unit, machine), domain.axes), strict=True))
        ends = [axis.start if axis.is_fixed else axis.stop for axis, name in axes if name == "m"]
        longest = max(map(abs, ends), default=0.0)
        name = "--legs" if legs else "--height" if machine.is_stage else "--x, --y, --z"
        if hint := typed.hint(name, longest * unit.per_metre):
            outputs.note(hint, "yellow")
        parameters: dict[str, float] = {"push": leg_force, "leg_stiffness": leg_stiffness}
        if length is not None:
            parameters["length"] = length / unit.per_metre
        chosen = [_with_parameters(name, parameters) for name in metric or _DEFAULT]
        with _progress(out) as progress:
            sweeps.run_sweep(machine, domain, chosen, out, chunk=chunk, progress=progress, **run)
    elif not status:
        beside = {"--samples": samples, "--metric": metric, "--length": length}
        beside |= {f"--{name}": True for name in typed.given if name != "machine"}
        named = ", ".join(option for option, value in beside.items() if value)
        if named:
            cause = "To continue a sweep, give --out alone"
            raise ArgumentError(", ".join((*own, "--legs")), f"ranges beside {named}", "none", cause)
        require_extra("cluster")
        with _progress(out) as progress:
            sweeps.resume_sweep(out, progress=progress, **run)
    stored = sweeps.sweep_status(out)
    content = dataclasses.asdict(stored) | {"complete": stored.complete, "store": str(out)}
    shape = ", ".join(f"{name} {size}" for name, size in stored.shape.items())
    lines = [f"{stored.points} points: {shape}", f"metrics: {', '.join(stored.metrics)}"]
    lines.append(f"{stored.done} of {stored.total} chunks complete")
    lines.append(f'open with: xarray.open_zarr("{out}")' if stored.complete else _go_on(out, stored.own_metrics))
    return Report(content, lines)


def _domain(
    poses: dict[str, Any], legs: list[str] | None, drawn: dict[str, Any], metres: FloatArray, scale: float
) -> Domain | None:
    """Return the domain of `poses` or `legs`, if any; readings are multiplied by `metres`, positions by `scale`."""
    missing = [option for option, value in poses.items() if value is None]
    if legs and len(missing) < len(poses):
        raise ArgumentError("--legs", "poses or leg lengths, not both", "both")
    if legs:
        count = len(metres)
        if len(legs) not in {1, count // 3, count}:
            expected = "one range, two, or six" if count == 6 else "one range, or three"
            raise ArgumentError("--legs", expected, f"{len(legs)}")
        texts = [text for text in legs for _ in range(count // len(legs))]
        ranges = [_range("--legs", text, factor) for text, factor in zip(texts, metres.tolist(), strict=True)]
        stages: dict[str, Any] = {"lower": ranges[:3], "upper": ranges[3:] or None}
        return (sweeps.leg_sample if drawn else sweeps.leg_grid)(**stages, **drawn)
    if len(missing) == len(poses):
        return None
    if missing:
        raise ArgumentError(", ".join(missing), "a range or a number for every coordinate", "none")
    if "--tilt" in poses:
        degrees = np.pi / 180.0
        factors = zip(("height", "tilt", "azimuth"), (scale, degrees, degrees), strict=True)
        tilts: dict[str, Any] = {name: _range(f"--{name}", poses[f"--{name}"], factor) for name, factor in factors}
        return (sweeps.tilt_sample if drawn else sweeps.tilt_grid)(**drawn, **tilts)
    pose: dict[str, Any] = {axis: _range(f"--{axis}", poses[f"--{axis}"], scale) for axis in "xyz"}
    pose["xyx"] = [_range("--xyx", text, np.pi / 180.0) for text in poses["--xyx"]]
    return (sweeps.pose_sample if drawn else sweeps.pose_grid)(**drawn, **pose)


def _range(option: str, text: str, scale: float) -> float | tuple[float, ...]:
    """Read a number, START:STOP or START:STOP:COUNT; the caller checks which of them is allowed."""
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


def _go_on(out: Path, own_metrics: tuple[str, ...] = ()) -> str:
    if own_metrics:
        names = ", ".join(own_metrics)
        return f"go on in Python: run_sweep with the same arguments, and {names} of your own, continues {out}"
    return f"go on with: spm-pin sweep --out {out}"


@contextlib.contextmanager
def _progress(out: Path) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar; after Ctrl-C, print what is kept and how to continue, and exit."""
    try:
        with outputs.progress_bar() as bar:
            yield lambda done, total: bar(out.name, done, total)
    except KeyboardInterrupt as interrupt:
        for text in (*getattr(interrupt, "__notes__", ["interrupted before it began"]), _go_on(out)):
            outputs.note(text)
        raise typer.Exit(130) from None


def design(
    typed: MachineInUnits,
    store: Annotated[Path, Argument(metavar="STORE", help="JSON file of the search; one that exists is continued.")],
    free: Annotated[
        list[str],
        Option(
            metavar="NAME:LOW:HIGH",
            help=f"A free dimension in metres, angles in radians: {', '.join(VARIABLES)}. May be repeated.",
        ),
    ],
    maximise: Annotated[list[str] | None, Option(metavar="COLUMN", help=f"Column to maximise: {_COLUMNS}.")] = None,
    minimise: Annotated[list[str] | None, Option(metavar="COLUMN", help="Column to minimise.")] = None,
    at_least: Annotated[
        list[str] | None, Option(metavar="COLUMN:VALUE", help="Lower bound, such as certified:1. May be repeated.")
    ] = None,
    at_most: Annotated[
        list[str] | None,
        Option(metavar="COLUMN:VALUE", help="Upper bound, such as footprint:1.2. May be repeated."),
    ] = None,
    task: Annotated[
        Path | None,
        Option(metavar="CSV", help="Poses to be reached, columns x y z \\[m], qx qy qz qw: task_margin, task_effort."),
        OF_MANIPULATOR,
    ] = None,
    wrench: Annotated[
        str | None,
        Option(metavar="F,M", help="Force [N] and moment [N m] at o in {B} for task_effort; default: 0,0,-1,0,0,0."),
        OF_MANIPULATOR,
    ] = None,
    population: Annotated[int, Option(min=2, help="Number of machines in a generation.")] = 40,
    generations: Annotated[int, Option(min=2, help="Number of generations.")] = 25,
    states: Annotated[int, Option(min=2, help="Number of states at which each machine is evaluated.")] = 2000,
    seed: Annotated[int, Option(min=0, help="Seed of the search and of the states.")] = 0,
    workers: Annotated[
        int | None,
        Option(min=1, help="Processes on this machine; default 1. More are faster if a generation takes long."),
    ] = None,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="Dask scheduler: tcp://head:8786.")] = None,
    choose: Annotated[int | None, Option(metavar="ROW", help="Row of the front to write to --out, from 0.")] = None,
    out: Annotated[Path | None, outputs.file_option("YAML file of the chosen machine.", (".yaml", ".yml"))] = None,
    figure: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) of the front to write.")] = None,
) -> Report:
    """Search for dimensions that no others beat in all aims: a Pareto front.

    Example: spm-pin design front.json --free base_radius:0.4:0.8 --free platform_radius:0.25:0.6
    --free middle_side:0.5:1 --maximise payload_low --maximise volume --at-least certified:1 --at-most footprint:1.2

    Values that are not free are those of --machine, with which the front is compared. After Ctrl-C the same command
    continues; after its end, it shows the front again. Exit code 3 if no machine keeps the bounds. It needs the
    extra "design".
    """
    require_extra("design")
    if (choose is None) != (out is None):
        raise ArgumentError("--choose and --out", "both or neither", "only one of them")
    if choose is not None and choose < 0:
        raise ArgumentError("--choose", "a row of the front, from 0", choose)
    ends = _by_name("--free", [_numbers("--free", text, 2) for text in free])
    least = _by_name("--at-least", [_numbers("--at-least", text, 1) for text in at_least or []])
    most = _by_name("--at-most", [_numbers("--at-most", text, 1) for text in at_most or []])
    aims = [(name, "max") for name in maximise or []] + [(name, "min") for name in minimise or []]
    if wrench is not None and task is None:
        raise ArgumentError("--wrench", "poses at which it acts", "no --task CSV")
    machine = typed.machine
    functions = {} if task is None else _task_functions(task, wrench, machine)
    problem = DesignProblem(
        machine,
        {name: (low, high) for name, (low, high) in ends.items()},
        _by_name("--maximise, --minimise", aims),
        at_least={name: value for name, (value,) in least.items()},
        at_most={name: value for name, (value,) in most.items()},
        functions=functions,
    )
    search = {"population": population, "generations": generations, "states": states, "seed": seed}
    with outputs.progress_bar() as progress:
        front = pareto_front(problem, store, **search, scheduler=scheduler, workers=workers, progress=progress)
    if choose is not None and out is not None:
        if choose >= len(front.designs):
            if not len(front.designs):
                raise ArgumentError("--choose", "a front with rows", choose, _NONE.capitalize())
            raise ArgumentError("--choose", f"a row from 0 to {len(front.designs) - 1}", choose)
        front.designs.machines[choose].to_yaml(out)
        outputs.note(f"wrote {out}")
    outputs.write_figure(figure, front_figure, front)
    if not len(front.designs):
        outputs.note(_NONE)
    machines = [machine.as_data() for machine in front.designs.machines]
    content = {"machines": machines, "columns": dict(front.designs.columns), "better": front.better}
    return Report(content, _front_parts(front), 0 if len(front.designs) else 3)


def _task_functions(path: Path, wrench: str | None, machine: Manipulator | Stage) -> dict[str, Any]:
    """Return the columns of a task, by name, as functions of a machine."""
    if machine.is_stage:
        cause = "Tasks of tilts are given in Python: spm_pin.design.Task.of_tilts"
        raise ArgumentError("--task", "poses of a manipulator", "a stage by --machine", cause)
    poses = MotionTable(path).poses()
    if not isinstance(poses, RigidTransform):
        raise ArgumentError(
            "--task", "poses, columns x y z qx qy qz qw", "positions alone" if poses is not None else "none"
        )
    if hint := unit_hint(machine, poses.translation):
        received = f"values up to {np.abs(poses.translation).max():g}"
        raise ArgumentError("--task", "positions in metres, in proportion to the machine", received, hint)
    task = Task(poses, leg_numbers(wrench or "0,0,-1,0,0,0", "--wrench", 6))
    return {"task_margin": task.margin, "task_effort": task.effort}


def _numbers(option: str, text: str, count: int) -> tuple[str, list[float]]:
    """Read a name and numbers, separated by colons."""
    name, *numbers = text.split(":")
    try:
        values = [float(number) for number in numbers]
    except ValueError:
        values = []
    if len(values) != count:
        raise ArgumentError(option, f"a name and {count} number{'s' * (count > 1)}, with colons between", repr(text))
    return name, values


def _by_name(option: str, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if repeated is not None:
        raise ArgumentError(option, "names without repetition", f"{repeated} twice")
    return dict(pairs)


def _front_parts(front: Front) -> list[Table | str]:
    designs, problem = front.designs, front.problem
    rows: list[int | None] = [None, *range(len(designs))]

    def size(k: int, row: int | None) -> str:
        return f"{problem.values(problem.machine if row is None else designs.machines[row])[k]:.4f}"

    def value(name: str, row: int | None) -> str:
        part = front.reference if row is None else designs
        return outputs.significant(float(part.columns[name][row or 0]), digits=4)

    def title(row: int | None) -> str:
        return "began with" if row is None else f"{row}{' better' if front.better[row] else ''}"

    columns: dict[str, Callable[[int | None], str]] = {"row": title}
    columns |= {f"{name} [{problem.unit(name)}]": partial(size, k) for k, name in enumerate(problem.free)}
    for name in problem.columns:
        unit = problem.column_unit(name)
        columns[name if unit == "1" else f"{name} [{unit}]"] = partial(value, name)
    better = int(front.better.sum())
    text = f"{len(front.evaluated)} machines evaluated, {len(designs)} on the front, {better} of them at least as good"
    if "volume" in problem.columns and not {"certified", "assembled"} & problem.at_least.keys():
        outputs.note("volume is too small if there is a forward singularity within the limits: --at-least certified:1")
    table = Table("Machines that no other beats in all aims", columns, rows)
    return [table, f"{text} as the machine at the start in all aims"]
