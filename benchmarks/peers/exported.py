"""The exported C of `spm_pin.symbolic`, called pose by pose from a loop in C."""

from __future__ import annotations

import ctypes
import functools

from scipy.spatial.transform import RigidTransform

from benchmarks.peers.c_loop import Arrays, real_branches
from benchmarks.peers.compiled import address, folder, shared_object
from benchmarks.peers.peer import Prepared
from spm_pin import Geometry
from spm_pin.symbolic import write_c

__all__ = ["answered"]

_LOOP = """
#include "spm_kinematics.c"
void inverse_of_all(long count, const double *poses, double *joints, double *lengths, signed char *status)
{
    long n;
    int i, j;
    for (n = 0; n < count; ++n) {
        const double *pose = poses + 16 * n;
        const double rotation[9] = {pose[0], pose[1], pose[2], pose[4], pose[5], pose[6], pose[8], pose[9], pose[10]};
        const double position[3] = {pose[3], pose[7], pose[11]};
        spm_branches found;
        status[n] = (signed char)spm_inverse(&spm_machine, rotation, position, &found);
        for (i = 0; i < 8; ++i) {
            for (j = 0; j < 9; ++j) joints[72 * n + 9 * i + j] = found.joints[i][j];
            for (j = 0; j < 6; ++j) lengths[48 * n + 6 * i + j] = found.lengths[i][j];
        }
    }
}
"""


@functools.cache
def _library(geometry: Geometry) -> ctypes.CDLL:
    place = folder() / "exported"
    write_c(geometry, place)
    (place / "loop.c").write_text(_LOOP, encoding="utf-8")
    return ctypes.CDLL(str(shared_object(place / "loop.c", ("-std=c99", "-O2"))))


def answered(problem: tuple[Geometry, RigidTransform]) -> Prepared:
    """Into arrays that are there, with all checks of a controller."""
    geometry, poses = problem
    loaded, arrays = _library(geometry), Arrays.of(poses)
    results = [address(x) for x in (arrays.poses, arrays.joints, arrays.lengths, arrays.status)]

    def call() -> Arrays:
        loaded.inverse_of_all(ctypes.c_long(len(arrays.poses)), *results)
        return arrays

    return Prepared(call, lambda found: real_branches(found.joints))
