"""Reachable positions: their set, the nearest ones to other points, the orientations at one, and their volume.

Rotations are described by tilt and torsion, R = Rz(φ) Ry(θ) Rz(σ - φ): the platform's normal leans by the tilt θ
towards the azimuth φ, and the platform is turned by the torsion σ about it. The uniform measure of rotations is
sin θ dφ dθ dσ, 8π² in all. Bonev, Zlatanov, Gosselin, "Advantages of the modified Euler angles in the design and
control of PKMs", 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.either_machine import or_of_stage
from spm_pin.kinematics.kernels import RESOLUTION
from spm_pin.kinematics.stage_displacement import read_heights
from spm_pin.machine import Configuration, LegLimits, Manipulator, Stage
from spm_pin.machine.configuration import Condition, check_condition
from spm_pin.machine.manipulator import check_manipulator
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    Progress,
    choice,
    generator,
    real_array,
    type_and_value,
    whole_number,
)
from spm_pin.support.progress import shown_progress
from spm_pin.workspace.boundary import FOR_STAGE, Boundary, reachable_boundary
from spm_pin.workspace.search import Membership, nearest_points, search_states, start_table
from spm_pin.workspace.state_set import StateSet, states_within

_OPTIMALITY_TOLERANCE = 1e-6
"""Violation of Eq. (1) of `docs/theory/reachable_set.md`, above which the search has not converged."""
_TRIED = 8
"""Number of states that satisfy a condition, from which the search for one at a point starts."""
CONFIDENCE = 0.95
"""Probability with which the intervals of volumes from samples hold the volume."""
ROTATIONS = 8.0 * np.pi**2
"""Measure of all rotations [rad³]."""
NORMALS = 4.0 * np.pi
"""Measure of all normals [sr]."""
_LARGE = 0.99
"""Share of the states with a smaller weight than one that is assumed where no state counts."""


@dataclass(frozen=True)
class PositionReach:
    """Reachability of positions of shape (...) in some orientation."""

    reachable: BoolArray
    """Whether o can be there, to a billionth of the machine's size, shape (...)."""
    distance: FloatArray
    """Distance to the nearest reachable position that was found [m], shape (...); zero where reachable."""
    nearest: FloatArray
    """The nearest reachable position that was found, in {B} [m], shape (..., 3)."""
    readings: FloatArray
    """Readings within the limits that put o there [m], shape (..., 6); there may be others."""
    undecided: BoolArray
    """Points without a state and without a nearest one: `distance` is an upper bound there, shape (...)."""


