"""The orientations that the platform can have at a position.

The coordinates u of the lower stage and the position determine those of the upper one, v, so the orientations have the
volume ∫ |det ∂(o, R)/∂(u, v)| / |det ∂o/∂v| du over the lower stages for which the upper one is within its limits too.

Rotations are described by tilt and torsion, R = Rz(φ) Ry(θ) Rz(σ - φ): the platform's normal leans by the tilt θ
towards the azimuth φ, and the platform is turned by the torsion σ about it. The uniform measure of rotations is
sin θ dφ dθ dσ, 8π² in all. Bonev, Zlatanov, Gosselin, "Advantages of the modified Euler angles in the design and
control of PKMs", 2002.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism import Configuration, Geometry, LegLimits
from spm_pin.mechanism.arguments import FloatArray, generator, real_array, whole_number
from spm_pin.workspace.positions import Estimate, check_confidence
from spm_pin.workspace.states import pose_densities, states_within

ROTATIONS = 8.0 * np.pi**2
"""Measure of all rotations [rad³]."""


@dataclass(frozen=True)
class OrientationWorkspace:
    """Orientations that can be reached at one position; arrays over the n states found."""

    position: FloatArray
    """Position of o in {B} [m], shape (3,)."""
    states: Configuration
    """States with o there, uniform in the coordinates of the lower stage, shape (n,)."""
    weights: FloatArray
    """Volume of the orientations that each state stands for [rad³], shape (n,); they add up to `volume.value`."""
    azimuth: FloatArray
    """Azimuth to which the platform's normal leans [rad], shape (n,)."""
    tilt: FloatArray
    """Angle of the platform's normal to the vertical [rad], shape (n,)."""
    torsion: FloatArray
    """Rotation about the platform's normal [rad], shape (n,)."""
    volume: Estimate
    """Volume of the orientations in rad³; all rotations measure 8π²."""

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
        number = whole_number(sectors, "sectors", least=1)
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
    """Find the orientations that the platform can have at a position in the physical mode.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    position : array_like, shape (3,)
        Of o in {B} [m].
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    samples : int
        States of the lower stage to try.
    confidence : float
        Of the volume's interval: Student's; if no state is found, Clopper and Pearson's for the share of states,
        taken of all rotations, which is generous.
    rng : Generator or int, optional
        Source of randomness, or its seed.

    Returns
    -------
    OrientationWorkspace
        Without states and of volume 0 where the position is out of reach, or hardly reached.

    Notes
    -----
    An orientation that several sets of lengths lead to is counted once. Where several upper stages see o in the same
    place, the one is taken that is nearest to pointing at it.
    """
    point = real_array(position, "position", (3,), "a position in metres").reshape(-1, 3)
    if len(point) != 1:
        real_array(position, "position", (3, 0), "one position in metres")
    count, confidence = whole_number(samples, "samples", least=2), check_confidence(confidence)
    states, rng = states_within(geometry, limits), generator(rng)
    lower, region = states.draw_stages(0, count, rng)
    upper = states.upper_for(lower, point)
    index = np.flatnonzero(states.contains(1, upper))
    coordinates = np.stack([lower[index], upper[index]], axis=1)
    across = np.abs(np.linalg.det(states.jacobians(coordinates)[:, :3, 3:]))
    values = np.zeros(count)
    values[index] = pose_densities(states, coordinates) / across
    method = "change of variables from the lower stage's coordinates"
    if len(index):
        volume = Estimate.from_mean(values, region, confidence, method, "rad³", 1.0 / count)
    else:
        volume = Estimate.from_hits(0, count, ROTATIONS, confidence, method, "rad³")
    configurations = states.states(coordinates)
    azimuth, tilt, torsion = tilt_torsion(configurations.rotation)
    return OrientationWorkspace(
        point[0], configurations, values[index] * region / count, azimuth, tilt, torsion, volume
    )


def tilt_torsion(rotation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return azimuth in [-π, π), tilt in [0, π] and torsion in [-π, π] of matrices (..., 3, 3) [rad]."""
    azimuth = np.arctan2(rotation[..., 1, 2], rotation[..., 0, 2])
    tilt = np.arctan2(np.hypot(rotation[..., 0, 2], rotation[..., 1, 2]), rotation[..., 2, 2])
    torsion = np.arctan2(rotation[..., 1, 0] - rotation[..., 0, 1], rotation[..., 0, 0] + rotation[..., 1, 1])
    return azimuth, tilt, torsion
