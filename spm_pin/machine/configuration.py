"""A state of a machine: pose of the platform, ball joints, and derived quantities."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError, SelectionError
from spm_pin.formulas import branches, circles
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.machine.legs import LegLimits, triangle_frames, triangle_sides
from spm_pin.machine.machine import ALONE, Machine, check_machine
from spm_pin.machine.manipulator import Manipulator, check_manipulator, check_same_machine
from spm_pin.machine.stage import Stage
from spm_pin.support import notebook
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    boolean_array,
    broadcastable,
    first_offender,
    frozen,
    real_array,
    type_and_value,
)
from spm_pin.support.pose import PoseLike, as_rigid_transform, unchecked_transform

_HALF_TURN_BACK = -np.pi + 1e-9
"""Smallest torsion [rad] of those that are π up to rounding, with negative sign."""

_is_upright, _is_home_state = on_arrays(circles.is_upright), on_arrays(circles.is_home_state)
_tilt_cosine_sum = on_arrays(branches.tilt_cosine_sum)


class Configuration:
    """One state of a machine, or a batch of states; read-only.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose in the base {B} of the terminal platform {m} of a manipulator, or of a stage's platform {n}.
    middle_joints : array_like, shape (..., 3, 3)
        For a manipulator: centres of the compound ball joints b_1, b_2, b_3 as rows, in {B} [m], those of the lower
        legs' balls. A missing member is NaN throughout. Leading axes broadcast with those of `pose`. A stage's balls
        follow from its pose.

    Notes
    -----
    The arrays are copied. Nothing is solved here: the state may violate the loop equations; see
    `closure_residual`.
    """

    missing_reason = ""
    """Why a single state does not exist, if known; otherwise empty."""
    _machine: Machine
    _arrays: tuple[FloatArray, ...]
    """Rotations and translations of the platform; of a manipulator the middle joints too."""

    def __init__(
        self, machine: Manipulator | Stage, pose: PoseLike, middle_joints: npt.ArrayLike | None = None
    ) -> None:
        matrix = as_rigid_transform(pose).as_matrix()
        rotation, translation = matrix[..., :3, :3], matrix[..., :3, 3]
        if check_machine(machine).is_stage:
            if middle_joints is not None:
                raise ArgumentError("middle_joints", "none for a stage, whose pose places its balls", "a value")
            self._set(machine, rotation.copy(), translation.copy())
            return
        what = "rows b_1, b_2, b_3 in {B} in metres"
        joints = real_array(cast("npt.ArrayLike", middle_joints), "middle_joints", (3, 3), what, allow_nan=True)
        incomplete = np.isnan(joints).any(axis=(-1, -2)) & ~np.isnan(joints).all(axis=(-1, -2))
        if incomplete.any():
            expected = "all nine coordinates finite, or all NaN for a missing member"
            raise ArgumentError("middle_joints", expected, f"some NaN at index {first_offender(incomplete)}")
        shape = broadcastable("middle_joints", joints.shape[:-2], "the pose", translation.shape[:-1])
        self._set(
            machine,
            np.broadcast_to(rotation, (*shape, 3, 3)),
            np.broadcast_to(translation, (*shape, 3)),
            np.broadcast_to(joints.copy(), (*shape, 3, 3)),
        )

    def _set(self, machine: Machine, *arrays: FloatArray) -> None:
        self._machine = machine
        self._arrays = tuple(map(frozen, arrays))

    @classmethod
    def from_arrays(cls, machine: Machine, *arrays: FloatArray | None) -> Configuration:
        """Make a state from valid arrays with equal leading axes, without checks or copies.

        They are the rotations (..., 3, 3) and the translations (..., 3) of the platform, for a manipulator the middle
        joints (..., 3, 3), and what a solver may have computed already: for a manipulator leg lengths (..., 6), for a
        stage its readings (..., 3).
        """
        self = cls.__new__(cls)
        count = 2 if machine.is_stage else 3
        self._set(machine, *cast("tuple[FloatArray, ...]", arrays[:count]))
        if len(arrays) > count and arrays[count] is not None:
            self.__dict__[self._solved] = frozen(cast("FloatArray", arrays[count]))
        return self

    @property
    def _solved(self) -> str:
        """Name of the property, one number for each leg, which a solver may have computed already."""
        return "readings" if self._machine.is_stage else "leg_lengths"

    @property
    def _known(self) -> FloatArray | None:
        """The value of the property named by `_solved`, if it has been computed already."""
        return self.__dict__.get(self._solved)

    def with_machine(self, machine: Machine) -> Configuration:
        """Return the same states of another machine, which has the same dimensions but perhaps other limits."""
        check_same_machine(check_machine(machine), self._machine, "machine", "the state")
        return self.from_arrays(machine, *self._arrays)

    def transformed(self, change: Callable[[FloatArray, int], FloatArray]) -> Configuration:
        """Return the states with each array replaced by `change(array, number of inner axes)`."""
        solved = self._known
        arrays = (change(array, inner) for array, inner in zip(self._arrays, (2, 1, 2), strict=False))
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
        return self.translation.shape[:-1]

    @property
    def rotation(self) -> FloatArray:
        """Rotation of the platform in {B}, shape (..., 3, 3)."""
        return self._arrays[0]

    @property
    def translation(self) -> FloatArray:
        """Position of the platform's origin in {B} [m], shape (..., 3)."""
        return self._arrays[1]

    @property
    def exists(self) -> BoolArray:
        """False for a member of the batch that does not exist, shape (...)."""
        return ~np.isnan(self.translation[..., 2] if self._machine.is_stage else self._arrays[2][..., 0, 0])

    def where(self, mask: npt.ArrayLike) -> Configuration:
        """Return the states where `mask` (...) is true; the others are NaN, but a manipulator's keep their pose."""
        kept = boolean_array(mask, "mask", self.shape)
        if self._machine.is_stage:
            return self.transformed(lambda array, inner: masked(array, kept, inner))
        lengths = None if self._known is None else masked(self._known, kept, 1)
        joints = masked(self.middle_joints, kept, 2)
        return self.from_arrays(self._machine, self.rotation, self.translation, joints, lengths)

    @property
    def is_at_home(self) -> BoolArray:
        """True for physical states, without regard to leg limits, shape (...).

        A physical state is reached from the symmetric home without a forward singularity: no torsion in either stage,
        each stage on the outer side of its platform, and both in the home assembly region. The signs of det J_b and
        det J_c do not determine this region alone: they are sums of two products of three factors, all six positive at
        home, and in the home assembly region at most one is negative; see `docs/theory/forward_displacement.md`. If the
        machine is calibrated, the nominal directions determine the mode, and the machine's own axes the region.
        """
        legs = self._machine.legs
        balls, centres = self.balls_of_stages, legs.pivots if legs.are_rps else self.own_circle_centres
        axes, centres = (x.reshape(*x.shape[:-2], len(legs.kinds), 3, 3) for x in (legs.axes, centres))
        at_home = np.asarray(_is_upright(rows_of(balls), rows_of(centres), legs.stage_ups).all(axis=-1))
        # In a batch few states are upright, and the test of the region takes longer.
        centres = np.broadcast_to(centres, balls.shape)
        stages = (rows_of(x) for x in (balls[at_home], centres[at_home], axes))
        at_home[at_home] = _is_home_state(*stages, legs.stage_ups).all(axis=-1)
        return at_home

    @property
    def tilt_cosine_sum(self) -> FloatArray:
        """Sum of the cosines of the stages' tilts, shape (...): 2 for a straight manipulator."""
        if self._machine.is_stage:
            return self.normal[..., 2]
        return np.asarray(_tilt_cosine_sum(rows_of(self.middle_joints), rows_of(self.rotation)))

    @cached_property
    def balls(self) -> FloatArray:
        """Centres of the legs' balls as rows in {B} [m], (..., legs, 3): b_1, b_2, b_3 twice if nominal."""
        if self._machine.is_stage:
            turned = self._machine.legs.balls @ np.swapaxes(self.rotation, -1, -2)
            return frozen(turned + self.translation[..., None, :])
        lower = self.middle_joints
        sides = lower[..., 1, :] - lower[..., 0, :], lower[..., 2, :] - lower[..., 0, :]
        moved = self._machine.legs.upper_ball_weights @ np.stack([*sides, np.cross(*sides)], axis=-2)
        return frozen(np.concatenate([lower, lower + moved], axis=-2))

    @property
    def middle_joints(self) -> FloatArray:
        """Ball joint centres b_1, b_2, b_3 as rows in {B} [m], shape (..., 3, 3); those of a stage are its `balls`."""
        return self.balls if self._machine.is_stage else self._arrays[2]

    @cached_property
    def middle_pose(self) -> RigidTransform:
        """Pose in {B} of the platform {n} that holds the lower legs' balls: a stage's own.

        In a nominal manipulator {n} is at the triangle's centre, with x along b_3 b_1.
        """
        if self._machine.is_stage:
            return self.pose
        corners = self._machine.legs.balls[:3]
        frames = triangle_frames(self.middle_joints) @ triangle_frames(corners).T
        centres = self.middle_joints.mean(axis=-2) - frames @ corners.mean(axis=0)
        return unchecked_transform(frames, centres)

    @property
    def platform_joints(self) -> FloatArray:
        """Pivots of a manipulator's upper legs, c_1, c_2, c_3, as rows in {B} [m], shape (..., 3, 3). Eq. (2)."""
        check_manipulator(self._machine)
        return self.leg_bases[..., 3:, :]

    @property
    def platform_axes(self) -> FloatArray:
        """Unit revolute axes at c_1, c_2, c_3 as rows in {B}, shape (..., 3, 3). Eq. (4b)."""
        check_manipulator(self._machine)
        return self.leg_axes[..., 3:, :]

    @property
    def compared_points(self) -> FloatArray:
        """Points whose displacements measure the distance between two states, as rows in {B} [m], shape (..., n, 3).

        The balls of a stage; of a manipulator b_i and c_i.
        """
        if self._machine.is_stage:
            return self.balls
        return np.concatenate([self.middle_joints, self.platform_joints], axis=-2)

    def _in_base(self, rows: FloatArray, *, are_points: bool = False) -> FloatArray:
        """Return rows in {B} of vectors or points (..., legs, 3) that are in the frames of the legs' plates."""
        if rows.shape[-2] == 3:
            return rows
        upper = rows[..., 3:, :] @ np.swapaxes(self.rotation, -1, -2)
        if are_points:
            upper += self.translation[..., None, :]
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
        np.matmul(upper - self.translation[..., None, :], self.rotation, out=stages[..., 1, :, :])
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

    def _summary(self) -> str:
        """Return the text of a single state."""
        if self._machine.is_stage:
            tilt, azimuth = np.degrees([self.tilt, self.azimuth])
            readings = ", ".join(f"{x:.4f}" for x in self.readings)
            text = f"tilt {tilt:.2f}° towards {azimuth:.1f}°, height {self.height:.4f} m"
            return f"{text}, readings {readings} {self._machine.legs.units[0]}"
        readings = ", ".join(f"{x:.4f} {unit}" for x, unit in zip(self.readings, self._machine.legs.units, strict=True))
        return f"readings {readings}"

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

    def __getitem__(self, index: object) -> Configuration:
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

    def __iter__(self) -> Iterator[Configuration]:
        return (self[i] for i in range(len(self)))

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("a single configuration has no length and no batch axes to iterate over")
        return self.shape[0]

    @cached_property
    def pose(self) -> RigidTransform:
        """Pose of the platform in {B}; NaN where a member has no pose."""
        return unchecked_transform(self.rotation, self.translation)

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the platform in {B}, shape (..., 3)."""
        return self.rotation[..., 2]

    @property
    def tilt(self) -> FloatArray:
        """Angle between the platform's normal and z, from 0 to π [rad], shape (...)."""
        return np.asarray(np.arctan2(np.hypot(self.normal[..., 0], self.normal[..., 1]), self.normal[..., 2]))

    @property
    def azimuth(self) -> FloatArray:
        """Direction to which the normal leans, where the platform is lowest [rad], shape (...).

        It is measured from x towards y: the legs are at -30°, 90° and 210°.
        """
        return np.asarray(np.arctan2(self.normal[..., 1] + 0.0, self.normal[..., 0]))

    @property
    def roll(self) -> FloatArray:
        """Rotation about x, that of ``pose.rotation.as_euler("xyz")`` without torsion [rad], shape (...)."""
        return np.asarray(np.arctan2(-self.normal[..., 1], self.normal[..., 2]))

    @property
    def pitch(self) -> FloatArray:
        """Rotation about y before the roll about x: the normal is Rx(roll) Ry(pitch) z [rad], shape (...)."""
        return np.asarray(np.arctan2(self.normal[..., 0], np.hypot(self.normal[..., 1], self.normal[..., 2])))

    @property
    def height(self) -> FloatArray:
        """Height of the platform's origin above the plane of the pivots [m], shape (...)."""
        return self.translation[..., 2]

    @property
    def shift(self) -> FloatArray:
        """Lateral (parasitic) displacement of the platform's origin from the axis of the base, x and y [m], (..., 2).

        It follows from the tilt and cannot be commanded.
        """
        return self.translation[..., :2]

    @property
    def torsion(self) -> FloatArray:
        """Rotation of the platform about its normal, beyond the shortest rotation that tilts it [rad], shape (...).

        Zero in mode T of a nominal stage, π in mode F; a half turn is never -π, even by rounding.
        """
        r = self.rotation
        torsion = np.arctan2(r[..., 1, 0] - r[..., 0, 1], r[..., 0, 0] + r[..., 1, 1])
        return np.asarray(np.where(torsion < _HALF_TURN_BACK, torsion + 2.0 * np.pi, torsion))

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


