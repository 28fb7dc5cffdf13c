"""The branch of a configuration: its family, its sign, and the coordinates of its two stages.

Each stage's middle platform either has no torsion (mode T) or is turned by half a turn (mode F) against the other
end of that stage. A family names the lower stage's mode, then the upper's. A family has at most two branches
of one pose, distinguished by a sign. Derivation: `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.formulas import wrenches
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.machine.configuration import Configuration, halves
from spm_pin.support.arguments import FloatArray, IntArray

if TYPE_CHECKING:
    from spm_pin.machine.configuration import Configuration

FAMILIES = ("TT", "TF", "FT", "FF")
"""The four families of branches: the mode, T or F, of the lower stage and of the upper."""
BRANCHES = ("TT+", "TT-", "TF+", "TF-", "FT+", "FT-", "FF+", "FF-")
"""Canonical order of the eight branches of an inverse displacement."""

_structure_determinant = on_arrays(wrenches.structure_determinant)


def family(configuration: Configuration) -> IntArray:
    """Return the index in `FAMILIES` of each state, shape (...); -1 where it does not exist."""
    # Signs of the mean radii of the b_i in {B} and in {m}. The radial directions add up to zero, so b_i is b_i - o.
    moments = np.swapaxes(configuration.middle_joints, -1, -2) @ configuration.machine.radial_directions
    lower = moments[..., 0, 0] + moments[..., 1, 1] + moments[..., 2, 2]
    upper = np.einsum("...ij,...ij->...", moments, configuration.rotation)
    return np.where(configuration.exists, 2 * (lower < 0.0) + (upper < 0.0), -1).astype(np.intp)


def branch_sign(configuration: Configuration) -> FloatArray:
    """Return a number with the sign of the branch's label, zero at an inverse singularity, shape (...).

    It is det K [m³] up to a sign that makes it continuous along any path of one family: with a and b the unit
    quaternions of the middle platform seen from {B} and from {m}, their nonzero component in the mode's
    coordinate taken positive, it is det K times the sign of that component of a b*.
    """
    index, exists = family(configuration), configuration.exists
    middle = np.where(exists[..., None, None], configuration.middle_pose.as_matrix()[..., :3, :3], np.eye(3))
    back = np.where(exists[..., None, None], np.swapaxes(configuration.rotation, -1, -2), np.eye(3))
    a, b = Rotation.from_matrix(middle).as_quat(), Rotation.from_matrix(back @ middle).as_quat()
    a = a * np.where(np.where(index >= 2, a[..., 2], a[..., 3]) < 0.0, -1.0, 1.0)[..., None]
    b = b * np.where(np.where(index % 2 == 1, b[..., 2], b[..., 3]) < 0.0, -1.0, 1.0)[..., None]
    # The component of a b* that cannot vanish in this family: the scalar part, in mixed families the z part.
    z = b[..., 3] * a[..., 2] - a[..., 3] * b[..., 2] - a[..., 0] * b[..., 1] + a[..., 1] * b[..., 0]
    kappa = np.select([index == 1, index == 2], [-z, z], (a * b).sum(axis=-1))
    arms = configuration.balls - configuration.middle_joints.mean(axis=-2, keepdims=True)
    det_k = _structure_determinant(*map(rows_of, (*halves(arms), *halves(configuration.leg_axes))))
    return np.where(exists, det_k * np.sign(kappa), np.nan)


def stage_coordinates(configuration: Configuration, modes: str = "TT") -> FloatArray:
    """Return (x, y, Z [m]) of the lower stage in {B} and of the upper one in {m}, (..., 2, 3); (..., 1, 3) for a stage.

    x and y are parts of the quaternion of the middle platform, turned by half a turn about its normal in mode F; Z is
    the height of its centre. NaN where there is no configuration, or one of other modes.
    """
    middle, back = configuration.middle_pose.as_matrix(), np.swapaxes(configuration.rotation, -1, -2)
    rotation, centre = middle[..., :3, :3], middle[..., :3, 3]
    seen = (back @ (centre - configuration.translation)[..., None])[..., 0]
    plates = [(rotation, centre), (back @ rotation, seen)][: len(configuration.machine.legs.kinds)]
    coordinates = []
    for mode, (turn, place) in zip(modes, plates, strict=False):
        turn = turn if mode == "T" else turn * [-1.0, -1.0, 1.0]
        exists = np.asarray(np.isfinite(turn).all(axis=(-2, -1)))
        quaternion = Rotation.from_matrix(np.where(exists[..., None, None], turn, np.eye(3))).as_quat()
        x, y, x3, x0 = np.moveaxis(np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion), -1, 0)
        exists = exists & (x0 > np.abs(x3))
        coordinates.append(np.where(exists[..., None], np.stack([x, y, place[..., 2]], axis=-1), np.nan))
    return np.stack(coordinates, axis=-2)
