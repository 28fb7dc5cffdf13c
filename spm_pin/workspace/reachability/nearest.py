"""The point of the reachable set nearest to a given one: least squares in the box of the leg lengths.

In the mode of a real machine the six lengths l determine where the platform's centre o is, and the reachable positions
are the image W of the box of the limits under that map p(l). The point of W nearest to y minimises |p(l) - y|² over the
box. Where that is zero y is reachable; elsewhere n = (y - p)/|y - p| is an outward normal of W, and with the gradient
q_i = n·∂p/∂l_i

    q_i = 0 for a free leg,    q_i ≥ 0 for one at its maximum,    q_i ≤ 0 for one at its minimum.            (1)

So a leg is at a limit, or n annihilates the whole 3 x 6 Jacobian of the position, which then has lost its rank.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_box import LegBox

__all__ = ["RESOLUTION", "Nearest", "Progress", "merged", "nearest_in_box"]

BoolArray = npt.NDArray[np.bool_]
Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many steps are done, and of how many; may raise to interrupt."""

_EPS = float(np.finfo(np.float64).eps)
RESOLUTION = 1e-9
"""Distances are found to this share of the machine's size."""
_CHUNK = 8192
_GAUSS_NEWTON, _NEWTON = 30, 500
_FLAT = 1e-9
"""Where the gradient is at most this, no leg length that is free makes the distance shorter."""
_DAMPING, _LEAST_DAMPING = 1e-4, 1e-10
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
        From the point asked for [m].
    gradient : ndarray, shape (N, 6)
        q of Eq. (1), with n towards the point asked for; zero where that is reachable.
    optimality : ndarray, shape (N,)
        By how much q violates Eq. (1), the largest of the six; zero where the point is reachable. Infinite where the
        search has left the mode of a real machine; then `position` is where that mode has o.
    coordinates : ndarray, shape (N, 2, 3)
        The state for `spm_pin.workspace.reachability.position_map`, to begin another search with.
    """

    position: FloatArray
    lengths: FloatArray
    distance: FloatArray
    gradient: FloatArray
    optimality: FloatArray
    coordinates: FloatArray

    def part(self, index: npt.NDArray[np.intp]) -> Nearest:
        """Return some of the N."""
        return Nearest(*(getattr(self, name)[index] for name in Nearest.__dataclass_fields__))


def merged(whole: Nearest, index: npt.NDArray[np.intp], part: Nearest) -> Nearest:
    """Return `whole` with `part` in the places `index`."""
    arrays = {name: getattr(whole, name).copy() for name in Nearest.__dataclass_fields__}
    for name, array in arrays.items():
        array[index] = getattr(part, name)
    return Nearest(**arrays)


def nearest_in_box(box: LegBox, points: FloatArray, starts: FloatArray | None = None, tries: int = 1) -> Nearest:
    """Return the point of the reachable set nearest to each of `points` (N, 3) [m].

    Parameters
    ----------
    box : LegBox
        The leg lengths.
    points : ndarray, shape (N, 3)
        In {B} [m].
    starts : ndarray, shape (N, 2, 3), optional
        States within the box to begin with, as in `Nearest.coordinates`.
    tries : int
        How many more beginnings, near the point, are tried where it seems to be out of reach.

    Notes
    -----
    Gauss-Newton, then Newton's method for those that have not arrived, both projected on the box: a leg at a limit
    stays there if the gradient holds it there, see Bertsekas, SIAM J. Control Optim. 20 (1982) 221. Steps are damped
    until they reduce the distance.
    """
    parts = []
    for first in range(0, max(len(points), 1), _CHUNK):
        part = slice(first, first + _CHUNK)
        parts.append(_solved(box, points[part], None if starts is None else starts[part], tries))
    return Nearest(*(np.concatenate([getattr(part, name) for part in parts]) for name in Nearest.__dataclass_fields__))


def _solved(box: LegBox, points: FloatArray, starts: FloatArray | None, tries: int) -> Nearest:
    begin = _Search(box, points, box.coordinates[box.tree.query(points)[1]] if starts is None else starts)
    begin.approach()
    if tries > 1:
        remote = np.flatnonzero(begin.distance > RESOLUTION * box.size)
        # Neighbours in space may be neighbours in leg space too: every third of them.
        many = min(3 * tries, len(box.lengths))
        places = np.empty((len(points), many), dtype=np.intp)
        places[remote] = box.tree.query(points[remote], many)[1].reshape(-1, many)
        for k in range(0, many, 3):
            other = _Search(box, points[remote], box.coordinates[places[remote, k]])
            other.approach()
            begin.take(remote, other)
            remote = remote[begin.distance[remote] > RESOLUTION * box.size]
    begin.settle()
    return begin.result()


class _Search:
    """The iteration, on N points at once."""

    def __init__(self, box: LegBox, points: FloatArray, coordinates: FloatArray) -> None:
        self.box, self.points, self.coordinates = box, points, coordinates.copy()
        self.lengths = box.snapped(box.map.lengths(coordinates))
        self.position, self.jacobian = box.map.position(coordinates)
        self.damping = np.full(len(points), _DAMPING)

    @property
    def distance(self) -> FloatArray:
        return np.asarray(np.sqrt(((self.position - self.points) ** 2).sum(axis=-1)))

    def take(self, index: npt.NDArray[np.intp], other: _Search) -> None:
        """Take over what `other` found nearer, for the points `index`."""
        better = other.distance < self.distance[index]
        for name in ("coordinates", "lengths", "position", "jacobian"):
            getattr(self, name)[index[better]] = getattr(other, name)[better]

    def approach(self) -> None:
        """Go by Gauss-Newton, which arrives where the point is reachable, or free legs move o only along the set."""
        self._iterate(np.arange(len(self.points)), _GAUSS_NEWTON, exact=False)

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
        self, index: npt.NDArray[np.intp], error: FloatArray, held: BoolArray, slope: FloatArray, *, exact: bool
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
            # What is at its end pulls the others along.
            right = slope[left] + (hessian[left] @ np.where(stop, step[left], 0.0)[..., None])[..., 0]
            right = np.where(stop, 0.0, right)[..., None]
            matrix = np.where(stop[:, :, None] | stop[:, None, :], np.eye(6), hessian[left])
            if exact:
                values, vectors = np.linalg.eigh(matrix)
                values = np.abs(values) + damping[left, None]
                solved = vectors @ ((np.swapaxes(vectors, -1, -2) @ right) / values[..., None])
            else:
                solved = np.linalg.solve(matrix + damping[left, None, None] * np.eye(6), right)
            free = np.where(stop, step[left], -solved[..., 0])
            step[left] = np.clip(free, low[left], high[left])
            beyond = (step[left] != free) & ~stop
            fixed[left] |= beyond
            left = left[beyond.any(axis=-1)]
        return step

    def _iterate(self, active: npt.NDArray[np.intp], steps: int, *, exact: bool) -> npt.NDArray[np.intp]:
        """Step; return those of `active` that have not arrived."""
        box = self.box
        for _ in range(steps):
            error = self.position[active] - self.points[active]
            held, slope = self._projected(self.lengths[active], self.jacobian[active], error)
            distance = np.sqrt((error**2).sum(axis=-1))
            arrived = distance <= 1e-3 * RESOLUTION * box.size
            arrived |= np.abs(slope).max(axis=-1, initial=0.0) <= _FLAT * distance
            # No step is short enough.
            arrived |= self.damping[active] > 1e8
            going = ~arrived
            active, error, held, slope = active[going], error[going], held[going], slope[going]
            if not len(active):
                break
            step = self._step(active, error, held, slope, exact=exact)
            lengths = box.snapped(self.lengths[active] + step)
            coordinates = box.map.moved(self.coordinates[active], lengths)
            position, derivatives = box.map.position(coordinates)
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
        return active

    def _curvature(self, index: npt.NDArray[np.intp], error: FloatArray) -> FloatArray:
        """Return the second derivatives of error·p, (n, 6, 6), from differences of the Jacobian."""
        h = _DIFFERENCE * self.box.size
        shifted = self.lengths[index, None, :] + h * np.concatenate([np.eye(6), -np.eye(6)])
        start = np.repeat(self.coordinates[index], 12, axis=0)
        _, jacobian = self.box.map.position(self.box.map.moved(start, np.maximum(shifted, h).reshape(-1, 6)))
        slopes = (jacobian.reshape(len(index), 12, 3, 6) * error[:, None, :, None]).sum(axis=-2)
        matrix = (slopes[:, :6] - slopes[:, 6:]) / (2.0 * h)
        matrix = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
        return np.where(np.isnan(matrix).any(axis=(-1, -2), keepdims=True), 0.0, matrix)

    def result(self) -> Nearest:
        states = forward_physical(self.box.geometry, self.lengths)
        with np.errstate(invalid="ignore"):
            strayed = ~(
                np.abs(states.translation - self.position).max(axis=-1, initial=0.0) <= _STRAYED * self.box.size
            )
        self.position[strayed] = states.translation[strayed]
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
