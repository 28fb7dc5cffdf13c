"""A state of a stage alone, its platform's pose, and sets of such states."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.formulas import circles
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.machine.batched import Batched, masked
from spm_pin.machine.solution_axis import Solutions, following
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, frozen
from spm_pin.support.pose import PoseLike, as_rigid_transform

OPERATION_MODES = ("T", "F")
"""The two solutions of an inverse displacement: without torsion, and turned half round."""
BELOW = "The height is negative: below the pivots"
"""A cause that there is no physical state."""
_HALF_TURN_BACK = -np.pi + 1e-9
"""A torsion [rad] below which it is π up to rounding."""

_is_home_state = on_arrays(circles.is_home_state)


class StageConfiguration(Batched):
    """One state of a stage, or a batch of states; read-only.

    Parameters
    ----------
    stage : Stage
        The stage.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of the platform in {B}: its origin is the centre of the balls, in a machine as drawn.

    Notes
    -----
    Nothing is solved here: balls may be out of their legs' planes, and `closure_residual` is by how much.
    """

    _machine: Stage
    _solved = "readings"

    def __init__(self, stage: Stage, pose: PoseLike) -> None:
        matrix = as_rigid_transform(pose).as_matrix()
        self._set(check_instance(stage, Stage, "stage"), matrix[..., :3, :3].copy(), matrix[..., :3, 3].copy())

    @classmethod
    def from_arrays(
        cls, stage: Stage, rotation: FloatArray, translation: FloatArray, readings: FloatArray | None = None
    ) -> StageConfiguration:
        """Make a configuration from valid arrays with equal leading axes, without checks or copies."""
        self = cls.__new__(cls)
        self._set(stage, rotation, translation)
        if readings is not None:
            self.__dict__["readings"] = frozen(readings)
        return self

    def where(self, kept: BoolArray) -> StageConfiguration:
        """Return the states where `kept` (...) is true; the others are NaN throughout."""
        return self.transformed(lambda array, inner: masked(array, kept, inner))

    def _summary(self) -> str:
        tilt, azimuth = np.degrees([self.tilt, self.azimuth])
        readings = ", ".join(f"{x:.4f}" for x in self.readings)
        text = f"tilt {tilt:.2f}° towards {azimuth:.1f}°, height {self.height:.4f} m"
        return f"{text}, readings {readings} {self.stage.unit}"

    @property
    def stage(self) -> Stage:
        """The stage."""
        return self._machine

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape."""
        return self._translation.shape[:-1]

    @property
    def exists(self) -> BoolArray:
        """False for a member of the batch that does not exist, shape (...)."""
        return ~np.isnan(self._translation[..., 2])

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the platform in {B}, shape (..., 3)."""
        return self._rotation[..., 2]

    @property
    def tilt(self) -> FloatArray:
        """Angle between the platform's normal and z, from 0 to π [rad], shape (...)."""
        return np.asarray(np.arctan2(np.hypot(self.normal[..., 0], self.normal[..., 1]), self.normal[..., 2]))

    @property
    def azimuth(self) -> FloatArray:
        """Direction in which the normal leans, hence in which the platform is lowest [rad], shape (...).

        From x towards y: the legs stand at -30°, 90° and 210°.
        """
        return np.asarray(np.arctan2(self.normal[..., 1] + 0.0, self.normal[..., 0]))

    @property
    def roll(self) -> FloatArray:
        """Turn about x, of ``pose.rotation.as_euler("xyz")`` where there is no torsion [rad], shape (...)."""
        return np.asarray(np.arctan2(-self.normal[..., 1], self.normal[..., 2]))

    @property
    def pitch(self) -> FloatArray:
        """Turn about y that comes before the roll about x: the normal is Rx(roll) Ry(pitch) z [rad], shape (...)."""
        return np.asarray(np.arctan2(self.normal[..., 0], np.hypot(self.normal[..., 1], self.normal[..., 2])))

    @property
    def height(self) -> FloatArray:
        """Of the platform's origin above the plane of the pivots [m], shape (...)."""
        return self._translation[..., 2]

    @property
    def shift(self) -> FloatArray:
        """By how much the platform's origin is beside the axis of the base, x and y [m], shape (..., 2).

        It follows from the tilt: a parasitic motion.
        """
        return self._translation[..., :2]

    @property
    def torsion(self) -> FloatArray:
        """Turn of the platform about its normal, from the shortest turn that takes z to it [rad], shape (...).

        Zero in mode T of a stage as drawn, π in mode F; a half turn is never -π, even by rounding.
        """
        r = self._rotation
        torsion = np.arctan2(r[..., 1, 0] - r[..., 0, 1], r[..., 0, 0] + r[..., 1, 1])
        return np.asarray(np.where(torsion < _HALF_TURN_BACK, torsion + 2.0 * np.pi, torsion))

    @cached_property
    def balls(self) -> FloatArray:
        """Centres of the balls as rows in {B} [m], shape (..., 3, 3)."""
        turned = self.stage.legs.balls @ np.swapaxes(self._rotation, -1, -2)
        return frozen(turned + self._translation[..., None, :])

    @property
    def middle_pose(self) -> RigidTransform:
        """Pose of the platform, as of a robot's middle platform."""
        return self.pose

    @property
    def compared_points(self) -> FloatArray:
        """The points by which states are compared: the balls."""
        return self.balls

    @property
    def leg_bases(self) -> FloatArray:
        """Pivots of the legs as rows in {B} [m], shape (3, 3): the same in all states."""
        return self.stage.legs.pivots

    @property
    def leg_axes(self) -> FloatArray:
        """Unit revolute axes of the legs as rows in {B}, shape (3, 3)."""
        return self.stage.legs.axes

    @property
    def leg_planes(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors x, radially outwards, and z, upwards, of the legs' planes, as rows in {B}, (3, 3) each."""
        return self.stage.legs.planes

    @cached_property
    def readings(self) -> FloatArray:
        """Readings of the legs' encoders, shape (..., 3): [m], of RRS legs [rad]; NaN for a ball out of reach."""
        return frozen(self.stage.legs.readings(self.places))

    @cached_property
    def circle_centres(self) -> FloatArray:
        """Centres of the circles that the locked actuators leave to the balls, as rows in {B} [m], (..., 3, 3).

        The pivots of RPS legs, the joints of carriage and rod of PRS legs, and the knees of RRS legs.
        """
        return frozen(np.asarray(self.stage.legs.circles(self.readings)[0]))

    @property
    def leg_vectors(self) -> FloatArray:
        """From circle centres to balls, as rows in {B} [m], (..., 3, 3): along them the legs push."""
        return self.balls - self.circle_centres

    @property
    def closure_residual(self) -> FloatArray:
        """Largest distance of a ball from the plane of its leg [m], shape (...)."""
        apart = ((self.balls - self.leg_bases) * self.leg_axes).sum(axis=-1)
        return np.asarray(np.abs(apart).max(axis=-1))

    @property
    def is_at_home(self) -> BoolArray:
        """True without torsion, and reached from the level platform without a forward singularity, shape (...)."""
        axes, centres, none = (rows_of(x) for x in (self.stage.legs.axes, self.circle_centres, np.zeros((3, 3))))
        stage: Any = circles.Circles(axes, centres, none[0], none[0])  # type: ignore[arg-type]
        at_home = _is_home_state(stage, rows_of(self.leg_vectors), rows_of(self.balls), self.stage.kind.up)
        return np.asarray(at_home, dtype=np.bool_)


class StageSolutions(Solutions[StageConfiguration]):
    """The states of a stage that solve one problem, or a batch of problems, along one axis; see `SolutionSet`.

    Of an inverse displacement two, labelled by the operation modes T, without torsion, and F, a half turn; of a forward
    displacement the sixteen of `spm_pin.kinematics.STAGE_MODES`.
    """

    _kind = StageConfiguration

    @property
    def stage(self) -> Stage:
        """The stage."""
        return self.configurations.stage

    @property
    def is_physical(self) -> BoolArray:
        """True for solutions reached from the level platform without a forward singularity, shape (..., n)."""
        return self.configurations.is_at_home

    def preference(self, candidates: BoolArray) -> FloatArray:
        """Prefer the one that tilts least."""
        return np.where(candidates, np.cos(self.configurations.tilt), -math.inf)

    def _hint(self, index: tuple[int, ...]) -> str:
        nearest = "For the nearest tilt that is reached see spm_pin.stages.nearest_reachable"
        if self.labels != OPERATION_MODES:
            return super()._hint(index)
        below = (self.configurations.height[index] < 0.0).any() and not self.is_physical[index].any()
        return following([self.configurations.missing_reason, BELOW * bool(below), nearest])
