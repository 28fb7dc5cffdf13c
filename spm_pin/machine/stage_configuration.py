"""A state of a stage alone, its platform's pose, and sets of such states."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.formulas import circles
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.machine.batched import Batched, masked
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, frozen
from spm_pin.support.pose import PoseLike, as_rigid_transform

OPERATION_MODES = ("T", "F")
"""The two solutions of an inverse displacement: without torsion, and with half a turn of torsion."""
BELOW = "The height is negative: below the pivots"
"""A cause for a missing physical state."""
_HALF_TURN_BACK = -np.pi + 1e-9
"""Smallest torsion [rad] of those that are π up to rounding, with negative sign."""

_is_home_state = on_arrays(circles.is_home_state)


class StageConfiguration(Batched):
    """One state of a stage, or a batch of states; read-only.

    Parameters
    ----------
    stage : Stage
        The stage.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of the platform in {B}; in a nominal machine its origin is the centre of the balls.

    Notes
    -----
    Nothing is solved here: balls may be out of their legs' planes; see `closure_residual`.
    """

    _machine: Stage
    _solved = "readings"

    def __init__(self, stage: Stage, pose: PoseLike) -> None:
        matrix = as_rigid_transform(pose).as_matrix()
        self._set(check_instance(stage, Stage, "stage"), matrix[..., :3, :3].copy(), matrix[..., :3, 3].copy())

    def where(self, kept: BoolArray) -> StageConfiguration:
        """Return the states where `kept` (...) is true; the others are NaN throughout."""
        return self.transformed(lambda array, inner: masked(array, kept, inner))

    def _summary(self) -> str:
        tilt, azimuth = np.degrees([self.tilt, self.azimuth])
        readings = ", ".join(f"{x:.4f}" for x in self.readings)
        text = f"tilt {tilt:.2f}° towards {azimuth:.1f}°, height {self.height:.4f} m"
        return f"{text}, readings {readings} {self.stage.unit}"

    @property
    def stage(self) -> Stage:
        """The stage."""
        return self._machine

    @property
    def exists(self) -> BoolArray:
        """False for a member of the batch that does not exist, shape (...)."""
        return ~np.isnan(self._translation[..., 2])

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the platform in {B}, shape (..., 3)."""
        return self._rotation[..., 2]

    @property
    def tilt(self) -> FloatArray:
        """Angle between the platform's normal and z, from 0 to π [rad], shape (...)."""
        return np.asarray(np.arctan2(np.hypot(self.normal[..., 0], self.normal[..., 1]), self.normal[..., 2]))

    @property
    def azimuth(self) -> FloatArray:
        """Direction to which the normal leans, where the platform is lowest [rad], shape (...).

        It is measured from x towards y: the legs are at -30°, 90° and 210°.
        """
        return np.asarray(np.arctan2(self.normal[..., 1] + 0.0, self.normal[..., 0]))

    @property
    def roll(self) -> FloatArray:
        """Rotation about x, that of ``pose.rotation.as_euler("xyz")`` without torsion [rad], shape (...)."""
        return np.asarray(np.arctan2(-self.normal[..., 1], self.normal[..., 2]))

    @property
    def pitch(self) -> FloatArray:
        """Rotation about y before the roll about x: the normal is Rx(roll) Ry(pitch) z [rad], shape (...)."""
        return np.asarray(np.arctan2(self.normal[..., 0], np.hypot(self.normal[..., 1], self.normal[..., 2])))

    @property
    def height(self) -> FloatArray:
        """Height of the platform's origin above the plane of the pivots [m], shape (...)."""
        return self._translation[..., 2]

    @property
    def shift(self) -> FloatArray:
        """Lateral (parasitic) displacement of the platform's origin from the axis of the base, x and y [m], (..., 2).

        It follows from the tilt and cannot be commanded.
        """
        return self._translation[..., :2]

    @property
    def torsion(self) -> FloatArray:
        """Rotation of the platform about its normal, beyond the shortest rotation that tilts it [rad], shape (...).

        Zero in mode T of a nominal stage, π in mode F; a half turn is never -π, even by rounding.
        """
        r = self._rotation
        torsion = np.arctan2(r[..., 1, 0] - r[..., 0, 1], r[..., 0, 0] + r[..., 1, 1])
        return np.asarray(np.where(torsion < _HALF_TURN_BACK, torsion + 2.0 * np.pi, torsion))

    @cached_property
    def balls(self) -> FloatArray:
        """Centres of the balls as rows in {B} [m], shape (..., 3, 3)."""
        turned = self.stage.legs.balls @ np.swapaxes(self._rotation, -1, -2)
        return frozen(turned + self._translation[..., None, :])

    @property
    def middle_pose(self) -> RigidTransform:
        """Pose of the platform, as of a robot's middle platform."""
        return self.pose

    @property
    def tilt_cosine_sum(self) -> FloatArray:
        """Cosine of the tilt, shape (...)."""
        return self.normal[..., 2]

    @property
    def is_at_home(self) -> BoolArray:
        """True without torsion, and reached from the level platform without a forward singularity, shape (...)."""
        axes, centres, none = (rows_of(x) for x in (self.stage.legs.axes, self.circle_centres, np.zeros((3, 3))))
        stage: Any = circles.Circles(axes, centres, none[0], none[0])  # type: ignore[arg-type]
        at_home = _is_home_state(stage, rows_of(self.leg_vectors), rows_of(self.balls), self.stage.kind.up)
        return np.asarray(at_home, dtype=np.bool_)
