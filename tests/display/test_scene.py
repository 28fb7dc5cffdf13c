"""The scene: the solids of the URDF, in the right places, for every branch of every machine."""

from __future__ import annotations

import numpy as np
import problems
import pytest
import trimesh
from description.kinematic_tree import KinematicTree, origin, vector

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.description.tree import joint_values
from spm_pin.description.visuals import part_placements, section_size, visual_parts
from spm_pin.display.rendering import AXIS_COLOURS, TRIAD, robot_solids
from spm_pin.errors import ArgumentError

PAPER = spm.Geometry.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
SOLUTIONS = spm.inverse_displacement(PAPER, POSE)
STATE = SOLUTIONS.physical()


def solids(state, **options):
    return {solid.name: solid for solid in robot_solids(state, **options)}


def along(vertices, start, end):
    """Nearest and farthest vertex along a line [m], and the largest distance from it."""
    direction = (end - start) / np.linalg.norm(end - start)
    lengths = (vertices - start) @ direction
    across = vertices - start - lengths[:, None] * direction
    return lengths.min(), lengths.max(), np.linalg.norm(across, axis=-1).max()


@pytest.mark.parametrize("name", problems.GEOMETRIES)
def test_every_machine_in_every_family_makes_closed_solids(name):
    for family in spm.mechanism.FAMILIES:
        built = robot_solids(problems.random_branches(problems.GEOMETRIES[name], family, 1, seed=5).configuration[0])
        assert len({solid.name for solid in built}) == len(built)
        for solid in built:
            mesh = trimesh.Trimesh(solid.vertices, solid.faces)
            assert mesh.is_watertight, solid.name
            assert mesh.is_winding_consistent, solid.name
            assert mesh.volume > 0.0, solid.name


