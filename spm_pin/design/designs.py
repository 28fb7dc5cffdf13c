"""Comparison and search of dimensions: many machines over one sample of leg lengths, and Pareto fronts by NSGA-II."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.design.task import Task
from spm_pin.errors import ArgumentError, GeometryError, require_extra
from spm_pin.kinematics.rates_and_forces import tilt_densities
from spm_pin.machine import Manipulator, Stage
from spm_pin.machine.leg_kinds import KINDS
from spm_pin.machine.machine import Machine, check_machine, likely_unit
from spm_pin.proofs.certificate import free_of_singularities
from spm_pin.support.arguments import (
    LARGEST,
    SMALLEST,
    BoolArray,
    FloatArray,
    Progress,
    check_instance,
    choice,
    number_pair,
    real_number,
    type_and_value,
    whole_number,
)
from spm_pin.support.files import file_path, write_files
from spm_pin.support.progress import shown_progress
from spm_pin.sweeps.domains import Sample, definition_differences, package_version
from spm_pin.sweeps.metrics import METRICS, Metric, prepare_metrics, resolve_metrics
from spm_pin.sweeps.points import Points
from spm_pin.sweeps.runner import check_workers, processes, run_tasks

if TYPE_CHECKING:
    from distributed import Client

Batch = tuple[int, tuple[Manipulator | Stage, ...]]
Rows = tuple[int, FloatArray]

_TOGETHER = 16
"""Machines in a batch, at most: some tenths of a second for 10⁴ states each."""
SIZES = ("assembled", "volume", "footprint")
"""Columns that are not statistics of metrics, besides "certified" and those of functions."""
Function = Callable[[Any], float]
"""A number of a machine."""
_STAGES = ("", "lower_", "upper_")
_DIMENSIONS = ("base_radius", "platform_radius", "middle_side")
_OF_LEGS = ("minimum", "stroke", *dict.fromkeys(name for kind in KINDS.values() for name in kind.identified))
VARIABLES = (*_DIMENSIONS, *(f"{stage}{name}" for stage in _STAGES for name in _OF_LEGS))
"""Names of variables that may be free: E, C, d [m]; and of all legs, or of a stage's, the least reading, the stroke and
the numbers that are fixed in PRS and RRS legs, such as "lower_crank" [m, rad]. A machine of one stage has neither d nor
the names that begin with lower or upper."""
_LOW = 0.05
"""Share of the configurations at which a metric may be below its "_low"."""
_NARROWEST = 1e-6
"""Least width of a free range, over its end: a search needs many distinct numbers."""
_CHOICES = ("free", "aims", "at_least", "at_most")
_FORMAT, _IMPOSSIBLE = 3, 1e30


@dataclass(frozen=True)
class Designs:
    """Numbers of N machines, evaluated over the same states in shares of their strokes."""

    machines: tuple[Manipulator | Stage, ...]
    """The machines."""
    columns: Mapping[str, FloatArray]
    """Numbers (N,) by name, NaN if not defined for a machine:

    - "assembled": share of the leg lengths with a physical configuration; below 1 a forward singularity is within the
      limits.
    - "volume": volume of the poses of these configurations, ∫ |det ∂(o, R)/∂l| dl [m³ rad³]; a pose with several
      configurations is counted once for each. For a stage it is the volume of heights and normals [m sr]. It is
      reliable where "certified" is 1: the integrand is unbounded at a forward singularity, and the estimate then too
      small.
    - "footprint": area of the base circle π E² [m²].
    - "certified": 1 where the limits are proved free of forward singularities, 0 where they are not, or the proof takes
      more than the boxes allowed; if asked for.
    - the names of given functions: their values.
    - "<metric>_mean" and "<metric>_low": mean of a metric of `spm_pin.sweeps` and the value that it exceeds at all but
      one in twenty of the configurations.
    """

    def __len__(self) -> int:
        return len(self.machines)


def evaluate_designs(
    machines: Iterable[Manipulator | Stage],
    metrics: str | Metric | Iterable[str | Metric] = ("conditioning", "payload"),
    *,
    functions: dict[str, Function] | None = None,
    states: int = 10_000,
    boxes: int = 0,
    seed: int = 0,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Designs:
    """Evaluate many machines over one sample of readings, drawn uniformly in shares of their limits.

    Parameters
    ----------
    machines : iterable of Manipulator, or of Stage
        Machines with finite leg limits. A machine without a configuration within its limits has NaN in its row.
    metrics : metrics or their names
        Metrics of states: those of `spm_pin.sweeps`, or your own.
    functions : dict of str to callable, optional
        Columns by their names, each a function of a machine that returns a number: your own, or those of a
        `Task`, `task.margin` and `task.effort`. They are sent to other processes, if any are used.
    states : int
        Number of sets of readings for each machine: a Sobol sequence, with the same shares of the strokes for all.
    boxes : int
        Prove as `certify` does, with at most so many boxes for a stage, that the limits are free of forward
        singularities; not tried where some leg lengths have no configuration. Where the legs of a stage have equal
        limits, a sixth of its states is searched. 0 leaves the column out.
    seed : int
        Seed of the sequence.
    scheduler, workers
        As for `spm_pin.sweeps.run_sweep`, but by default everything runs in this process. A script that uses more
        processes must call this below ``if __name__ == "__main__":``.
    progress : callable, optional
        Called with the current task, the number of evaluated machines and that of all machines.

    Returns
    -------
    Designs
        A row for each machine, in their order; it does not depend on the number of workers.
    """
    if not isinstance(machines, Iterable):
        raise ArgumentError("machines", "an iterable of at least one machine", type_and_value(machines))
    machines = tuple(machines)
    for index, machine in enumerate(machines):
        if not (isinstance(machine, Machine) and machine.limits and machine.limits.are_finite):
            received = repr(machine) if isinstance(machine, Machine) else type(machine).__name__
            raise ArgumentError("machines", "machines with finite leg limits", f"{received} at index {index}")
        if type(machine) is not type(machines[0]):
            raise ArgumentError(
                "machines", "machines of one class, all Manipulator or all Stage", f"another class at index {index}"
            )
    if not machines:
        raise ArgumentError("machines", "an iterable of at least one machine", "an empty one")
    chosen, sample = resolve_metrics(metrics), Sample(whole_number(states, "states", least=2, most=10**7), seed)
    whole_number(boxes, "boxes")
    check_workers(scheduler, workers)
    report = shown_progress(progress)
    if scheduler is not None or workers not in (None, 1):
        require_extra("cluster")
    own = _checked_functions({} if functions is None else functions)
    names = column_names(chosen, boxes, own)
    shares = sample.draw(len(machines[0].legs.names), (0,), sample.count)
    work = partial(_evaluate_some, shares, chosen, boxes, tuple(own.values()))
    values = np.full((len(machines), len(names)), np.nan)
    together = min(_TOGETHER, -(-len(machines) // 4))
    tasks, done = ((k, machines[k : k + together]) for k in range(0, len(machines), together)), 0
    low, stroke = leg_ranges(machines[0])
    prepare_metrics(chosen, Points(machines[0], "legs", np.tile(low + 0.3 * stroke, (2, 1))))
    for first, rows in run_tasks(work, tasks, -(-len(machines) // together), scheduler, workers or 1):
        values[first : first + len(rows)] = rows
        done += len(rows)
        report("machines", done, len(machines))
    return Designs(machines, dict(zip(names, values.T, strict=True)))


def _checked_functions(functions: dict[str, Function]) -> dict[str, Function]:
    for name, function in check_instance(functions, dict, "functions").items():
        if name in column_names(tuple(METRICS.values()), 1):
            raise ArgumentError("functions", "names other than the package's columns", repr(name))
        if not callable(function):
            raise ArgumentError(f"functions[{name!r}]", "a function of a machine", type_and_value(function))
    return dict(functions)


def leg_ranges(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Return the least readings and the strokes of the legs, of shape (legs,) each [m] ([rad] for RRS legs)."""
    assert machine.limits is not None
    low, high = machine.limits.ends
    return low.copy(), high - low


