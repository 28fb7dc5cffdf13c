"""The frames in which a platform is measured: {B} in a tracker's frame, and its target on the platform.

An IMU and a ruler are a tracker that sees less: its z is the vertical, and its target an IMU and a point of the plate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.calibration.error_model import error_jacobian
from spm_pin.machine.configuration import Configuration
from spm_pin.support.arguments import FloatArray
from spm_pin.support.pose import homogeneous

FRAME_PARAMETERS = tuple(f"{frame}.{part}{x}" for frame in ("base", "target") for part in ("", "turn_") for x in "xyz")
"""Names of the changes of both frames: of {B} in the tracker's axes, of the target in the platform's [m, rad]."""
_ROUNDS = 10
"""Times that the vertical and an IMU's mounting are estimated from each other."""


@dataclass(frozen=True)
class Frames:
    """Poses (4, 4) of {B} in the tracker's frame, and of the target in the platform's frame."""

    base: FloatArray
    target: FloatArray

    @classmethod
    def as_defined(cls) -> Frames:
        """Return the frames of measurements that are poses of {m} in {B} already."""
        return cls(np.eye(4), np.eye(4))

    @classmethod
    def estimated(cls, states: Configuration, measured: FloatArray) -> Frames:
        """Return the frames with which poses (N, 4, 4), seen by the tracker, are nearest to states (N,).

        The place of the target is searched for, with the base for each that fits all positions best. Where rotations
        were not measured, that of the target is of no use.
        """
        known = states.exists
        poses, seen = states[known].pose.as_matrix(), measured[known]
        places = seen[:, :3, 3]

        def base_of(target: FloatArray) -> tuple[Rotation, FloatArray]:
            """Return the rotation and the position of {B}."""
            points = poses[:, :3, :3] @ target + poses[:, :3, 3]
            turn, _ = Rotation.align_vectors(places - places.mean(axis=0), points - points.mean(axis=0))
            return turn, (places - turn.apply(points)).mean(axis=0)

        def errors(target: FloatArray) -> FloatArray:
            turn, position = base_of(target)
            points = poses[:, :3, :3] @ target + poses[:, :3, 3]
            return np.asarray((turn.apply(points) + position - places).ravel())

        size: float = states.machine.ball_side
        starts = np.concatenate([np.zeros((1, 3)), size * np.eye(3), -size * np.eye(3)])
        fits = [scipy.optimize.least_squares(errors, x) for x in starts]
        target = min(fits, key=lambda fit: float(fit.cost)).x
        turn, position = base_of(target)
        ahead = Rotation.from_matrix(poses[:, :3, :3]).inv() * turn.inv() * Rotation.from_matrix(seen[:, :3, :3])
        pairs = (position, turn), (target, ahead.mean())
        return cls(*(RigidTransform.from_components(*pair).as_matrix() for pair in pairs))

    @classmethod
    def levelled(cls, states: Configuration, measured: FloatArray) -> Frames:
        """Return the frames with which verticals and heights, of poses (N, 4, 4), are nearest to states (N,)."""
        seen, heights, turn = measured[:, :3, :3], measured[:, 2, 3], Rotation.identity()
        rotations, up, point = states.rotation, np.array([0.0, 0.0, 1.0]), np.zeros(3)
        level, tilted = 0.0, states.exists & np.isfinite(seen[:, 0, 0])
        if tilted.any():
            for _ in range(_ROUNDS):
                # The vertical in the IMU's frame is turnᵀ Rᵀ up.
                turn, _ = Rotation.align_vectors(rotations[tilted].mT @ up, seen[tilted, 2])
                up = (rotations[tilted] @ turn.apply(seen[tilted, 2])[..., None]).mean(axis=0)[:, 0]
                up /= np.linalg.norm(up)
        if (known := states.exists & np.isfinite(heights)).any():
            places = np.concatenate([up @ rotations[known], np.ones((known.sum(), 1))], axis=-1)
            *point, level = np.linalg.lstsq(places, heights[known] - states.translation[known] @ up)[0]
        base = homogeneous(Rotation.align_vectors([0.0, 0.0, 1.0], up)[0].as_matrix(), np.array([0.0, 0.0, level]))
        return cls(base, homogeneous(turn.as_matrix(), np.array(point)))

    def changed(self, by: FloatArray) -> Frames:
        """Return frames changed by `FRAME_PARAMETERS`."""
        shifts, turns = by.reshape(2, 2, 3).swapaxes(0, 1)
        moves = homogeneous(Rotation.from_rotvec(turns).as_matrix(), shifts)
        frames = np.stack([self.base, self.target])
        frames[:, :3, :3] = moves[:, :3, :3] @ frames[:, :3, :3]
        frames[:, :3, 3] += moves[:, :3, 3]
        return Frames(*frames)

    def seen(self, states: Configuration) -> FloatArray:
        """Return the poses (N, 4, 4) of the target in the tracker's frame, in states (N,)."""
        return np.asarray(self.base @ states.pose.as_matrix() @ self.target)

    def motions(self, states: Any, twists: FloatArray) -> FloatArray:
        """Return twists (N, 6, k) of the target in the tracker's frame for twists (v, ω) of the platform in {B}."""
        lever = states.rotation @ self.target[:3, 3]
        linear = twists[:, :3] + np.cross(twists[:, 3:], lever[..., None], axis=1)
        return np.concatenate([self.base[:3, :3] @ linear, self.base[:3, :3] @ twists[:, 3:]], axis=1)

    def jacobian(self, states: Any) -> FloatArray:
        """Return the measured twists per error of the machine's parameters and of the frames, (N, 6, n + 12)."""
        point = self.base[:3, :3] @ (states.rotation @ self.target[:3, 3] + states.translation)[..., None]
        turns = np.tile(np.eye(3), (len(states), 1, 1))
        frames = np.zeros((len(states), 6, 12))
        frames[:, :3, :3] = frames[:, 3:, 3:6] = turns
        frames[:, :3, 3:6] = np.cross(turns, point, axis=1)
        frames[:, :3, 6:9] = frames[:, 3:, 9:] = self.base[:3, :3] @ states.rotation
        return np.concatenate([self.motions(states, error_jacobian(states)), frames], axis=-1)
