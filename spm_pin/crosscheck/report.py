"""Comparison of methods on random poses: the runs, and the report they end in.

A branch is real if its nine loop equations hold and it is isolated; this is measured, not voted on. A method whose
branch does not close has invented it. One that lacks a branch which another method proved has missed it, and may do
so as often as it states. Positions, Jacobians and forces are compared by pairs; where a pair differs by more than
conditioning and rounding explain, the outlier is attributed by majority.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.compare import Comparison
from spm_pin.crosscheck.methods import Method, make_methods
from spm_pin.crosscheck.random_poses import command, in_leg_space, on_all_rotations, printable
from spm_pin.crosscheck.scores import MethodScore, PairDifference
from spm_pin.mechanism.arguments import BoolArray, FloatArray, Progress, whole_number
from spm_pin.mechanism.geometry import Geometry

LEG_SPACE = 0.8
"""Share of the poses drawn in leg space; the rest have rotations from all of SO(3)."""
_BATCH = 10
"""Poses compared before each report."""


@dataclass(frozen=True)
class Report:
    """The outcome of a comparison."""

    geometry: Geometry
    """The manipulator."""
    seed: int
    """Seed of the poses and wrenches."""
    requested: int
    """Number of poses asked for; the report of a run that was interrupted has fewer."""
    translation: FloatArray
    """Positions of o at the poses compared, in {B} [m], shape (N, 3)."""
    xyx: FloatArray
    """Their X-Y-X angles in degrees, shape (N, 3)."""
    reached: int
    """Number of poses with a branch."""
    states: int
    """Number of configurations at which Jacobians and forces were compared."""
    scores: tuple[MethodScore, ...]
    """One per method."""
    differences: tuple[PairDifference, ...]
    """One per pair and quantity."""

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
            return f"All {len(self.scores)} methods agree."
        if not self.outliers:
            return "The methods disagree."
        if len(self.outliers) > 1:
            return f"{' and '.join(self.outliers)} contradict each other; a third method can decide."
        return f"{self.outliers[0]} is wrong: the others agree."

    def command(self, pose: int, geometry_file: str | None = None) -> str:
        """Return the command line that solves a pose of this report; without a file, for the paper's geometry."""
        return command(self.translation[pose], self.xyx[pose], geometry_file)


def compare_in_batches(
    geometry: Geometry,
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
    rng = np.random.default_rng(seed)
    inner = max(1, round(LEG_SPACE * poses))
    drawn = [in_leg_space(geometry, inner, rng), on_all_rotations(geometry, poses - inner, rng)]
    matrices = np.concatenate([part.as_matrix() for part in drawn])[rng.permutation(poses)]
    sample, translation, xyx = printable(RigidTransform.from_matrix(matrices))
    made = make_methods(methods, geometry)
    done = 0

    def step(description: str) -> None:
        if progress is not None:
            progress(description, done, poses)

    comparison = Comparison(geometry, made, step)
    selected = {method.name: _spread(method.share, poses) for method in made}
    while done < poses:
        batch = slice(done, min(done + _BATCH, poses))
        comparison.add(sample[batch], {name: mask[batch] for name, mask in selected.items()}, rng)
        done = comparison.poses
        step("compared")
        yield Report(
            geometry,
            seed,
            poses,
            translation[:done],
            xyx[:done],
            comparison.reached,
            comparison.states,
            tuple(map(copy, comparison.scores.values())),
            comparison.differences,
        )


def compare_methods(
    geometry: Geometry,
    *,
    poses: int = 200,
    seed: int = 0,
    methods: Sequence[Method | str] | None = None,
    progress: Progress | None = None,
) -> Report:
    """Run methods on random poses and compare all their answers.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    poses : int
        Number of poses; four fifths of them in leg space.
    seed : int
        Seed of the poses and of the wrenches.
    methods : sequence of Method or of str, optional
        The methods; all of `METHODS` that can be imported if not given. States at which Jacobians and forces are
        compared come from the first that solves the inverse displacement.
    progress : callable, optional
        Called with a description of the step, the number of poses compared, and of how many.

    Raises
    ------
    ArgumentError
        If an argument is none of these, or no method solves the inverse displacement.
    ImportError
        If a method named needs a package that is missing.
    """
    *_, report = compare_in_batches(geometry, poses=poses, seed=seed, methods=methods, progress=progress)
    return report


def _spread(share: float, poses: int) -> BoolArray:
    """Return a mask (poses,) of a share of the poses, at least one, evenly spread."""
    count = max(1, round(share * poses))
    return np.asarray(np.arange(poses) * count % poses < count)