def column_names(metrics: tuple[Metric, ...], boxes: int, own: Iterable[str] = ()) -> list[str]:
    """Return the names of the columns of `Designs`, in their order."""
    statistics = [f"{metric.name}_{which}" for metric in metrics for which in ("mean", "low")]
    return [*SIZES, *statistics, *own, *(["certified"] if boxes else [])]


def _evaluate_some(
    shares: FloatArray,
    metrics: tuple[Metric, ...],
    boxes: int,
    own: tuple[Function, ...],
    batch: Batch,
) -> Rows:
    first, machines = batch
    rows = np.array(
        [
            [*_evaluate(shares, metrics, machine), *(_number(function, machine) for function in own)]
            for machine in machines
        ]
    )
    if boxes:
        whole = np.flatnonzero(rows[:, 0] == 1.0)
        certified = np.zeros(len(machines))
        certified[whole] = free_of_singularities([machines[k] for k in whole], boxes)
        rows = np.column_stack([rows, certified])
    return first, rows


def _number(function: Function, machine: Manipulator | Stage) -> float:
    try:
        return float(function(machine))
    except (TypeError, ValueError) as error:
        raise ArgumentError("functions", "functions that return a number", repr(error)) from error


def _evaluate(shares: FloatArray, metrics: tuple[Metric, ...], machine: Manipulator | Stage) -> list[float]:
    low, stroke = leg_ranges(machine)
    points = Points(machine, "legs", low + shares * stroke)
    assembled, area = float(points.reachable.mean()), np.pi * machine.base_radius**2
    if not assembled:
        return [0.0, 0.0, area] + [np.nan] * (2 * len(metrics))
    row = [assembled, float(_densities(points).sum()) / len(shares) * float(stroke.prod()), area]
    for metric in metrics:
        values = metric.evaluate(points).astype(np.float64)
        values = values[np.isfinite(values)]
        row += [float(values.mean()), float(np.quantile(values, _LOW))] if len(values) else [np.nan, np.nan]
    return row


