"""Machines of RPS, PRS and RRS legs in either stage, drawn and as built."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
from error_fields import with_fields
from kinds_of_legs import KINDS_OF_STAGES, PAIRS, machine_of_kinds, states
from problems import Array
from scipy.optimize import fsolve

import spm_pin as spm
from spm_pin.formulas import planar_legs
from spm_pin.formulas.operations import ARRAYS, bind
from spm_pin.formulas.planar_legs import LegPlane, place_in_plane
from spm_pin.kinematics import compliance, determinant_gradients, platform_jacobian
from spm_pin.machine import PRS, RPS, RRS, Legs, Stage

SIGNS = [PRS(rod=1.6, direction=1.3, sign=1), RRS(crank=1.1, rod=0.9, sign=1), *KINDS_OF_STAGES.values()]
BALL = 0.3, 1.2
WRENCH = np.array([30.0, -20.0, -500.0, 4.0, -6.0, 8.0])


def test_readings_of_right_triangles() -> None:
    rrs, prs = RRS(crank=3.0, rod=4.0), PRS(rod=5.0)
    place = np.array([[[3.0, 4.0]] * 3]) + 0.0
    right_angle = np.arctan2(4.0, 3.0) - np.arccos(3.0 / 5.0)
    np.testing.assert_allclose(rrs.readings(place, np.zeros(3)), right_angle, atol=1e-15)
    np.testing.assert_allclose(prs.readings(place, np.zeros(3)), 0.0, atol=1e-15)
    np.testing.assert_allclose(RPS().readings(place, np.zeros(3)), 5.0)
    # The knee is at the end of the crank, the carriage on its vertical slide.
    np.testing.assert_allclose(rrs.circles(rrs.readings(place, np.zeros(3)))[0][0, 0], [3.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(prs.circles(prs.readings(place, np.zeros(3)))[0][0, 0], [0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("kind", SIGNS, ids=repr)
def test_a_reading_is_where_another_method_finds_the_joint_between_the_links(kind: Any) -> None:
    numbers, (x, z) = kind.numbers[0], BALL
    (reading,) = kind.readings(np.array([[BALL] * 3]), np.full(3, 0.5 * np.pi))[:, 0]

    def gaps(q: Array) -> list[float]:
        if isinstance(kind, RPS):
            return [float(np.hypot(x, z) - q[0])]
        if isinstance(kind, PRS):
            along = q[0] * np.array([np.cos(numbers[1]), np.sin(numbers[1])])
            return [float(np.hypot(*(BALL - along)) - numbers[0])]
        return [float(np.hypot(*(BALL - numbers[0] * np.array([np.cos(q[0]), np.sin(q[0])]))) - numbers[1])]

    (found,) = fsolve(gaps, [reading + 0.05], xtol=1e-13)
    assert found == pytest.approx(reading, abs=1e-11)


@pytest.mark.parametrize("kind", SIGNS, ids=repr)
def test_rates_of_a_leg_are_differences_of_its_state(kind: Any) -> None:
    numbers, (x, z), (vx, vz) = tuple(kind.numbers[0].tolist()), BALL, (0.6, -0.8)

    def state_at(t: float) -> planar_legs.LegState:
        state = {RPS: planar_legs.rps_state, PRS: planar_legs.prs_state}.get(type(kind))
        place = x + t * vx, z + t * vz
        return state(*place, numbers) if state else planar_legs.rrs_state(*place, 1.6, numbers)

    def values(state: planar_legs.LegState) -> Array:
        return np.array([state.reading, np.arctan2(*state.direction), state.room.distance])

    state = state_at(0.0)
    assert np.hypot(*state.direction) == pytest.approx(1.0, abs=1e-15)
    found = planar_legs.leg_rates(state, vx, vz)
    np.testing.assert_allclose(found, (values(state_at(1e-6)) - values(state_at(-1e-6))) / 2e-6, atol=1e-9)


@pytest.mark.parametrize("kind", SIGNS, ids=repr)
def test_formulas_of_legs_on_every_kind_of_number(kind: Any) -> None:
    def values(run: Callable[..., Any], number: Callable[[float], Any]) -> list[Any]:
        x, z, numbers = number(BALL[0]), number(BALL[1]), tuple(map(number, kind.numbers[0].tolist()))
        reading = run(kind.formulas.reading)(x, z, number(-2.5), numbers)
        circle = run(kind.formulas.circle)(reading, numbers)
        return [reading, *circle, run(kind.formulas.slope)(x, z, reading, numbers)]

    expected = values(lambda formula: formula, float)
    mp = {"sqrt": mpmath.sqrt, "cos": mpmath.cos, "sin": mpmath.sin, "arctan2": mpmath.atan2}
    with mpmath.workdps(40):
        exact = values(lambda formula: bind(formula, **mp, RIGHT_ANGLE=mpmath.pi / 2), mpmath.mpf)
        np.testing.assert_allclose(expected, [float(x) for x in exact], atol=1e-15)
    own = {"sqrt": ca.sqrt, "cos": ca.cos, "sin": ca.sin, "arctan2": ca.atan2}
    symbolic = values(lambda formula: bind(formula, **own), ca.DM)
    np.testing.assert_allclose(expected, [float(x) for x in symbolic], atol=1e-15)
    arrays = values(lambda formula: bind(formula, **ARRAYS), lambda x: np.full(2, x))
    np.testing.assert_allclose(expected, [np.broadcast_to(x, 2)[1] for x in arrays], atol=1e-15)


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), PAIRS)
def test_readings_lead_to_the_pose_and_the_pose_to_the_readings(lower: str, upper: str, built: bool) -> None:
    machine = machine_of_kinds(lower, upper, built=built)
    found = states(machine)
    assert len(found) > 20
    assert found.closure_residual.max() < 1e-14
    branches = spm.inverse_displacement(machine, found.pose)
    error = np.abs(branches.readings - found.readings[:, None]).max(axis=-1)
    np.testing.assert_allclose(np.nanmin(error, axis=-1), 0.0, atol=1e-11)
    physical = spm.inverse_physical(machine, found.pose, near=found)
    np.testing.assert_allclose(physical.readings, found.readings, atol=1e-11)
    # The balls are on the circles that the readings leave, seen from outside.
    centres, radii = machine.legs.circles(found.readings)
    np.testing.assert_allclose(found.own_circle_centres, centres)
    np.testing.assert_allclose(np.linalg.norm(found.leg_vectors, axis=-1), radii, atol=1e-13)
    outward, forward = machine.legs.planes
    plane = LegPlane(*map(tuple, (machine.legs.pivots[0], outward[0], forward[0])))
    x, z = place_in_plane(tuple(found.balls[:, 0].T), plane)
    np.testing.assert_allclose(np.stack([x, z], axis=-1), found.places[:, 0], atol=1e-15)
    moved = spm.forward_physical(machine, found.readings[1:], near=found[:-1])
    assert moved.exists.mean() > 0.9
    np.testing.assert_allclose(
        moved.translation[moved.exists], found.translation[1:][moved.exists], atol=1e-11, err_msg="followed elsewhere"
    )
    modes = spm.forward_displacement(machine, found.readings[:3])
    assert (np.asarray(modes.status) == spm.Status.OK).all()
    assert np.nanmax(modes.residual) < 1e-13
    assert np.nanmax(np.abs(modes.readings - found.readings[:3, None])) < 1e-10
    np.testing.assert_allclose(modes.physical(found[:3]).translation, found.translation[:3], atol=1e-11)


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), [("RPS", "RPS"), ("RRS", "PRS"), ("PRS", "RRS")])
def test_rates_forces_and_gradients_are_those_of_the_readings(lower: str, upper: str, built: bool) -> None:
    machine = machine_of_kinds(lower, upper, built=built)
    found = states(machine)[:12]
    jacobian, inverse, h = platform_jacobian(found), spm.inverse_jacobian(found), 1e-6
    gradients = determinant_gradients(found)
    for leg in range(6):
        ends = [spm.forward_physical(machine, found.readings + sign * h * np.eye(6)[leg], found) for sign in (1, -1)]
        linear = (ends[0].translation - ends[1].translation) / (2.0 * h)
        angular = (ends[0].pose.rotation * ends[1].pose.rotation.inv()).as_rotvec() / (2.0 * h)
        expected = np.concatenate([linear, angular], axis=-1)
        scale = 1.0 + np.abs(expected).max()
        np.testing.assert_allclose(jacobian[..., leg], expected, rtol=0, atol=1e-7 * scale**2)
        slopes = (spm.determinants(ends[0]) - spm.determinants(ends[1])) / (2.0 * h)
        np.testing.assert_allclose(gradients[..., leg], slopes, rtol=0, atol=1e-7 * scale**2)
    np.testing.assert_allclose(inverse @ jacobian, np.broadcast_to(np.eye(6), inverse.shape), atol=1e-10)
    # Power balance: what the actuators exert at the rates of a twist is minus the work of the wrench.
    forces = spm.leg_forces(found, WRENCH)
    np.testing.assert_allclose(np.einsum("nl,nlk->nk", forces, inverse), np.tile(-WRENCH, (len(found), 1)), atol=1e-8)
    product = spm.stiffness(found, 1e4) @ compliance(found, 1e4)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(6), product.shape), atol=1e-6)


def test_a_ball_out_of_a_legs_reach_is_data() -> None:
    machine = spm.Manipulator.of_stages(Stage(0.7, 0.45, RRS(crank=0.6, rod=0.8)), Stage(0.4, 0.45))
    branches = spm.inverse_displacement(machine, spm.pose([0.0, 0.0, 9.0], rpy=[0.1, 0.1, 0.0]))
    assert branches.status == spm.Status.UNREACHABLE
    assert "r_b1" in branches.physical().missing_reason


def test_a_leg_is_singular_where_rod_and_crank_are_in_line() -> None:
    machine = machine_of_kinds("RRS", "RPS")
    state = states(machine)[0]
    # The same state of a machine whose first leg just reaches its ball.
    reach = float(np.hypot(*state.places[0]))
    kind = RRS(crank=(reach - 0.9, 1.1, 1.1), rod=0.9)
    legs = Legs(*machine.legs.arrays, (kind, RPS()))
    built = spm.Manipulator(*machine.dimensions, legs=legs)
    stretched = spm.machine.Configuration(built, state.pose, state.middle_joints)
    kind_of = spm.kinematics.SingularityKind
    assert kind_of(int(spm.singularities(stretched, tolerance=1e-6).kind)) & kind_of.LEG
    assert not kind_of(int(spm.singularities(state, tolerance=1e-6).kind)) & kind_of.LEG


@pytest.mark.parametrize("built", [False, True])
def test_files_copies_and_parameters_keep_the_legs(built: bool, tmp_path: Path) -> None:
    machine = machine_of_kinds("RRS", "PRS", built=built)
    machine.to_yaml(tmp_path / "machine.yaml")
    for copy in (spm.Manipulator.from_yaml(tmp_path / "machine.yaml"), pickle.loads(pickle.dumps(machine))):
        assert copy == machine
        assert copy.is_nominal == machine.is_nominal != built
    again = machine.from_parameters(machine.parameters)
    np.testing.assert_allclose(again.parameters, machine.parameters, atol=1e-15)
    assert len(machine.parameter_names) == len(machine.parameter_units) == len(machine.parameters) == 66
    assert machine.parameter_units[-1] == "rad", "the direction of a slide"


def limited(lower: tuple[float, float], upper: tuple[float, float]) -> spm.Manipulator:
    return dataclasses.replace(machine_of_kinds("RRS", "RPS"), limits=spm.LegLimits.stages(lower, upper))


WRONG: list[tuple[Callable[[], Any], str]] = [
    (lambda: RRS(crank=0.5, rod=0.9, sign=0), "sign"),
    (lambda: PRS(rod=0.0), "rod"),
    (lambda: PRS(rod=1.0, direction=90.0), "direction"),
    (lambda: RRS(crank=[1.0] * 4, rod=1.0), "crank"),
    (lambda: limited((-7.0, 7.0), (1.0, 1.5)), "limits"),
    (lambda: spm.Manipulator.of_stages(Stage(0.7, 0.45, RPS(), (-0.3, 0.9)), Stage(0.4, 0.45)), "limits"),
    (lambda: spm.Manipulator.of_stages(Stage(0.7, 0.45), Stage(0.4, 0.46)), "upper"),
    (lambda: spm.forward_physical(machine_of_kinds("RRS", "RPS"), [7.0, 6.0, 6.0, 1.3, 1.3, 1.3]), "readings"),
]


def test_wrong_legs_are_refused() -> None:
    for call, argument in WRONG:
        with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
            call()


@pytest.mark.parametrize("limits", [(-2.0, 4.3), ([-1.0, -1.58, -1.0], np.inf), (-np.inf, 4.8)])
def test_limits_beyond_the_turn_of_a_cranks_readings_are_refused(limits: tuple[Any, Any]) -> None:
    with pytest.raises(spm.GeometryError, check=with_fields(argument="limits")):
        Stage(0.05, 0.10, RRS(crank=0.04, rod=0.12), limits)


def test_other_limits_than_the_machines_are_within_the_turn_of_its_readings() -> None:
    """Readings are nearest to the middle of the machine's own limits: a state within others of another turn is not."""
    servos, other = Stage(0.05, 0.10, RRS(crank=0.04, rod=0.12)), spm.LegLimits(-2.0, 0.5)
    for refuse in (servos.check_limits, spm.inverse_displacement(servos, 0.07).within):
        with pytest.raises(spm.GeometryError, check=with_fields(argument="limits")):
            refuse(other)
    swinging = dataclasses.replace(servos, limits=spm.LegLimits(-2.2, 0.4))
    assert spm.inverse_displacement(swinging, 0.07).within(other).physical().exists


