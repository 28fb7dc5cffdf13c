"""The task that dimensions are searched for: poses that a machine has to reach, and the load on it there."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import inverse_displacement, leg_forces
from spm_pin.machine import Configuration, Manipulator, as_rigid_transform
from spm_pin.machine.branch_of_state import physical
from spm_pin.support.arguments import FloatArray, check_instance, real_array, whole_number


@dataclass(frozen=True, eq=False)
class Task:
    """Poses that a machine has to reach in one branch, all along a path or in any order, under a load.

    Its methods are functions of a `Manipulator`, as searches for dimensions take them.

    Parameters
    ----------
    poses : pose of shape (n,), or PlatformPath
        Of {m} in {B}, translation in metres; of a path so many as `samples`, evenly spaced in its time.
    wrench : array_like, shape (6,) or (n, 6), optional
        (f, m): force [N] and moment [N m] at o, in {B}, onto the platform from outside; a newton down if not given.
    samples : int
        Poses along a path.
    """

    poses: Any
    wrench: npt.ArrayLike = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)
    samples: int = 200
    _poses: RigidTransform = field(init=False, repr=False)
    _load: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from spm_pin.multibody.trajectory import PlatformPath

        count = whole_number(self.samples, "samples", "at least two samples", least=2, most=10**6)
        if isinstance(self.poses, PlatformPath):
            transform = self.poses(np.linspace(self.poses.start, self.poses.end, count)).pose
        else:
            transform = as_rigid_transform(self.poses, "poses")
        if len(transform.shape) != 1 or not transform.shape[0]:
            raise ArgumentError("poses", "one or more poses, shape (n,)", f"shape {transform.shape}")
        load = real_array(self.wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        if load.shape[:-1] not in ((), transform.shape):
            raise ArgumentError("wrench", f"shape (6,), or ({transform.shape[0]}, 6)", f"shape {load.shape}")
        object.__setattr__(self, "_poses", transform)
        object.__setattr__(self, "_load", load)

    @property
    def identity(self) -> str:
        """A text that differs between tasks."""
        arrays = self._poses.as_matrix(), self._load
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

    def margin(self, machine: Manipulator) -> float:
        """Return how far the worst leg at the worst pose is inside its limits [m], for RRS legs at the knee.

        Negative outside; NaN where no physical branch leads through all poses. Of two that do the better one counts.
        """
        return self._along(machine)[0]

    def effort(self, machine: Manipulator) -> float:
        """Return the largest effort of an actuator at any pose [N], for RRS legs [N m], in the branch of `margin`.

        NaN if no branch exists, or a pose is singular.
        """
        states = self._along(machine)[1]
        return float("nan") if states is None else float(np.abs(leg_forces(states, self._load)).max())

    def _along(self, machine: Manipulator) -> tuple[float, Configuration | None]:
        """Return the margin, and the states (n,) in the branch that has it."""
        limits = check_instance(machine, Manipulator, "machine").limits
        if limits is None:
            raise ArgumentError("machine", "a machine with leg limits", repr(machine))
        states = inverse_displacement(machine, self._poses).configurations
        margins = limits.margin(states.readings, machine.legs.largest_slopes)
        # A machine does not change its branch between poses: branches meet at inverse singularities.
        worst = np.where(physical(states), margins, -np.inf).min(axis=0)
        branch = int(worst.argmax())
        return (float(worst[branch]), states[:, branch]) if np.isfinite(worst[branch]) else (float("nan"), None)
