"""Every export is the same robot in the engine that it is for: joints, poses, closures, masses and what moves it.

The measure is the URDF, read with the standard library alone; the engines' own numbers are compared with it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from description.kinematic_tree import SLIDES, STATES, TREE, KinematicTree
from engines import ENGINES, JOINTS, Array, Engine, Mujoco, Pinocchio, Values, Yourdfpy
from problems import MANIPULATORS

from spm_pin.description import MJCF_PATH, PACKAGE_PATH, SDF_PATH, URDF_PATH, mjcf_text, sdf_text, urdf_text
from spm_pin.description.source_files import read_closures

CLOSED = ["home", *(f"solution_{number}" for number in (1, 2, 3, 4, 6, 7))]
CASES = [
    ("pinocchio", "urdf"),
    ("pinocchio", "mjcf"),
    ("mujoco", "mjcf"),
    ("drake", "urdf"),
    ("drake", "written urdf"),
    ("drake", "mjcf"),
    ("drake", "sdf for drake"),
]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("exports")
    texts = {
        "written.urdf": urdf_text(ros_constraints=True),
        "drake.sdf": sdf_text(loops="drake"),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return {
        "urdf": Path(URDF_PATH),
        "mjcf": Path(MJCF_PATH),
        "written urdf": folder / "written.urdf",
        "sdf for drake": folder / "drake.sdf",
    }


Load = Callable[[str, str], Any]


@pytest.fixture(scope="module")
def load(files: dict[str, Path]) -> Load:
    @cache
    def loaded(engine: str, kind: str) -> Engine:
        return ENGINES[engine](files[kind])

    return loaded


@pytest.fixture(params=CASES, ids=" ".join)
def robot(request: pytest.FixtureRequest, load: Load) -> Engine:
    return load(*request.param)


def random_values(seed: int, count: int = 5) -> list[dict[str, float]]:
    rng = np.random.default_rng(seed)
    return [TREE.random_values(rng) for _ in range(count)]


def worst_frame(robot: Any, values: Values, tree: KinematicTree = TREE) -> tuple[float, str]:
    """Largest difference of a link's pose from the tree's, and the link."""
    found, expected = robot.frames(values), tree.frames(values)
    assert found.keys() == expected.keys()
    return max((float(np.abs(found[link] - expected[link]).max()), link) for link in expected)


def test_forward_kinematics(robot: Engine) -> None:
    assert robot.joints == JOINTS
    for values in [STATES["home"], STATES["solution_7"], *random_values(20)]:
        # A chain of nine joints above levers of 2.6 m.
        assert worst_frame(robot, values) < (1e-12, "")


@pytest.mark.parametrize("reader", [Mujoco, Yourdfpy])
def test_readers_that_know_no_closures_pass_over_them(reader: Any, files: dict[str, Path]) -> None:
    robot = reader(files["written urdf"])
    assert set(robot.joints) == TREE.moving.keys()
    for values in [STATES["solution_4"], *random_values(24, 2)]:
        assert worst_frame(robot, values) < (1e-12, "")


def test_closures_hold_in_every_solution_and_only_there(robot: Engine) -> None:
    for state in CLOSED:
        gaps = robot.gaps(STATES[state])
        assert gaps.shape == (4, 3)
        assert np.abs(gaps).max() < 1e-12, state
    for values in random_values(21, 3):
        frames = TREE.frames(values)
        ends = [[frames[frame][:3, 3] for frame in (c.frame_a, c.frame_b)] for c in read_closures()]
        expected = [np.linalg.norm(a - b) for a, b in ends]
        np.testing.assert_allclose(np.linalg.norm(robot.gaps(values), axis=1), expected, rtol=1e-10)


def test_mass_matrix(robot: Engine, load: Load) -> None:
    reference = load("pinocchio", "urdf")
    for values in random_values(22):
        expected = reference.mass_matrix(values)
        np.testing.assert_allclose(robot.mass_matrix(values), expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_limits_and_actuators(load: Load) -> None:
    mujoco, drake, pinocchio = load("mujoco", "mjcf"), load("drake", "mjcf"), load("pinocchio", "mjcf")
    model = mujoco.model
    assert model.nu == len(SLIDES)
    assert [model.joint(model.actuator(i).trnid[0]).name for i in range(model.nu)] == list(SLIDES)
    velocities = model.numeric("velocity_limit").data
    for i, (name, velocity) in enumerate(zip(mujoco.joints, velocities, strict=True)):
        limit = TREE.moving[name].limit
        assert model.joint(name).range.tolist() == [limit["lower"], limit["upper"]]
        assert model.joint(name).limited[0]
        assert pinocchio.model.lowerPositionLimit[i] == limit["lower"]
        assert pinocchio.model.upperPositionLimit[i] == limit["upper"]
        assert velocity == limit["velocity"]
        drake_joint = drake.plant.GetJointByName(name)
        assert drake_joint.position_lower_limits()[0] == limit["lower"]
        assert drake_joint.position_upper_limits()[0] == limit["upper"]
    mujoco.set(STATES["reference"])
    mujoco.data.ctrl[:] = np.arange(1.0, 7.0)
    mujoco.mujoco.mj_forward(model, mujoco.data)
    forces = {name: mujoco.data.joint(name).qfrc_actuator[0] for name in mujoco.joints}
    assert {name: force for name, force in forces.items() if force} == dict(zip(SLIDES, range(1, 7), strict=True))
    effort = TREE.moving[SLIDES[0]].limit["effort"]
    assert (model.actuator_ctrlrange == [-effort, effort]).all()
    for robot in (drake, load("drake", "sdf for drake"), load("drake", "written urdf")):
        actuators = [robot.plant.get_joint_actuator(i) for i in robot.plant.GetJointActuatorIndices()]
        assert [actuator.joint().name() for actuator in actuators] == list(SLIDES)
        assert [actuator.effort_limit() for actuator in actuators] == [effort] * 6


def test_keyframes_are_the_named_states(load: Load) -> None:
    mujoco, pinocchio = load("mujoco", "mjcf"), load("pinocchio", "mjcf")
    for name, values in STATES.items():
        expected = [values[joint] for joint in mujoco.joints]
        assert mujoco.model.key(name).qpos.tolist() == expected
        assert pinocchio.model.referenceConfigurations[name].tolist() == expected


def test_sites_are_at_the_frames(load: Load) -> None:
    robot: Mujoco = load("mujoco", "mjcf")
    robot.set(STATES["reference"])
    frames = TREE.frames(STATES["reference"])
    pinocchio: Pinocchio = load("pinocchio", "mjcf")
    pinocchio.frames(STATES["reference"])
    sites = [robot.data.site(i) for i in range(robot.model.nsite)]
    platforms = {"base", "middle_platform", "terminal_platform"}
    ends = {frame for c in read_closures() for frame in (c.frame_a, c.frame_b)}
    assert {f"{name}_site" for name in platforms | ends} <= {site.name for site in sites}
    for site in sites:
        expected = frames[site.name.removesuffix("_site")]
        np.testing.assert_allclose(site.xpos, expected[:3, 3], atol=1e-12)
        np.testing.assert_allclose(site.xmat.reshape(3, 3), expected[:3, :3], atol=1e-12)
        if site.name.startswith("base"):
            continue  # Pinocchio leaves the fixed base's out
        there = pinocchio.data.oMf[pinocchio.model.getFrameId(site.name)].homogeneous
        np.testing.assert_allclose(there, expected, atol=1e-12, err_msg=site.name)


@pytest.mark.parametrize("kind", ["VISUAL", "COLLISION"])
def test_shapes_are_where_the_urdf_has_them(kind: str, load: Load) -> None:
    pin, what = load("pinocchio", "urdf").pin, getattr(load("pinocchio", "urdf").pin, kind)
    found = pin.buildGeomFromMJCF(load("pinocchio", "mjcf").model, MJCF_PATH, what)
    expected = pin.buildGeomFromUrdf(load("pinocchio", "urdf").model, URDF_PATH, what, package_dirs=PACKAGE_PATH)
    assert found.ngeoms == expected.ngeoms > 0

    def described(shapes: Any) -> Array:
        rows = []
        for shape in shapes.geometryObjects:
            shape.geometry.computeLocalAABB()
            box = shape.geometry.aabb_local
            at = shape.placement.homogeneous[:3].ravel()
            rows.append([shape.parentJoint, *at, *(box.max_ - box.min_), shape.geometry.computeVolume()])
        rounded = np.round(np.array(rows), 9) + 0.0
        return np.array(rows)[np.lexsort(rounded.T[::-1])]

    np.testing.assert_allclose(described(found), described(expected), atol=1e-12)


def test_mjcf_of_another_machine(tmp_path: Path) -> None:
    machine = MANIPULATORS["wide base"]
    tree = KinematicTree(urdf_text(machine))
    path = tmp_path / "robot.xml"
    path.write_text(mjcf_text(machine), encoding="utf-8")
    values = tree.random_values(np.random.default_rng(23))
    size = max(1.0, machine.base_radius)
    for engine, reader in ENGINES.items():
        robot = reader(path)
        assert worst_frame(robot, values, tree)[0] < 1e-11 * size, engine
        assert np.abs(robot.gaps({})).max() < 1e-12 * size, engine


def test_ros_constraints_are_behind_a_switch(files: dict[str, Path]) -> None:
    assert "<constraint" not in urdf_text()
    assert TREE.root.find("constraint") is None
    found = ElementTree.parse(files["written urdf"]).getroot().findall("constraint")
    assert [(c.get("name"), c.get("type")) for c in found] == [
        (f"{c.frame_a}_{c.frame_b}", "spherical_joint") for c in read_closures()
    ]
    for element, closure in zip(found, read_closures(), strict=True):
        ends = [(end.tag, end.get("link")) for end in element if end.tag in ("parent", "child")]
        assert ends == [("parent", closure.frame_a), ("child", closure.frame_b)]
        for end in ("parent_origin", "child_origin"):
            origin = element.find(end)
            assert origin.attrib == {"xyz": "0 0 0", "rpy": "0 0 0"}


def test_sdf_is_read_with_its_loops_up_to_where_engines_stop() -> None:
    """libsdformat, inside Drake, reads the graph with four links that have two parents; Drake's plant refuses it."""
    pytest.importorskip("pydrake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(SDF_PATH)
    joints = [plant.get_joint(i) for i in plant.GetJointIndices()]
    assert len(joints) == len(TREE.joints) + 1 + 4
    balls = {joint.name(): joint for joint in joints if joint.type_name() == "ball_rpy"}
    assert balls.keys() == {closure.name for closure in read_closures()}
    children = [joint.child_body().name() for joint in joints]
    home = TREE.frames({})
    for closure in read_closures():
        joint = balls[closure.name]
        assert (joint.parent_body().name(), joint.child_body().name()) == (closure.frame_a, closure.frame_b)
        assert children.count(closure.frame_b) == 2
        # Where Drake placed the joint in both links: the same point, once the robot stands at home.
        ends = zip((joint.frame_on_parent(), joint.frame_on_child()), (closure.frame_a, closure.frame_b), strict=True)
        a, b = (home[link] @ frame.GetFixedPoseInBodyFrame().GetAsMatrix4()[:, 3] for frame, link in ends)
        np.testing.assert_allclose(a, b, atol=1e-12)
        np.testing.assert_allclose(a[:3], home[closure.frame_b][:3, 3], atol=1e-12)
    with pytest.raises(RuntimeError, match="loops"):
        plant.Finalize()


@cache
def model(collisions: str) -> Any:
    return pytest.importorskip("mujoco").MjModel.from_xml_string(mjcf_text(collisions=collisions))


def colliding(found: Any) -> Array:
    return np.flatnonzero(found.geom_contype > 0)


def test_without_collisions_no_shape_collides_and_the_masses_stay() -> None:
    none, exact = model("none"), model("exact")
    assert not len(colliding(none))
    assert len(colliding(exact)) > 20
    np.testing.assert_array_equal(none.body_mass, exact.body_mass)
    assert mjcf_text(collisions="exact") == mjcf_text()


def test_simple_shapes_are_no_cylinders_and_lie_inside_the_exact_ones() -> None:
    exact, simple = model("exact"), model("simple")
    shapes, kinds = colliding(exact), pytest.importorskip("mujoco").mjtGeom
    assert (shapes == colliding(simple)).all()
    assert not (simple.geom_type[shapes] == kinds.mjGEOM_CYLINDER).any()
    cylinders = shapes[exact.geom_type[shapes] == kinds.mjGEOM_CYLINDER]
    assert len(cylinders) > 10
    for k in cylinders:
        radius, half = exact.geom_size[k, :2]
        x, y, z = simple.geom_size[k]
        if simple.geom_type[k] == kinds.mjGEOM_CAPSULE:
            assert x == radius
            assert x + y == pytest.approx(half)
        else:
            assert simple.geom_type[k] == kinds.mjGEOM_BOX
            assert np.hypot(x, y) == pytest.approx(radius)
            assert z == pytest.approx(half)
    np.testing.assert_array_equal(simple.geom_pos, exact.geom_pos)


def test_mjx_takes_it() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its optional back ends
        mjx = pytest.importorskip("mujoco.mjx")
        taken = mjx.put_model(model("simple"))
    assert taken.neq == 4
