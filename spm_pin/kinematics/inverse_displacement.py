"""Inverse displacement in closed form: four quadratics, one per family, no iteration, no data-dependent branching.

Derivation: `docs/theory/inverse_displacement.md`. The equations of a calibrated machine are three quadrics, from its
six leg planes; all eight roots are found, and the labels of the nominal machine are tracked to them, see
`docs/theory/calibrated.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.formulas.branches import ROUNDING
from spm_pin.kinematics import stage_displacement
from spm_pin.kinematics.batches import (
    BUILT_BRANCHES,
    DRAWN_BRANCHES,
    BuiltBranches,
    DrawnBranches,
    new_result,
    radii,
    read_pose,
    run_kernel,
    with_batch_shape,
)
from spm_pin.kinematics.either_machine import or_of_stage
from spm_pin.machine.branch_of_state import BRANCHES
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.legs import LEGS
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.machine.solutions import Degeneracy, SolutionSet, Status
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import FloatArray, IntArray, as_bool, check_instance, whole_number
from spm_pin.support.pose import PoseLike, as_rigid_transform

_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_AS_BUILT = 1 << 14, 1 << 9


@or_of_stage(stage_displacement.inverse)
def inverse_displacement(
    machine: Manipulator, pose: PoseLike, *, out: BranchMemory | None = None, certify: bool = False
) -> SolutionSet:
    """Find all configurations with a given pose of the platform: the branches.

    For a stage the arguments are a height and a tilt instead of a pose, as for
    `spm_pin.kinematics.stage_displacement.inverse`.

    Parameters
    ----------
    machine : Manipulator or Stage
        The manipulator. Its leg limits are not applied; see `SolutionSet.within`.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of {m} in {B}, translation in metres; one, or a batch of shape (...).
    out : BranchMemory, optional
        Memory for the results, for this machine and a batch of this size. The results of earlier calls with it then
        have the new numbers.
    certify : bool
        Bound the error of all joints, in `SolutionSet.radius`. For a nominal machine also decide the families that are
        not `certain`, and compute their branches, with more digits, a few milliseconds each.

    Returns
    -------
    SolutionSet
        The branches TT+, TT-, TF+, TF-, FT+, FT-, FF+, FF- along the last axis, so `.middle_joints` is
        (..., 8, 3, 3) and `.leg_lengths` (..., 8, 6), NaN where a branch is not real. `.status` (...) is `Status.OK`;
        `UNREACHABLE` if no branch is real; or `DEGENERATE` if some solutions are a continuous family, which is
        omitted.

        For a nominal machine `.discriminants` (..., 4), dimensionless, are those of the families' quadratics divided by
        r² = d²/3: the two branches of a family are real where it is not negative, and meet where it is zero, at an
        inverse singularity. `.degeneracy` describes continuous families, and `.certain` (..., 4) says which families
        are proved to be real or not; see `docs/theory/proofs.md`.

        For a calibrated machine labels are tracked from the nominal one while the errors grow. `.merged` (..., 8) is
        true if the tracked branch of a label met another one, and for a remaining label given to a real root of this
        machine. The status may be `UNSOLVED`, if not all eight roots could be isolated; see
        `docs/theory/calibrated.md`.

    Notes
    -----
    The paper obtains the same branches from a resultant of degree eight, Eqs. (5)-(20), see
    `spm_pin.crosscheck.paper.resultant`.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> machine = spm.Manipulator.paper()
    >>> pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    >>> spm.inverse_displacement(machine, pose)
    <SolutionSet: ok, 6 of 8 real: TT+, TT-, TF+, TF-, FF+, FF->
    """
    certified = as_bool(certify, "certify")
    shape, rotation, position = read_pose(machine, pose)
    results = None if out is None else _memory_of(out, machine, len(position))
    solved = _method(machine).branches(rotation, position, results)
    details: dict[str, Any] = {}
    if isinstance(solved, DrawnBranches):
        details["degeneracy"] = _find_degeneracy(machine, shape, solved)
    if certified:
        from spm_pin.kinematics.certified_branches import certify_branches

        details["radius"] = certify_branches(machine, solved).reshape(*shape, 8)
    if isinstance(solved, DrawnBranches):
        names = "discriminants", "certain", "at_home"
        details |= dict(zip(names, with_batch_shape([getattr(solved, name) for name in names], shape), strict=True))
    else:
        details["merged"] = (solved.carried == 0).reshape(*shape, 8)
    branches = SolutionSet(_states(machine, solved, shape), BRANCHES, solved.status.reshape(shape), **details)
    return branches if machine.legs.are_rps else _within_reach(branches)


def _states(machine: Manipulator, solved: DrawnBranches | BuiltBranches, shape: tuple[int, ...]) -> Configuration:
    """Return branches (..., 8)."""
    rotation, position = solved.rotation.reshape(*shape, 1, 3, 3), solved.position.reshape(*shape, 1, 3)
    return Configuration.from_arrays(
        machine,
        np.broadcast_to(rotation, (*shape, 8, 3, 3)),
        np.broadcast_to(position, (*shape, 8, 3)),
        *with_batch_shape((solved.joints, solved.lengths), shape),
    )


def _within_reach(branches: SolutionSet) -> SolutionSet:
    """Return the branches whose balls are within reach of all legs."""
    reached = np.isfinite(branches.readings)
    left = branches.where(reached.all(axis=-1))
    lost = np.asarray(branches.exists.any(axis=-1) & ~left.exists.any(axis=-1))
    if not branches.shape and lost:
        rows = zip(BRANCHES, branches.exists, ~reached, strict=True)
        beyond = (f"{label} {', '.join(np.array(LEGS)[legs])}" for label, exists, legs in rows if exists and legs.any())
        left.configurations.missing_reason = f"balls are out of reach of their legs: {'; '.join(beyond)}"
    # Which branches are physical depends on rods, while the kernels use the lines from the pivots.
    return replace(left, status=np.where(lost, Status.UNREACHABLE, branches.status), at_home=None)


class BranchMemory:
    """Memory for the branches of one batch after another, with `size` poses each; see `inverse_displacement`."""

    def __init__(self, machine: Manipulator, size: int) -> None:
        self._machine = check_manipulator(machine)
        self._size = whole_number(size, "size", "the number of poses of a batch", least=0)
        results = _method(machine).results
        self.arrays = [x if isinstance(x, np.ndarray) else new_result(self._size, x) for x in results]


def _memory_of(out: BranchMemory, machine: Manipulator, size: int) -> list[npt.NDArray[Any]]:
    expected = f"BranchMemory of this machine for {size} poses"
    memory = check_instance(out, BranchMemory, "out", expected)
    if memory._size != size or (memory._machine is not machine and memory._machine != machine):
        raise ArgumentError("out", expected, f"one of {memory._machine!r} for {memory._size}")
    return memory.arrays


class _Method(NamedTuple):
    """The kernels that solve poses of a machine, their constants, and the results of all branches."""

    all_branches: Callable[..., None]
    physical_branch: Callable[..., None]
    constants: tuple[Any, ...]
    results: DrawnBranches | BuiltBranches
    min_batch: int

    def branches(
        self, rotation: FloatArray, position: FloatArray, results: Sequence[Any] | None = None
    ) -> DrawnBranches | BuiltBranches:
        """Return all branches of N poses, in memory of their own or in `results`, see `run_kernel`."""
        wanted = self.results if results is None else results
        return type(self.results)(
            *run_kernel(self.all_branches, (rotation, position), self.constants, wanted, self.min_batch)
        )


def _method(machine: Manipulator) -> _Method:
    if machine.is_nominal:
        from spm_pin.kinematics.kernels.branch_kernels import all_branches, physical_branch

        return _Method(all_branches, physical_branch, radii(machine), DRAWN_BRANCHES, _MIN_BATCH_PER_THREAD)
    from spm_pin.kinematics.kernels.calibrated_kernels import calibrated_branches, calibrated_physical_branch

    unit = machine.middle_radius
    machines = [(x.axes, x.pivots / unit, x.balls / unit) for x in (machine.nominal.legs, machine.legs)]
    constants = np.stack(machines), unit
    return _Method(
        calibrated_branches, calibrated_physical_branch, constants, BUILT_BRANCHES, _MIN_BATCH_PER_THREAD_AS_BUILT
    )


@or_of_stage(stage_displacement.inverse_physical)
def inverse_physical(machine: Manipulator, pose: PoseLike, *, near: Configuration | None = None) -> Configuration:
    """Find the physical configuration for a pose, in which an assembled machine is.

    For a stage the arguments are a height and a tilt instead of a pose, as for
    `spm_pin.kinematics.stage_displacement.inverse_physical`.

    Parameters
    ----------
    machine : Manipulator or Stage
        The manipulator. Its leg limits only decide between two configurations; see `LegLimits.contains`.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        As for `inverse_displacement`, one or a batch of shape (...).
    near : Configuration, optional
        A state of the machine before: of two physical configurations, on either side of an inverse singularity, the
        one closer to that state is returned. See `SolutionSet.nearest`.

    Returns
    -------
    Configuration
        Of shape (...): the same as ``inverse_displacement(machine, pose).physical(near)``, with less time and memory.
        Both stages are without torsion and reached from the symmetric home without a forward singularity. If TT+ and
        TT- both are, those within the leg limits are preferred, then the one closer to `near` or, without it, the one
        with less tilted stages. `.exists` is False, and everything NaN, if there is no such configuration.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> machine = spm.Manipulator.paper()
    >>> pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    >>> spm.inverse_physical(machine, pose).leg_lengths.round(3)
    array([1.2  , 1.2  , 1.399, 1.25 , 1.2  , 1.501])
    """
    legs = check_manipulator(machine).legs
    if near is not None or not legs.are_rps:
        return inverse_displacement(machine, pose).physical(near)
    shape, rotation, position = read_pose(machine, pose)
    limits, offsets = machine.limits, legs.offsets
    bounds = np.array([[-np.inf] * 6, [np.inf] * 6] if limits is None else limits.admitted) - offsets
    results = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64), ((6,), np.float64)
    method = _method(machine)
    constants = *method.constants, bounds
    solved = run_kernel(method.physical_branch, (rotation, position), constants, results, method.min_batch)
    state = Configuration.from_arrays(machine, *with_batch_shape(solved, shape))
    if not shape and not state.exists:
        # The same, with the reason why it does not exist.
        return inverse_displacement(machine, pose).physical()
    return state


def branch_lengths(machine: Manipulator, pose: PoseLike) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Compute only the leg lengths of all branches, for maps and filters.

    Parameters
    ----------
    machine, pose
        As for `inverse_displacement`.

    Returns
    -------
    leg_lengths : ndarray, shape (..., 8, 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m] of the branches in the order of `BRANCHES`, NaN where one is not real:
        bitwise equal to those of `inverse_displacement`, with a third of the memory.
    status : ndarray of int8, shape (...)
        `Status` of each pose.
    """
    shape, rotation, position = read_pose(machine, pose)
    method = _method(machine)
    results = method.results
    if isinstance(results, DrawnBranches):
        # No memory for results that are not requested.
        nothing = {name: new_result(0, getattr(results, name)) for name in results._fields}
        results = results._replace(**{x: nothing[x] for x in nothing if x not in ("lengths", "status", "flagged")})
    solved = method.branches(rotation, position, results)
    if isinstance(solved, DrawnBranches):
        _find_degeneracy(machine, shape, solved._replace(rotation=rotation, position=position))
    return solved.lengths.reshape(*shape, 8, 6), solved.status.reshape(shape)


