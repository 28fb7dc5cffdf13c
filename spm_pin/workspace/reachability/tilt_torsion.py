"""Rotations by tilt and torsion: R = Rz(φ) Ry(θ) Rz(σ - φ).

The platform's normal leans by the tilt θ towards the azimuth φ, and the platform is turned by the torsion σ about it.
The uniform measure of rotations is sin θ dφ dθ dσ, 8π² in all. Bonev, Zlatanov, Gosselin, "Advantages of the modified
Euler angles in the design and control of PKMs", 2002.
"""

from __future__ import annotations

import numpy as np

from spm_pin.mechanism.arguments import FloatArray

__all__ = ["ROTATIONS", "tilt_torsion"]

ROTATIONS = 8.0 * np.pi**2
"""Measure of all rotations [rad³]."""


def tilt_torsion(rotation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return azimuth in [-π, π), tilt in [0, π] and torsion in [-π, π] of matrices (..., 3, 3) [rad]."""
    azimuth = np.arctan2(rotation[..., 1, 2], rotation[..., 0, 2])
    tilt = np.arctan2(np.hypot(rotation[..., 0, 2], rotation[..., 1, 2]), rotation[..., 2, 2])
    torsion = np.arctan2(rotation[..., 1, 0] - rotation[..., 0, 1], rotation[..., 0, 0] + rotation[..., 1, 1])
    return azimuth, tilt, torsion
