"""Lattices and samples of poses or of leg lengths, from ranges: the ways to say what a sweep runs over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS, pose
from spm_pin.mechanism.arguments import real_array
from spm_pin.sweeps.domains import ANGLES, POSITION, Axis, Grid, Method, Sample, Space

__all__ = ["leg_grid", "leg_sample", "pose_grid", "pose_sample"]

Range = float | Sequence[float]


def pose_grid(
    x: Range,
    y: Range,
    z: Range,
    *,
    xyx: Sequence[Range] | None = None,
    rotation: Rotation | npt.ArrayLike | None = None,
) -> Grid:
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
    return _grid("pose", _pose_ranges(x, y, z, xyx, rotation))


def leg_grid(lower: Range | Sequence[Range], upper: Range | Sequence[Range]) -> Grid:
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
    return _grid("legs", _leg_ranges(lower, upper))


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
) -> Sample:
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
        Seed of the drawing.

    Raises
    ------
    ArgumentError
        As for `pose_grid`, or if `count`, `method` or `seed` is none.
    """
    return _sample("pose", _pose_ranges(x, y, z, xyx, rotation), count, method, seed)


def leg_sample(
    count: int,
    lower: Range | Sequence[Range],
    upper: Range | Sequence[Range],
    *,
    method: Method = "sobol",
    seed: int = 0,
) -> Sample:
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
    return _sample("legs", _leg_ranges(lower, upper), count, method, seed)


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
    if xyx is None or isinstance(xyx, str) or len(xyx) != 3:
        raise ArgumentError("xyx", "three angles or ranges [rad]", xyx)
    return dict(zip((*POSITION, *ANGLES), (x, y, z, *xyx), strict=True))


def _leg_ranges(lower: Range | Sequence[Range], upper: Range | Sequence[Range]) -> dict[str, Range]:
    ranges: list[Range] = []
    for argument, given in (("lower", lower), ("upper", upper)):
        if isinstance(given, list):
            if len(given) != 3:
                raise ArgumentError(argument, "one length or range, or a list of three", f"a list of {len(given)}")
            ranges += given
        else:
            ranges += [given] * 3  # type: ignore[list-item]  # a tuple is one range, which its type does not say
    return dict(zip(LEGS, ranges, strict=True))


def _grid(space: Space, ranges: Mapping[str, Range]) -> Grid:
    axes = tuple(_axis(name, given, 3) for name, given in ranges.items())
    _refuse_a_single_point(axes)
    return Grid(space, axes)


def _sample(space: Space, ranges: Mapping[str, Range], count: int, method: Method, seed: int) -> Sample:
    axes = tuple(_axis(name, given, 2) for name, given in ranges.items())
    _refuse_a_single_point(axes)
    for argument, value, least in (("count", count, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise ArgumentError(argument, f"an integer from {least} on", value)
    if method not in ("sobol", "uniform"):
        raise ArgumentError("method", "'sobol' or 'uniform'", method)
    return Sample(space, axes, int(count), method, int(seed))


def _refuse_a_single_point(axes: tuple[Axis, ...]) -> None:
    if all(axis.fixed for axis in axes):
        raise ArgumentError("ranges", "at least one coordinate that varies", "six fixed ones")


def _axis(name: str, given: Range, numbers: int) -> Axis:
    unit = "radians" if name in ANGLES else "metres"
    parts = "(start, stop, count)" if numbers == 3 else "(start, stop)"
    expected = f"one value or {parts}, in {unit}"
    values = real_array(given, name, (), expected)
    if values.shape not in ((), (numbers,)):
        raise ArgumentError(name, expected, f"shape {values.shape}")
    ends = np.broadcast_to(values, (2,)) if values.ndim == 0 else values[:2]
    start, stop = float(ends[0]), float(ends[1])
    if name in ANGLES and np.abs(ends).max() > 2.0 * np.pi:
        raise ArgumentError(name, "angles within ±2π radians", given, "Degrees instead of radians?")
    if name in LEGS and start <= 0.0:
        raise ArgumentError(name, "positive lengths in metres", given)
    if values.ndim == 0:
        return Axis(name, start, stop, 1)
    if not start < stop:
        cause = "The ends exchanged?" if start > stop else "Give a fixed coordinate as one number."
        raise ArgumentError(name, "start < stop", f"{start:g} and {stop:g}", cause)
    if numbers == 2:
        return Axis(name, start, stop, 0)
    count = float(values[2])
    if count < 2 or count != int(count):
        cause = "Give a fixed coordinate as one number." if count == 1 else ""
        raise ArgumentError(name, "an integer count of at least 2", f"{count:g}", cause)
    return Axis(name, start, stop, int(count))