@dataclass(frozen=True)
class Estimate:
    """A number and an interval for it."""

    value: float
    """The best estimate, in `unit`."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""
    confidence: float
    """Confidence of the interval; NaN where the interval is the error of an extrapolation."""
    method: str
    """The method of the estimate."""
    unit: str
    """Unit of the value and both ends; empty for a share."""

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}] {self.unit}".rstrip()

    def times(self, factor: float, unit: str) -> Estimate:
        """Return the estimate of a positive multiple."""
        return replace(self, value=factor * self.value, low=factor * self.low, high=factor * self.high, unit=unit)

    @classmethod
    def from_meshes(cls, coarse: Boundary, fine: Boundary) -> Estimate:
        """Return a volume from two meshes, the second of half the first's spacing, with the extrapolation's error."""
        # A mesh with vertices on a surface is off by the square of its spacing.
        added = (fine.volume - coarse.volume) / 3.0
        value, error = fine.volume + added, abs(added)
        how = f"meshes of spacing {coarse.spacing:g} and {fine.spacing:g} m, extrapolated"
        return cls(value, value - error, value + error, float("nan"), how, "m³")

    @classmethod
    def from_hits(
        cls, hits: int, samples: int, whole: float, confidence: float, method: str, unit: str, undecided: int = 0
    ) -> Estimate:
        """Estimate the size of a part of `whole` from uniform samples, of which `hits` are in it: Clopper and Pearson.

        `undecided` samples may be hits or not: the lower end counts none of them, the upper end all.
        """
        from scipy import stats  # takes as long to load as all the rest

        low = stats.binomtest(hits, samples).proportion_ci(confidence, method="exact").low
        high = stats.binomtest(hits + undecided, samples).proportion_ci(confidence, method="exact").high
        return cls(whole * hits / samples, whole * float(low), whole * float(high), confidence, method, unit)

    @classmethod
    def from_mean(
        cls,
        values: FloatArray,
        whole: float,
        confidence: float,
        method: str,
        unit: str,
        relative_variance: float = 0.0,
        unseen: float | None = None,
    ) -> Estimate:
        """Estimate an integral over a region of size `whole` from values (N,) at uniform samples: Student's interval.

        The size may be an independent estimate, unbiased and with the given relative variance. Where few values are
        not zero, `unseen` is what another one may be, and the interval includes that of the effective number of hits.
        """
        from scipy import stats

        mean = float(values.mean())
        variance = float(values.var(ddof=1)) / len(values) + mean**2 * relative_variance
        error = float(stats.t.ppf(0.5 + 0.5 * confidence, len(values) - 1)) * np.sqrt(variance)
        low, high = max(mean - error, 0.0), mean + error
        if unseen is not None:
            counted = _counted_ends(values, unseen, confidence)
            low, high = float(np.fmin(low, counted[0])), float(np.fmax(high, counted[1]))
        return cls(whole * mean, whole * low, whole * high, confidence, method, unit)


def _counted_ends(values: FloatArray, unseen: float, confidence: float) -> tuple[float, float]:
    """Return the ends of an interval for the mean of values (N,) of which few are not zero, after Fay and Feuer.

    They are Clopper and Pearson's of (Σ v)² / Σ v² hits; the upper end counts one more, the largest or `unseen`.
    M. P. Fay, E. J. Feuer, "Confidence intervals for directly standardized rates", Statistics in Medicine 16 (1997).
    """
    from scipy import stats

    def end(share: float, more: float) -> float:
        total, squares = float(values.sum()) + more, float((values**2).sum()) + more**2
        hits = total**2 / squares if total else 0.0
        return float(stats.beta.ppf(share, hits, len(values) - hits + 1.0)) * squares / total if hits else 0.0

    return end(0.5 - 0.5 * confidence, 0.0), end(0.5 + 0.5 * confidence, max(float(values.max()), unseen))


def reachable_position(machine: Manipulator, points: npt.ArrayLike, limits: LegLimits | None = None) -> PositionReach:
    """Find the positions that o can reach in some orientation, in the physical mode, and the nearest to the others.

    Parameters
    ----------
    machine, limits
        As for `reachable_boundary`.
    points : array_like, shape (..., 3)
        In {B} [m].

    Notes
    -----
    "Reachable" is proved: `readings` put o there. The determinant of each stage, about 1 at home, is at least 1e-6:
    closer to a forward singularity, rounding of readings decides whether there is a state. "Not reachable" is the
    outcome of a search; where it has not found the nearest position either, `undecided` says so.
    """
    check_manipulator(machine, for_stage=FOR_STAGE)
    array = real_array(points, "points", (3,), "positions in metres")
    states = states_within(machine, limits)
    flat, shape = array.reshape(-1, 3), array.shape[:-1]
    result = nearest_points(states, flat)
    reached = result.distance <= RESOLUTION * states.size
    return PositionReach(
        reached.reshape(shape),
        np.where(reached, 0.0, result.distance).reshape(shape),
        states.positions(result.coordinates).reshape(*shape, 3),
        result.readings.reshape(*shape, 6),
        (~reached & (result.optimality > _OPTIMALITY_TOLERANCE)).reshape(shape),
    )


def reachable_volume(
    machine: Manipulator,
    limits: LegLimits | None = None,
    *,
    method: Literal["sampling", "mesh"] = "sampling",
    where: Condition | None = None,
    samples: int = 20_000,
    spacing: float | None = None,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the volume of the positions that o can reach in the physical mode, in m³.

    Parameters
    ----------
    machine, limits, progress
        As for `reachable_boundary`.
    method : str
        "sampling": the share of uniform points that are reachable, with Clopper and Pearson's interval, whose upper end
        counts undecided points as reachable. "mesh": the volume enclosed by `reachable_boundary` at `spacing` and half
        of it, extrapolated; the error is the extrapolated part, and the interval has no confidence.
    where : callable, optional
        Takes states (n,) and returns which of them meet a condition, (n,). A position is then counted if at least one
        of its states does. Where no such state was found, the upper end of the interval counts the position all the
        same, so that the interval is wide where few states meet the condition. For "sampling" only; see `pose_volume`
        for states.
    samples : int
        Points for "sampling".
    spacing : float
        Spacing of the coarser grid for "mesh" [m], see `reachable_boundary`.
    rng : Generator or int, optional
        Source of randomness, or its seed.

    Notes
    -----
    Positions are reachable to a billionth of the machine's size, as in `reachable_position`, which adds to the volume
    for limits nearly as narrow.
    """
    check_manipulator(machine, for_stage="For a stage see spm_pin.workspace.pose_volume, of heights and normals")
    if choice(method, "method", ("sampling", "mesh")) == "mesh":
        if where is not None:
            raise ArgumentError("where", 'None with the method "mesh"', type_and_value(where))
        coarse = reachable_boundary(machine, limits, spacing=spacing, progress=progress)
        fine = reachable_boundary(machine, limits, spacing=0.5 * coarse.spacing, progress=progress)
        return Estimate.from_meshes(coarse, fine)
    count = whole_number(samples, "samples", least=2)
    states, rng = states_within(machine, limits), generator(rng)
    points, region = start_table(states).draw_around(count, rng)
    member = search_states(states, points, what="reachable points", progress=shown_progress(progress))
    hits, undecided = member.reached, member.undecided
    if where is not None:
        hits = _with_condition(states, points, member, where, rng)
        undecided = undecided | (member.reached & ~hits)
    numbers = int(hits.sum()), int(undecided.sum())
    return Estimate.from_hits(numbers[0], count, region, CONFIDENCE, "share of uniform points", "m³", numbers[1])


