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
from spm_pin.cli.options import OF_MANIPULATOR, MachineFile, Picture, Scheduler, Seed, Workers, leg_numbers
from spm_pin.cli.outputs import Report, Table
from spm_pin.cli.units import MachineInUnits
from spm_pin.design import VARIABLES, DesignProblem, Front, Task, pareto_front
from spm_pin.display.figures import front_figure
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.machine import Manipulator, Stage
from spm_pin.machine.machine import unit_hint
from spm_pin.support.motion_table import MotionTable
from spm_pin.sweeps.domains import Domain, coordinate_unit
from spm_pin.sweeps.runner import CHUNK

_DEFAULT = ("reachable", "branches", "conditioning")
_RANGE = "START:STOP:COUNT"
_METRICS = f"Repeatable; default: {', '.join(_DEFAULT)}. One of {', '.join(sweeps.METRICS)}."
_COLUMNS = (
    "volume, footprint, assembled, certified, task_margin or task_effort with --task, or a metric with _mean or _low, "
    "such as payload_low"
)
_NONE = "no machine keeps the bounds"
_TILT = "height", "tilt", "azimuth"


def _axis(help_text: str) -> Any:
    return Option(metavar=_RANGE, help=help_text)


def sweep(
    typed: MachineInUnits,
    store: Annotated[Path, Option("--out", metavar="FOLDER", help="Store of the results, in Zarr v3.")],
    x: Annotated[str | None, _axis("X of o in {B}, in --unit, or one number."), OF_MANIPULATOR] = None,
    y: Annotated[str | None, _axis("Y, likewise."), OF_MANIPULATOR] = None,
    z: Annotated[str | None, _axis("Z, likewise."), OF_MANIPULATOR] = None,
    xyx: Annotated[
        tuple[str, str, str] | None,
        Option(metavar="ALPHA BETA LAMBDA", help="X-Y-X angles in degrees, each a range or one number."),
        OF_MANIPULATOR,
    ] = None,
    height: Annotated[str | None, _axis("For a stage: height of its platform, in --unit.")] = None,
    tilt: Annotated[str | None, _axis("For a stage: its tilt in degrees.")] = None,
    azimuth: Annotated[str | None, _axis("For a stage: direction in which it is lowest, in degrees.")] = None,
    legs: Annotated[
        list[str] | None, _axis("Readings instead of poses: once for all legs, twice for the stages, or one each.")
    ] = None,
    samples: Annotated[int | None, Option(min=1, help="Random points, not a lattice; ranges are START:STOP.")] = None,
    seed: Seed = 0,
    metrics: Annotated[list[str] | None, Option("--metric", metavar="NAME", help=_METRICS)] = None,
    length: Annotated[
        float | None, Option(help="Length of conditioning, isotropy; default: platform's radius.")
    ] = None,
    push: Annotated[float, Option("--leg-force", help="Largest force of a leg, for the payloads [N].")] = 1.0,
    leg_stiffness: Annotated[float, Option(help="Stiffness of a leg, for the stiffnesses [N/m].")] = 1.0,
    scheduler: Scheduler = None,
    workers: Workers = None,
    chunk: Annotated[int, Option(min=1, help="Most points per chunk, the unit of work and of storage.")] = CHUNK,
    status: Annotated[bool, Option("--status", help="Only print how much is done.")] = False,
) -> Report:
    """Map metrics over poses, tilts of a stage, or leg lengths, in parallel, into a Zarr store.

    Example: spm-pin sweep --legs 1.1:1.5 --samples 100000 --out map.zarr

    Example: spm-pin stage sweep --machine stage.yaml --height 0.1:0.14:9 --tilt 0:30:7 --azimuth 0:360:13
    --out tilts.zarr

    If it is interrupted nothing is lost: the same command continues, and so does spm-pin sweep --out FOLDER alone.
    """
    poses: dict[str, Any] = {"x": x, "y": y, "z": z, "xyx": xyx, "height": height, "tilt": tilt, "azimuth": azimuth}
    machine, unit = typed.machine, typed.unit
    places = {name: value for name, value in poses.items() if (name in _TILT) == machine.is_stage}
    if strange := [f"--{name}" for name, value in poses.items() if value is not None and name not in places]:
        raise outputs.cannot_be_used(", ".join(strange), "a stage" if machine.is_stage else "a manipulator")
    drawn: dict[str, Any] = {} if samples is None else {"count": samples, "seed": seed}
    run: dict[str, Any] = {"scheduler": scheduler, "workers": workers}
    domain = None if status else _domain(places, legs, drawn, typed)
    if domain is not None:
        require_extra("cluster")
        axes = [axis for axis in domain.axes if coordinate_unit(machine, axis) == "m"]
        longest = max((abs(axis.start if axis.is_fixed else axis.stop) for axis in axes), default=0.0)
        name = "--legs" if legs else "--height" if machine.is_stage else "--x, --y, --z"
        if hint := typed.hint(name, longest * unit.per_metre):
            outputs.note(hint, "yellow")
        parameters: dict[str, float] = {"push": push, "leg_stiffness": leg_stiffness}
        if length is not None:
            parameters["length"] = length / unit.per_metre
        chosen = [_with_parameters(name, parameters) for name in metrics or _DEFAULT]
        with _progress(store) as progress:
            sweeps.run_sweep(machine, domain, chosen, store, chunk=chunk, progress=progress, **run)
    elif not status:
        beside = {"--samples": samples, "--metric": metrics, "--length": length}
        beside |= {f"--{name}": True for name in typed.given if name != "machine"}
        if named := ", ".join(option for option, value in beside.items() if value):
            coordinates = ", ".join(f"--{name}" for name in (*places, "legs"))
            raise ArgumentError(coordinates, f"ranges beside {named}", "none", "To continue a sweep, give --out alone")
        require_extra("cluster")
        with _progress(store) as progress:
            sweeps.resume_sweep(store, progress=progress, **run)
    stored = sweeps.sweep_status(store)
    content = dataclasses.asdict(stored) | {"complete": stored.complete, "store": str(store)}
    shape = ", ".join(f"{name} {size}" for name, size in stored.shape.items())
    lines = [f"{stored.points} points: {shape}", f"metrics: {', '.join(stored.metrics)}"]
    lines.append(f"{stored.done} of {stored.total} chunks complete")
    lines.append(f'open with: xarray.open_zarr("{store}")' if stored.complete else _go_on(store, stored.own_metrics))
    return Report(content, lines)


