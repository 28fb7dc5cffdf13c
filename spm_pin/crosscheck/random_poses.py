"""Random poses for comparisons."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.kinematics.random_states import random_states
from spm_pin.machine import Configuration, Manipulator, pose
from spm_pin.machine.manipulator import check_manipulator
from spm_pin.support.arguments import FloatArray, generator, whole_number


def in_leg_space(machine: Manipulator, count: int, rng: np.random.Generator | int) -> RigidTransform:
    """Draw poses (count,) of physical states whose leg lengths are uniform within the limits.

    Without limits the lengths are those of the home, a third more or less.
    """
    count, rng = _checked(machine, count, rng)
    states: Configuration = random_states(machine, count, rng)
    return states.pose


def on_all_rotations(machine: Manipulator, count: int, rng: np.random.Generator | int) -> RigidTransform:
    """Draw poses (count,) with rotations uniform on SO(3), near enough to the axis that about half have branches."""
    count, rng = _checked(machine, count, rng)
    far = 1.5 * machine.middle_radius * np.sqrt(rng.uniform(size=count))
    azimuth = rng.uniform(-np.pi, np.pi, count)
    height = rng.uniform(-3.0, 3.0, count) * machine.middle_side
    position = np.stack([far * np.cos(azimuth), far * np.sin(azimuth), height], axis=-1)
    return pose(position, rotation=Rotation.random(count, rng=rng))


def _checked(machine: Manipulator, count: int, rng: np.random.Generator | int) -> tuple[int, np.random.Generator]:
    check_manipulator(machine)
    return whole_number(count, "count", "a number of poses up to 10⁹", most=10**9), generator(rng)


def printable(poses: RigidTransform) -> tuple[RigidTransform, FloatArray, FloatArray]:
    """Return poses (N,) that the command line reproduces to the last bit, equal to those given up to rounding.

    And the numbers to type: translations (N, 3) [m], and X-Y-X Euler angles (N, 3) in degrees.
    """
    translation = np.asarray(poses.translation)
    xyx = np.asarray(poses.rotation.as_euler("XYX", degrees=True))
    return pose(translation, xyx=np.deg2rad(xyx)), translation, xyx
