"""Comparison of methods on random poses of a manipulator, or tilts and heights of a stage: scores and the report.

A branch is real if its loop equations hold and it is isolated; this is measured, not voted on. A method whose
branch does not close has invented it. A method that lacks a branch which another method proved has missed it, and may
do so as often as it states. Positions, Jacobians and forces are compared in pairs; if a pair differs by more than
conditioning and rounding explain, the outlier is attributed by majority.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.ball_states import closure_residuals, freedoms, states_with_balls
from spm_pin.crosscheck.methods import Method, make_methods
from spm_pin.crosscheck.random_poses import in_leg_space, on_all_rotations, printable
from spm_pin.crosscheck.tolerances import ROWS, Conditioning
from spm_pin.errors import ArgumentError
from spm_pin.machine import Manipulator, Status
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, Progress, whole_number
from spm_pin.support.pose import inverse_command

LEG_SPACE = 0.8
"""Share of the poses drawn in leg space; the rest have rotations from all of SO(3)."""
_BATCH = 10
"""Poses compared before each report."""
_FORCE = 1e3
"""Largest component of the wrenches: forces [N], and moments over d [N]."""
_UNLIKELY = 1e-6
"""A number of missed branches less probable than this at a method's stated rate counts as a fault."""
_FAR = 1e9
"""Distance [m] beyond that of any two branches."""


class Quantity(enum.StrEnum):
    """Quantities that are compared."""

    POSITIONS = "middle joints"
    ASSEMBLY = "assembly"
    JACOBIAN = "inverse Jacobian"
    FORCES = "leg forces"

    @property
    def unit(self) -> str:
        """Unit of the differences."""
        return {"inverse Jacobian": "", "leg forces": "N"}.get(self.value, "m")


@dataclass(frozen=True)
class PairDifference:
    """Difference of two methods in one quantity, over all poses.

    Those of Jacobians are norms with angles times d.
    """

    quantity: Quantity
    """The quantity compared."""
    first: str
    """Name of the first method."""
    second: str
    """Name of the second method."""
    compared: int
    """Number of states at which both answered."""
    disagreements: int
    """Number of those at which they differ by more than the tolerance."""
    worst: float
    """Difference where its ratio to the tolerance is largest, in the quantity's unit."""
    tolerance: float
    """Tolerance there, in the same unit."""
    pose: int
    """Number of the pose where that is, counted as in the report."""
    branch: str
    """Branch of that pose, by its label in the first method that finds branches."""

    @property
    def ratio(self) -> float:
        """The largest difference in units of its tolerance."""
        return self.worst / self.tolerance if self.compared else 0.0

    def combined(self, other: PairDifference) -> PairDifference:
        """Return the difference over the states of both; the pair and the quantity must be the same."""
        compared, disagreements = self.compared + other.compared, self.disagreements + other.disagreements
        larger = max(self, other, key=lambda pair: pair.ratio)
        return replace(larger, compared=compared, disagreements=disagreements)


@dataclass
class MethodScore:
    """Counts of one method: branches found, invented and missed, comparisons lost."""

    name: str
    """The method's name."""
    allowed: float = 0.0
    """Share of poses at which it may miss a branch, as it states."""
    solved: int = 0
    """Number of poses it was given."""
    unsolved: int = 0
    """Number of those that it reported as unsolved."""
    branches: int = 0
    """Number of branches it found."""
    invented: int = 0
    """Number of those whose loops do not close."""
    missed: int = 0
    """Number of poses at which it lacks a branch that another method proved, those left unsolved included."""
    outvoted: int = 0
    """Number of comparisons in which a majority of the methods contradicts it."""
    residual: float = 0.0
    """Largest closure residual in units of the one it states."""
    invented_at: int = -1
    """Pose of the first branch invented; -1 if missing."""
    missed_at: int = -1
    """Pose of the first branch missed; -1 if missing."""

    @property
    def pose(self) -> int:
        """Pose of the first branch invented, else of the first missed, else -1."""
        return self.invented_at if self.invented else self.missed_at

    @property
    def misses_too_often(self) -> bool:
        """True if the misses are more than the stated rate makes likely."""
        return self.missed > 0 and float(scipy.stats.binom.sf(self.missed - 1, self.solved, self.allowed)) < _UNLIKELY

    @property
    def faults(self) -> int:
        """Number of wrong answers."""
        return self.invented + self.outvoted + (self.missed if self.misses_too_often else 0)


