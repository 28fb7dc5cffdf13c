"""The stage of vertical slides with two configurations of one aspect, of docs/theory/uniqueness.md.

Units are the middle platform's radius r; a tilt is w = √p e^{iψ}, the vector part of its quaternion in mode T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import label

from spm_pin.kinematics.intervals import Interval

Array = npt.NDArray[np.float64]

AZIMUTHS = np.radians([-30.0, 90.0, 210.0])
SLIDES = 0.25, 1.4, -0.67 + 0.18j
"""E and the rods, in units of r, and the tilt at which the certified ray ends."""


def slide_stage(epsilon: float, rod: float, w: Array) -> tuple[Array, Array]:
    """Return the carriages' heights (3, ...) with the platform's centre at height 0, and D; NaN out of reach."""
    p, turned = np.abs(w) ** 2, np.exp(1j * AZIMUTHS).reshape(3, *[1] * np.ndim(w))
    radii = 1.0 - p - 2.0 * np.imag(w**2 * turned)
    heights = 2.0 * np.sqrt(1.0 - p) * np.imag(np.conj(w) * turned)
    with np.errstate(invalid="ignore"):
        rise = np.sqrt(rod**2 - (radii - epsilon) ** 2)
    return heights - rise, _slide_determinant(radii, heights, rise, epsilon)


def _slide_determinant(radii, heights, rise, epsilon):  # type: ignore[no-untyped-def]
    """Return D of the rods, of arrays or intervals."""
    m = {
        (i, j): rise[i] * (radii[i] + 0.5 * radii[j]) - (radii[i] - epsilon) * (heights[i] - heights[j])
        for i in range(3)
        for j in range(3)
    }
    return m[0, 1] * m[1, 2] * m[2, 0] + m[1, 0] * m[2, 1] * m[0, 2]


def slides_of_two_states(epsilon: float, rod: float, cells: int = 161) -> bool:
    """Return whether, on a grid, the home's aspect holds a tilt off a leg's plane with two slides equal: observed."""
    x = np.linspace(-1.0, 1.0, cells)
    w = x[:, None] + 1j * x
    slides, determinant = slide_stage(epsilon, rod, np.where(np.abs(w) < 1.0, w, np.nan))
    number, _ = label(determinant > 0.0)
    centre = cells // 2
    if number[centre, centre] == 0:
        return False
    home = number == number[centre, centre]
    home[:, : centre + 2] = False  # tilts with x2 > 0; their mirror images have legs 1 and 3 exchanged
    unlike = slides[0] - slides[2]
    return bool((unlike[home] > 0.0).any())


@dataclass(frozen=True)
class SlidePair:
    """A ray of tilts from the level state, on which D > 0, and what is proved at both ends of a part of it."""

    boxes: int
    least: float
    """A lower bound of D / r⁶ along the ray."""
    near: Interval
    """The difference of slides 1 and 3 halfway along the ray."""
    far: Interval
    """The same at its end."""

    @property
    def proved(self) -> bool:
        """Whether D > 0, and slides 1 and 3 are equal between both."""
        return bool(self.least > 0.0 and self.near.high[0] < 0.0 < self.far.low[0])


def slide_pair(epsilon: float, rod: float, end: complex, boxes: int = 400) -> SlidePair:
    """Return what interval arithmetic proves along the ray of tilts from 0 to `end`."""
    ends = np.linspace(0.0, 1.0, boxes + 1)
    _, least, reach = _along(epsilon, rod, end, Interval(ends[:-1], ends[1:]))
    points, _, _ = _along(epsilon, rod, end, Interval.from_numbers(np.array([0.5, 1.0])))
    unlike = points[0] - points[2]
    bound = least.low.min() if (reach.low > 0.0).all() else -np.inf
    halves = [Interval(unlike.low[i : i + 1], unlike.high[i : i + 1]) for i in (0, 1)]
    return SlidePair(boxes, float(bound), *halves)


def _along(epsilon: float, rod: float, end: complex, t: Interval) -> tuple[list[Interval], Interval, Interval]:
    """Return the slides, D, and the least square of a rod's rise, over parts of the ray."""
    x, y = t * end.real, t * end.imag
    root_3 = Interval.from_numbers(3.0).root()
    a, b, product = x.square(), y.square(), 2.0 * root_3 * (x * y)
    radii = [1.0 - 2.0 * b - product, 1.0 - 3.0 * a + b, 1.0 - 2.0 * b + product]
    lever = (1.0 - (a + b)).root()
    heights = [-1.0 * lever * (x + root_3 * y), 2.0 * lever * x, -1.0 * lever * (x - root_3 * y)]
    squares = [rod * Interval.from_numbers(rod) - (radius - epsilon).square() for radius in radii]
    rise = [square.root() for square in squares]
    slides = [height - part for height, part in zip(heights, rise, strict=True)]
    reach = Interval(
        np.minimum.reduce([square.low for square in squares]), np.maximum.reduce([s.high for s in squares])
    )
    return slides, _slide_determinant(radii, heights, rise, Interval.from_numbers(epsilon)), reach
