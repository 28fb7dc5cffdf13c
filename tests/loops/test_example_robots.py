"""The robots of examples/robots: mobility, gaps as MuJoCo measures them, both ways, forces, closed forms of stages."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import pytest

import spm_pin as spm
from spm_pin.loops.closed_chain import ClosedChain
from tests.loops.robots import pose_of

ROBOTS = Path(__file__).parents[2] / "examples/robots"
MOBILITY = {
    "four_bar": (1, 1, 2),
    "five_bar": (2, 2, 2),
    "ankle": (2, 2, 6),
    "delta": (3, 3, 18),
    "stewart": (6, 6, 18),
    "tricept": (5, 5, 9),
    "two_3rps": (6, 6, 18),
    "two_3spr": (6, 6, 18),
    "two_3upu": (6, 6, 30),
}
"""Degrees of freedom, actuators, and rank of the closures."""
PLATFORMS = {"four_bar": "coupler", "five_bar": "tip", "ankle": "foot", "tricept": "tool"}
Array = npt.NDArray[np.float64]


@cache
def robot(name: str) -> ClosedChain:
    return ClosedChain.from_mjcf(ROBOTS / f"{name}.xml")


def at(chain: ClosedChain, scale: float, seed: int = 0) -> Array:
    """Return q at actuators near those at rest."""
    home = chain.close()
    values = home[chain.actuated_in_q]
    return chain.forward(values + scale * np.random.default_rng(seed).uniform(-1, 1, size=len(values)), near=home)


def test_every_robot_is_tested() -> None:
    assert {file.stem for file in ROBOTS.glob("*.xml")} == set(MOBILITY)


@pytest.mark.parametrize("name", MOBILITY)
def test_mobility_is_that_of_the_mechanism(name: str) -> None:
    """At their rest pose as well, where some joints stand still for a moment."""
    chain = robot(name)
    for q in (chain.close(), at(chain, 0.02)):
        mobility = chain.mobility(q)
        assert (mobility.dof, mobility.actuated_rank, mobility.rank) == MOBILITY[name]
        assert mobility.is_fully_driven
        assert not mobility.is_singular
        assert mobility.undriven == mobility.redundant == mobility.locked == ()


@pytest.mark.parametrize("name", MOBILITY)
def test_loops_are_closed_as_mujoco_measures_it(name: str) -> None:
    chain = robot(name)
    model = mujoco.MjModel.from_xml_path(str(ROBOTS / f"{name}.xml"))
    data = mujoco.MjData(model)
    q = at(chain, 0.03)
    for joint, label in list(zip(chain.model.joints, chain.model.names, strict=True))[1:]:
        values = q[joint.idx_q : joint.idx_q + joint.nq].copy()
        if joint.nq == 7:
            values[3:] = np.roll(values[3:], 1)
        data.joint(label).qpos[:] = values
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() < 1e-12
    for i in range(1, model.nbody):
        np.testing.assert_allclose(data.xpos[i], pose_of(chain.model, q, model.body(i).name).translation, atol=1e-12)


@pytest.mark.parametrize("name", MOBILITY)
def test_forward_and_inverse_undo_each_other(name: str) -> None:
    chain, frame = robot(name), PLATFORMS.get(name, "platform")
    near = at(chain, 0.05, seed=2)  # symmetric poses at rest are singular
    values = near[chain.actuated_in_q]
    q = chain.forward(values + 0.003 * np.random.default_rng(1).uniform(-1, 1, size=len(values)), near=near)
    rows = {"four_bar": (4,), "five_bar": (0, 2), "ankle": (3, 4), "delta": (0, 1, 2), "tricept": (0, 1, 2, 3, 4)}
    again = chain.inverse(
        frame, pose_of(chain.model, q, frame).homogeneous, near=near, rows=rows.get(name, (0, 1, 2, 3, 4, 5))
    )
    np.testing.assert_allclose(again[chain.actuated_in_q], q[chain.actuated_in_q], atol=1e-9)


@pytest.mark.parametrize("name", MOBILITY)
def test_the_power_of_holding_forces_is_that_of_gravity(name: str) -> None:
    chain = robot(name)
    q = at(chain, 0.02)
    values, tau = q[chain.actuated_in_q], chain.state(q).holding_forces()
    step, data = 1e-6, chain.model.createData()
    slopes = []
    for k in range(len(values)):
        moved = [chain.forward(values + sign * step * np.eye(len(values))[k], near=q) for sign in (-1, 1)]
        low, high = (pin.computePotentialEnergy(chain.model, data, m) for m in moved)
        slopes.append((high - low) / (2 * step))
    np.testing.assert_allclose(tau, slopes, rtol=1e-6, atol=1e-6)


def as_stage(found: Any) -> tuple[Array, Array]:
    """Return translation and rotation in the axes of a `Stage`, whose leg 1 is at −30° instead of 0°."""
    turned = pin.exp3(np.array([0.0, 0.0, -np.pi / 6]))
    return turned @ found.translation, turned @ found.rotation @ turned.T


def test_the_stage_of_two_3rps_is_its_closed_form() -> None:
    chain, stage = robot("two_3rps"), spm.Stage(base_radius=0.2, platform_radius=0.11)
    home = chain.close()
    for tilt, azimuth, height in ((0.1, 0.3, 0.41), (0.2, 2.0, 0.39), (0.3, 4.0, 0.4)):
        state = spm.inverse_physical(stage, height=height, tilt=tilt, azimuth=azimuth)
        q = chain.forward([*state.readings, 0.41, 0.41, 0.41], near=home)
        translation, rotation = as_stage(pose_of(chain.model, q, "middle"))
        np.testing.assert_allclose(translation, state.translation, atol=1e-12)
        np.testing.assert_allclose(rotation, state.rotation, atol=1e-12)


def test_the_stage_of_two_3spr_is_the_closed_form_upside_down() -> None:
    chain, stage = robot("two_3spr"), spm.Stage(base_radius=0.11, platform_radius=0.2)
    home = chain.close()
    turned = pin.SE3(
        np.diag([1.0, -1.0, -1.0]), np.zeros(3)
    )  # seen from the platform that has the hinges, legs 1 and 2 exchanged
    for tilt, azimuth, height in ((0.1, 0.3, 0.41), (0.2, 2.0, 0.39)):
        state = spm.inverse_physical(stage, height=height, tilt=tilt, azimuth=azimuth)
        q = chain.forward([*state.readings[[0, 2, 1]], 0.41, 0.41, 0.41], near=home)
        translation, rotation = as_stage(turned * pose_of(chain.model, q, "middle").inverse() * turned)
        np.testing.assert_allclose(translation, state.translation, atol=1e-12)
        np.testing.assert_allclose(rotation, state.rotation, atol=1e-12)


def test_the_lower_3upu_turns_about_its_centre_and_the_upper_one_translates() -> None:
    chain = robot("two_3upu")
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))  # in the platform between
    for seed in range(3):
        q = at(chain, 0.02, seed)
        middle, platform = (pose_of(chain.model, q, name) for name in ("middle", "platform"))
        np.testing.assert_allclose((middle * centre).translation, [0.0, 0.0, 0.4], atol=1e-12)
        np.testing.assert_allclose(platform.rotation, middle.rotation, atol=1e-12)
        assert np.abs(pin.log3(middle.rotation)).max() > 1e-2


def test_a_four_bar_is_the_closed_form_of_its_loop() -> None:
    """Freudenstein's equation of the lengths said in the file: ground .3, crank .1, coupler √.1, rocker .2."""
    chain = robot("four_bar")
    q = chain.close()
    for turn in np.linspace(0.0, 1.0, 11):
        q = chain.forward([turn], near=q)
        crank, rocker = (np.pi / 2 + q[chain.indices_in_q(name)[0]] for name in ("crank", "rocker"))
        k = (0.3**2 + 0.1**2 + 0.2**2 - 0.1) / (2 * 0.1 * 0.2)
        assert 0.3 / 0.1 * np.cos(rocker) - 0.3 / 0.2 * np.cos(crank) + k == pytest.approx(
            np.cos(crank - rocker), abs=1e-12
        )
