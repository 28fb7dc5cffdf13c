"""Lattices and random samples of poses, or of leg lengths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import pose
from spm_pin.sweeps.domain import AXES, Domain, Method, Range, Sample

__all__ = ["leg_grid", "leg_sample", "pose_grid", "pose_sample"]


def pose_grid(
    x: Range,
    y: Range,
    z: Range,
    *,
    xyx: Sequence[Range] | None = None,
    rotation: Rotation | npt.ArrayLike | None = None,
) -> Domain:
    """Describe a lattice of poses.

    Parameters
    ----------
    x, y, z : float or (start, stop, count)
        Position of o in {B} [m]: one value, or equally spaced ones with both ends among them.
    xyx : three of float or (start, stop, count), optional
        The paper's Euler angles α, β, λ [rad], likewise.
    rotation : Rotation or array_like, shape (3, 3), optional
        One orientation instead of `xyx`; it is kept as its X-Y-X angles.

    Raises
    ------
    ArgumentError
        If a range is reversed, empty, not finite, or of fewer than two points, if nothing varies, or if both or neither
        of `xyx` and `rotation` are given.

    Examples
    --------
    >>> grid = pose_grid((-0.5, 0.5, 101), (-0.5, 0.5, 101), 2.4, xyx=[0.3, 0.5, -0.3])
    >>> grid.dims, grid.size
    (('x', 'y'), 10201)
    """
    return Domain.of_ranges("pose", _pose_ranges(x, y, z, xyx, rotation))


def leg_grid(lower: Range | Sequence[Range], upper: Range | Sequence[Range]) -> Domain:
    """Describe a lattice of leg lengths.

    Parameters
    ----------
    lower, upper : float, (start, stop, count), or three of these
        Lengths of the lower legs r_b1, r_b2, r_b3 and of the upper legs r_c1, r_c2, r_c3 [m]: the same for the three,
        or one after another in a list. A tuple of three numbers is a range.

    Raises
    ------
    ArgumentError
        As for `pose_grid`, and if a length is not positive.
    """
    return Domain.of_ranges("legs", _leg_ranges(lower, upper))


def pose_sample(
    count: int,
    x: Range,
    y: Range,
    z: Range,
    *,
    xyx: Sequence[Range] | None = None,
    rotation: Rotation | npt.ArrayLike | None = None,
    method: Method = "sobol",
    seed: int = 0,
) -> Domain:
    """Describe poses drawn from a box of positions and X-Y-X angles.

    Parameters
    ----------
    count : int
        Number of poses.
    x, y, z, xyx, rotation
        As for `pose_grid`, with ranges (start, stop). The distribution is uniform in these coordinates; one that is
        uniform over rotations has the weight ``|sin β|``.
    method : {"sobol", "uniform"}
        Scrambled Sobol sequences, one per chunk, or independent numbers; see `Sample`.
    seed : int
        Seed of the random generator.

    Raises
    ------
    ArgumentError
        As for `pose_grid`, or if `count`, `method` or `seed` is not as above.
    """
    return Domain.of_ranges("pose", _pose_ranges(x, y, z, xyx, rotation), Sample(count, method, seed))


def leg_sample(
    count: int,
    lower: Range | Sequence[Range],
    upper: Range | Sequence[Range],
    *,
    method: Method = "sobol",
    seed: int = 0,
) -> Domain:
    """Describe leg lengths drawn from a box.

    Parameters
    ----------
    count : int
        Number of sets of six lengths.
    lower, upper : float, (start, stop), or three of these
        As for `leg_grid`.
    method, seed
        As for `pose_sample`.

    Raises
    ------
    ArgumentError
        As for `pose_sample`, and if a length is not positive.
    """
    return Domain.of_ranges("legs", _leg_ranges(lower, upper), Sample(count, method, seed))


def _pose_ranges(
    x: Range, y: Range, z: Range, xyx: Sequence[Range] | None, rotation: Rotation | npt.ArrayLike | None
) -> dict[str, Range]:
    if (xyx is None) == (rotation is None):
        raise ArgumentError("rotation", "either xyx=... or rotation=...", "neither" if xyx is None else "both")
    if rotation is not None:
        # Reads a matrix or a Rotation, with the checks that a pose has.
        orientation = pose(np.zeros(3), rotation=rotation).rotation
        if orientation.shape != ():
            raise ArgumentError("rotation", "one orientation", f"shape {orientation.shape}")
        xyx = [float(angle) for angle in orientation.as_euler("XYX", suppress_warnings=True)]
    if not isinstance(xyx, Sequence | np.ndarray) or isinstance(xyx, str) or len(xyx) != 3:
        raise ArgumentError("xyx", "three angles or ranges [rad]", repr(xyx))
    return dict(zip(AXES["pose"], (x, y, z, *xyx), strict=True))


def _leg_ranges(lower: Range | Sequence[Range], upper: Range | Sequence[Range]) -> dict[str, Range]:
    ranges: list[Any] = []
    for argument, lengths in (("lower", lower), ("upper", upper)):
        if isinstance(lengths, list) and len(lengths) != 3:
            raise ArgumentError(argument, "one length or range, or a list of three", f"a list of {len(lengths)}")
        ranges += lengths if isinstance(lengths, list) else [lengths] * 3
    return dict(zip(AXES["legs"], ranges, strict=True))