def complex_middle_joints(machine: Manipulator, pose: PoseLike) -> npt.NDArray[np.complex128]:
    """Return all eight roots of the inverse displacement, real or complex.

    Parameters
    ----------
    machine, pose
        As for `inverse_displacement`.

    Returns
    -------
    ndarray of complex128, shape (..., 8, 3, 3)
        Rows b_1, b_2, b_3 in {B} [m]. A family with a negative discriminant has two conjugate solutions, as
        in the paper's Tables 1-3. NaN where a family is continuous or has no finite solution. For a calibrated machine
        real roots have their labels of `inverse_displacement`, the others the remaining labels.
    """
    shape, rotation, position = read_pose(machine, pose)
    method, roots = _method(machine), ((8, 3, 3), np.complex128)
    if isinstance(method.results, DrawnBranches):
        from spm_pin.kinematics.kernels.branch_kernels import complex_branches

        radius = method.constants[:1]
        (joints,) = run_kernel(complex_branches, (rotation, position), radius, [roots], _MIN_BATCH_PER_THREAD_AS_BUILT)
    else:
        solved = method.branches(rotation, position, method.results._replace(roots=roots))
        assert isinstance(solved, BuiltBranches)
        joints = solved.roots
    return np.asarray(joints.reshape(*shape, 8, 3, 3))


