"""States within leg limits that put the platform's centre at given points: which points are reachable.

Unknown are the coordinates c of both stages. To be zero are p(c) - y, by how much each of the six lengths l(c) is
outside its limits, and how far each stage is beyond a forward singularity: eleven functions of six unknowns, without
the infinite derivatives that the position has as a function of the lengths. The search begins at states that
`LegBox.nearby` finds by going through all of the set, and a state found counts only if it is one of a real machine: the
position that its lengths give, snapped to the limits, is compared with the point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_box import LegBox
from spm_pin.workspace.reachability.position_map import inverses

__all__ = ["RESOLUTION", "Membership", "Progress", "damped_solution", "search_states"]

BoolArray = npt.NDArray[np.bool_]
Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many steps are done, and of how many; may raise to interrupt."""

RESOLUTION = 1e-9
"""Distances are found to this share of the machine's size."""
_STARTS = 8
_STEPS = 40
_STALLED, _PROGRESS = 8, 1e-3
_SHORTEST = 1e3  # damping with which no step is worth another
_DOUBT = 1e-4
"""A search that stalls with a gap below this share of the machine's size is not taken for an answer."""
_FLAT = 1e-6
_LEAST_DAMPING = 1e-13
_PORTION = 4096
_DIFFERENCE = 1e-7


@dataclass(frozen=True)
class Membership:
    """Which of N points are reachable.

    Attributes
    ----------
    reached : ndarray of bool, shape (N,)
        Points with a state: proved.
    undecided : ndarray of bool, shape (N,)
        Points without one for which a search failed: it ended in another assembly mode, or stalled just short of a
        state.
    coordinates : ndarray, shape (N, 2, 3)
        The states found; where there is none, states within the limits with o nearby.
    lengths : ndarray, shape (N, 6)
        Their leg lengths [m].
    distance : ndarray, shape (N,)
        How far the reachable set is, to about two spacings of the box's table [m]; zero where reached.
    """

    reached: BoolArray
    undecided: BoolArray
    coordinates: FloatArray
    lengths: FloatArray
    distance: FloatArray


