"""Fastest motions of stages, against the times of trapezoids and the balance of Pinocchio's energies."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from balancers import stage_and_height
from error_fields import with_fields

import spm_pin as spm
from spm_pin.errors import ArgumentError

MACHINES = ["RPS", "PRS as built", "RRS", "RRS as built"]


def problem(machine: str) -> tuple[spm.ClosedChain, spm.motion.MotionPlan, spm.motion.MotionPlan]:
    """Return a chain, and plans between two states of it, in readings and in tilts."""
    stage, height = stage_and_height(machine)
    start = spm.inverse_physical(stage, height, tilt=0.1, azimuth=0.5)
    goal = spm.inverse_physical(stage, 1.05 * height, tilt=0.15, azimuth=-2.0)
    chain = spm.ClosedChain.from_urdf(machine=stage)
    return chain, spm.plan(stage, start, goal), spm.plan(stage, start, goal, line="poses")


@pytest.mark.parametrize("machine", MACHINES)
def test_a_line_of_readings_takes_the_time_of_a_trapezoid(machine: str) -> None:
    chain, plan, _ = problem(machine)
    distance = np.abs(np.diff(plan.path([0.0, 1.0]).lengths, axis=0)).max()
    rate, acceleration = 2.0 * distance, 10.0 * distance
    motion = spm.time_optimal(chain, plan, leg_rates=rate, leg_accelerations=acceleration, grid=200)
    assert motion.times[-1] == pytest.approx(distance / rate + rate / acceleration, rel=1e-3)
    assert motion.readings.shape[1] == 3
    np.testing.assert_allclose(np.abs(motion.velocities[:, chain.leg_indices]).max(), rate, rtol=1e-5)


@pytest.mark.parametrize(
    ("machine", "of_poses"), [("RPS", False), ("PRS as built", True), ("RRS", False), ("RRS as built", True)]
)
def test_the_power_of_the_actuators_changes_the_energy(machine: str, of_poses: bool) -> None:
    chain, *plans = problem(machine)
    distance = np.abs(np.diff(plans[0].path([0.0, 1.0]).lengths, axis=0)).max()
    limits = {"leg_accelerations": 8.0 * distance, "leg_rates": 3.0 * distance}
    motion = spm.time_optimal(chain, plans[of_poses], **limits, grid=100)
    # Not in the middle, where the acceleration jumps.
    at, h = np.array([0.07, 0.2, 0.31, 0.43, 0.61, 0.78, 0.93]) * motion.times[-1], 1e-5
    here, ahead, behind = (motion.at(at + shift) for shift in (0.0, h, -h))
    assert chain.state(here.positions).closure_gap().max() < 1e-9
    np.testing.assert_allclose((ahead.positions - behind.positions) / (2.0 * h), here.velocities, atol=1e-4)

    def energy(q: np.ndarray, v: np.ndarray) -> float:
        model, data = chain.model, chain.model.createData()
        return float(pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q))

    energies = [[energy(*pair) for pair in zip(x.positions, x.velocities, strict=True)] for x in (ahead, behind)]
    rates = np.subtract(*energies) / (2.0 * h)
    legs = chain.leg_indices
    power = (here.efforts[:, legs] * here.velocities[:, legs]).sum(axis=-1)
    np.testing.assert_allclose(power, rates, rtol=1e-4, atol=1e-4 * np.abs(power).max())


def test_forces_and_jerks_of_three_legs_limit_the_motion() -> None:
    chain, plan, _ = problem("RPS")
    held = np.abs(spm.time_optimal(chain, plan, leg_accelerations=0.01, grid=50).efforts).max()
    motion = spm.time_optimal(chain, plan, leg_forces=[1.5 * held, 1.6 * held, 1.7 * held], grid=200)
    used = np.abs(motion.efforts[:, chain.leg_indices]) / (held * np.array([1.5, 1.6, 1.7]))
    assert used.max() == pytest.approx(1.0, abs=1e-6)
    gentle = spm.time_optimal(chain, plan, leg_accelerations=1.0, leg_jerks=[10.0, 12.0, 14.0], grid=100)
    np.testing.assert_allclose(gentle.accelerations[[0, -1]], 0.0, atol=1e-3)


def test_limits_of_another_number_of_legs_are_refused() -> None:
    chain, plan, _ = problem("RRS")
    for name, value in (("leg_rates", [1.0] * 6), ("leg_forces", [1.0] * 6), ("leg_jerks", np.ones((2, 3)))):
        with pytest.raises(ArgumentError, check=with_fields(argument=name)):
            spm.time_optimal(chain, plan, **{"leg_accelerations": 1.0, name: value})
    with pytest.raises(spm.GeometryError):
        spm.time_optimal(spm.ClosedChain.from_urdf(), plan, leg_accelerations=1.0)