def _find_degeneracy(machine: Manipulator, shape: tuple[int, ...], solved: DrawnBranches) -> Degeneracy:
    """Describe the continuous families, which only flagged poses can have; set their status."""
    from spm_pin.kinematics.kernels.branch_kernels import VERTICAL

    rotation, position, flagged = solved.rotation, solved.position, solved.flagged
    n, some = len(flagged), np.flatnonzero(flagged)
    families, dimension, legs = np.zeros((n, 4), np.bool_), np.zeros(n, np.int8), np.zeros((n, 3), np.bool_)
    families[some] = (flagged[some, None] & np.array([1, 2, 4, 8])) > 0
    # Where the two Z axes meet or cross, (P : Q) is free in a continuous family: it has one dimension.
    dimension[some] = families[some].any(axis=-1)
    vertical = np.flatnonzero(flagged & VERTICAL)
    if len(vertical):
        sizes = _vertical_families(rotation[vertical], position[vertical] / machine.middle_radius)
        families[vertical], dimension[vertical] = sizes > 0, sizes.max(axis=-1)
    moving = np.flatnonzero(dimension)
    if len(moving):
        solved.status[moving] = Status.DEGENERATE
        axes, places = machine.revolute_axes, position[moving]
        parallel = np.linalg.norm(np.cross(axes, axes @ np.swapaxes(rotation[moving], -1, -2)), axis=-1) <= ROUNDING
        aside = np.hypot(places[:, 0], places[:, 1])
        in_plane = np.abs(places @ axes.T) <= ROUNDING * (machine.middle_radius + aside)[:, None]
        legs[moving] = parallel & in_plane
    return Degeneracy(dimension.reshape(shape), families.reshape(*shape, 4), legs.reshape(*shape, 3))


