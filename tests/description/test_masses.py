"""Assumed masses are those of simple bodies; others in their place, and a payload, in all formats and exported C."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
import yourdfpy
from description.kinematic_tree import Array, KinematicTree, inertia, origin, vector
from error_fields import with_fields
from problems import MANIPULATORS

import spm_pin as spm
from spm_pin.description import Masses, RigidBody, mjcf_text, urdf_text
from spm_pin.description.masses import with_masses
from spm_pin.description.source_files import description_file
from spm_pin.errors import DescriptionError

STATE = spm.forward_physical(spm.Manipulator.paper(), [1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
TURN = pin.rpy.rpyToMatrix(0.3, -0.2, 0.5)
INERTIA = TURN @ np.diag([0.5, 0.7, 1.0]) @ TURN.T
PAYLOAD = RigidBody(10.0, [0.1, -0.05, 0.2], np.diag([0.1, 0.2, 0.25]))


def weights(chain: spm.ClosedChain) -> np.ndarray:
    return np.asarray(chain.state(chain.joint_values(STATE)).inverse_dynamics(np.zeros(18)))


def test_a_payload_adds_its_weight_and_its_inertia() -> None:
    assumed, loaded = (spm.ClosedChain.from_urdf(masses=masses) for masses in (None, Masses(payload=PAYLOAD)))
    force = np.array([0.0, 0.0, -9.81 * PAYLOAD.mass])
    arm = STATE.rotation @ np.asarray(PAYLOAD.centre)
    wrench = np.concatenate([force, np.cross(arm, force)])
    np.testing.assert_allclose(weights(loaded) - weights(assumed), spm.leg_forces(STATE, wrench), atol=1e-7)
    # The reflected inertia grows by that of the body at o.
    q, rest = assumed.joint_values(STATE), np.zeros(18)
    grown = loaded.state(q, rest).platform_dynamics().mass - assumed.state(q, rest).platform_dynamics().mass
    body = pin.Inertia(PAYLOAD.mass, np.asarray(PAYLOAD.centre), np.asarray(PAYLOAD.inertia))
    turned = pin.SE3(STATE.rotation, np.zeros(3)).act(body)
    np.testing.assert_allclose(grown, turned.matrix(), atol=1e-9)


def test_bodies_have_the_masses_given_and_keep_the_rest() -> None:
    platform = {"mass": 24.0, "centre": [0.0, 0.01, 0.05], "inertia": INERTIA.tolist()}
    given = Masses({"leg_*_rod": {"mass": 5.0}, "leg_c3_rod": {"mass": 6.0}, "terminal_platform": platform})
    assumed, changed = bodies(urdf_text()), bodies(urdf_text(masses=given))
    for link, (mass, centre, moments) in assumed.items():
        if link == "terminal_platform":
            expected: tuple[Any, ...] = (24.0, platform["centre"], INERTIA)
        elif link.startswith("leg_") and link.endswith("_rod"):
            new = 6.0 if link == "leg_c3_rod" else 5.0
            expected = (new, centre, moments * new / mass)
        else:
            expected = (mass, centre, moments)
        for value, wanted in zip(changed[link], expected, strict=True):
            np.testing.assert_allclose(value, wanted, atol=1e-12, err_msg=link)


def bodies(urdf: str) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    """Mass, centre and inertia in the axes of the link, read by yourdfpy."""
    robot = yourdfpy.URDF.load(io.StringIO(urdf), build_scene_graph=False, load_meshes=False)
    found = {}
    for name, link in robot.link_map.items():
        turn = link.inertial.origin[:3, :3]
        found[name] = link.inertial.mass, link.inertial.origin[:3, 3], turn @ link.inertial.inertia @ turn.T
    return found


def test_all_formats_weigh_the_same() -> None:
    mujoco = pytest.importorskip("mujoco")
    given = Masses({"middle_platform": {"mass": 30.0}}, PAYLOAD)
    model = mujoco.MjModel.from_xml_string(mjcf_text(masses=given))
    expected = pin.buildModelFromXML(urdf_text(masses=given))
    grounded = sum(mass for name, (mass, *_) in bodies(urdf_text(masses=given)).items() if name.startswith("base"))
    assert model.body_mass.sum() == pytest.approx(pin.computeTotalMass(expected) + grounded, rel=1e-9)
    parts = spm.casadi.bodies(masses=given)
    chain = spm.ClosedChain.from_urdf(masses=given)
    state = STATE.middle_joints, STATE.rotation, STATE.translation
    forces = spm.casadi.gravity()(*state, parts, np.zeros(4), [0.0, 0.0, -9.81])
    np.testing.assert_allclose(forces.full().ravel(), weights(chain), rtol=1e-9)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="masses")):
        spm.casadi.bodies(masses=Masses({"leg_b2_rod": {"mass": 3.0, "centre": [0.1, 0.0, 0.0]}}))


def test_a_file_gives_the_same_masses(tmp_path: Path) -> None:
    content = {
        "bodies": {"terminal_platform": {"mass": 24.0, "inertia": INERTIA.tolist()}, "leg_*_rod": {"mass": 5.0}},
        "payload": {"mass": 10.0, "centre": [0.1, -0.05, 0.2], "inertia": np.asarray(PAYLOAD.inertia).tolist()},
    }
    file = tmp_path / "masses.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    read, made = Masses.from_yaml(file), Masses(content["bodies"], PAYLOAD)
    assert urdf_text(masses=read, prefix="left_") == urdf_text(masses=made, prefix="left_")
    # A URDF that is given takes them as well.
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(urdf_text(), encoding="utf-8")
    chain = spm.ClosedChain.from_urdf(urdf, masses=read)
    np.testing.assert_allclose(weights(chain), weights(spm.ClosedChain.from_urdf(masses=made)), rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- 1", "expected a mapping with the keys bodies and payload, got list"),
        ("masses: {}", "got masses"),
        ("payload: {mass: -1}", r"payload.mass in .*: expected a mass in kg, not negative, got -1"),
        ("payload: {centre: [0, 0, 0]}", "payload in .*: expected a mapping with mass"),
        ("bodies: {platform: {mass: 3, centre: [0, 1]}}", r"platform\].centre in .*: expected real numbers"),
        ("payload: {mass: 1, inertia: [[1, 0, 0], [0, 1, 0], [0, 0, 9]]}", "payload.inertia in .*: expected principal"),
        ("payload: {mass: 010}", "payload.mass in .* str '010'"),
    ],
)
def test_a_file_that_has_no_masses_is_refused(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "masses.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError, match=words):
        Masses.from_yaml(file)


def test_a_payload_on_a_link_without_mass_is_all_of_its_mass() -> None:
    root = ElementTree.fromstring(urdf_text())
    (link,) = root.findall("link[@name='terminal_platform']")
    link.remove(link.find("inertial"))
    loaded = with_masses(ElementTree.tostring(root, encoding="unicode"), Masses(payload=PAYLOAD), "")
    expected = PAYLOAD.mass, PAYLOAD.centre, PAYLOAD.inertia
    for value, wanted in zip(bodies(loaded)["terminal_platform"], expected, strict=True):
        np.testing.assert_allclose(value, wanted, atol=1e-12)


def test_an_unknown_link_is_refused() -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="bodies")):
        Masses({1: {"mass": 1.0}})  # type: ignore[dict-item]
    with pytest.raises(DescriptionError, check=with_fields(argument="masses")):
        urdf_text(masses=Masses({"legs": {"mass": 1.0}}))


NUMBERS = yaml.safe_load(description_file("config/inertials.yaml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module", params=["paper", "wide base"])
def tree(request: pytest.FixtureRequest) -> KinematicTree:
    return KinematicTree(urdf_text(MANIPULATORS[request.param]))


def volume_and_moments(kind: str, *size: float) -> tuple[float, Array]:
    """Volume and second moments per volume about the centre (3, 3) of a box, or of a sphere or cylinder about z."""
    if kind == "box":
        x, y, z = size
        return x * y * z, np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) / 12.0
    if kind == "sphere":
        return 4.0 / 3.0 * np.pi * size[0] ** 3, 0.4 * size[0] ** 2 * np.eye(3)
    radius, length = size
    across = (3.0 * radius**2 + length**2) / 12.0
    return np.pi * radius**2 * length, np.diag([across, across, 0.5 * radius**2])


def simple_bodies(name: str, link: ElementTree.Element, tree: KinematicTree) -> list[tuple[tuple[float, Array], Array]]:
    """The simple bodies whose inertia a link has, each with its pose (4, 4) in the link."""
    if name.endswith(("_cylinder", "_rod")):  # what collides ends short of the joints
        (tube,) = [v for v in link.findall("visual") if "/tube.obj" in str(v.find("geometry/mesh").get("filename"))]
        radius, _, length = vector(tube.find("geometry/mesh").get("scale"))
        pose = origin(tube)
        pose[2, 3] += 0.5 * length
        return [(volume_and_moments("cylinder", radius, length), pose)]
    if name.startswith("ball_") or name.endswith("_tip"):  # inside a ball joint nothing collides
        size = vector(tree.links["base_a1"].find("visual/geometry/mesh").get("scale"))[0]
        sizes = NUMBERS["leg"]["tip_radius"] if name.endswith("_tip") else NUMBERS["ball_radius"]
        return [(volume_and_moments("sphere", sizes * size), np.eye(4))]
    # Two balls share the socket of a corner: that of the lower leg collides, and each has half of the mass.
    link = tree.links[name.removesuffix("_upper")]
    found = []
    for collision in link.findall("collision"):
        (solid,) = collision.findall("geometry/*")
        size = [v for key in ("size", "radius", "length") if solid.get(key) for v in vector(solid.get(key))]
        found.append((volume_and_moments(solid.tag, *size), origin(collision)))
    return found


def test_inertia_is_that_of_simple_bodies(tree: KinematicTree) -> None:
    for name, link in tree.links.items():
        solids = simple_bodies(name, link, tree)
        volume = sum(v for (v, _), _ in solids)
        centre = sum(v * pose[:3, 3] for (v, _), pose in solids) / volume
        mass, frame, moments = inertia(link)
        share = 0.5 if name.startswith(("middle_b2", "middle_b3")) else 1.0
        densities = [share * density for density in NUMBERS["density"].values()]
        assert any(mass / volume == pytest.approx(density) for density in densities), name
        np.testing.assert_allclose(frame[:3, 3], centre, atol=1e-15, err_msg=name)
        expected = np.zeros((3, 3))
        for (v, second), pose in solids:
            arm = pose[:3, 3] - centre
            about_centre = pose[:3, :3] @ second @ pose[:3, :3].T + arm @ arm * np.eye(3) - np.outer(arm, arm)
            expected += v * mass / volume * about_centre
        found = frame[:3, :3] @ moments @ frame[:3, :3].T
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * expected.max(), err_msg=name)
