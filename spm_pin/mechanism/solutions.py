"""Several solutions of one problem side by side: the branches of a pose, or the assembly modes of leg lengths."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError, NotOneSolutionError, SelectionError
from spm_pin.mechanism import notebook
from spm_pin.mechanism.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    boolean_array,
    broadcastable,
    check_instance,
    first_offender,
    real_array,
    type_and_value,
)
from spm_pin.mechanism.branch_of_state import BRANCHES, FAMILIES, branch_sign, family, physical, tilt_cosine_sum
from spm_pin.mechanism.configuration import Configuration, batch_index, compared_points
from spm_pin.mechanism.geometry import Geometry, unit_hint
from spm_pin.mechanism.legs import LEGS, LegLimits
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform


class Status(enum.IntEnum):
    """Outcome of one problem."""

    OK = 0
    """At least one real solution, and all solutions are isolated."""
    UNREACHABLE = 1
    """No real solution."""
    DEGENERATE = 2
    """Some solutions form a continuous family, of which none is picked; those of the other families are kept."""
    UNSOLVED = 3
    """The method failed: nothing is known about the problem."""

    def __str__(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Degeneracy:
    """Description of the continuous families of solutions, where there are any."""

    dimension: npt.NDArray[np.int8]
    """Dimension of the family, shape (...); 0 where all solutions are isolated."""
    families: BoolArray
    """True for those of TT, TF, FT, FF that are continuous, shape (..., 4)."""
    legs: BoolArray
    """Legs whose lower and upper plane coincide, so that b_i is bound to no line, shape (..., 3)."""

    def __getitem__(self, batch: tuple[Any, ...]) -> Degeneracy:
        inner = (*batch, slice(None))
        return Degeneracy(self.dimension[batch], self.families[inner], self.legs[inner])


@dataclass(frozen=True, eq=False, repr=False)
class SolutionSet:
    """The solutions of one problem, or of a batch of problems, along one axis.

    Parameters
    ----------
    configurations : Configuration
        Batch of shape (..., n): the solutions, NaN where one is not real.
    labels : sequence of n str
        Names of the places along the axis.
    status : array_like of Status, shape (...)
        Outcome of each problem; `Status` of a single problem, an int8 array of them for a batch.
    discriminants : ndarray, shape (..., 4), optional
        Of the families TT, TF, FT, FF, for inverse displacement: real iff not negative.
    certain : ndarray of bool, shape (..., 4), optional
        Families that are proved to be real, or not, as `exists` says: their discriminant is larger than all that
        rounding can have changed. False for a continuous family, and where the Z axes of {B} and {m} are parallel to
        1e-12 rad.
    at_home : ndarray of bool, shape (..., n), optional
        True for solutions reached from the symmetric home without a forward singularity, leg limits aside; looked for
        if not given.
    degeneracy : Degeneracy, optional
        Which families, legs and how many dimensions, where `status` is `Status.DEGENERATE`.
    merged : ndarray of bool, shape (..., n), optional
        For a machine as built: True where the branch or mode of this label met another while the errors grew from zero
        to those of the machine. It has ended, or is a root left over, whose label is a name only.
    radius : ndarray, shape (..., n), optional
        Radius [m] around each middle joint within which the exact one is, NaN where not proved; exactly one solution
        has all three joints within it. Given if the solver was asked to certify.

    Notes
    -----
    A single problem is indexed by its solutions: ``solutions[0]``, ``solutions["TT+"]``. A batch is indexed as NumPy
    would index its batch axes: ``solutions[i]`` is the `SolutionSet` of problem i; a label picks that solution of every
    problem. What selects nothing is a `SelectionError`. Iterating over a single problem yields the solutions that
    exist.
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

    def __post_init__(self) -> None:
        shape = check_instance(self.configurations, Configuration, "configurations").shape
        count = len(self.labels)
        if not shape or shape[-1] != count:
            raise ArgumentError("configurations", f"a last axis of {count}, one per label", f"shape {shape}")
        status = np.broadcast_to(np.asarray(self.status, dtype=np.int8), shape[:-1])
        object.__setattr__(self, "labels", tuple(self.labels))
        object.__setattr__(self, "status", status if self.shape else Status(int(status)))

    @classmethod
    def from_unordered(
        cls, geometry: Geometry, pose: PoseLike, middle_joints: npt.ArrayLike, solved: npt.ArrayLike = True
    ) -> SolutionSet:
        """Make a set of real branches, in any order, under the canonical labels.

        Parameters
        ----------
        geometry : Geometry
            The manipulator.
        pose : pose of shape (...)
            The pose that was solved.
        middle_joints : array_like, shape (..., n, 3, 3)
            Up to eight distinct solutions each [m] in {B}, NaN in places not used.
        solved : array_like of bool, shape (...)
            False where the method failed. There, and where a family has more than two solutions, the status is
            `Status.UNSOLVED` and nothing exists.
        """
        check_instance(geometry, Geometry, "geometry")
        transform = as_rigid_transform(pose)
        joints = real_array(middle_joints, "middle_joints", (3, 3), "rows b_1, b_2, b_3", allow_nan=True)
        if joints.ndim < 3 or joints.shape[-3] == 0:
            raise ArgumentError("middle_joints", "shape (..., n, 3, 3) with n from 1", f"shape {joints.shape}")
        shape = broadcastable("middle_joints", joints.shape[:-3], "the pose", transform.shape)
        good = boolean_array(solved, "solved", shape)
        with np.errstate(over="ignore", invalid="ignore"):
            normal = np.cross(joints[..., 0, :] - joints[..., 2, :], joints[..., 1, :] - joints[..., 2, :])
        size = np.abs(normal).max(axis=-1) / geometry.middle_side**2
        if (wrong := (size < 1e-9) | (size > 1e9)).any():
            index = first_offender(wrong)
            cause = f"They are the corners of the middle platform, {geometry.middle_side:g} m from each other."
            received = f"{joints[index].tolist()} at index {index}"
            raise ArgumentError("middle_joints", "three points that are not in a line", received, cause)
        branches, status = _in_canonical_order(geometry, transform, joints, good)
        return cls(branches, BRANCHES, status)

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape, without the axis of solutions."""
        return self.configurations.shape[:-1]

    @property
    def geometry(self) -> Geometry:
        """The manipulator."""
        return self.configurations.geometry

    @property
    def exists(self) -> BoolArray:
        """True for the solutions that are real, shape (..., n)."""
        return self.configurations.exists

    @property
    def rotation(self) -> FloatArray:
        """Rotations from {m} to {B}, shape (..., n, 3, 3)."""
        return self.configurations.rotation

    @property
    def translation(self) -> FloatArray:
        """Positions of o in {B} [m], shape (..., n, 3)."""
        return self.configurations.translation

    @property
    def middle_joints(self) -> FloatArray:
        """Ball joint centres b_1, b_2, b_3 as rows in {B} [m], shape (..., n, 3, 3); NaN where not real."""
        return self.configurations.middle_joints

    @property
    def leg_lengths(self) -> FloatArray:
        """r_b1 to r_c3 [m], shape (..., n, 6); NaN where not real."""
        return self.configurations.leg_lengths

    @property
    def readings(self) -> FloatArray:
        """Readings of the legs' encoders [m], shape (..., n, 6)."""
        return self.configurations.readings

    @property
    def residual(self) -> FloatArray:
        """Closure residual of each solution [m], shape (..., n)."""
        return self.configurations.closure_residual

    @property
    def count(self) -> IntArray:
        """Number of real solutions, shape (...)."""
        return np.asarray(np.count_nonzero(self.exists, axis=-1), dtype=np.intp)

    @overload
    def __getitem__(self, index: str) -> Configuration: ...
    @overload
    def __getitem__(self, index: Any) -> Configuration | SolutionSet: ...
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
        values: dict[str, Any] = {"status": np.asarray(self.status)[index]}
        if self.degeneracy is not None:
            values["degeneracy"] = self.degeneracy[batch]
        for name in ("discriminants", "certain", "at_home", "merged", "radius"):
            array = getattr(self, name)
            values[name] = None if array is None else array[inner]
        return replace(self, configurations=chosen, **values)

    def __iter__(self) -> Iterator[Configuration]:
        if self.shape:
            raise TypeError("a batch of problems is indexed, not iterated over: solutions[i] is problem i")
        return (self.configurations[int(i)] for i in np.flatnonzero(self.exists))

    def __repr__(self) -> str:
        if self.shape:
            tally = ", ".join(f"{np.count_nonzero(self.status == s)} {s}" for s in Status)
            return f"<SolutionSet: {self.shape} problems ({tally}), {len(self.labels)} solutions each>"
        real = [label for label, real in zip(self.labels, self.exists, strict=True) if real]
        shown = (", ".join(real[:8]) + ", …" * (len(real) > 8)) or "none"
        hint = _hint(self, ()) if self.status is Status.UNREACHABLE else ""
        return f"<SolutionSet: {self.status}, {self.count} of {len(self.labels)} real: {shown}{hint}>"

    def _repr_html_(self) -> str:
        if self.shape:
            tally = [(str(status), np.count_nonzero(self.status == status)) for status in Status]
            return notebook.table(repr(self), ("status", "problems"), [(name, f"{count:,}") for name, count in tally])
        places = np.flatnonzero(self.exists)[: notebook.MOST_ROWS]
        names = {int(k): self.labels[k] + ", physical" * bool(self.is_physical[k]) for k in places}
        if self.labels == BRANCHES:
            header = ("branch", *(f"{leg} [m]" for leg in LEGS))
            rows = [[names[k], *(f"{length:.4f}" for length in self.readings[k])] for k in names]
        else:  # assembly modes: they share their leg lengths and differ in their pose
            header = ("mode", "x [m]", "y [m]", "z [m]", "roll [°]", "pitch [°]", "yaw [°]")
            angles = self.configurations[places].pose.rotation.as_euler("xyz", degrees=True)
            rows = [
                [name, *(f"{x:.4f}" for x in self.translation[k]), *(f"{angle:.2f}" for angle in turn)]
                for (k, name), turn in zip(names.items(), angles, strict=True)
            ]
        if self.count > len(rows):
            rows.append([f"and {self.count - len(rows)} more"])
        legs = self.configurations
        pictures = "".join(notebook.stick_figure(legs.leg_bases[k], legs.balls[k], names[k]) for k in list(names)[:8])
        return notebook.table(repr(self), header, rows, pictures)

    def pick(self, index: IntArray, exists: BoolArray) -> Configuration:
        """Return the solution of each problem at `index` (...); NaN, the pose too, where `exists` (...) is False."""
        everywhere = bool(exists.all())
        # For a single problem a slice, so that nothing shares memory with the others.
        places = (*np.indices(index.shape, sparse=True), index) if self.shape else (slice(index, index + 1),)

        def take(array: FloatArray, inner: int) -> FloatArray:
            values = array[places].reshape(*self.shape, *array.shape[-inner:])
            if everywhere and self.shape:
                return values
            return np.where(exists.reshape(*self.shape, *(1,) * inner), values, np.nan)

        selected = self.configurations.transformed(take)
        if not self.shape and not exists:
            selected.missing_reason = _reason_for_none(self)
        return selected

    def where(self, mask: npt.ArrayLike) -> SolutionSet:
        """Keep the solutions where the booleans `mask` (..., n) are true; the others become NaN."""
        state, kept = self.configurations, boolean_array(mask, "mask", self.exists.shape)[..., None]
        joints = np.where(kept[..., None], state.middle_joints, np.nan)
        lengths = None if state.known_lengths is None else np.where(kept, state.known_lengths, np.nan)
        left = Configuration.from_arrays(self.geometry, state.rotation, state.translation, joints, lengths)
        radius = None if self.radius is None else np.where(kept[..., 0], self.radius, np.nan)
        return replace(self, configurations=left, radius=radius)

    def within(self, limits: LegLimits | None = None) -> SolutionSet:
        """Keep the solutions inside leg limits, by default the geometry's own; `status` stays as it is."""
        limits = self.geometry.limits if limits is None else check_instance(limits, LegLimits, "limits")
        return self if limits is None else self.where(limits.contains(self.readings))

    def nearest(self, near: Configuration | npt.ArrayLike) -> Configuration:
        """Return the solution whose joints are nearest to those of `near`; NaN where none exists.

        The largest displacement of a joint is compared: of the b_i and the c_i of a `Configuration`, or of the b_i if
        only these are given, as rows (..., 3, 3) [m].
        """
        state = self.configurations
        if isinstance(near, Configuration):
            points, target = compared_points(state), compared_points(near)
        else:
            points = state.middle_joints
            target = real_array(near, "near", (3, 3), "a Configuration, or rows b_1, b_2, b_3 in metres")
        absent = np.isnan(target).any(axis=(-1, -2))
        if absent.any():
            raise ArgumentError("near", "states that exist", f"NaN at index {first_offender(absent)}")
        boolean_array(absent, "near", self.shape)  # leading axes that broadcast to those of the problems
        distance = np.sqrt(((points - target[..., None, :, :]) ** 2).sum(axis=-1)).max(axis=-1)
        distance = np.where(self.exists, distance, np.inf)
        return self.pick(distance.argmin(axis=-1), np.asarray(self.exists.any(axis=-1)))

    @property
    def is_physical(self) -> BoolArray:
        """True for solutions reached from the symmetric home without a forward singularity, shape (..., n).

        If several are, and some respect the geometry's limits, the others are dropped; chain ``.within().physical()``
        to exclude all that do not.
        """
        mode = physical(self.configurations) if self.at_home is None else self.at_home & self.exists
        limits = self.geometry.limits
        if limits is None:
            return mode
        # Of branches the first two as a rule: readings of the others are not computed.
        some = slice(int(np.flatnonzero(mode.reshape(-1, len(self.labels)).any(axis=0))[-1:].sum()) + 1)
        inside = mode.copy()
        inside[..., some] &= limits.contains(self.configurations[..., some].readings)
        return np.where(inside.any(axis=-1, keepdims=True), inside, mode)

    @property
    def ambiguous(self) -> Any:
        """True if several solutions of a problem are physical, shape (...); `physical` then takes one."""
        several = np.count_nonzero(self.is_physical, axis=-1) > 1
        return several if self.shape else bool(several)

    def physical(self, near: Configuration | npt.ArrayLike | None = None) -> Configuration:
        """Return the physical solution; NaN where there is none.

        Of those in `is_physical`, the nearest to `near` if it is given. Without it two may be left, on
        either side of an inverse singularity: the one whose stages are tilted least, and `ambiguous` is true.
        """
        candidates = self.is_physical
        if near is not None:
            return self.where(candidates).nearest(near)
        score = np.where(candidates, 0.0, -np.inf)
        several = candidates & (np.count_nonzero(candidates, axis=-1, keepdims=True) > 1)
        if several.any():
            score[several] = tilt_cosine_sum(self.configurations[several])
        return self.pick(score.argmax(axis=-1), np.asarray(candidates.any(axis=-1)))

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
            raise NotOneSolutionError(labels, index, "" if labels else _reason_for_none(self, index))
        return self.pick(self.exists.argmax(axis=-1), np.ones(self.shape, dtype=bool))