def _domain(
    places: dict[str, Any], legs: list[str] | None, drawn: dict[str, Any], typed: MachineInUnits
) -> Domain | None:
    """Return the domain of coordinates of poses or `legs`, if any are given."""
    given = {name: value for name, value in places.items() if value is not None}
    if legs:
        if given:
            raise ArgumentError("--legs", "poses or leg lengths, not both", "both")
        count = len(typed.names)
        if len(legs) not in {1, count // 3, count}:
            expected = "one range, two, or six" if count == 6 else "one range, or three"
            raise ArgumentError("--legs", expected, f"{len(legs)}")
        texts = [text for text in legs for _ in range(count // len(legs))]
        ranges = [_range("--legs", text, scale) for text, scale in zip(texts, typed.scale.tolist(), strict=True)]
        stages: dict[str, Any] = {"lower": ranges[:3], "upper": ranges[3:] or None}
        return (sweeps.leg_sample if drawn else sweeps.leg_grid)(**stages, **drawn)
    if not given:
        return None
    if missing := ", ".join(f"--{name}" for name in places if name not in given):
        raise ArgumentError(missing, "a range or a number for every coordinate", "none")
    degrees = 180.0 / np.pi
    scales = dict.fromkeys(("xyx", "tilt", "azimuth"), degrees)
    read: dict[str, Any] = {
        name: [_range(f"--{name}", text, degrees) for text in value]
        if isinstance(value, tuple)
        else _range(f"--{name}", value, scales.get(name, typed.unit.per_metre))
        for name, value in given.items()
    }
    if typed.machine.is_stage:
        return (sweeps.tilt_sample if drawn else sweeps.tilt_grid)(**drawn, **read)
    return (sweeps.pose_sample if drawn else sweeps.pose_grid)(**drawn, **read)


def _range(option: str, text: str, scale: float) -> float | tuple[float, ...]:
    """Read a number, START:STOP or START:STOP:COUNT; numbers are divided by `scale`."""
    try:
        numbers = [float(part) / scale for part in text.split(":")[:2]]
        counts = [int(part) for part in text.split(":")[2:]]
    except ValueError:
        raise ArgumentError(option, f"a number, START:STOP or {_RANGE}", repr(text)) from None
    return numbers[0] if len(numbers) == 1 else (*numbers, *counts)


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


def _bound(help_text: str) -> Any:
    return Option(metavar="COLUMN:VALUE", help=help_text)


def design(
    typed: MachineInUnits,
    store: Annotated[Path, Argument(metavar="STORE", help="JSON file of the search; one that exists is continued.")],
    free: Annotated[
        list[str],
        Option(metavar="NAME:LOW:HIGH", help=f"Free dimension \\[m, rad]: {', '.join(VARIABLES)}. Repeatable."),
    ],
    maximise: Annotated[list[str] | None, Option(metavar="COLUMN", help=f"Column to maximise: {_COLUMNS}.")] = None,
    minimise: Annotated[list[str] | None, Option(metavar="COLUMN", help="Column to minimise.")] = None,
    at_least: Annotated[list[str] | None, _bound("Lower bound, such as certified:1. Repeatable.")] = None,
    at_most: Annotated[list[str] | None, _bound("Upper bound, such as footprint:1.2. Repeatable.")] = None,
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
    seed: Seed = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    choose: Annotated[int | None, Option(metavar="ROW", help="Row of the front to write to --out, from 0.")] = None,
    out: MachineFile = None,
    figure: Picture = None,
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
    if wrench is not None and task is None:
        raise ArgumentError("--wrench", "poses at which it acts", "no --task CSV")
    aims = [(name, "max") for name in maximise or []] + [(name, "min") for name in minimise or []]
    problem = DesignProblem(
        typed.machine,
        _by_name("--free", [_numbers("--free", text, 2) for text in free]),
        _by_name("--maximise, --minimise", aims),
        at_least=_by_name("--at-least", [_numbers("--at-least", text, 1) for text in at_least or []]),
        at_most=_by_name("--at-most", [_numbers("--at-most", text, 1) for text in at_most or []]),
        functions={} if task is None else _task_functions(task, wrench, typed.machine),
    )
    search = {"population": population, "generations": generations, "states": states, "seed": seed}
    with outputs.progress_bar() as progress:
        front = pareto_front(problem, store, **search, scheduler=scheduler, workers=workers, progress=progress)
    if choose is not None and out is not None:
        if not 0 <= choose < len(front.designs):
            expected = f"a row from 0 to {len(front.designs) - 1}" if len(front.designs) else "a front with rows"
            raise ArgumentError("--choose", expected, choose)
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


def _numbers(option: str, text: str, count: int) -> tuple[str, Any]:
    """Read a name and a number, or two as a pair, with colons between."""
    name, *numbers = text.split(":")
    with contextlib.suppress(ValueError):
        values = tuple(float(number) for number in numbers)
        if len(values) == count:
            return name, values if count > 1 else values[0]
    raise ArgumentError(option, f"a name and {count} number{'s' * (count > 1)}, with colons between", repr(text))


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
