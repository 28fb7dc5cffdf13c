"""Positions and leg lengths as functions of the coordinates of the two stages, with derivatives.

A stage of mode T has no torsion: in a frame of its hips its middle platform is turned by the unit quaternion
(x0, x1, x2, 0), about a level axis, and its centre is at t = (-2r x1 x2, r (x2² - x1²), Z). Mode F is the same with -r
for r and a half turn about the platform's normal first; see `docs/theory/forward_displacement.md`. So (x1, x2, Z/|r|)
of both stages give everything explicitly, and without singularities: a point p of the platform is at

    t_a + R_a s,    s = R_bᵀ (p - t_b),

s being where it is seen from the middle platform. The leg lengths are explicit too.

In mode T, `spm_pin.mechanism.stage_coordinates` has (x1, x2, Z) of the lower stage and (-x1, -x2, -Z) of the upper one,
which it mirrors, so that both have a positive Z at home.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.mechanism import Configuration, Geometry
from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.mechanism.branches import in_home_aspect

CENTRE = np.zeros((1, 3))
"""The platform's centre o in {m}."""
_STEPS = 24
"""Steps of Newton's method in `PositionMap.upper_for`."""
_BOTH = slice(None)
"""Index of both stages."""
_OPPOSITE = np.array([-1.0, -1.0, 1.0])
"""Factors of the coordinates (x1, x2, Z/r) for the inverse rotation."""
_HALF_TURN = np.array([-1.0, -1.0, 1.0])
"""Diagonal of the half turn about Z."""