def pose_volume(
    machine: Manipulator | Stage,
    limits: LegLimits | None = None,
    *,
    where: Condition | None = None,
    samples: int = 20_000,
    rng: np.random.Generator | int | None = None,
) -> Estimate:
    """Estimate the volume of the poses that are reachable in the physical mode, in m³ rad³; all rotations have 8π².

    For a stage it is the volume of the reachable heights and normals, in m sr; all normals have 4π.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    limits, rng
        As for `reachable_volume`.
    where : callable, optional
        Takes states (n,) and returns which of them count, (n,); all if not given. A state counts with one over the
        number of states of its pose, whether those count or not.
    samples : int
        States to draw.

    Notes
    -----
    States are drawn uniformly in coordinates of the stages, and weighted with |det ∂(o, R)/∂c| over the number of
    states with the same pose. A ratio of two such volumes, of the same seed, is a share of the poses. The interval is
    Student's; with `where` the wider of that and one of the effective number of states that count, in `method`.
    """
    count = whole_number(samples, "samples", least=2)
    states, rng = states_within(machine, limits), generator(rng)
    drawn = [states.draw_stages(stage, count, rng) for stage in range(len(states.aspects))]
    number = min(len(coordinates) for coordinates, _ in drawn)
    if number < 2:
        raise ArgumentError(
            "limits", "limits that enough random states are within", f"limits that {number} of {count} are within"
        )
    coordinates = np.stack([coordinates[:number] for coordinates, _ in drawn], axis=1)
    values, method = states.densities(coordinates), "change of variables from coordinates of the stages"
    unseen = None
    if where is not None:
        satisfied = check_condition(where, states.states(coordinates))
        values, method, unseen = _counting(values, satisfied, method)
    whole, unit = math.prod(volume for _, volume in drawn), "m sr" if len(drawn) == 1 else "m³ rad³"
    return Estimate.from_mean(values, whole, CONFIDENCE, method, unit, len(drawn) / number, unseen)


