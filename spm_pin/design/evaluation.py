"""Many machines evaluated over one sample of leg lengths: a row of numbers for each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import FloatArray, Progress, check_progress, real_number, type_and_value, whole_number
from spm_pin.proofs.certificate import free_of_singularities
from spm_pin.sweeps.domains import Sample
from spm_pin.sweeps.metrics import Metric, prepare_metrics, resolve_metrics
from spm_pin.sweeps.points import Points
from spm_pin.sweeps.runner import check_workers, run_tasks

if TYPE_CHECKING:
    from distributed import Client

Task = tuple[int, tuple[Geometry, ...]]
Rows = tuple[int, FloatArray]

_TOGETHER = 16
"""Machines in a task, at most: some tenths of a second for 10⁴ states each."""
SIZES = ("assembled", "volume", "footprint")
"""Columns that are no statistics of metrics, besides "certified"."""


@dataclass(frozen=True)
class Designs:
    """Numbers of N machines, evaluated over the same states in shares of their strokes."""

    geometries: tuple[Geometry, ...]
    """The machines."""
    columns: Mapping[str, FloatArray]
    """Numbers (N,) by their names, NaN where a machine has none:

    - "assembled": share of the leg lengths with a physical configuration; below 1 a forward singularity is within the
      limits.
    - "volume": of the poses of these configurations, ∫ |det ∂(o, R)/∂l| dl [m³ rad³]; a pose that several of them have
      counts as often. Holds where "certified" is 1: it has no bound at a forward singularity, and comes out small.
    - "footprint": area of the base circle π E² [m²].
    - "certified": 1 where the limits are proved free of forward singularities, 0 where they are not, or the proof takes
      more than the boxes allowed; if asked for.
    - "<metric>_mean" and "<metric>_low": mean of a metric of `spm_pin.sweeps` and the value that it exceeds at all but
      the share `quantile` of the configurations.
    """

    def __len__(self) -> int:
        return len(self.geometries)


def evaluate_designs(
    geometries: Iterable[Geometry],
    metrics: str | Metric | Iterable[str | Metric] = ("conditioning", "payload"),
    *,
    states: int = 10_000,
    quantile: float = 0.05,
    boxes: int = 0,
    seed: int = 0,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Designs:
    """Evaluate many machines over one sample of leg lengths, drawn uniformly in shares of their limits.

    Parameters
    ----------
    geometries : iterable of Geometry
        Machines with finite leg limits. One whose limits hold no configuration has NaN in its row, and stops nothing.
    metrics : metrics or their names
        Of `spm_pin.sweeps`; those of a state.
    states : int
        Sets of leg lengths for each machine: a Sobol sequence, the same shares of the strokes for all.
    quantile : float
        Share of the configurations at which a metric may be below its "_low".
    boxes : int
        Prove as `certify` does, with at most so many boxes for a stage, that the limits are free of forward
        singularities; not tried where some leg lengths have no configuration. Where the legs of a stage have equal
        limits, a sixth of its states is searched. 0 leaves the column out.
    seed : int
        Of the sequence.
    scheduler, workers
        As for `spm_pin.sweeps.run_sweep`, but without them all is done in this process. A script that asks for more
        calls this below ``if __name__ == "__main__":``.
    progress : callable, optional
        Called with what is being done, the machines done and all machines.

    Returns
    -------
    Designs
        A row for each machine, in their order; it does not depend on the number of workers.
    """
    machines = tuple(geometries) if isinstance(geometries, Iterable) else ()
    for index, machine in enumerate(machines):
        if not isinstance(machine, Geometry) or machine.limits is None or not np.isfinite(machine.limits.maximum).all():
            received = repr(machine) if isinstance(machine, Geometry) else type(machine).__name__
            raise ArgumentError("geometries", "Geometry objects with finite leg limits", f"{received} at index {index}")
    if not machines:
        received = "none" if isinstance(geometries, Iterable) else type_and_value(geometries)
        raise ArgumentError("geometries", "an iterable of at least one Geometry", received)
    chosen, sample = resolve_metrics(metrics), Sample(whole_number(states, "states", least=2, most=10**7), seed)
    real_number(quantile, "quantile", "a share from 0 to 1", least=0.0, most=1.0)
    whole_number(boxes, "boxes")
    check_workers(scheduler, workers)
    check_progress(progress)
    if scheduler is not None or workers not in (None, 1):
        require_extra("cluster")
    task = partial(_evaluate_some, sample.draw(6, (0,), sample.count), chosen, quantile, boxes)
    values = np.full((len(machines), len(column_names(chosen, boxes))), np.nan)
    together = min(_TOGETHER, -(-len(machines) // 4))
    tasks, done = ((k, machines[k : k + together]) for k in range(0, len(machines), together)), 0
    prepare_metrics(chosen, Points(machines[0], "legs", _readings(machines[0], np.full((2, 6), 0.3))))
    for first, rows in run_tasks(task, tasks, -(-len(machines) // together), scheduler, workers or 1):
        values[first : first + len(rows)] = rows
        done += len(rows)
        if progress is not None:
            progress("machines", done, len(machines))
    return Designs(machines, dict(zip(column_names(chosen, boxes), values.T, strict=True)))


def leg_ranges(machine: Geometry) -> tuple[FloatArray, FloatArray]:
    """Return the shortest lengths and the strokes of the legs, shapes (6,) [m]."""
    assert machine.limits is not None
    low = np.array(machine.limits.minimum)
    return low, np.array(machine.limits.maximum) - low


def column_names(metrics: tuple[Metric, ...], boxes: int) -> list[str]:
    """Return the names of the columns of `Designs`, in their order."""
    statistics = [f"{metric.name}_{which}" for metric in metrics for which in ("mean", "low")]
    return [*SIZES, *statistics, *(["certified"] if boxes else [])]


def _readings(machine: Geometry, shares: FloatArray) -> FloatArray:
    low, stroke = leg_ranges(machine)
    return np.asarray(low + shares * stroke)


def _evaluate_some(shares: FloatArray, metrics: tuple[Metric, ...], quantile: float, boxes: int, task: Task) -> Rows:
    first, machines = task
    rows = np.array([_evaluate(shares, metrics, quantile, machine) for machine in machines])
    if boxes:
        whole = np.flatnonzero(rows[:, 0] == 1.0)
        certified = np.zeros(len(machines))
        certified[whole] = free_of_singularities([machines[k] for k in whole], boxes)
        rows = np.column_stack([rows, certified])
    return first, rows


def _evaluate(shares: FloatArray, metrics: tuple[Metric, ...], quantile: float, machine: Geometry) -> list[float]:
    points = Points(machine, "legs", _readings(machine, shares))
    assembled, area = float(points.reachable.mean()), np.pi * machine.base_radius**2
    if not assembled:
        return [0.0, 0.0, area] + [np.nan] * (2 * len(metrics))
    # The determinant of G from what the conditioning needs as well: singular values of the twist (v, L ω).
    determinants = np.nan_to_num(points.singular_values().prod(axis=-1)) / machine.platform_radius**3
    row = [assembled, float(determinants.sum()) / len(shares) * float(leg_ranges(machine)[1].prod()), area]
    for metric in metrics:
        values = metric.evaluate(points).astype(np.float64)
        values = values[np.isfinite(values)]
        row += [float(values.mean()), float(np.quantile(values, quantile))] if len(values) else [np.nan, np.nan]
    return row