def test_limits_at_the_ends_of_the_turn_of_a_cranks_readings_are_accepted() -> None:
    servos, ends = Stage(0.05, 0.10, RRS(crank=0.04, rod=0.12)), (-np.pi / 2.0, 1.5 * np.pi)
    limited = dataclasses.replace(servos, limits=spm.LegLimits(*ends))
    readings = np.full(3, ends[0] + 1e-9)
    state = spm.forward_physical(limited, readings)
    np.testing.assert_allclose(spm.inverse_physical(limited, state.height).readings, readings, atol=1e-12)
    assert limited.perturbed(1).limits == limited.limits
    # An offset moves the turn.
    legs = Legs(*servos.legs.arrays[:3], np.full(3, -1.0), (servos.kind,))
    assert dataclasses.replace(servos, legs=legs, limits=spm.LegLimits(-2.5, 0.5)).limits is not None


REFUSED: dict[str, Callable[[spm.Manipulator], Any]] = {
    "certify_inverse": lambda g: spm.proofs.certify_inverse(g, spm.LegLimits(1.2, 1.3)),
    "weights in CasADi": lambda g: spm.casadi.gravity(g),
    "the paper's method": lambda g: spm.crosscheck.compare_methods(g, poses=2, methods=["paper"]),
    "the paper's Jacobian": lambda g: spm.crosscheck.paper.jacobian.J_f(states(g)[0]),
    "weights in C": lambda g: spm.casadi.bodies(g),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_known_for_rps_legs_alone_refuses_others_by_name(name: str) -> None:
    with pytest.raises(spm.GeometryError, match="RRS below and RPS above"):
        REFUSED[name](machine_of_kinds("RRS", "RPS"))


def test_where_slides_are_measured_from_does_not_matter() -> None:
    """Rails measured from their upper end: balls below the pivots, and the robot as far down as the zero is up."""
    machine = spm.Manipulator.of_stages(Stage(0.35, 0.25, PRS(rod=0.42)), Stage(0.30, 0.25, PRS(rod=0.40)))
    readings = np.random.default_rng(0).uniform(0.05, 0.2, (50, 6))
    down = np.concatenate([readings[:, :3] - 0.9, readings[:, 3:] - 0.7], axis=1)
    above, below = spm.forward_physical(machine, readings), spm.forward_physical(machine, down)
    assert above.exists.all()
    shift = 0.9 * np.array([0.0, 0.0, 1.0]) + 0.7 * above.rotation[..., 2]
    np.testing.assert_allclose(below.translation, above.translation - shift, atol=1e-12)
    assert (below.middle_joints[..., 2] < 0.0).all()
    np.testing.assert_allclose(spm.inverse_physical(machine, below.pose, near=below).readings, down, atol=1e-9)
    assert spm.inverse_displacement(machine, below.pose).is_physical.any(axis=-1).all()