@pytest.mark.parametrize("name", [*problems.GEOMETRIES, "as built"])
def test_solids_are_those_of_the_urdf_where_its_joints_put_them(name):
    geometry = problems.GEOMETRIES.get(name, problems.as_built(PAPER, 5e-2))
    tree = KinematicTree(urdf_text(geometry))
    colours = {m.get("name"): vector(m.find("color").get("rgba"))[:3] for m in tree.root.findall("material")}
    if geometry.is_nominal:
        state = problems.random_branches(geometry, "TT", 1, seed=2).configuration[0]
    else:
        state = spm.forward_physical(geometry, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    frames, built = tree.frames(joint_values(state)), solids(state, frames=False)
    count = 0
    for link, element in tree.links.items():
        for visual in element.findall("visual"):
            file = visual.find("geometry/mesh")
            mesh = trimesh.load(file.get("filename"), process=False, maintain_order=True)
            pose = frames[link] @ origin(visual)
            expected = (mesh.vertices * vector(file.get("scale"))) @ pose[:3, :3].T + pose[:3, 3]
            name_of_mesh = file.get("filename").rpartition("/")[2].removesuffix(".obj")
            solid = built[f"{link} {name_of_mesh}"]
            np.testing.assert_allclose(solid.colour, colours[visual.find("material").get("name")])
            count += 1
            if name_of_mesh in ("tube", "gland"):  # as long as the leg needs: tested below
                continue
            np.testing.assert_allclose(solid.vertices.min(axis=0), expected.min(axis=0), atol=1e-9)
            np.testing.assert_allclose(solid.vertices.max(axis=0), expected.max(axis=0), atol=1e-9)
    assert count == len(built)


@pytest.mark.parametrize("label", [label for label in SOLUTIONS.labels if SOLUTIONS[label].exists])
@pytest.mark.parametrize("limits", [None, spm.LegLimits(1.1, 1.5), spm.LegLimits(0.3, 3.0)])
def test_a_leg_is_one_leg_whatever_its_length(label, limits):
    """The real branches have legs from 0.6 to 2 m; the rod begins inside the barrel and ends in the ball."""
    geometry = spm.Geometry(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side, limits)
    state = SOLUTIONS[label]
    built = solids(spm.Configuration(geometry, state.pose, state.middle_joints))
    for leg, hip, ball in zip(spm.mechanism.LEGS, state.leg_bases, state.balls, strict=True):
        length = np.linalg.norm(ball - hip)
        start, joint, barrel_radius = along(built[f"leg_{leg[2:]}_cylinder tube"].vertices, hip, ball)
        rod_start, end, rod_radius = along(built[f"leg_{leg[2:]}_rod tube"].vertices, hip, ball)
        gland_start, gland_end, _ = along(built[f"leg_{leg[2:]}_cylinder gland"].vertices, hip, ball)
        np.testing.assert_allclose([start, end], [0.0, length], atol=1e-12)
        assert 0.0 < rod_start < joint < length
        assert gland_start < joint < gland_end < length
        assert rod_radius < barrel_radius < 0.1 * length


def test_within_its_limits_a_leg_is_that_of_the_urdf():
    """Rod and barrel of fixed lengths overlap, from the shortest leg to the longest, and no rod leaves its hip."""
    for limits in (PAPER.limits, spm.LegLimits(1.0, 1.9), spm.LegLimits([0.9] * 3 + [0.5] * 3, [1.6] * 3 + [0.9] * 3)):
        geometry = spm.Geometry(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side, limits)
        tubes = {part.name: np.ptp(part.vertices[:, 2]) for part in visual_parts(geometry) if part.mesh == "tube"}
        for k, leg in enumerate(spm.mechanism.LEGS):
            barrel, rod = (tubes[f"leg_{leg[2:]}_{half} tube"] for half in ("cylinder", "rod"))
            assert barrel + rod > limits.maximum[k]
            assert max(barrel, rod) < limits.minimum[k]


def test_placements_of_a_batch_are_those_of_its_members():
    batch = SOLUTIONS.configurations
    together = part_placements(batch)
    for i in range(len(batch)):
        if batch.exists[i]:
            np.testing.assert_allclose(together[i], part_placements(batch[i]), rtol=1e-14, atol=1e-14)
        else:
            assert np.isnan(together[i]).any()


@pytest.mark.parametrize("size", [0.0, 1e-3, 5e-2])
def test_pins_lie_on_the_revolute_axes_and_legs_go_from_pivots_to_balls(size):
    """The legs are as long as the distance of pivot and ball, whatever the offsets of the encoders."""
    machine = problems.as_built(PAPER, size)
    assert (np.abs(machine.legs.offsets).max() > 0.5 * size) == (size > 0.0)
    state = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    built = solids(state)
    place = state.pose.as_matrix()
    for k, leg in enumerate(spm.mechanism.LEGS):
        pivot, axis = machine.legs.pivots[k], machine.legs.axes[k]
        if k >= 3:
            pivot, axis = place[:3, :3] @ pivot + place[:3, 3], place[:3, :3] @ axis
        link = f"{'base_a' if k < 3 else 'terminal_c'}{k % 3 + 1}"
        low, high, radius = along(built[f"{link} pin"].vertices, pivot, pivot + axis)
        assert low == pytest.approx(-high)
        assert high > 2.0 * radius
        ball = built[f"leg_{leg[2:]}_tip ball"].vertices
        radii = np.linalg.norm(ball - state.balls[k], axis=-1)
        np.testing.assert_allclose(radii, radii[0], rtol=1e-4)
        start, _, _ = along(built[f"leg_{leg[2:]}_cylinder tube"].vertices, pivot, state.balls[k])
        _, end, _ = along(built[f"leg_{leg[2:]}_rod tube"].vertices, pivot, state.balls[k])
        assert start == pytest.approx(0.0, abs=1e-9)
        assert end == pytest.approx(state.readings[k] - machine.legs.offsets[k], abs=1e-9)


def test_frames_are_arrows_along_their_axes_and_can_be_left_out():
    built, size = solids(STATE), section_size(PAPER)
    for frame, rotation, start in (("B", np.eye(3), np.zeros(3)), ("m", STATE.rotation, STATE.translation)):
        for k, axis in enumerate("xyz"):
            arrow = built[f"{{{frame}}} {axis}"]
            low, high, radius = along(arrow.vertices, start, start + rotation[:, k])
            np.testing.assert_allclose([low, high], [0.0, TRIAD * size], atol=1e-12)
            assert radius < 0.12 * high
            assert arrow.colour == AXIS_COLOURS[axis]
    assert built.keys() - solids(STATE, frames=False).keys() == {f"{{{f}}} {axis}" for f in "Bm" for axis in "xyz"}


def test_sizes_scale_with_the_machine():
    factor = 0.01
    small = spm.Geometry(PAPER.base_radius * factor, PAPER.platform_radius * factor, PAPER.middle_side * factor)
    large = spm.Geometry(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side)
    pose = spm.pose(STATE.translation * factor, rotation=STATE.rotation)
    little = robot_solids(spm.Configuration(small, pose, STATE.middle_joints * factor))
    big = robot_solids(spm.Configuration(large, POSE, STATE.middle_joints))
    for solid, larger in zip(little, big, strict=True):
        np.testing.assert_allclose(solid.vertices, larger.vertices * factor, atol=1e-12)


@pytest.mark.parametrize(
    ("state", "says"),
    [
        (SOLUTIONS, "SolutionSet"),
        (SOLUTIONS.configurations, "batch of shape"),
        (SOLUTIONS["FT+"], "configuration that exists"),
        (spm.Configuration(PAPER, POSE, PAPER.base_joints), "positive length"),
        (spm.Configuration(PAPER, POSE, [[0.0, 0.0, 1.0], [0.0, 0.1, 1.0], [0.0, 0.2, 1.0]]), "span a plane"),
    ],
)
def test_what_cannot_be_shown_is_refused(state, says):
    with pytest.raises(ArgumentError, match=says):
        robot_solids(state)
