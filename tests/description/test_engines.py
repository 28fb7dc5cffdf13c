"""Every reader builds the same tree: poses of all links against those computed from the file itself.

1e-12 m leaves room for a chain of nine joints above levers of 2.6 m; all of them, MuJoCo included, stay below 1e-14.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from description.kinematic_tree import Array, KinematicTree, inertia, named_states, origin, vector
from problems import GEOMETRIES

from spm_pin.description import urdf_text
from spm_pin.description.source_files import MJCF, SRDF, URDF, description_directory, description_file
from spm_pin.description.tree import SLIDES, read_closures

TOLERANCE = 1e-12
TEXT = description_file(URDF).read_text(encoding="utf-8")
TREE = KinematicTree(TEXT)
STATES = named_states(description_file(SRDF).read_text(encoding="utf-8"))
CLOSURES = read_closures()

Frames = Mapping[str, Array]


def assert_same_frames(frames: Callable[[Mapping[str, float]], Frames], tree: KinematicTree = TREE) -> None:
    rng = np.random.default_rng(7)
    values = [STATES["home"], STATES["reference"], *(tree.random_values(rng) for _ in range(5))]
    for value in values:
        found, expected = frames(value), tree.frames(value)
        assert found.keys() == expected.keys()
        for link in expected:
            np.testing.assert_allclose(found[link], expected[link], atol=TOLERANCE, err_msg=link)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_pinocchio(name: str) -> None:
    pin = pytest.importorskip("pinocchio")
    text = urdf_text(GEOMETRIES[name])
    model = pin.buildModelFromXML(text)
    assert (model.nq, model.nv, model.njoints) == (18, 18, 19)
    data = model.createData()
    tree = KinematicTree(text)

    def frames(values: Mapping[str, float]) -> Frames:
        q = np.full(model.nq, np.nan)
        for joint, value in values.items():
            q[model.joints[model.getJointId(joint)].idx_q] = value
        pin.framesForwardKinematics(model, data, q)
        return {link: data.oMf[model.getFrameId(link, pin.BODY)].homogeneous.copy() for link in tree.links}

    assert_same_frames(frames, tree)


def test_yourdfpy() -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(io.BytesIO(TEXT.encode()), load_meshes=False)
    assert robot.validate()
    assert set(robot.actuated_joint_names) == TREE.moving.keys()

    def frames(values: Mapping[str, float]) -> Frames:
        robot.update_cfg(dict(values))
        return {link: robot.get_transform(link, "base") for link in TREE.links}

    assert_same_frames(frames)


def test_mujoco() -> None:
    mujoco = pytest.importorskip("mujoco")
    model, data = mujoco_model(mujoco)
    # No link was merged or dropped: that is what the <mujoco> tag in the URDF is for.
    assert model.nbody == len(TREE.links) + 1
    assert model.body_mass.sum() == pytest.approx(sum(inertia(link)[0] for link in TREE.links.values()))

    def frames(values: Mapping[str, float]) -> Frames:
        for joint, value in values.items():
            data.joint(joint).qpos[0] = value
        mujoco.mj_forward(model, data)
        poses = {}
        for link in TREE.links:
            poses[link] = np.eye(4)
            poses[link][:3, :3] = data.body(link).xmat.reshape(3, 3)
            poses[link][:3, 3] = data.body(link).xpos
        return poses

    assert_same_frames(frames)
    for name in ("home", "reference"):
        frames(STATES[name])
        equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert np.count_nonzero(equality) == 12
        assert np.abs(data.efc_pos[equality]).max() < TOLERANCE
        # MuJoCo reads no SRDF: the collision shapes themselves keep clear of the joints.
        assert data.ncon == 0
    frames(STATES["reference"] | {"leg_b2_slide": 0.0})
    assert np.abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() > 1e-2


def mujoco_model(mujoco: Any) -> tuple[Any, Any]:
    """The tree as MuJoCo reads it, with the closures added as `connect` between bodies."""
    spec = mujoco.MjSpec.from_file(str(description_file(URDF)))
    for closure in CLOSURES:
        equality = spec.add_equality()
        equality.type, equality.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_BODY
        equality.name, equality.name1, equality.name2 = closure.name, closure.frame_a, closure.frame_b
        # The anchor in frame_a; MuJoCo's default is of another type.
        equality.data = np.zeros_like(equality.data)
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("looped", [True, False], ids=["loops", "no loops"])
def test_drake(looped: bool, tmp_path: Path) -> None:
    pytest.importorskip("pydrake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)  # ball constraints need SAP
    path = tmp_path / "spm.urdf"  # in a text without a file, Drake takes no paths of meshes
    path.write_text(urdf_text() if looped else without_constraints(urdf_text()), encoding="utf-8")
    Parser(plant).AddModels(str(path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    assert {actuator.joint().name() for actuator in actuators} == set(SLIDES)
    assert all(actuator.effort_limit() == TREE.moving[SLIDES[0]].limit["effort"] for actuator in actuators)
    assert plant.num_positions() == 18
    assert plant.num_constraints() == (4 if looped else 0)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    state = plant.GetMyMutableContextFromRoot(context)

    def frames(values: Mapping[str, float]) -> Frames:
        for name, value in values.items():
            joint = plant.GetJointByName(name)
            (joint.set_translation if name in SLIDES else joint.set_angle)(state, value)
        return {link: plant.GetFrameByName(link).CalcPoseInWorld(state).GetAsMatrix4() for link in TREE.links}

    assert_same_frames(frames)
    # Falling freely for 50 ms, the loops hold together; without them they are torn by a hundred times more.
    frames(STATES["reference"])
    before = plant.GetPositions(state).copy()
    Simulator(diagram, context).AdvanceTo(0.05)
    assert np.abs(plant.GetPositions(state) - before).max() > 1e-2
    poses = [[plant.GetFrameByName(f).CalcPoseInWorld(state) for f in (c.frame_a, c.frame_b)] for c in CLOSURES]
    gap = max(np.linalg.norm(a.translation() - b.translation()) for a, b in poses)
    assert gap < 1e-5 if looped else gap > 1e-3


def without_constraints(urdf: str) -> str:
    start, end = urdf.index("<drake:ball_constraint>"), urdf.rindex("</drake:ball_constraint>")
    return urdf[:start] + urdf[end + len("</drake:ball_constraint>") :]


@pytest.mark.parametrize("name", GEOMETRIES)
def test_check_urdf(name: str, tmp_path: Path) -> None:
    # Debian's liburdfdom-tools have it, and so does the urdfdom wheel that Pinocchio brings along.
    path = f"{sysconfig.get_path('scripts')}:/usr/local/bin:/usr/bin:/bin"
    binaries = {shutil.which("check_urdf", path=folder) for folder in path.split(":")} - {None}
    if not binaries:
        pytest.skip("check_urdf is not installed (Debian: liburdfdom-tools)")
    urdf = tmp_path / "spm.urdf"
    urdf.write_text(urdf_text(GEOMETRIES[name], prefix="left_"), encoding="utf-8")
    for binary in binaries:
        answer = subprocess.run([str(binary), str(urdf)], capture_output=True, text=True, check=False)
        assert answer.returncode == 0, answer.stdout + answer.stderr
        assert answer.stderr == ""
        assert "Successfully Parsed XML" in answer.stdout
        assert answer.stdout.count("child(") == 1 + len(TREE.joints)


def mesh_boxes() -> Array:
    """The lowest and highest corner (n, 2, 3) of each mesh that is drawn, at `reference`, by trimesh and the tree."""
    frames = TREE.frames(STATES["reference"])
    boxes = []
    for name, link in TREE.links.items():
        for visual in link.findall("visual"):
            (file,) = visual.findall("geometry/mesh")
            mesh = trimesh.load(description_directory() / str(file.get("filename")), process=False)
            pose = frames[name] @ origin(visual)
            points = (mesh.vertices * vector(file.get("scale"))) @ pose[:3, :3].T + pose[:3, 3]
            boxes.append([points.min(axis=0), points.max(axis=0)])
    return np.array(boxes)


def sorted_boxes(boxes: Any) -> Array:
    rows = np.asarray(boxes).reshape(-1, 6)
    return np.asarray(rows[np.lexsort(np.round(rows, 6).T)])


def test_pinocchio_shows_the_meshes() -> None:
    pin = pytest.importorskip("pinocchio")
    model, _, shapes = pin.buildModelsFromUrdf(str(description_file(URDF)), package_dirs=str(description_directory()))
    data, placed = model.createData(), shapes.createData()
    q = np.array([STATES["reference"][name] for name in list(model.names)[1:]])
    pin.updateGeometryPlacements(model, data, shapes, placed, q)
    boxes = []
    for shape, pose in zip(shapes.geometryObjects, placed.oMg, strict=True):
        points = shape.geometry.vertices() @ pose.rotation.T + pose.translation
        boxes.append([points.min(axis=0), points.max(axis=0)])
    np.testing.assert_allclose(sorted_boxes(boxes), sorted_boxes(mesh_boxes()), atol=1e-6)


def test_yourdfpy_shows_the_meshes() -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(description_file(URDF)))
    robot.update_cfg(dict(STATES["reference"]))
    boxes = mesh_boxes()
    expected = [boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]
    np.testing.assert_allclose(robot.scene.bounds, expected, atol=1e-6)
    assert len(robot.scene.graph.nodes_geometry) == len(boxes)


@pytest.mark.parametrize("name", [URDF, MJCF])
def test_mujoco_shows_the_meshes(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(description_file(name)))
    data = mujoco.MjData(model)
    for joint, value in STATES["reference"].items():
        data.joint(joint).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    boxes = []
    for i in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.mesh(model.geom_dataid[i])
        start, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        points = model.mesh_vert[start : start + count] @ data.geom_xmat[i].reshape(3, 3).T + data.geom_xpos[i]
        boxes.append([points.min(axis=0), points.max(axis=0)])
    np.testing.assert_allclose(sorted_boxes(boxes), sorted_boxes(mesh_boxes()), atol=1e-5)


@pytest.mark.parametrize("name", [URDF, MJCF])
def test_drake_shows_the_meshes(name: str) -> None:
    pytest.importorskip("pydrake")
    from pydrake.geometry import Role
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
    from pydrake.systems.framework import DiagramBuilder

    plant, graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)  # ball constraints need SAP
    Parser(plant).AddModels(str(description_file(name)))
    inspector = graph.model_inspector()
    shown = [inspector.GetShape(g) for g in inspector.GetAllGeometryIds(Role.kIllustration)]
    found = sorted((shape.source().path().name, *shape.scale3()) for shape in shown)
    meshes = TREE.root.findall("link/visual/geometry/mesh")
    expected = sorted((str(m.get("filename")).rpartition("/")[2], *vector(m.get("scale"))) for m in meshes)
    assert [file for file, *_ in found] == [file for file, *_ in expected]
    np.testing.assert_allclose([s for _, *s in found], [s for _, *s in expected], rtol=1e-12)
