"""Masses and inertias are those of bodies that can exist, and of the solids that are drawn."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from description.kinematic_tree import Array, KinematicTree, inertia, origin, vector
from problems import GEOMETRIES

import spm_pin as spm
from spm_pin.description.expand import expand
from spm_pin.description.paths import description_file

PAPER = GEOMETRIES["paper"]
DENSITIES = yaml.safe_load(description_file("config/inertials.yaml").read_text(encoding="utf-8"))["density"].values()


@pytest.fixture(scope="module", params=GEOMETRIES)
def tree(request: pytest.FixtureRequest) -> KinematicTree:
    return KinematicTree(expand(GEOMETRIES[request.param]))


def test_every_link_is_a_possible_body(tree: KinematicTree) -> None:
    for name, link in tree.links.items():
        mass, _, moments = inertia(link)
        assert mass > 0.0, name
        a, b, c = np.linalg.eigvalsh(moments)
        assert a > 0.0, name
        assert c <= (a + b) * (1.0 + 1e-12), name


def shape(element: ElementTree.Element) -> tuple[float, Array]:
    """Volume and second moments per volume about the centre (3, 3), in the shape's own frame."""
    (solid,) = element.findall("geometry/*")
    if solid.tag == "box":
        x, y, z = vector(solid.get("size"))
        return x * y * z, np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) / 12.0
    radius = float(str(solid.get("radius")))
    if solid.tag == "sphere":
        return 4.0 / 3.0 * np.pi * radius**3, 0.4 * radius**2 * np.eye(3)
    assert solid.tag == "cylinder"
    length = float(str(solid.get("length")))
    across = (3.0 * radius**2 + length**2) / 12.0
    return np.pi * radius**2 * length, np.diag([across, across, 0.5 * radius**2])


def test_inertia_is_that_of_the_drawn_solids(tree: KinematicTree) -> None:
    for name, link in tree.links.items():
        solids = [(shape(visual), origin(visual)) for visual in link.findall("visual")]
        volume = sum(v for (v, _), _ in solids)
        centre = sum(v * pose[:3, 3] for (v, _), pose in solids) / volume
        mass, frame, moments = inertia(link)
        assert any(mass / volume == pytest.approx(density) for density in DENSITIES), name
        np.testing.assert_allclose(frame[:3, 3], centre, atol=1e-15, err_msg=name)
        expected = np.zeros((3, 3))
        for (v, second), pose in solids:
            arm = pose[:3, 3] - centre
            about_centre = pose[:3, :3] @ second @ pose[:3, :3].T + arm @ arm * np.eye(3) - np.outer(arm, arm)
            expected += v * mass / volume * about_centre
        found = frame[:3, :3] @ moments @ frame[:3, :3].T
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * expected.max(), err_msg=name)


def test_plausible_at_the_paper_s_size() -> None:
    masses = {name: inertia(link)[0] for name, link in KinematicTree(expand()).links.items()}
    balls = [mass for name, mass in masses.items() if name.startswith("ball_")]
    assert balls == [pytest.approx(0.2, rel=1e-3)] * 4
    assert 100.0 < sum(masses.values()) < 250.0


def test_mass_goes_with_volume() -> None:
    double = spm.Geometry(2 * PAPER.base_radius, 2 * PAPER.platform_radius, 2 * PAPER.middle_side)
    single = spm.Geometry(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side)
    small, large = KinematicTree(expand(single)), KinematicTree(expand(double))
    for name, link in small.links.items():
        (mass, _, moments), (more, _, larger) = inertia(link), inertia(large.links[name])
        assert more == pytest.approx(8.0 * mass), name
        np.testing.assert_allclose(larger, 32.0 * moments, rtol=1e-12)


def test_drawn_and_collided(tree: KinematicTree) -> None:
    materials = {str(m.get("name")) for m in tree.root.findall("material")}
    for name, link in tree.links.items():
        visuals = link.findall("visual")
        assert visuals, name
        assert {material.get("name") for material in link.findall("visual/material")} <= materials
        inside_a_ball = name.startswith("ball_") or name.endswith("_tip")
        assert bool(link.findall("collision")) != inside_a_ball, name
        for element in [*visuals, *link.findall("collision")]:
            assert shape(element)[0] > 0.0, name
            (solid,) = element.findall("geometry/*")
            assert all((vector(value) > 0.0).all() for value in solid.attrib.values()), name
