"""A path of the platform in time, through poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, RotationSpline

from spm_pin.errors import ArgumentError, PoseError
from spm_pin.mechanism.arguments import FloatArray, as_bool, real_array
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform, pose


class PlatformMotion(NamedTuple):
    """Motion of the terminal platform at one time or several."""

    pose: RigidTransform
    """Pose of {m} in {B}, shape (...)."""
    twist: FloatArray
    """(v, ω): velocity of o [m/s], angular velocity [rad/s], in {B}, shape (..., 6)."""
    acceleration: FloatArray
    """Time derivative of the twist [m/s², rad/s²], shape (..., 6)."""


class PlatformPath:
    """A twice continuously differentiable motion of the platform through given poses.

    Cubic splines: of o as in SciPy's `CubicSpline`, of the rotation as in its `RotationSpline`.

    Parameters
    ----------
    times : array_like, shape (n,)
        Times of the poses [s], increasing, at least two.
    poses : RigidTransform or array_like (n, 4, 4)
        Poses of the terminal platform at these times, {m} in {B}.
    ease : bool
        Start from rest and end at rest, without acceleration: the path is gone through on a clock that runs from the
        first to the last time as 10 x³ - 15 x⁴ + 6 x⁵. The poses between are then met at other times.

    Raises
    ------
    ArgumentError, PoseError
        If an argument is malformed.
    """

    def __init__(self, times: npt.ArrayLike, poses: PoseLike, *, ease: bool = False) -> None:
        knots = increasing_times(times, least=2)
        transforms = as_rigid_transform(poses, "poses")
        if transforms.shape != knots.shape:
            raise PoseError("poses", f"one for each of {knots.size} times", f"shape {transforms.shape}")
        self._times = knots
        self._ease = as_bool(ease, "ease")
        self._translation = CubicSpline(knots, transforms.translation)
        self._rotation = RotationSpline(knots, transforms.rotation)

    @property
    def times(self) -> FloatArray:
        """Times of the poses [s], shape (n,), as given, before easing; a copy."""
        return self._times.copy()

    @property
    def start(self) -> float:
        """First time [s]."""
        return float(self._times[0])

    @property
    def end(self) -> float:
        """Last time [s]."""
        return float(self._times[-1])

    @property
    def duration(self) -> float:
        """From the first to the last time [s]."""
        return self.end - self.start

    def __call__(self, times: npt.ArrayLike) -> PlatformMotion:
        """Return the motion at times [s] of shape (...), none outside the path's own.

        Raises
        ------
        ArgumentError
            If a time is not finite, or outside.
        """
        t = real_array(times, "times", (), "in seconds")
        begin, until = self.start, self.end
        outside = (t < begin) | (t > until)
        if outside.any():
            raise ArgumentError("times", f"times from {begin:g} to {until:g} s", f"{t[outside].flat[0]:g}")
        clock, rate, rate_change = t, np.ones_like(t), np.zeros_like(t)
        if self._ease:
            x = (t - begin) / self.duration
            # Rounding must not run past the end.
            clock = np.clip(begin + self.duration * x**3 * (10.0 - 15.0 * x + 6.0 * x**2), begin, until)
            rate = 30.0 * x**2 * (1.0 - x) ** 2
            rate_change = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / self.duration
        flat, shape = clock.reshape(-1), t.shape
        rotation = self._rotation(flat)
        # SciPy's angular rates are in {m}; in {B} their derivative is that in {m}, because ω × ω = 0.
        first, second = (
            np.concatenate([self._translation(flat, order), rotation.apply(self._rotation(flat, order))], axis=-1)
            for order in (1, 2)
        )
        speed, change = rate.reshape(-1, 1), rate_change.reshape(-1, 1)
        place, turn = self._translation(flat).reshape(*shape, 3), rotation.as_matrix().reshape(*shape, 3, 3)
        twist, acceleration = speed * first, speed**2 * second + change * first
        return PlatformMotion(pose(place, rotation=turn), twist.reshape(*shape, 6), acceleration.reshape(*shape, 6))


def increasing_times(times: npt.ArrayLike, *, least: int = 1) -> FloatArray:
    """Read times (n,) [s], or raise `ArgumentError`."""
    array = real_array(times, "times", (), "in seconds")
    if array.ndim != 1 or array.size < least:
        raise ArgumentError("times", f"times in seconds, shape (n,), at least {least}", f"shape {array.shape}")
    backward = np.diff(array) <= 0.0
    if backward.any():
        at = int(np.flatnonzero(backward)[0])
        raise ArgumentError("times", "increasing times", f"{array[at + 1]:g} after {array[at]:g}")
    return array
