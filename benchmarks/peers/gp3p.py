"""PoseLib's generalised three-point problem: a triangle with its corners on three lines.

The middle platform is the triangle, the lines are those of `lines.py`: the same algebra, for all real solutions.
It is called pose by pose, as its binding takes no batches.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.lines import lines
from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin import Manipulator


def bare(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the call alone: lines computed beforehand, results left as poses of the triangle."""
    machine, poses = problem
    gp3p = required("poselib", "poselib").gp3p
    triangle = _triangle(machine)
    points, directions = lines(machine, poses.as_matrix())
    lines_of_poses = list(zip(points, directions, strict=True))

    def read(found: list[Any]) -> list[FloatArray]:
        return [_joints(solutions, triangle) for solutions in found]

    return Prepared(lambda: [gp3p(point, direction, triangle) for point, direction in lines_of_poses], read)


def complete(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the way from poses to ball joints and leg lengths, pose by pose in Python."""
    machine, poses = problem
    gp3p = required("poselib", "poselib").gp3p
    triangle, matrices = _triangle(machine), poses.as_matrix()

    def solve(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        point, direction = lines(machine, matrix)
        joints = _joints(gp3p(point, direction, triangle), triangle)
        platform = machine.platform_joints @ matrix[:3, :3].T + matrix[:3, 3]
        legs = np.concatenate([joints - machine.base_joints, platform - joints], axis=-2)
        return joints, np.sqrt((legs * legs).sum(axis=-1))

    return Prepared(lambda: [solve(matrix) for matrix in matrices], lambda found: [joints for joints, _ in found])


def _triangle(machine: Manipulator) -> FloatArray:
    return machine.legs.balls[:3]
    return machine.middle_radius * machine.radial_directions


def _joints(solutions: list[Any], triangle: FloatArray) -> FloatArray:
    return np.array([triangle @ pose.R.T + pose.t for pose in solutions]).reshape(-1, 3, 3)