def search_states(
    box: LegBox,
    points: FloatArray,
    starts: FloatArray | None = None,
    *,
    what: str = "",
    progress: Progress | None = None,
) -> Membership:
    """Search for states within the limits that put o at points.

    Parameters
    ----------
    box : LegBox
        The leg lengths.
    points : ndarray, shape (N, 3)
        In {B} [m].
    starts : ndarray, shape (N, 2, 3), optional
        One state to begin with for each point, instead of those of `LegBox.nearby`.
    what : str
        What is being done, for `progress`.
    progress : callable, optional
        See `Progress`.
    """
    parts = []
    for begin in range(0, max(len(points), 1), _PORTION):
        if progress is not None:
            progress(what, begin, len(points))
        part = slice(begin, begin + _PORTION)
        parts.append(_searched(box, points[part], None if starts is None else starts[part]))
    if progress is not None:
        progress(what, len(points), len(points))
    names = Membership.__dataclass_fields__
    return Membership(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _searched(box: LegBox, points: FloatArray, near: FloatArray | None) -> Membership:
    if near is None:
        distance, starts = box.nearby(points, _STARTS)
    else:
        starts = near[:, None]
        distance = np.sqrt(((box.map.points(near)[0] - points) ** 2).sum(axis=-1))
    reached, undecided = np.zeros((2, len(points)), dtype=bool)
    coordinates = starts[:, 0].copy()
    lengths = box.snapped(box.map.lengths(coordinates))
    left = np.flatnonzero(distance <= box.margin) if near is None else np.arange(len(points))
    for k in range(starts.shape[1]):
        if not len(left):
            break
        found, gap, flat = _solved(box, points[left], starts[left, k])
        legs = box.snapped(box.map.lengths(found))
        tolerance = RESOLUTION * box.size
        solved = np.flatnonzero(gap <= tolerance)
        states = forward_physical(box.geometry, legs[solved])
        with np.errstate(invalid="ignore"):
            good = np.abs(states.translation - points[left[solved]]).max(axis=-1, initial=0.0) <= tolerance
        done = solved[good]
        reached[left[done]] = True
        coordinates[left[done]], lengths[left[done]] = found[done], legs[done]
        # Solved by another assembly mode, or stalled just short of a solution.
        undecided[left] |= (gap <= tolerance) | (~flat & (gap <= _DOUBT * box.size))
        left = np.delete(left, done)
    distance = np.where(reached, 0.0, np.maximum(distance, 0.0))
    return Membership(reached, undecided & ~reached, coordinates, lengths, distance)


def _solved(box: LegBox, points: FloatArray, starts: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return coordinates (N, 2, 3) that miss points and limits least, by how much [m], and where that is a minimum."""
    coordinates = starts.copy()
    residual, jacobian = _gaps(box, points, coordinates)
    gap = np.sqrt((residual**2).sum(axis=-1))
    damping = np.full(len(points), 1e-3)
    flat = np.zeros(len(points), dtype=bool)
    active = np.arange(len(points))
    before = gap.copy()
    for count in range(1, _STEPS + 1):
        if count % _STALLED == 0:
            # Newton's method near a solution is faster than that.
            active = active[gap[active] <= (1.0 - _PROGRESS) * before[active]]
            before[active] = gap[active]
        slope = (jacobian[active] * residual[active, :, None]).sum(axis=1)
        flat[active] = np.abs(slope).max(axis=-1, initial=0.0) <= _FLAT * gap[active]
        going = ~flat[active] & (gap[active] > 1e-3 * RESOLUTION * box.size) & (damping[active] < _SHORTEST)
        active, slope = active[going], slope[going]
        if not len(active):
            break
        matrix = np.swapaxes(jacobian[active], -1, -2) @ jacobian[active]
        step = damped_solution(matrix, slope, damping[active])
        trial = coordinates[active] - step.reshape(-1, 2, 3)
        errors, derivatives = _gaps(box, points[active], trial)
        there = np.sqrt((errors**2).sum(axis=-1))
        better = there < gap[active]  # False for NaN, beyond the unit circle
        chosen = active[better]
        coordinates[chosen], residual[chosen], jacobian[chosen] = trial[better], errors[better], derivatives[better]
        gap[chosen] = there[better]
        damping[active] = np.where(better, np.maximum(0.1 * damping[active], _LEAST_DAMPING), 10.0 * damping[active])
    return coordinates, gap, flat


def _gaps(box: LegBox, points: FloatArray, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what has to vanish, (N, 11) [m], and its derivatives with respect to the coordinates, (N, 11, 6).

    By how much o misses `points`, by how much lengths miss their limits, and how far each stage is beyond a forward
    singularity, as the determinant of the lengths' derivatives in units of that of a stage inside.
    """
    position, derivatives = box.map.points(coordinates)
    legs, slopes = box.map.legs(coordinates)
    lengths = legs.reshape(-1, 6)
    outside = lengths - np.clip(lengths, box.minimum, box.maximum)
    determinants = box.size * inverses(slopes)[1] / box.regular
    beyond = np.minimum(determinants, 0.0)
    jacobian = np.zeros((len(points), 11, 6))
    jacobian[:, :3] = derivatives
    crossed = np.flatnonzero((beyond < 0.0).any(axis=-1))
    for k in range(2):
        rows = slice(3 * k, 3 * k + 3)
        jacobian[:, 3 + 3 * k : 6 + 3 * k, rows] = np.where(outside[:, rows, None] != 0.0, slopes[:, k], 0.0)
    for column in range(3):
        shifted = coordinates[crossed].copy()
        shifted[..., column] += _DIFFERENCE
        change = box.size * inverses(box.map.legs(shifted)[1])[1] / box.regular - determinants[crossed]
        for k in range(2):
            jacobian[crossed, 9 + k, 3 * k + column] = np.where(
                beyond[crossed, k] < 0.0, change[:, k] / _DIFFERENCE, 0.0
            )
    return np.concatenate([position - points, outside, beyond], axis=-1), jacobian


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
