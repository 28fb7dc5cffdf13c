"""A state of the manipulator: pose of the platform, ball joints, and derived quantities."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError
from spm_pin.formulas import branches, wrenches
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.machine.batched import Batched, halves, masked
from spm_pin.machine.legs import triangle_frames
from spm_pin.machine.machine import ALONE
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    broadcastable,
    check_instance,
    first_offender,
    frozen,
    real_array,
    type_and_value,
)
from spm_pin.support.pose import PoseLike, as_rigid_transform, unchecked_transform

_is_upright, _tilt_cosine_sum = on_arrays(branches.is_upright), on_arrays(branches.tilt_cosine_sum)
_is_stage_at_home = on_arrays(wrenches.is_stage_at_home)


class Configuration(Batched):
    """One state of the manipulator, or a batch of states; read-only.

    Parameters
    ----------
    machine : Manipulator
        The manipulator.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of the terminal platform {m} in the base {B}.
    middle_joints : array_like, shape (..., 3, 3)
        Centres of the compound ball joints b_1, b_2, b_3 as rows, in {B} [m]: those of the lower legs' balls. A missing
        member is NaN throughout. Leading axes broadcast with those of `pose`.

    Notes
    -----
    The arrays are copied. Nothing is solved here: the state may violate the loop equations; see
    `closure_residual`.
    """

    _machine: Manipulator
    _solved = "leg_lengths"
    _inner = (2, 1, 2)

    def __init__(self, machine: Manipulator, pose: PoseLike, middle_joints: npt.ArrayLike) -> None:
        check_manipulator(machine)
        transform = as_rigid_transform(pose)
        joints = real_array(
            middle_joints, "middle_joints", (3, 3), "rows b_1, b_2, b_3 in {B} in metres", allow_nan=True
        )
        incomplete = np.isnan(joints).any(axis=(-1, -2)) & ~np.isnan(joints).all(axis=(-1, -2))
        if incomplete.any():
            expected = "all nine coordinates finite, or all NaN for a missing member"
            raise ArgumentError("middle_joints", expected, f"some NaN at index {first_offender(incomplete)}")
        matrix = transform.as_matrix()
        shape = broadcastable("middle_joints", joints.shape[:-2], "the pose", transform.shape)
        self._set(
            machine,
            np.broadcast_to(matrix[..., :3, :3], (*shape, 3, 3)),
            np.broadcast_to(matrix[..., :3, 3], (*shape, 3)),
            np.broadcast_to(joints.copy(), (*shape, 3, 3)),
        )

    def _summary(self) -> str:
        readings = (f"{x:.4f} {unit}" for x, unit in zip(self.readings, self.machine.legs.units, strict=True))
        return f"readings {', '.join(readings)}"

    @property
    def machine(self) -> Manipulator:
        """The manipulator."""
        return self._machine

    @property
    def compared_points(self) -> FloatArray:
        """Points by whose displacement states are compared, b_i and c_i as rows in {B} [m], shape (..., 6, 3)."""
        return np.concatenate([self.middle_joints, self.platform_joints], axis=-2)

    def where(self, kept: BoolArray) -> Configuration:
        """Return the states where `kept` (...) is true; the others have no joints, but keep their pose."""
        lengths = None if self._known is None else masked(self._known, kept, 1)
        joints = masked(self.middle_joints, kept, 2)
        return Configuration.from_arrays(self.machine, self._rotation, self._translation, joints, lengths)

    @property
    def middle_joints(self) -> FloatArray:
        """Ball joint centres b_1, b_2, b_3 as rows in {B} [m], shape (..., 3, 3)."""
        return self._arrays[2]

    @property
    def exists(self) -> BoolArray:
        """False for a member of the batch that does not exist, shape (...)."""
        return ~np.isnan(self.middle_joints[..., 0, 0])

    @property
    def is_at_home(self) -> BoolArray:
        """True for physical states, without regard to leg limits, shape (...).

        A physical state is reached from the symmetric home without a forward singularity: no torsion in either stage,
        each stage on the outer side of its platform, and both in the home assembly region. The signs of det J_b and
        det J_c do not determine this region alone: they are sums of two products of three factors, all six positive at
        home, and in the home assembly region at most one is negative; see `docs/theory/forward_displacement.md`. If the
        machine is calibrated, the nominal directions determine the mode, and the machine's own axes the region.
        """
        position = tuple(np.moveaxis(self.translation, -1, 0))
        outer = self.leg_vectors * self.machine.legs.ups[:, None]
        vectors = self.middle_joints, *halves(outer), self.rotation
        upright = np.asarray(_is_upright(*map(rows_of, vectors), position))
        # In a batch few states are upright, and the test of the region takes longer.
        states = self[upright] if self.shape else self
        outer = outer[upright] if self.shape else outer
        stages = zip(*map(halves, (states.balls, outer, states.leg_axes)), strict=True)
        at_home: BoolArray = upright.copy()
        at_home[upright] = np.logical_and(*(_is_stage_at_home(*map(rows_of, vectors)) for vectors in stages))
        return at_home

    @property
    def tilt_cosine_sum(self) -> FloatArray:
        """Sum of the cosines of the two stages' tilts, shape (...): 2 for a straight machine."""
        return np.asarray(_tilt_cosine_sum(rows_of(self.middle_joints), rows_of(self.rotation)))

    @cached_property
    def balls(self) -> FloatArray:
        """Centres of the legs' balls as rows in {B} [m], (..., 6, 3); in a nominal machine b_1, b_2, b_3 twice."""
        lower = self.middle_joints
        sides = lower[..., 1, :] - lower[..., 0, :], lower[..., 2, :] - lower[..., 0, :]
        moved = self.machine.legs.upper_ball_weights @ np.stack([*sides, np.cross(*sides)], axis=-2)
        return frozen(np.concatenate([lower, lower + moved], axis=-2))

    @property
    def platform_joints(self) -> FloatArray:
        """Pivots of the upper legs, c_1, c_2, c_3, as rows in {B} [m], shape (..., 3, 3). Eq. (2)."""
        return self.leg_bases[..., 3:, :]

    @property
    def platform_axes(self) -> FloatArray:
        """Unit revolute axes at c_1, c_2, c_3 as rows in {B}, shape (..., 3, 3). Eq. (4b)."""
        return self.leg_axes[..., 3:, :]

    @cached_property
    def middle_pose(self) -> RigidTransform:
        """Pose of the middle platform {n} in {B}; in a nominal machine at the triangle's centre, x along b_3 b_1."""
        corners = self.machine.legs.balls[:3]
        frames = triangle_frames(self.middle_joints) @ triangle_frames(corners).T
        centres = self.middle_joints.mean(axis=-2) - frames @ corners.mean(axis=0)
        return unchecked_transform(frames, centres)


