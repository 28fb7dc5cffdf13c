"""Which positions are reachable in some orientation, and the reachable ones nearest to the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism import Geometry, LegLimits
from spm_pin.mechanism.arguments import BoolArray, FloatArray, real_array
from spm_pin.workspace.reachability.leg_length_box import leg_length_box
from spm_pin.workspace.reachability.nearest_points import nearest_in_box
from spm_pin.workspace.reachability.state_search import RESOLUTION

_OPTIMALITY_TOLERANCE = 1e-6
"""Violation of the conditions of a nearest point, dimensionless, above which the search has not converged."""


@dataclass(frozen=True)
class PositionReach:
    """Which positions of shape (...) can be reached in some orientation."""

    reachable: BoolArray
    """Whether o can be there, to within `tolerance`, shape (...)."""
    distance: FloatArray
    """Distance to the nearest reachable position that was found [m], shape (...); zero where reachable."""
    nearest: FloatArray
    """The nearest reachable position that was found, in {B} [m], shape (..., 3)."""
    leg_lengths: FloatArray
    """Leg lengths that put o there [m], shape (..., 6); there may be others."""
    optimality: FloatArray
    """How far `nearest` is from obeying the conditions of a nearest point, shape (...), see
    `spm_pin.workspace.reachability.nearest_points`; rounding, unless the search has not converged and `distance` is
    only an upper bound."""
    tolerance: float
    """Tolerance of the positions [m]: one nearer than this counts as reached."""

    @property
    def undecided(self) -> BoolArray:
        """Points where no state was found, and no nearest one either, shape (...)."""
        return np.asarray(~self.reachable & (self.optimality > _OPTIMALITY_TOLERANCE))


def reachable_position(geometry: Geometry, points: npt.ArrayLike, limits: LegLimits | None = None) -> PositionReach:
    """Find which positions o can reach in some orientation, in the physical mode, and the nearest it can.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    points : array_like, shape (..., 3)
        In {B} [m].
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.

    Raises
    ------
    ArgumentError
        If `points` are not finite numbers of that shape, or there are no limits, one is infinite, or no lengths within
        them belong to a configuration.

    Notes
    -----
    "Reachable" is proved: `leg_lengths` put o there. "Not reachable" is the outcome of a search: a coarse one through
    the states of both stages, then least squares from the best of them. Where the nearest position is not found either,
    `undecided` says so.
    """
    array = real_array(points, "points", (3,), "positions in metres")
    box = leg_length_box(geometry, limits)
    found = nearest_in_box(box, array.reshape(-1, 3))
    tolerance = RESOLUTION * box.size
    shape = array.shape[:-1]
    reached = found.distance <= tolerance
    return PositionReach(
        reached.reshape(shape),
        np.where(reached, 0.0, found.distance).reshape(shape),
        found.position.reshape(*shape, 3),
        found.lengths.reshape(*shape, 6),
        found.optimality.reshape(shape),
        tolerance,
    )
