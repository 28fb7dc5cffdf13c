"""Run all methods on poses, certify their branches, compare the answers of every pair."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.methods import Method
from spm_pin.crosscheck.scores import MethodScore, PairDifference, Quantity
from spm_pin.crosscheck.tolerances import ROWS, Conditioning
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import BRANCHES, Configuration, Geometry, Status
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray
from spm_pin.mechanism.configuration import compared_points

_FORCE = 1e3
"""Largest component of the wrenches: forces [N], and moments over d [N]."""
_BRANCHES = len(BRANCHES)


@dataclass(frozen=True)
class _Answer:
    """The branches one method found at n poses; NaN where it found none or did not solve the pose."""

    states: Configuration
    """The branches of all poses, shape (8 n,)."""
    selected: BoolArray
    """Poses that the method was given, shape (n,)."""
    status: npt.NDArray[np.int8]
    """One `Status` per pose, shape (n,)."""
    rounding: FloatArray
    """Closure residuals that the method states [m], shape (8 n,)."""


@dataclass(frozen=True)
class _States:
    """Configurations (m,) at which methods are compared, each a branch of a pose."""

    configuration: Configuration
    """The configurations, shape (m,)."""
    place: IntArray
    """8 times the number of the pose in the batch, plus the number of the branch, shape (m,)."""
    first: int
    """Number of the pose of the report with which the batch begins."""
    rounding: Mapping[str, FloatArray]
    """Closure residuals [m] that each method states, by its name, shape (m,)."""


class Comparison:
    """Scores and differences of methods, over all poses added so far; the counts are those of `Report`.

    `describe_step` is called with a line of text before each part of the work. Two methods of the same name are an
    `ArgumentError`.
    """

    def __init__(self, geometry: Geometry, methods: Sequence[Method], describe_step: Callable[[str], None]) -> None:
        names = [method.name for method in methods]
        if len(set(names)) < len(names):
            raise ArgumentError("methods", "a name of its own for each", names)
        self.poses = self.reached = self.states = 0
        self.scores = {method.name: MethodScore(method.name, method.miss_rate) for method in methods}
        self._differences: dict[tuple[Quantity, str, str], PairDifference] = {}
        self._geometry = geometry
        self._methods = methods
        self._describe_step = describe_step
        self._solves_inverse = False

    @property
    def differences(self) -> tuple[PairDifference, ...]:
        """Differences of the pairs, quantity by quantity."""
        order = list(Quantity)
        return tuple(sorted(self._differences.values(), key=lambda pair: order.index(pair.quantity)))

    def add(self, poses: RigidTransform, selected: Mapping[str, BoolArray], rng: np.random.Generator) -> None:
        """Compare the methods at poses (n,), each solving those of its mask `selected` (n,); one must solve some."""
        states = self._compare_branches(poses, selected)
        if len(states.place):
            self._compare_rates_and_forces(states, rng)
        self.poses += len(poses)
        self.reached += len(np.unique(states.place // _BRANCHES))
        self.states += len(states.place)

    def _compare_branches(self, poses: RigidTransform, selected: Mapping[str, BoolArray]) -> _States:
        """Solve poses (n,) by every method and return the states that are proved.

        A branch is proved by the first method whose state closes to rounding and is isolated.
        """
        answers = {m.name: a for m in self._methods if (a := self._solve(m, poses, selected[m.name])) is not None}
        self._solves_inverse |= bool(answers)
        if not self._solves_inverse:
            raise ArgumentError("methods", "one at least that solves the inverse displacement", list(self.scores))
        joints = np.full((len(poses) * _BRANCHES, 3, 3), np.nan)
        # A pose with a continuous family has no list of branches to compare.
        regular = np.ones(len(joints), dtype=bool)
        for answer in reversed(answers.values()):
            with np.errstate(invalid="ignore"):
                closed = answer.states.closure_residual <= ROWS * answer.rounding
            certain = closed & Conditioning.of(answer.states).resolves(answer.rounding)
            joints[certain] = answer.states.middle_joints[certain]
            regular &= np.repeat(answer.status != Status.DEGENERATE, _BRANCHES)
        joints[~regular] = np.nan
        proved = self._configuration(poses, joints)
        for method in self._methods:
            if method.name in answers:
                self._score(method, answers[method.name], proved)
        place = np.flatnonzero(proved.exists)
        configuration = proved[place]
        states = _States(configuration, place, self.poses, {m.name: m.rounding(configuration) for m in self._methods})
        values = {name: a.states.middle_joints.reshape(-1, 9)[place] for name, a in answers.items()}
        self._compare(Quantity.POSITIONS, states, values, Conditioning.of(configuration).position)
        return states

    def _compare_rates_and_forces(self, states: _States, rng: np.random.Generator) -> None:
        """Compare inverse Jacobians, leg forces under random wrenches, and states assembled from joint values."""
        configuration, count = states.configuration, len(states.place)
        conditioning = Conditioning.of(configuration)
        side = self._geometry.middle_side
        wrench = _FORCE * rng.uniform(-1.0, 1.0, (count, 6)) * np.repeat([1.0, side], 3)
        rates: dict[str, FloatArray] = {}
        forces: dict[str, FloatArray] = {}
        assembled: dict[str, FloatArray] = {"given state": _points(configuration)}
        for method in self._methods:
            self._describe_step(f"{method.name}: Jacobians and forces")
            jacobian, force = method.inverse_jacobian(configuration), method.leg_forces(configuration, wrench)
            built = method.assembled(configuration)
            if jacobian is not None:
                rates[method.name] = (jacobian / np.repeat([1.0, side], 3)).reshape(-1, 36)
            if force is not None:
                forces[method.name] = force
            if built is not None:
                assembled[method.name] = _points(built)
        self._compare(Quantity.JACOBIAN, states, rates, conditioning.rates)
        size = np.nanmax([np.zeros(count), *(np.linalg.norm(force, axis=-1) for force in forces.values())], axis=0)
        self._compare(Quantity.FORCES, states, forces, lambda rounding: conditioning.forces(rounding) * size)
        self._compare(Quantity.ASSEMBLY, states, assembled, lambda rounding: ROWS * rounding)

    def _configuration(self, poses: RigidTransform, joints: FloatArray) -> Configuration:
        matrix = np.repeat(poses.as_matrix(), _BRANCHES, axis=0)
        return Configuration.from_arrays(self._geometry, matrix[:, :3, :3], matrix[:, :3, 3], joints)

    def _solve(self, method: Method, poses: RigidTransform, selected: BoolArray) -> _Answer | None:
        """Return a method's branches of poses (n,); None if it solves none of them."""
        if not selected.any():
            return None
        self._describe_step(f"{method.name}: branches")
        solutions = method.inverse(poses[selected])
        if solutions is None:
            return None
        joints = np.full((len(poses), _BRANCHES, 3, 3), np.nan)
        status = np.full(len(poses), Status.UNSOLVED, dtype=np.int8)
        joints[selected], status[selected] = solutions.middle_joints, solutions.status
        states = self._configuration(poses, joints.reshape(-1, 3, 3))
        with np.errstate(invalid="ignore"):
            return _Answer(states, selected, status, method.rounding(states))

    def _score(self, method: Method, answer: _Answer, proved: Configuration) -> None:
        """Count the branches a method invented, and those it missed although its arithmetic resolves them."""
        found = answer.states.exists
        with np.errstate(invalid="ignore"):
            share = answer.states.closure_residual / (ROWS * answer.rounding)
            resolved = Conditioning.of(proved).resolves(method.rounding(proved))
        invented = found & (share > 1.0)
        missed = (proved.exists & resolved & ~found).reshape(-1, _BRANCHES).any(axis=-1) & answer.selected
        score = self.scores[method.name]
        score.solved += int(answer.selected.sum())
        score.unsolved += int((answer.selected & (answer.status == Status.UNSOLVED)).sum())
        score.branches += int(found.sum())
        score.invented += int(invented.sum())
        score.missed += int(missed.sum())
        score.residual = max(score.residual, float(np.nanmax(share, initial=0.0)))
        if score.invented_at < 0:
            score.invented_at = self._first_pose(invented.reshape(-1, _BRANCHES).any(axis=-1))
        if score.missed_at < 0:
            score.missed_at = self._first_pose(missed)

    def _first_pose(self, marked: Any) -> int:
        return self.poses + int(marked.argmax()) if marked.any() else -1

    def _compare(
        self,
        quantity: Quantity,
        states: _States,
        values: Mapping[str, FloatArray],
        error: Callable[[FloatArray], FloatArray],
    ) -> None:
        """Compare the values (m, k) of every pair, and attribute outliers by majority."""
        count = len(states.place)
        allowance = {name: error(states.rounding.get(name, np.zeros(count))) for name in values}
        support = {name: np.zeros(count, dtype=int) for name in values}
        opposed = {name: np.zeros(count, dtype=bool) for name in values}
        for first, second in combinations(values, 2):
            difference = np.linalg.norm(values[first] - values[second], axis=-1)
            tolerance = allowance[first] + allowance[second]
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
            pose, branch = divmod(int(states.place[k]), _BRANCHES)
            pair = PairDifference(
                quantity,
                first,
                second,
                compared=int(both.sum()),
                disagreements=int(apart.sum()),
                worst=float(difference[k]),
                tolerance=float(tolerance[k]),
                pose=states.first + pose,
                branch=BRANCHES[branch],
            )
            key = (quantity, first, second)
            before = self._differences.get(key)
            self._differences[key] = pair if before is None else before.combined(pair)
        strongest = np.max(list(support.values()), axis=0, initial=0)
        for name in self.scores.keys() & values.keys():
            # Where two contradict each other and no third decides, either may be wrong.
            lost = opposed[name] & ((support[name] < strongest) | (strongest == 0))
            self.scores[name].outvoted += int(lost.sum())


def _points(configuration: Configuration) -> FloatArray:
    """Return the b_i and the c_i of states (m,) as rows (m, 18) [m]."""
    return compared_points(configuration).reshape(-1, 18)