@dataclass(frozen=True)
class Report:
    """The outcome of a comparison."""

    machine: Machine
    """The manipulator or the stage."""
    seed: int
    """Seed of the poses and wrenches."""
    requested: int
    """Number of poses asked for; the report of a run that was interrupted has fewer."""
    requests: dict[str, FloatArray]
    """The poses compared, as options of the command line: `translation` [m] and `xyx` in degrees, shape (N, 3) each.

    For a stage they are `height` [m], `roll` and `pitch` in degrees, shape (N,) each.
    """
    reached: int
    """Number of poses with a branch."""
    states: int
    """Number of configurations at which Jacobians and forces were compared."""
    scores: tuple[MethodScore, ...]
    """One per method."""
    differences: tuple[PairDifference, ...]
    """One per pair and quantity."""

    @property
    def poses(self) -> int:
        """Number of poses compared."""
        return len(next(iter(self.requests.values())))

    @property
    def agrees(self) -> bool:
        """True if no method has a fault and no pair differs."""
        return not any(p.disagreements for p in self.differences) and not any(s.faults for s in self.scores)

    @property
    def outliers(self) -> tuple[str, ...]:
        """The methods with the most faults; several where two disagree and no third was compared."""
        most = max((score.faults for score in self.scores), default=0)
        return tuple(s.name for s in self.scores if most and s.faults == most)

    @property
    def worst(self) -> PairDifference | None:
        """The largest difference in units of its tolerance."""
        return max(self.differences, key=lambda pair: pair.ratio, default=None)

    @property
    def verdict(self) -> str:
        """One sentence: that the methods agree, or which do not."""
        if self.agrees and len(self.scores) == 1:
            return f"Only {self.scores[0].name} was run, and its branches close."
        if self.agrees:
            return f"{'Both' if len(self.scores) == 2 else f'All {len(self.scores)}'} methods agree."
        if not self.outliers:
            return "The methods disagree."
        if len(self.outliers) > 1:
            return f"{' and '.join(self.outliers)} contradict each other; a third method can decide."
        why = "the others agree" if len(self.scores) > 2 else "branches that it found or lost contradict the equations"
        return f"{self.outliers[0]} is wrong: {why}."

    def command(self, pose: int, machine_file: str | None = None) -> str:
        """Return the command line that solves a pose of this report, FILE if no file of the machine is given."""
        if machine_file is None and self.machine != Manipulator.paper():
            machine_file = "FILE"
        return inverse_command({name: numbers[pose] for name, numbers in self.requests.items()}, machine_file)


def compare_in_batches(
    machine: Machine,
    *,
    poses: int = 200,
    seed: int = 0,
    methods: Sequence[Method | str] | None = None,
    progress: Progress | None = None,
) -> Iterator[Report]:
    """Compare methods and yield the report after each batch of poses; the last one covers all.

    Parameters and errors are those of `compare_methods`.
    """
    poses = whole_number(poses, "poses", "a whole number, at least 1", least=1)
    seed = whole_number(seed, "seed", "a whole number, at least 0", most=1 << 128)
    check_machine(machine)
    rng = np.random.default_rng(seed)
    inner = max(1, round(LEG_SPACE * poses))
    drawn = [in_leg_space(machine, inner, rng), on_all_rotations(machine, poses - inner, rng)]
    matrices = np.concatenate([part.as_matrix() for part in drawn])[rng.permutation(poses)]
    sample, requests = printable(machine, RigidTransform.from_matrix(matrices))
    made = make_methods(methods, machine)
    done = 0

    def step(description: str) -> None:
        if progress is not None:
            progress(description, done, poses)

    comparison = _Comparison(machine, made, step)
    # Slow methods compute only some of the poses, at least one, evenly distributed.
    counts = {method.name: max(1, round(method.share * poses)) for method in made}
    selected = {name: np.arange(poses) * count % poses < count for name, count in counts.items()}
    while done < poses:
        batch = slice(done, min(done + _BATCH, poses))
        comparison.add(sample[batch], {name: mask[batch] for name, mask in selected.items()}, rng)
        done = comparison.poses
        step("compared")
        yield Report(
            machine,
            seed,
            poses,
            {name: numbers[:done] for name, numbers in requests.items()},
            comparison.reached,
            comparison.states,
            tuple(map(copy, comparison.scores.values())),
            comparison.differences,
        )


