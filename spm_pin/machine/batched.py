"""The base class of `Configuration` and `StageConfiguration`: the platform's pose, and indexing of batches."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, ClassVar, Self, TypeVar, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError, SelectionError
from spm_pin.machine.legs import LegLimits, triangle_sides
from spm_pin.machine.machine import Machine
from spm_pin.support import notebook
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, frozen, type_and_value
from spm_pin.support.pose import unchecked_transform

S = TypeVar("S", bound="Batched")


class Batched(ABC):
    """A state, or a batch of states, read-only."""

    missing_reason = ""
    """Why a single state does not exist, if known; otherwise empty."""
    _machine: Machine
    _solved: ClassVar[str]
    """Name of the property, one number for each leg, which a solver may have computed already."""

    _inner: ClassVar[tuple[int, ...]] = (2, 1)
    """Axes per member of the arrays: rotation and translation of the platform; then, of a manipulator, the joints."""

    def _set(self, machine: Machine, *arrays: FloatArray) -> None:
        """Store the machine and the arrays of `_inner`."""
        self._machine = machine
        self._arrays = tuple(map(frozen, arrays))
        self._rotation, self._translation = self._arrays[:2]

    @classmethod
    def from_arrays(cls, machine: Machine, *arrays: FloatArray | None) -> Self:
        """Make a state from valid arrays with equal leading axes, without checks or copies.

        They are the rotations (..., 3, 3) and the translations (..., 3) of the platform, for a manipulator the middle
        joints (..., 3, 3), and what a solver may have computed already: leg lengths (..., 6), for a stage its readings.
        """
        self = cls.__new__(cls)
        count = len(cls._inner)
        self._set(machine, *cast("tuple[FloatArray, ...]", arrays[:count]))
        if len(arrays) > count and arrays[count] is not None:
            self.__dict__[cls._solved] = frozen(cast("FloatArray", arrays[count]))
        return self

    @property
    def _known(self) -> FloatArray | None:
        """The value of the property named by `_solved`, if it has been computed already."""
        return self.__dict__.get(self._solved)

    def with_machine(self, machine: Machine) -> Self:
        """Return the same states of another machine, which has the same dimensions but perhaps other limits."""
        return self.from_arrays(check_instance(machine, type(self._machine), "machine"), *self._arrays)

    def transformed(self, change: Callable[[FloatArray, int], FloatArray]) -> Self:
        """Return the states with each array replaced by `change(array, number of inner axes)`."""
        solved = self._known
        arrays = (change(array, inner) for array, inner in zip(self._arrays, self._inner, strict=True))
        return self.from_arrays(self._machine, *arrays, None if solved is None else change(solved, 1))

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies and unpickled states are read-only too; derived values are not copied.
        state = self._machine, *self._arrays, self._known
        return self.from_arrays, state, {"missing_reason": self.missing_reason}

    @property
    def machine(self) -> Any:
        """The `Manipulator` or the `Stage`."""
        return self._machine

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape."""
        return self._translation.shape[:-1]

    @property
    @abstractmethod
    def exists(self) -> BoolArray:
        """False for a member of the batch that does not exist, shape (...)."""

    @property
    @abstractmethod
    def is_at_home(self) -> BoolArray:
        """True for physical states: reached from the home without a forward singularity, shape (...)."""

    @property
    @abstractmethod
    def tilt_cosine_sum(self) -> FloatArray:
        """Sum of the cosines of the stages' tilts, shape (...)."""

    @property
    @abstractmethod
    def balls(self) -> FloatArray:
        """Centres of the legs' balls as rows in {B} [m], shape (..., legs, 3)."""

    @property
    @abstractmethod
    def middle_pose(self) -> RigidTransform:
        """Pose in {B} of the platform that holds the lower legs' balls."""

    def _in_base(self, rows: FloatArray, *, are_points: bool = False) -> FloatArray:
        """Return rows in {B} of vectors or points (..., legs, 3) that are in the frames of the legs' plates."""
        if rows.shape[-2] == 3:
            return rows
        upper = rows[..., 3:, :] @ np.swapaxes(self._rotation, -1, -2)
        if are_points:
            upper += self._translation[..., None, :]
        return frozen(np.concatenate([np.broadcast_to(rows[..., :3, :], upper.shape), upper], axis=-2))

    @cached_property
    def leg_bases(self) -> FloatArray:
        """Pivots of the legs as rows in {B} [m], (..., 6, 3), Eqs. (1), (2); for a stage (3, 3), the same for all."""
        return self._in_base(self._machine.legs.pivots, are_points=True)

    @cached_property
    def leg_axes(self) -> FloatArray:
        """Unit revolute axes of the legs as rows in {B}, shapes as of `leg_bases`. Eq. (4)."""
        return self._in_base(self._machine.legs.axes)

    @property
    def leg_planes(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors x, outwards, and z, to the balls, of the legs' planes, in {B}, shapes as of `leg_bases`."""
        outward, forward = self._machine.legs.planes
        return self._in_base(outward), self._in_base(forward)

    @property
    def own_circle_centres(self) -> FloatArray:
        """`circle_centres` as rows in the frames of the legs' plates, {B} or {m} [m], shape (..., legs, 3)."""
        centres, _ = self._machine.legs.circles(self.readings)
        return centres

    @property
    def balls_of_stages(self) -> FloatArray:
        """`balls` by stage, in {B}, and of the upper stage in {m} [m], shape (..., stages, 3, 3)."""
        lower, upper = self.balls[..., :3, :], self.balls[..., 3:, :]
        if not upper.shape[-2]:
            return lower[..., None, :, :]
        stages = np.empty((*lower.shape[:-2], 2, 3, 3))
        stages[..., 0, :, :] = lower
        np.matmul(upper - self._translation[..., None, :], self._rotation, out=stages[..., 1, :, :])
        return stages

    @cached_property
    def circle_centres(self) -> FloatArray:
        """Centres of the circles on which balls move with locked actuators, as rows in {B} [m], (..., legs, 3).

        For RPS legs the `leg_bases`, for PRS legs the joints of carriage and rod, for RRS legs the knees.
        """
        if self._machine.legs.are_rps:
            bases, shape = self.leg_bases, self.balls.shape
            return bases if bases.shape == shape else np.broadcast_to(bases, shape)
        return self._in_base(self.own_circle_centres, are_points=True)

    @cached_property
    def leg_vectors(self) -> FloatArray:
        """Vectors from circle centres to lower balls, from upper balls to circle centres, in {B} [m], (..., legs, 3).

        The legs push along these vectors: an RPS leg has its pivot for the centre, other legs have rods.
        """
        centres, balls = self.circle_centres, self.balls
        return frozen(np.concatenate([(balls - centres)[..., :3, :], (centres - balls)[..., 3:, :]], axis=-2))

    @cached_property
    def leg_lengths(self) -> FloatArray:
        """Distances of balls and pivots, r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], shape (..., legs). Eq. (20)."""
        return frozen(np.sqrt(((self.balls - self.leg_bases) ** 2).sum(axis=-1)))

    @cached_property
    def readings(self) -> FloatArray:
        """Readings of the encoders, (..., legs): [m], for RRS legs [rad]; NaN for a ball out of a leg's reach.

        For RPS legs they are `leg_lengths` plus the offsets of the machine.
        """
        legs = self._machine.legs
        return frozen(
            self.leg_lengths + legs.offsets if legs.are_rps else legs.readings(self.places, self._machine.crank_middles)
        )

    @property
    def compared_points(self) -> FloatArray:
        """Points whose displacements measure the distance between two states, as rows in {B} [m], shape (..., n, 3).

        The balls of a stage; of a manipulator b_i and c_i.
        """
        return self.balls

    @cached_property
    def closure_residual(self) -> FloatArray:
        """Largest violation of the closure equations [m], shape (...); NaN for a missing member.

        These are distances of balls from the planes of their legs, Eqs. (5b), (5c), and errors of sides, Eq. (12).
        """
        balls, legs = self.balls, self._machine.legs
        # Axes, and distances of the planes from O; the latter are exactly zero in a nominal machine.
        axes, pivots = legs.axes[:3], legs.pivots[:3]
        lower = (balls[..., :3, :] * axes).sum(axis=-1) - (pivots * axes).sum(axis=-1)
        upper = ((balls - self.leg_bases) * self.leg_axes)[..., 3:, :].sum(axis=-1)
        sides = triangle_sides(balls[..., :3, :]) - legs.sides
        return frozen(np.asarray(np.abs(np.concatenate([lower, upper, sides], axis=-1)).max(axis=-1)))

    @abstractmethod
    def where(self, kept: BoolArray) -> Self:
        """Return the states where `kept` (...) is true; the others are missing."""

    @abstractmethod
    def _summary(self) -> str:
        """Return the text of a single state."""

    def __repr__(self) -> str:
        if self.shape:
            return f"<{type(self).__name__}: {self.shape} states, {np.count_nonzero(self.exists)} exist>"
        if not self.exists:
            return f"<{type(self).__name__}: {self._absence()}>"
        beyond = ", ".join(self._machine.legs.names[leg] for leg in np.flatnonzero(self.limit_excess))
        return f"<{type(self).__name__}: {self._summary()}{beyond and f', beyond the limits: {beyond}'}>"

    def _absence(self) -> str:
        return f"does not exist{self.missing_reason and ': '}{self.missing_reason}"

    def _repr_html_(self) -> str:
        if not self.shape:
            return notebook.table(repr(self), self._columns, [self._cells()] if self.exists else [])
        rows = notebook.first_rows(self.shape, lambda index: self[index]._cells())
        return notebook.table(repr(self), ("index", *self._columns), rows)

    @property
    def _columns(self) -> tuple[str, ...]:
        """Heading of the table in a notebook."""
        legs = self._machine.legs
        readings = (f"{leg} [{unit}]" for leg, unit in zip(legs.names, legs.units, strict=True))
        return "o in {B} [m]", "roll, pitch, yaw [°]", *readings

    def _cells(self) -> tuple[str, ...]:
        """Return the cells of a single state for the table in a notebook."""
        if not self.exists:
            return (self._absence(),)
        x, y, z = self.translation
        roll, pitch, yaw = self.pose.rotation.as_euler("xyz", degrees=True)
        lengths = (f"{length:.4f}" for length in self.readings)
        return (f"{x:.4f}, {y:.4f}, {z:.4f}", f"{roll:.2f}, {pitch:.2f}, {yaw:.2f}", *lengths)

    def __getitem__(self, index: object) -> Self:
        """Index the batch axes as NumPy would."""
        if not self.shape:
            raise SelectionError("index", "a batch of configurations", "a single one", "It has no batch axes to index")
        batch = batch_index(index)
        try:
            _ = np.broadcast_to(False, self.shape)[batch]
        except Exception as error:  # NumPy raises any type for a foreign object
            expected = f"an index of the batch axes {self.shape}"
            raise SelectionError("index", expected, type_and_value(index), str(error)) from error
        return self.transformed(lambda array, inner: array[(*batch, *(slice(None),) * inner)])

    def __iter__(self) -> Iterator[Self]:
        return (self[i] for i in range(len(self)))

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("a single configuration has no length and no batch axes to iterate over")
        return self.shape[0]

    @property
    def rotation(self) -> FloatArray:
        """Rotation of the platform in {B}, shape (..., 3, 3)."""
        return self._rotation

    @property
    def translation(self) -> FloatArray:
        """Position of the platform's origin in {B} [m], shape (..., 3)."""
        return self._translation

    @cached_property
    def pose(self) -> RigidTransform:
        """Pose of the platform in {B}; NaN where a member has no pose."""
        return unchecked_transform(self._rotation, self._translation)

    @cached_property
    def places(self) -> FloatArray:
        """Balls in their legs' planes, from the pivots: x radially outwards, z to the middle [m], (..., legs, 2)."""
        arms = self.balls - self.leg_bases
        return frozen(np.stack([(arms * axes).sum(axis=-1) for axes in self.leg_planes], axis=-1))

    @property
    def centre_rates(self) -> FloatArray:
        """Derivatives of `circle_centres` by their own readings, relative to the plates, in {B}, (..., legs, 3)."""
        outward, forward = self.leg_planes
        rates = self._machine.legs.centre_rates(self.readings)
        return np.asarray(rates[..., :1] * outward + rates[..., 1:] * forward)

    @property
    def limits(self) -> LegLimits | None:
        """Limits of the machine's readings."""
        return self._machine.limits

    @cached_property
    def limit_excess(self) -> FloatArray:
        """Excess of readings above their limits, negative below them, in their units, (..., legs); 0 within."""
        return frozen(np.zeros(self.readings.shape) if self.limits is None else self.limits.excess(self.readings))

    @cached_property
    def slopes(self) -> FloatArray:
        """κ of the legs, shape (..., legs): speed along each of `leg_vectors` per unit rate of the reading.

        [m/rad] for RRS legs, otherwise dimensionless; 1 for RPS legs. The leg itself is singular where it is zero.
        """
        return frozen(self._machine.legs.slopes(self.places, self.readings))


def stacked(states: Sequence[S]) -> S:
    """Return single states of one machine as a batch."""
    if not states:
        raise ArgumentError("states", "at least one state", "an empty list")
    first = states[0]
    solved = [state._known for state in states if state._known is not None]
    arrays = map(np.stack, zip(*(state._arrays for state in states), strict=True))
    return first.from_arrays(first.machine, *arrays, np.stack(solved) if len(solved) == len(states) else None)


def batch_index(index: object) -> tuple[Any, ...]:
    """Return an index of batch axes with an Ellipsis, so that an index of the inner axes may follow."""
    batch = index if isinstance(index, tuple) else (index,)
    return batch if any(part is Ellipsis for part in batch) else (*batch, Ellipsis)


def masked(array: FloatArray, kept: BoolArray, inner: int) -> FloatArray:
    """Return an array with `inner` axes per member, NaN where `kept` (...) is false."""
    return np.where(np.reshape(kept, (*kept.shape, *(1,) * inner)), array, np.nan)


def halves(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the vectors (..., 3, 3) of the lower and of the upper legs, of six (..., 6, 3)."""
    return vectors[..., :3, :], vectors[..., 3:, :]
