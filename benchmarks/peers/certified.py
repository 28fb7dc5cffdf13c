"""python-flint: the octic of `tests/oracle.py` in ball arithmetic, its real roots isolated and proved."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.lines import lines
from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin import Manipulator


def real_coordinates(quaternion: FloatArray, position: FloatArray, side: float) -> FloatArray | None:
    """Return the certified coordinates of b_2 along its line, ascending [m]; None where no precision separates them.

    The balls are far narrower than a double; their midpoints are returned.
    """
    required("flint", "python-flint")
    from oracle import certified_roots

    found = certified_roots(quaternion, position, side)
    return None if found is None else np.sort([float(root.mid()) for root in found])


def roots(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the certified coordinates of b_2, pose by pose; b_1 and b_3 are left NaN."""
    machine, poses = problem
    required("flint", "python-flint")
    separate = list(zip(poses.rotation.as_quat(), poses.translation, strict=True))
    points, directions = lines(machine, poses.as_matrix())

    def read(found: list[FloatArray | None]) -> list[FloatArray]:
        answers = []
        for point, direction, coordinates in zip(points, directions, found, strict=True):
            along = np.empty(0) if coordinates is None else coordinates
            joints = np.full((len(along), 3, 3), np.nan)
            joints[:, 1] = point[1] + along[:, None] * direction[1]
            answers.append(joints)
        return answers

    return Prepared(lambda: [real_coordinates(q, o, machine.middle_side) for q, o in separate], read)
