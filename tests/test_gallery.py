"""Real machines: what is known of them, rigid plates over their whole reach, and the formulas of their programs."""

from __future__ import annotations

import gallery as page
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.machine import RealMachine, StageConfiguration

pytestmark = pytest.mark.documents

MACHINES = spm.machine.gallery()
STAGES = {f"{name} {k}": (stage, m.height) for name, m in MACHINES.items() for k, stage in enumerate(m.stages)}
INCH = 0.0254


def over_the_reach(stage: spm.Stage) -> StageConfiguration:
    """Return states of a stage at all heights, in all directions, to the end of what it reaches."""
    reach = spm.workspace.reach(stage, directions=24)
    tilts = reach.tilts[..., None] * np.linspace(0.0, 1.0, 12)
    heights, azimuths = reach.heights[:, None, None], reach.azimuths[:, None]
    return spm.inverse_physical(stage, heights, tilt=tilts, azimuth=azimuths)


def states_of(name: str, tilt: float, count: int = 12) -> StageConfiguration:
    machine = MACHINES[name]
    azimuths = np.linspace(-np.pi, np.pi, count, endpoint=False)
    return spm.inverse_physical(machine.stage, machine.height, tilt=tilt, azimuth=azimuths)


def test_numbers_are_those_of_the_sources() -> None:
    """In the units of the sources, level heights by Pythagoras and the law of cosines."""
    assert [m.architecture for m in MACHINES.values()].count("3-RRS") >= 4
    first = MACHINES["Ball-Balancer-V2"].stage
    numbers = [first.base_radius, first.platform_radius, *first.kind.numbers[0, :2]]
    np.testing.assert_allclose(np.divide(numbers, INCH), [2.0, 3.125, 1.75, 3.669291339], rtol=1e-9)
    assert MACHINES["Ball-Balancer-V2"].height == pytest.approx(4.25 * INCH)
    across, up = np.array([1.125, 4.25])
    long = np.hypot(across, up)
    elbow = np.arccos((long**2 + 1.75**2 - 3.669291339**2) / (2.0 * long * 1.75))
    level = spm.inverse_physical(first, 4.25 * INCH).readings
    np.testing.assert_allclose(level, np.arctan2(up, across) - elbow, atol=1e-9)
    heliostat, robot = MACHINES["3-RPS heliostat"], MACHINES["3PRS robot"]
    # The prototype's actuators were 1.645, 1.653 and 1.650 m long there.
    level = spm.inverse_physical(heliostat.stage, 1.64).readings
    np.testing.assert_allclose(level, [1.645, 1.653, 1.650], atol=0.007)
    np.testing.assert_allclose(spm.inverse_physical(robot.stage, robot.height).readings, 0.4, atol=1e-15)
    assert spm.Manipulator.of_stages(*MACHINES["3RPS-3SPR"].stages) == spm.Manipulator.paper()


def test_a_neck_brace_has_its_legs_in_a_t() -> None:
    """Two balls stay in one plane, the third in the plane across; its inverse has slides from the centre."""
    state = states_of("3PRS neck brace", 0.05)
    np.testing.assert_allclose(state.balls[:, 0::2, 1], 0.0, atol=1e-16)
    np.testing.assert_allclose(state.balls[:, 1, 0], 0.0, atol=1e-16)
    level = spm.inverse_physical(state.stage, 0.02).readings
    # Roots b of b² - 2 b r + r² + z² = l².
    for slide, rod in zip(0.055 + level, [0.158, 0.17088, 0.158], strict=True):
        roots = np.roots([1.0, -2.0 * 0.055, 0.055**2 + 0.02**2 - rod**2])
        assert roots.max() == pytest.approx(slide, abs=1e-15)


@pytest.mark.parametrize("name", STAGES)
def test_plates_are_rigid_over_the_whole_reach_and_readings_lead_back(name: str) -> None:
    stage, height = STAGES[name]
    states = over_the_reach(stage)
    assert states.exists.all()
    assert not states.limit_excess.any()
    sides, own = (
        np.linalg.norm(balls - np.roll(balls, -1, axis=-2), axis=-1) for balls in (states.balls, stage.legs.balls)
    )
    np.testing.assert_allclose(sides, np.broadcast_to(own, sides.shape), rtol=1e-12)
    near = spm.singularities(states)
    states = states[np.minimum(near.forward, near.leg.min(axis=-1)) > 1e-3]
    again = spm.forward_physical(stage, states.readings)
    assert again.exists.all()
    np.testing.assert_allclose(again.balls, states.balls, atol=1e-12 * stage.size)
    assert spm.inverse_physical(stage, height).exists


@pytest.mark.parametrize("name", [name for name, (formula, _) in page.PROGRAMS.items() if formula])
def test_formulas_are_right_where_the_plate_is_level(name: str) -> None:
    state = states_of(name, 0.0, 1)
    formula, _ = page.PROGRAMS[name]
    assert formula is not None
    np.testing.assert_allclose(formula(state), state.readings, atol=1e-14)


