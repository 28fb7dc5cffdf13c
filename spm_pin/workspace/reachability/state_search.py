"""States within leg limits that put points of the platform where they should be, or as near as they can.

Unknown are the coordinates c of both stages. To be zero are p(c) - y, by how much each of the six lengths l(c) is
outside its limits, and how far each stage is beyond a forward singularity: smooth functions of c, without the infinite
derivatives that the position has as a function of the lengths. All searches here are damped least squares of that kind,
for many members at once.

A point is reachable if all of it can vanish; a state found counts only if it is physical: the position that its
lengths give, snapped to the limits, is compared with the point.
"""

from __future__ import annotations

import numpy as np

from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox
from spm_pin.workspace.reachability.position_map import CENTRE

RESOLUTION = 1e-9
"""Distances are found to this share of the machine's size."""
_EPS = float(np.finfo(np.float64).eps)
SINGULARITY_MARGIN = 1e-6
"""Least determinant of a stage, as a share of that at home, in searches for the boundary: nearer to a forward
singularity, rounding of the lengths moves o farther than `RESOLUTION`."""
_STEPS = {"Gauss-Newton": 40, "Newton": 200}
"""Steps of a search at most."""
_STALL_STEPS = 8
"""Steps after which the residual norm is compared with what it was before them."""
_LEAST_DECREASE = {"Gauss-Newton": 1e-3, "Newton": 1e-6}
"""Relative decrease of the residual norm in that many steps, below which a search ends."""
_DOUBT = 1e-4
"""Residual norm, over the machine's size, up to which a search that ends away from a minimum leaves its point
undecided."""
_GRADIENT_TOLERANCE = {"Gauss-Newton": 1e-6, "Newton": 1e-9}
"""Gradient of half the squared residual norm, over that norm, at which a state is stationary, dimensionless."""
_DAMPING = 1e-3
"""Damping of the first step, relative to the matrix."""
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-13, 1e3
"""Least damping, and the one at which a search ends: its steps are too short to gain anything."""
_DIFFERENCE = 1e-7
"""Step in the coordinates of the stages for derivatives of the determinants."""
_SECOND_DIFFERENCE = 1e-4
"""Step in them for derivatives of the Jacobian."""


