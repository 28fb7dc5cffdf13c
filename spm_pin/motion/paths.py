"""Paths of the legs or of the platform, over a parameter from 0 to 1, and the states along them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BPoly

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_physical
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.multibody.trajectory import PlatformMotion, PlatformPath

ROUNDING = 1e-9
"""Amount by which a rule of a path may be broken, in its unit: a state at its limit keeps it."""
STEP = 0.005
"""Largest distance of two samples of a path in the leg lengths, in units of d."""


class LegMotion(NamedTuple):
    """Leg lengths r_b1 to r_c3 along a path, (..., 6) [m], and their derivatives per unit of its parameter."""

    lengths: FloatArray
    """Leg lengths [m]."""
    first: FloatArray
    """First derivatives [m]."""
    second: FloatArray
    """Second derivatives [m]."""


class LegPath:
    """A twice continuously differentiable path through given leg lengths, over a parameter from 0 to 1.

    A straight line between two; through more, quintic polynomials from each to the next, on which no leg leaves the
    range between its two lengths: limits that the points keep are kept all along. The parameter grows with the distance
    between them, √Σ(difference of a length)².

    Parameters
    ----------
    lengths : array_like, shape (n, 6)
        Where it passes [m], in order, at least two and no two in succession the same.
    """

    def __init__(self, lengths: npt.ArrayLike) -> None:
        points = real_array(lengths, "lengths", (6,), "leg lengths in metres, one row after another").copy()
        if points.ndim != 2 or len(points) < 2:
            raise ArgumentError("lengths", "shape (n, 6), at least two rows", f"shape {points.shape}")
        if (points <= 0.0).any():
            raise ArgumentError("lengths", "positive lengths in metres", f"{points.min():g} m")
        distances = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        if (distances == 0.0).any():
            row = int(distances.argmin())
            raise ArgumentError("lengths", "rows that differ", f"rows {row} and {row + 1} equal", "No motion there?")
        self._points = points
        self._knots = np.concatenate([[0.0], np.cumsum(distances) / distances.sum()])
        self._knots[-1] = 1.0
        slopes = _slopes(points, self._knots)
        self._path = BPoly.from_derivatives(self._knots, np.stack([points, slopes, np.zeros_like(points)], axis=1))
        self._derivatives = self._path.derivative(1), self._path.derivative(2)

    def __repr__(self) -> str:
        return f"<LegPath: {'a straight line' if len(self._points) == 2 else f'through {len(self._points)} points'}>"

    @property
    def points(self) -> FloatArray:
        """Leg lengths that it passes, shape (n, 6) [m]; a copy."""
        return self._points.copy()

    @property
    def knots(self) -> FloatArray:
        """Parameters of `points`, shape (n,), from 0 to 1; a copy."""
        return self._knots.copy()

    def __call__(self, parameters: npt.ArrayLike) -> LegMotion:
        """Return the lengths at parameters (...) from 0 to 1; raises `ArgumentError` outside."""
        values = real_array(parameters, "parameters", (), "from 0 to 1")
        if ((values < 0.0) | (values > 1.0)).any():
            raise ArgumentError("parameters", "numbers from 0 to 1", f"from {values.min():g} to {values.max():g}")
        # Not beyond its points by rounding.
        lengths = np.clip(self._path(values), self._points.min(axis=0), self._points.max(axis=0))
        return LegMotion(lengths, *(np.asarray(derivative(values)) for derivative in self._derivatives))


def _slopes(points: FloatArray, knots: FloatArray) -> FloatArray:
    """Return derivatives at the points, shape (n, 6), with which the path between two is monotonic.

    Zero where a leg turns back, else the harmonic mean of both sides, as PCHIP takes it. A quintic from y0 to y1 with
    the slopes d0, d1 and no curvature at its ends has the Bézier points y0 + (0, 1, 2) d0 h / 5 and
    y1 - (2, 1, 0) d1 h / 5: in order if d0 + d1 is at most 5/2 (y1 - y0) / h.
    """
    secants = np.diff(points, axis=0) / np.diff(knots)[:, None]
    before, after = secants[:-1], secants[1:]
    same = before * after > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(same, 2.0 * before * after / (before + after), 0.0)
    least = np.minimum(np.abs(before), np.abs(after))
    inner = np.sign(mean) * np.minimum(np.abs(mean), 1.25 * least)
    return np.concatenate([secants[:1], inner, secants[-1:]])


MotionPath = LegPath | PlatformPath
"""A path; its parameter goes from 0 to 1, of a `PlatformPath` the share of its duration."""


def states_along(geometry: Geometry, path: MotionPath, parameters: FloatArray) -> Configuration:
    """Return the states at parameters (n,) from 0 to 1; some may not exist."""
    if isinstance(path, LegPath):
        return forward_physical(geometry, path(parameters).lengths)
    return inverse_physical(geometry, platform_motion(path, parameters).pose)


def platform_motion(path: PlatformPath, parameters: FloatArray) -> PlatformMotion:
    """Return the pose at parameters (n,) from 0 to 1, and its derivatives by the path's own time."""
    # Not beyond the end by rounding.
    return path(np.minimum(path.start + parameters * path.duration, path.end))


def line_states(geometry: Geometry, start: FloatArray, end: FloatArray) -> Configuration:
    """Return the states on a straight line between leg lengths (6,), at most `STEP` apart."""
    parameters = spaced_parameters(geometry, np.array([start, end]))[:, None]
    return forward_physical(geometry, start + parameters * (end - start))


def spaced_parameters(geometry: Geometry, lengths: FloatArray) -> FloatArray:
    """Return evenly spaced parameters from 0 to 1 for a path through leg lengths (n, 6), at most `STEP` apart."""
    distance = float(np.linalg.norm(np.diff(lengths, axis=0), axis=-1).sum())
    return np.linspace(0.0, 1.0, max(int(np.ceil(distance / (STEP * geometry.middle_side))), 2) + 1)
