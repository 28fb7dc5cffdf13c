"""Inverse displacement of a machine as built: three quadrics, all eight roots, the labels of the nominal machine.

Derivation, and what becomes of the nominal machine's branches: `docs/theory/as_built.md`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.batches import BRANCH_RESULTS, branch_states, radii, read_pose, run_kernel, with_batch_shape
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES, tangent_signs
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import PoseLike, homogeneous
from spm_pin.mechanism.solution_status import Status
from spm_pin.mechanism.solutions import SolutionSet

_MIN_BATCH_PER_THREAD = 1 << 9
_LARGE = 5e-3
"""Errors, of directions and in units of the middle platform's radius, that may make other branches physical."""


def as_built_inverse(geometry: Geometry, pose: PoseLike) -> SolutionSet:
    """Find all configurations of a machine as built that hold the platform in a pose; see `inverse_displacement`.

    `.met` is true under a label whose branch of the nominal machine ended on the straight way from the nominal axes,
    pivots and balls to those of this machine, and under a label left over that a real root of this machine took: pairs
    of a root and a label near each other first. `.status` is `DEGENERATE` where the leg planes do not determine the
    position, and `UNSOLVED` where not all eight roots could be isolated.
    """
    shape, rotation, position = read_pose(pose)
    joints, lengths, carried, status, _ = _solve(geometry, rotation, position, complex_roots=False)
    # The poses may be the caller's memory.
    solved = rotation.copy(), position.copy(), joints, lengths
    branches = branch_states(geometry, shape, solved)
    return SolutionSet(branches, BRANCHES, status.reshape(shape), met=(carried == 0).reshape(*shape, 8))


def as_built_physical(geometry: Geometry, pose: PoseLike) -> Configuration:
    """Find the configuration in which a machine as built holds the platform in a pose; see `inverse_physical`.

    Newton's method starts from the branches TT+ and TT- of the nominal machine. All branches are solved for where it
    cannot be followed from there, where neither branch is physical, and for large errors.
    """
    from spm_pin.kinematics.kernels.as_built_physical_kernel import certain_physical_branches

    limits, machines = geometry.limits, _machines(geometry)
    if np.abs(machines[1] - machines[0]).max() > _LARGE:
        return as_built_inverse(geometry, pose).physical()
    shape, rotation, position = read_pose(pose)
    nominal = _nominal_branches(geometry, rotation, position)
    bounds = np.array([(-np.inf,) * 6, (np.inf,) * 6] if limits is None else [limits.minimum, limits.maximum])
    constants = (
        *machines,
        tangent_signs(geometry.nominal),
        bounds - geometry.legs.offsets,
        geometry.nominal.middle_radius,
    )
    results = ((3, 3), np.float64), ((6,), np.float64), ((), np.bool_)
    joints, lengths, certain = run_kernel(
        certain_physical_branches, (rotation, position, nominal[2]), constants, results, _MIN_BATCH_PER_THREAD
    )
    turned, moved = nominal[0], nominal[1]
    rest = np.flatnonzero(~certain)
    if len(rest):
        matrices = homogeneous(rotation[rest], position[rest])
        others = as_built_inverse(geometry, matrices if shape else matrices[0]).physical()
        if not shape:
            return others
        turned[rest], moved[rest] = others.rotation, others.translation
        joints[rest], lengths[rest] = others.middle_joints, others.leg_lengths
    return Configuration.from_arrays(geometry, *with_batch_shape((turned, moved, joints, lengths), shape))


def as_built_complex_joints(geometry: Geometry, pose: PoseLike) -> npt.NDArray[np.complex128]:
    """Return the centres of the lower legs' balls of all eight roots; see `complex_middle_joints`.

    Real roots stand under their labels of `as_built_inverse`, the others under those left over.
    """
    shape, rotation, position = read_pose(pose)
    joints: npt.NDArray[np.complex128] = _solve(geometry, rotation, position, complex_roots=True)[4]
    return joints.reshape(*shape, 8, 3, 3)


def _machines(geometry: Geometry) -> list[FloatArray]:
    """Return axes, and pivots and balls in units of the middle radius, of the nominal machine and of this one."""
    unit = geometry.nominal.middle_radius
    both = geometry.nominal, geometry
    return [np.stack([g.legs.axes, g.legs.pivots / unit, g.legs.balls / unit]) for g in both]


def _nominal_branches(geometry: Geometry, rotation: FloatArray, position: FloatArray) -> tuple[Any, ...]:
    """Return the `BRANCH_RESULTS` of the nominal machine at N poses, joints that are not to be followed as NaN."""
    from spm_pin.kinematics.kernels.branch_kernels import all_branches

    poses, sizes = (rotation, position), radii(geometry.nominal)
    found = run_kernel(all_branches, poses, sizes, BRANCH_RESULTS, _MIN_BATCH_PER_THREAD)
    # The branches left of a degenerate pose are not followed: what they would meet is a continuous family.
    found[2][(found[6] == Status.DEGENERATE) | (found[7] != 0)] = np.nan
    return found


def _solve(geometry: Geometry, rotation: FloatArray, position: FloatArray, *, complex_roots: bool) -> tuple[Any, ...]:
    """Run the kernels on N poses: joints, lengths without offsets, carried, status, and the complex joints if asked."""
    from spm_pin.kinematics.kernels.as_built_kernels import as_built_branches
    from spm_pin.kinematics.kernels.branch_kernels import complex_branches

    sizes, poses = radii(geometry.nominal), (rotation, position)
    nominal = _nominal_branches(geometry, *poses)
    (everything,) = run_kernel(complex_branches, poses, sizes[:1], [((8, 3, 3), np.complex128)], _MIN_BATCH_PER_THREAD)
    count = len(position)
    results = (
        ((8, 3, 3), np.float64),
        ((8, 6), np.float64),
        ((8,), np.uint8),
        ((), np.int8),
        np.empty((count if complex_roots else 0, 8, 3, 3), np.complex128),
    )
    inputs = rotation, position, nominal[2], everything
    return run_kernel(as_built_branches, inputs, (*_machines(geometry), sizes[0]), results, _MIN_BATCH_PER_THREAD)
