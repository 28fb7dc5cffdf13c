"""Branches found in any order, put in the places of their labels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES, FAMILIES, branch_sign, family
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solution_status import Status

__all__ = ["in_canonical_order"]


def in_canonical_order(
    geometry: Geometry, pose: RigidTransform, joints: FloatArray, solved: npt.NDArray[np.bool_]
) -> tuple[Configuration, npt.NDArray[np.int8]]:
    """Return branches (..., 8) in the order of `BRANCHES` and the status (...), see `SolutionSet.from_unordered`."""
    matrix = pose.as_matrix()[..., None, :, :]
    found = Configuration(geometry, matrix, joints)
    families, signs = family(found), branch_sign(found)
    ordered = np.full((*found.shape[:-1], len(BRANCHES), 3, 3), np.nan)
    counts = np.stack([(families == index).sum(axis=-1) for index in range(len(FAMILIES))], axis=-1)
    good = solved & (counts <= 2).all(axis=-1)
    for index in range(len(FAMILIES)):
        member = families == index
        count = np.where(good, counts[..., index], 0)
        top = np.where(member, signs, -np.inf).argmax(axis=-1)[..., None]
        bottom = np.where(member, signs, np.inf).argmin(axis=-1)[..., None]
        # Two members are distinguished by their order, which is right also where rounding hides a sign.
        plus = (count == 2) | ((count == 1) & (np.take_along_axis(signs, top, -1)[..., 0] >= 0.0))
        minus = (count == 2) | ((count == 1) & ~plus)
        for place, chosen, present in ((2 * index, top, plus), (2 * index + 1, bottom, minus)):
            joint = np.take_along_axis(found.middle_joints, chosen[..., None, None], -3)[..., 0, :, :]
            ordered[..., place, :, :] = np.where(present[..., None, None], joint, np.nan)
    branches = Configuration(geometry, matrix, ordered)
    reached = np.where(branches.exists.any(axis=-1), Status.OK, Status.UNREACHABLE)
    return branches, np.where(good, reached, Status.UNSOLVED)
