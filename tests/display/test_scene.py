"""The scene: closed solids, in the right places, for every branch of every machine."""

from __future__ import annotations

import pickle
import sys

import numpy as np
import problems
import pytest

import spm_pin as spm
from spm_pin.display.scene import COLOURS, TRIAD, scene
from spm_pin.errors import ArgumentError, MissingExtraError, SpmError

PAPER = spm.Geometry.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
SOLUTIONS = spm.inverse_displacement(PAPER, POSE)
STATE = SOLUTIONS.physical()


def along(mesh, start, end):
    """Nearest and farthest vertex of a mesh along a line [m], and the largest distance from it."""
    direction = (end - start) / np.linalg.norm(end - start)
    lengths = (mesh.vertices - start) @ direction
    across = mesh.vertices - start - lengths[:, None] * direction
    return lengths.min(), lengths.max(), np.linalg.norm(across, axis=-1).max()


@pytest.mark.parametrize("name", problems.GEOMETRIES)
@pytest.mark.parametrize("family", spm.mechanism.FAMILIES)
def test_every_machine_in_every_family_makes_closed_solids(name, family):
    geometry = problems.GEOMETRIES[name]
    for state in problems.random_branches(geometry, family, 3, seed=5).configuration:
        built = scene(state)
        names = [solid.name for solid in built.solids]
        assert len(set(names)) == len(names)
        for solid in built.solids:
            assert solid.mesh.is_watertight, solid.name
            assert solid.mesh.is_winding_consistent, solid.name
            assert solid.mesh.volume > 0.0, solid.name


def test_legs_run_from_revolute_joint_to_ball():
    built = scene(STATE)
    hips = np.concatenate([PAPER.base_joints, STATE.platform_joints])
    for i, leg in enumerate(spm.mechanism.LEGS):
        hip, ball = hips[i], STATE.middle_joints[i % 3]
        start, joint, barrel_radius = along(built[f"{leg} barrel"].mesh, hip, ball)
        again, end, rod_radius = along(built[f"{leg} rod"].mesh, hip, ball)
        np.testing.assert_allclose([start, again, end], [0.0, joint, STATE.leg_lengths[i]], atol=1e-12)
        assert rod_radius < barrel_radius < 0.1 * STATE.leg_lengths[i]


def test_barrels_keep_their_length_from_pose_to_pose():
    lengths = []
    for state in problems.in_leg_space(PAPER, 4, seed=3).configuration:
        _, length, _ = along(scene(state)["r_c2 barrel"].mesh, state.platform_joints[1], state.middle_joints[1])
        lengths.append(length)
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-12)


def test_pins_lie_on_the_revolute_axes_and_balls_around_their_centres():
    built = scene(STATE)
    for i in range(3):
        for letter, points, axes in (
            ("a", PAPER.base_joints, PAPER.revolute_axes),
            ("c", STATE.platform_joints, STATE.platform_axes),
        ):
            low, high, radius = along(built[f"{letter}_{i + 1} pin"].mesh, points[i], points[i] + axes[i])
            assert low == pytest.approx(-high)
            assert high > 2.0 * radius
        ball = built[f"b_{i + 1} ball"].mesh
        radii = np.linalg.norm(ball.vertices - STATE.middle_joints[i], axis=-1)
        np.testing.assert_allclose(radii, radii[0], rtol=1e-12)


def test_plates_lie_in_the_planes_of_their_joints():
    built = scene(STATE)
    middle = STATE.middle_pose.as_matrix()
    for name, rotation, origin in (
        ("base", np.eye(3), np.zeros(3)),
        ("middle platform", middle[:3, :3], middle[:3, 3]),
        ("terminal platform", STATE.rotation, STATE.translation),
    ):
        local = (built[name].mesh.vertices - origin) @ rotation
        assert local[:, 2].max() == pytest.approx(-local[:, 2].min())
        np.testing.assert_allclose(built[name].mesh.center_mass, origin, atol=1e-12)


def test_stages_have_colours_of_their_own_and_frames_can_be_left_out():
    built = scene(STATE)
    assert built["r_b1 barrel"].colour == COLOURS["lower leg"] != built["r_c1 barrel"].colour
    for k, axis in enumerate("xyz"):
        start, end, _ = along(built[f"{{m}} {axis}"].mesh, STATE.translation, STATE.translation + STATE.rotation[:, k])
        np.testing.assert_allclose([start, end], [0.0, TRIAD * built.size], atol=1e-12)
    assert {s.name for s in built.solids} - {s.name for s in scene(STATE, frames=False).solids} == {
        f"{{{frame}}} {axis}" for frame in "Bm" for axis in "xyz"
    }


def test_sizes_scale_with_the_machine():
    factor = 0.01
    small = spm.Geometry(PAPER.base_radius * factor, PAPER.platform_radius * factor, PAPER.middle_side * factor)
    large = spm.Geometry(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side)
    pose = spm.pose(STATE.translation * factor, rotation=STATE.rotation)
    little = scene(spm.Configuration(small, pose, STATE.middle_joints * factor))
    big = scene(spm.Configuration(large, POSE, STATE.middle_joints))
    for one, other in zip(little.solids, big.solids, strict=True):
        np.testing.assert_allclose(one.mesh.bounds, other.mesh.bounds * factor, atol=1e-9)


def test_unknown_solid():
    with pytest.raises(KeyError, match="r_b1 barrel"):
        scene(STATE)["r_d1 barrel"]


@pytest.mark.parametrize(
    ("state", "says"),
    [
        (SOLUTIONS, "SolutionSet"),
        (SOLUTIONS.configurations, "batch of shape"),
        (SOLUTIONS["FT+"], "no such real branch"),
        (spm.Configuration(PAPER, POSE, PAPER.base_joints), "positive length"),
        (spm.Configuration(PAPER, POSE, [[0.0, 0.0, 1.0], [0.0, 0.1, 1.0], [0.0, 0.2, 1.0]]), "span a plane"),
    ],
)
def test_what_cannot_be_shown_is_refused(state, says):
    with pytest.raises(ArgumentError, match=says):
        scene(state)


def test_without_trimesh_the_error_tells_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r'pip install "\.\[plots\]"') as caught:
        scene(STATE)
    assert isinstance(caught.value, SpmError)
    assert isinstance(caught.value, ImportError)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.extra, again.package, again.name, str(again)) == ("plots", "trimesh", "trimesh", str(caught.value))
