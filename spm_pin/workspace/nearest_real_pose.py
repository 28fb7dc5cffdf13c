"""The pose nearest to a given one in which a family of branches is real, leg limits aside.

Distances are those of `spm_pin.workspace.poses.pose_distance`; c_1, c_2, c_3 are symmetric about o,
hence d² = |Δo|² + (the same mean for the rotation alone), and shifts and turns separate.

For a fixed orientation a family is real where its quadratic form S, see `spm_pin.kinematics.inverse_displacement`,
allows for the distance h = n·o of the two Z axes: λ_min(S) <= h <= λ_max(S). That is a slab between two planes normal
to n, so the nearest position is a projection onto one of them and exact. What is left is a search over three angles,
for which there is no such formula: a grid of turns, then BFGS from the best of them.
"""

from __future__ import annotations

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.formulas.branches import families, pose_frame
from spm_pin.formulas.operations import on_arrays
from spm_pin.mechanism import FAMILIES, Geometry
from spm_pin.mechanism import pose as make_pose
from spm_pin.mechanism.arguments import FloatArray

LEAST_TILT = np.deg2rad(0.1)
"""Angle between the Z axes of {B} and {m} [rad] below which there is no search: parallel, they have no common normal,
and the manipulator is degenerate or out of reach."""

_EXCLUDED = 1e6
"""Squared displacement, over C², given to turns whose tilt is too small: larger than any other."""
_INSIDE = 1e-9
"""Distance of results from the edge of the slab, over d: at the edge, rounding decides whether the branch is real."""
_pose_frame, _families = on_arrays(pose_frame), on_arrays(families)


def nearest_real_pose(
    geometry: Geometry, target: RigidTransform, family: str, near: RigidTransform | None = None
) -> RigidTransform:
    """Find the pose nearest to a single pose of {m} in {B} in which one of `FAMILIES` is real, leg limits aside.

    `target` itself where the family is real there, else a local minimum, and the global one as far as the grid of
    starts shows. The orientation of `near`, a pose in which the family is real, such as the last one, is one more
    start.
    """
    search = _Search(geometry, target, FAMILIES.index(family))
    starts = _turns()
    if near is not None:
        back = (near.rotation * target.rotation.inv()).as_rotvec()
        starts = np.concatenate([starts, np.linspace(0.05, 1.0, 12)[:, None] * back])
    squares = search.squares(starts)
    best: FloatArray = np.array(starts[int(squares.argmin())])
    if squares.min() > 0.0:
        found = scipy.optimize.minimize(search.square, best, method="BFGS")
        best = found.x if found.fun <= squares.min() else best
        if search.tilt(best) < 3.0 * LEAST_TILT:
            # Where it ends at the least tilt there is a step, on which BFGS stops early.
            best = scipy.optimize.minimize(search.square, best, method="Nelder-Mead", options={"maxfev": 400}).x
    return search.pose(best)


def _turns() -> FloatArray:
    """Return rotation vectors (n, 3): none at first, then shells of growing angle in evenly spread directions."""
    count = 48
    k = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * k / count), np.pi * (1.0 + np.sqrt(5.0)) * k
    sphere = np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)],
        axis=-1,
    )
    shells = [angle * sphere for angle in (2.0 * LEAST_TILT, 0.02, 0.06, 0.15, 0.35, 0.7, 1.2, 2.0)]
    return np.concatenate([np.zeros((1, 3)), *shells])


class _Search:
    """The squared displacement as a function of the turn alone."""

    def __init__(self, geometry: Geometry, target: RigidTransform, family: int) -> None:
        self.geometry = geometry
        self.rotation = target.rotation
        self.position = np.asarray(target.translation)
        self.family = family

    def _shifts(self, turns: FloatArray) -> tuple[Rotation, FloatArray, FloatArray]:
        """Return orientations, the shifts (n, 2) of o in the plane that reach the slab, and whose tilt is too small."""
        rotation = Rotation.from_rotvec(turns) * self.rotation
        position = np.broadcast_to(self.position, turns.shape)
        rows = np.moveaxis(rotation.as_matrix(), 0, -1)
        frame = _pose_frame(tuple(map(tuple, rows)), tuple(position.T), self.geometry.middle_radius)
        uu, uv, vv = _families(frame, self.geometry.middle_radius)[self.family][:3]
        # Eigenvalues of the form, from which h is subtracted already.
        middle, spread = (uu + vv) / 2.0, np.hypot((uu - vv) / 2.0, uv)
        inset = _INSIDE * self.geometry.middle_side
        low, high = middle - spread + inset, middle + spread - inset
        shift = np.where(low > 0.0, low, np.where(high < 0.0, high, 0.0))
        normal = np.where(frame.is_vertical, np.nan, frame.normal[:2]).T
        # The tilt is twice the angle with this sine and cosine.
        too_level = 2.0 * frame.sine * frame.cosine < np.sin(LEAST_TILT)
        return rotation, shift[:, None] * normal, too_level | frame.is_vertical | ~np.isfinite(shift)

    def squares(self, turns: FloatArray) -> FloatArray:
        """Return the squared displacements (n,), over C²; very large where the tilt is too small."""
        rotation, shift, excluded = self._shifts(turns)
        c = self.geometry.platform_joints
        moved = (rotation.as_matrix() - self.rotation.as_matrix()) @ c.T
        square = (shift**2).sum(axis=-1) + (moved**2).sum(axis=-2).mean(axis=-1)
        return np.where(excluded, _EXCLUDED, square / self.geometry.platform_radius**2)

    def square(self, turn: FloatArray) -> float:
        """Return the squared displacement of one turn (3,), over C²."""
        return float(self.squares(turn[None])[0])

    def tilt(self, turn: FloatArray) -> float:
        """Return the angle between the Z axes of {B} and {m} [rad]."""
        z = (Rotation.from_rotvec(turn) * self.rotation).as_matrix()[:, 2]
        return float(np.arctan2(np.hypot(z[0], z[1]), z[2]))

    def pose(self, turn: FloatArray) -> RigidTransform:
        rotation, shift, _ = self._shifts(turn[None])
        return make_pose(self.position + np.append(shift[0], 0.0), rotation=rotation[0])