def _vertical_families(rotation: FloatArray, place: FloatArray) -> IntArray:
    """Return the dimensions (N, 4) of the continuous families TT, TF, FT, FF where the Z axes are parallel; 0 for none.

    `place` is o / r. All legs' planes are vertical then, so a solution can move along Z: there is no solution, or a
    continuous family.

    - Platform level, turned by 0 or a half turn: planes in pairs parallel. On the axis they coincide and the middle
      platform moves with three degrees of freedom, in equal or in opposite modes; off it, there is no solution.
    - Platform level, turned by another angle τ: lines vertical. The middle platform is upside down in both stages,
      which requires |o| = 2 r |sin τ| in the horizontal.
    - Platform upside down, turned over about the horizontal axis W: y = i o / r must be on the segment from e_p W⁴ to
      e_q conj(W²); where that shrinks to a point, (P : Q) is free as well.
    """
    mixed, lower = np.array([False, True, True, False]), np.array([1.0, 1.0, -1.0, -1.0])
    cosine, sine, is_level = rotation[:, 0, :1], rotation[:, 1, :1], rotation[:, 2, 2:] > 0.0
    x, y = place[:, :1], place[:, 1:2]
    aside = np.hypot(x, y)
    tolerance = ROUNDING * (1.0 + aside)
    # R maps 1 to W², which gives W up to a sign that does not matter.
    w = np.sqrt(cosine + 1j * sine)
    cubed, turned = w * w * w, 1j * (x + 1j * y) * w.conj()
    fixed, across = (np.where(mixed, z.imag, z.real) for z in (cubed, turned))
    extent, along = (np.abs(np.where(mixed, z.real, z.imag)) for z in (cubed, turned))
    on_segment = (np.abs(across - lower * fixed) <= tolerance) & (along <= extent + tolerance)
    on_axis, on_circle = (
        (aside <= tolerance) & (mixed == (cosine <= 0.0)),
        np.abs(aside - 2.0 * np.abs(sine)) <= tolerance,
    )
    of_level = np.where(np.abs(sine) <= tolerance, 3 * on_axis, on_circle)
    return np.where(is_level, of_level, on_segment * np.where(extent <= tolerance, 2, 1))


def physical_at_poses(machine: Manipulator | Stage, pose: PoseLike) -> Configuration:
    """Return the physical states of poses (...); for a stage only their heights and normals are used."""
    if isinstance(machine, Manipulator):
        return inverse_physical(machine, pose)
    matrices = as_rigid_transform(pose).as_matrix()
    return stage_displacement.inverse_physical(machine, matrices[..., 2, 3], normal=matrices[..., :3, 2])