def stacked(states: Sequence[Configuration]) -> Configuration:
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


def check_configuration(
    value: Any,
    argument: str = "configuration",
    *,
    single: bool = False,
    existing: bool = False,
    of: type[Machine] = Machine,
) -> Configuration:
    """Return `value` if it is a configuration, no batch if `single`, without absent members if `existing`.

    `of` is the class that its machine must have.
    """
    if not isinstance(value, Configuration):
        several = hasattr(type(value), "physical")
        cause = (
            "Choose one of its solutions: .physical(), .nearest(near), or a label such as ['TT+']" if several else ""
        )
        raise ArgumentError(argument, "a Configuration", type(value).__name__, cause)
    if not isinstance(value.machine, of):
        received = f"one of a {type(value.machine).__name__}"
        raise ArgumentError(argument, f"a configuration of a {of.__name__}", received, ALONE * value.machine.is_stage)
    if single and value.shape:
        cause = f"Choose one member by its index: {argument}[0]"
        raise ArgumentError(argument, "a single configuration", f"a batch of shape {value.shape}", cause)
    if existing and not value.exists.all():
        index = first_offender(~value.exists)
        where = f" at batch index {index}" if index else ""
        cause = value.missing_reason or "Is it no real solution? See .status and .exists of the SolutionSet"
        raise ArgumentError(argument, "a configuration that exists", f"NaN{where}", cause)
    return value


Condition = Callable[[Any], npt.ArrayLike]
"""Takes states (n,) and returns for each whether it counts, (n,); see `spm_pin.sweeps.condition` for one of metrics."""


def check_condition(where: Condition, states: Configuration) -> BoolArray:
    """Return which states (n,) satisfy a condition, after a check of what it returns."""
    if not callable(where):
        raise ArgumentError("where", "a function of states that says which count", type_and_value(where))
    if states.shape == (0,):
        return np.zeros(0, dtype=np.bool_)
    answer = np.asarray(where(states))
    if answer.shape != states.shape or answer.dtype.kind != "b":
        received = f"{answer.dtype} of shape {answer.shape}"
        raise ArgumentError("where", f"a function that returns booleans of shape {states.shape}", received)
    return answer
