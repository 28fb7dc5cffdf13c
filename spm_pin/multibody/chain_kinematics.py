"""Closed joint values of a chain: near others, and of leg lengths or a pose, in closed form or by continuation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_physical
from spm_pin.mechanism.arguments import FloatArray, as_bool, first_offender, whole_number
from spm_pin.mechanism.leg_limits import LEGS
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.multibody.batched_states import LOCATED, ChainLike, located
from spm_pin.multibody.closure_checks import require_closed
from spm_pin.multibody.closure_solvers import ContinuationSolver, project_to_closure
from spm_pin.multibody.constrained_state import ChainState
from spm_pin.multibody.vector_arguments import read_vectors


def project(self: ChainLike, q: npt.ArrayLike, *, hold_legs: bool = False, max_iterations: int = 50) -> FloatArray:
    """Return closed joint values (..., 18) near q, by Newton's method; angles are not reduced to one turn.

    All joints move, as little as closes the loops to first order, slides measured in units of the middle platform's
    side; with `hold_legs` the passive ones alone: forward displacement, to the assembly mode that q is near to.
    Steps are halved where a full one does not shrink the gaps. Raises `ClosureError`, with the largest gap and the
    number of steps, if the loops of a member do not close to rounding in `max_iterations`.
    """
    most, held = whole_number(max_iterations, "max_iterations", "a number of steps"), as_bool(hold_legs, "hold_legs")

    def member(state: ChainState) -> FloatArray:
        return project_to_closure(state.kinematics.q, state.kinematics, held, most)

    return self._states.array(member, (18,), q)


def forward_kinematics(self: ChainLike, leg_lengths: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
    """Return all joints (..., 18) of leg lengths (..., 6) [m]: the passive ones from the actuated ones.

    By default in the physical assembly mode of each member, in closed form and vectorised, angles in [-π, π]; see
    `spm_pin.forward_physical`. With `near` (18,), a closed q, the mechanism goes from there to the first member by
    changing all legs in proportion, and on to each from the one before, in C order, in the assembly mode that it
    comes to, angles continuous and not reduced to one turn; legs that change little take one or two steps of
    Newton's method. Closed to rounding.

    Raises
    ------
    ArgumentError
        If an argument is malformed or, without `near`, the physical mode cannot have these lengths.
    ClosureError
        If `near` is open, or the path does not lead to a member: with how far it leads.
    SingularConfigurationError
        If `near` or a member is at a forward or a constraint singularity.
    """
    layout = self._states.constrained.layout
    if near is None:
        found = forward_physical(layout.geometry, leg_lengths)
        if not found.exists.all():
            index = first_offender(~found.exists)
            received = f"{_listed(np.asarray(leg_lengths, dtype=np.float64)[index])} m"
            expected = "lengths that the physical assembly mode can have"
            raise _not_found("leg_lengths", expected, received, index, found.missing_reason or "A misread leg?")
        return layout.values_of(found)
    lengths = read_vectors(leg_lengths, "leg_lengths", 6)
    if (lengths < layout.offsets).any():
        worst = np.unravel_index(int((lengths - layout.offsets).argmin()), lengths.shape)
        expected = "no negative length" if layout.geometry.is_nominal else "readings above the offsets"
        raise ArgumentError("leg_lengths", expected, f"{lengths[worst]:g} m in {LEGS[worst[-1]]}")
    return _follow(self, ContinuationSolver.to_leg_lengths, near, lengths.shape[:-1], lengths)


def inverse_kinematics(self: ChainLike, pose: PoseLike, near: npt.ArrayLike | None = None) -> FloatArray:
    """Return all joints (..., 18) of a pose (...) of the terminal platform, {m} in {B}.

    By default in the physical branch of each member, in closed form and vectorised, angles in [-π, π]; see
    `spm_pin.kinematics.inverse_physical`. With `near` (18,), a closed q, the platform moves and turns from there
    to the first member in proportion, and on to each from the one before, as in `forward_kinematics`, in the branch
    that it comes to; leg limits play no part. Closed to rounding.

    Raises
    ------
    ArgumentError, PoseError
        If an argument is malformed or, without `near`, no physical branch has the pose.
    ClosureError
        If `near` is open, or the path does not lead to a member: with how far it leads.
    SingularConfigurationError
        If `near` or a member is at an inverse or a constraint singularity.
    """
    layout, transform = self._states.constrained.layout, as_rigid_transform(pose)
    if near is None:
        found = inverse_physical(layout.geometry, transform)
        if not found.exists.all():
            index = first_offender(~found.exists)
            place, turn = (x[index] for x in (transform.translation, transform.rotation.as_rotvec()))
            received = f"o at {_listed(place)} m, turned by the rotation vector {_listed(turn)} rad"
            expected = "poses that a physical branch has"
            raise _not_found("pose", expected, received, index, found.missing_reason or "Level, or out of reach?")
        return layout.values_of(found)
    poses = transform.rotation.as_matrix(), transform.translation
    return _follow(self, ContinuationSolver.to_pose, near, transform.shape, *poses)


def _follow(
    self: ChainLike,
    solve: Callable[..., FloatArray],
    near: npt.ArrayLike,
    shape: tuple[int, ...],
    *targets: FloatArray,
) -> FloatArray:
    """Return q of each target by a method of `ContinuationSolver`, from that of the one before."""
    start = self._states.constrained.checked(near, "near", single=True)

    def found(state: ChainState) -> FloatArray:
        require_closed(state.kinematics)
        solver, path = ContinuationSolver(state.kinematics), [start]
        for index in np.ndindex(shape):
            try:
                path.append(solve(solver, path[-1], *(array[index] for array in targets)))
            except LOCATED as error:
                raise located(error, index) from error
        return np.reshape(path[1:], (*shape, start.size))

    return self._states.array(found, (*shape, start.size), start)


def _listed(numbers: FloatArray) -> str:
    """Return numbers (n,) as text, to nine digits."""
    return f"[{', '.join(f'{number:.9g}' for number in numbers)}]"


def _not_found(argument: str, expected: str, received: str, index: tuple[int, ...], reason: str) -> ArgumentError:
    """Return the error about a member of a batch that has no physical solution, `()` for a single one."""
    where = f" at batch index {index}" if index else ""
    sentence = f"{reason[0].upper()}{reason[1:]}{'' if reason.endswith(('.', '?')) else '.'}"
    cause = f"{sentence} Pass a closed q as near: the solution on the path from there need not be physical."
    return ArgumentError(argument, expected, f"{received}{where}", cause)
