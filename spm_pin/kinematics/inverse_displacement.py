"""Inverse displacement in closed form: four quadratics, one per family, no iteration, no data-dependent branching.

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
In the coordinates u ~ P - Q, v ~ P + Q that make N = u² + v² the equation is a symmetric 2 x 2 form, and nothing
cancels as the platform levels. Derivation: `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.as_built_inverse import as_built_complex_joints, as_built_inverse, as_built_physical
from spm_pin.kinematics.batches import (
    BRANCH_RESULTS,
    branch_states,
    radii,
    read_pose,
    run_kernel,
    with_batch_shape,
)
from spm_pin.kinematics.degeneracy import find_degeneracy
from spm_pin.mechanism.arguments import FloatArray, as_bool
from spm_pin.mechanism.branches import BRANCHES
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import PoseLike
from spm_pin.mechanism.solutions import SolutionSet

ROUNDING_BOUND = 2.0**-39
"""Bound of the rounding error of a discriminant over r², divided by (1 + (|x| + |y|)/r)²: `docs/theory/proofs.md`."""

_MIN_BATCH_PER_THREAD = 1 << 14


def inverse_displacement(
    geometry: Geometry, pose: PoseLike, *, out: SolutionSet | None = None, certify: bool = False
) -> SolutionSet:
    """Find all configurations of the manipulator that hold the platform in a pose.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits are not applied; see `SolutionSet.within`.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of {m} in {B}, translation in metres; one, or a batch of shape (...).
    out : SolutionSet, optional
        What an earlier call for a batch of this shape returned. Its memory is written anew, which saves what the system
        takes to provide memory; it and everything taken from it then hold the new numbers.
    certify : bool
        Decide the families that are not `certain` without rounding, and compute their branches with more digits, a few
        milliseconds each; and bound the error of all joints, in `SolutionSet.radius`.

    Returns
    -------
    SolutionSet
        The branches TT+, TT-, TF+, TF-, FT+, FT-, FF+, FF- along the last axis, so `.middle_joints` is
        (..., 8, 3, 3) and `.leg_lengths` (..., 8, 6), NaN where a branch is not real. `.discriminants`
        (..., 4), dimensionless, are those of the families' quadratics divided by r² = d²/3: the two branches
        of a family are real where it is not negative, and meet where it is zero, at an inverse singularity.
        `.status` (...) is `Status.OK`; `UNREACHABLE` where no branch is real; or `DEGENERATE` where some
        family is continuous: it is left out, and `.degeneracy` describes it. For a machine as built `.leg_lengths`
        are readings, offsets included, labels are carried from the nominal machine, `.met` (..., 8) is true where two
        branches met on the way, and the status may be `UNSOLVED`; see `docs/theory/as_built.md`. For a `Geometry`
        `.certain` (..., 4) says which families are proved to be real, or not; see `docs/theory/proofs.md`.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    ArgumentError
        If `out` is no result of this function for a batch of this shape, or it or `certify` is given for an
        machine as built.

    Notes
    -----
    Hu, Lu, Yu, Zhuang [1]_ obtain the same branches from a resultant of degree eight, Eqs. (5)-(20); that route is
    `spm_pin.paper.resultant`. This one has no denominator that a regular pose can make zero. As far as we remember,
    four quadratic factors are in [2]_ as well.

    References
    ----------
    .. [1] B. Hu, Y. Lu, J. J. Yu, S. Zhuang, "Analyses of Inverse Kinematics, Statics and Workspace of a Novel
       3RPS-3SPR Serial-Parallel Manipulator".
    .. [2] A. Nayak, S. Caro, P. Wenger, "Kinematic Analysis of the 3-RPS-3-SPR Series-Parallel Manipulator", Robotica
       37 (2019). More in docs/related_work.md.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> geometry = spm.Geometry.paper()
    >>> pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    >>> spm.inverse_displacement(geometry, pose)
    <SolutionSet: ok, 6 of 8 real: TT+, TT-, TF+, TF-, FF+, FF->
    """
    certified = as_bool(certify, "certify")
    if not geometry.is_nominal:
        if out is not None:
            raise ArgumentError("out", "None for a machine as built", type(out).__name__)
        if certified:
            raise ArgumentError("certify", "False for a machine as built", certify)
        return as_built_inverse(geometry, pose)
    from spm_pin.kinematics.kernels.branch_kernels import all_branches

    shape, rotation, position = read_pose(pose)
    results = BRANCH_RESULTS if out is None else _memory_of(out, shape)
    solved = run_kernel(all_branches, (rotation, position), radii(geometry), results, _MIN_BATCH_PER_THREAD)
    rotation, position, _, _, discriminants, choice, status, flagged = solved
    degeneracy = find_degeneracy(geometry, shape, rotation, position, flagged, status)
    found = SolutionSet(
        branch_states(geometry, shape, solved[:4]),
        BRANCHES,
        status.reshape(shape),
        discriminants=discriminants.reshape(*shape, 4),
        degeneracy=degeneracy,
        choice=choice.reshape(*shape, 3),
        memory=solved,
        rounding=ROUNDING_BOUND,
    )
    if not certified:
        return found
    from spm_pin.kinematics.certified_branches import certify_branches

    return certify_branches(found, solved)


def _memory_of(out: SolutionSet, shape: tuple[int, ...]) -> tuple[npt.NDArray[np.generic], ...]:
    if not isinstance(out, SolutionSet):
        raise ArgumentError("out", "a SolutionSet", type(out).__name__)
    if out.memory is None or out.shape != shape or len(out.memory[0]) != math.prod(shape):
        received = f"one of shape {out.shape}" if out.memory is not None else "one that does not own its memory"
        raise ArgumentError("out", f"what `inverse_displacement` returned for a batch of shape {shape}", received)
    return out.memory


def inverse_physical(geometry: Geometry, pose: PoseLike) -> Configuration:
    """Find the physical configuration for a pose: the one in which the machine holds the platform there.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits only decide between two configurations; see `LegLimits.contains`.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of {m} in {B}, translation in metres; one, or a batch of shape (...).

    Returns
    -------
    Configuration
        Of shape (...): to the bit what ``inverse_displacement(geometry, pose).physical()`` returns, in less time and
        memory. Both stages are without torsion and reached from the symmetric home without a forward
        singularity. If TT+ and TT- both are, those within the leg limits are preferred, then the one whose stages are
        tilted less; `SolutionSet.ambiguous` is True there. `.exists` is False, and everything NaN,
        where there is no such configuration. Of a machine as built the same, to rounding.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> geometry = spm.Geometry.paper()
    >>> pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    >>> spm.inverse_physical(geometry, pose).leg_lengths.round(3)
    array([1.2 , 1.2 , 1.4 , 1.25, 1.2 , 1.5 ])
    """
    from spm_pin.kinematics.kernels.branch_kernels import physical_branches

    if not geometry.is_nominal:
        return as_built_physical(geometry, pose)
    sizes, limits = radii(geometry), geometry.limits
    shape, rotation, position = read_pose(pose)
    bounds = np.array([(0.0,) * 6, (np.inf,) * 6] if limits is None else [limits.minimum, limits.maximum])
    results = (((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64), ((6,), np.float64))
    solved = run_kernel(physical_branches, (rotation, position), (*sizes, bounds), results, _MIN_BATCH_PER_THREAD)
    found = Configuration.from_arrays(geometry, *with_batch_shape(solved, shape))
    if not shape and not found.exists:
        # The same, with the reason why there is none.
        return inverse_displacement(geometry, pose).physical()
    return found


def branch_lengths(geometry: Geometry, pose: PoseLike) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Find the leg lengths of all branches alone, as maps and filters need them.

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
    from spm_pin.kinematics.kernels import branch_kernels as kernels

    if not geometry.is_nominal:
        solutions = inverse_displacement(geometry, pose)
        return solutions.leg_lengths, solutions.status
    shape, rotation, position = read_pose(pose)
    results = ((8, 6), np.float64), ((), np.int8), ((), np.uint8)
    lengths, status, flagged = run_kernel(
        kernels.branch_lengths, (rotation, position), radii(geometry), results, _MIN_BATCH_PER_THREAD
    )
    find_degeneracy(geometry, shape, rotation, position, flagged, status)
    leg_lengths, outcome = with_batch_shape((lengths, status), shape)
    return leg_lengths, outcome


def complex_middle_joints(geometry: Geometry, pose: PoseLike) -> npt.NDArray[np.complex128]:
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
    from spm_pin.kinematics.kernels.branch_kernels import complex_branches

    if not geometry.is_nominal:
        return as_built_complex_joints(geometry, pose)
    shape, rotation, position = read_pose(pose)
    results = [((8, 3, 3), np.complex128)]
    (joints,) = run_kernel(complex_branches, (rotation, position), radii(geometry)[:1], results, _MIN_BATCH_PER_THREAD)
    return np.asarray(joints.reshape(*shape, 8, 3, 3))
