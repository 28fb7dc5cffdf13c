"""The orientations that the platform can have at a position.

A position leaves three of six freedoms. Choose the lower legs: they place the middle platform, and from there o is seen
in one place s, which determines the upper legs. So the box of the lower legs, where the upper ones respect their limits
too, is the whole set of states at this position, and its orientations have the volume

    ∫ |det ∂(o, R)/∂l| / |det ∂o/∂l_upper| dl_lower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.jacobians import platform_jacobian
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry, LegLimits
from spm_pin.workspace.reachability.estimate import Estimate, check_confidence, check_count, from_hits, from_mean
from spm_pin.workspace.reachability.leg_box import leg_box
from spm_pin.workspace.reachability.membership import pose_density
from spm_pin.workspace.reachability.position_map import stage_coordinates
from spm_pin.workspace.reachability.tilt_torsion import ROTATIONS, tilt_torsion

__all__ = ["OrientationWorkspace", "orientation_workspace"]

_SAME = 1e-9


@dataclass(frozen=True)
class OrientationWorkspace:
    """Orientations that can be reached at one position; arrays over the n states found.

    Attributes
    ----------
    position : ndarray, shape (3,)
        Of o in {B} [m].
    states : Configuration, shape (n,)
        States with o there, uniform in the lower legs.
    weights : ndarray, shape (n,)
        How much of the orientations each state stands for [rad³]; they add up to `volume.value`.
    azimuth, tilt, torsion : ndarray, shape (n,)
        Where the platform's normal leans, how far, and the turn about it [rad]; see
        `spm_pin.workspace.reachability.tilt_torsion`.
    volume : Estimate
        Of the orientations, in rad³; all rotations measure 8π².
    """

    position: FloatArray
    states: Configuration
    weights: FloatArray
    azimuth: FloatArray
    tilt: FloatArray
    torsion: FloatArray
    volume: Estimate

    def __repr__(self) -> str:
        return f"<OrientationWorkspace: {len(self.weights)} states, {self.volume}>"

    @property
    def share(self) -> Estimate:
        """Share of all rotations."""
        return self.volume.times(1.0 / ROTATIONS, "")

    def largest_tilt(self, sectors: int = 36) -> tuple[FloatArray, FloatArray]:
        """Return the middles of `sectors` equal sectors of azimuth and the largest tilt found in each [rad].

        NaN for a sector with no state. A sample finds a little less than there is.
        """
        number = check_count(sectors, "sectors", 1)
        edges = np.linspace(-np.pi, np.pi, number + 1)
        sector = np.clip(np.digitize(self.azimuth, edges) - 1, 0, number - 1)
        largest = np.full(number, -np.inf)
        np.maximum.at(largest, sector, self.tilt)
        return 0.5 * (edges[1:] + edges[:-1]), np.where(np.isinf(largest), np.nan, largest)


def orientation_workspace(
    geometry: Geometry,
    position: npt.ArrayLike,
    limits: LegLimits | None = None,
    *,
    samples: int = 20_000,
    confidence: float = 0.95,
    rng: np.random.Generator | int | None = None,
) -> OrientationWorkspace:
    """Find the orientations that the platform of a real machine can have at a position.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    position : array_like, shape (3,)
        Of o in {B} [m].
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    samples : int
        Sets of lower legs to try.
    confidence : float
        Of the volume's interval: Student's; if no state is found, Clopper and Pearson's for the share of sets of legs,
        taken of all rotations, which is generous.
    rng : Generator or int, optional
        Source of randomness, or its seed.

    Returns
    -------
    OrientationWorkspace
        Without states and of volume 0 where the position is out of reach, or hardly reached.

    Raises
    ------
    ArgumentError
        If `position` is not three finite numbers, another argument is not as above, there are no limits, one is
        infinite, or no lengths within them belong to a configuration.

    Notes
    -----
    An orientation that several sets of lengths lead to is counted once. Where several upper stages see o in the same
    place, the one is taken that is nearest to pointing at it.
    """
    point = real_array(position, "position", (3,), "a position in metres").reshape(-1, 3)
    if len(point) != 1:
        real_array(position, "position", (3, 0), "one position in metres")
    count, confidence = check_count(samples, "samples"), check_confidence(confidence)
    box = leg_box(geometry, limits)
    lengths = np.empty((count, 6))
    lengths[:, :3] = np.random.default_rng(rng).uniform(box.minimum[:3], box.maximum[:3], (count, 3))
    # Any upper legs: only the lower stage is wanted.
    lengths[:, 3:] = box.lengths[0, 3:]
    assembled = forward_physical(geometry, lengths)
    index = np.flatnonzero(assembled.exists)
    coordinates = stage_coordinates(assembled[index])
    coordinates[:, 1] = box.map.upper_for(coordinates[:, 0], point)
    upper = box.map.lengths(coordinates)[:, 3:]
    with np.errstate(invalid="ignore"):
        good = ((upper >= box.minimum[3:]) & (upper <= box.maximum[3:])).all(axis=-1)
    index = index[good]
    lengths[index, 3:] = upper[good]
    states = forward_physical(geometry, lengths[index])
    with np.errstate(invalid="ignore"):
        # Another mode of the upper stage may see o in the same place.
        physical = np.abs(states.translation - point).max(axis=-1, initial=0.0) <= _SAME * box.size
    index, states = index[physical], states[physical]
    values = np.zeros(count)
    values[index] = pose_density(states, box.limits) / np.abs(np.linalg.det(platform_jacobian(states)[:, :3, 3:]))
    region = float((box.maximum - box.minimum)[:3].prod())
    method = "change of variables from the lower legs"
    if len(index):
        volume = from_mean(values, region, confidence, method, "rad³")
    else:
        volume = from_hits(0, count, ROTATIONS, confidence, method, "rad³")
    azimuth, tilt, torsion = tilt_torsion(states.rotation)
    return OrientationWorkspace(point[0], states, values[index] * region / count, azimuth, tilt, torsion, volume)
