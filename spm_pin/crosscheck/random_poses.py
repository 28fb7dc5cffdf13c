"""Random poses for comparisons: for a stage only their heights and normals are requested."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.kinematics.random_states import random_states
from spm_pin.machine import pose
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.support.arguments import FloatArray, generator, whole_number


def in_leg_space(machine: Machine, count: int, rng: np.random.Generator | int) -> RigidTransform:
    """Draw poses (count,) of physical states whose readings are uniform within the limits.

    Without limits, the distances of balls and pivots are between 1/1.33 and 1.33 times those in the home.
    """
    count, rng = _checked(machine, count, rng)
    poses: RigidTransform = random_states(machine, count, rng).pose
    return poses


def on_all_rotations(machine: Machine, count: int, rng: np.random.Generator | int) -> RigidTransform:
    """Draw poses (count,) with rotations uniform on SO(3) and positions near the axis; many have no branches."""
    count, rng = _checked(machine, count, rng)
    far = 1.5 * machine.stage_radii[0][1] * np.sqrt(rng.uniform(size=count))
    azimuth = rng.uniform(-np.pi, np.pi, count)
    height = rng.uniform(-3.0, 3.0, count) * machine.ball_side
    position = np.stack([far * np.cos(azimuth), far * np.sin(azimuth), height], axis=-1)
    return pose(position, rotation=Rotation.random(count, rng=rng))


def _checked(machine: Machine, count: int, rng: np.random.Generator | int) -> tuple[int, np.random.Generator]:
    check_machine(machine)
    return whole_number(count, "count", "a number of poses up to 10⁹", most=10**9), generator(rng)


def printable(machine: Machine, poses: RigidTransform) -> tuple[RigidTransform, dict[str, FloatArray]]:
    """Return poses (N,) that the command line reproduces to the last bit, and the numbers to type for them.

    For a manipulator they are the given poses up to rounding; for a stage they have the same heights and normals, with
    the origin on the axis of the base. The numbers (N, ...) are by their options, in [m] and degrees.
    """
    translation = np.asarray(poses.translation)
    if machine.is_stage:
        angles = np.asarray(poses.rotation.as_euler("XYZ", degrees=True))[:, :2]
        rotation, height = Rotation.from_euler("XY", angles, degrees=True), translation[:, 2]
        on_axis = pose(translation * [0.0, 0.0, 1.0], rotation=rotation)
        return on_axis, {"height": height, "roll": angles[:, 0], "pitch": angles[:, 1]}
    xyx = np.asarray(poses.rotation.as_euler("XYX", degrees=True))
    return pose(translation, xyx=np.deg2rad(xyx)), {"translation": translation, "xyx": xyx}
