"""Singular configurations: recognised, named, and with the quantities that stay finite there."""

from __future__ import annotations

import numpy as np
import problems
import pytest
from error_fields import with_fields
from multibody.chains import EPS, PAPER, POSE, chain, placed, six_branches, wrench_conditions
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.errors import ArgumentError, SingularConfigurationError

pinocchio = pytest.importorskip("pinocchio")


from spm_pin.multibody.constrained_model import SINGULAR  # noqa: E402

HOME = np.zeros(18)


def test_home_is_an_inverse_singularity() -> None:
    """NumPy's solve sees nothing wrong there, and returns some 1e16."""
    home = chain().state(HOME)
    for call, *twists in (
        (home.inverse_jacobian,),
        (home.platform_dynamics,),
        (home.joint_velocities, np.ones(6)),
        (home.joint_accelerations, np.zeros(6)),
    ):
        with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse", index=())) as caught:
            call(*twists)
        assert caught.value.sigma_min <= 10 * SINGULAR
    values = home.singular_values()
    assert values.inverse <= 10 * SINGULAR
    assert min(values.forward, values.constraint) > 0.1
    # Forces accelerate and hold.
    for wrench in np.random.default_rng(121).normal(size=(10, 6)):
        expected = spm.leg_forces(home.configuration(), wrench)
        assert np.linalg.norm(home.leg_forces(wrench) - expected) <= 1e-13 * np.linalg.norm(expected)
    assert np.abs(home.forward_dynamics(home.inverse_dynamics(HOME))).max() <= 1e-9
    assert np.abs(home.forward_dynamics(np.zeros(6))).max() > 1.0


def test_between_two_branches_that_meet() -> None:
    """Half way between two branches of a family the closures' quadratics are singular to the last bit."""
    pose = problems.at_discriminant(POSE, 0, 1e-13, PAPER)
    plus, minus = spm.inverse_displacement(PAPER, pose).configurations[:2]
    state = spm.Configuration(PAPER, pose, (plus.middle_joints + minus.middle_joints) / 2)
    robot = chain()
    q = robot.joint_values(state)
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")):
        robot.state(q).inverse_jacobian()
    wrench = np.arange(1.0, 7.0)
    expected = spm.leg_forces(state, wrench)
    # As far as closure is violated, to second order in the branches' distance, q is another state.
    allowed = 64 * (EPS + float(state.closure_residual)) / robot.state(q).singular_values().forward ** 2
    assert np.linalg.norm(robot.state(q).leg_forces(wrench) - expected) <= allowed * np.linalg.norm(wrench)


@pytest.mark.parametrize("mode", ["T", "F"])
def test_forward_singularities(mode: str) -> None:
    """A level lower stage of no height: its three legs and their axes lie in the plane, and lift nothing."""
    state = problems.without_torsion(PAPER, (0.0, 0.0, 0.0), (0.4, 0.3, -1.1), f"{mode}T")
    robot = chain()
    q = robot.joint_values(state)
    flat = robot.state(q)
    for call, argument in ((flat.leg_forces, np.ones(6)), (flat.cut_forces, np.ones(6)), (flat.inverse_dynamics, HOME)):
        with pytest.raises(SingularConfigurationError, check=with_fields(kind="forward")):
            call(argument)
    assert np.isfinite(flat.forward_dynamics(np.zeros(6))).all()
    assert robot.state(q).singular_values().forward <= 10 * SINGULAR
    assert robot.state(q).singular_values().constraint > 1e-3
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="forward")):
        spm.leg_forces(state, np.ones(6))


@pytest.mark.parametrize("which", ["lower", "upper"])
def test_constraint_singularities(which: str) -> None:
    """A stage tilted half round: its three revolute axes and the middle platform's plane fall together."""
    regular, turned = (0.4, 0.3), (1.1, 1.0)
    lower, upper = (turned, regular) if which == "lower" else (regular, turned)
    state = problems.without_torsion(PAPER, (*lower, 1.2), (*upper, -1.1))
    robot = chain()
    q = robot.joint_values(state)
    for call in (lambda q: robot.state(q).inverse_jacobian(), lambda q: robot.state(q).leg_forces(np.ones(6))):
        with pytest.raises(SingularConfigurationError, check=with_fields(kind="constraint")):
            call(q)
    values = robot.state(q).singular_values()
    assert max(values.constraint, values.inverse, values.forward) <= 10 * SINGULAR
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="constraint")):
        spm.inverse_jacobian(state)


def test_kinds_are_those_of_the_closed_form() -> None:
    """Each smallest singular value goes to zero with its counterpart in the 6 x 6 matrices."""
    for name in ("paper", "millimetres"):
        for state, q in placed(name, 20, seed=122):
            values = chain(name).state(q).singular_values()
            stages, both = wrench_conditions(state)
            for tree, wrenches in ((values.forward, stages), (values.inverse, both)):
                assert 1e-3 < tree / wrenches < 1e3


def test_a_ball_joint_at_a_right_angle() -> None:
    """Its three revolute joints lose a rotation there, which is no property of the mechanism."""
    robot = chain()
    q = robot.joint_values(six_branches()[0])
    for ball in ("ball_b1_y", "ball_c1_y"):
        right = q.copy()
        right[robot.joint_indices(ball)] = -np.pi / 2
        state = robot.state(right)
        for call in (state.inverse_jacobian, state.singular_values, lambda s=state: s.leg_forces(np.ones(6))):
            with pytest.raises(ArgumentError, check=with_fields(argument="q", expected=f"{ball} away from ±90°")):
                call()


def test_singular_values_do_not_depend_on_the_ball_angles() -> None:
    """Renumbered, another leg carries the tree's balls, at other angles: the robot is as near to singularity."""
    robot = chain()
    # Tilted by 2 asin(half sine) about the level normal of leg 1's axis: that is the middle angle of its ball.
    across = np.deg2rad(60.0 + 90.0)
    tilts = np.deg2rad([45.0, 60.0, 75.0, 85.0, 89.0, 89.9, 89.99])
    steep = [problems.without_torsion(PAPER, (across, np.sin(tilt / 2), 1.2), (0.5, 0.2, -1.3)) for tilt in tilts]
    for state, tilt in zip(steep, tilts, strict=True):
        (angle,) = robot.joint_values(state)[robot.joint_indices("ball_b1_y")]
        assert abs(angle) == pytest.approx(tilt)
    # Turned about Z with base and platform, leg 2 in leg 1's place.
    turn = Rotation.from_euler("z", 120, degrees=True).as_matrix()
    for state in [*six_branches(), *steep]:
        pose = spm.pose(turn @ state.translation, rotation=turn @ state.rotation @ turn.T)
        turned = spm.Configuration(PAPER, pose, np.roll(state.middle_joints @ turn.T, 1, axis=0))
        before, after = (robot.state(robot.joint_values(s)).singular_values() for s in (state, turned))
        assert np.abs(np.log(np.divide(after, before))).max() < np.log(3.0)
