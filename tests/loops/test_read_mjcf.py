"""The reader of MJCF files: places, gaps and masses are those of MuJoCo; what it cannot keep is refused by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from loops.damaged_files import count_refused

from spm_pin.errors import DescriptionError
from spm_pin.loops.closures import RobotDescription, find_frame
from spm_pin.loops.read_mjcf import read_mjcf
from tests.loops.robots import ends_of

EVERYTHING = """<mujoco model="everything">
  <option gravity="0.1 -0.2 -9.7"/>
  <worldbody>
    <site name="dock" pos="0.3 0.2 0.1" euler="10 20 30"/>
    <body name="tower" pos="1 0 0.2" euler="10 20 30">
      <joint name="turn" axis="1 2 3" pos=".1 .2 .3" ref="20" range="-30 40" limited="true"/>
      <joint name="lift" type="slide" axis="0 1 1" ref="0.3" armature="0.2" damping="0.5" frictionloss="0.7"/>
      <geom type="box" size=".1 .2 .3" pos=".1 .2 0" euler="30 10 0"/>
      <site name="eye" pos=".1 0 0" euler="0 30 0"/>
      <body name="fixed" pos="0 .3 0" euler="0 0 40">
        <geom size=".1" pos="0 0 .2"/>
        <body name="arm" pos="0 1 0">
          <joint name="shoulder" type="ball" pos="0 .1 .2"/>
          <geom type="capsule" fromto="0 0 0 .1 .4 .2" size=".05"/>
          <site name="arm" pos="0 0.4 0"/>
          <body name="hand" pos="0 .5 0"><joint axis="0 0 1"/><geom size=".1"/></body>
        </body>
      </body>
    </body>
    <body name="drone" pos="0 0 2" euler="30 0 0">
      <freejoint name="flight"/>
      <geom type="box" size=".3 .2 .1" pos="0 .1 0"/>
      <body name="rotor" pos="0 0 .2"><joint name="spin" axis="0 0 -1"/><geom type="box" size=".3 .02 .02"/></body>
    </body>
    <body name="cart"><joint name="drive" type="slide" axis="1 0 0"/><geom size=".2"/></body>
  </worldbody>
  <equality>
    <connect name="tie" body1="hand" body2="drone" anchor="0.1 0.2 0.3"/>
    <connect name="pinned" body1="cart" anchor="0.1 0 0.3"/>
    <connect name="by_sites" site1="eye" site2="arm"/>
    <connect name="off" body1="tower" body2="cart" anchor="0 0 0" active="false"/>
    <weld name="glue" body1="rotor" body2="cart" anchor="0.1 0.2 0.4" relpose="0.3 0.2 0.1 0.8 0.2 0.4 0.4"/>
    <weld name="dock" site1="dock" site2="eye"/>
    <joint name="gear" joint1="lift" joint2="turn" polycoef="0.1 0.2 0.3 0.4 0.5"/>
    <joint name="stop" joint1="spin" polycoef="0.7 0 0 0 0"/>
  </equality>
  <actuator><motor joint="spin"/><position joint="lift"/><velocity joint="lift"/></actuator>
  <keyframe>
    <key name="up" qpos=".3 .2 1 1 0 0 .1  1 2 3 0 0 1 0 .4 .5"/>
    <key qpos="0 0 1 0 0 0 0  0 0 0 1 0 0 0 0 0"/>
  </keyframe>
</mujoco>"""


def qpos_of(robot: RobotDescription, q: Any) -> Any:
    """MuJoCo's qpos: quaternions have their scalar first."""
    qpos = q.copy()
    for joint in robot.model.joints[1:]:
        if joint.nq > 1:
            end = joint.idx_q + joint.nq
            qpos[end - 4 : end] = np.roll(q[end - 4 : end], 1)
    return qpos


def efc_gaps(model: Any, data: Any, name: str) -> Any:
    rows = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (data.efc_id == model.equality(name).id)
    return data.efc_pos[rows]


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return read_mjcf(EVERYTHING)


