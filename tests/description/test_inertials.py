"""Masses and inertias are those of bodies that can exist, and of simple bodies; what is drawn are meshes."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from description.kinematic_tree import Array, KinematicTree, inertia, origin, vector
from problems import GEOMETRIES

from spm_pin.description import urdf_text
from spm_pin.description.source_files import description_file

NUMBERS = yaml.safe_load(description_file("config/inertials.yaml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module", params=GEOMETRIES)
def tree(request: pytest.FixtureRequest) -> KinematicTree:
    return KinematicTree(urdf_text(GEOMETRIES[request.param]))


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


def bodies(name: str, link: ElementTree.Element, tree: KinematicTree) -> list[tuple[tuple[float, Array], Array]]:
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
        solids = bodies(name, link, tree)
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


def test_plausible_at_the_paper_s_size() -> None:
    masses = {name: inertia(link)[0] for name, link in KinematicTree(urdf_text()).links.items()}
    balls = [mass for name, mass in masses.items() if name.startswith("ball_")]
    assert balls == [pytest.approx(0.2, rel=1e-3)] * 4
    assert 100.0 < sum(masses.values()) < 250.0


def test_visual_and_collision_geometry(tree: KinematicTree) -> None:
    materials = {str(m.get("name")) for m in tree.root.findall("material")}
    for name, link in tree.links.items():
        visuals = link.findall("visual")
        assert {material.get("name") for material in link.findall("visual/material")} <= materials
        assert bool(visuals) != (name.startswith("ball_") or name.endswith("_upper")), name
        assert bool(link.findall("collision")) != (name.startswith("ball_") or name.endswith(("_tip", "_upper"))), name
        for mesh in link.findall("visual/geometry/mesh"):
            assert (vector(mesh.get("scale")) > 0.0).all(), name
            assert Path(str(mesh.get("filename"))).is_file(), name
        for solid in link.findall("collision/geometry/*"):
            assert solid.tag in ("box", "cylinder", "sphere"), name
            assert all((vector(value) > 0.0).all() for value in solid.attrib.values()), name
