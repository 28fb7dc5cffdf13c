"""python-flint: the octic of `tests/oracle.py` in ball arithmetic, its roots isolated and proved real or not."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.lines import lines
from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin import Geometry

__all__ = ["real_coordinates", "roots"]


def real_coordinates(quaternion: FloatArray, position: FloatArray, side: float) -> FloatArray | None:
    """Return the certified coordinates of b_2 along its line, ascending [m]; None where no precision separates them.

    The balls are far narrower than a double; their midpoints are returned.
    """
    flint = required("flint", "python-flint")
    from oracle import octic

    for precision in (128, 256, 512, 1024, 2048):
        flint.ctx.prec = precision
        polynomial = octic(quaternion, position, side)
        leading = polynomial[8]
        if leading.contains(0):
            continue
        mean = -polynomial[7] / (8 * leading)
        try:
            # Moved to the roots' mean, where the iteration converges.
            moved = flint.acb_poly(polynomial(flint.arb_poly([mean, 1])))
            isolated = moved.roots(tol=flint.arb(2) ** (-precision // 2), maxprec=64 * precision)
        except ValueError:
            continue
        real = [root for root in isolated if root.imag.contains(0)]
        if any(root.conjugate().overlaps(other) for root in real for other in isolated if other is not root):
            continue
        return np.sort([float((root.real + mean).mid()) for root in real])
    return None


def roots(problem: tuple[Geometry, RigidTransform]) -> Prepared:
    """Certified coordinates of b_2, pose by pose; b_1 and b_3 are left NaN."""
    geometry, poses = problem
    required("flint", "python-flint")
    asked = list(zip(poses.rotation.as_quat(), poses.translation, strict=True))
    points, directions = lines(geometry, poses.as_matrix())

    def read(found: list[FloatArray | None]) -> list[FloatArray]:
        answers = []
        for point, direction, own in zip(points, directions, found, strict=True):
            along = np.empty(0) if own is None else own
            joints = np.full((len(along), 3, 3), np.nan)
            joints[:, 1] = point[1] + along[:, None] * direction[1]
            answers.append(joints)
        return answers

    return Prepared(lambda: [real_coordinates(q, o, geometry.middle_side) for q, o in asked], read)
