"""Sweeps over tilts and readings of stages of every kind: metrics against their definitions, and stores."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balancers import MACHINES, equilibrium, stage_and_height
from error_fields import with_fields

import spm_pin as spm
from spm_pin.sweeps import METRICS, Points
from spm_pin.sweeps.domains import SweepPlan

OF_MANIPULATORS = "branch", "det_upper", "det_structure"
PAPER = spm.Manipulator.paper()
ROBOTS = {"paper": PAPER, "paper as built": PAPER.perturbed(3, length=2e-3, angle=2e-3)}


def limited(machine: str) -> tuple[spm.Stage, float]:
    """Return a stage with limits that some of its tilts keep, and a height at which it stands."""
    stage, height = stage_and_height(machine)
    level = spm.inverse_physical(stage, height).readings
    room = 0.4 if stage.unit == "rad" else 0.1 * stage.size
    return dataclasses.replace(stage, limits=spm.LegLimits(level - room, level + room)), height


def points_of(machine: str, space: str, count: int = 60) -> Points:
    """Return points some of which the machine reaches within its limits, some not."""
    rng = np.random.default_rng(0)
    if machine in ROBOTS:
        robot = ROBOTS[machine]
        readings = rng.uniform(1.05, 1.55, (count, 6))
        if space == "legs":
            return Points(robot, "legs", readings)
        states = spm.forward_physical(robot, readings)
        states = states[states.exists]
        poses = np.concatenate([states.translation, states.pose.rotation.as_euler("XYX")], axis=-1)
        poses[::5, :3] += [0.9, -0.7, 0.0]
        return Points(robot, "pose", poses)
    stage, height = limited(machine)
    if space == "legs":
        low, high = stage.reading_limits
        return Points(stage, "legs", rng.uniform(low - 0.1 * (high - low), high, (count, 3)))
    low, high = [0.85 * height, 0.0, -np.pi], [1.15 * height, 0.6, np.pi]
    return Points(stage, "tilt", rng.uniform(low, high, (count, 3)))


def efforts_of(state: Any) -> np.ndarray:
    """Return the efforts (legs, 6) that hold unit wrenches: of a stage from forces at the balls in equilibrium."""
    if not state.machine.is_stage:
        return -np.linalg.inv(spm.inverse_jacobian(state).T)
    return -np.linalg.inv(equilibrium(state))[:3]


@pytest.mark.parametrize("space", ["places", "legs"])
@pytest.mark.parametrize("machine", [*MACHINES, *ROBOTS])
def test_metrics_are_those_of_their_definitions(machine: str, space: str) -> None:
    points, is_stage = points_of(machine, space), machine not in ROBOTS
    owner = points.machine
    if space == "places":
        heights, tilts, azimuths = points.coordinates.T[:3]
        both = (
            spm.inverse_displacement(owner, heights, tilt=tilts, azimuth=azimuths)
            if is_stage
            else spm.inverse_displacement(owner, spm.pose(points.coordinates[:, :3], xyx=points.coordinates[:, 3:]))
        )
        states = both.within().physical()
        np.testing.assert_array_equal(METRICS["branches"].evaluate(points), both.count)
        np.testing.assert_array_equal(METRICS["branches_within"].evaluate(points), both.within().count)
    else:
        states = spm.forward_physical(owner, points.coordinates)
        found = METRICS["assembly_modes"].evaluate(points)[points.reachable]
        modes = spm.forward_displacement(owner, points.coordinates[points.reachable])
        np.testing.assert_array_equal(found, modes.count)
    reachable = states.exists & (states.limit_excess == 0.0).all(axis=-1)
    assert 0 < np.count_nonzero(reachable) < len(points)
    np.testing.assert_array_equal(METRICS["reachable"].evaluate(points), reachable)
    names = [name for name in METRICS if not (is_stage and name in OF_MANIPULATORS)]
    for name in names:
        if METRICS[name].dtype.startswith("float") and name != "leg_margin":
            np.testing.assert_array_equal(np.isfinite(METRICS[name].evaluate(points)), reachable, err_msg=name)
    for name in set(METRICS) - set(names):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="metrics")):
            METRICS[name].evaluate(points)
    values, reached = {name: METRICS[name].evaluate(points)[reachable] for name in names}, states[reachable]
    np.testing.assert_allclose(points.reached.readings, reached.readings, atol=1e-9)
    np.testing.assert_allclose(values["platform_tilt"], np.arccos(reached.rotation[:, 2, 2]), atol=1e-7)
    np.testing.assert_allclose(np.stack([values[f"o_{x}"] for x in "xyz"], axis=-1), reached.translation, atol=1e-9)
    low, high = owner.reading_limits
    slopes = owner.legs.largest_slopes
    room = np.minimum(reached.readings - low, high - reached.readings) * slopes
    np.testing.assert_allclose(values["leg_margin"], room.min(axis=-1), atol=1e-9)
    strong = METRICS["payload_down"](push=900.0, pull=400.0).evaluate(points)[reachable]
    long = METRICS["conditioning"](length=0.5).evaluate(points)[reachable]
    stiff = METRICS["least_stiffness"](leg_stiffness=2e7).evaluate(points)[reachable]
    np.testing.assert_allclose(stiff, 2e7 * values["least_stiffness"], rtol=1e-9)
    for k, state in enumerate(reached):
        efforts = efforts_of(state)
        np.testing.assert_allclose(values["payload"][k], 1.0 / np.linalg.norm(efforts[:, :3], axis=-1).max(), rtol=1e-6)
        np.testing.assert_allclose(values["payload_down"][k], 1.0 / np.abs(efforts[:, 2]).max(), rtol=1e-6)
        shares = np.maximum(-efforts[:, 2] / 900.0, efforts[:, 2] / 400.0)
        np.testing.assert_allclose(strong[k], 1.0 / shares.max(), rtol=1e-6)
        for name, rows in (("least_stiffness", slice(3)), ("least_rotational_stiffness", slice(3, 6))):
            compliance = efforts[:, rows].T @ efforts[:, rows]
            np.testing.assert_allclose(values[name][k], 1.0 / np.linalg.eigvalsh(compliance)[-1], rtol=1e-6)
        # By virtual work G is minus the transposed efforts; of the motion in rates of knees and carriages.
        for length, found in ((owner.platform_radius, values["conditioning"][k]), (0.5, long[k])):
            g = (efforts.T * np.repeat([1.0, length], 3)[:, None] / slopes)[slice(2, 5) if is_stage else slice(6)]
            sizes = np.linalg.svd(g, compute_uv=False)
            np.testing.assert_allclose(found, sizes[-1] / sizes[0], rtol=1e-6)
            if length == owner.platform_radius:
                isotropy = np.exp(2.0 * np.log(sizes).mean()) / np.mean(sizes**2)
                np.testing.assert_allclose(values["isotropy"][k], isotropy, rtol=1e-6)


@pytest.mark.parametrize("machine", ["RPS", "PRS as built", "RRS as built"])
def test_the_determinant_of_a_stage_is_that_of_the_lower_one_of_a_robot(machine: str) -> None:
    points = points_of(machine, "legs")
    robot = spm.Manipulator.of_stages(points.machine, points.machine)
    six = np.concatenate([points.coordinates, points.coordinates], axis=-1)
    found, expected = (METRICS["det_lower"].evaluate(each) for each in (points, Points(robot, "legs", six)))
    both = np.isfinite(found) & np.isfinite(expected)
    assert both.any()
    np.testing.assert_allclose(found[both], expected[both], rtol=1e-9)


def test_a_store_of_a_stage_is_written_read_and_continued(tmp_path: Path) -> None:
    stage, height = limited("RRS as built")
    grid = spm.sweeps.tilt_grid((0.9 * height, 1.1 * height, 4), (0.0, 0.5, 3), (-np.pi, np.pi, 5))
    metrics = ["reachable", "conditioning", "platform_tilt"]
    results = spm.sweeps.run_sweep(stage, grid, metrics, tmp_path / "tilts.zarr", workers=1, chunk=20)
    assert dict(results.sizes) == {"height": 4, "tilt": 3, "azimuth": 5}
    assert results.azimuth.attrs["units"] == "rad"
    states = spm.inverse_physical(
        stage,
        results.height.values[:, None, None],
        tilt=results.tilt.values[:, None],
        azimuth=results.azimuth.values,
    )
    reachable = states.exists & (states.limit_excess == 0.0).all(axis=-1)
    np.testing.assert_array_equal(results.reachable.values, reachable)
    again = spm.sweeps.resume_sweep(tmp_path / "tilts.zarr", workers=1)
    np.testing.assert_array_equal(again.conditioning.values, results.conditioning.values)
    low, high = stage.reading_limits
    sample = spm.sweeps.leg_sample(50, [*zip(low, high, strict=True)], seed=3)
    drawn = spm.sweeps.run_sweep(stage, sample, metrics, tmp_path / "legs.zarr", workers=1)
    readings = np.stack([drawn[leg].values for leg in ("r_1", "r_2", "r_3")], axis=-1)
    tilts = spm.forward_physical(stage, readings).tilt
    np.testing.assert_allclose(drawn.platform_tilt.values, tilts)
    assert drawn.r_1.attrs["units"] == stage.unit


def test_a_condition_on_states_of_a_stage_is_its_metric() -> None:
    stage, height = limited("RRS as built")
    states = spm.inverse_physical(stage, np.linspace(0.5, 1.3, 9) * height, tilt=0.2, azimuth=0.1)
    values = METRICS["payload_down"].evaluate(
        Points(dataclasses.replace(stage, limits=None), "legs", states.readings[states.exists])
    )
    middle = float(np.median(values))
    kept = spm.sweeps.condition("payload_down", least=middle)(states[states.exists])
    np.testing.assert_array_equal(kept, values >= middle)


def test_a_condition_on_a_state_is_not_that_of_another_with_its_readings() -> None:
    modes = spm.forward_displacement(spm.Stage(0.7, 0.46), [1.2, 1.25, 1.4]).configurations
    tilts = np.arccos(modes.normal[:, 2])
    kept = spm.sweeps.condition("platform_tilt", least=0.5 * np.nanmax(tilts))(modes)
    np.testing.assert_array_equal(kept, tilts >= 0.5 * np.nanmax(tilts))
    assert 1 < np.count_nonzero(kept) < np.count_nonzero(modes.exists)


def test_a_condition_on_the_margin_of_legs_is_that_of_the_machine_s_own_limits() -> None:
    stage, height = limited("RPS")
    states = spm.inverse_physical(stage, height, tilt=np.linspace(0.0, 0.5, 30), azimuth=0.3)
    assert stage.limits is not None
    margins = np.minimum(states.readings - stage.limits.minimum, stage.limits.maximum - states.readings).min(axis=-1)
    kept = spm.sweeps.condition("leg_margin", least=0.02)(states)
    np.testing.assert_array_equal(kept, margins >= 0.02)
    assert 0 < np.count_nonzero(kept) < 30


def test_chunks_are_numbered_without_a_list_of_them() -> None:
    tilts = spm.sweeps.tilt_grid((0.1, 0.2, 10**6), (0.0, 0.2, 10**5), (0.0, 1.0, 10**5))
    plan = SweepPlan.make(spm.Stage(0.08, 0.09), tilts, ["reachable"], chunk=10**6)
    indices = iter(plan)
    assert plan.count == 10**10
    assert [next(indices) for _ in range(3)] == [(0, 0, 0), (0, 1, 0), (0, 2, 0)]


def test_domains_of_the_other_machine_and_heights_in_another_unit_are_refused(tmp_path: Path) -> None:
    stage, _ = limited("RRS")
    paper = spm.Manipulator.paper()
    tilts = spm.sweeps.tilt_grid((0.1, 0.2, 3), 0.1, 0.0)
    for machine, domain in (
        (stage, spm.sweeps.pose_grid((0, 0.1, 2), 0, 0, xyx=[0, 0, 0])),
        (stage, spm.sweeps.leg_grid((0.1, 0.2, 2), 0.2)),
        (paper, tilts),
        (paper, spm.sweeps.leg_grid((0.1, 0.2, 2))),
    ):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="domain")):
            SweepPlan.make(machine, domain, ["reachable"], 10)
    for wrong in ((-0.1, 0.2, 3), (0.0, 4.0, 3), 30.0):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="tilt")):
            spm.sweeps.tilt_grid(0.1, wrong, (0.0, 1.0, 2))
    millimetres = spm.sweeps.tilt_grid((100.0, 150.0, 3), 0.1, 0.0)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="height")):
        spm.sweeps.run_sweep(stage, millimetres, ["reachable"], tmp_path / "map.zarr", workers=1)
    assert not (tmp_path / "map.zarr").exists()