def _counting(values: FloatArray, satisfied: BoolArray, method: str) -> tuple[FloatArray, str, float]:
    """Return weights of the states (N,) that satisfy a condition, the method, and the weight of one not drawn."""
    hits = int(satisfied.sum())
    # The fewer states count, the larger is the uncertainty from states that were not drawn.
    unseen = float(np.quantile(values, _LARGE)) / max(hits, 1)
    return np.where(satisfied, values, 0.0), f"{method}; {hits} of {len(values)} states count", unseen


def _with_condition(
    states: StateSet, points: FloatArray, member: Membership, where: Condition, rng: np.random.Generator
) -> BoolArray:
    """Return at which points (N, 3) a state was found that satisfies a condition."""
    satisfied = np.zeros(len(points), dtype=np.bool_)
    satisfied[member.reached] = check_condition(where, states.states(member.coordinates[member.reached]))
    drawn = np.concatenate([states.sample, states.draw(len(states.sample), rng)])
    starts = drawn[check_condition(where, states.states(drawn))]
    if not len(starts):
        return satisfied
    nearest = KDTree(states.positions(starts)).query(points, min(_TRIED, len(starts)))[1].reshape(len(points), -1)
    for column in nearest.T:
        left = np.flatnonzero(member.reached & ~satisfied)
        moved = search_states(states, points[left], starts[column[left]])
        left, coordinates = left[moved.reached], moved.coordinates[moved.reached]
        satisfied[left] = check_condition(where, states.states(coordinates))
    return satisfied


@dataclass(frozen=True)
class OrientationWorkspace:
    """Orientations that can be reached at one position, or by a stage at one height; arrays over the n states found."""

    states: Configuration
    """States with o at the position, uniform in the coordinates of the lower stage, shape (n,)."""
    weights: FloatArray
    """Volume of the orientations that each state stands for, shape (n,); they add up to `volume.value`."""
    azimuth: FloatArray
    """Azimuth to which the platform's normal leans [rad], shape (n,)."""
    tilt: FloatArray
    """Angle of the platform's normal to the vertical [rad], shape (n,)."""
    torsion: FloatArray
    """Rotation about the platform's normal [rad], shape (n,)."""
    volume: Estimate
    """Volume of the orientations in rad³; all rotations measure 8π². For a stage that of the normals, of 4π sr."""

    def __repr__(self) -> str:
        return f"<OrientationWorkspace: {len(self.weights)} states, {self.volume}>"

    @property
    def share(self) -> Estimate:
        """Share of all rotations, for a stage of all normals."""
        return self.volume.times(1.0 / (NORMALS if self.volume.unit == "sr" else ROTATIONS), "")

    def largest_tilt(self, sectors: int = 36) -> tuple[FloatArray, FloatArray]:
        """Return the middles of `sectors` equal sectors of azimuth and the largest tilt found in each [rad].

        NaN for a sector without a state. The largest tilt of a sample is a little below the true one.
        """
        from scipy import stats

        number = whole_number(sectors, "sectors", least=1)
        largest, edges, _ = stats.binned_statistic(self.azimuth, self.tilt, "max", number, [(-np.pi, np.pi)])
        return 0.5 * (edges[1:] + edges[:-1]), np.asarray(largest, dtype=np.float64)


def _normals_of_stage(
    machine: Stage,
    height: float,
    limits: LegLimits | None = None,
    *,
    where: Condition | None = None,
    samples: int = 20_000,
    rng: np.random.Generator | int | None = None,
) -> OrientationWorkspace:
    level = read_heights(machine, height)
    if level.shape:
        raise ArgumentError("height", "one height, in metres", f"shape {level.shape}")
    count = whole_number(samples, "samples", least=2)
    states, rng = states_within(machine, limits), generator(rng)
    drawn, area = states.draw_stages(0, count, rng, float(level) / states.radius)
    coordinates = drawn[:, None]
    # The densities are those of heights, whose unit is r in the coordinates, and normals.
    weights = states.densities(coordinates) / states.radius
    return _orientations(states, coordinates, weights, area, len(drawn) or count, where)