def _reason_for_none(solutions: SolutionSet, index: tuple[int, ...] = ()) -> str:
    """Return the reason why no solution of a problem can be chosen."""
    status, degeneracy = Status(int(np.asarray(solutions.status)[index])), solutions.degeneracy
    if status is Status.DEGENERATE:
        if solutions.labels == BRANCHES and degeneracy is not None and degeneracy.legs[index].all():
            return (
                "a level platform over the axis of the base is singular for the inverse, its solutions are a "
                "continuous family. Give leg lengths to forward_physical instead; or tilt the pose, which makes "
                "the solutions isolated, and choose with .nearest(near)"
            )
        return "the pose or the leg lengths are singular, the solutions are a continuous family; see .degeneracy"
    if status is Status.OK:
        return "none of the solutions is physical, or .within(limits) and .where(mask) excluded them"
    if status is Status.UNREACHABLE:
        return f"out of reach: no solution is real{_hint(solutions, index)}"
    return "the method failed here"


def _hint(solutions: SolutionSet, index: tuple[int, ...]) -> str:
    """Return the likely unit of an unreachable problem's lengths, as a sentence after a stop; empty if none."""
    hint = solutions.configurations.missing_reason or unit_hint(solutions.geometry, solutions.translation[index][0])
    return hint and f". {hint}"


