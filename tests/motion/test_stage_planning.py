"""Plans of stages, between states of a tilt and a height or between readings."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from balancers import MACHINES, STAGES, forward_determinants, stage_and_height
from error_fields import with_fields

import spm_pin as spm
from spm_pin.errors import ArgumentError, GeometryError, UnreachableError
from spm_pin.machine import Configuration
from spm_pin.motion import LegPath, MotionPlan
from spm_pin.workspace import JointLimits


def two_states(stage: spm.Stage, height: float) -> tuple[Configuration]:
    return (
        spm.inverse_physical(stage, height, tilt=0.1, azimuth=0.5),
        spm.inverse_physical(stage, 1.02 * height, tilt=0.15, azimuth=-2.0),
    )


@pytest.mark.parametrize("machine", MACHINES)
def test_a_line_of_readings_leads_from_one_state_to_the_other(machine: str) -> None:
    stage, height = stage_and_height(machine)
    start, goal = two_states(stage, height)
    plan = spm.plan(stage, start, goal)
    assert (type(plan), type(plan.path), plan.machine) == (MotionPlan, LegPath, stage)
    assert plan.method == "straight in leg lengths"
    states = plan.configurations(400)
    assert states.exists.all()
    assert states.closure_residual.max() < 1e-12 * stage.size
    np.testing.assert_allclose(states.readings, np.linspace(start.readings, goal.readings, 400), atol=1e-12)
    np.testing.assert_allclose(states.balls[[0, -1]], [start.balls, goal.balls], atol=1e-9 * stage.size)
    # One mode: no jump, and no change of the determinant's sign.
    steps = np.linalg.norm(np.diff(states.balls, axis=0), axis=-1)
    assert steps.max() < 3.0 * np.linalg.norm(goal.balls - start.balls, axis=-1).max() / 400
    values = forward_determinants(states)
    assert values.min() > 0.0
    assert plan.margin == pytest.approx(values.min(), rel=1e-3)


@pytest.mark.parametrize("machine", MACHINES)
def test_a_line_of_tilts_and_heights_leads_from_one_state_to_the_other(machine: str) -> None:
    stage, height = stage_and_height(machine)
    start, goal = two_states(stage, height)
    states = spm.plan(stage, start, goal, line="poses").configurations(101)
    assert states.exists.all()
    np.testing.assert_allclose(states.balls[[0, -1]], [start.balls, goal.balls], atol=1e-9 * stage.size)
    np.testing.assert_allclose(states.height, np.linspace(start.height, goal.height, 101), atol=1e-12)
    turns = np.linalg.norm(np.cross(states.normal[:-1], states.normal[1:]), axis=-1)
    np.testing.assert_allclose(turns, turns.mean(), rtol=2e-2)
    assert forward_determinants(states).min() > 0.0


@pytest.mark.parametrize("name", ["RPS", "PRS", "RRS"])
def test_a_plan_passes_states_and_is_certified_within_certified_limits(name: str) -> None:
    stage, height = stage_and_height(name)
    start, goal = two_states(stage, height)
    level = spm.inverse_physical(stage, height)
    around = np.stack([x.readings for x in (start, level, goal)])
    half = 1.2 * np.abs(around - level.readings).max()
    limits = (level.readings.min() - half, level.readings.max() + half)
    certificate = spm.certify(stage, limits)
    assert certificate.holds
    plan = spm.plan(stage, around[0], around[2], limits, via=[level], certificate=certificate)
    assert plan.certified
    readings = plan.configurations(401).readings
    assert np.abs(readings - level.readings).max(axis=-1).min() < 1e-3 * half
    assert certificate.covers(plan.configurations()).all()
    assert spm.plan(stage, start, goal, limits, line="poses", certificate=certificate).certified


def test_a_way_around_keeps_the_margin_that_the_line_breaks() -> None:
    stage, margin = STAGES["PRS"], 0.5955
    ends = [[0.33352063, 0.15050152, 0.24565498], [0.22296916, 0.14067669, 0.34291781]]
    line = spm.forward_physical(stage, np.linspace(*ends, 300))
    assert forward_determinants(line).min() < margin < forward_determinants(line)[[0, -1]].min()
    plan = spm.plan(stage, *ends, margin=margin)
    assert plan.method == "around"
    assert "a forward singularity is near" in plan.reason
    assert forward_determinants(plan.configurations(300)).min() > margin - 1e-3


def test_limits_of_joints_are_rules() -> None:
    stage, height = stage_and_height("RPS")
    start, goal = two_states(stage, height)
    states = spm.plan(stage, start, goal).configurations(50)
    hips = spm.machine.joint_angles(states).passive
    assert spm.plan(stage, start, goal, joint_limits=JointLimits(hip=(hips.min() - 1e-3, hips.max() + 1e-3))).exists
    with pytest.raises(UnreachableError, check=with_fields(argument="start")):
        spm.plan(stage, start, goal, joint_limits=JointLimits(hip=(hips.max() - 1e-3, hips.max() + 1e-3)))


def test_wrong_arguments_are_named() -> None:
    stage, height = stage_and_height("RRS")
    start, goal = two_states(stage, height)
    paper, robot = spm.Manipulator.paper(), spm.forward_physical(spm.Manipulator.paper(), [1.3] * 6)
    for argument, error, call in (
        *(
            ("goal", ArgumentError, partial(spm.plan, stage, start, x))
            for x in (start.pose, np.eye(4), [0.1, 0.2], None)
        ),
        ("start", ArgumentError, partial(spm.plan, stage, spm.inverse_physical(stage, [height]), goal)),
        ("goal", GeometryError, partial(spm.plan, stage, start, robot)),
        ("start", GeometryError, partial(spm.plan, paper, start, robot)),
        ("limits", GeometryError, partial(spm.plan, stage, start, goal, spm.LegLimits.stages((0.1, 0.9), (0.1, 0.8)))),
        ("goal", UnreachableError, partial(spm.plan, stage, start, [2.9, -1.0, 2.9])),
        ("lengths", ArgumentError, partial(LegPath, np.ones((2, 4)))),
    ):
        with pytest.raises(error, check=with_fields(argument=argument)):
            call()
    with pytest.raises(ArgumentError, check=with_fields(argument="certificate")):
        spm.plan(stage, start, goal, certificate=spm.certify(STAGES["PRS"], (0.1, 0.15)))


def test_the_search_stays_within_a_turn_of_the_cranks() -> None:
    # Lengths of the rods beyond start and goal would be readings that no function takes.
    stage = spm.Stage(0.062, 0.075, spm.RRS(crank=0.04, rod=0.085))
    plan = spm.plan(stage, spm.inverse_physical(stage, height=0.09), [-6.2, 0.0, 0.0], tries=200)
    assert not plan.exists
