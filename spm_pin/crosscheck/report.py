"""Where the witnesses meet: the same questions, every pair of answers, and who is wrong if they differ.

A branch is real if its nine loop equations hold and it is isolated; this is measured, not voted on. A witness that
shows a branch which does not close has invented it. One that lacks a branch which another proved has missed it,
and may do so as often as it states. Positions, Jacobians and forces are compared by pairs; where a pair differs by
more than conditioning and rounding explain, the one with fewer others on its side is to blame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.compare import Hearing
from spm_pin.crosscheck.methods import Witness, make
from spm_pin.crosscheck.sampling import command, in_leg_space, on_all_rotations, printable
from spm_pin.crosscheck.verdicts import Comparison, Standing
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry

__all__ = ["Report", "crosscheck"]

LEG_SPACE = 0.8
"""Share of the poses drawn in leg space; the rest have rotations from all of SO(3)."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Report:
    """The outcome of a cross-check.

    Attributes
    ----------
    geometry : Geometry
        The manipulator.
    seed : int
        Of the poses and wrenches.
    translation, xyx : ndarray, shape (N, 3)
        The poses: [m], and X-Y-X angles in degrees.
    reached : int
        Poses with a branch.
    states : int
        Configurations at which Jacobians and forces were compared.
    standings : tuple of Standing
        One per witness.
    comparisons : tuple of Comparison
        One per pair and quantity.
    """

    geometry: Geometry
    seed: int
    translation: FloatArray
    xyx: FloatArray
    reached: int
    states: int
    standings: tuple[Standing, ...]
    comparisons: tuple[Comparison, ...]

    @property
    def agrees(self) -> bool:
        """Whether every answer is right as far as anyone can tell."""
        return not any(c.disagreements for c in self.comparisons) and not any(s.faults for s in self.standings)

    @property
    def culprits(self) -> tuple[str, ...]:
        """The witnesses most to blame; several where two disagree and no third was asked."""
        most = max((standing.faults for standing in self.standings), default=0)
        return tuple(s.name for s in self.standings if most and s.faults == most)

    @property
    def worst(self) -> Comparison | None:
        """The comparison with the largest difference in units of its tolerance."""
        return max(self.comparisons, key=lambda one: one.ratio, default=None)

    @property
    def verdict(self) -> str:
        """One sentence: that they agree, or who does not."""
        if self.agrees:
            return f"All {len(self.standings)} witnesses agree."
        if not self.culprits:
            return "The witnesses disagree."
        if len(self.culprits) > 1:
            return f"{' and '.join(self.culprits)} contradict each other; ask a third witness."
        return f"{self.culprits[0]} is wrong: the others agree."

    def command(self, pose: int, geometry_file: str | None = None) -> str:
        """Return the command line that solves a pose of this report; without a file, for the paper's geometry."""
        return command(self.translation[pose], self.xyx[pose], geometry_file)


def crosscheck(
    geometry: Geometry,
    *,
    poses: int = 200,
    seed: int = 0,
    witnesses: Sequence[Witness | str] | None = None,
    progress: Progress | None = None,
) -> Report:
    """Ask witnesses about random poses and compare all they say.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    poses : int
        How many; four fifths of them in leg space.
    seed : int
        Of the poses and of the wrenches.
    witnesses : sequence of Witness or of str, optional
        Who is asked; all of `spm_pin.crosscheck.methods.WITNESSES` that can be imported if not given. States at
        which Jacobians and forces are compared come from the first that solves the inverse displacement.
    progress : callable, optional
        Called with what is being done, how many steps are done, and of how many.

    Raises
    ------
    ArgumentError
        If an argument is none of these, or nobody solves the inverse displacement.
    """
    if isinstance(poses, bool) or not isinstance(poses, int) or poses < 1:
        raise ArgumentError("poses", "a positive whole number", poses)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ArgumentError("seed", "a whole number, not negative", seed)
    rng = np.random.default_rng(seed)
    inner = max(1, round(LEG_SPACE * poses))
    drawn = [in_leg_space(geometry, inner, rng), on_all_rotations(geometry, poses - inner, rng)]
    matrices = np.concatenate([part.as_matrix() for part in drawn])[rng.permutation(poses)]
    sample, translation, xyx = printable(RigidTransform.from_matrix(matrices))
    hearing = Hearing(geometry, _called(witnesses, geometry), progress or (lambda *_: None))
    proved = hearing.branches(sample)
    states = hearing.states(proved, rng)
    reached = int(proved.exists.reshape(poses, -1).any(axis=-1).sum())
    return Report(geometry, seed, translation, xyx, reached, states, hearing.standings, tuple(hearing.comparisons))


def _called(witnesses: Sequence[Witness | str] | None, geometry: Geometry) -> list[Witness]:
    if witnesses is None:
        return make(None, geometry)
    return [make([one], geometry)[0] if isinstance(one, str) else one for one in witnesses]
