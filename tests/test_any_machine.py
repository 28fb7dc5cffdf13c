"""Every function takes any machine: small errors of its legs move its answers little, and large ones do move them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import spm_pin as spm

PAPER = spm.Manipulator.paper()
READINGS = np.array([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
ENDS = np.array([[1.3, 1.2, 1.4, 1.25, 1.2, 1.45], [1.35, 1.25, 1.2, 1.3, 1.25, 1.4]])
WRENCH = np.array([-20.0, -30.0, -60.0, 3.0, 2.0, 1.0])
TWIST = np.array([0.1, 0.2, 0.3, 0.1, -0.2, 0.3])


def state(machine: spm.Manipulator) -> spm.Configuration:
    return spm.forward_physical(machine, READINGS)


def held_pose(machine: spm.Manipulator) -> spm.Configuration:
    """One pose for all machines."""
    return spm.inverse_physical(machine, state(PAPER).pose, near=state(PAPER))


def chain(machine: spm.Manipulator) -> spm.ClosedChain:
    return spm.ClosedChain.from_urdf(machine=machine)


def q(machine: spm.Manipulator) -> np.ndarray:
    return chain(machine).joint_values(state(machine))


VALUES: dict[str, Callable[[spm.Manipulator], Any]] = {
    "compliance": lambda g: spm.kinematics.compliance(state(g), 2e7, 5e7),
    "determinant_gradients": lambda g: spm.kinematics.determinant_gradients(state(g)),
    "determinants": lambda g: spm.determinants(state(g)),
    "follow": lambda g: spm.follow(g, ENDS, spm.forward_physical(g, ENDS[0])).configurations.translation[-1],
    "forward_displacement": lambda g: spm.forward_displacement(g, READINGS)["T1+/T1+"].translation,
    "forward_physical": lambda g: state(g).translation,
    "forward_physical, near": lambda g: spm.forward_physical(g, ENDS[0], near=state(g)).translation,
    "inverse_displacement": lambda g: spm.inverse_displacement(g, state(PAPER).pose).physical(state(PAPER)).readings,
    "inverse_jacobian": lambda g: spm.inverse_jacobian(state(g)),
    "inverse_physical": lambda g: held_pose(g).readings,
    "joint_angles": lambda g: spm.machine.joint_angles(state(g)).values,
    "leg_forces": lambda g: spm.leg_forces(state(g), WRENCH),
    "leg_rates": lambda g: spm.leg_rates(state(g), TWIST),
    "leg_vectors": lambda g: state(g).leg_vectors,
    "platform_jacobian": lambda g: spm.kinematics.platform_jacobian(state(g)),
    "singularities": lambda g: spm.singularities(state(g)).sigma,
    "stiffness": lambda g: spm.stiffness(state(g), 2e7),
    "chain.forward_kinematics": lambda g: chain(g).forward_kinematics(READINGS),
    "chain.inverse_jacobian": lambda g: chain(g).state(q(g)).inverse_jacobian(),
    "chain.leg_forces": lambda g: chain(g).state(q(g)).leg_forces(WRENCH),
    "chain.forward_dynamics": lambda g: chain(g).state(q(g)).forward_dynamics(np.full(6, 500.0)),
    "motion.plan": lambda g: spm.plan(g, ENDS[0], ENDS[1]).configurations(3).translation[1],
    "workspace.nearest_reachable_pose": lambda g: (
        spm.workspace.nearest_reachable_pose(g, spm.pose([0.9, 0.1, 2.2], xyx=[0.1, 0.2, 0.1])).configuration.readings
    ),
    "nlp.search": lambda g: spm.crosscheck.nlp.search(g, state(PAPER).pose).solutions.nearest(state(PAPER)).readings,
    "workspace.leg_clearance": lambda g: spm.workspace.leg_clearance(state(g)),
    "certify": lambda g: list(spm.certify(g, spm.LegLimits(1.25, 1.35)).bounds),
}

REFUSED: dict[str, Callable[[spm.Manipulator], Any]] = {
    "the paper's shell": lambda g: spm.crosscheck.workspace_shell(g),
}


@pytest.mark.parametrize("name", VALUES)
def test_answers_are_those_of_the_machine(name: str) -> None:
    drawn, slight, wrong = (
        np.asarray(VALUES[name](PAPER.perturbed(5, length=size, angle=size)), dtype=float) for size in (0.0, 1e-9, 2e-3)
    )
    scale = np.abs(drawn).max()
    assert np.isfinite(wrong).all()
    np.testing.assert_allclose(slight, drawn, rtol=0, atol=1e-5 * scale)
    assert np.abs(wrong - drawn).max() > 1e-5 * scale, "the errors of the legs change nothing"


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_for_drawn_machines_alone_refuses_by_name(name: str) -> None:
    with pytest.raises(spm.GeometryError, match="nominal machine"):
        REFUSED[name](PAPER.perturbed(5))
