"""The nearest pose within limits against SciPy from many starts, by the loop equations of both platforms' poses.

Nothing is shared with the search but the dimensions of the legs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.workspace import nearest_reachable_pose, reachable

pytestmark = pytest.mark.slow

PAPER = spm.Manipulator.paper()
BUILT = PAPER.perturbed(3, length=5e-3, angle=5e-3)
WIDE = spm.LegLimits(0.6, 2.0)
STEP = 1e-7


def rotations(quaternions: Any) -> Any:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), scalar first, times their squared norm."""
    w, v = quaternions[..., 0], quaternions[..., 1:]
    cross = np.cross(v[..., None, :], np.eye(3), axis=-1)
    square = (w * w - (v * v).sum(axis=-1))[..., None, None]
    return square * np.eye(3) + 2.0 * (v[..., :, None] * v[..., None, :] - w[..., None, None] * cross)


class Loops:
    """Both platforms' poses (14,), (o, q) of {mid} in {B} and of {m} in {B}, and what they have to satisfy."""

    def __init__(self, machine: spm.Manipulator, target: Any, limits: spm.LegLimits) -> None:
        self.machine, self.limits = machine, limits
        self.joints = target.apply(machine.platform_joints)

    def parts(self, x: Any) -> tuple[Any, Any, Any, Any]:
        legs = self.machine.legs
        middle, platform = rotations(x[..., 3:7]), rotations(x[..., 10:14])
        balls = x[..., None, 0:3] + legs.balls @ middle.swapaxes(-1, -2)
        # Those of the upper stage seen from the platform.
        balls[..., 3:, :] = (balls[..., 3:, :] - x[..., None, 7:10]) @ platform
        return balls, balls - legs.pivots, platform, x[..., 7:10]

    def distance2(self, x: Any) -> Any:
        _, _, platform, place = self.parts(x)
        gap = place[..., None, :] + self.machine.platform_joints @ platform.swapaxes(-1, -2) - self.joints
        return (gap * gap).sum(axis=(-1, -2)) / 3.0

    def equations(self, x: Any) -> Any:
        """Balls in their legs' planes, quaternions of length one."""
        _, along, _, _ = self.parts(x)
        norms = [(x[..., k : k + 4] ** 2).sum(axis=-1, keepdims=True) - 1.0 for k in (3, 10)]
        return np.concatenate([(along * self.machine.legs.axes).sum(axis=-1), *norms], axis=-1)

    def readings(self, x: Any) -> Any:
        return np.linalg.norm(self.parts(x)[1], axis=-1) + self.machine.legs.offsets

    def room(self, x: Any) -> Any:
        """Readings within the limits, and six forces of each stage that are independent: in units as at home."""
        balls, along, _, _ = self.parts(x)
        forces = [along / np.linalg.norm(along, axis=-1, keepdims=True), self.machine.legs.axes + 0.0 * along]
        rows = [np.concatenate([force, np.cross(balls, force)], axis=-1) for force in forces]
        stages = [np.concatenate([row[..., 3 * k : 3 * k + 3, :] for row in rows], axis=-2) for k in range(2)]
        determinants = np.stack([np.linalg.det(stage) for stage in stages], axis=-1)
        return np.concatenate(
            [self.readings(x) - self.limits.minimum, self.limits.maximum - self.readings(x), determinants], axis=-1
        )

    def nearest(self, starts: Any) -> list[tuple[float, Any]]:
        """Distances and unknowns where SLSQP ends from the starts (n, 14) with all equations satisfied."""
        signs = np.ones(14)
        signs[12:] = np.sign(self.room(starts[0])[12:])
        constraints = [("eq", self.equations), ("ineq", lambda x: signs * self.room(x))]
        options = [{"type": kind, "fun": f, "jac": slopes(f)} for kind, f in constraints]
        ends = []
        for start in starts:
            end: Any = minimize(
                self.distance2,
                start,
                jac=slopes(self.distance2),
                method="SLSQP",
                constraints=options,
                options={"maxiter": 200, "ftol": 1e-13},
            )
            worst = max(np.abs(self.equations(end.x)).max(), *(-f["fun"](end.x).min() for f in options[1:]), 0.0)
            if worst < 1e-9:
                ends.append((float(np.sqrt(self.distance2(end.x))), end.x))
        return sorted(ends, key=lambda end: end[0])


def slopes(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Derivatives by central differences, all evaluated at once."""
    steps = STEP * np.eye(14)
    return lambda x: np.moveaxis((function(x + steps) - function(x - steps)) / (2.0 * STEP), 0, -1)


def unknowns(states: spm.Configuration) -> Any:
    """The unknowns (n, 14) of states (n,)."""
    parts = []
    for pose in (states.middle_pose, states.pose):
        quaternions = pose.rotation.as_quat(scalar_first=True)
        parts += [pose.translation, quaternions]
    return np.concatenate(parts, axis=-1)


def is_reached(machine: spm.Manipulator, x: Any) -> bool:
    """Whether the pose is reached within the limits, in the physical mode."""
    wider = spm.LegLimits(np.array(WIDE.minimum) - 1e-6, np.array(WIDE.maximum) + 1e-6)
    pose = spm.pose(x[7:10], rotation=Rotation.from_quat(x[10:14], scalar_first=True))
    return bool(reachable(machine, pose, wider).reachable)


@pytest.mark.parametrize("machine", [PAPER, BUILT], ids=["nominal", "calibrated"])
def test_no_search_from_random_states_ends_nearer(machine: spm.Manipulator) -> None:
    rng, compared = np.random.default_rng(47), 0
    for _ in range(12):
        place, turn = rng.uniform([-1.0, -1.0, 0.3], [1.0, 1.0, 2.8]), Rotation.from_rotvec(rng.normal(size=3))
        target = spm.pose(place, rotation=turn)
        states = spm.forward_physical(machine, rng.uniform(0.6, 2.0, (60, 6)))
        states = states[np.flatnonzero(states.exists)[:16]]
        ends = Loops(machine, target, WIDE).nearest(unknowns(states))
        least = min((distance for distance, x in ends if is_reached(machine, x)), default=np.inf)
        assert nearest_reachable_pose(machine, target, WIDE).distance < least + 1e-4
        compared += least < np.inf
    assert compared >= 10
