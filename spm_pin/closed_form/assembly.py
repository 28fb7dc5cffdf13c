"""The whole manipulator from its two stages."""

from __future__ import annotations

import numpy as np

from spm_pin.closed_form.stage import placement
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

__all__ = ["composed", "joined"]


def composed(
    geometry: Geometry, lower: tuple[FloatArray, FloatArray], upper: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Join two stages at their middle platform.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    lower, upper : pairs of ndarrays, shapes (M, 4) and (M,)
        The middle platform's quaternion, scalar last, and the height of its centre in units of r: of the lower stage
        in {B}, of the upper stage in {m}.

    Returns
    -------
    rotation, translation, middle_joints : ndarrays, shapes (M, 3, 3), (M, 3) and (M, 3, 3)
        R, o [m] and the b_i as rows [m], in {B}.
    """
    r = geometry.middle_radius
    centre, radii, heights = placement(*lower)
    seen_from_m, _, _ = placement(*upper)
    (a1, a2, a3, a0), (b1, b2, b3, b0) = lower[0].T, upper[0].T
    # The middle platform's rotation in {B} times the inverse of that in {m}.
    w = a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3
    x = a1 * b0 - a0 * b1 - a2 * b3 + a3 * b2
    y = a2 * b0 - a0 * b2 - a3 * b1 + a1 * b3
    z = a3 * b0 - a0 * b3 - a1 * b2 + a2 * b1
    entries = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)]
    entries += [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)]
    entries += [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)]
    rotation = np.stack(entries, axis=-1).reshape(-1, 3, 3)
    translation = r * (centre - (rotation * seen_from_m[:, None, :]).sum(axis=-1))
    joints = r * (radii[..., None] * geometry.radial_directions + heights[..., None] * np.array([0.0, 0.0, 1.0]))
    return rotation, translation, joints


def joined(
    geometry: Geometry,
    lower: tuple[FloatArray, FloatArray],
    upper: tuple[FloatArray, FloatArray],
    shape: tuple[int, ...],
) -> Configuration:
    """Return the configurations of shape (...) of `composed`, NaN throughout where either stage is."""
    rotation, translation, joints = composed(geometry, lower, upper)
    absent = np.isnan(rotation[:, 0, 0])
    joints = np.where(absent[:, None, None], np.nan, joints)
    return Configuration.from_arrays(
        geometry, rotation.reshape(*shape, 3, 3), translation.reshape(*shape, 3), joints.reshape(*shape, 3, 3)
    )
