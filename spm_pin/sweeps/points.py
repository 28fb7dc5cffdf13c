"""The state of the machine at N points of a sweep, computed once for all metrics."""

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
from spm_pin.kinematics.rates_and_forces import motion_rows
from spm_pin.kinematics.stage_displacement import normals_of_tilt
from spm_pin.machine import Configuration, LegLimits, Manipulator, SolutionSet, Stage, Status
from spm_pin.support.arguments import BoolArray, FloatArray, frozen

Space = Literal["pose", "tilt", "legs"]
"""The coordinates of points: poses of the platform, heights and tilts of that of a stage, or readings of the legs."""


class Poses(NamedTuple):
    """Rotations (M, 3, 3) and positions (M, 3) [m] of a manipulator's platform."""

    rotation: FloatArray
    translation: FloatArray

    def solved_by(self, function: Any, machine: Any) -> Any:
        """Return what a function of a machine and its pose, or its tilt and height, finds for these."""
        return function(machine, self)


class Tilts(NamedTuple):
    """Unit normals (M, 3) and heights (M,) [m] of a stage's platform."""

    normal: FloatArray
    height: FloatArray

    def solved_by(self, function: Any, machine: Any) -> Any:
        """Return what a function of a machine and its pose, or its tilt and height, finds for these."""
        return function(machine, self.height, normal=self.normal)


