"""Several solutions of one problem, or of a batch of problems, along one axis: branches of a pose, assembly modes."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self, overload

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError, NotOneSolutionError, SelectionError
from spm_pin.machine.branch_of_state import BRANCHES, FAMILIES, branch_sign, family
from spm_pin.machine.configuration import Configuration, batch_index, check_configuration
from spm_pin.machine.legs import LegLimits
from spm_pin.machine.machine import unit_hint
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.support import notebook
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    boolean_array,
    broadcastable,
    first_offender,
    real_array,
    type_and_value,
)
from spm_pin.support.pose import PoseLike, as_rigid_transform

_NEAREST, _REACHED = "For the nearest", "that is reached see spm_pin.workspace.nearest_reachable_pose"
_FAR_TURN = 45.0
"""Turns of the platform larger than this, which are rare, may be given in another unit of angles [degrees]."""


OPERATION_MODES = ("T", "F")
"""The two solutions of an inverse displacement of a stage: without torsion, and with half a turn of torsion."""
BELOW = "The height is negative: below the pivots"
"""A cause for a missing physical state of a stage."""


class Status(enum.IntEnum):
    """Outcome of one problem."""

    OK = 0
    """At least one real solution, and all solutions are isolated."""
    UNREACHABLE = 1
    """No real solution."""
    DEGENERATE = 2
    """Some solutions form a continuous family and are omitted; those of the other families are kept."""
    UNSOLVED = 3
    """The method failed: nothing is known about the problem."""

    def __str__(self) -> str:
        return self.name.lower()


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
class SolutionSet:
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
    problem. An index that selects nothing raises `SelectionError`. A single problem is a sequence of the solutions of
    all labels, real or not: `exists` says which are real, and `count` how many.

    Labels are, for a manipulator, the eight branches of a pose, `BRANCHES`, or assembly modes, such as "T1+/F2-"; for a
    stage the `OPERATION_MODES` T, without torsion, and F, with a half turn, or the sixteen `STAGE_MODES`.
    """

    configurations: Configuration
    labels: tuple[str, ...]
    status: Status | npt.NDArray[np.int8]
    discriminants: FloatArray | None = None
    certain: BoolArray | None = None
    at_home: BoolArray | None = None
    degeneracy: Degeneracy | None = None
    merged: BoolArray | None = None
    radius: FloatArray | None = None
    _chosen: bool = field(default=False, kw_only=True)
    """True if a mask has excluded solutions."""

    def __post_init__(self) -> None:
        shape = check_configuration(self.configurations, "configurations").shape
        count = len(self.labels)
        if not shape or shape[-1] != count:
            raise ArgumentError("configurations", f"a last axis of {count}, one per label", f"shape {shape}")
        status = np.broadcast_to(np.asarray(self.status, dtype=np.int8), shape[:-1])
        object.__setattr__(self, "labels", tuple(self.labels))
        object.__setattr__(self, "status", status if self.shape else Status(int(status)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape, without the axis of solutions."""
        return self.configurations.shape[:-1]

    @property
    def machine(self) -> Any:
        """The `Manipulator` or the `Stage`."""
        return self.configurations.machine

    @property
    def exists(self) -> BoolArray:
        """True for the solutions that are real, shape (..., n)."""
        return self.configurations.exists

    @property
    def rotation(self) -> FloatArray:
        """Rotations of the platform in {B}, shape (..., n, 3, 3)."""
        return self.configurations.rotation

    @property
    def translation(self) -> FloatArray:
        """Positions of the platform's origin in {B} [m], shape (..., n, 3)."""
        return self.configurations.translation

    @property
    def readings(self) -> FloatArray:
        """Readings of the legs' encoders [m] ([rad] for RRS legs), shape (..., n, legs)."""
        return self.configurations.readings

    @property
    def residual(self) -> FloatArray:
        """Closure residual of each solution [m], shape (..., n)."""
        return self.configurations.closure_residual

    @property
    def count(self) -> IntArray:
        """Number of real solutions, shape (...); ``len`` is the number of labels."""
        return np.asarray(np.count_nonzero(self.exists, axis=-1), dtype=np.intp)

    @overload
    def __getitem__(self, index: str) -> Configuration: ...
    @overload
    def __getitem__(self, index: Any) -> Configuration | Self: ...
    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, str):
            if index not in self.labels:
                labels = ", ".join(self.labels[:8]) + ", …" * (len(self.labels) > 8)
                raise SelectionError("index", f"a label: {labels}", repr(index))
            return self.configurations[..., self.labels.index(index)]
        if not self.shape:
            return self.configurations[index]
        batch = batch_index(index)
        inner = (*batch, slice(None))
        try:
            chosen = self.configurations[inner]
        except SelectionError as error:
            expected = f"a label, or an index of the problems {self.shape}"
            raise SelectionError("index", expected, type_and_value(index), error.cause) from error
        details = {x.name: getattr(self, x.name) for x in fields(self) if x.default is None}
        details = {name: None if x is None else x[inner] for name, x in details.items()}
        return replace(self, configurations=chosen, status=np.asarray(self.status)[index], **details)

    def __iter__(self) -> Iterator[Configuration]:
        if self.shape:
            raise TypeError("a batch of problems is indexed, not iterated over: solutions[i] is problem i")
        return (self.configurations[k] for k in range(len(self.labels)))

    def __len__(self) -> int:
        """Return the number of labels, or for a batch the length of its first axis."""
        return self.shape[0] if self.shape else len(self.labels)

    def __repr__(self) -> str:
        name = type(self).__name__
        if self.shape:
            tally = ", ".join(f"{np.count_nonzero(self.status == s)} {s}" for s in Status)
            return f"<{name}: {self.shape} problems ({tally}), {len(self.labels)} solutions each>"
        real = [label for label, real in zip(self.labels, self.exists, strict=True) if real]
        shown = (", ".join(real[:8]) + ", …" * (len(real) > 8)) or "none"
        hint = self._hint(()) if self.status is Status.UNREACHABLE else ""
        return f"<{name}: {self.status}, {self.count} of {len(self.labels)} real: {shown}{hint}>"

    def pick(self, index: IntArray, exists: BoolArray) -> Configuration:
        """Return the solution of each problem at `index` (...); NaN, pose included, where `exists` (...) is False."""
        everywhere = bool(exists.all())
        # A slice for a single problem, so that nothing shares memory with the others.
        places = (*np.indices(index.shape, sparse=True), index) if self.shape else (slice(index, index + 1),)

        def take(array: FloatArray, inner: int) -> FloatArray:
            values = array[places].reshape(*self.shape, *array.shape[-inner:])
            if everywhere and self.shape:
                return values
            return np.where(exists.reshape(*self.shape, *(1,) * inner), values, np.nan)

        selected = self.configurations.transformed(take)
        if not self.shape and not exists:
            selected.missing_reason = self._reason_for_none()
        return selected

    def where(self, mask: npt.ArrayLike) -> Self:
        """Keep the solutions where the booleans `mask` (..., n) are true; the others become NaN."""
        kept = boolean_array(mask, "mask", self.exists.shape)
        chosen = self._chosen or bool((self.exists & ~kept).any())
        states = self.configurations.where(kept)
        radius = None if self.radius is None else np.where(states.exists, self.radius, np.nan)
        return replace(self, configurations=states, radius=radius, _chosen=chosen)

    def within(self, limits: LegLimits | None = None) -> Self:
        """Keep the solutions within limits of the legs, by default the machine's own; `status` does not change."""
        limits = self.configurations.limits if limits is None else self.machine.check_limits(limits)
        if limits is None:
            return self
        return self.where(limits.contains(self.readings))

    def nearest(self, near: Configuration | npt.ArrayLike) -> Configuration:
        """Return the solution whose joints are nearest to those of `near`; NaN if none exists.

        Solutions are compared by their largest displacement of a joint: of all `compared_points` of a state, or of the
        first three if only these are given, as rows (..., 3, 3) [m].
        """
        return self._nearest(near, self.exists)

    def _nearest(self, near: Configuration | npt.ArrayLike, candidates: BoolArray) -> Configuration:
        points = self.configurations.compared_points
        if isinstance(near, Configuration):
            target = check_configuration(near, "near", of=type(self.machine)).compared_points
        else:
            target = real_array(near, "near", (3, 3), "a state, or rows b_1, b_2, b_3 in metres")
        points = points[..., : target.shape[-2], :]
        absent = np.isnan(target).any(axis=(-1, -2))
        if absent.any():
            raise ArgumentError("near", "states that exist", f"NaN at index {first_offender(absent)}")
        boolean_array(absent, "near", self.shape)  # leading axes that broadcast to those of the problems
        distance = np.sqrt(((points - target[..., None, :, :]) ** 2).sum(axis=-1)).max(axis=-1)
        distance = np.where(candidates, distance, np.inf)
        return self.pick(distance.argmin(axis=-1), np.asarray(candidates.any(axis=-1)))

    @property
    def is_physical(self) -> BoolArray:
        """True for solutions reached from the symmetric home without a forward singularity, shape (..., n).

        If several are, and some are within the machine's limits, the others are dropped; use ``.within().physical()``
        to exclude all that are beyond them.
        """
        mode = self.configurations.is_at_home if self.at_home is None else self.at_home & self.exists
        limits = self.configurations.limits
        if limits is None or np.count_nonzero(mode) <= 1:
            return mode
        # Usually the first two branches suffice; readings of the others are then not computed.
        some = slice(int(np.flatnonzero(mode.reshape(-1, len(self.labels)).any(axis=0))[-1:].sum()) + 1)
        inside = mode.copy()
        inside[..., some] &= limits.contains(self.configurations[..., some].readings)
        return np.where(inside.any(axis=-1, keepdims=True), inside, mode)

    @property
    def ambiguous(self) -> Any:
        """True if several solutions of a problem are physical, shape (...); `physical` then chooses one."""
        several = np.count_nonzero(self.is_physical, axis=-1) > 1
        return several if self.shape else bool(several)

    def physical(self, near: Configuration | npt.ArrayLike | None = None) -> Configuration:
        """Return the physical solution; NaN if missing.

        From `is_physical` it chooses the nearest to `near` if given. Without `near`, two solutions on either side of an
        inverse singularity may remain: it then chooses the one with less tilted stages, and `ambiguous` is true.
        """
        candidates = self.is_physical
        if near is not None:
            return self._nearest(near, candidates)
        return self.pick(least_tilted(self.configurations, candidates), np.asarray(candidates.any(axis=-1)))

    def one(self) -> Configuration:
        """Return the only solution of every problem.

        Raises
        ------
        NotOneSolutionError
            If a problem has none or several.
        """
        wrong = self.count != 1
        if wrong.any():
            index = first_offender(wrong)
            labels = tuple(np.array(self.labels)[self.exists[index]])
            raise NotOneSolutionError(labels, index, "" if labels else self._reason_for_none(index))
        return self.pick(self.exists.argmax(axis=-1), np.ones(self.shape, dtype=bool))

    def _reason_for_none(self, index: tuple[int, ...] = ()) -> str:
        """Return the reason why no solution of a problem can be chosen."""
        status = Status(int(np.asarray(self.status)[index]))
        if status is Status.DEGENERATE:
            return self._degenerate(index)
        if status is Status.OK:
            if not self.count[index]:
                return f".within(limits) or .where(mask) excluded all solutions{self._hint(index)}"
            left = " left by .within(limits) or .where(mask)" if self._chosen else ""
            return f"none of the solutions{left} is physical{self._hint(index)}"
        if status is Status.UNREACHABLE:
            return f"out of reach: no solution is real{self._hint(index)}"
        return "the method failed here"

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
        return SolutionSet(branches, BRANCHES, status)

    @property
    def middle_joints(self) -> FloatArray:
        """Ball joint centres b_1, b_2, b_3 as rows in {B} [m], shape (..., n, 3, 3); NaN where not real."""
        return self.configurations.middle_joints

    @property
    def leg_lengths(self) -> FloatArray:
        """Distances of balls and pivots, r_b1 to r_c3 [m], shape (..., n, legs); NaN where not real."""
        return self.configurations.leg_lengths

    def _repr_html_(self) -> str:
        if self.shape:
            tally = [(str(status), np.count_nonzero(self.status == status)) for status in Status]
            return notebook.table(repr(self), ("status", "problems"), [(name, f"{count:,}") for name, count in tally])
        places = np.flatnonzero(self.exists)[: notebook.MOST_ROWS]
        names = {int(k): self.labels[k] + ", physical" * bool(self.is_physical[k]) for k in places}
        if self.labels in (BRANCHES, OPERATION_MODES):
            legs = self.machine.legs
            header = ("branch", *(f"{leg} [{unit}]" for leg, unit in zip(legs.names, legs.units, strict=True)))
            rows = [[names[k], *(f"{length:.4f}" for length in self.readings[k])] for k in names]
        else:  # assembly modes have the same readings and differ in their pose
            header = ("mode", "x [m]", "y [m]", "z [m]", "roll [°]", "pitch [°]", "yaw [°]")
            angles = self.configurations[places].pose.rotation.as_euler("xyz", degrees=True)
            rows = [
                [name, *(f"{x:.4f}" for x in self.translation[k]), *(f"{angle:.2f}" for angle in turn)]
                for (k, name), turn in zip(names.items(), angles, strict=True)
            ]
        if self.count > len(rows):
            rows.append([f"and {self.count - len(rows)} more"])
        return notebook.table(repr(self), header, rows)

    def _degenerate(self, index: tuple[int, ...]) -> str:
        if self.labels == BRANCHES and self.degeneracy is not None and self.degeneracy.legs[index].all():
            return (
                "a level platform over the axis of the base is singular for the inverse, its solutions are a "
                "continuous family. Give leg lengths to forward_physical instead; or tilt the pose, which makes "
                "the solutions isolated, and choose with .nearest(near)"
            )
        return "the pose or the leg lengths are singular: the solutions are a continuous family; see .degeneracy"

    def _hint(self, index: tuple[int, ...]) -> str:
        """Return sentences, each after a full stop, on why a problem has no solution and where one is; may be empty."""
        states = self.configurations
        reasons = [states.missing_reason]
        if self.machine.is_stage:
            if self.labels == OPERATION_MODES:
                below = (self.translation[index][..., 2] < 0.0).any() and not self.is_physical[index].any()
                reasons += [BELOW * bool(below), f"{_NEAREST} tilt {_REACHED}"]
            return _following(reasons)
        reasons[0] = reasons[0] or unit_hint(self.machine, self.translation[index][0])
        if self.labels == BRANCHES:
            turn = np.degrees(np.arccos(np.clip((np.trace(self.rotation[index][0]) - 1.0) / 2.0, -1.0, 1.0)))
            if turn > _FAR_TURN:
                reasons.append(f"The platform is turned by {turn:.0f}° relative to the base: angles are in radians")
            reasons.append(f"{_NEAREST} pose {_REACHED}")
        return _following(reasons)


def least_tilted(states: Configuration, candidates: BoolArray) -> IntArray:
    """Return the index (...) of the candidate (..., n) whose stages are least tilted, 0 if there is none."""
    if np.count_nonzero(candidates) <= 1:
        return np.asarray(candidates.argmax(axis=-1))
    score = np.where(candidates, 0.0, -np.inf)
    several = candidates & (np.count_nonzero(candidates, axis=-1, keepdims=True) > 1)
    if several.any():
        score[several] = states[several].tilt_cosine_sum
    return np.asarray(score.argmax(axis=-1))


def _following(sentences: Iterable[str]) -> str:
    """Return the sentences that are not empty, joined so that they follow another sentence."""
    text = ""
    for sentence in filter(None, sentences):
        text += f"{'' if text.endswith('?') else '.'} {sentence[0].upper()}{sentence[1:]}"
    return text


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