@or_of_stage(_normals_of_stage)
def orientation_workspace(
    machine: Manipulator,
    position: npt.ArrayLike,
    limits: LegLimits | None = None,
    *,
    where: Condition | None = None,
    samples: int = 20_000,
    rng: np.random.Generator | int | None = None,
) -> OrientationWorkspace:
    """Find the orientations that the platform can have at a position in the physical mode.

    For a stage the position is its ``height`` [m], and the orientations are its normals, which are drawn uniformly.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    limits, rng
        As for `reachable_volume`.
    position : array_like, shape (3,)
        Position of o in {B} [m].
    where : callable, optional
        Takes states (n,) and returns which of them count, (n,), such as `JointLimits`; all if not given.
    samples : int
        States of the lower stage to try.

    Returns
    -------
    OrientationWorkspace
        Without states and of volume 0 where the position is out of reach, or hardly reached. The volume's interval is
        Student's; without states Clopper and Pearson's for the share of states, of all rotations, which is generous.

    Notes
    -----
    The coordinates u of the lower stage and the position determine those of the upper one, v, so the orientations have
    the volume ∫ |det ∂(o, R)/∂(u, v)| / |det ∂o/∂v| du over the lower stages for which the upper one is within its
    limits too. An orientation that several sets of lengths lead to is counted once. Where several upper stages see o in
    the same place, the one is taken that is nearest to pointing at it.
    """
    point = real_array(position, "position", (3,), "a position in metres").reshape(-1, 3)
    if len(point) != 1:
        raise ArgumentError("position", "one position of shape (3,), in metres", f"{len(point)} positions")
    count = whole_number(samples, "samples", least=2)
    states, rng = states_within(machine, limits), generator(rng)
    lower, region = states.draw_stages(0, count, rng)
    upper = states.upper_for(lower, point)
    index = np.flatnonzero(states.contains(1, upper))
    coordinates = np.stack([lower[index], upper[index]], axis=1)
    across = np.abs(np.linalg.det(states.jacobians(coordinates)[:, :3, 3:]))
    return _orientations(states, coordinates, states.densities(coordinates) / across, region, count, where)


def _orientations(
    states: StateSet, coordinates: FloatArray, weights: FloatArray, region: float, count: int, where: Condition | None
) -> OrientationWorkspace:
    """Return the orientations of states (n,) with weights (n,), of `count` stages drawn from a region of this size."""
    whole, unit = (NORMALS, "sr") if len(states.aspects) == 1 else (ROTATIONS, "rad³")
    found, method, unseen = states.states(coordinates), "change of variables from coordinates of one stage", None
    values = np.zeros(count)
    if where is not None:
        counts = check_condition(where, found)
        if len(weights):
            _, method, unseen = _counting(weights, counts, method)
        found, weights = found[counts], weights[counts]
    values[: len(weights)] = weights
    if len(weights) and count > 1:
        volume = Estimate.from_mean(values, region, CONFIDENCE, method, unit, 1.0 / count, unseen)
    else:
        volume = Estimate.from_hits(0, count, whole, CONFIDENCE, method, unit)
    return OrientationWorkspace(found, weights * region / count, *tilt_torsion(found.rotation), volume)


def tilt_torsion(rotation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return azimuth in [-π, π), tilt in [0, π] and torsion in [-π, π] of matrices (..., 3, 3) [rad]."""
    azimuth = np.arctan2(rotation[..., 1, 2], rotation[..., 0, 2])
    tilt = np.arctan2(np.hypot(rotation[..., 0, 2], rotation[..., 1, 2]), rotation[..., 2, 2])
    torsion = np.arctan2(rotation[..., 1, 0] - rotation[..., 0, 1], rotation[..., 0, 0] + rotation[..., 1, 1])
    return azimuth, tilt, torsion