def _densities(points: Points) -> FloatArray:
    """Return the volume of poses (of heights and normals for a stage [m sr]) per volume of readings, (M,)."""
    machine, reached = points.machine, points.reached
    if reached.machine.is_stage:
        return tilt_densities(reached, np.nan_to_num(points.platform_jacobians))
    # The determinant of G from the singular values that the conditioning needs as well: of the twist (v, L ω) by rates
    # of knees.
    sizes = np.nan_to_num(points.singular_values().prod(axis=-1)) / machine.platform_radius**3
    return np.asarray(sizes * machine.legs.largest_slopes.prod())


def variables_of(machine: Machine) -> tuple[str, ...]:
    """Return the `VARIABLES` that a machine has."""
    return (*_DIMENSIONS[:2], *_OF_LEGS) if machine.is_stage else VARIABLES


def _stages_and_name(machine: Machine, variable: str) -> tuple[range, str]:
    """Return the stages of a machine that a variable concerns, and the name of the variable in a stage."""
    for stage, prefix in enumerate(_STAGES[1:]):
        if variable.startswith(prefix):
            return range(stage, stage + 1), variable.removeprefix(prefix)
    return range(len(machine.legs.kinds)), variable


@dataclass(frozen=True)
class DesignProblem:
    """A search for dimensions: the free ones, the aims to be made large or small, and the bounds to be kept.

    Parameters
    ----------
    machine : Manipulator or Stage
        A nominal machine with finite leg limits: the values that are not free are those of this machine, which is also
        the reference of the result.
    free : dict of str to (low, high)
        Ranges of some of `VARIABLES` [m, rad].
    aims : dict of str to "max" or "min"
        Columns of `Designs`, such as "volume" or "payload_low", or names of `functions`. With a single aim the front is
        one machine.
    at_least, at_most : dict of str to float, optional
        Least and largest values of columns, such as {"certified": 1, "conditioning_low": 1 / 60} for condition numbers
        of at most 60, and {"footprint": 1.2}.
    functions : dict of str to callable, optional
        Columns for aims and bounds, see `evaluate_designs`. A store identifies those of a task by its poses, your own
        by their names alone.
    metrics : iterable of Metric, optional
        Metrics of your own, or those of the package with other parameters, for their "_mean" and "_low".
    """

    machine: Manipulator | Stage
    free: dict[str, tuple[float, float]]
    aims: dict[str, str]
    at_least: dict[str, float] = dataclasses.field(default_factory=dict)
    at_most: dict[str, float] = dataclasses.field(default_factory=dict)
    functions: dict[str, Function] = dataclasses.field(default_factory=dict)
    metrics: Iterable[Metric] = ()

    def __post_init__(self) -> None:
        machine = check_machine(self.machine)
        if not (machine.is_nominal and machine.limits and machine.limits.are_finite):
            raise ArgumentError("machine", "a nominal machine with finite leg limits", repr(machine))
        for name in _CHOICES:
            object.__setattr__(self, name, dict(check_instance(getattr(self, name), dict, name)))
        object.__setattr__(self, "functions", _checked_functions(self.functions))
        is_empty = isinstance(self.metrics, tuple | list) and not self.metrics
        object.__setattr__(self, "metrics", () if is_empty else resolve_metrics(self.metrics))
        for name, ends in self.free.items():
            self._check_range(choice(name, "free", variables_of(machine)), ends)
        for each in _OF_LEGS:
            if each in self.free and {f"lower_{each}", f"upper_{each}"} & self.free.keys():
                raise ArgumentError("free", f"{each} of all legs, or lower_{each} and upper_{each}", "both")
        for name, sense in self.aims.items():
            choice(sense, f"aims[{self._column(name, 'aims')!r}]", ("max", "min"))
        for bounds in ("at_least", "at_most"):
            for name, value in getattr(self, bounds).items():
                real_number(value, f"{bounds}[{self._column(name, bounds)!r}]", "a number")
        for name, expected in (("free", "a dimension that may change"), ("aims", "a column to be large or small")):
            if not getattr(self, name):
                raise ArgumentError(name, f"at least one, {expected}", "none")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that aims and bounds need."""
        return tuple(dict.fromkeys([*self.aims, *self.at_least, *self.at_most]))

    @property
    def needed_metrics(self) -> tuple[str | Metric, ...]:
        """The metrics that aims and bounds need."""
        others = {*SIZES, "certified", *self.functions}
        own = {metric.name: metric for metric in self.metrics}
        names = (name.rpartition("_")[0] for name in self.columns if name not in others)
        return tuple(own.get(name, name) for name in dict.fromkeys(names)) or ("conditioning",)

    def _column(self, name: str, argument: str) -> str:
        known = {metric.name: metric for metric in (*METRICS.values(), *self.metrics)}
        if name in known:
            raise ArgumentError(argument, f"'{name}_mean' or '{name}_low'", repr(name))
        return choice(name, argument, column_names(tuple(known.values()), 1, self.functions))

    def _check_range(self, name: str, ends: tuple[float, float]) -> None:
        """Raise `ArgumentError` unless this is a range of a variable that the machine has."""
        low, high = number_pair(ends, f"free[{name!r}]", "metres, or radians of angles")
        stages, of_legs = _stages_and_name(self.machine, name)
        own = of_legs not in (*_DIMENSIONS, "minimum", "stroke")
        kinds = [self.machine.legs.kinds[stage] for stage in stages]
        lacking = [kind.name for kind in kinds if own and of_legs not in kind.identified]
        if lacking:
            raise ArgumentError("free", "a number that the machine's legs have", f"{name} of {lacking[0]} legs")
        if of_legs in ("minimum", "direction"):
            least = float(np.max(self.machine.legs.free_limits.minimum)) if of_legs == "minimum" else -np.inf
        else:
            least = SMALLEST
        if not (least <= low < high <= LARGEST and high - low > _NARROWEST * max(abs(low), abs(high))):
            expected = f"{least:g} <= low < high <= {LARGEST:g}, a range of more than {_NARROWEST:g} of it"
            raise ArgumentError(f"free[{name!r}]", expected, f"{low:g} and {high:g}")
        if self.unit(name) == "m" and likely_unit(self.machine, low):
            expected = f"lengths in metres, in proportion to a machine about {self.machine.size:.3g} m high"
            raise ArgumentError(f"free[{name!r}]", expected, f"{low:g} and {high:g}", "In mm or cm?")

    def machine_of(self, values: FloatArray) -> Manipulator | Stage:
        """Return the machine of values (k,) of the free variables, in order; `GeometryError` if infeasible."""
        machine, (low, stroke) = self.machine, leg_ranges(self.machine)
        dimensions = {name: getattr(machine, name) for name in _DIMENSIONS if hasattr(machine, name)}
        kinds = list(machine.legs.kinds)
        for name, value in zip(self.free, map(float, values), strict=True):
            stages, of_legs = _stages_and_name(machine, name)
            rows = slice(3 * stages.start, 3 * stages.stop)
            if of_legs in dimensions:
                dimensions[of_legs] = value
            elif of_legs in ("minimum", "stroke"):
                (low if of_legs == "minimum" else stroke)[rows] = value
            else:
                for stage in stages:
                    kinds[stage] = dataclasses.replace(kinds[stage], **{of_legs: value})
        limits: Any = type(machine.limits)(low.tolist(), (low + stroke).tolist())  # type: ignore[misc]
        legs: Any = kinds[0] if machine.is_stage else tuple(kinds)
        return type(machine)(**dimensions, limits=limits, legs=legs)

    def values(self, machine: Machine) -> FloatArray:
        """Return the free variables (k,) of a machine as `machine` makes them, in their order."""
        low, stroke = leg_ranges(machine)
        values = []
        for name in self.free:
            stages, of_legs = _stages_and_name(machine, name)
            if of_legs in ("minimum", "stroke"):
                values.append((low if of_legs == "minimum" else stroke)[3 * stages.start])
            else:
                values.append(getattr(machine if of_legs in _DIMENSIONS else machine.legs.kinds[stages.start], of_legs))
        return np.array(values)

    def unit(self, name: str) -> str:
        """Return the unit of a free variable, "m" or "rad"."""
        stages, of_legs = _stages_and_name(self.machine, name)
        of_readings = of_legs in ("minimum", "stroke")
        return self.machine.legs.kinds[stages.start].unit if of_readings else "rad" if of_legs == "direction" else "m"

    def column_unit(self, name: str) -> str:
        """Return the unit of a column, "1" if it has none."""
        metrics = {metric.name: metric.unit for metric in (*METRICS.values(), *self.metrics)}
        efforts = " or ".join(dict.fromkeys(kind.effort_unit for kind in self.machine.legs.kinds))
        volume = "m sr" if self.machine.is_stage else "m³ rad³"
        units = {"volume": volume, "footprint": "m²", "task_margin": "m", "task_effort": efforts}
        return units.get(name) or metrics.get(name.rpartition("_")[0], "1")

    def objectives(self, designs: Designs) -> tuple[FloatArray, FloatArray]:
        """Return objectives to minimize (N, m) and constraints g <= 0 (N, c); the last is 1 if a number is missing."""
        signs = [-1.0 if sense == "max" else 1.0 for sense in self.aims.values()]
        values = np.stack([designs.columns[name] for name in self.aims], axis=-1) * signs
        bounds = [least - designs.columns[name] for name, least in self.at_least.items()]
        bounds += [designs.columns[name] - most for name, most in self.at_most.items()]
        lacks = np.isnan(np.stack([*values.T, *bounds], axis=-1)).any(axis=-1)
        bounds = [np.where(np.isnan(bound), _IMPOSSIBLE, bound) for bound in bounds]
        return np.where(lacks[:, None], _IMPOSSIBLE, values), np.stack([*bounds, lacks], axis=-1)


@dataclass(frozen=True)
class Front:
    """The Pareto-optimal machines of a search, in the order of the first aim."""

    problem: DesignProblem
    """The free dimensions, aims and bounds of the search."""
    designs: Designs
    """The machines of the front and their numbers."""
    evaluated: Designs
    """All machines that were evaluated."""
    reference: Designs
    """The machine that the problem began with."""

    @cached_property
    def better(self) -> BoolArray:
        """True for machines of the front at least as good as the reference in all aims that keep all bounds, (n,)."""
        values = self.problem.objectives(self.designs)[0]
        return np.asarray((values <= self.problem.objectives(self.reference)[0]).all(axis=-1))


def pareto_front(
    problem: DesignProblem,
    store: str | os.PathLike[str],
    *,
    population: int = 40,
    generations: int = 25,
    states: int = 2000,
    boxes: int = 30_000,
    seed: int = 0,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Front:
    """Search for the Pareto-optimal machines of a problem, by NSGA-II.

    Parameters
    ----------
    problem : DesignProblem
        Free dimensions, aims and bounds.
    store : path
        JSON file of the search: problem, seed, versions, and all machines evaluated, written after each generation. A
        search that was interrupted goes on from it, and a finished one is read from it; another search's is refused.
    population, generations : int
        Number of machines of a generation, and number of generations.
    states, boxes, scheduler, workers
        As for `evaluate_designs`; certificates are made where an aim or a bound is "certified". Processes are started
        once for the search, and need ``if __name__ == "__main__":`` as in `evaluate_designs`.
    seed : int
        Seed of the search and of the states.
    progress : callable, optional
        Called with the current task, the number of completed generations and that of all.

    Returns
    -------
    Front
        The same for the same problem, seed and versions, however often it was interrupted.

    Notes
    -----
    K. Deb et al., "A fast and elitist multiobjective genetic algorithm: NSGA-II", IEEE Transactions on Evolutionary
    Computation 6 (2002). A search that goes on repeats the choices of NSGA-II with the numbers of the file.
    """
    require_extra("design")
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.evaluator import Evaluator
    from pymoo.core.problem import Problem
    from pymoo.problems.static import StaticProblem
    from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

    check_instance(problem, DesignProblem, "problem")
    path = file_path(store, "store", suffixes=(".json",))
    for name, value in (("population", population), ("generations", generations), ("states", states)):
        whole_number(value, name, least=2, most=10**6)
    whole_number(seed, "seed", most=2**32 - 1)
    check_workers(scheduler, workers)
    report = shown_progress(progress)
    whole_number(boxes, "boxes")
    needed = boxes if "certified" in problem.columns else 0
    options: dict[str, Any] = {"states": states, "boxes": needed, "seed": seed}
    given = {
        "format": _FORMAT,
        "versions": {"spm_pin": package_version(), "pymoo": metadata.version("pymoo"), "numpy": np.__version__},
        "geometry": problem.machine.as_data(),
        **{name: list(getattr(problem, name).items()) for name in _CHOICES},
        "functions": [[name, _identity(function)] for name, function in problem.functions.items()],
        "metrics": [metric.definition() for metric in problem.metrics],
        "population": population,
        **options,
    }
    definition, parts = json.loads(json.dumps(given)), list[Designs]()
    chosen, own = resolve_metrics(problem.needed_metrics), problem.functions
    stored = _read(path, definition, column_names(chosen, needed, own))

    def evaluate(client: Client | None, values: FloatArray, generation: int) -> tuple[Designs, BoolArray]:
        """Return the numbers of machines and which are feasible; others have NaN, and the initial machine."""
        built = [_built(problem, each) for each in values]
        exist = np.array([each is not None for each in built])
        some = tuple(each or problem.machine for each in built)
        if generation < len(stored):
            if stored[generation]["values"] != values.tolist():
                cause = "Written on another kind of computer?"
                raise ArgumentError(
                    "store",
                    "a store with the machines of this search",
                    f"other machines in generation {generation}",
                    cause,
                )
            columns = {name: np.array(column, dtype=float) for name, column in stored[generation]["columns"].items()}
            return Designs(some, columns), exist
        designs = evaluate_designs(some, chosen, functions=own, scheduler=client, progress=lambda *_: None, **options)
        columns = {name: np.where(exist, column, np.nan) for name, column in designs.columns.items()}
        designs = Designs(some, columns)
        numbers = {name: [None if np.isnan(x) else x for x in column] for name, column in designs.columns.items()}
        stored.append({"values": values.tolist(), "columns": numbers})
        write_files({path: json.dumps({**definition, "generations": stored}, allow_nan=False)}, "store")
        return designs, exist

    ends = np.array(list(problem.free.values()))
    count = len(problem.at_least) + len(problem.at_most) + 1
    space = Problem(n_var=len(ends), n_obj=len(problem.aims), n_ieq_constr=count, xl=ends[:, 0], xu=ends[:, 1])
    algorithm = NSGA2(pop_size=population)
    algorithm.setup(space, termination=("n_gen", generations), seed=seed, verbose=False)
    started = processes(population, scheduler, workers or 1) if len(stored) < generations else nullcontext()
    with started as client:
        for generation in range(generations):
            asked = algorithm.ask()
            designs, exist = evaluate(client, asked.get("X"), generation)
            values, bounds = problem.objectives(designs)
            columns = {name: column[exist] for name, column in designs.columns.items()}
            parts.append(Designs(tuple(x for x, kept in zip(designs.machines, exist, strict=True) if kept), columns))
            Evaluator().eval(StaticProblem(space, F=values, G=bounds), asked)
            algorithm.tell(infills=asked)
            report("generations", generation + 1, generations)
    columns = {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns}
    every = Designs(sum((part.machines for part in parts), ()), columns)
    reference = evaluate_designs([problem.machine], chosen, functions=own, **options)
    values, bounds = problem.objectives(every)
    feasible = np.flatnonzero((bounds <= 0.0).all(axis=-1))
    # In the order of the first aim; of equal rows only the first is kept.
    kept = feasible[np.unique(values[feasible], axis=0, return_index=True)[1]]
    kept = kept[np.sort(NonDominatedSorting().do(values[kept], only_non_dominated_front=True))]
    best = {name: column[kept] for name, column in columns.items()}
    return Front(problem, Designs(tuple(every.machines[k] for k in kept), best), every, reference)


def _built(problem: DesignProblem, values: FloatArray) -> Manipulator | Stage | None:
    """Return the machine of free variables, None if they are not feasible, such as rods that reach no ball."""
    try:
        return problem.machine_of(values)
    except GeometryError:
        return None


def _identity(function: Function) -> str | None:
    """Return the identity of the task of a function; None if it is not a task's function."""
    task = getattr(function, "__self__", None)
    return task.identity if isinstance(task, Task) else None


def _read(path: Path, definition: dict[str, Any], names: list[str]) -> list[dict[str, Any]]:
    """Return the generations in a file of the search, an empty list if the file does not exist."""
    if not path.exists():
        return []
    expected = "a file of this very search"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        generations = list(content.pop("generations"))
        differences = definition_differences(content, definition, of="search")
        for one in [] if differences else generations:
            lengths = {np.array(column, dtype=float).shape for column in one["columns"].values()}
            if one["columns"].keys() != set(names) or lengths != {(len(one["values"]),)}:
                raise ValueError("a generation without all its numbers")
    except (OSError, ValueError, AttributeError, KeyError, TypeError) as error:
        raise ArgumentError("store", expected, path, f"It cannot be read: {error!r}") from error
    if differences:
        raise ArgumentError("store", expected, path, f"{'; '.join(differences)}. Give another file")
    return generations