def compare_methods(
    machine: Machine,
    *,
    poses: int = 200,
    seed: int = 0,
    methods: Sequence[Method | str] | None = None,
    progress: Progress | None = None,
) -> Report:
    """Run methods on random poses and compare all their answers.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine, nominal or calibrated. A numerical search has no labels for a calibrated manipulator and for a
        stage: its branches are compared as sets, each paired with the nearest of those found by the previous methods.
    poses : int
        Number of poses; four fifths of them in leg space.
    seed : int
        Seed of the poses and of the wrenches.
    methods : sequence of Method or of str, optional
        The methods, one of which solves the inverse displacement; all of `METHODS` that can be imported if not given.
    progress : callable, optional
        Called with a description of the step, the number of poses compared, and of how many.
    """
    *_, report = compare_in_batches(machine, poses=poses, seed=seed, methods=methods, progress=progress)
    return report


class _Answer(NamedTuple):
    """The branches one method found at n poses; NaN where it found none or did not solve the pose."""

    states: Any
    """The branches of all poses, shape (m n,) with m labels."""
    residual: FloatArray
    """Violations of the loop equations and of the requests [m], shape (m n,)."""
    selected: BoolArray
    """Poses that the method was given, shape (n,)."""
    status: npt.NDArray[np.int8]
    """One `Status` per pose, shape (n,)."""
    rounding: FloatArray
    """Closure residuals that the method states [m], shape (m n,)."""


