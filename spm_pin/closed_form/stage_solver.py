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
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.batches import run_kernel
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["MODES", "PLACES", "StageModes", "placement", "solve_stage"]

BoolArray = npt.NDArray[np.bool_]

MODES = ("T", "F")
"""The two families of solutions of a stage."""
PLACES = 4
"""The most solutions of one mode, mirror images apart."""
_MIN_BATCH_PER_THREAD = 1 << 9


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
    from spm_pin.closed_form.kernels.stage_modes import stage_modes

    m, places = len(modes), (len(modes), PLACES)
    results = ((*places, 4), np.float64), (places, np.float64), (places, np.bool_), ((m,), np.bool_)
    hips = np.broadcast_to(np.asarray(epsilon, dtype=np.float64), len(lengths))
    half_turned = np.array([mode == "F" for mode in modes])

    def solve(lengths: FloatArray, hips: FloatArray, *written: npt.NDArray[Any]) -> None:
        stage_modes(lengths, hips, half_turned, *written)

    quaternion, height, flat, continuous = run_kernel(solve, (lengths, hips), (), results, _MIN_BATCH_PER_THREAD)
    return StageModes(quaternion, *placement(quaternion, height), flat, continuous)


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
    from spm_pin.closed_form.kernels.compilation import interpreted
    from spm_pin.closed_form.kernels.stage_equations import placed

    x1, x2, x3, x0 = np.moveaxis(quaternion, -1, 0)
    radii, heights = interpreted(placed)(x0, x1, x2, x3, height)
    centre = np.stack([-2.0 * x1 * x2, x2 * x2 - x1 * x1, height], axis=-1)
    return centre, np.stack(radii, axis=-1), np.stack(heights, axis=-1)