class StateSearch:
    """Damped least squares over the coordinates of both stages, for N members at once.

    Parameters
    ----------
    box : LegLengthBox
        The leg lengths, the family, and the side of its forward singularities on which each stage has to be.
    targets : ndarray, shape (N, 3K)
        Where the points of `body` (K, 3), given in {m}, should be [m].
    coordinates : ndarray, shape (N, 2, 3)
        States to begin with; then those that have been reached. `stationary` (N,) says where the gradient vanishes.
    singularity_margin : float
        Least determinant of a stage, as a share of what `PositionMap.determinants` is at home.

    Notes
    -----
    The limits, of six lengths and of the two stages' determinants times the machine's size, are penalised: `weights`
    (N,) are the penalty weights, dimensionless, and `shifts` (N, 8) [m] the multipliers over the squared weights, which
    are added to these values before they are compared with their limits. Both may be changed; then call `refresh`.
    """

    def __init__(
        self,
        box: LegLengthBox,
        targets: FloatArray,
        coordinates: FloatArray,
        body: FloatArray = CENTRE,
        singularity_margin: float = 0.0,
    ) -> None:
        self.box, self.body = box, body
        self.scale = 1.0 / np.sqrt(len(body))
        self.targets, self.coordinates = self.scale * targets, coordinates.copy()
        self._unit = box.size * np.array(box.sides)
        self._low = np.concatenate([box.minimum, np.full(2, singularity_margin * box.size)])
        self._high = np.concatenate([box.maximum, np.full(2, np.inf)])
        count = len(targets)
        self.weights, self.shifts = np.ones(count), np.zeros((count, 8))
        self.stationary = np.zeros(count, dtype=bool)
        self.members = np.arange(count)
        self.residual, self.jacobian = self._residuals(self.members, self.coordinates)

    def refresh(self, index: IntArray) -> None:
        """Evaluate members again, after a change of weights or shifts."""
        self.residual[index], self.jacobian[index] = self._residuals(index, self.coordinates[index])

    @property
    def residual_norm(self) -> FloatArray:
        """Norm of the residual at the states [m], whose square is minimised, shape (N,)."""
        return np.asarray(np.sqrt((self.residual**2).sum(axis=-1)))

    @property
    def position(self) -> FloatArray:
        """Where the points are, times `scale`, shape (N, 3K) [m]."""
        return np.asarray(self.targets + self.error)

    @property
    def error(self) -> FloatArray:
        """How far the points are from the targets, times `scale`, shape (N, 3K) [m]."""
        return np.asarray(self.residual[:, :-8])

    @property
    def distance(self) -> FloatArray:
        """Root mean square distance of the points from the targets, shape (N,) [m]."""
        return np.asarray(np.sqrt((self.error**2).sum(axis=-1)))

    def proved(self) -> tuple[BoolArray, BoolArray]:
        """Return which members have a physical state with o at the target, and which are in doubt, (N,) each.

        In doubt are those in another assembly mode, and those that stalled just short of a state.
        """
        solved = self.residual_norm <= RESOLUTION * self.box.size
        good, lengths = solved.copy(), self.box.lengths(self.coordinates[solved])
        good[solved], _ = self.box.confirm(lengths, self.targets[solved], RESOLUTION)
        return good, ~good & (solved | (~self.stationary & (self.residual_norm <= _DOUBT * self.box.size)))

    def _residuals(
        self, index: IntArray, coordinates: FloatArray, active: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (n, 3K + 8) [m] and their Jacobians (n, 3K + 8, 6) with respect to the coordinates.

        The errors of the points, the violations of six lengths' limits, and how far each stage is beyond a forward
        singularity. Of the last eight, the derivatives of those that are `active`: not within limits.
        """
        position, derivatives = self.box.map.points(coordinates, self.body)
        lengths, slopes = self.box.map.legs(coordinates)
        determinants = self._unit * self.box.map.determinants(slopes)
        values = np.concatenate([lengths.reshape(-1, 6), determinants], axis=-1) + self.shifts[index]
        outside = values - np.clip(values, self._low, self._high)
        active = outside != 0.0 if active is None else active
        rows = position.shape[-1]
        jacobian = np.zeros((len(index), rows + 8, 6))
        jacobian[:, :rows] = self.scale * derivatives
        for k in range(2):
            part = slice(3 * k, 3 * k + 3)
            jacobian[:, rows + 3 * k : rows + 3 * k + 3, part] = np.where(active[:, part, None], slopes[:, k], 0.0)
        crossed = np.flatnonzero(active[:, 6:].any(axis=-1))
        if len(crossed):
            there = coordinates[crossed] + _DIFFERENCE * np.eye(3)[:, None, None]
            change = self._unit * self.box.map.determinants(self.box.map.legs(there)[1]) - determinants[crossed]
            for k in range(2):
                slope = np.where(active[crossed, 6 + k], change[..., k] / _DIFFERENCE, 0.0)
                jacobian[crossed, rows + 6 + k, 3 * k : 3 * k + 3] = slope.T
        weights = self.weights[index, None]
        jacobian[:, rows:] *= weights[..., None]
        return np.concatenate([self.scale * position - self.targets[index], weights * outside], axis=-1), jacobian

    def _curvature(self, index: IntArray) -> FloatArray:
        """Return the residual times its second derivatives, (n, 6, 6), from differences of the Jacobian."""
        steps = _SECOND_DIFFERENCE * np.concatenate([np.eye(6), -np.eye(6)]).reshape(12, 2, 3)
        residual = self.residual[index]
        there = (self.coordinates[index, None] + steps).reshape(-1, 2, 3)
        _, jacobian = self._residuals(np.repeat(index, 12), there, np.repeat(residual[:, -8:] != 0.0, 12, axis=0))
        slopes = np.einsum("nkij,ni->nkj", jacobian.reshape(len(index), 12, -1, 6), residual)
        matrix = (slopes[:, :6] - slopes[:, 6:]) / (2.0 * _SECOND_DIFFERENCE)
        matrix = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
        return np.where(np.isfinite(matrix).all(axis=(-1, -2), keepdims=True), matrix, 0.0)

    def iterate(self, members: IntArray | None = None, method: str = "Gauss-Newton") -> None:
        """Iterate `members`, all if not given, by the damped "Gauss-Newton" or "Newton" method.

        Until the gradient is small, the residual norm vanishes, or it hardly decreases in eight steps.
        """
        active = self.members if members is None else members
        self.damping = np.full(len(self.coordinates), _DAMPING)
        before = self.residual_norm
        for count in range(1, _STEPS[method] + 1):
            residual, jacobian, norm = self.residual[active], self.jacobian[active], self.residual_norm[active]
            gradient = np.einsum("nij,ni->nj", jacobian, residual)
            largest = np.abs(gradient).max(axis=-1, initial=0.0)
            self.stationary[active] = largest <= _GRADIENT_TOLERANCE[method] * norm
            going = ~self.stationary[active] & (norm > 1e-3 * RESOLUTION * self.box.size)
            going &= self.damping[active] < _LARGEST_DAMPING
            if count % _STALL_STEPS == 0:
                # Newton's method near a solution is faster than that.
                going &= norm <= (1.0 - _LEAST_DECREASE[method]) * before[active]
                before[active] = norm
            active = active[going]
            jacobian, gradient, largest, norm = (array[going] for array in (jacobian, gradient, largest, norm))
            if not len(active):
                break
            matrix = np.swapaxes(jacobian, -1, -2) @ jacobian
            if method == "Newton":
                step = newton_step(matrix + self._curvature(active), gradient, self.damping[active])
            else:
                step = damped_solution(matrix, gradient, self.damping[active])
            trial = self.coordinates[active] - step.reshape(-1, 2, 3)
            errors, derivatives = self._residuals(active, trial)
            # False for NaN, beyond the unit circle. At the end, what a step gains is less than the norm's rounding.
            change = np.sqrt((errors**2).sum(axis=-1)) - norm
            flatter = np.abs(np.einsum("nij,ni->nj", derivatives, errors)).max(axis=-1, initial=0.0) < largest
            rounding = 4.0 * _EPS * self.box.size
            better = (change < -rounding) | ((change < rounding) & flatter)
            chosen = active[better]
            self.coordinates[chosen] = trial[better]
            self.residual[chosen], self.jacobian[chosen] = errors[better], derivatives[better]
            damping = self.damping[active]
            self.damping[active] = np.where(better, np.maximum(0.1 * damping, _LEAST_DAMPING), 10.0 * damping)


def damped_solution(matrix: FloatArray, right: FloatArray, damping: FloatArray) -> FloatArray:
    """Return (M + damping · trace(M) · I)⁻¹ right of symmetric, positive matrices (N, n, n), shape (N, n).

    Damping relative to the matrix keeps it regular to rounding however large its elements are, as near a forward
    singularity. Zero where a matrix is not finite.
    """
    size = matrix.shape[-1]
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    good = np.isfinite(trace) & (trace > 0.0) & np.isfinite(right).all(axis=-1)
    matrix = np.where(good[:, None, None], matrix, np.eye(size))
    shift = (damping * np.where(good, trace, 1.0))[:, None, None] * np.eye(size)
    solution = np.linalg.solve(matrix + shift, np.where(good[:, None], right, 0.0)[..., None])
    return np.asarray(solution[..., 0])


def newton_step(matrix: FloatArray, right: FloatArray, damping: FloatArray) -> FloatArray:
    """Return the solution (N, n) with the absolute eigenvalues of symmetric matrices (N, n, n), and damping."""
    good = np.asarray(np.isfinite(matrix).all(axis=(-1, -2)))
    values, vectors = np.linalg.eigh(np.where(good[:, None, None], matrix, 0.0))
    values = np.abs(values)
    values += damping[:, None] * np.maximum(values.max(axis=-1, keepdims=True), np.finfo(float).tiny)
    turned = np.swapaxes(vectors, -1, -2) @ np.where(good[:, None], right, 0.0)[..., None]
    return np.asarray((vectors @ (turned / values[..., None]))[..., 0])
