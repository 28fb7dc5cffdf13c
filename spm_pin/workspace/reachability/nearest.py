"""The states nearest to given points or poses: least squares in the box of the leg lengths.

In one assembly mode the six lengths l determine where points of the platform are. For the platform's centre o alone, in
the mode of a real machine, the reachable positions are the image W of the box of the limits under that map p(l). The
point of W nearest to y minimises |p(l) - y|² over the box. Where that is zero y is reachable; elsewhere
n = (y - p)/|y - p| is an outward normal of W, and with the gradient q_i = n·∂p/∂l_i

    q_i = 0 for a free leg,    q_i ≥ 0 for one at its maximum,    q_i ≤ 0 for one at its minimum.            (1)

So a leg is at a limit, or n annihilates the whole 3 x 6 Jacobian of the position, which then has lost its rank. For
three points, the platform's joints c_1, c_2, c_3, the same finds the nearest pose; n and q are those of all nine
coordinates over √3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_box import LegBox
from spm_pin.workspace.reachability.position_map import PositionMap
from spm_pin.workspace.reachability.state_search import RESOLUTION, damped_solution, search_states

__all__ = ["LegSearch", "Nearest", "merged", "nearest_in_box"]

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

_EPS = float(np.finfo(np.float64).eps)
_CHUNK = 8192
_GAUSS_NEWTON, _NEWTON = 30, 200
_STALLED, _PROGRESS = 10, 1e-6
_SHORTEST = 1e4  # damping with which no step is worth another
_FLAT = 1e-9
"""Largest gradient at which no free leg length makes the distance shorter."""
_DAMPING, _LEAST_DAMPING = 1e-4, 1e-12
_STARTS, _REMOTE_STARTS = 2, 3
_CENTRE = np.zeros((1, 3))
_STRAYED = 1e-9
_DIFFERENCE = 1e-4  # of lengths, relative to the machine: the rounding of a second derivative is its square's inverse


@dataclass(frozen=True)
class Nearest:
    """Points of the reachable set, arrays over N.

    Attributes
    ----------
    position : ndarray, shape (N, 3)
        The points, in {B} [m].
    lengths : ndarray, shape (N, 6)
        Leg lengths that put o there [m]; a leg at a limit has that limit to the last bit.
    distance : ndarray, shape (N,)
        Distance from the given point [m].
    gradient : ndarray, shape (N, 6)
        q of Eq. (1), with n towards the given point; zero where that is reachable.
    optimality : ndarray, shape (N,)
        By how much q violates Eq. (1), the largest of the six; zero where the point is reachable. Infinite where the
        search has left the mode of a real machine; then the state is the one it began with.
    coordinates : ndarray, shape (N, 2, 3)
        The state for `spm_pin.workspace.reachability.position_map`, to begin another search with.
    """

    position: FloatArray
    lengths: FloatArray
    distance: FloatArray
    gradient: FloatArray
    optimality: FloatArray
    coordinates: FloatArray

    def part(self, index: IntArray) -> Nearest:
        """Return some of the N."""
        return Nearest(*(getattr(self, name)[index] for name in Nearest.__dataclass_fields__))


def merged(whole: Nearest, index: IntArray, part: Nearest) -> Nearest:
    """Return `whole` with `part` in the places `index`."""
    arrays = {name: getattr(whole, name).copy() for name in Nearest.__dataclass_fields__}
    for name, array in arrays.items():
        array[index] = getattr(part, name)
    return Nearest(**arrays)


def nearest_in_box(box: LegBox, points: FloatArray, starts: FloatArray | None = None) -> Nearest:
    """Return the point of the reachable set nearest to each of `points` (N, 3) [m].

    Parameters
    ----------
    box : LegBox
        The leg lengths.
    points : ndarray, shape (N, 3)
        In {B} [m].
    starts : ndarray, shape (N, 2, 3), optional
        States within the box to begin with, as in `Nearest.coordinates`. If not given, `search_states` says which
        points are reachable, and the others begin at the best states of `LegBox.nearby`.
    """
    if not len(points):
        return LegSearch(box, points, np.empty((0, 2, 3))).result()
    return _joined([_nearest(box, points, starts, slice(k, k + _CHUNK)) for k in range(0, len(points), _CHUNK)])


def _nearest(box: LegBox, points: FloatArray, starts: FloatArray | None, part: slice) -> Nearest:
    if starts is not None:
        search = LegSearch(box, points[part], starts[part])
        search.approach()
    else:
        found = search_states(box, points[part])
        search = LegSearch(box, points[part], found.coordinates)
        left = np.flatnonzero(~found.reached)
        _, others = box.nearby(points[part][left], _STARTS)
        # Far away the other ones are not the best.
        remote = box.sample[box.tree.query(points[part][left], _REMOTE_STARTS)[1]]
        others = np.concatenate([others, remote], axis=1)
        for k in range(others.shape[1]):
            other = LegSearch(box, points[part][left], others[:, k])
            other.approach()
            search.take(left, other)
    search.settle()
    return search.result()


def _joined(parts: list[Nearest]) -> Nearest:
    names = Nearest.__dataclass_fields__
    return Nearest(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class LegSearch:
    """Gauss-Newton and Newton's method over the leg lengths, for N members at once.

    Both are projected on the box: a leg at a limit stays there if the gradient holds it there, see Bertsekas, SIAM J.
    Control Optim. 20 (1982) 221. Steps are damped until they reduce the distance.

    Parameters
    ----------
    box : LegBox
        The leg lengths.
    targets : ndarray, shape (N, 3K)
        Where the points of `body` should be [m].
    coordinates : ndarray, shape (N, 2, 3)
        States within the box to begin with.
    body : ndarray, shape (K, 3)
        Points in {m} [m].
    mapping : PositionMap, optional
        Of the family of the states, if that is not TT.
    """

    def __init__(
        self,
        box: LegBox,
        targets: FloatArray,
        coordinates: FloatArray,
        body: FloatArray = _CENTRE,
        mapping: PositionMap | None = None,
    ) -> None:
        self.box, self.body, self.map = box, body, mapping or box.map
        self.scale = 1.0 / np.sqrt(len(body))
        self.points, self.first, self.coordinates = self.scale * targets, coordinates, coordinates.copy()
        self.lengths = box.snapped(self.map.lengths(coordinates))
        self.position, self.jacobian = self._positions(coordinates)
        self.damping = np.full(len(targets), _DAMPING)

    def _positions(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        position, jacobian = self.map.position(coordinates, self.body)
        return self.scale * position, self.scale * jacobian

    @property
    def distance(self) -> FloatArray:
        """From the targets, shape (N,) [m]."""
        return np.asarray(np.sqrt(((self.position - self.points) ** 2).sum(axis=-1)))

    def take(self, index: IntArray, other: LegSearch) -> None:
        """Take over what `other` found nearer, for the points `index`."""
        better = other.distance < self.distance[index]
        for name in ("coordinates", "lengths", "position", "jacobian"):
            getattr(self, name)[index[better]] = getattr(other, name)[better]

    def approach(self, steps: int = _GAUSS_NEWTON) -> None:
        """Go by Gauss-Newton, which arrives where the point is reachable, or free legs move o only along the set."""
        self._iterate(np.arange(len(self.points)), steps, exact=False)

    def settle(self) -> None:
        """Go on by Newton's method where that has not arrived."""
        self.damping[:] = _DAMPING
        self._iterate(np.arange(len(self.points)), _NEWTON, exact=True)

    def _projected(self, lengths: FloatArray, jacobian: FloatArray, error: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return which legs a limit holds, and Jᵀ (p - y) without them, both (n, 6)."""
        slope = (jacobian * error[:, :, None]).sum(axis=1)
        held = ((lengths <= self.box.minimum) & (slope > 0.0)) | ((lengths >= self.box.maximum) & (slope < 0.0))
        return held, np.where(held, 0.0, slope)

    def _step(
        self, index: IntArray, error: FloatArray, held: BoolArray, slope: FloatArray, *, exact: bool
    ) -> FloatArray:
        """Return the change of the lengths, (n, 6), that leads to the nearest point to second order within the limits.

        Legs that would go beyond a limit stop there, and the others go where that is best.
        """
        jacobian, lengths, damping = self.jacobian[index], self.lengths[index], self.damping[index]
        hessian = np.swapaxes(jacobian, -1, -2) @ jacobian
        if exact:
            hessian = hessian + self._curvature(index, error)
        low, high = self.box.minimum - lengths, self.box.maximum - lengths
        step = np.zeros_like(slope)
        left, fixed = np.arange(len(index)), held.copy()
        while len(left):
            stop = fixed[left]
            # Legs at a limit change the step of the others.
            right = slope[left] + (hessian[left] @ np.where(stop, step[left], 0.0)[..., None])[..., 0]
            right = np.where(stop, 0.0, right)
            matrix = np.where(stop[:, :, None] | stop[:, None, :], np.eye(6), hessian[left])
            if exact:
                solved = _newton_step(matrix, right, damping[left])
            else:
                solved = damped_solution(matrix, right, damping[left])
            if not np.isfinite(solved).all():
                solved = np.nan_to_num(solved, nan=0.0, posinf=0.0, neginf=0.0)
            free = np.where(stop, step[left], -solved)
            step[left] = np.clip(free, low[left], high[left])
            beyond = (step[left] != free) & ~stop
            fixed[left] |= beyond
            left = left[beyond.any(axis=-1)]
        return step

    def _iterate(self, active: IntArray, steps: int, *, exact: bool) -> None:
        box = self.box
        before = self.distance
        for count in range(1, steps + 1):
            if count % _STALLED == 0:
                # Towards a forward singularity steps become shorter and shorter.
                distance = self.distance[active]
                active = active[distance <= (1.0 - _PROGRESS) * before[active]] if count > _STALLED else active
                before[active] = self.distance[active]
            error = self.position[active] - self.points[active]
            held, slope = self._projected(self.lengths[active], self.jacobian[active], error)
            distance = np.sqrt((error**2).sum(axis=-1))
            arrived = distance <= 1e-3 * RESOLUTION * box.size
            arrived |= np.abs(slope).max(axis=-1, initial=0.0) <= _FLAT * distance
            arrived |= self.damping[active] > _SHORTEST
            going = ~arrived
            active, error, held, slope = active[going], error[going], held[going], slope[going]
            if not len(active):
                break
            step = self._step(active, error, held, slope, exact=exact)
            lengths = box.snapped(self.lengths[active] + step)
            coordinates = self.map.moved(self.coordinates[active], lengths)
            position, derivatives = self._positions(coordinates)
            # False for what does not exist. At the end, what a step gains is less than the rounding of the distance.
            moved = position - self.points[active]
            change = np.sqrt((moved**2).sum(axis=-1)) - distance[going]
            _, after = self._projected(lengths, derivatives, moved)
            flatter = np.abs(after).max(axis=-1, initial=0.0) < np.abs(slope).max(axis=-1, initial=0.0)
            better = (change < -4.0 * _EPS * box.size) | ((change < 4.0 * _EPS * box.size) & flatter)
            chosen = active[better]
            self.lengths[chosen], self.position[chosen] = lengths[better], position[better]
            self.jacobian[chosen], self.coordinates[chosen] = derivatives[better], coordinates[better]
            damping = self.damping[active]
            self.damping[active] = np.where(better, np.maximum(0.1 * damping, _LEAST_DAMPING), 10.0 * damping)

    def _curvature(self, index: IntArray, error: FloatArray) -> FloatArray:
        """Return the second derivatives of error·p, (n, 6, 6), from differences of the Jacobian."""
        h = _DIFFERENCE * self.box.size
        shifted = self.lengths[index, None, :] + h * np.concatenate([np.eye(6), -np.eye(6)])
        start = np.repeat(self.coordinates[index], 12, axis=0)
        _, jacobian = self._positions(self.map.moved(start, np.maximum(shifted, h).reshape(-1, 6)))
        slopes = (jacobian.reshape(len(index), 12, -1, 6) * error[:, None, :, None]).sum(axis=-2)
        matrix = (slopes[:, :6] - slopes[:, 6:]) / (2.0 * h)
        matrix = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
        return np.where(np.isfinite(matrix).all(axis=(-1, -2), keepdims=True), matrix, 0.0)

    def result(self) -> Nearest:
        """Return what was found by a search for o, each state checked against the mode of a real machine.

        One that has left it is replaced by the state that it began with.
        """
        states = forward_physical(self.box.geometry, self.lengths)
        with np.errstate(invalid="ignore"):
            strayed = ~(
                np.abs(states.translation - self.position).max(axis=-1, initial=0.0) <= _STRAYED * self.box.size
            )
        if strayed.any():
            first = LegSearch(self.box, self.points[strayed], self.first[strayed])
            for name in ("coordinates", "lengths", "position", "jacobian"):
                getattr(self, name)[strayed] = getattr(first, name)
        error = self.position - self.points
        _, slope = self._projected(self.lengths, self.jacobian, error)
        gradient = (self.jacobian * error[:, :, None]).sum(axis=1)
        distance = self.distance
        remote = distance > RESOLUTION * self.box.size
        scale = np.where(remote, -distance, 1.0)[:, None]
        optimality = np.where(remote, np.abs(slope / scale).max(axis=-1, initial=0.0), 0.0)
        optimality[strayed] = np.inf
        gradient = np.where(remote[:, None], gradient / scale, 0.0)
        return Nearest(self.position, self.lengths, distance, gradient, optimality, self.coordinates)


def _newton_step(matrix: FloatArray, right: FloatArray, damping: FloatArray) -> FloatArray:
    """Return the solution (N, n) with the absolute eigenvalues of symmetric matrices (N, n, n), and damping."""
    good = np.asarray(np.isfinite(matrix).all(axis=(-1, -2)))
    values, vectors = np.linalg.eigh(np.where(good[:, None, None], matrix, 0.0))
    values = np.abs(values)
    values += damping[:, None] * np.maximum(values.max(axis=-1, keepdims=True), np.finfo(float).tiny)
    turned = np.swapaxes(vectors, -1, -2) @ np.where(good[:, None], right, 0.0)[..., None]
    return np.asarray((vectors @ (turned / values[..., None]))[..., 0])