def test_names_actuators_and_keyframes(robot: RobotDescription) -> None:
    assert list(robot.model.names)[1:] == ["turn", "lift", "shoulder", "hand_joint1", "flight", "spin", "drive"]
    assert robot.model.name == "everything"
    assert robot.actuated == ("spin", "lift")
    assert [(c.kind, c.name) for c in robot.closures] == [
        *[("point", "tie"), ("point", "pinned"), ("point", "by_sites")],
        *[("weld", "glue"), ("weld", "dock")],
    ]
    assert list(robot.configurations) == ["up", "key1"]
    compiled = mujoco.MjModel.from_xml_string(EVERYTHING)
    keyframe = compiled.key("up").qpos.copy()
    np.testing.assert_allclose(qpos_of(robot, robot.q0)[:2], keyframe[:2])
    np.testing.assert_allclose(robot.q0[2:6], [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    lift = robot.model.joints[robot.model.getJointId("lift")].idx_v
    assert robot.model.armature[lift] == 0.2
    assert robot.model.damping[lift] == 0.5
    assert robot.model.upperDryFrictionLimit[lift] == 0.7
    np.testing.assert_allclose(robot.model.lowerPositionLimit[0], np.deg2rad(-30))
    np.testing.assert_allclose(robot.model.gravity.linear, [0.1, -0.2, -9.7])


def test_a_compiled_model_and_a_file_are_read_as_their_text(robot: RobotDescription, tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(EVERYTHING, encoding="utf-8")
    compiled = mujoco.MjModel.from_xml_string(EVERYTHING)
    assert read_mjcf(file).model == read_mjcf(str(file)).model == read_mjcf(compiled).model == robot.model
    np.testing.assert_array_equal(compiled.key_qpos, mujoco.MjModel.from_xml_string(EVERYTHING).key_qpos)


def test_places_gaps_and_masses_are_those_of_mujoco(robot: RobotDescription) -> None:
    compiled = mujoco.MjModel.from_xml_string(EVERYTHING)
    data = mujoco.MjData(compiled)
    model, pin_data = robot.model, robot.model.createData()
    rng = np.random.default_rng(3)
    spin = model.joints[model.getJointId("flight")].idx_v
    for _ in range(20):
        q = pin.integrate(model, robot.q0, rng.normal(size=model.nv))
        data.qpos[:] = qpos_of(robot, q)
        mujoco.mj_forward(compiled, data)
        pin.framesForwardKinematics(model, pin_data, q)
        for kind in ("body", "site"):
            for i in range(compiled.nbody if kind == "body" else compiled.nsite):
                thing = getattr(data, kind)(i)
                name = "universe" if (kind, i) == ("body", 0) else thing.name
                name = "arm_site" if (kind, name) == ("site", "arm") else name
                found = pin_data.oMf[find_frame(model, name)]
                position = thing.xpos
                np.testing.assert_allclose(found.translation, position, atol=1e-12)
                np.testing.assert_allclose(found.rotation, thing.xmat.reshape(3, 3), atol=1e-12)
        for closure in robot.closures:
            first, second = ends_of(model, q, closure)
            gap = efc_gaps(compiled, data, closure.name)
            np.testing.assert_allclose(first.translation - second.translation, gap[:3], atol=1e-12)
            if closure.kind == "weld":
                # MuJoCo's rows of rotation are the vector part of a quaternion, times a scale.
                turned = pin.Quaternion(second.rotation.T @ first.rotation)
                half = turned.vec() * np.sign(turned.w) if abs(turned.w) > 1e-9 else turned.vec()
                scale = np.linalg.norm(gap[3:]) / np.linalg.norm(half)
                np.testing.assert_allclose(np.abs(gap[3:]), np.abs(scale * half), atol=1e-9)
        for equality in robot.equalities:
            of = [
                None if name is None else q[model.joints[model.getJointId(name)].idx_q]
                for name in (equality.joint, equality.driver)
            ]
            powers = np.polynomial.polynomial.polyval(
                0.0 if of[1] is None else of[1] - equality.driver_zero, equality.coefficients
            )
            np.testing.assert_allclose(
                of[0] - equality.zero - powers, efc_gaps(compiled, data, equality.name)[0], atol=1e-12
            )
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(compiled, data, mass)
        # MuJoCo's free joint has its linear velocity in the axes of the world.
        turn = np.eye(model.nv)
        turn[spin : spin + 3, spin : spin + 3] = pin_data.oMi[model.getJointId("flight")].rotation
        upper = np.triu(pin.crba(model, pin_data, q))
        np.testing.assert_allclose(upper + np.triu(upper, 1).T, turn.T @ mass @ turn, atol=1e-11)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<mujoco><worldbody>", "MuJoCo compiles"),
        ('<robot name="arm"><link name="base"/></robot>', "whose root is <mujoco>"),
        ('<mujoco><asset><mesh name="m" file="gone.stl"/></asset></mujoco>', "MuJoCo compiles"),
        (EVERYTHING.replace('body2="drone"', 'body2="gone"'), "MuJoCo compiles"),
        (EVERYTHING.replace('body1="hand" body2="drone"', 'body1="tower" body2="fixed"'), "move against each other"),
        (
            EVERYTHING.replace(
                "<actuator>", '<tendon><fixed name="t"><joint joint="turn" coef="1"/></fixed></tendon><actuator>'
            ).replace("</equality>", '<tendon name="cable" tendon1="t"/></equality>'),
            "connect, weld and joint equalities",
        ),
        (
            EVERYTHING.replace("<actuator>", '<actuator><motor name="wing" site="eye" gear="1 0 0 0 0 0"/>'),
            "actuator of a joint",
        ),
    ],
)
def test_what_cannot_be_kept_is_refused(text: str, expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        read_mjcf(text)
    assert re.search(expected, caught.value.expected)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError) as caught:
        read_mjcf(tmp_path / "gone.xml")
    assert caught.value.argument == str(tmp_path / "gone.xml")


def test_actuators_that_are_named_are_not_read(robot: RobotDescription) -> None:
    assert read_mjcf(EVERYTHING, actuated=["drive"]).actuated == ("drive",)
    with pytest.raises(DescriptionError) as caught:
        read_mjcf(EVERYTHING, actuated=["shoulder"])
    assert caught.value.received == "'shoulder'"


def test_without_any_of_its_elements_a_file_is_read_or_refused() -> None:
    refused, count = count_refused(read_mjcf, EVERYTHING, 1000)
    assert 0 < refused < count


def test_two_points_on_an_axis_are_a_hinge() -> None:
    text = """<mujoco><worldbody><body name="a"><joint/><geom size=".1"/></body>
      <body name="b" pos="0 1 0"><joint axis="1 0 0"/><geom size=".1"/></body></worldbody>
      <equality><connect name="pin" body1="a" body2="b" anchor=".1 0 0"/>
      <connect body1="a" body2="b" anchor=".1 .3 .4"/></equality></mujoco>"""
    (closure,) = read_mjcf(text).closures
    assert (closure.kind, closure.name) == ("hinge", "pin")
    for anchor, origin in ((closure.first, [0.1, 0.0, 0.0]), (closure.second, [0.1, -1.0, 0.0])):
        np.testing.assert_allclose(anchor.placement.translation, origin, atol=1e-15)
        np.testing.assert_allclose(anchor.placement.rotation[:, 2], [0.0, 0.6, 0.8], atol=1e-15)