def _in_canonical_order(
    geometry: Geometry, pose: RigidTransform, joints: FloatArray, solved: BoolArray
) -> tuple[Configuration, npt.NDArray[np.int8]]:
    """Return branches (..., 8) in the order of `BRANCHES`, and the status (...)."""
    matrix = pose.as_matrix()[..., None, :, :]
    unordered = Configuration(geometry, matrix, joints)
    signs = branch_sign(unordered)[..., None, :]
    member = family(unordered)[..., None, :] == np.arange(len(FAMILIES))[:, None]
    count = member.sum(axis=-1)
    good = solved & (count <= 2).all(axis=-1)
    top, bottom = np.where(member, signs, -np.inf).argmax(axis=-1), np.where(member, signs, np.inf).argmin(axis=-1)
    # Two members are distinguished by their order, which is right also where rounding hides a sign.
    upper = np.take_along_axis(signs, top[..., None], axis=-1)[..., 0] >= 0.0
    present = np.stack([(count == 2) | ((count == 1) & upper), (count == 2) | ((count == 1) & ~upper)], axis=-1)
    present &= good[..., None, None]
    places = np.stack([top, bottom], axis=-1).reshape(*good.shape, len(BRANCHES), 1, 1)
    ordered = np.take_along_axis(unordered.middle_joints, places, axis=-3)
    branches = Configuration(geometry, matrix, np.where(present.reshape(places.shape), ordered, np.nan))
    reached = np.where(branches.exists.any(axis=-1), Status.OK, Status.UNREACHABLE)
    return branches, np.where(good, reached, Status.UNSOLVED)
