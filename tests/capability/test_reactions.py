"""Reactions at the legs' joints, against equilibrium, and the forces in Pinocchio's closures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.capability import joint_reactions, velocity_polytope, wrench_polytope
from spm_pin.machine import PRS, RRS, Stage

PAPER = spm.Manipulator.paper()
MACHINE = PAPER.perturbed(2, length=0.01, angle=0.02)
SERVOS, SCREWS = Stage(0.7, 0.46, RRS(crank=0.5, rod=1.0)), Stage(0.35, 0.46, PRS(rod=1.0, direction=1.4))
MIXED = spm.Manipulator.of_stages(SERVOS, SCREWS).perturbed(2, length=0.01, angle=0.02)
LENGTHS = [[1.20, 1.20, 1.40, 1.25, 1.20, 1.50], [1.30, 1.42, 1.17, 1.22, 1.36, 1.28]]
READINGS = [[0.5, 0.6, 0.7, 0.2, 0.25, 0.3], [0.7, 0.4, 0.5, 0.3, 0.2, 0.15]]
WRENCH = np.array([30.0, -20.0, -50.0, 4.0, 3.0, -2.0])


def leg_loads(states: spm.Configuration) -> tuple[np.ndarray, np.ndarray]:
    """Return the force (..., 6, 3) that each leg exerts on what it carries, and where its line passes: the ball."""
    reactions = joint_reactions(states)
    along = states.leg_vectors / np.linalg.norm(states.leg_vectors, axis=-1, keepdims=True)
    axial = (reactions.axial @ WRENCH)[..., None]
    return (spm.leg_forces(states, WRENCH) / states.slopes)[..., None] * along + axial * states.leg_axes, states.balls


@pytest.mark.parametrize("machine", [PAPER, MACHINE, MIXED], ids=["drawn", "as built", "servos and screws"])
def test_both_platforms_are_in_equilibrium(machine: spm.Manipulator) -> None:
    states = spm.forward_physical(machine, READINGS if machine is MIXED else LENGTHS)
    assert states.exists.all()
    forces, points = leg_loads(states)
    o = states.translation[:, None]
    for legs in (slice(3), slice(3, 6)):
        part, arms = forces[:, legs], points[:, legs] - o
        np.testing.assert_allclose(part.sum(axis=1), -np.broadcast_to(WRENCH[:3], (2, 3)), atol=1e-9)
        moment = np.cross(arms, part).sum(axis=1)
        np.testing.assert_allclose(moment, -np.broadcast_to(WRENCH[3:], (2, 3)), atol=1e-9)


@pytest.mark.parametrize("machine", [PAPER, MACHINE], ids=["drawn", "as built"])
def test_the_forces_in_the_cut_balls_are_those_of_pinocchio(machine: spm.Manipulator) -> None:
    states = spm.forward_physical(machine, LENGTHS)
    chain = spm.ClosedChain.from_urdf(machine=machine)
    cuts = chain.state(chain.joint_values(states)).cut_forces(WRENCH)
    forces, _ = leg_loads(states)
    for number, closure in enumerate(chain.closures):
        name = f"{closure.frame_a} {closure.frame_b}"
        leg = next(k for k, leg in enumerate(spm.machine.LEGS) if f"leg_{leg[2:]}_" in name)
        # Onto the leg, or onto the middle platform: of an upper leg the force goes on, a lower leg's is answered.
        sign = (1.0 if "leg_" in closure.frame_b else -1.0) * (1.0 if leg >= 3 else -1.0)
        np.testing.assert_allclose(sign * cuts[:, number], forces[:, leg], atol=1e-9)


def test_bending_is_the_moment_of_the_ball_s_force_about_the_pivot() -> None:
    states = spm.forward_physical(MACHINE, LENGTHS)
    forces, balls = leg_loads(states)
    # The pivot of a lower leg is at its foot; an upper leg's ball is at the foot.
    moments = np.cross(balls - states.leg_bases, forces)
    towards = states.leg_vectors / states.leg_lengths[..., None]
    about = np.cross(towards, states.leg_axes)
    sign = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    found = joint_reactions(states).bending @ WRENCH
    np.testing.assert_allclose(found, sign * (moments * about).sum(axis=-1), rtol=1e-9, atol=1e-9)
    # Of legs without an offset of the ball along the axis nothing else acts about the axis or the leg.
    np.testing.assert_allclose(np.linalg.norm(moments, axis=-1), np.abs(found), rtol=0.05)


def test_joints_of_servos_and_screws_bear_the_moments_of_the_ball_s_force() -> None:
    states = spm.forward_physical(MIXED, READINGS)
    forces, balls = leg_loads(states)
    reactions = joint_reactions(states)
    for rows, points in ((reactions.bending, states.circle_centres), (reactions.pivot, states.leg_bases)):
        arms = balls - points
        along_axis = (np.cross(arms, forces) * states.leg_axes).sum(axis=-1)
        moments = np.cross(arms, forces) - along_axis[..., None] * states.leg_axes
        # Beside what turns about the axis, but for balls that are off their leg's plane by the errors of this machine.
        np.testing.assert_allclose(np.abs(rows @ WRENCH), np.linalg.norm(moments, axis=-1), rtol=1e-9)
    # A servo exerts the moment about its shaft; about the knees and on the carriages nothing turns.
    shafts = (np.cross(balls - states.leg_bases, forces) * states.leg_axes).sum(axis=-1)[:, :3]
    np.testing.assert_allclose(np.abs(shafts), np.abs(spm.leg_forces(states, WRENCH)[:, :3]), rtol=1e-9)


def test_polytopes_of_servos_and_screws_are_those_of_efforts_and_rates() -> None:
    """Against virtual work and rates by differences of the displacement: nothing of κ is used."""
    states, h = spm.forward_physical(MIXED, READINGS), 1e-6
    columns = []
    for step in h * np.eye(6):
        ends = [spm.forward_physical(MIXED, states.readings + s * step) for s in (1, -1)]
        turn = Rotation.from_matrix(ends[0].rotation @ ends[1].rotation.mT).as_rotvec()
        columns.append(np.concatenate([ends[0].translation - ends[1].translation, turn], axis=-1) / (2.0 * h))
    moved = np.stack(columns, axis=-1)
    limits = np.array([8.0, 9.0, 10.0, 100.0, 120.0, 140.0])
    held, fast = wrench_polytope(states, limits), velocity_polytope(states, limits)
    efforts = -held.vertices @ moved
    np.testing.assert_allclose(np.abs(efforts), np.broadcast_to(limits, efforts.shape), rtol=1e-6)
    rates = fast.vertices @ np.linalg.inv(moved).mT
    np.testing.assert_allclose(np.abs(rates), np.broadcast_to(limits, rates.shape), rtol=1e-6)


@pytest.mark.documents
def test_the_numbers_of_the_page_on_capability() -> None:
    state = spm.forward_physical(PAPER, [1.20, 1.20, 1.40, 1.25, 1.20, 1.40])
    held, reactions = wrench_polytope(state, 1000.0), joint_reactions(state)
    limited = held.within(reactions.bending, 250.0).within(reactions.ball, 1500.0)
    assert held.ball() == pytest.approx(509.0, abs=0.5)
    assert limited.ball() == pytest.approx(274.0, abs=0.5)
    chain = spm.ClosedChain.from_urdf()
    gravity = chain.state(chain.joint_values(state)).platform_dynamics().gravity
    down = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    assert held.extent(down) == pytest.approx(1065.0, abs=0.5)
    assert wrench_polytope(state, 1000.0, load=-gravity).extent(down) == pytest.approx(464.0, abs=0.5)
