"""Inverse displacement in closed form: four quadratics, one per family, no iteration and no branch.

Write the horizontal vector (x, y) as the complex number x + iy and a unit quaternion as the pair
s = x0 + i x3, w = x1 + i x2. With q_R = (S, W) the platform's rotation, a = (p, w_a) and b = (q, w_b) the
middle platform's seen from {B} and from {m}, a = q_R b reads

    W conj(w_b) = S q - p,        conj(W) w_a = conj(q) - S conj(p).

The lower leg planes all contain the Z axis of {B}; this alone forces p to be real (mode T: p = P) or imaginary
(mode F: p = iP) and puts the middle platform's centre at the horizontal position -i r conj(w_a²). The same
holds for q, w_b, Q in {m}. With h the signed distance of the two Z axes along their common normal, closing the
chain along that normal is homogeneous of degree two in (P, Q):

    r Re(i s [W³ e_q (Q - S'P)² + conj(W)³ e_p (S'Q - P)²]) = h N,    N = P² + Q² - 2 κ PQ = |W|²,

s = S/|S| and W scaled to modulus one in the bracket, S' = S (q/Q)/(p/P) = κ + iμ, e = +1 for T and -1 for F.
In the coordinates u ~ P - Q, v ~ P + Q that make N = u² + v² the equation is a symmetric 2 x 2 form, and every
step keeps the relative accuracy of small tilts. Derivation: `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.closed_form.degeneracy import find_degeneracy
from spm_pin.closed_form.threads import in_parts
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import EXACT, PoseLike, checked_pose, unchecked_pose
from spm_pin.mechanism.solutions import Degeneracy, SolutionSet, Status

__all__ = ["branch_lengths", "complex_middle_joints", "inverse_displacement"]

ByteArray = npt.NDArray[np.uint8]
ComplexArray = npt.NDArray[np.complex128]
Found = TypeVar("Found")
_Branches = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, npt.NDArray[np.int8]]
_Lengths = tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.int8]]

_ENOUGH = 1 << 14
"""Poses that are worth a thread."""


def inverse_displacement(geometry: Geometry, pose: PoseLike) -> SolutionSet:
    """Find all configurations of the manipulator that hold the platform in a pose.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits are not applied; see `SolutionSet.within`.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of {m} in {B}, translation in metres; one, or a batch of shape (...).

    Returns
    -------
    SolutionSet
        The branches TT+, TT-, TF+, TF-, FT+, FT-, FF+, FF- along the last axis, so `.middle_joints` is
        (..., 8, 3, 3) and `.leg_lengths` (..., 8, 6), NaN where a branch is not real. `.discriminants`
        (..., 4), dimensionless, are those of the families' quadratics divided by r² = d²/3: the two branches
        of a family are real where it is not negative, and meet where it is zero, at an inverse singularity.
        `.status` (...) is `Status.OK`; `UNREACHABLE` where no branch is real; or `DEGENERATE` where some
        family is continuous: it is left out, and `.degeneracy` describes it.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.

    Notes
    -----
    Hu, Lu, Yu, Zhuang obtain the same branches from a resultant of degree eight, Eqs. (5)-(20); that route is
    `spm_pin.paper.resultant`. This one has no denominator that a regular pose can make zero.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> geometry = spm.Geometry.paper()
    >>> pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    >>> spm.inverse_displacement(geometry, pose)
    <SolutionSet: ok, 6 of 8 real: TT+, TT-, TF+, TF-, FF+, FF->
    """

    def solve(rotation: FloatArray, position: FloatArray) -> tuple[_Branches, ByteArray]:
        from spm_pin.closed_form.kernels.branch_kernels import all_branches

        n = len(position)
        # The answer keeps the pose, hence a copy; RigidTransform has made one already.
        keep = (rotation, position) if isinstance(pose, RigidTransform) else (np.empty((n, 3, 3)), np.empty((n, 3)))
        found = np.empty((n, 8, 3, 3)), np.empty((n, 8, 6)), np.empty((n, 4)), np.empty(n, dtype=np.int8)
        flagged = np.empty(n, dtype=np.uint8)
        joints, lengths, discriminants, status = found
        sizes = geometry.middle_radius, geometry.base_radius, geometry.platform_radius, EXACT

        def part(at: slice) -> None:
            if keep[0] is not rotation:
                keep[0][at], keep[1][at] = rotation[at], position[at]
            written = joints[at], lengths[at], discriminants[at]
            all_branches(keep[0][at], keep[1][at], *sizes, *written, status[at], flagged[at])

        in_parts(part, n, _ENOUGH)
        return (*keep, *found), flagged

    shape, (rotation, position, joints, lengths, discriminants, status), flagged = _solved(solve, pose)
    rotation, position = rotation.reshape(*shape, 3, 3), position.reshape(*shape, 3)
    degeneracy = _degeneracy(geometry, rotation, position, flagged, status)
    branches = Configuration.from_arrays(
        geometry,
        np.broadcast_to(rotation[..., None, :, :], (*shape, 8, 3, 3)),
        np.broadcast_to(position[..., None, :], (*shape, 8, 3)),
        joints.reshape(*shape, 8, 3, 3),
        lengths.reshape(*shape, 8, 6),
    )
    return SolutionSet(
        branches,
        BRANCHES,
        status.reshape(shape),
        discriminants=discriminants.reshape(*shape, 4),
        degeneracy=degeneracy,
    )


def branch_lengths(geometry: Geometry, pose: PoseLike) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Find the leg lengths of all branches, and nothing else: `inverse_displacement` for maps and filters.

    Parameters
    ----------
    geometry, pose
        As for `inverse_displacement`.

    Returns
    -------
    leg_lengths : ndarray, shape (..., 8, 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m] of the branches in the order of `BRANCHES`, NaN where one is not real:
        what `inverse_displacement` returns, to the bit, for a third of the memory.
    status : ndarray of int8, shape (...)
        `Status` of each pose.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    """

    def solve(rotation: FloatArray, position: FloatArray) -> tuple[_Lengths, ByteArray]:
        from spm_pin.closed_form.kernels import branch_kernels as kernels

        n = len(position)
        lengths, status, flagged = np.empty((n, 8, 6)), np.empty(n, dtype=np.int8), np.empty(n, dtype=np.uint8)
        sizes = geometry.middle_radius, geometry.base_radius, geometry.platform_radius, EXACT

        def part(at: slice) -> None:
            kernels.branch_lengths(rotation[at], position[at], *sizes, lengths[at], status[at], flagged[at])

        in_parts(part, n, _ENOUGH)
        return (rotation, position, lengths, status), flagged

    shape, (rotation, position, lengths, status), flagged = _solved(solve, pose)
    _degeneracy(geometry, rotation, position, flagged, status)
    return lengths.reshape(*shape, 8, 6), status.reshape(shape)


