"""Real machines: what is known of them, rigid plates over their whole reach, and the formulas of their programs."""

from __future__ import annotations

import gallery as page
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.machine import Configuration

pytestmark = pytest.mark.documents

MACHINES = spm.machine.gallery()
STAGES = {f"{name} {k}": (stage, m.height) for name, m in MACHINES.items() for k, stage in enumerate(m.stages)}
INCH = 0.0254


def over_the_reach(stage: spm.Stage) -> Configuration:
    """Return states of a stage at all heights, in all directions, to the end of what it reaches."""
    reach = spm.workspace.reach(stage, directions=24)
    tilts = reach.tilts[..., None] * np.linspace(0.0, 1.0, 12)
    heights, azimuths = reach.heights[:, None, None], reach.azimuths[:, None]
    return spm.inverse_physical(stage, heights, tilt=tilts, azimuth=azimuths)


def states_of(name: str, tilt: float, count: int = 12) -> Configuration:
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


@pytest.mark.slow
def test_the_page_is_as_new_as_the_machines() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.with_tables(text) == text
    assert all(f"| {name} |" in text for name in MACHINES)
    assert len(page.picture().axes) == len(MACHINES)
