"""Measured quantities of a platform: its pose, its position, or the tilt and height from an IMU and a ruler."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.calibration.error_model import pose_errors
from spm_pin.errors import ArgumentError
from spm_pin.support.arguments import BoolArray, FloatArray, first_offender, frozen, real_array
from spm_pin.support.pose import homogeneous

_PLACE, _TURN = ("x", "y", "z"), ("turn_x", "turn_y", "turn_z")


@dataclass(frozen=True)
class Observable:
    """Components of the errors of measured poses, and how they depend on predicted poses."""

    components: tuple[str, ...]
    is_levelled: bool = False
    """Whether only z, and the vertical in the platform's frame, are measured."""

    @property
    def lengths(self) -> int:
        """Number of the components that are lengths; they come first."""
        return sum(name in _PLACE for name in self.components)

    @property
    def frames(self) -> BoolArray:
        """Mask of the observable `frames.FRAME_PARAMETERS`, (12,)."""
        has_turns = self.lengths < len(self.components)
        base = [not self.is_levelled or name in ("turn_x", "turn_y", *self.components) for name in (*_PLACE, *_TURN)]
        return np.array([*base, *3 * [self.lengths > 0], *3 * [has_turns]])

    def errors(self, predicted: FloatArray, measured: FloatArray) -> FloatArray:
        """Return predicted less measured poses (N, 4, 4) as displacements [m] and turns [rad], (N, n)."""
        if not self.is_levelled:
            return pose_errors(predicted, measured)[:, : len(self.components)]
        up = (measured[:, :3, :3] @ predicted[:, :3, :3].mT)[..., 2]
        return self._seen([predicted[:, 2, 3] - measured[:, 2, 3], up[:, 1], -up[:, 0]])

    def slopes(self, predicted: FloatArray, measured: FloatArray, twists: FloatArray) -> FloatArray:
        """Return the derivatives of `errors` (N, n, k) by motions of predicted poses with twists (v, ω) (N, 6, k)."""
        if not self.is_levelled:
            return twists[:, : len(self.components)]
        back = measured[:, :3, :3] @ predicted[:, :3, :3].mT
        up = back[..., 1:2] * twists[:, 3:4] - back[..., :1] * twists[:, 4:5]
        return self._seen([twists[:, 2], up[:, 1], -up[:, 0]])

    def _seen(self, values: list[FloatArray]) -> FloatArray:
        return np.stack([values[INCLINATIONS.components.index(name)] for name in self.components], axis=1)

    def sizes(self, errors: FloatArray, side: float) -> FloatArray:
        """Return a length for each of errors (N, n): of the position, or of the height and the tilt of a `side` [m]."""
        weights = np.where(np.arange(errors.shape[1]) < self.lengths, 1.0, side * self.is_levelled)
        return np.asarray(np.linalg.norm(errors * weights, axis=-1))

    def other_axes(self, measured: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield measured poses (N, 4, 4) with axes exchanged or negated, the given ones first, and what they are."""
        names = ("roll", "pitch") if self.is_levelled else _PLACE
        values = roll_and_pitch(measured) if self.is_levelled else measured[:, :3, 3]
        signs = list(itertools.product((1, -1), repeat=len(names)))
        for order, sign in itertools.product(itertools.permutations(range(len(names))), signs):
            other, changed = measured.copy(), values[:, order] * sign
            if self.is_levelled:
                other[:, :3, :3] = _rotations(changed)
            else:
                other[:, :3, 3] = changed
            yield ", ".join(f"{'-' * (x < 0)}{names[k]}" for k, x in zip(order, sign, strict=True)), other


POSES, POSITIONS = Observable((*_PLACE, *_TURN)), Observable(_PLACE)
INCLINATIONS = Observable(("z", "turn_x", "turn_y"), is_levelled=True)
OBSERVABLES = {"poses": POSES, "positions": POSITIONS, "inclinations": INCLINATIONS}
"""Kinds of measurements, by the names of `choose_poses`."""


@dataclass(frozen=True, eq=False)
class Inclinations:
    """Roll and pitch that an IMU on the platform shows, and heights that a ruler shows, of N states.

    Parameters
    ----------
    roll, pitch : array_like, shape (N,), optional
        Roll and pitch of the IMU [rad], as in ROS: in its frame the vertical is (-sin pitch, cos pitch sin roll, cos
        pitch cos roll). Those of `Configuration.roll` and `.pitch` but for the torsion.
    height : array_like, shape (N,), optional
        Height of the platform's origin, or of another mark on it, along the vertical [m].

    Either may be NaN where it was not measured.
    """

    roll: Any = None
    pitch: Any = None
    height: Any = None

    def __post_init__(self) -> None:
        given = {name: x for name in ("roll", "pitch", "height") if (x := getattr(self, name)) is not None}
        if not given:
            raise ArgumentError("roll", "roll and pitch in radians, heights in metres, or both", None)
        for name, other in (("roll", "pitch"), ("pitch", "roll")):
            if name in given and other not in given:
                raise ArgumentError(other, f"{other} in radians beside {name}", None)
        arrays = {name: _column(x, name) for name, x in given.items()}
        first, count = next((name, len(array)) for name, array in arrays.items())
        for name in ("roll", "pitch", "height"):
            array = arrays.get(name, np.full(count, np.nan))
            if len(array) != count:
                raise ArgumentError(name, f"as many numbers as of {first}, {count}", f"{len(array)}")
            object.__setattr__(self, name, frozen(array))
        if (apart := np.isnan(self.roll) ^ np.isnan(self.pitch)).any():
            raise ArgumentError("pitch", "roll and pitch, or NaN for both", f"only one of them in row {apart.argmax()}")
        if (empty := np.isnan(self.roll) & np.isnan(self.height)).any():
            raise ArgumentError(
                "height", "roll and pitch, or a height, in every row", f"neither in row {empty.argmax()}"
            )


def poses_and_observable(shown: Inclinations) -> tuple[FloatArray, Observable]:
    """Return poses (N, 4, 4) of these rolls, pitches and heights, without yaw, and the components measured at all."""
    place = shown.height[:, None] * [0.0, 0.0, 1.0]
    matrices = homogeneous(_rotations(np.stack([shown.roll, shown.pitch], axis=-1)), place)
    has_height, has_tilt = (bool(np.isfinite(x).any()) for x in (shown.height, shown.roll))
    given = has_height, has_tilt, has_tilt
    return matrices, Observable(tuple(itertools.compress(INCLINATIONS.components, given)), is_levelled=True)


def _column(value: npt.ArrayLike, name: str) -> FloatArray:
    meaning = "heights in metres" if name == "height" else "angles in radians"
    array = real_array(value, name, (), meaning, allow_nan=True)
    if array.ndim != 1:
        raise ArgumentError(name, f"{meaning} of N states, shape (N,)", f"shape {array.shape}")
    most = {"roll": math.pi, "pitch": math.pi / 2.0}.get(name, math.inf)
    beyond = np.asarray(np.abs(array) > most)
    if beyond.any():
        received = f"{array[first_offender(beyond)]:g}"
        raise ArgumentError(name, f"{meaning}, within ±{most:.4g}", received, "Given in degrees?")
    return array


def _rotations(angles: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) of roll and pitch (N, 2) without yaw; NaN where roll or pitch is NaN."""
    matrices = Rotation.from_euler("xy", np.nan_to_num(angles)).as_matrix()
    missing = np.asarray(np.isnan(angles).any(axis=-1))
    return np.where(missing[:, None, None], np.nan, matrices)


def roll_and_pitch(poses: FloatArray) -> FloatArray:
    """Return the roll and pitch (N, 2) of poses (N, 4, 4), as an IMU on the platform shows them."""
    up = poses[:, 2, :3]
    return np.stack([np.arctan2(up[:, 1], up[:, 2]), np.arctan2(-up[:, 0], np.hypot(up[:, 1], up[:, 2]))], axis=-1)
