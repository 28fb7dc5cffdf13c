"""Task of a search for dimensions: poses or tilts that a machine has to reach, and the load on it there."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import inverse_displacement, leg_forces
from spm_pin.kinematics.stage_displacement import normals_of_request
from spm_pin.machine import Configuration, Manipulator, Stage, as_rigid_transform
from spm_pin.machine.machine import check_machine
from spm_pin.support.arguments import FloatArray, broadcastable, real_array, whole_number
from spm_pin.sweeps.points import Poses, Tilts


@dataclass(frozen=True, eq=False)
class Task:
    """Poses that a machine has to reach in one branch, all along a path or in any order, under a load.

    Its methods are functions of a `Manipulator`, for use in searches for dimensions; for a task made by `of_tilts` they
    are functions of a `Stage`.

    Parameters
    ----------
    poses : pose of shape (n,), or PlatformPath
        Poses of {m} in {B}, translation in metres. A path is sampled at `samples` poses, evenly spaced in its time.
    wrench : array_like, shape (6,) or (n, 6), optional
        (f, m): force [N] and moment [N m] at o, in {B}, onto the platform from outside; by default a force of 1 N along
        -Z.
    samples : int
        Number of poses at which a path is sampled.
    """

    poses: Any
    wrench: npt.ArrayLike = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)
    samples: int = 200
    _requests: Poses | Tilts = field(init=False, repr=False)
    _load: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        requests = self.poses if isinstance(self.poses, Tilts) else self._read_poses()
        count = len(requests[0])
        load = real_array(self.wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        if load.shape[:-1] not in ((), (count,)):
            raise ArgumentError("wrench", f"shape (6,), or ({count}, 6)", f"shape {load.shape}")
        object.__setattr__(self, "_requests", requests)
        object.__setattr__(self, "_load", load)

    def _read_poses(self) -> Poses:
        from spm_pin.multibody.trajectory import PlatformPath

        count = whole_number(self.samples, "samples", "at least two samples", least=2, most=10**6)
        if isinstance(self.poses, PlatformPath):
            transform = self.poses(np.linspace(self.poses.start, self.poses.end, count)).pose
        else:
            transform = as_rigid_transform(self.poses, "poses")
        if len(transform.shape) != 1 or not transform.shape[0]:
            raise ArgumentError("poses", "one or more poses, shape (n,)", f"shape {transform.shape}")
        matrices = transform.as_matrix()
        return Poses(matrices[:, :3, :3], matrices[:, :3, 3])

    @classmethod
    def of_tilts(
        cls,
        height: npt.ArrayLike,
        *,
        wrench: npt.ArrayLike = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0),
        **tilts: npt.ArrayLike,
    ) -> Self:
        """Return the task of heights and tilts of a stage, of shape (n,).

        Parameters
        ----------
        height, tilts
            As for `spm_pin.inverse_displacement`: tilt and azimuth, roll and pitch, or normal.
        wrench
            As for the class.
        """
        heights = np.atleast_1d(real_array(height, "height", (), "of the platform's origin in metres"))
        normals = np.atleast_2d(normals_of_request(**tilts))
        shape = broadcastable("height", heights.shape, "the normals", normals.shape[:-1])
        if len(shape) != 1 or not shape[0]:
            raise ArgumentError("height", "one or more states, shape (n,)", f"shape {shape}")
        return cls(Tilts(np.broadcast_to(normals, (*shape, 3)), np.broadcast_to(heights, shape)), wrench)

    @property
    def identity(self) -> str:
        """A text that differs between tasks."""
        arrays = *self._requests, self._load
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

    def margin(self, machine: Manipulator | Stage) -> float:
        """Return the distance of the worst leg at the worst pose from its limits [m], at the knee for RRS legs.

        Negative outside; NaN if no physical branch contains all poses. If two do, the larger value is returned.
        """
        return self._along(machine)[0]

    def effort(self, machine: Manipulator | Stage) -> float:
        """Return the largest effort of an actuator at any pose [N] ([N m] for RRS legs), in the branch of `margin`.

        NaN if no branch exists, or a pose is singular.
        """
        states = self._along(machine)[1]
        return float("nan") if states is None else float(np.abs(leg_forces(states, self._load)).max())

    def _along(self, machine: Manipulator | Stage) -> tuple[float, Configuration | None]:
        """Return the margin, and the states (n,) in the branch that has it."""
        limits = check_machine(machine).limits
        if isinstance(self._requests, Tilts) is not machine.is_stage:
            expected = "a Stage for a task of tilts, a Manipulator for one of poses"
            raise ArgumentError("machine", expected, type(machine).__name__, "A task of tilts is made by Task.of_tilts")
        if limits is None:
            raise ArgumentError("machine", "a machine with leg limits", repr(machine))
        states = self._requests.solved_by(inverse_displacement, machine).configurations
        margins = limits.margin(states.readings, machine.legs.largest_slopes)
        # A machine does not change its branch between poses: branches meet at inverse singularities.
        worst = np.where(states.is_at_home, margins, -np.inf).min(axis=0)
        branch = int(worst.argmax())
        return (float(worst[branch]), states[:, branch]) if np.isfinite(worst[branch]) else (float("nan"), None)
