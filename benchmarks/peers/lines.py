"""The lines on which the ball joints must be, where the planes of their two legs meet."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.peer import FloatArray
from spm_pin import Manipulator


def lines(machine: Manipulator, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points and unit directions, (..., 3, 3) each, a row per corner, for poses (..., 4, 4); NaN if vertical.

    The two balls at a corner of a machine as built have to coincide.
    """
    rotation, position = matrix[..., :3, :3], matrix[..., :3, 3]
    legs = machine.legs
    (lower, above), heights = legs.axes.reshape(2, 3, 3), (legs.axes * legs.pivots).sum(axis=-1, keepdims=True)
    upper = above @ np.swapaxes(rotation, -1, -2)
    along = np.cross(lower, upper)
    squared = (along * along).sum(axis=-1, keepdims=True)
    # Heights of the planes above O; of the line, the point nearest to O.
    height = heights[3:] + upper @ position[..., None]
    point = height / squared * np.cross(along, lower) + heights[:3] / squared * np.cross(upper, along)
    return point, along / np.sqrt(squared)


def coordinates(machine: Manipulator, poses: RigidTransform, branches: list[FloatArray]) -> list[FloatArray]:
    """Return where on its line b_2 is, in the branches (k, 3, 3) of each pose, (k,) in ascending order [m].

    All branches of a pose differ in it, so it tells them apart, and it is what is certified.
    """
    point, direction = (part[:, 1] for part in lines(machine, poses.as_matrix()))
    return [
        np.sort((found[:, 1] - point[k]) @ direction[k]) if len(found) else np.empty(0)
        for k, found in enumerate(branches)
    ]