@dataclass(frozen=True)
class PositionMap:
    """The states of one family of a manipulator, by the coordinates of its stages."""

    geometry: Geometry
    family: str = "TT"

    @property
    def radii(self) -> FloatArray:
        """The middle platform's radius [m], shape (2,); negative for a stage of mode F."""
        return self.geometry.middle_radius * np.array([1.0 if mode == "T" else -1.0 for mode in self.family])

    @property
    def _between(self) -> FloatArray:
        # A half turn of one stage, but not of the other, is left between the two.
        return np.ones(3) if self.family[0] == self.family[1] else _HALF_TURN

    def coordinates(self, states: Configuration) -> FloatArray:
        """Return (x1, x2, Z/|r|) of the lower and of the upper stage of states (N,) of this family, (N, 2, 3)."""
        middle = states.middle_pose.as_matrix()[:, :3, :3]
        centre = states.middle_joints.mean(axis=-2)
        from_m = np.swapaxes(states.rotation, -1, -2)
        seen = (from_m @ (centre - states.translation)[..., None])[..., 0]
        coordinates = np.empty((len(middle), 2, 3))
        for k, (matrix, height) in enumerate(((middle, centre[:, 2]), (from_m @ middle, seen[:, 2]))):
            matrix = matrix if self.family[k] == "T" else matrix * _HALF_TURN
            # Without torsion R + Rᵀ and R - Rᵀ give 4 x0² and 4 x0 (x1, x2).
            x0 = 0.5 * np.sqrt(np.maximum(1.0 + np.trace(matrix, axis1=-2, axis2=-1), 0.0))
            coordinates[:, k, 0] = (matrix[:, 2, 1] - matrix[:, 1, 2]) / (4.0 * x0)
            coordinates[:, k, 1] = (matrix[:, 0, 2] - matrix[:, 2, 0]) / (4.0 * x0)
            coordinates[:, k, 2] = height / states.geometry.middle_radius
        return coordinates

    def lengths(self, coordinates: FloatArray) -> FloatArray:
        """Return the leg lengths (N, 6) [m] of stage coordinates (N, 2, 3)."""
        return np.hypot(*self.in_leg_planes(coordinates)).reshape(-1, 6)

    def in_leg_planes(self, coordinates: FloatArray, stages: int | slice = _BOTH) -> tuple[FloatArray, FloatArray]:
        """Return the ball joints' coordinates in their legs' planes: outward from the hips, and up, (N, 2, 3) each [m].

        `coordinates` has the shape (N, 2, 3). For one of the stages it has the shape (N, 3), and so have the results.
        """
        r = self.radii[stages][..., None]
        cos, sin = self.geometry.radial_directions[:, 0], self.geometry.radial_directions[:, 1]
        x0, x1, x2 = _quaternion(coordinates[..., None, :])
        height, square = coordinates[..., 2, None], 1.0 - x1 * x1 - x2 * x2
        across = r * (square - 2.0 * (2.0 * x1 * x2 * cos + (x1 * x1 - x2 * x2) * sin)) - self._hips[stages]
        return across, abs(r) * height + 2.0 * r * x0 * (x1 * sin - x2 * cos)

    @property
    def _hips(self) -> FloatArray:
        return np.array([[self.geometry.base_radius], [self.geometry.platform_radius]])

    def legs(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return leg lengths (N, 2, 3) [m] and their derivatives (N, 2, 3, 3): rows legs, columns coordinates [m]."""
        r = self.radii[:, None]
        cos, sin = self.geometry.radial_directions[:, 0], self.geometry.radial_directions[:, 1]
        across, up = self.in_leg_planes(coordinates)
        x0, x1, x2 = _quaternion(coordinates[..., None, :])
        with np.errstate(invalid="ignore", divide="ignore"):
            lift = (x1 * sin - x2 * cos) / x0
            lengths = np.sqrt(across * across + up * up)
            across_1 = -2.0 * r * (x1 + 2.0 * (x2 * cos + x1 * sin))
            across_2 = -2.0 * r * (x2 + 2.0 * (x1 * cos - x2 * sin))
            up_1, up_2 = 2.0 * r * (x0 * sin - x1 * lift), -2.0 * r * (x0 * cos + x2 * lift)
            rows = [(across * across_1 + up * up_1), (across * across_2 + up * up_2), abs(r) * up]
            return lengths, np.stack(rows, axis=-1) / lengths[..., None]

    def determinants(self, slopes: FloatArray) -> FloatArray:
        """Return the determinants (N, 2) of the derivatives (N, 2, 3, 3) that `legs` gives; 1 near home, 0 if singular.

        They are zero at forward singularities, and negative on the other side of them.
        """
        return np.asarray(inverses(slopes)[1] / (6.0 * np.sqrt(3.0) * self.geometry.middle_radius**3) * [1.0, -1.0])

    def home_aspect(self, coordinates: FloatArray, stages: int | slice = _BOTH) -> BoolArray:
        """Test which stages (N, 2) of mode T are on the outer side of their platform and in the home's aspect.

        For one of the stages `coordinates` has the shape (N, 3), and the result (N,).
        """
        radial = self.geometry.radial_directions
        axis = np.array([0.0, 0.0, 1.0])
        across, up = (array[..., None] for array in self.in_leg_planes(coordinates, stages))
        points = (across + self._hips[stages][..., None]) * radial + up * axis
        outer = np.array([1.0, -1.0])[stages]
        normals = outer[..., None, None] * (up * radial - across * axis)
        with np.errstate(invalid="ignore"):
            return (outer * coordinates[..., 2] > 0.0) & in_home_aspect(points, normals)

    def points(self, coordinates: FloatArray, body: FloatArray = CENTRE) -> tuple[FloatArray, FloatArray]:
        """Return the positions of points of the platform in {B}, (N, 3K) [m], and the derivatives (N, 3K, 6).

        With respect to the `coordinates` (N, 2, 3) of the stages; `body` holds the points (K, 3) in {m} [m].
        """
        lower, upper = coordinates[:, None, 0], coordinates[:, None, 1]
        centre, by_lower = stage_centre(lower, self.radii[0])
        s, ds = self.seen(upper, body)
        moved, by_turn = turned(lower, s)
        by_upper = rotated(lower[:, :, None], ds)
        rows = np.concatenate([np.broadcast_to(by_lower, by_upper.shape), by_upper], axis=-2)
        rows[..., :2, :] += by_turn
        count = 3 * len(body)
        return (centre + moved).reshape(-1, count), np.swapaxes(rows, -1, -2).reshape(-1, count, 6)

    def seen(self, upper: FloatArray, point: FloatArray = CENTRE[0]) -> tuple[FloatArray, FloatArray]:
        """Return s [m], where points of {m} are seen from the middle platform, (..., 3), and a row per coordinate.

        `upper` holds the coordinates of the upper stage, (..., 3), `point` the points, (3,) or (..., 3).
        """
        t, dt = stage_centre(upper, self.radii[1])
        # R_bᵀ is the turn about the opposite axis.
        opposite = upper * _OPPOSITE
        s, by_axis = turned(opposite, point - t)
        by_centre = -rotated(opposite[..., None, :], dt)
        derivatives = np.broadcast_to(by_centre, (*s.shape[:-1], 3, 3)).copy()
        derivatives[..., :2, :] -= by_axis
        return self._between * s, self._between * derivatives

    def states(self, coordinates: FloatArray) -> Configuration:
        """Return the configurations (N,) of stage coordinates (N, 2, 3)."""
        across, up = self.in_leg_planes(coordinates[:, 0], 0)
        outward = (across + self._hips[0])[..., None] * self.geometry.radial_directions
        joints = outward + up[..., None] * [0.0, 0.0, 1.0]
        lower, upper = coordinates[:, None, 0], coordinates[:, None, 1]
        back = rotated(upper * _OPPOSITE, np.eye(3))
        rotation = np.swapaxes(rotated(lower, self._between * back), -1, -2)
        return Configuration.from_arrays(self.geometry, rotation, self.points(coordinates)[0], joints)

    def pose_densities(self, coordinates: FloatArray) -> FloatArray:
        """Return |det ∂(o, R)/∂(coordinates)| [m³ rad³], (N,): how much of pose space they stand for."""
        _, translations = self.points(coordinates)
        lower, upper = coordinates[:, 0], coordinates[:, 1]
        turns = np.zeros((len(lower), 6, 3))
        turns[:, :2] = _angular(lower)
        # The rotation is R_a times the turn about the opposite axis.
        turns[:, 3:5] = rotated(lower[:, None, :], -self._between * _angular(upper * _OPPOSITE))
        matrix = np.concatenate([translations, np.swapaxes(turns, -1, -2)], axis=1)
        return np.asarray(np.abs(np.linalg.det(matrix)))

    def upper_for(self, lower: FloatArray, points: FloatArray) -> FloatArray:
        """Return coordinates of upper stages (N, 3) that put o at `points` (N, 3) [m], given those of the lower stages.

        By Newton's method, from the middle platform's normal turned towards o; NaN where that does not arrive. For the
        family TT only.
        """
        centre, _ = stage_centre(lower, self.radii[0])
        target = rotated(lower * _OPPOSITE, points - centre)
        distance = np.sqrt((target**2).sum(axis=-1))
        across = np.hypot(target[:, 0], target[:, 1])
        half = 0.5 * np.arctan2(across, target[:, 2])
        with np.errstate(invalid="ignore", divide="ignore"):
            axis = np.where(across > 0.0, np.stack([target[:, 1], -target[:, 0]]) / across, 0.0)
        height = -distance / self.geometry.middle_radius
        upper = np.stack([np.sin(half) * axis[0], np.sin(half) * axis[1], height], axis=-1)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for _ in range(_STEPS):
                s, ds = self.seen(upper)
                inverse, _ = inverses(ds)
                upper = upper + (np.swapaxes(inverse, -1, -2) @ (target - s)[..., None])[..., 0]
            error = np.abs(self.seen(upper)[0] - target).max(axis=-1, initial=0.0)
        return np.where((error <= 1e-12 * (1.0 + distance))[:, None], upper, np.nan)


def stage_centre(coordinates: FloatArray, r: float) -> tuple[FloatArray, FloatArray]:
    """Return t (..., 3) [m] of a stage and its derivatives, a row per coordinate, (..., 3, 3)."""
    x1, x2, height = (coordinates[..., k] for k in range(3))
    rows = np.zeros((*x1.shape, 3, 3))
    rows[..., 0, 1] = rows[..., 1, 0] = -2.0 * r * x1
    rows[..., 0, 0], rows[..., 1, 1] = -2.0 * r * x2, 2.0 * r * x2
    rows[..., 2, 2] = abs(r)
    return np.stack([-2.0 * r * x1 * x2, r * (x2 * x2 - x1 * x1), abs(r) * height], axis=-1), rows


def _quaternion(coordinates: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x0, x1 and x2 of coordinates (..., 3), (...) each; x0 is NaN beyond the unit circle."""
    x1, x2 = coordinates[..., 0], coordinates[..., 1]
    with np.errstate(invalid="ignore"):
        return np.sqrt(1.0 - x1 * x1 - x2 * x2), x1, x2


def rotated(coordinates: FloatArray, vector: FloatArray) -> FloatArray:
    """Return R v (..., 3) for the turn by (x0, x1, x2, 0)."""
    x0, x1, x2 = _quaternion(coordinates)
    a, b, c = (vector[..., k] for k in range(3))
    # w = x × v, and v' = v + 2 x0 w + 2 x × w.
    w1, w2, w3 = x2 * c, -x1 * c, x1 * b - x2 * a
    rows = [
        a + 2.0 * (x0 * w1 + x2 * w3),
        b + 2.0 * (x0 * w2 - x1 * w3),
        c + 2.0 * (x0 * w3 + x1 * w2 - x2 * w1),
    ]
    return np.stack(rows, axis=-1)


def turned(coordinates: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R v as `rotated`, and its derivatives by x1 and x2, rows of (..., 2, 3)."""
    x0, x1, x2 = _quaternion(coordinates)
    a, b, c = (vector[..., k] for k in range(3))
    w1, w2, w3 = x2 * c, -x1 * c, x1 * b - x2 * a
    with np.errstate(invalid="ignore", divide="ignore"):
        first, second = x1 / x0, x2 / x0
    # w changes by (0, -c, b) per x1 and by (c, 0, -a) per x2.
    by_first = [x2 * b - first * w1, -x0 * c - first * w2 - x1 * b - w3, x0 * b - first * w3 - x1 * c + w2]
    by_second = [x0 * c - second * w1 - x2 * a + w3, x1 * a - second * w2, -x0 * a - second * w3 - x2 * c - w1]
    slopes = np.stack([np.stack(by_first, axis=-1), np.stack(by_second, axis=-1)], axis=-2)
    return rotated(coordinates, vector), 2.0 * slopes


def _angular(coordinates: FloatArray) -> FloatArray:
    """Return the angular velocities [rad] of the turn by (x0, x1, x2, 0) per x1 and x2, rows of (N, 2, 3)."""
    x0, x1, x2 = _quaternion(coordinates)
    # Twice the vector part of dq q*.
    first = [x0 + x1 * x1 / x0, x1 * x2 / x0, -x2]
    second = [x1 * x2 / x0, x0 + x2 * x2 / x0, x1]
    return 2.0 * np.stack([np.stack(first, axis=-1), np.stack(second, axis=-1)], axis=-2)


def inverses(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inverses of (..., 3, 3) by cofactors, and the determinants (...); not finite where singular."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        columns = [_cross(b, c), _cross(c, a), _cross(a, b)]
        determinant = (a * columns[0]).sum(axis=-1)
        return np.stack(columns, axis=-1) / determinant[..., None, None], determinant


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    # NumPy's own spends most of its time on the axes.
    x, y, z = (a[..., k] for k in range(3))
    u, v, w = (b[..., k] for k in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