def test_straight_lines_by_hand() -> None:
    """A plate that leans towards leg 1: its ball is at r (cos t, -sin t) from the centre, in the plane of the leg."""
    machine, t = MACHINES["3RRS-Balancing-Robot"], 0.2
    stage, radius = machine.stage, machine.stage.platform_radius
    state = spm.inverse_physical(stage, machine.height, tilt=t, azimuth=[np.radians(-30.0)])
    steep = np.hypot(np.cos(t), np.sin(t) / 2.0)
    x = radius * np.array([np.cos(t), np.cos(t) / steep, np.cos(t) / steep]) - stage.base_radius
    z = machine.height + radius * np.array([-np.sin(t), np.sin(t) / 2.0 / steep, np.sin(t) / 2.0 / steep])
    readings = page.straight_lines(state)[0]
    knees = np.stack([np.cos(readings), np.sin(readings)]) * 0.05
    np.testing.assert_allclose(np.hypot(*(np.stack([x, z]) - knees)), 0.075, atol=1e-15)


def test_two_balls_of_three_are_where_they_should_be() -> None:
    state = states_of("Ball-Balancer-V2", np.radians(10.0))
    error = page.third_leg_otherwise(state) - state.readings
    np.testing.assert_allclose(error[:, :2], 0.0, atol=1e-14)
    assert 1e-6 < np.abs(error[:, 2]).max() < 1e-3


def test_plates_about_a_centre_by_hand() -> None:
    """A leg at 0° in the programs' frames is leg 1, at -30° here; a pitch leans the plate towards it."""
    t = 0.15
    machine = MACHINES["3-RPS-Simulator"]
    state = spm.inverse_physical(machine.stage, machine.height, tilt=t, azimuth=[np.radians(-30.0)])
    first = np.hypot(0.115 * np.cos(t) - 0.12, 0.125 - 0.115 * np.sin(t))
    ball, pivot = (
        np.array([-np.cos(t) / 2.0, np.sqrt(0.75), np.sin(t) / 2.0]) * 0.115 + [0.0, 0.0, 0.125],
        np.array([-0.5, np.sqrt(0.75), 0.0]) * 0.12,
    )
    second = np.linalg.norm(ball - pivot)
    np.testing.assert_allclose(page.about_the_centre(state)[0], [first, second, second], atol=1e-15)
    machine = MACHINES["3RRS-ball-ballancing-platform"]
    state = spm.inverse_physical(machine.stage, machine.height, tilt=t, azimuth=[np.radians(60.0)])
    places = np.stack([np.full(3, 0.075), 0.2 + 0.15 * np.sqrt(0.75) * np.sin(t) * np.array([0.0, -1.0, 1.0])], -1)
    readings = machine.stage.kind.readings(places, machine.stage.crank_middles)
    np.testing.assert_allclose(page.about_the_centre_by_x(state)[0], readings, atol=1e-14)


def test_the_haptic_device_is_right_but_for_the_height_of_its_balls(monkeypatch: pytest.MonkeyPatch) -> None:
    state = states_of("3-SPR haptic device", 0.3)
    assert np.abs(page.balls_at_the_origin(state) - state.readings).max() > 1e-3
    monkeypatch.setattr(page, "ABOVE", 0.0)
    np.testing.assert_allclose(page.balls_at_the_origin(state), state.readings, atol=1e-15)


def test_the_heliostat_solves_the_equations_of_the_rigid_plate() -> None:
    """Five equations of its program, for columns n, o, a of the mirror's rotation, legs at 0, 120 and 240°."""
    state = states_of("3-RPS heliostat", 0.4)
    turn = Rotation.from_euler("z", np.pi / 6.0).as_matrix()
    n, o, a = np.moveaxis(turn @ state.rotation @ turn.T, -1, 0)
    x, y, _ = (turn @ state.translation[..., None])[..., 0].T
    np.testing.assert_allclose(n[:, 1], -y / 0.25, atol=1e-15)
    np.testing.assert_allclose(o[:, 0], n[:, 1], atol=1e-15)
    np.testing.assert_allclose(o[:, 1], n[:, 0] - 2.0 * x / 0.25, atol=1e-15)
    np.testing.assert_allclose([(n * a).sum(-1), (o * a).sum(-1), (n * o).sum(-1)], 0.0, atol=1e-15)


def test_an_error_is_that_of_a_plate_that_is_moved_by_hand() -> None:
    machine = MACHINES["3-RPS heliostat"]

    def higher(wanted: StageConfiguration) -> np.ndarray:
        return spm.inverse_physical(wanted.stage, wanted.height + 0.003, normal=wanted.normal).readings

    error = page.formula_error(machine, higher)
    assert error.ball == pytest.approx(0.003, rel=1e-9)
    assert error.angle < 1e-9
    assert error.tilt == pytest.approx(np.radians(20.0))


def test_the_nearest_singularity_ignores_limits() -> None:
    machine: RealMachine = MACHINES["3-SPR haptic device"]
    least, end = page.nearest_singularity(machine.stage, machine.height)
    assert end is spm.workspace.ReachEnd.FORWARD
    assert least > spm.workspace.reach(machine.stage, machine.height).all_round[0]


@pytest.mark.slow
def test_the_page_is_as_new_as_the_machines() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.with_tables(text) == text
    assert all(f"| {name} |" in text for name in MACHINES)
    assert len(page.picture().axes) == len(MACHINES)
