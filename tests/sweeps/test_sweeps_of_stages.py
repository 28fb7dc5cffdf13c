"""Sweeps over tilts and readings of stages of every kind: metrics against their definitions, and stores."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from balancers import MACHINES, equilibrium, stage_and_height

import spm_pin as spm
from spm_pin.sweeps import METRICS, Points
from spm_pin.sweeps.domains import SweepPlan
from spm_pin.sweeps.points import Space

OF_MANIPULATORS = "branch", "det_upper", "det_structure"


def limited(machine: str) -> tuple[spm.Stage, float]:
    """Return a stage with limits that some of its tilts keep, and a height at which it stands."""
    stage, height = stage_and_height(machine)
    level = spm.inverse_physical(stage, height).readings
    room = 0.4 if stage.unit == "rad" else 0.1 * stage.size
    return dataclasses.replace(stage, limits=spm.machine.StageLimits(level - room, level + room)), height


def points_of(machine: str, space: Space, count: int = 60) -> Points:
    """Return points some of which the stage reaches within its limits, some not."""
    stage, height = limited(machine)
    rng = np.random.default_rng(0)
    if space == "legs":
        low, high = stage.reading_limits
        return Points(stage, "legs", rng.uniform(low - 0.1 * (high - low), high, (count, 3)))
    low, high = [0.85 * height, 0.0, -np.pi], [1.15 * height, 0.6, np.pi]
    return Points(stage, "tilt", rng.uniform(low, high, (count, 3)))


@pytest.mark.parametrize("space", ["tilt", "legs"])
@pytest.mark.parametrize("machine", MACHINES)
def test_metrics_of_stages_are_those_of_their_definitions(machine: str, space: Space) -> None:
    points = points_of(machine, space)
    stage = points.machine
    assert isinstance(stage, spm.Stage)
    if space == "tilt":
        heights, tilts, azimuths = points.coordinates.T
        both = spm.inverse_displacement(stage, heights, tilt=tilts, azimuth=azimuths)
        states = both.physical()
        np.testing.assert_array_equal(METRICS["branches"].evaluate(points), both.count)
        np.testing.assert_array_equal(METRICS["branches_within"].evaluate(points), both.within().count)
    else:
        states = spm.forward_physical(stage, points.coordinates)
        found = METRICS["assembly_modes"].evaluate(points)[points.reachable]
        modes = spm.forward_displacement(stage, points.coordinates[points.reachable])
        np.testing.assert_array_equal(found, modes.count)
    reachable = states.exists & (states.limit_excess == 0.0).all(axis=-1)
    assert 0 < np.count_nonzero(reachable) < len(points)
    np.testing.assert_array_equal(METRICS["reachable"].evaluate(points), reachable)
    for name, metric in METRICS.items():
        if name in OF_MANIPULATORS:
            with pytest.raises(spm.ArgumentError) as caught:
                metric.evaluate(points)
            assert caught.value.argument == "metrics"
        elif metric.dtype.startswith("float") and name != "leg_margin":
            np.testing.assert_array_equal(np.isfinite(metric.evaluate(points)), reachable)
    values = {name: METRICS[name].evaluate(points)[reachable] for name in METRICS if name not in OF_MANIPULATORS}
    reached = states[reachable]
    np.testing.assert_allclose(values["platform_tilt"], reached.tilt, atol=1e-9)
    np.testing.assert_allclose(np.stack([values[f"o_{x}"] for x in "xyz"], axis=-1), reached.translation, atol=1e-9)
    low, high = stage.reading_limits
    room = np.minimum(reached.readings - low, high - reached.readings) * stage.legs.largest_slopes
    np.testing.assert_allclose(values["leg_margin"], room.min(axis=-1), atol=1e-9)
    for k, state in enumerate(reached):
        # Efforts that hold a wrench, from forces at the balls that are in equilibrium with it.
        efforts = -np.linalg.inv(equilibrium(state))[:3]
        np.testing.assert_allclose(values["payload"][k], 1.0 / np.linalg.norm(efforts[:, :3], axis=-1).max(), rtol=1e-6)
        np.testing.assert_allclose(values["payload_down"][k], 1.0 / np.abs(efforts[:, 2]).max(), rtol=1e-6)
        for name, rows in (("least_stiffness", slice(3)), ("least_rotational_stiffness", slice(3, 6))):
            compliance = efforts[:, rows].T @ efforts[:, rows]
            np.testing.assert_allclose(values[name][k], 1.0 / np.linalg.eigvalsh(compliance)[-1], rtol=1e-6)
        # By virtual work G is minus the transposed efforts; of the motion in rates of knees and carriages.
        g = -efforts.T[2:5] * [[1.0], [stage.platform_radius], [stage.platform_radius]] / stage.legs.largest_slopes
        sizes = np.linalg.svd(g, compute_uv=False)
        np.testing.assert_allclose(values["conditioning"][k], sizes[-1] / sizes[0], rtol=1e-6)
        isotropy = np.prod(sizes**2) ** (1.0 / 3.0) / np.mean(sizes**2)
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
        with pytest.raises(spm.ArgumentError) as caught:
            SweepPlan.make(machine, domain, ["reachable"], 10)
        assert caught.value.argument == "domain"
    for wrong in ((-0.1, 0.2, 3), (0.0, 4.0, 3), 30.0):
        with pytest.raises(spm.ArgumentError) as caught:
            spm.sweeps.tilt_grid(0.1, wrong, (0.0, 1.0, 2))
        assert caught.value.argument == "tilt"
    millimetres = spm.sweeps.tilt_grid((100.0, 150.0, 3), 0.1, 0.0)
    with pytest.raises(spm.ArgumentError) as caught:
        spm.sweeps.run_sweep(stage, millimetres, ["reachable"], tmp_path / "map.zarr", workers=1)
    assert caught.value.argument == "height"
    assert not (tmp_path / "map.zarr").exists()