class Points:
    """N points of a sweep. Each property is computed when first used, and kept; all arrays are read-only.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine; its leg limits, if it has any, decide what is reachable.
    space : {"pose", "tilt", "legs"}
        Kind of the coordinates: "pose" for a manipulator, "tilt" for a stage, "legs" for both.
    coordinates : ndarray, shape (N, 6); for a stage (N, 3)
        x, y, z [m] and the X-Y-X angles [rad]; height [m], tilt and azimuth [rad]; or the readings of the legs [m]
        ([rad] for RRS legs).
    """

    def __init__(self, machine: Manipulator | Stage, space: Space, coordinates: FloatArray) -> None:
        self.machine = machine
        self.space = space
        self.coordinates = frozen(coordinates)
        self._singular_values: dict[float, FloatArray] = {}

    @classmethod
    def of_states(cls, states: Configuration) -> Points:
        """Return points at states (N,), whatever the limits of their machine and their assembly modes."""
        points = cls(states.machine, "legs", np.array(states.readings))
        points.limits, points.assembled = states.machine.legs.free_limits, states
        return points

    def __len__(self) -> int:
        return len(self.coordinates)

    @cached_property
    def limits(self) -> LegLimits:
        """The machine's leg limits; without any, limits that exclude nothing."""
        return self.machine.limits or self.machine.legs.free_limits

    @cached_property
    def status(self) -> npt.NDArray[np.int8]:
        """`Status` of the displacement problem of each point, shape (N,)."""
        if self.space != "legs":
            return self._branches[1]
        return frozen(np.where(self.assembled.exists, Status.OK, Status.UNREACHABLE).astype(np.int8))

    @cached_property
    def branch_readings(self) -> FloatArray:
        """Readings of the legs in all branches of the pose, shape (N, 8, 6), NaN where one is not real.

        For a stage the readings in the modes T and F of the tilt, (N, 2, 3).
        """
        return self._branches[0]

    @cached_property
    def branches_within(self) -> BoolArray:
        """Mask of the branches that are real and within the leg limits, shape (N, 8); for a stage (N, 2)."""
        return frozen(self.limits.contains(self.branch_readings))

    @cached_property
    def solutions(self) -> SolutionSet:
        """All branches of the pose, leg limits not applied, of shape (N,); for a stage the modes of the tilt.

        If points are readings, the pose is that of `assembled`; where it does not exist, no branch exists.
        """
        solutions = self._requests.solved_by(inverse_displacement, self.machine)
        if self.space != "legs":
            return solutions  # type: ignore[no-any-return]
        exists = self.assembled.exists
        branches = solutions.configurations.transformed(lambda values, _: _spread(values, exists))
        status = _spread(np.asarray(solutions.status), exists, Status.UNREACHABLE).astype(np.int8)
        return type(solutions)(branches, solutions.labels, status)  # type: ignore[no-any-return]

    @cached_property
    def physical(self) -> Configuration:
        """The physical configuration, shape (N,); NaN where it does not exist within the leg limits."""
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
        reachable, requests = np.asarray(self.branches_within.any(axis=-1)), self._requests
        some = type(requests)(*(values[reachable] for values in requests))
        states = some.solved_by(inverse_physical, self.machine)
        is_within = self.limits.contains(states.readings)
        reachable[reachable] = is_within
        return frozen(reachable), states[is_within]

    def spread(self, values: npt.ArrayLike, absent: float = np.nan) -> FloatArray:
        """Return values of the M `reached` points as an array of shape (N,), `absent` elsewhere."""
        return _spread(np.asarray(values), self.reachable, absent)

    @cached_property
    def sigma(self) -> FloatArray:
        """Smallest singular values of J_b, J_c and K at the M `reached` points, (M, 3); for a stage `sigma`, (M, 2)."""
        return frozen(singularities(self.reached).sigma)

    @cached_property
    def determinants(self) -> FloatArray:
        """Determinants of J_b, J_c, K over d³ at the M `reached` points, (M, 3); a stage has the first, (M, 1)."""
        values = determinants(self.reached)
        return frozen(values[:, : 1 if self.machine.is_stage else 3] / self.machine.ball_side**3)

    @cached_property
    def platform_jacobians(self) -> FloatArray:
        """G of the M `reached` points, (M, 6, legs), see `platform_jacobian`; NaN at a forward singularity."""
        return frozen(platform_jacobian(self.reached))

    def singular_values(self, length: float | None = None) -> FloatArray:
        """Return the singular values of G for the twist (v, Lω), L = `length` [m] or C, (M, 6), descending.

        NaN where G is. For a stage those for its motion (v_z, Lω_x, Lω_y), (M, 3). Rates of RRS legs are those of their
        knees [m/s].
        """
        length = self.machine.platform_radius if length is None else length
        if length not in self._singular_values:
            scales = np.repeat([1.0, length], 3)[:, None] / self.machine.legs.largest_slopes
            scaled = motion_rows(self.platform_jacobians * scales)
            self._singular_values[length] = frozen(singular_values(scaled))
        return self._singular_values[length]

    @cached_property
    def assembled(self) -> Configuration:
        """The physical configuration with readings that are the coordinates, limits aside, shape (N,)."""
        return forward_physical(self.machine, self.coordinates)

    @cached_property
    def _requests(self) -> Poses | Tilts:
        """All poses, or tilts; where points are readings, those of the physical configurations that exist."""
        if self.space == "pose":
            return Poses(_xyx_rotations(self.coordinates[:, 3:]), np.ascontiguousarray(self.coordinates[:, :3]))
        if self.space == "tilt":
            heights, tilts, azimuths = self.coordinates.T
            return Tilts(normals_of_tilt(tilts, azimuths), heights)
        assembled: Any = self.assembled[self.assembled.exists]
        if self.machine.is_stage:
            return Tilts(assembled.normal, assembled.height)
        return Poses(assembled.rotation, assembled.translation)

    @cached_property
    def _branches(self) -> tuple[FloatArray, npt.NDArray[np.int8]]:
        """Readings of all branches, shape (N, 8, 6), and the status of the M `_requests`."""
        if self.machine.legs.are_rps and isinstance(self.machine, Manipulator):
            lengths, status = branch_lengths(self.machine, self._requests)
            readings = lengths + self.machine.legs.offsets
        else:
            branches = self._requests.solved_by(inverse_displacement, self.machine)
            readings, status = np.array(branches.readings), np.array(branches.status, dtype=np.int8)
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
