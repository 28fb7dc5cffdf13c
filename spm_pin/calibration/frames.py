"""The frames in which a platform is measured: where a tracker sees {B}, and where its target is on {m}."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.calibration.error_model import error_jacobian
from spm_pin.machine import Configuration
from spm_pin.support.arguments import FloatArray
from spm_pin.support.pose import homogeneous

FRAME_PARAMETERS = tuple(f"{frame}.{part}{x}" for frame in ("base", "target") for part in ("", "turn_") for x in "xyz")
"""Names of the changes of both frames: of {B} in its own axes, of the target in those of {m} [m, rad]."""


@dataclass(frozen=True)
class Frames:
    """Poses (4, 4) of {B} seen from the tracker, and of the target in {m}; as given both are where they should be."""

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

        size = states.machine.middle_side
        starts = np.concatenate([np.zeros((1, 3)), size * np.eye(3), -size * np.eye(3)])
        fits = [scipy.optimize.least_squares(errors, x) for x in starts]
        target = min(fits, key=lambda fit: float(fit.cost)).x
        turn, position = base_of(target)
        ahead = Rotation.from_matrix(poses[:, :3, :3]).inv() * turn.inv() * Rotation.from_matrix(seen[:, :3, :3])
        pairs = (position, turn), (target, ahead.mean())
        return cls(*(RigidTransform.from_components(*pair).as_matrix() for pair in pairs))

    def changed(self, by: FloatArray) -> Frames:
        """Return frames changed by `FRAME_PARAMETERS`."""
        shifts, turns = by.reshape(2, 2, 3).swapaxes(0, 1)
        moves = homogeneous(Rotation.from_rotvec(turns).as_matrix(), shifts)
        target = self.target.copy()
        target[:3, :3] = moves[1, :3, :3] @ target[:3, :3]
        target[:3, 3] += moves[1, :3, 3]
        return Frames(self.base @ moves[0], target)

    def seen(self, states: Configuration) -> FloatArray:
        """Return what the tracker sees of the target in states (N,): poses (N, 4, 4)."""
        return np.asarray(self.base @ states.pose.as_matrix() @ self.target)

    def motions(self, states: Configuration, twists: FloatArray) -> FloatArray:
        """Return what the tracker sees of twists (v, ω) at o in {B}, (N, 6, k) each."""
        lever = states.rotation @ self.target[:3, 3]
        linear = twists[:, :3] + np.cross(twists[:, 3:], lever[..., None], axis=1)
        return np.concatenate([self.base[:3, :3] @ linear, self.base[:3, :3] @ twists[:, 3:]], axis=1)

    def jacobian(self, states: Configuration) -> FloatArray:
        """Return how what is seen moves per error of the machine's parameters and of the frames, (N, 6, n + 12)."""
        point = states.rotation @ self.target[:3, 3] + states.translation
        turns = np.tile(np.eye(3), (len(states), 1, 1))
        frames = np.zeros((len(states), 6, 12))
        frames[:, :3, :3] = frames[:, 3:, 3:6] = turns
        frames[:, :3, 3:6] = np.cross(turns, point[..., None], axis=1)
        frames[:, :3, 6:9] = frames[:, 3:, 9:] = states.rotation
        turned = np.concatenate([self.base[:3, :3] @ frames[:, :3], self.base[:3, :3] @ frames[:, 3:]], axis=1)
        return np.concatenate([self.motions(states, error_jacobian(states)), turned], axis=-1)
