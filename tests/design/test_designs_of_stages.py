"""Designs and tasks of stages: numbers against integrals and differences, a search, and what is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from balancers import stage_and_height

import spm_pin as spm
from spm_pin.design import DesignProblem, Task, evaluate_designs, pareto_front

BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.3, 0.6))
KINDS = ["RPS", "PRS as built", "RRS"]


def limited(machine: str, share: float = 0.06) -> spm.Stage:
    stage, height = stage_and_height(machine)
    level = spm.inverse_physical(stage, height).readings
    room = 5.0 * share if stage.unit == "rad" else share * stage.size
    return dataclasses.replace(stage, limits=spm.LegLimits(level - room, level + room))


@pytest.mark.parametrize("machine", KINDS)
def test_the_volume_is_that_of_the_heights_and_normals_reached(machine: str) -> None:
    stage = limited(machine)
    found = evaluate_designs([stage], "payload_down", states=8192)
    assert found.columns["assembled"][0] == 1.0
    # The share of a box of heights and normals that the inverse displacement reaches within the limits.
    corners = np.stack(np.meshgrid(*stage.reading_limits.T), axis=-1).reshape(-1, 3)
    states = spm.forward_physical(stage, corners)
    low, high = 0.9 * states.height.min(), 1.1 * states.height.max()
    tilt = 1.3 * states.tilt.max()
    rng, count = np.random.default_rng(0), 200_000
    heights, cosines = rng.uniform(low, high, count), rng.uniform(np.cos(tilt), 1.0, count)
    azimuths = rng.uniform(-np.pi, np.pi, count)
    reached = spm.inverse_physical(stage, heights, tilt=np.arccos(cosines), azimuth=azimuths)
    share = np.mean(reached.exists & (reached.limit_excess == 0.0).all(axis=-1))
    expected = share * (high - low) * 2.0 * np.pi * (1.0 - np.cos(tilt))
    error = expected * np.sqrt((1.0 - share) / share / count)
    np.testing.assert_allclose(found.columns["volume"][0], expected, rtol=2e-3, atol=4.0 * error)


def test_rows_of_designs_are_those_of_each_alone_and_of_metrics() -> None:
    machines = [BALANCER, limited("RRS as built"), dataclasses.replace(BALANCER, limits=(-1.5, -1.4))]
    together = evaluate_designs(machines, ("conditioning", "payload"), states=64)
    alone = evaluate_designs(machines[1:2], ("conditioning", "payload"), states=64)
    for name, column in alone.columns.items():
        assert together.columns[name][1] == column[0]
    points = spm.sweeps.Points(BALANCER, "legs", np.array(spm.sweeps.leg_sample(64, (-0.3, 0.6)).points((0,), (64,))))
    expected = spm.sweeps.METRICS["conditioning"].evaluate(points).mean()
    np.testing.assert_allclose(together.columns["conditioning_mean"][0], expected, rtol=1e-12)
    quiet = [dataclasses.replace(BALANCER, limits=(0.2, 0.5)), limited("RPS", 0.01)]
    certified = evaluate_designs(quiet, states=16, boxes=30_000).columns["certified"]
    np.testing.assert_array_equal(certified, [spm.certify(spm.Manipulator.of_stages(x, x)).holds for x in quiet])
    assert certified.all()
    np.testing.assert_allclose(together.columns["footprint"][0], np.pi * 0.08**2)


def test_a_task_of_tilts_is_that_of_the_states_there() -> None:
    tilts = {"tilt": [0.1, 0.2, 0.15], "azimuth": [0.0, 2.0, -1.0]}
    task = Task.of_tilts(0.12, **tilts, wrench=[0, 0, -2.0, 0, 0, 0])
    stage = dataclasses.replace(BALANCER, limits=(-0.6, 1.2))
    states = spm.inverse_physical(stage, 0.12, **tilts)
    room = np.minimum(states.readings + 0.6, 1.2 - states.readings).min()
    assert task.margin(stage) == pytest.approx(0.05 * room)
    # By virtual work a torque is the weight times the change of height with the reading, by differences.
    efforts = []
    for leg in range(3):
        step = 1e-6 * np.eye(3)[leg]
        ends = [spm.forward_physical(stage, states.readings + x, near=states).height for x in (step, -step)]
        efforts.append(2.0 * (ends[0] - ends[1]) / 2e-6)
    assert task.effort(stage) == pytest.approx(np.abs(efforts).max(), rel=1e-6)
    assert np.isnan(Task.of_tilts(0.3).margin(stage))
    assert task.identity != Task.of_tilts(0.12, **tilts).identity
    with pytest.raises(spm.ArgumentError) as caught:
        task.margin(spm.Manipulator.paper())
    assert caught.value.argument == "machine"
    with pytest.raises(spm.ArgumentError) as caught:
        Task.of_tilts(0.12, wrench=[1.0])
    assert caught.value.argument == "wrench"


def test_a_search_for_a_stage_passes_by_impossible_ones_and_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("pymoo")
    problem = DesignProblem(
        BALANCER,
        # Cranks and rods of 2 cm each reach no ball of platforms that are wider than the base by more than 4 cm.
        free={"crank": (0.02, 0.06), "rod": (0.02, 0.12), "platform_radius": (0.06, 0.17)},
        aims={"payload_down_low": "max", "volume": "max"},
        at_least={"assembled": 1.0},
    )
    values = np.array([0.02, 0.02, 0.17])
    with pytest.raises(spm.GeometryError):
        problem.machine_of(values)
    machine = problem.machine_of(np.array([0.04, 0.12, 0.07]))
    assert isinstance(machine, spm.Stage)
    np.testing.assert_array_equal(problem.values(machine), [0.04, 0.12, 0.07])
    options = {"population": 12, "generations": 5, "states": 64, "seed": 1}
    front = pareto_front(problem, tmp_path / "front.json", **options)
    assert len(front.designs) > 0
    assert len(front.evaluated) < 60  # some cannot be built
    assert all(isinstance(each, spm.Stage) for each in front.designs.machines)
    every, best = (np.stack([x.columns[name] for name in problem.aims]) for x in (front.evaluated, front.designs))
    kept = every[:, front.evaluated.columns["assembled"] == 1.0]
    for column in best.T:
        assert not (kept > column[:, None]).all(axis=0).any()
    again = pareto_front(problem, tmp_path / "front.json", **options)
    assert again.designs.machines == front.designs.machines


def test_what_a_stage_has_not_is_refused() -> None:
    for free in ("middle_side", "lower_crank", "upper_stroke"):
        with pytest.raises(spm.ArgumentError) as caught:
            DesignProblem(BALANCER, {free: (0.05, 0.1)}, {"volume": "max"})
        assert caught.value.argument == "free"
    for machines in ([BALANCER, spm.Manipulator.paper()], [spm.Stage(0.08, 0.09)]):
        with pytest.raises(spm.ArgumentError) as caught:
            evaluate_designs(machines)
        assert caught.value.argument == "machines"
