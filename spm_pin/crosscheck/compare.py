"""The hearing: everybody is asked, branches are proved or not, and pairs of answers compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.methods import Witness
from spm_pin.crosscheck.tolerances import ROWS, Conditioning
from spm_pin.crosscheck.verdicts import Comparison, Quantity, Standing
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solutions import Status

__all__ = ["Hearing"]

_CHUNK = 8
_FORCE = 1e3  # N, and N m per metre of d
_PLACES = len(BRANCHES)

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _Answer:
    """The branches one witness shows of N poses: NaN and not asked beyond its share."""

    states: Configuration  # (N * 8,)
    asked: BoolArray  # (N,)
    status: npt.NDArray[np.int8]  # (N,)


@dataclass(frozen=True)
class _States:
    """Configurations (m,) that witnesses are compared at, each a branch of a pose."""

    configuration: Configuration
    place: IntArray  # pose * 8 + branch
    roundings: Mapping[str, FloatArray]


class Hearing:
    """Asks witnesses and keeps what comes out.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    witnesses : list of Witness
        Who is asked.
    progress : callable
        Called with what is being done, how many steps are done, and of how many.

    Raises
    ------
    ArgumentError
        If two have the same name.
    """

    def __init__(self, geometry: Geometry, witnesses: list[Witness], progress: Progress) -> None:
        names = [witness.name for witness in witnesses]
        if len(set(names)) < len(names):
            raise ArgumentError("witnesses", "a name of its own for each", names)
        self.comparisons: list[Comparison] = []
        self._geometry = geometry
        self._witnesses = witnesses
        self._progress = progress
        self._standings = {w.name: Standing(w.name, allowed=w.miss_rate) for w in witnesses}

    @property
    def standings(self) -> tuple[Standing, ...]:
        """What each witness is worth so far."""
        return tuple(self._standings.values())

    def branches(self, sample: RigidTransform) -> Configuration:
        """Ask for the branches of poses (N,); return those that are proved, NaN elsewhere, shape (N * 8,).

        A branch is proved by the first witness whose state closes to rounding and is isolated.
        """
        answers = {w.name: a for w in self._witnesses if (a := self._ask(w, sample)) is not None}
        if not answers:
            names = [witness.name for witness in self._witnesses]
            raise ArgumentError("witnesses", "one at least that solves the inverse displacement", names)
        witnesses = [witness for witness in self._witnesses if witness.name in answers]
        real = {w.name: self._closing(w, answers[w.name]) for w in witnesses}
        joints = np.full((len(sample) * _PLACES, 3, 3), np.nan)
        # A pose with a continuous family has no list of branches to compare.
        regular = np.ones(len(sample) * _PLACES, dtype=bool)
        for witness in reversed(witnesses):
            answer = answers[witness.name]
            joints[real[witness.name]] = answer.states.middle_joints[real[witness.name]]
            regular &= np.repeat(answer.status != Status.DEGENERATE, _PLACES)
        joints[~regular] = np.nan
        first = next(iter(answers.values())).states
        proved = Configuration.from_arrays(self._geometry, first.rotation, first.translation, joints)
        for witness in witnesses:
            self._judge(witness, answers[witness.name], real[witness.name], proved)
        states = self._existing(proved)
        values = {name: a.states.middle_joints.reshape(-1, 9)[states.place] for name, a in answers.items()}
        self._compare(Quantity.POSITIONS, states, values, Conditioning.of(states.configuration).position)
        return proved

    def states(self, proved: Configuration, rng: np.random.Generator) -> int:
        """Ask about Jacobians and forces at the states that exist, and return how many there are."""
        states = self._existing(proved)
        configuration, count = states.configuration, len(states.place)
        if not count:
            return 0
        conditioning = Conditioning.of(configuration)
        side = self._geometry.middle_side
        wrench = _FORCE * rng.uniform(-1.0, 1.0, (count, 6)) * np.repeat([1.0, side], 3)
        rates: dict[str, FloatArray] = {}
        forces: dict[str, FloatArray] = {}
        assembled: dict[str, FloatArray] = {"asked for": _points(configuration)}
        for witness in self._witnesses:
            self._progress(f"{witness.name}: Jacobians and forces", 0, count)
            jacobian, force = witness.inverse_jacobian(configuration), witness.leg_forces(configuration, wrench)
            built = witness.assembled(configuration)
            if jacobian is not None:
                rates[witness.name] = (jacobian / np.repeat([1.0, side], 3)).reshape(-1, 36)
            if force is not None:
                forces[witness.name] = force
            if built is not None:
                assembled[witness.name] = _points(built)
            self._progress(f"{witness.name}: Jacobians and forces", count, count)
        self._compare(Quantity.JACOBIAN, states, rates, conditioning.rates)
        size = np.nanmax([np.zeros(count), *(np.linalg.norm(force, axis=-1) for force in forces.values())], axis=0)
        self._compare(Quantity.FORCES, states, forces, lambda rounding: conditioning.forces(rounding) * size)
        self._compare(Quantity.ASSEMBLY, states, assembled, lambda rounding: ROWS * rounding)
        return count

    def _ask(self, witness: Witness, sample: RigidTransform) -> _Answer | None:
        total = len(sample)
        count = max(1, round(witness.share * total))
        matrix = sample.as_matrix()
        joints = np.full((total, _PLACES, 3, 3), np.nan)
        status = np.full(total, Status.UNSOLVED, dtype=np.int8)
        for begin in range(0, count, _CHUNK):
            self._progress(f"{witness.name}: branches", begin, count)
            part = slice(begin, min(begin + _CHUNK, count))
            solutions = witness.inverse(sample[part])
            if solutions is None:
                return None
            joints[part], status[part] = solutions.middle_joints, solutions.status
        self._progress(f"{witness.name}: branches", count, count)
        repeated = np.repeat(matrix, _PLACES, axis=0)
        flat = joints.reshape(-1, 3, 3)
        states = Configuration.from_arrays(self._geometry, repeated[:, :3, :3], repeated[:, :3, 3], flat)
        return _Answer(states, np.arange(total) < count, status)

    def _closing(self, witness: Witness, answer: _Answer) -> BoolArray:
        """Tell which states (N * 8,) of a witness are proved."""
        states = answer.states
        with np.errstate(invalid="ignore"):
            rounding = witness.rounding(states)
            closed = states.closure_residual <= ROWS * rounding
            return np.asarray(closed & Conditioning.of(states).told_apart(rounding))

    def _judge(self, witness: Witness, answer: _Answer, real: BoolArray, proved: Configuration) -> None:
        """Count what a witness invented, and what it missed though its arithmetic could have told it apart."""
        shown, rounding = answer.states.exists, witness.rounding(answer.states)
        with np.errstate(invalid="ignore"):
            share = answer.states.closure_residual / (ROWS * rounding)
            invented = shown & (share > 1.0)
            could = Conditioning.of(proved).told_apart(witness.rounding(proved))
        lacking = (proved.exists & could & ~shown).reshape(-1, _PLACES).any(axis=-1) & answer.asked
        wrong = invented.reshape(-1, _PLACES).any(axis=-1)
        poses = np.flatnonzero(wrong) if wrong.any() else np.flatnonzero(lacking)
        self._standings[witness.name] = replace(
            self._standings[witness.name],
            solved=int(answer.asked.sum()),
            abstained=int((answer.asked & (answer.status == Status.UNSOLVED)).sum()),
            branches=int(shown.sum()),
            invented=int(invented.sum()),
            missed=int(lacking.sum()),
            residual=float(np.nanmax(share, initial=0.0)),
            pose=int(poses[0]) if poses.size else -1,
        )

    def _existing(self, proved: Configuration) -> _States:
        place = np.flatnonzero(proved.exists)
        configuration = proved[place]
        return _States(configuration, place, {w.name: w.rounding(configuration) for w in self._witnesses})

    def _compare(
        self,
        quantity: Quantity,
        states: _States,
        values: Mapping[str, FloatArray],
        error: Callable[[FloatArray], FloatArray],
    ) -> None:
        """Compare values (m, k) of every pair, and blame whoever has fewer on its side."""
        allowance = {name: error(states.roundings.get(name, np.zeros(len(states.place)))) for name in values}
        support = {name: np.zeros(len(states.place), dtype=int) for name in values}
        opposed = {name: np.zeros(len(states.place), dtype=bool) for name in values}
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
            pose, branch = divmod(int(states.place[k]), _PLACES)
            self.comparisons.append(
                Comparison(
                    quantity,
                    first,
                    second,
                    int(both.sum()),
                    int(apart.sum()),
                    float(difference[k]),
                    float(tolerance[k]),
                    pose,
                    BRANCHES[branch],
                )
            )
        if not values:
            return
        strongest = np.max(list(support.values()), axis=0)
        for name in self._standings.keys() & values.keys():
            # Two who contradict each other and no third: either may be wrong.
            lost = opposed[name] & ((support[name] < strongest) | (strongest == 0))
            standing = self._standings[name]
            self._standings[name] = replace(standing, blame=standing.blame + int(lost.sum()))


def _points(configuration: Configuration) -> FloatArray:
    """Return the b_i and the c_i of states (m,) as rows (m, 18) [m]."""
    both = np.concatenate([configuration.middle_joints, configuration.platform_joints], axis=-2)
    return both.reshape(-1, 18)
