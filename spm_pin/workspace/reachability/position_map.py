"""Where o is for six leg lengths, and its derivatives, near a configuration that is known.

Both stages are without torsion: in a frame of its hips a stage's middle platform is turned by the unit quaternion
(x0, x1, x2, 0), about a level axis, and its centre is at t = (-2r x1 x2, r (x2² - x1²), Z); see
`docs/theory/forward_displacement.md`. So (x1, x2, Z) of both stages give everything explicitly,

    o = t_a + R_a s,    s = -R_bᵀ t_b,

s being where o is seen from the middle platform, and the leg lengths too; three at a time they are solved for the
coordinates by Newton's method. `forward_physical` finds a configuration from nothing; where thousands of searches take
many short steps each, going on from the last one is ten times as fast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

__all__ = ["PositionMap", "stage_coordinates"]

_STEPS = 12


def stage_coordinates(states: Configuration) -> FloatArray:
    """Return (x1, x2, Z/r) of the lower and of the upper stage of states (N,) without torsion, shape (N, 2, 3)."""
    b, rotation = states.middle_joints, states.rotation
    middle = states.middle_pose
    seen = np.swapaxes(rotation, -1, -2) @ middle.as_matrix()[:, :3, :3]
    centre = b.mean(axis=-2)
    from_m = ((centre - states.translation)[:, None, :] @ rotation)[:, 0]
    coordinates = np.empty((len(b), 2, 3))
    for k, (matrix, height) in enumerate(((middle.as_matrix()[:, :3, :3], centre[:, 2]), (seen, from_m[:, 2]))):
        # Without torsion R + Rᵀ and R - Rᵀ give 4 x0² and 4 x0 (x1, x2).
        x0 = 0.5 * np.sqrt(np.maximum(1.0 + np.trace(matrix, axis1=-2, axis2=-1), 0.0))
        coordinates[:, k, 0] = (matrix[:, 2, 1] - matrix[:, 1, 2]) / (4.0 * x0)
        coordinates[:, k, 1] = (matrix[:, 0, 2] - matrix[:, 2, 0]) / (4.0 * x0)
        coordinates[:, k, 2] = height / states.geometry.middle_radius
    return coordinates


@dataclass(frozen=True)
class PositionMap:
    """The map from leg lengths to the position of o of one manipulator."""

    geometry: Geometry

    def moved(self, coordinates: FloatArray, lengths: FloatArray) -> FloatArray:
        """Return the stage coordinates (N, 2, 3) that belong to `lengths` (N, 6) [m], near `coordinates`.

        NaN where Newton's method does not arrive, or has gone past a singularity of a stage.
        """
        here = coordinates.copy()
        target = lengths.reshape(-1, 2, 3)
        side = None
        active = np.arange(len(here))
        arrived = np.zeros(len(here), dtype=bool)
        for _ in range(_STEPS):
            found, jacobian = self._legs(here[active])
            inverse, determinant = _inverse(jacobian)
            if side is None:
                side = np.sign(determinant)
            error = target[active] - found
            good = (np.sign(determinant) == side[active]).all(axis=-1)
            near = np.abs(error).max(axis=(-1, -2), initial=0.0) <= 1e-14 * self._size(target[active])
            with np.errstate(invalid="ignore"):
                here[active] += (inverse * error[..., None, :]).sum(axis=-1)
            arrived[active[near & good]] = True
            active = active[~near & good]
            if not len(active):
                break
        else:
            # Rounding may stop just short of the tolerance.
            found, _ = self._legs(here[active])
            near = np.abs(target[active] - found).max(axis=(-1, -2), initial=0.0)
            arrived[active[near <= 1e-12 * self._size(target[active])]] = True
        here[~arrived] = np.nan
        return here

    def lengths(self, coordinates: FloatArray) -> FloatArray:
        """Return the leg lengths (N, 6) [m] of stage coordinates (N, 2, 3)."""
        return self._legs(coordinates)[0].reshape(-1, 6)

    def _size(self, lengths: FloatArray) -> FloatArray:
        radii = self.geometry.base_radius + self.geometry.platform_radius + self.geometry.middle_side
        return np.asarray(radii + lengths.max(axis=(-1, -2), initial=0.0))

    def _legs(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return leg lengths (N, 2, 3) [m] and their derivatives (N, 2, 3, 3): rows legs, columns coordinates [m]."""
        g = self.geometry
        r = g.middle_radius
        cos, sin = g.radial_directions[:, 0], g.radial_directions[:, 1]
        hips = np.array([g.base_radius, g.platform_radius])[:, None]
        x1, x2, height = (coordinates[..., k, None] for k in range(3))
        with np.errstate(invalid="ignore"):
            x0 = np.sqrt(1.0 - x1 * x1 - x2 * x2)
        lift = x1 * sin - x2 * cos
        across = r * (x0 * x0 - 2.0 * (2.0 * x1 * x2 * cos + (x1 * x1 - x2 * x2) * sin)) - hips
        up = r * (height + 2.0 * x0 * lift)
        lengths = np.sqrt(across * across + up * up)
        across_1 = -2.0 * r * (x1 + 2.0 * (x2 * cos + x1 * sin))
        across_2 = -2.0 * r * (x2 + 2.0 * (x1 * cos - x2 * sin))
        up_1, up_2 = 2.0 * r * (x0 * sin - x1 / x0 * lift), -2.0 * r * (x0 * cos + x2 / x0 * lift)
        rows = [(across * across_1 + up * up_1), (across * across_2 + up * up_2), r * up]
        return lengths, np.stack(rows, axis=-1) / lengths[..., None]

    def seen(self, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s [m], where o is seen from the middle platform, (N, 3), and its derivatives, a row per coordinate.

        `upper` holds the coordinates of the upper stage, (N, 3).
        """
        r = self.geometry.middle_radius
        t, dt = _centre(upper, r)
        # R_bᵀ is the turn about the opposite axis.
        opposite = upper * [-1.0, -1.0, 1.0]
        turned, by_axis = _turned(opposite, t)
        derivatives = -_turned(opposite[:, None, :], dt)[0]
        derivatives[:, :2] += by_axis
        return -turned, derivatives

    def position(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return o [m] in {B}, (N, 3), and its derivatives with respect to the leg lengths, (N, 3, 6)."""
        lower, upper = coordinates[:, 0], coordinates[:, 1]
        centre, d_lower = _centre(lower, self.geometry.middle_radius)
        s, ds = self.seen(upper)
        moved, by_lower = _turned(lower, s)
        d_lower[:, :2] += by_lower
        d_upper = _turned(lower[:, None, :], ds)[0]
        # One row per coordinate so far, from here on one column per leg.
        inverse, _ = _inverse(self._legs(coordinates)[1])
        jacobian = [np.swapaxes(d, -1, -2) @ inverse[:, k] for k, d in enumerate((d_lower, d_upper))]
        return centre + moved, np.concatenate(jacobian, axis=-1)

    def upper_for(self, lower: FloatArray, points: FloatArray) -> FloatArray:
        """Return coordinates of upper stages (N, 3) that put o at `points` (N, 3) [m], given those of the lower stages.

        By Newton's method, from the middle platform's normal turned towards o; NaN where that does not arrive.
        """
        centre, _ = _centre(lower, self.geometry.middle_radius)
        target, _ = _turned(lower * [-1.0, -1.0, 1.0], points - centre)
        distance = np.sqrt((target**2).sum(axis=-1))
        across = np.hypot(target[:, 0], target[:, 1])
        half = 0.5 * np.arctan2(across, target[:, 2])
        with np.errstate(invalid="ignore", divide="ignore"):
            axis = np.where(across > 0.0, np.stack([target[:, 1], -target[:, 0]]) / across, 0.0)
        height = -distance / self.geometry.middle_radius
        upper = np.stack([np.sin(half) * axis[0], np.sin(half) * axis[1], height], axis=-1)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for _ in range(2 * _STEPS):
                s, ds = self.seen(upper)
                inverse, _ = _inverse(ds)
                upper = upper + (np.swapaxes(inverse, -1, -2) @ (target - s)[..., None])[..., 0]
            error = np.abs(self.seen(upper)[0] - target).max(axis=-1, initial=0.0)
        return np.where((error <= 1e-12 * (1.0 + distance))[:, None], upper, np.nan)


def _centre(coordinates: FloatArray, r: float) -> tuple[FloatArray, FloatArray]:
    """Return t (N, 3) [m] and its derivatives, a row per coordinate, (N, 3, 3)."""
    x1, x2, height = (r * coordinates[:, k] for k in range(3))
    u1, u2 = coordinates[:, 0], coordinates[:, 1]
    zero = np.zeros_like(x1)
    rows = [[-2.0 * x2, -2.0 * x1, zero], [-2.0 * x1, 2.0 * x2, zero], [zero, zero, np.full_like(x1, r)]]
    return np.stack([-2.0 * x1 * u2, x2 * u2 - x1 * u1, height], axis=-1), np.stack(
        [np.stack(row, axis=-1) for row in rows], axis=-2
    )


def _turned(coordinates: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R v (..., 3) for the turn by (x0, x1, x2, 0), and its derivatives by x1 and x2, rows of (..., 2, 3)."""
    x1, x2 = coordinates[..., 0, None], coordinates[..., 1, None]
    x0 = np.sqrt(1.0 - x1 * x1 - x2 * x2)
    a, b, c = vector[..., 0, None], vector[..., 1, None], vector[..., 2, None]
    # w = x × v, and v' = v + 2 x0 w + 2 x × w.
    w1, w2, w3 = x2 * c, -x1 * c, x1 * b - x2 * a

    def across(p1: FloatArray, p2: FloatArray, q1: FloatArray, q2: FloatArray, q3: FloatArray) -> FloatArray:
        return np.concatenate([p2 * q3, -p1 * q3, p1 * q2 - p2 * q1], axis=-1)

    w = np.concatenate([w1, w2, w3], axis=-1)
    zero = np.zeros_like(w3)
    one = zero + 1.0
    out = vector + 2.0 * x0 * w + 2.0 * across(x1, x2, w1, w2, w3)
    slopes = []
    for x, p1, p2 in ((x1, one, zero), (x2, zero, one)):
        d1, d2, d3 = p2 * c, -p1 * c, p1 * b - p2 * a
        d = np.concatenate([d1 + zero, d2 + zero, d3], axis=-1)
        slopes.append(
            2.0 * (x0 * d - x / x0 * w) + 2.0 * (across(p1, p2, w1, w2, w3) + across(x1, x2, d1 + zero, d2 + zero, d3))
        )
    return out, np.stack(slopes, axis=-2)


def _inverse(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inverses of (..., 3, 3) by cofactors, and the determinants (...); not finite where singular."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    columns = [_cross(b, c), _cross(c, a), _cross(a, b)]
    determinant = (a * columns[0]).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack(columns, axis=-1) / determinant[..., None, None], determinant


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    # NumPy's own spends most of its time on the axes.
    x, y, z = (a[..., k] for k in range(3))
    u, v, w = (b[..., k] for k in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
