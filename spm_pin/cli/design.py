"""`spm-pin design`: dimensions searched for several aims at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from spm_pin.cli import options, outputs
from spm_pin.design import VARIABLES, DesignProblem, Front, pareto_front
from spm_pin.design.evaluation import leg_ranges
from spm_pin.display.figures import front_figure
from spm_pin.errors import ArgumentError, require_extra

_COLUMNS = "volume, footprint, assembled, certified, or a metric with _mean or _low, such as payload_low"
_NONE = "no machine keeps the bounds"


@outputs.name_options(store="STORE", free="--free", aims="--maximise, --minimise")
def design(
    store: Annotated[Path, Argument(metavar="STORE", help="JSON file of the search; one that exists is continued.")],
    free: Annotated[
        list[str],
        Option(metavar="NAME:LOW:HIGH", help=f"A free dimension in metres: {', '.join(VARIABLES)}. May be repeated."),
    ],
    maximise: Annotated[list[str] | None, Option(metavar="COLUMN", help=f"To be large: {_COLUMNS}.")] = None,
    minimise: Annotated[list[str] | None, Option(metavar="COLUMN", help="To be small, likewise.")] = None,
    at_least: Annotated[
        list[str] | None, Option(metavar="COLUMN:VALUE", help="A least value, such as certified:1. May be repeated.")
    ] = None,
    at_most: Annotated[
        list[str] | None,
        Option(metavar="COLUMN:VALUE", help="A largest value, such as footprint:1.2. May be repeated."),
    ] = None,
    population: Annotated[int, Option(min=2, help="Machines of a generation.")] = 40,
    generations: Annotated[int, Option(min=2, help="Number of generations.")] = 25,
    states: Annotated[int, Option(min=2, help="States at which each machine is evaluated.")] = 2000,
    seed: Annotated[int, Option(min=0, help="Seed of the search and of the states.")] = 0,
    workers: Annotated[
        int | None,
        Option(min=1, help="Processes on this machine, by default 1. More pay where a generation takes long."),
    ] = None,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="Dask scheduler: tcp://head:8786.")] = None,
    choose: Annotated[int | None, Option(metavar="ROW", help="Row of the front to write to --out, from 0.")] = None,
    out: Annotated[Path | None, outputs.file_option("YAML file of that machine to write.", (".yaml", ".yml"))] = None,
    figure: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) of the front to write.")] = None,
    style: outputs.PictureStyle = None,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Search for dimensions that no others beat in all aims: a Pareto front.

    Example: spm-pin design front.json --free base_radius:0.4:0.8 --free platform_radius:0.25:0.6
    --free middle_side:0.5:1 --maximise payload_low --maximise volume --at-least certified:1 --at-most footprint:1.2

    What is not free is as in --geometry, which the front is compared with. Stopped by Ctrl-C, the same command goes on
    where it was; ended, it shows the front again at once. Exit code 3 if no machine keeps the bounds. It needs the
    extra "design".
    """
    require_extra("design")
    if (choose is None) != (out is None):
        raise ArgumentError("--choose and --out", "both or neither", "one of them")
    if choose is not None and choose < 0:
        raise ArgumentError("--choose", "a row of the front, from 0", choose)
    parts = [_numbers("--free", text, 2) for text in free]
    least = [_numbers("--at-least", text, 1) for text in at_least or []]
    most = [_numbers("--at-most", text, 1) for text in at_most or []]
    for option, numbers in (("--free", parts), ("--at-least", least), ("--at-most", most)):
        _refuse_repeated(option, [name for name, _ in numbers])
    _refuse_repeated("--maximise, --minimise", [*(maximise or []), *(minimise or [])])
    problem = DesignProblem(
        options.read_geometry(geometry),
        {name: (ends[0], ends[1]) for name, ends in parts},
        dict.fromkeys(maximise or [], "max") | dict.fromkeys(minimise or [], "min"),
        *({name: value[0] for name, value in bounds} for bounds in (least, most)),
    )
    search = {"population": population, "generations": generations, "states": states, "seed": seed}
    with outputs.progress_bar() as progress:
        front = pareto_front(problem, store, **search, scheduler=scheduler, workers=workers, progress=progress)
    if choose is not None and out is not None:
        if choose >= len(front.designs):
            rows = f"a row from 0 to {len(front.designs) - 1}" if len(front.designs) else "a front that has rows"
            raise ArgumentError("--choose", rows, choose, "" if len(front.designs) else _NONE.capitalize())
        front.designs.geometries[choose].to_yaml(out)
        outputs.note(f"wrote {out}")
    outputs.write_figure(figure, style, front_figure, front)
    if json:
        content = {name: front.designs.columns[name] for name in front.designs.columns}
        machines = [machine.as_data() for machine in front.designs.geometries]
        outputs.write_json({"machines": machines, "columns": content, "better": front.better})
    else:
        _report(front)
    if not len(front.designs):
        outputs.note(_NONE)
        raise Exit(3)


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


def _refuse_repeated(option: str, names: list[str]) -> None:
    repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if repeated is not None:
        raise ArgumentError(option, "each name once", f"{repeated} twice")


def _report(front: Front) -> None:
    designs, problem = front.designs, front.problem
    rows: list[int | None] = [None, *range(len(designs))]

    def size(name: str, row: int | None) -> str:
        machine = problem.geometry if row is None else designs.geometries[row]
        ends = dict(zip(("minimum", "stroke"), leg_ranges(machine), strict=True))
        stage, _, end = name.rpartition("_")
        leg = 3 if stage == "upper" else 0
        return f"{ends[end][leg] if end in ends else getattr(machine, name):.4f}"

    def value(name: str, row: int | None) -> str:
        part = front.reference if row is None else designs
        return outputs.significant(float(part.columns[name][row or 0]), digits=4)

    def title(row: int | None) -> str:
        return "began with" if row is None else f"{row}{' better' if front.better[row] else ''}"

    columns: dict[str, Callable[[int | None], str]] = {"row": title}
    columns |= {f"{name} [m]": partial(size, name) for name in problem.free}
    columns |= {name: partial(value, name) for name in problem.columns}
    outputs.print_table("Machines that no other beats in all aims", columns, rows)
    better = int(front.better.sum())
    text = f"{len(front.evaluated)} machines evaluated, {len(designs)} on the front, {better} of them at least as good"
    outputs.print_lines([f"{text} as the geometry that the search began with in all aims"])
    if "volume" in problem.columns and not {"certified", "assembled"} & problem.at_least.keys():
        outputs.note("volume comes out small where a forward singularity is within the limits: --at-least certified:1")
