"""Readers of the URDF and the MJCF: check_urdf accepts them, and every engine shows the meshes where the tree is."""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from description.kinematic_tree import STATES, TREE, Array, origin, vector
from engines import Drake, Mujoco, Pinocchio, Yourdfpy
from problems import MANIPULATORS

import spm_pin as spm
from spm_pin.description import Masses, urdf_text
from spm_pin.description.source_files import MJCF, URDF, description_directory, description_file


@pytest.mark.parametrize("name", MANIPULATORS)
def test_check_urdf(name: str, tmp_path: Path) -> None:
    # Debian's liburdfdom-tools have it, and so does the urdfdom wheel that Pinocchio brings along.
    path = f"{sysconfig.get_path('scripts')}:/usr/local/bin:/usr/bin:/bin"
    binaries = {shutil.which("check_urdf", path=folder) for folder in path.split(":")} - {None}
    if not binaries:
        pytest.skip("check_urdf is not installed (Debian: liburdfdom-tools)")
    urdf = tmp_path / "spm.urdf"
    urdf.write_text(urdf_text(MANIPULATORS[name], prefix="left_", ros_constraints=True), encoding="utf-8")
    for binary in binaries:
        answer = subprocess.run([str(binary), str(urdf)], capture_output=True, text=True, check=False)
        assert answer.returncode == 0, answer.stdout + answer.stderr
        assert answer.stderr == ""
        assert "Successfully Parsed XML" in answer.stdout
        assert answer.stdout.count("child(") == 1 + len(TREE.joints)


@pytest.mark.parametrize("prefix", ["", "left_"])
@pytest.mark.parametrize(
    "machine", [None, spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))], ids=["robot", "stage"]
)
def test_the_root_for_ros_has_no_inertia_and_carries_the_base(machine: spm.Stage | None, prefix: str) -> None:
    masses = Masses(bodies={"*": {"mass": 0.1}})
    plain, rooted = (
        ElementTree.fromstring(urdf_text(machine, prefix=prefix, root=root, masses=masses)) for root in (False, True)
    )
    links = {link.get("name"): link for link in rooted.findall("link")}
    (root,) = links.keys() - {child.get("link") for child in rooted.iter("child")}
    assert root == f"{prefix}root"
    assert len(links.pop(root)) == 0
    assert list(links) == [link.get("name") for link in plain.findall("link")]


@pytest.mark.parametrize("engine", [Pinocchio, Mujoco, Drake, Yourdfpy])
def test_engines_place_the_robot_on_the_root_for_ros_as_without_it(engine: type, tmp_path: Path) -> None:
    pytest.importorskip({Pinocchio: "pinocchio", Mujoco: "mujoco", Drake: "pydrake", Yourdfpy: "yourdfpy"}[engine])
    robots = []
    for root in (False, True):
        file = tmp_path / f"{root}.urdf"
        file.write_text(urdf_text(root=root), encoding="utf-8")
        robots.append(engine(file))
    plain, rooted = robots
    assert rooted.joints == plain.joints
    values = STATES["reference"]
    frames, expected = (robot.frames(values) for robot in (rooted, plain))
    assert frames.keys() >= expected.keys()
    for link, pose in expected.items():
        np.testing.assert_allclose(frames[link], pose, rtol=0, atol=1e-14)
    if engine is not Yourdfpy:
        np.testing.assert_allclose(rooted.gaps(values), 0.0, rtol=0, atol=1e-12)
        np.testing.assert_allclose(rooted.mass_matrix(values), plain.mass_matrix(values), rtol=0, atol=1e-12)


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


def assert_meshes_at(clouds: Iterable[Array], atol: float) -> None:
    rows = (np.array([[p.min(axis=0), p.max(axis=0)] for p in clouds]).reshape(-1, 6), mesh_boxes().reshape(-1, 6))
    found, expected = (boxes[np.lexsort(np.round(boxes, 6).T)] for boxes in rows)
    np.testing.assert_allclose(found, expected, atol=atol)


def test_pinocchio_shows_the_meshes() -> None:
    pin = pytest.importorskip("pinocchio")
    model, _, shapes = pin.buildModelsFromUrdf(str(description_file(URDF)), package_dirs=str(description_directory()))
    data, placed = model.createData(), shapes.createData()
    q = np.array([STATES["reference"][name] for name in list(model.names)[1:]])
    pin.updateGeometryPlacements(model, data, shapes, placed, q)
    shown = zip(shapes.geometryObjects, placed.oMg, strict=True)
    clouds = [shape.geometry.vertices() @ pose.rotation.T + pose.translation for shape, pose in shown]
    assert_meshes_at(clouds, atol=1e-6)


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
    robot = Mujoco(description_file(name))
    robot.set(STATES["reference"])
    model, data, clouds = robot.model, robot.data, []
    for i in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.mesh(model.geom_dataid[i])
        start, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        vertices = model.mesh_vert[start : start + count]
        clouds.append(vertices @ data.geom_xmat[i].reshape(3, 3).T + data.geom_xpos[i])
    assert_meshes_at(clouds, atol=1e-5)


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
