"""Any chain in MJCF, URDF with YAML, and SDF: read again it is the same, and engines see its loops."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from spm_pin.description import CLOSURES_PATH, SDF_PATH, URDF_PATH
from spm_pin.errors import DescriptionError
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import Anchor, Closure, JointEquality, RobotDescription, find_frame
from spm_pin.loops.links import place
from spm_pin.loops.read_mjcf import read_mjcf
from spm_pin.loops.read_sdf import read_sdf
from spm_pin.loops.read_urdf import read_urdf
from spm_pin.loops.write_chain import mjcf_text, sdf_text, urdf_texts


def by_mjcf(robot: RobotDescription) -> RobotDescription:
    return read_mjcf(mjcf_text(robot))


def by_urdf(robot: RobotDescription) -> RobotDescription:
    return read_urdf(*urdf_texts(robot))


def by_sdf(robot: RobotDescription) -> RobotDescription:
    return read_sdf(sdf_text(robot))


def cassie() -> RobotDescription:
    data = pytest.importorskip("example_robot_data")
    path = "cassie_description/robots/cassie.sdf"
    robot = read_sdf(Path(data.getModelPath(path)) / path)
    motors = [f"{side}-{name}-ip" for side in ("left", "right") for name in ("roll", "yaw", "pitch", "knee", "foot")]
    return robot._replace(actuated=tuple(motors))


def this_robot() -> RobotDescription:
    return read_urdf(URDF_PATH, CLOSURES_PATH)


def linkage() -> RobotDescription:
    """A tree with every kind of joint and of closure, open at zero, links beside their joints."""
    text = """<mujoco model="linkage"><worldbody>
      <body name="stand" pos="0 0 .2"><geom size=".1"/></body>
      <body name="a" pos=".1 0 0" euler="10 20 0"><joint name="j1" axis="0 .6 .8" pos=".1 .2 .3" range="-60 120"
        limited="true" armature=".1" damping=".2" frictionloss=".3"/><geom type="box" size=".1 .2 .3" pos="0 .1 0"/>
        <body name="b" pos="0 .3 0"><joint name="j2" type="slide" axis="1 0 0"/><geom type="box" size=".1 .2 .3"/>
          <body name="c" pos="0 .2 .1"><joint name="j3" type="ball"/><geom type="box" size=".1 .1 .3"/></body>
      </body></body>
      <body name="d" pos="1 0 0"><joint name="j4" pos=".1 0 .1"/><geom type="box" size=".1 .1 .2" euler="10 20 30"/>
        <body name="tag" pos="0 .1 0" euler="0 0 30"><geom size=".02"/></body></body>
      <body name="e" pos="0 0 1"><freejoint name="root_joint"/><geom type="box" size=".3 .1 .2"/></body>
    </worldbody>
    <actuator><motor joint="j4"/><motor joint="j2"/></actuator></mujoco>"""
    robot = read_mjcf(text)

    def at(link: str, world: Any) -> Anchor:
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.q0)
        return Anchor(link, data.oMf[find_frame(robot.model, link)].inverse() * world)

    meeting = pin.SE3(pin.exp3(np.array([0.3, 0.2, 0.1])), np.array([0.5, 0.2, 0.1]))
    closures = [
        Closure(kind, at(one, meeting), at(other, meeting), kind)
        for kind, one, other in (
            ("point", "e", "c"),
            ("hinge", "tag", "c"),
            ("planar", "universe", "d"),
            ("weld", "e", "b"),
        )
    ]
    return robot._replace(closures=tuple(closures), equalities=(JointEquality("j1", "j4", (0.1, 0.2), 0.0, 0.3),))


def world_poses(robot: RobotDescription, values: dict[str, Any]) -> dict[str, Any]:
    """Return the poses of all frames at the joints' values by name."""
    q = pin.neutral(robot.model)
    for name, value in values.items():
        joint = robot.model.joints[robot.model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = value
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return {frame.name: data.oMf[i].copy() for i, frame in enumerate(robot.model.frames)}


@pytest.mark.parametrize(
    ("make", "write"),
    [
        *((make, write) for make in (this_robot, linkage) for write in (by_mjcf, by_urdf, by_sdf)),
        *((cassie, write) for write in (by_urdf, by_sdf)),
    ],
)
def test_a_chain_that_is_read_again_is_the_same(
    make: Callable[[], RobotDescription], write: Callable[[RobotDescription], RobotDescription]
) -> None:
    robot = make()
    again = write(robot)
    model = robot.model
    assert sorted(again.model.names) == sorted(model.names)
    in_order = write is not by_sdf  # a joint of SDF is actuated by its limit of effort
    assert again.actuated == robot.actuated if in_order else set(again.actuated) == set(robot.actuated)
    assert pin.computeTotalMass(again.model) == pytest.approx(pin.computeTotalMass(model), rel=1e-12)
    rng = np.random.default_rng(2)
    for _ in range(3):
        q = pin.integrate(model, robot.q0, rng.normal(size=model.nv))
        values = {
            name: q[j.idx_q : j.idx_q + j.nq] for name, j in list(zip(model.names, model.joints, strict=True))[1:]
        }
        before, after = world_poses(robot, values), world_poses(again, values)
        for frame in model.frames:
            if frame.type == pin.FrameType.BODY and frame.name in after:
                np.testing.assert_allclose(after[frame.name].homogeneous, before[frame.name].homogeneous, atol=1e-12)
        kinds = {"planar": "point"} if write is by_mjcf else {"planar": "hinge"} if write is by_sdf else {}
        names = [c.name for c in (robot if write is by_urdf else again).closures]
        found = dict(zip(names, again.closures, strict=True))
        for closure in robot.closures:
            other = found[closure.name]
            assert other.kind == kinds.get(closure.kind, closure.kind)
            (first, second), (first_again, second_again) = (
                [at[a.frame] * a.placement for a in (c.first, c.second)]
                for at, c in ((before, closure), (after, other))
            )
            apart, apart_again = (
                first.translation - second.translation,
                first_again.translation - second_again.translation,
            )
            np.testing.assert_allclose(apart_again, apart, atol=1e-12)
            if closure.kind == "hinge":
                np.testing.assert_allclose(second_again.rotation[:, 2], second.rotation[:, 2], atol=1e-12)
                np.testing.assert_allclose(first_again.rotation[:, 2], first.rotation[:, 2], atol=1e-12)
            elif closure.kind == "weld":
                turned = first.rotation @ second.rotation.T
                np.testing.assert_allclose(first_again.rotation @ second_again.rotation.T, turned, atol=1e-12)
        for one, other in zip(robot.equalities, again.equalities, strict=True):
            followers = []
            for e in (one, other):
                assert (e.joint, e.driver) == (one.joint, one.driver)
                polynomial = np.polynomial.Polynomial(e.coefficients)
                followers.append(e.zero + polynomial(values[e.driver][0] - e.driver_zero))
            assert followers[1] == pytest.approx(followers[0], abs=1e-12)


def test_points_of_a_planar_loop_are_written_to_mjcf_where_they_meet() -> None:
    """In the chain they may be apart along the normal."""
    robot = linkage()
    planar = robot.closures[2]
    apart = Anchor(planar.second.frame, planar.second.placement * place((0.0, 0.0, 0.2)))
    again = by_mjcf(robot._replace(closures=(Closure("planar", planar.first, apart, "planar"),)))
    (closure,) = again.closures
    poses = world_poses(again, {})
    first, second = (poses[a.frame] * a.placement for a in (closure.first, closure.second))
    np.testing.assert_allclose(first.translation, second.translation, atol=1e-12)
    np.testing.assert_allclose(second.translation, (world_poses(robot, {})["d"] * apart.placement).translation)


def test_mujoco_sees_the_loops_closed_at_q0_and_the_masses() -> None:
    chain = ClosedChain.from_description(this_robot())
    q = chain.close(np.random.default_rng(0).normal(scale=0.05, size=18))
    closed = ClosedChain(chain.model, chain.closures, chain.actuated, q0=q)
    model = mujoco.MjModel.from_xml_string(mjcf_text(closed))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(model.qpos0, q)
    assert (model.neq, model.nu) == (4, 6)
    assert np.abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() < 1e-12
    mass = np.zeros((18, 18))
    mujoco.mj_fullM(model, data, mass)
    upper = np.triu(pin.crba(chain.model, chain.model.createData(), q))
    np.testing.assert_allclose(mass, upper + np.triu(upper, 1).T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml"])
def test_drake_sees_every_loop(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("pydrake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant

    robot = this_robot()
    open_at_zero = ClosedChain.from_description(robot)
    q = open_at_zero.close(np.random.default_rng(0).normal(scale=0.05, size=18))
    closed = ClosedChain(robot.model, robot.closures, robot.actuated, q0=q)
    # An SDF that is closed at zero has loops of joints, which Drake refuses: this one is open by a centimetre.
    first, *others = robot.closures
    moved = Closure("point", first.first, Anchor(first.second.frame, place((0.0, 0.0, 0.01))), first.name)
    texts = {
        "urdf": lambda: urdf_texts(closed)[0],
        "xml": lambda: mjcf_text(closed),
        "sdf": lambda: sdf_text(robot._replace(closures=(moved, *others))),
    }
    file = tmp_path / f"robot.{kind}"
    file.write_text(texts[kind](), encoding="utf-8")
    plant = MultibodyPlant(1e-3)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    Parser(plant).AddModels(str(file))
    plant.Finalize()
    assert (plant.num_constraints(), plant.num_actuators()) == (4, 6)


@pytest.mark.parametrize("write", [by_mjcf, by_urdf, by_sdf])
def test_a_root_link_called_world_is_the_world(write: Callable[[RobotDescription], RobotDescription]) -> None:
    robot = read_urdf(
        """<robot name="crank"><link name="world"/><link name="crank"><inertial><mass value="1"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="turn" type="continuous"><parent link="world"/><child link="crank"/><origin xyz="0 0 1"/></joint>
        </robot>""",
        [Closure("point", Anchor("world", place((0.0, 0.1, 1.0))), Anchor("crank", place((0.0, 0.1, 0.0))), "pin")],
    )
    again = write(robot)
    assert list(again.model.names) == ["universe", "turn"]
    poses = world_poses(again, {})
    for anchor in (again.closures[0].first, again.closures[0].second):
        np.testing.assert_allclose((poses[anchor.frame] * anchor.placement).translation, [0.0, 0.1, 1.0], atol=1e-15)


def test_what_a_format_cannot_say_is_refused() -> None:
    robot = this_robot()
    square = robot._replace(equalities=(JointEquality("leg_b2_hip", "leg_b3_hip", (0.0, 1.0, 0.5)),))
    for write in (urdf_texts, sdf_text):
        with pytest.raises(DescriptionError) as caught:
            write(square)
        assert caught.value.received == "'leg_b2_hip'"
    assert read_mjcf(mjcf_text(square)).equalities[0].coefficients[:3] == (0.0, 1.0, 0.5)
    with pytest.raises(DescriptionError) as caught:
        mjcf_text(cassie())
    assert "left-foot-reference" in caught.value.received
    weightless = read_sdf(SDF_PATH)
    for i in range(1, weightless.model.njoints):
        weightless.model.inertias[i] = pin.Inertia.Zero()
    with pytest.raises(DescriptionError) as caught:
        mjcf_text(weightless)
    assert "mass" in caught.value.expected
