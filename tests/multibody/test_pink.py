"""Pink, unmodified: the closures are an equality constraint of its quadratic program."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody.chains import Array, chain

pink = pytest.importorskip("pink")
pytest.importorskip("daqp")


class ClosureTask(pink.Task):
    def __init__(self, robot: Any) -> None:
        super().__init__(cost=1.0)
        self.robot = robot

    def compute_error(self, configuration: Any) -> Array:
        return np.asarray(self.robot.closure_gap(configuration.q).ravel())

    def compute_jacobian(self, configuration: Any) -> Array:
        return np.asarray(self.robot.constraint_jacobian(configuration.q))

    def __repr__(self) -> str:
        return "ClosureTask()"


def test_inverse_kinematics_reaches_the_pose_with_closed_loops() -> None:
    import pinocchio as pin

    robot = chain()
    wrapper = robot.robot_wrapper()
    q = robot.forward_kinematics([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    goal = robot.configuration(robot.forward_kinematics([1.25, 1.18, 1.38, 1.22, 1.25, 1.42], q))
    task = pink.tasks.FrameTask("terminal_platform", position_cost=1.0, orientation_cost=1.0)
    task.set_target(pin.SE3(goal.rotation.copy(), goal.translation.copy()))
    configuration = pink.Configuration(wrapper.model, wrapper.data, q)
    worst = 0.0
    for _ in range(400):
        v = pink.solve_ik(configuration, [task], 0.01, solver="daqp", constraints=[ClosureTask(robot)], damping=1e-9)
        configuration.integrate_inplace(v, 0.01)
        worst = max(worst, float(np.abs(robot.closure_gap(configuration.q)).max()))
    assert np.abs(task.compute_error(configuration)).max() <= 1e-6
    # A step of 10 ms opens the loops to second order, and the next one closes them.
    assert worst <= 1e-3
    assert np.abs(robot.closure_gap(configuration.q)).max() <= 1e-9
