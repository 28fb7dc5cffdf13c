"""Forces and accelerations: against plain equations, two other engines, finite differences and energy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import problems
import pytest
from engines import Drake, Mujoco, accelerations
from error_fields import with_fields
from multibody.chains import NAMES, Array, chain, frame_jacobian, placed, plain_accelerations, six_branches

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError

pinocchio = pytest.importorskip("pinocchio")


def states(name: str, count: int, seed: int) -> list[tuple[Array, Array]]:
    """Regular q with velocities of the legs' order of size, so that nothing is fast near a singularity."""
    robot, rng = chain(name), np.random.default_rng(seed)
    found = []
    for _, q in placed(name, count, seed):
        values = robot.state(q).singular_values()
        if min(values.inverse, values.forward, values.constraint) > 3e-3:
            rates = rng.normal(size=6) * robot.machine.middle_side
            found.append((q, robot.state(q).joint_rates(rates)))
    assert len(found) >= count
    return found


@pytest.mark.parametrize("name", NAMES)
def test_forward_dynamics_is_the_plain_solution(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(200)
    for q, v in states(name, 5, seed=201):
        weight = 9.81 * sum(body.mass for body in robot.model.inertias)
        f, wrench = weight * rng.normal(size=6), weight * rng.normal(size=6) * robot.machine.middle_side
        force = frame_jacobian(robot, q, "terminal_platform").T @ wrench
        force[robot.leg_indices] += f
        expected = plain_accelerations(robot.model, robot.closures, q, v, force)
        error = np.abs(robot.state(q, v).forward_dynamics(f, wrench) - expected).max()
        assert error <= 1e-10 * np.abs(expected).max() / robot.state(q).singular_values().constraint


@pytest.mark.parametrize("engine", [Mujoco, Drake])
def test_two_other_engines_accelerate_alike(engine: Any, tmp_path: Path) -> None:
    pytest.importorskip("mujoco" if engine is Mujoco else "pydrake")
    robot, rng = chain("as built"), np.random.default_rng(204)
    file = tmp_path / "machine.urdf"
    file.write_text(urdf_text(robot.machine), encoding="utf-8")
    other = engine(file)
    for q, v in states("as built", 5, seed=205):
        f = 500.0 * rng.normal(size=6)
        ours, theirs = robot.state(q, v).forward_dynamics(f), accelerations(other, robot.leg_indices, q, v, f)
        assert np.abs(ours - theirs).max() <= 1e-10 * np.abs(theirs).max() / robot.state(q).singular_values().constraint


@pytest.mark.parametrize("name", NAMES)
def test_forward_after_inverse_returns_the_motion(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(206)
    for q, v in states(name, 5, seed=207):
        d = robot.machine.middle_side
        a = robot.state(q, v).joint_accelerations(rng.normal(size=6) * [d, d, d, 1, 1, 1])
        wrench = rng.normal(size=6)
        f = robot.state(q, v).inverse_dynamics(a, wrench)
        back = robot.state(q, v).forward_dynamics(f, wrench)
        values = robot.state(q).singular_values()
        assert np.abs(back - a).max() <= 1e-11 * np.abs(a).max() / (values.inverse * values.forward)
        again = robot.state(q, v).inverse_dynamics(back, wrench)
        assert np.abs(again - f).max() <= 1e-10 * np.abs(f).max() / (values.inverse * values.forward)


@pytest.mark.parametrize("name", NAMES)
def test_the_platform_s_equations(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(208)
    d = robot.machine.middle_side
    for q, v in states(name, 4, seed=209):
        change, wrench = rng.normal(size=6) * [d, d, d, 1, 1, 1], rng.normal(size=6)
        a = robot.state(q, v).joint_accelerations(change)
        f = robot.state(q, v).inverse_dynamics(a, wrench)
        at = robot.state(q, v).platform_dynamics()
        terms = [at.mass @ change, at.bias, at.gravity, -robot.state(q).inverse_jacobian().T @ f, -wrench]
        size = sum(np.abs(term).max() for term in terms)
        assert np.abs(sum(terms)).max() <= 1e-9 * size / robot.state(q).singular_values().forward
        twist = frame_jacobian(robot, q, "terminal_platform") @ v
        assert twist @ at.mass @ twist / 2 == pytest.approx(robot.state(q, v).energy().kinetic, rel=1e-9)
        assert np.array_equal(at.mass, at.mass.T)
        assert np.linalg.eigvalsh(at.mass).min() > 0.0
        assert np.abs(at.coriolis @ twist - at.bias).max() <= 1e-9 * np.abs(at.bias).max()


def test_finite_differences_of_the_platform_s_equations() -> None:
    """Λ̇ = C + Cᵀ, so that Λ̇ - 2 C is skew; and gravity is the slope of the potential energy."""
    robot, rng = chain(), np.random.default_rng(210)
    d, h, rest = robot.machine.middle_side, 1e-2, np.zeros(18)
    for q, _ in states("paper", 4, seed=211)[:6]:
        twist = 0.1 * rng.normal(size=6) * [d, d, d, 1, 1, 1] * robot.state(q).singular_values().inverse
        at, ends = robot.state(q, robot.state(q).joint_velocities(twist)).platform_dynamics(), []
        for t in (h, -h):  # to second order and better
            half = robot.project(q + t / 2 * robot.state(q).joint_velocities(twist))
            ends.append(robot.project(q + t * robot.state(half).joint_velocities(twist)))
        ahead, behind = (robot.state(end, rest).platform_dynamics().mass for end in ends)
        slope = (ahead - behind) / (2 * h)
        assert np.abs(slope).max() > 0.0
        assert np.abs(slope - at.coriolis - at.coriolis.T).max() <= 1e-3 * np.abs(slope).max()
        above, below = (robot.state(end, rest).energy().potential for end in ends)
        allowed = 1e-4 * np.abs(at.gravity * twist).max()
        assert (above - below) / (2 * h) == pytest.approx(at.gravity @ twist, rel=1e-4, abs=allowed)


def test_singularities() -> None:
    robot, home = chain(), np.zeros(18)
    rest, forces = np.zeros(18), np.zeros(6)
    # At home the twist says nothing of the legs, but forces still accelerate and hold.
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")):
        robot.state(home, rest).platform_dynamics()
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")):
        robot.state(home, rest).joint_accelerations(np.zeros(6))
    held = robot.state(home, rest).inverse_dynamics(rest)
    assert np.abs(robot.state(home, rest).forward_dynamics(held)).max() <= 1e-9
    assert np.abs(robot.state(home, rest).forward_dynamics(forces)).max() > 1.0
    forward = problems.singular_state(0, *problems.PAPER_TILTS[0])
    q = robot.joint_values(forward)
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="forward")) as caught:
        robot.state(q, rest).inverse_dynamics(rest)
    assert caught.value.sigma_min < 1e-12
    assert np.isfinite(robot.state(q, rest).forward_dynamics(forces)).all()


def test_bad_arguments() -> None:
    robot, rest = chain(), np.zeros(18)
    q = robot.joint_values(six_branches()[0])
    v = robot.state(q).joint_velocities([0.1, 0, 0, 0, 0, 0.1])
    with pytest.raises(ClosureError) as caught:
        robot.state(q + 1e-4, rest).inverse_dynamics(rest)
    assert caught.value.residual == pytest.approx(np.linalg.norm(robot.state(q + 1e-4).closure_gap(), axis=-1).max())
    with pytest.raises(ArgumentError, check=with_fields(argument="v")):
        robot.state(q, v + 1e-4).forward_dynamics(np.zeros(6))
    with pytest.raises(ArgumentError, check=with_fields(argument="a")):
        robot.state(q, v).inverse_dynamics(rest)


LENGTHS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
LEGS = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e9


def test_frequencies_are_the_spectrum_of_the_linearised_motion() -> None:
    """Accelerations of the legs when each is stretched in turn, its spring pulling back, less those without springs."""
    state = spm.forward_physical(chain().machine, LENGTHS)
    q = chain().joint_values(state)
    stiff = spm.stiffness(state, LEGS)
    step = 1e-6
    columns = []
    for leg in np.eye(6):
        ends = []
        for sign in (1.0, -1.0):
            moved = chain().forward_kinematics(LENGTHS + sign * step * leg, near=q)
            pull = -LEGS * sign * step * leg
            rest = np.zeros(18)
            with_springs = chain().state(moved, rest).forward_dynamics(pull)
            without = chain().state(moved, rest).forward_dynamics(np.zeros(6))
            ends.append((with_springs - without)[chain().leg_indices])
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    squares = np.sort(-np.linalg.eigvals(np.array(columns).T).real)
    found = chain().state(q).natural_frequencies(stiff)
    np.testing.assert_allclose(found.frequencies, np.sqrt(squares) / (2.0 * np.pi), rtol=1e-6)
    for wrong in (np.arange(36.0).reshape(6, 6), -np.eye(6)):
        with pytest.raises(ArgumentError, check=with_fields(argument="stiffness")):
            chain().state(q).natural_frequencies(wrong)
    with pytest.raises(ClosureError):
        chain().state(q + 0.01).natural_frequencies(np.eye(6))


def test_modes_are_orthogonal_with_respect_to_mass_and_stiffness() -> None:
    states = spm.forward_physical(chain().machine, np.random.default_rng(1).uniform(1.15, 1.45, (4, 6)))
    q, stiff = chain().joint_values(states), spm.stiffness(states, LEGS)
    found = chain().state(q).natural_frequencies(stiff)
    assert found.frequencies.shape == (4, 6)
    assert (np.diff(found.frequencies, axis=-1) >= 0.0).all()
    mass, turned = chain().state(q).platform_dynamics().mass, found.modes.swapaxes(-1, -2)
    np.testing.assert_allclose(found.modes @ mass @ turned, np.tile(np.eye(6), (4, 1, 1)), atol=1e-9)
    squares = np.diagonal(found.modes @ stiff @ turned, axis1=-2, axis2=-1)
    np.testing.assert_allclose(squares, (2.0 * np.pi * found.frequencies) ** 2, rtol=1e-9)