def check_configuration(
    value: Any, argument: str = "configuration", *, single: bool = False, existing: bool = False
) -> Configuration:
    """Return `value` if it is a configuration, no batch if `single`, without absent members if `existing`."""
    configuration = check_instance(value, Configuration, argument, _cause_of_kind(value))
    check_members(configuration, argument, single=single, existing=existing)
    return configuration


def check_state(value: Any, argument: str = "configuration", *, single: bool = False, existing: bool = False) -> Any:
    """Return `value` if it is a state of a manipulator or of a stage; see `check_configuration`."""
    if not isinstance(value, Batched):
        received = type(value).__name__
        raise ArgumentError(argument, "a Configuration or a StageConfiguration", received, _cause_of_kind(value))
    check_members(value, argument, single=single, existing=existing)
    return value


def _cause_of_kind(value: Any) -> str:
    if isinstance(value, Batched):
        return ALONE
    several = hasattr(type(value), "physical")
    return "Choose one of its solutions: .physical(), .nearest(near), or a label such as ['TT+']" if several else ""


def check_members(configuration: Batched, argument: str, *, single: bool, existing: bool) -> None:
    """Raise `ArgumentError` for a batch if `single`, and for missing members if `existing`."""
    if single and configuration.shape:
        cause = f"Choose one member by its index: {argument}[0]"
        raise ArgumentError(argument, "a single configuration", f"a batch of shape {configuration.shape}", cause)
    if existing and not configuration.exists.all():
        index = first_offender(~configuration.exists)
        where = f" at batch index {index}" if index else ""
        cause = configuration.missing_reason or "Is it no real solution? See .status and .exists of the SolutionSet"
        raise ArgumentError(argument, "a configuration that exists", f"NaN{where}", cause)


Condition = Callable[[Any], npt.ArrayLike]
"""Takes states (n,) and returns for each whether it counts, (n,); see `spm_pin.sweeps.condition` for one of metrics."""


def check_condition(where: Condition, states: Batched) -> BoolArray:
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