def complex_middle_joints(geometry: Geometry, pose: PoseLike) -> ComplexArray:
    """Return all eight roots of the inverse displacement, real or complex.

    Parameters
    ----------
    geometry, pose
        As for `inverse_displacement`.

    Returns
    -------
    ndarray of complex128, shape (..., 8, 3, 3)
        Rows b_1, b_2, b_3 in {B} [m]. A family with a negative discriminant holds two conjugate solutions, as
        in the paper's Tables 1-3. NaN where a family is continuous or has no finite solution.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    """

    def solve(rotation: FloatArray, position: FloatArray) -> tuple[ComplexArray, ByteArray]:
        from spm_pin.closed_form.kernels.branch_kernels import complex_branches

        n = len(position)
        joints, flagged = np.empty((n, 8, 3, 3), dtype=np.complex128), np.empty(n, dtype=np.uint8)

        def part(at: slice) -> None:
            complex_branches(rotation[at], position[at], geometry.middle_radius, EXACT, joints[at], flagged[at])

        in_parts(part, n, _ENOUGH)
        return joints, flagged

    shape, joints, _ = _solved(solve, pose)
    return joints.reshape(*shape, 8, 3, 3)


def _solved(
    solve: Callable[[FloatArray, FloatArray], tuple[Found, ByteArray]], pose: PoseLike
) -> tuple[tuple[int, ...], Found, ByteArray]:
    """Return the shape of a batch of poses, what `solve` found at N rotations and positions, and its flags (N,)."""
    from spm_pin.closed_form.kernels.branch_kernels import QUESTIONABLE

    rotation, position = unchecked_pose(pose)
    found, flagged = solve(rotation.reshape(-1, 3, 3), position.reshape(-1, 3))
    if flagged.any() and (flagged & QUESTIONABLE).any():
        # The kernel looks at the numbers in passing; what to do about them is said elsewhere.
        rotation, position = checked_pose(rotation, position, "pose")
        found, flagged = solve(rotation.reshape(-1, 3, 3), position.reshape(-1, 3))
    return position.shape[:-1], found, flagged


def _degeneracy(
    geometry: Geometry, rotation: FloatArray, position: FloatArray, flagged: ByteArray, status: npt.NDArray[np.int8]
) -> Degeneracy:
    """Look at the flagged poses, rotations (..., 3, 3) and positions (..., 3), and set the `status` (N,) of some."""
    shape, n = position.shape[:-1], len(flagged)
    dimension, families, legs = np.zeros(n, np.int8), np.zeros((n, 4), np.bool_), np.zeros((n, 3), np.bool_)
    if flagged.any():
        at = np.flatnonzero(flagged)
        found = find_degeneracy(geometry, flagged[at], rotation.reshape(-1, 3, 3)[at], position.reshape(-1, 3)[at])
        dimension[at], families[at], legs[at] = found.dimension, found.families, found.legs
        status[at[found.dimension > 0]] = Status.DEGENERATE
    return Degeneracy(dimension.reshape(shape), families.reshape(*shape, 4), legs.reshape(*shape, 3))
