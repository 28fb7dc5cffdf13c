"""The state of the mechanism at N points of a sweep, computed once for all metrics."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics import (
    branch_lengths,
    determinants,
    forward_physical,
    inverse_displacement,
    inverse_physical,
    platform_jacobian,
    singular_values,
    singularities,
)
from spm_pin.machine import BRANCHES, Configuration, LegLimits, Manipulator, SolutionSet, Status
from spm_pin.support.arguments import BoolArray, FloatArray, frozen

Space = Literal["pose", "legs"]
"""The coordinates of points: poses of the platform, or six leg lengths."""


class _Poses(NamedTuple):
    """Rotations (M, 3, 3) and positions (M, 3) [m]."""

    rotation: FloatArray
    translation: FloatArray


class Points:
    """N points of a sweep. Each property is computed when first used, and kept; all arrays are read-only.

    Parameters
    ----------
    machine : Manipulator
        The manipulator; its leg limits, if it has any, decide what is reachable.
    space : {"pose", "legs"}
        Kind of the coordinates.
    coordinates : ndarray, shape (N, 6)
        x, y, z [m] and the X-Y-X angles [rad], or the readings of the legs [m], for RRS legs [rad].
    """

    def __init__(self, machine: Manipulator, space: Space, coordinates: FloatArray) -> None:
        self.machine = machine
        self.space = space
        self.coordinates = frozen(coordinates)
        self._singular_values: dict[float, FloatArray] = {}

    def __len__(self) -> int:
        return len(self.coordinates)

    @cached_property
    def limits(self) -> LegLimits:
        """The machine's leg limits; without any, limits that exclude nothing."""
        return self.machine.limits or self.machine.legs.free_limits

    @cached_property
    def status(self) -> npt.NDArray[np.int8]:
        """`Status` of the displacement problem of each point, shape (N,)."""
        if self.space == "pose":
            return self._branches[1]
        return frozen(np.where(self.assembled.exists, Status.OK, Status.UNREACHABLE).astype(np.int8))

    @cached_property
    def branch_readings(self) -> FloatArray:
        """Readings of the legs in all branches of the pose, shape (N, 8, 6), NaN where one is not real."""
        return self._branches[0]

    @cached_property
    def branches_within(self) -> BoolArray:
        """True for branches that are real and within the leg limits, shape (N, 8)."""
        return frozen(self.limits.contains(self.branch_readings))

    @cached_property
    def solutions(self) -> SolutionSet:
        """All branches of the pose, leg limits aside, a `SolutionSet` of shape (N,).

        Where points are leg lengths, of the pose of `assembled`; no branch exists where that does not.
        """
        if self.space == "pose":
            return inverse_displacement(self.machine, self._poses)
        exists, solutions = self.assembled.exists, inverse_displacement(self.machine, self._poses)
        branches = solutions.configurations.transformed(lambda values, _: _spread(values, exists))
        status = _spread(np.asarray(solutions.status), exists, Status.UNREACHABLE).astype(np.int8)
        return SolutionSet(branches, BRANCHES, status)

    @cached_property
    def physical(self) -> Configuration:
        """The physical configuration, shape (N,); NaN if missing within the leg limits."""
        return self.reached.transformed(lambda values, _: _spread(values, self.reachable))

    @property
    def reachable(self) -> BoolArray:
        """True if `physical` exists, shape (N,)."""
        return self._reached[0]

    @property
    def reached(self) -> Configuration:
        """The M members of `physical` that exist."""
        return self._reached[1]

    @cached_property
    def _reached(self) -> tuple[BoolArray, Configuration]:
        if self.space == "legs":
            reachable = self.limits.contains(self.coordinates) & self.assembled.exists
            return frozen(reachable), self.assembled[reachable]
        # Most points of a box have no branch within the limits: the others alone are solved for the joints.
        reachable = np.asarray(self.branches_within.any(axis=-1))
        states = inverse_physical(self.machine, _Poses(*(values[reachable] for values in self._poses)))
        is_within = self.limits.contains(states.readings)
        reachable[reachable] = is_within
        return frozen(reachable), states[is_within]

    def spread(self, values: npt.ArrayLike, absent: float = np.nan) -> FloatArray:
        """Return values of the M `reached` points as an array of shape (N,), `absent` elsewhere."""
        return _spread(np.asarray(values), self.reachable, absent)

    @cached_property
    def sigma(self) -> FloatArray:
        """Smallest singular values of J_b, J_c and K of the M `reached` points, shape (M, 3)."""
        return frozen(singularities(self.reached).sigma)

    @cached_property
    def determinants(self) -> FloatArray:
        """Values of det J_b, det J_c and det K over d³ at the M `reached` points, shape (M, 3)."""
        return frozen(determinants(self.reached) / self.machine.middle_side**3)

    @cached_property
    def platform_jacobians(self) -> FloatArray:
        """G of the M `reached` points, shape (M, 6, 6), see `platform_jacobian`; NaN at a forward singularity."""
        return frozen(platform_jacobian(self.reached))

    def singular_values(self, length: float | None = None) -> FloatArray:
        """Return those of G for the twist (v, Lω), L = `length` [m] or C, shape (M, 6), falling; NaN as G is.

        Rates of RRS legs are those of their knees [m/s].
        """
        length = self.machine.platform_radius if length is None else length
        if length not in self._singular_values:
            scales = np.repeat([1.0, length], 3)[:, None] / self.machine.legs.largest_slopes
            scaled = self.platform_jacobians * scales
            self._singular_values[length] = frozen(singular_values(scaled))
        return self._singular_values[length]

    @cached_property
    def assembled(self) -> Configuration:
        """The physical configuration with readings that are the coordinates, limits aside, shape (N,)."""
        return forward_physical(self.machine, self.coordinates)

    @cached_property
    def _poses(self) -> _Poses:
        """All poses; where points are leg lengths, those of the physical configurations that exist."""
        if self.space == "pose":
            return _Poses(_xyx_rotations(self.coordinates[:, 3:]), np.ascontiguousarray(self.coordinates[:, :3]))
        assembled = self.assembled[self.assembled.exists]
        return _Poses(assembled.rotation, assembled.translation)

    @cached_property
    def _branches(self) -> tuple[FloatArray, npt.NDArray[np.int8]]:
        """Readings of all branches, shape (N, 8, 6), and the status of the M `_poses`."""
        if self.machine.legs.are_rps:
            lengths, status = branch_lengths(self.machine, self._poses)
            readings = lengths + self.machine.legs.offsets
        else:
            branches = inverse_displacement(self.machine, self._poses)
            readings, status = np.array(branches.readings), np.array(branches.status)
        if self.space == "legs":
            readings = _spread(readings, self.assembled.exists)
        return frozen(readings), frozen(status)


def _xyx_rotations(angles: FloatArray) -> FloatArray:
    """Return the rotations Rx(α) Ry(β) Rx(λ), shape (N, 3, 3), of angles (N, 3) [rad].

    As `spm_pin.pose`, to rounding, in a tenth of the time of SciPy's Euler angles.
    """
    (a, b, c), (sa, sb, sc) = np.cos(angles.T), np.sin(angles.T)
    rotations = np.empty((len(angles), 3, 3))
    rotations[:, 0, 0], rotations[:, 0, 1], rotations[:, 0, 2] = b, sb * sc, sb * c
    rotations[:, 1, 0], rotations[:, 1, 1], rotations[:, 1, 2] = sa * sb, a * c - sa * b * sc, -a * sc - sa * b * c
    rotations[:, 2, 0], rotations[:, 2, 1], rotations[:, 2, 2] = -a * sb, sa * c + a * b * sc, a * b * c - sa * sc
    return rotations


def _spread(values: npt.NDArray[Any], mask: BoolArray, absent: float = np.nan) -> FloatArray:
    """Return an array with `values` (M, ...) where `mask` (N,) is true, `absent` elsewhere."""
    spread = np.full((len(mask), *values.shape[1:]), absent)
    spread[mask] = values
    return spread
