"""All assembly modes of one 3RPS stage: a quartic for each of its two modes, and Newton's method to rounding.

A stage is three legs of given lengths from hips at radius E, each in the vertical plane of its hip, to a triangle of
circumradius r. In units of r, with ε = E/r, the height ζ of the triangle's centre and its quaternion (x0, w),
w = x1 + i x2, the squared leg lengths of mode T have the mean m and the first harmonic λ,

    m = (x0² - ε)² + 2 |w|² + ζ²,      λ = (2ε - x0²) w² + conj(w)⁴ + 2 ζ x0 conj(w),

over the three azimuths. Mode F is the same with -r for r, x3 for x0 and i w for w. It follows that
Im(λ w) = κ Im(w³), κ = 2ε - 1: the tilt |w|² is a ratio of sines of the azimuth ψ of w. Put into the rest, all high
harmonics cancel and a trigonometric polynomial of degree two in 2ψ is left: at most four solutions per mode, each
with its mirror image below the hips. Derivation: `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.closed_form.stage_newton import (
    NEAR,
    SAME,
    BoolArray,
    IntArray,
    StageEquations,
    other_side_of_fold,
    polished,
)
from spm_pin.closed_form.stage_quartic import approximate_solutions
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["MODES", "PLACES", "StageModes", "placement", "solve_stage"]

MODES = ("T", "F")
PLACES = 4
"""The most solutions of one mode, mirror images apart."""

_EPS = float(np.finfo(np.float64).eps)
# Of the legs' azimuths -30°, 90°, 210°.
_COSINES = np.array([np.sqrt(0.75), 0.0, -np.sqrt(0.75)])
_SINES = np.array([-0.5, 1.0, -0.5])
_FAMILY = 1e6
"""A solution beside a continuous family that errs more than this many times as much as the lengths belongs to it."""


@dataclass(frozen=True)
class StageModes:
    """Assembly modes of N stages in units of r: four places for each mode, T before F.

    A place holds a solution above the hips; its mirror image below them is another one.

    Attributes
    ----------
    quaternion : ndarray, shape (N, modes, 4, 4)
        Rotation of the triangle, scalar last; NaN in a place without a real solution.
    centre : ndarray, shape (N, modes, 4, 3)
        Position of its centre.
    radii, heights : ndarray, shape (N, modes, 4, 3)
        Of its corners in the vertical planes of the legs.
    flat : ndarray of bool, shape (N, modes, 4)
        The solution lies in the plane of the hips, and is its own mirror image.
    continuous : ndarray of bool, shape (N, modes)
        There is a continuous family of solutions besides.
    """

    quaternion: FloatArray
    centre: FloatArray
    radii: FloatArray
    heights: FloatArray
    flat: BoolArray
    continuous: BoolArray

    @property
    def exists(self) -> BoolArray:
        """Which places hold a solution, shape (N, modes, 4)."""
        return ~np.isnan(self.quaternion[..., 0])

    def part(self, stages: slice) -> StageModes:
        """Return some of the N stages."""
        return StageModes(
            self.quaternion[stages],
            self.centre[stages],
            self.radii[stages],
            self.heights[stages],
            self.flat[stages],
            self.continuous[stages],
        )


def solve_stage(lengths: FloatArray, epsilon: float | FloatArray, modes: tuple[str, ...] = MODES) -> StageModes:
    """Find all assembly modes of 3RPS stages.

    Parameters
    ----------
    lengths : ndarray, shape (N, 3)
        Leg lengths in units of r, positive.
    epsilon : float or ndarray, shape (N,)
        Radius of the hips in units of r.
    modes : tuple of str
        Which of the modes T and F to solve.

    Returns
    -------
    StageModes
        Per mode by falling mean radius of the corners; where nine digits of it agree, by the azimuth of the tilt axis.
    """
    epsilon = np.broadcast_to(np.asarray(epsilon, dtype=np.float64), len(lengths))
    signed = np.stack([epsilon if mode == "T" else -epsilon for mode in modes], axis=-1)
    stage = StageEquations.of(np.repeat(lengths, len(modes), axis=0), signed.reshape(-1))
    continuous = _continuous(lengths, epsilon, modes)
    family = continuous.reshape(-1)
    starts, plausible = approximate_solutions(stage, family)
    owner, place = np.nonzero(plausible)
    owner, states, gain = polished(stage, owner, starts[owner, place])
    near = gain > NEAR
    others = polished(stage, owner[near], other_side_of_fold(stage, owner[near], states[near]))
    owner, states, gain = (np.concatenate(pair) for pair in zip((owner, states, gain), others, strict=True))
    isolated = ~family[owner] | (gain < _FAMILY)
    return _arranged(owner[isolated], states[isolated], gain[isolated], modes, continuous)


def _continuous(lengths: FloatArray, epsilon: FloatArray, modes: tuple[str, ...]) -> BoolArray:
    """Tell where solutions form a continuous family, shape (N, modes): the only lengths at which the quartic vanishes.

    - E < r, one leg 3 E long and the others √3 √(r² - E²): both modes.
    - E = r/2 and equal legs longer than r/2: mode T.
    """
    squares = lengths * lengths
    tolerance = 64.0 * _EPS * (squares.mean(axis=-1) + (1.0 + epsilon) ** 2)
    # The three lengths with one leg odd, as rows.
    odd = np.eye(3, dtype=bool)
    special = np.where(odd, 9.0 * (epsilon * epsilon)[:, None, None], 3.0 - 3.0 * (epsilon * epsilon)[:, None, None])
    distance = np.abs(squares[:, None, :] - special).max(axis=-1).min(axis=-1)
    both = (distance <= tolerance) & (epsilon < 1.0)
    equal = np.abs(squares - squares[:, :1]).max(axis=-1) <= tolerance
    halved = equal & (squares[:, 0] > 0.25 + tolerance) & (np.abs(2.0 * epsilon - 1.0) <= 64.0 * _EPS)
    return np.stack([both | halved if mode == "T" else both for mode in modes], axis=-1)


def _arranged(
    owner: IntArray, states: FloatArray, gain: FloatArray, modes: tuple[str, ...], continuous: BoolArray
) -> StageModes:
    """Drop what was found twice, and put the rest into four places per mode."""
    x0, y1, y2, zeta = states.T
    half_turned = np.array([mode == "F" for mode in modes])[owner % len(modes)]
    x1, x2 = np.where(half_turned, -y2, y1), np.where(half_turned, y1, y2)
    quaternion = np.stack([x1, x2, np.where(half_turned, x0, 0.0), np.where(half_turned, 0.0, x0)], axis=-1)
    centre, radii, heights = placement(quaternion, zeta)

    # Azimuths of the tilt axis modulo a half turn, none of a symmetric solution's at the jump.
    azimuth = np.mod(np.arctan2(y2, y1) + np.pi / 6.0, np.pi)
    order = np.lexsort((azimuth, -np.round(1e9 * radii.mean(axis=-1)), owner))
    order = order[~_again(owner, radii, heights, np.clip(16.0 * _EPS * gain, SAME, 0.01), order)]
    ranked = owner[order]
    counts = np.bincount(ranked, minlength=continuous.size)
    place = np.arange(len(order)) - (np.cumsum(counts) - counts)[ranked]
    fits = place < PLACES

    def placed(array: FloatArray) -> FloatArray:
        everywhere = np.full((continuous.size, PLACES, array.shape[-1]), np.nan)
        everywhere[ranked[fits], place[fits]] = array[order[fits]]
        return everywhere.reshape(-1, len(modes), PLACES, array.shape[-1])

    corners = placed(heights)
    return StageModes(
        quaternion=placed(quaternion),
        centre=placed(centre),
        radii=placed(radii),
        heights=corners,
        flat=np.abs(corners).max(axis=-1) <= SAME,
        continuous=continuous,
    )


def placement(quaternion: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place the triangle in its stage.

    Parameters
    ----------
    quaternion : ndarray, shape (..., 4)
        Its rotation, scalar last, in mode T or F.
    height : ndarray, shape (...)
        Of its centre, in units of r.

    Returns
    -------
    centre, radii, heights : ndarrays, shape (..., 3)
        Position of the centre, and of the corners in the vertical planes of the legs, in units of r.
    """
    x1, x2, x3, x0 = (quaternion[..., k, None] for k in range(4))
    square = 2.0 * x1 * x2 * _COSINES + (x1 * x1 - x2 * x2) * _SINES
    lift = x0 * (x1 * _SINES - x2 * _COSINES) + x3 * (x1 * _COSINES + x2 * _SINES)
    centre = np.concatenate([-2.0 * x1 * x2, x2 * x2 - x1 * x1, height[..., None]], axis=-1)
    return centre, x0 * x0 - x3 * x3 - 2.0 * square, height[..., None] + 2.0 * lift


def _again(owner: IntArray, radii: FloatArray, heights: FloatArray, blur: FloatArray, order: IntArray) -> BoolArray:
    """Tell which states, in this order, are one of those before them, or its mirror image."""
    again = np.zeros(len(order), dtype=bool)
    for ahead in range(1, int(np.bincount(owner).max(initial=0))):
        one, other = order[:-ahead], order[ahead:]
        across = ((radii[one] - radii[other]) ** 2).sum(axis=-1)
        same_side = ((heights[one] - heights[other]) ** 2).sum(axis=-1)
        mirrored = ((heights[one] + heights[other]) ** 2).sum(axis=-1)
        apart = np.sqrt(across + np.minimum(same_side, mirrored))
        again[ahead:] |= (owner[one] == owner[other]) & (apart <= np.maximum(blur[one], blur[other]))
    return again
