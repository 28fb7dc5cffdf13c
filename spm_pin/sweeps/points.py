"""What the mechanism does at N points of a sweep: solved once, for all indices."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.closed_form.jacobians import platform_jacobian
from spm_pin.closed_form.singularity_analysis import Singularities, SingularityKind, singularities
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism import Configuration, Geometry, LegLimits, SolutionSet, Status, pose
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.sweeps.domains import Space

__all__ = ["Points"]

BoolArray = npt.NDArray[np.bool_]

_SHORTEST = float(np.finfo(np.float64).tiny)


class Points:
    """N points and what the mechanism does there; everything is computed when first asked for, and then kept.

    Parameters
    ----------
    geometry : Geometry
        The manipulator; its leg limits, if it has any, decide what is reachable.
    space : {"pose", "legs"}
        What the coordinates are.
    coordinates : ndarray, shape (N, 6)
        x, y, z [m] and the X-Y-X angles [rad], or the leg lengths [m].
    """

    def __init__(self, geometry: Geometry, space: Space, coordinates: FloatArray) -> None:
        self.geometry = geometry
        self.space = space
        self.coordinates = coordinates

    def __len__(self) -> int:
        return len(self.coordinates)

    @cached_property
    def limits(self) -> LegLimits:
        """The geometry's leg limits; without any, those that every leg with a direction respects."""
        return self.geometry.limits or LegLimits(_SHORTEST, np.inf)

    @cached_property
    def solutions(self) -> SolutionSet:
        """All branches of the pose, leg limits aside, a `SolutionSet` of shape (N,).

        Where points are leg lengths, of the pose that the machine then has; no branch exists where it has none.
        """
        if self.space == "pose":
            return inverse_displacement(self.geometry, pose(self.coordinates[:, :3], xyx=self.coordinates[:, 3:]))
        placed = self._placed.exists
        found = inverse_displacement(self.geometry, self._placed[placed].pose)
        joints = np.full((len(self), *found.middle_joints.shape[1:]), np.nan)
        joints[placed] = found.middle_joints
        shape = joints.shape[:2]
        lengths = np.full((*shape, 6), np.nan)
        lengths[placed] = found.leg_lengths
        branches = Configuration.from_arrays(
            self.geometry,
            np.broadcast_to(self._placed.rotation[:, None], (*shape, 3, 3)),
            np.broadcast_to(self._placed.translation[:, None], (*shape, 3)),
            joints,
            lengths,
        )
        status = np.full(len(self), Status.UNREACHABLE, dtype=np.int8)
        status[placed] = found.status
        return SolutionSet(branches, found.labels, status)

    @cached_property
    def status(self) -> npt.NDArray[np.int8]:
        """`Status` of the displacement problem that each point poses, shape (N,)."""
        if self.space == "pose":
            return np.asarray(self.solutions.status, dtype=np.int8)
        return np.where(self._placed.exists, Status.OK, Status.UNREACHABLE).astype(np.int8)

    @cached_property
    def machine(self) -> Configuration:
        """The configuration that a real machine is in, shape (N,); NaN where it has none within its leg limits."""
        if self.space == "legs":
            inside = self.limits.contains(self.coordinates) & self._placed.exists
            return self._kept(self._placed[inside], inside)
        within = self.solutions.within(self.limits)
        # Few points of a box have a branch within the limits, and only those are worth a closer look.
        some = np.asarray(within.exists.any(axis=-1))
        return self._kept(within[some].physical(), some)

    @cached_property
    def reachable(self) -> BoolArray:
        """Whether `machine` exists, shape (N,)."""
        return self.machine.exists

    @cached_property
    def reached(self) -> Configuration:
        """The M members of `machine` that exist."""
        return self.machine[self.reachable]

    def spread(self, values: npt.ArrayLike, absent: float = np.nan) -> FloatArray:
        """Put values of the M `reached` points into an array of shape (N,), `absent` elsewhere."""
        spread = np.full(len(self), absent)
        spread[self.reachable] = values
        return spread

    @cached_property
    def margin(self) -> FloatArray:
        """How far the worst leg is inside its limits [m], shape (N,): negative outside, NaN where no machine can be.

        Of the physical branches the one with the largest margin counts.

        Raises
        ------
        ArgumentError
            If the geometry has no leg limits.
        """
        if self.geometry.limits is None:
            raise ArgumentError("geometry", "one with leg limits, of which a margin can be left", "none")
        if self.space == "legs":
            return np.where(self._placed.exists, self.limits.margin(self.coordinates), np.nan)
        margins = self.limits.margin(self.solutions.leg_lengths)
        best = np.where(self.solutions.is_physical, margins, -np.inf).max(axis=-1)
        return np.where(np.isinf(best), np.nan, best)

    @cached_property
    def singularities(self) -> Singularities:
        """Of the M `reached` points."""
        return singularities(self.reached)

    @cached_property
    def platform_jacobians(self) -> FloatArray:
        """G of the M `reached` points, shape (M, 6, 6), see `platform_jacobian`; NaN at a forward singularity."""
        try:
            return platform_jacobian(self.reached)
        except SingularConfigurationError:
            held = (self.singularities.kind & SingularityKind.FORWARD) == 0
            jacobians = np.full((len(self.reached), 6, 6), np.nan)
            jacobians[held] = platform_jacobian(self.reached[held])
            return jacobians

    def _kept(self, states: Configuration, members: BoolArray) -> Configuration:
        """Return a batch (N,) of `states` at `members` and NaN elsewhere."""
        parts = []
        for values in (states.rotation, states.translation, states.middle_joints):
            parts.append(np.full((len(self), *values.shape[1:]), np.nan))
            parts[-1][members] = values
        return Configuration.from_arrays(self.geometry, *parts)

    @cached_property
    def _placed(self) -> Configuration:
        return forward_physical(self.geometry, self.coordinates)
