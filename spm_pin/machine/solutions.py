"""Several solutions of one problem side by side: the branches of a pose, or the assembly modes of leg lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError
from spm_pin.machine.branch_of_state import BRANCHES, FAMILIES, branch_sign, family
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.legs import LEGS
from spm_pin.machine.machine import unit_hint
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.machine.solution_axis import Solutions, Status, following
from spm_pin.support import notebook
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    boolean_array,
    broadcastable,
    first_offender,
    real_array,
)
from spm_pin.support.pose import PoseLike, as_rigid_transform

_FAR_TURN = 45.0
"""Turns of the platform larger than this, which are rare, may be given in another unit of angles [degrees]."""


@dataclass(frozen=True)
class Degeneracy:
    """Description of the continuous families of solutions, if any."""

    dimension: npt.NDArray[np.int8]
    """Dimension of the family, shape (...); 0 if all solutions are isolated."""
    families: BoolArray
    """True for the continuous ones of TT, TF, FT, FF, shape (..., 4)."""
    legs: BoolArray
    """Legs whose lower and upper planes coincide, so that b_i is not restricted to a line, shape (..., 3)."""

    def __getitem__(self, index: tuple[Any, ...]) -> Degeneracy:
        """Index the batch axes; the last part of `index` is that of the last axis."""
        return Degeneracy(self.dimension[index[:-1]], self.families[index], self.legs[index])


@dataclass(frozen=True, eq=False, repr=False)
class SolutionSet(Solutions[Configuration]):
    """The solutions of one problem, or of a batch of problems, along one axis.

    Parameters
    ----------
    configurations : Configuration
        Batch of shape (..., n): the solutions, NaN where one is not real.
    labels : sequence of n str
        Names of the positions along the axis.
    status : array_like of Status, shape (...)
        Outcome of each problem; `Status` of a single problem, an int8 array of them for a batch.
    discriminants : ndarray, shape (..., 4), optional
        Discriminants of the families TT, TF, FT, FF, for inverse displacement: real iff not negative.
    certain : ndarray of bool, shape (..., 4), optional
        Families for which `exists` is proved: their discriminant is larger than the effect of all
        rounding. False for a continuous family, and where the Z axes of {B} and {m} are parallel to
        1e-12 rad.
    at_home : ndarray of bool, shape (..., n), optional
        True for solutions reached from the symmetric home without a forward singularity, without regard to leg limits;
        computed if not given.
    degeneracy : Degeneracy, optional
        Continuous families, legs and dimensions, where `status` is `Status.DEGENERATE`.
    merged : ndarray of bool, shape (..., n), optional
        For a calibrated machine: True if the tracked branch or mode of this label met another one while the errors grew
        from zero to those of the machine. It has vanished, or is a remaining root whose label is arbitrary.
    radius : ndarray, shape (..., n), optional
        Radius [m] around each middle joint within which the exact one is, NaN if not proved; exactly one solution
        has all three joints within it. Given if certification was requested.

    Notes
    -----
    A single problem is indexed by its solutions: ``solutions[0]``, ``solutions["TT+"]``. A batch is indexed as NumPy
    would index its batch axes: ``solutions[i]`` is the `SolutionSet` of problem i; a label picks that solution of every
    problem. An index that selects nothing raises `SelectionError`. A single problem is a
    sequence of the solutions of all labels, real or not: `exists` says which are real, and `count` how many.
    """

    discriminants: FloatArray | None = None
    certain: BoolArray | None = None
    degeneracy: Degeneracy | None = None
    merged: BoolArray | None = None
    radius: FloatArray | None = None

    _kind = Configuration

    @classmethod
    def from_unordered(
        cls, machine: Manipulator, pose: PoseLike, middle_joints: npt.ArrayLike, solved: npt.ArrayLike = True
    ) -> SolutionSet:
        """Make a set of real branches, given in any order, with the canonical labels.

        Parameters
        ----------
        machine : Manipulator
            The manipulator.
        pose : pose of shape (...)
            The pose that was solved.
        middle_joints : array_like, shape (..., n, 3, 3)
            Up to eight distinct solutions each [m] in {B}; unused places are NaN.
        solved : array_like of bool, shape (...)
            False where the method failed. There, and where a family has more than two solutions, the status is
            `Status.UNSOLVED` and all solutions are missing.
        """
        check_manipulator(machine)
        transform = as_rigid_transform(pose)
        joints = real_array(middle_joints, "middle_joints", (3, 3), "rows b_1, b_2, b_3", allow_nan=True)
        if joints.ndim < 3 or joints.shape[-3] == 0:
            raise ArgumentError("middle_joints", "shape (..., n, 3, 3) with n from 1", f"shape {joints.shape}")
        shape = broadcastable("middle_joints", joints.shape[:-3], "the pose", transform.shape)
        good = boolean_array(solved, "solved", shape)
        with np.errstate(over="ignore", invalid="ignore"):
            normal = np.cross(joints[..., 0, :] - joints[..., 2, :], joints[..., 1, :] - joints[..., 2, :])
        size = np.abs(normal).max(axis=-1) / machine.middle_side**2
        if (wrong := (size < 1e-9) | (size > 1e9)).any():
            index = first_offender(wrong)
            cause = f"They are corners of the middle platform, {machine.middle_side:g} m apart"
            received = f"{joints[index].tolist()} at index {index}"
            raise ArgumentError("middle_joints", "three points that are not in a line", received, cause)
        branches, status = _in_canonical_order(machine, transform, joints, good)
        return cls(branches, BRANCHES, status)

    @property
    def middle_joints(self) -> FloatArray:
        """Ball joint centres b_1, b_2, b_3 as rows in {B} [m], shape (..., n, 3, 3); NaN where not real."""
        return self.configurations.middle_joints

    @property
    def leg_lengths(self) -> FloatArray:
        """r_b1 to r_c3 [m], shape (..., n, 6); NaN where not real."""
        return self.configurations.leg_lengths

    def _repr_html_(self) -> str:
        if self.shape:
            tally = [(str(status), np.count_nonzero(self.status == status)) for status in Status]
            return notebook.table(repr(self), ("status", "problems"), [(name, f"{count:,}") for name, count in tally])
        places = np.flatnonzero(self.exists)[: notebook.MOST_ROWS]
        names = {int(k): self.labels[k] + ", physical" * bool(self.is_physical[k]) for k in places}
        if self.labels == BRANCHES:
            header = ("branch", *(f"{leg} [m]" for leg in LEGS))
            rows = [[names[k], *(f"{length:.4f}" for length in self.readings[k])] for k in names]
        else:  # assembly modes have the same leg lengths and differ in their pose
            header = ("mode", "x [m]", "y [m]", "z [m]", "roll [°]", "pitch [°]", "yaw [°]")
            angles = self.configurations[places].pose.rotation.as_euler("xyz", degrees=True)
            rows = [
                [name, *(f"{x:.4f}" for x in self.translation[k]), *(f"{angle:.2f}" for angle in turn)]
                for (k, name), turn in zip(names.items(), angles, strict=True)
            ]
        if self.count > len(rows):
            rows.append([f"and {self.count - len(rows)} more"])
        return notebook.table(repr(self), header, rows)

    def where(self, mask: npt.ArrayLike) -> SolutionSet:
        """Keep the solutions where the booleans `mask` (..., n) are true; the others become NaN."""
        kept = super().where(mask)
        radius = None if self.radius is None else np.where(kept.exists, self.radius, np.nan)
        return replace(kept, radius=radius)

    def _degenerate(self, index: tuple[int, ...]) -> str:
        if self.labels == BRANCHES and self.degeneracy is not None and self.degeneracy.legs[index].all():
            return (
                "a level platform over the axis of the base is singular for the inverse, its solutions are a "
                "continuous family. Give leg lengths to forward_physical instead; or tilt the pose, which makes "
                "the solutions isolated, and choose with .nearest(near)"
            )
        return "the pose or the leg lengths are singular: the solutions are a continuous family; see .degeneracy"

    def _hint(self, index: tuple[int, ...]) -> str:
        reasons = [self.configurations.missing_reason or unit_hint(self.machine, self.translation[index][0])]
        if self.labels == BRANCHES:
            turn = np.degrees(np.arccos(np.clip((np.trace(self.rotation[index][0]) - 1.0) / 2.0, -1.0, 1.0)))
            if turn > _FAR_TURN:
                reasons.append(f"The platform is turned by {turn:.0f}° relative to the base: angles are in radians")
            reasons.append("For the nearest pose that is reached see spm_pin.workspace.nearest_reachable_pose")
        return following(reasons)


def _in_canonical_order(
    machine: Manipulator, pose: RigidTransform, joints: FloatArray, solved: BoolArray
) -> tuple[Configuration, npt.NDArray[np.int8]]:
    """Return branches (..., 8) in the order of `BRANCHES`, and the status (...)."""
    matrix = pose.as_matrix()[..., None, :, :]
    unordered = Configuration(machine, matrix, joints)
    signs = branch_sign(unordered)[..., None, :]
    member = family(unordered)[..., None, :] == np.arange(len(FAMILIES))[:, None]
    count = member.sum(axis=-1)
    good = solved & (count <= 2).all(axis=-1)
    top, bottom = np.where(member, signs, -np.inf).argmax(axis=-1), np.where(member, signs, np.inf).argmin(axis=-1)
    # Two members are distinguished by their order, which is right even if rounding hides a sign.
    upper = np.take_along_axis(signs, top[..., None], axis=-1)[..., 0] >= 0.0
    present = np.stack([(count == 2) | ((count == 1) & upper), (count == 2) | ((count == 1) & ~upper)], axis=-1)
    present &= good[..., None, None]
    places = np.stack([top, bottom], axis=-1).reshape(*good.shape, len(BRANCHES), 1, 1)
    ordered = np.take_along_axis(unordered.middle_joints, places, axis=-3)
    branches = Configuration(machine, matrix, np.where(present.reshape(places.shape), ordered, np.nan))
    reached = np.where(branches.exists.any(axis=-1), Status.OK, Status.UNREACHABLE)
    return branches, np.where(good, reached, Status.UNSOLVED)
