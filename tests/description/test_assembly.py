"""The tree is assembled at home for every machine, and in every real configuration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from description.kinematic_tree import SLIDES, STATES, TREE, KinematicTree
from problems import MANIPULATORS, in_leg_space

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.description.source_files import read_closures
from spm_pin.description.tree import joint_values
from spm_pin.machine.joint_angles import home_readings

EPS = np.finfo(float).eps
PAPER = spm.Manipulator.paper()
CLOSURES = read_closures()


def limited(minimum: float | list[float], maximum: float | list[float]) -> spm.Manipulator:
    return spm.Manipulator(1.2, 0.5, 0.8, spm.LegLimits(minimum, maximum))


LIMITED = {
    "a limit for each leg": limited([1.1, 1.0, 0.9, 0.7, 0.8, 0.6], [1.5, 1.7, 1.6, 1.2, 1.1, 1.3]),
    "no longest leg": limited(1.3, math.inf),
    "too short to stand": limited(0.2, 0.3),
    "nothing shared": limited([0.9, 1.2, 1.5, 0.9, 1.2, 1.5], [1.0, 1.3, 1.6, 1.0, 1.3, 1.6]),
}
ALL = {"paper": PAPER, "wide base": MANIPULATORS["wide base"]} | LIMITED


@pytest.fixture(scope="module")
def trees() -> dict[str, KinematicTree]:
    return {name: KinematicTree(urdf_text(machine)) for name, machine in ALL.items()}


@pytest.mark.parametrize("name", ALL)
def test_home_is_assembled_and_symmetric(name: str, trees: dict[str, KinematicTree]) -> None:
    tree, machine = trees[name], ALL[name]
    assert tree.gap({}, CLOSURES) < 1e-12
    frames = tree.frames({})
    for platform in ("base", "middle_platform", "terminal_platform"):
        np.testing.assert_allclose(frames[platform][:3, :3], np.eye(3), atol=1e-14)
        np.testing.assert_allclose(frames[platform][:2, 3], 0.0, atol=1e-14)
    heights = [frames[platform][2, 3] for platform in ("base", "middle_platform", "terminal_platform")]
    assert heights[0] == 0.0 < heights[1] < heights[2]
    lower, upper = home_readings(machine)[[0, 3]]
    for leg, corner, home in (("b", "base_a", lower), ("c", "terminal_c", upper)):
        for i in (1, 2, 3):
            hip, tip, middle = (frames[name][:3, 3] for name in (f"{corner}{i}", f"leg_{leg}{i}_tip", f"middle_b{i}"))
            np.testing.assert_allclose(tip, middle, atol=1e-12)
            assert np.linalg.norm(tip - hip) == pytest.approx(home, abs=1e-12)
    # Corners and axes are the machine's.
    for i in range(3):
        a, c = frames[f"base_a{i + 1}"], np.linalg.inv(frames["terminal_platform"]) @ frames[f"terminal_c{i + 1}"]
        np.testing.assert_allclose(a[:3, 3], machine.base_joints[i], atol=1e-15)
        np.testing.assert_allclose(c[:3, 3], machine.platform_joints[i], atol=1e-14)
        for corner in (a, c):
            np.testing.assert_allclose(corner[:3, 0], machine.revolute_axes[i], atol=1e-15)
            np.testing.assert_allclose(corner[:3, 2], [0.0, 0.0, 1.0], atol=1e-15)
        for leg in (f"leg_b{i + 1}", f"leg_c{i + 1}"):
            np.testing.assert_allclose(frames[f"{leg}_cylinder"][:3, 0], machine.revolute_axes[i], atol=1e-14)


@pytest.mark.parametrize("name", ALL)
def test_slides_are_lengths_minus_home(name: str, trees: dict[str, KinematicTree]) -> None:
    limits, slides = ALL[name].limits, [trees[name].moving[slide].limit for slide in SLIDES]
    homes = home_readings(ALL[name])
    shortest, longest = (homes + [limit[end] for limit in slides] for end in ("lower", "upper"))
    assert (shortest > 0.0).all()
    assert (shortest < longest).all()
    if limits is not None:
        least, most = np.array(limits.minimum), np.array(limits.maximum)
        np.testing.assert_allclose(shortest[least > 0.0], least[least > 0.0], rtol=0, atol=4 * EPS)
        np.testing.assert_allclose(longest[most < math.inf], most[most < math.inf], rtol=0, atol=4 * EPS)


def test_home_lies_in_the_middle_of_the_shared_limits_if_it_can() -> None:
    assert set(home_readings(PAPER).tolist()) == {1.3}
    assert home_readings(LIMITED["a limit for each leg"])[[0, 3]] == pytest.approx((1.3, 0.95))
    for name in ("no longest leg", "too short to stand", "nothing shared"):
        machine = LIMITED[name]
        for length, radius in zip(home_readings(machine)[[0, 3]], (1.2, 0.5), strict=True):
            assert length > abs(machine.middle_radius - radius)


def test_joint_values_of_what_a_machine_does_are_small(trees: dict[str, KinematicTree]) -> None:
    """Inside the leg limits, in the mode of home: no joint near the end of its range or a ball's singularity."""
    for configuration in in_leg_space(PAPER, 50, seed=4).configuration:
        values = joint_values(configuration)
        slides = [values[name] for name in SLIDES]
        np.testing.assert_allclose(slides, configuration.leg_lengths - 1.3, atol=1e-14)
        assert all(abs(value) < 1.2 for value in values.values())
        assert trees["paper"].gap(values, CLOSURES) < 1e-12