class _Comparison:
    """Scores and differences of methods, over all poses added so far; the counts are those of `Report`.

    `describe_step` is called with a line of text before each part of the work.
    """

    def __init__(self, machine: Machine, methods: Sequence[Method], describe_step: Callable[[str], None]) -> None:
        names = [method.name for method in methods]
        if len(set(names)) < len(names):
            raise ArgumentError("methods", "methods with different names", names)
        self.poses = self.reached = self.states = 0
        self.scores = {method.name: MethodScore(method.name, method.miss_rate) for method in methods}
        self._differences: dict[tuple[Quantity, str, str], PairDifference] = {}
        self._machine = machine
        self._methods = methods
        self._describe_step = describe_step
        self._labels: tuple[str, ...] = ()
        self._known: FloatArray | None = None
        """The branches of the batch, (n, m, 3, 3): those of the first method, and what others add where it has none."""

    @property
    def differences(self) -> tuple[PairDifference, ...]:
        """Differences of the pairs, quantity by quantity."""
        order = list(Quantity)
        return tuple(sorted(self._differences.values(), key=lambda pair: order.index(pair.quantity)))

    def add(self, poses: RigidTransform, selected: Mapping[str, BoolArray], rng: np.random.Generator) -> None:
        """Compare the methods at poses (n,), each solving those of its mask `selected` (n,); one must solve some."""
        self._known = None
        answers = {}
        for method in self._methods:
            answer = self._solve(method, poses, selected[method.name])
            if answer is not None:
                answers[method.name] = answer
        if not self._labels:
            raise ArgumentError("methods", "one at least that solves the inverse displacement", list(self.scores))
        proved = self._proved(poses, list(answers.values()))
        for method in self._methods:
            if method.name in answers:
                self._score(method, answers[method.name], proved)
        place = np.flatnonzero(proved.exists)
        if len(place):
            joints = {name: _lower_balls(answer.states)[place].reshape(-1, 9) for name, answer in answers.items()}
            self._compare_states(proved[place], place, joints, rng)
        self.poses += len(poses)
        self.reached += len(np.unique(place // len(self._labels)))
        self.states += len(place)

    def _solve(self, method: Method, poses: RigidTransform, selected: BoolArray) -> _Answer | None:
        """Return a method's branches of poses (n,); None if it solves none of them.

        Those with other labels than the first method's are put into the order of the branches `_known`.
        """
        if not selected.any():
            return None
        self._describe_step(f"{method.name}: branches")
        solutions = method.inverse(poses[selected])
        if solutions is None:
            return None
        labels = self._labels = self._labels or solutions.labels
        joints = np.full((len(poses), len(labels), 3, 3), np.nan)
        status = np.full(len(poses), Status.UNSOLVED, dtype=np.int8)
        joints[selected], status[selected] = _lower_balls(solutions.configurations), solutions.status
        known = self._known = joints.copy() if self._known is None else self._known
        for before, branches in zip(known, joints, strict=True):
            if solutions.labels != labels:
                distance = np.linalg.norm((before[:, None] - branches).reshape(len(labels), -1, 9), axis=-1)
                # What is absent is paired last.
                order = scipy.optimize.linear_sum_assignment(np.nan_to_num(distance, nan=_FAR))[1]
                branches[:] = branches[order]
            np.copyto(before, branches, where=np.isnan(before))
        flat = joints.reshape(-1, 3, 3)
        states, requested = self._states(poses, flat)
        with np.errstate(invalid="ignore"):
            residual = closure_residuals(states, requested, flat)
            return _Answer(states, residual, selected, status, method.rounding(states))

    def _proved(self, poses: RigidTransform, answers: Sequence[_Answer]) -> Any:
        """Return the branches (m n,) of the first method whose state closes to rounding and is isolated."""
        joints = np.full((len(poses) * len(self._labels), 3, 3), np.nan)
        for answer in reversed(answers):
            with np.errstate(invalid="ignore"):
                closed = answer.residual <= ROWS * answer.rounding
            certain = closed & Conditioning.from_configuration(answer.states).resolves(answer.rounding)
            joints[certain] = _lower_balls(answer.states)[certain]
        for answer in answers:
            # A pose with a continuous family has no list of branches to compare.
            joints[np.repeat(answer.status == Status.DEGENERATE, len(self._labels))] = np.nan
        return self._states(poses, joints)[0]

    def _states(self, poses: RigidTransform, joints: FloatArray) -> tuple[Any, FloatArray]:
        """Return the states with joints (m n, 3, 3), and their requests (m n, 4, 4)."""
        matrix = np.repeat(poses.as_matrix(), len(self._labels), axis=0)
        return states_with_balls(self._machine, matrix, joints), matrix

    def _score(self, method: Method, answer: _Answer, proved: Any) -> None:
        """Count the branches a method invented, and those it missed although its arithmetic resolves them."""
        exists = answer.states.exists
        with np.errstate(invalid="ignore"):
            share = answer.residual / (ROWS * answer.rounding)
            resolved = Conditioning.from_configuration(proved).resolves(method.rounding(proved))
        invented = exists & (share > 1.0)
        count = len(self._labels)
        missed = (proved.exists & resolved & ~exists).reshape(-1, count).any(axis=-1) & answer.selected
        score = self.scores[method.name]
        score.solved += int(answer.selected.sum())
        score.unsolved += int((answer.selected & (answer.status == Status.UNSOLVED)).sum())
        score.branches += int(exists.sum())
        score.invented += int(invented.sum())
        score.missed += int(missed.sum())
        score.residual = max(score.residual, float(np.nanmax(share, initial=0.0)))
        for name, marked in (("invented_at", invented.reshape(-1, count).any(axis=-1)), ("missed_at", missed)):
            if getattr(score, name) < 0 and marked.any():
                setattr(score, name, self.poses + int(marked.argmax()))

    def _compare_states(
        self, states: Any, place: IntArray, joints: dict[str, FloatArray], rng: np.random.Generator
    ) -> None:
        """Compare all answers at proved branches (m,), whose `place` is pose times number of labels plus label."""
        count, machine = len(place), self._machine
        per_angle = np.repeat([1.0, machine.ball_side], 3)
        # Rates and forces of the actuators in units of those of rods.
        slopes = machine.legs.largest_slopes
        conditioning = Conditioning.from_configuration(states)
        rounding = {method.name: method.rounding(states) for method in self._methods}
        wrench = _FORCE * rng.uniform(-1.0, 1.0, (count, 6)) * per_angle
        rates: dict[str, FloatArray] = {}
        forces: dict[str, FloatArray] = {}
        assembled: dict[str, FloatArray] = {"given state": states.compared_points.reshape(count, -1)}
        for method in self._methods:
            self._describe_step(f"{method.name}: Jacobians and forces")
            jacobian, force = method.inverse_jacobian(states), method.leg_forces(states, wrench)
            built = method.assembled(states)
            if jacobian is not None:
                rates[method.name] = (slopes[:, None] * jacobian / per_angle[freedoms(machine)]).reshape(count, -1)
            if force is not None:
                forces[method.name] = force / slopes
            if built is not None:
                assembled[method.name] = built.compared_points.reshape(count, -1)
        size = np.nanmax([np.zeros(count), *(np.linalg.norm(force, axis=-1) for force in forces.values())], axis=0)
        if machine.is_stage:
            size = size + np.linalg.norm(wrench / per_angle, axis=-1)
        quantities: dict[Quantity, tuple[dict[str, FloatArray], Callable[[FloatArray], FloatArray]]] = {
            Quantity.POSITIONS: (joints, conditioning.position),
            Quantity.JACOBIAN: (rates, conditioning.rates),
            Quantity.FORCES: (forces, lambda residual: conditioning.forces(residual) * size),
            Quantity.ASSEMBLY: (assembled, lambda residual: ROWS * residual),
        }
        for quantity, (values, error) in quantities.items():
            allowed = {name: error(rounding.get(name, np.zeros(count))) for name in values}
            self._compare(quantity, place, values, allowed)

    def _compare(
        self, quantity: Quantity, place: IntArray, values: dict[str, FloatArray], allowed: dict[str, FloatArray]
    ) -> None:
        """Compare the values (m, k) of every pair, each with its allowed error (m,), and find outliers by majority."""
        support = {name: np.zeros(len(place), dtype=int) for name in values}
        opposed = {name: np.zeros(len(place), dtype=bool) for name in values}
        for first, second in combinations(values, 2):
            difference = np.linalg.norm(values[first] - values[second], axis=-1)
            tolerance = allowed[first] + allowed[second]
            both = ~np.isnan(difference) & ~np.isnan(tolerance)
            with np.errstate(invalid="ignore"):
                apart = both & (difference > tolerance)
                ratio = np.where(both, difference / tolerance, -1.0)
            for name in (first, second):
                support[name] += both & ~apart
                opposed[name] |= apart
            if not both.any():
                continue
            k = int(ratio.argmax())
            pose, branch = divmod(int(place[k]), len(self._labels))
            counts = int(both.sum()), int(apart.sum()), float(difference[k]), float(tolerance[k])
            pair = PairDifference(quantity, first, second, *counts, self.poses + pose, self._labels[branch])
            before = self._differences.get((quantity, first, second))
            self._differences[quantity, first, second] = pair if before is None else before.combined(pair)
        strongest = np.max(list(support.values()), axis=0, initial=0)
        for name in self.scores.keys() & values.keys():
            # Where two contradict each other and no third decides, either may be wrong.
            lost = opposed[name] & ((support[name] < strongest) | (strongest == 0))
            self.scores[name].outvoted += int(lost.sum())


def _lower_balls(states: Any) -> FloatArray:
    """Return the balls of the lower legs, or of a stage, by which branches are compared, (..., 3, 3)."""
    return np.asarray(states.balls[..., :3, :])