def test_ball_joint_values_at_a_gimbal_singularity() -> None:
    """Middle angle ±90°: the outer two are not determined, yet the rotation is."""
    machine = spm.Manipulator(0.7, 0.7, 0.7 * 3**0.5)
    tree = KinematicTree(urdf_text(machine))
    corner = tree.frames({})["base_a1"][:3, :3]
    along_y = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    for turn in (along_y, along_y.T):
        middle = corner @ turn @ corner.T
        leg = np.array([0.0, 0.0, 1.4])
        b1 = machine.base_joints[0] + leg
        b = b1 + machine.middle_radius * (machine.radial_directions - machine.radial_directions[0]) @ middle.T
        pose = spm.pose(b1 + leg - machine.platform_joints[0], rotation=np.eye(3))
        # The other legs cannot follow, so only leg 1's chain is looked at.
        values = joint_values(spm.Configuration(machine, pose, b))
        assert abs(values["ball_b1_y"]) == pytest.approx(np.pi / 2, abs=1e-7)
        frames = tree.frames(values)
        np.testing.assert_allclose(frames["middle_platform"][:3, :3], middle, atol=1e-14)
        np.testing.assert_allclose(frames["terminal_platform"], pose.as_matrix(), atol=1e-13)


def test_named_states_are_the_paper_s_solutions() -> None:
    assert list(STATES) == ["home", "reference", *(f"solution_{n}" for n in (1, 2, 3, 4, 6, 7))]
    assert STATES["reference"] == STATES["solution_3"]
    assert set(STATES["home"].values()) == {0.0}
    # Table 2, Y of b_2 [m].
    printed = {1: 0.32471, 2: 0.39947, 3: 0.46190, 4: 0.64583, 6: -0.31569, 7: -0.45511}
    pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88])).as_matrix()
    for number, b2y in printed.items():
        state = STATES[f"solution_{number}"]
        assert state.keys() == TREE.moving.keys()
        frames = TREE.frames(state)
        assert TREE.gap(state, CLOSURES) < 1e-12
        np.testing.assert_allclose(frames["terminal_platform"], pose, atol=1e-12)
        assert frames["middle_b2"][1, 3] == pytest.approx(b2y, abs=1e-5)
