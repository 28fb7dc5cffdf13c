"""Metrics against their definitions, computed without shared code."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from problems import PAPER_TILTS, singular_state

import spm_pin as spm
from spm_pin.machine.branch_of_state import BRANCHES
from spm_pin.sweeps import METRICS, Metric, Points
from spm_pin.sweeps.metrics import resolve_metrics
from spm_pin.sweeps.points import Space

MACHINE = spm.Manipulator.paper()


def legs(count: int, seed: int = 0, low: float = 1.1, high: float = 1.5) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def mixed_poses(count: int) -> np.ndarray:
    """Poses, some within the leg limits, some beyond, some that nothing reaches."""
    states = spm.forward_physical(MACHINE, legs(2 * count, low=1.0, high=1.6))
    states = states[states.exists][:count]
    angles = states.pose.rotation.as_euler("XYX")
    poses = np.concatenate([states.translation, angles], axis=-1)
    poses[::5, :3] += [0.9, -0.7, 0.0]
    return poses


@pytest.fixture(params=["pose", "legs"])
def points(request: pytest.FixtureRequest) -> Points:
    space: Space = request.param
    return Points(MACHINE, space, mixed_poses(120) if space == "pose" else legs(60, low=1.0, high=1.6))


def test_the_branch_is_the_machines(points: Points) -> None:
    numbers = METRICS["branch"].evaluate(points)
    flags = METRICS["branch"].flags
    assert {flags[label] for label in BRANCHES} == set(range(8))
    np.testing.assert_array_equal(numbers == flags["none"], ~points.reachable)
    there = np.flatnonzero(points.reachable)
    np.testing.assert_allclose(
        points.solutions.leg_lengths[there, numbers[there]], points.physical.leg_lengths[there], atol=1e-9
    )


def test_the_margin_is_signed() -> None:
    points = Points(MACHINE, "pose", mixed_poses(120))
    margin = METRICS["leg_margin"].evaluate(points)
    np.testing.assert_array_equal(margin >= 0, points.reachable)
    assert (margin < 0).any()
    free = dataclasses.replace(MACHINE, limits=None)
    with pytest.raises(spm.ArgumentError, match="leg limits") as error:
        METRICS["leg_margin"].evaluate(Points(free, "pose", points.coordinates))
    assert error.value.__notes__ == ["while evaluating the metric 'leg_margin'"]
    # Without limits everything with a physical branch is reachable.
    assert Points(free, "pose", points.coordinates).reachable.sum() > points.reachable.sum()


def test_distances_and_determinants_are_those_of_singularities(points: Points) -> None:
    known = spm.singularities(points.physical)
    expected = {"forward_distance": known.sigma[:, :2].min(axis=-1), "inverse_distance": known.sigma[:, 2]}
    expected |= {
        f"det_{name}": known.scaled_determinants[:, k] for k, name in enumerate(("lower", "upper", "structure"))
    }
    for name, values in expected.items():
        np.testing.assert_allclose(METRICS[name].evaluate(points), values, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("which", PAPER_TILTS)
def test_singular_states_among_regular_ones_do_not_stop_a_sweep(which: int) -> None:
    singular = singular_state(which, *PAPER_TILTS[which])
    regular = spm.forward_physical(MACHINE, legs(3))
    points = Points(MACHINE, "legs", legs(4))
    joined = [
        np.concatenate([getattr(regular, name), getattr(singular, name)[None]])
        for name in ("rotation", "translation", "middle_joints")
    ]
    vars(points)["_reached"] = np.ones(4, dtype=bool), spm.Configuration.from_arrays(MACHINE, *joined)
    alone = Points(MACHINE, "legs", legs(3))
    for mine in (METRICS[name] for name in ("conditioning", "isotropy", "payload", "payload_down", "least_stiffness")):
        values = mine.evaluate(points)
        assert np.isfinite(values).all()
        if which == 0:
            assert values[3] == 0.0
        elif mine.name in ("conditioning", "isotropy"):
            assert values[3] < 1e-4
        else:
            # At an inverse singularity, det K = 0, forces stay finite.
            assert values[3] > 1e-3
        np.testing.assert_allclose(values[:3], mine.evaluate(alone), rtol=1e-9)


def test_points_of_which_none_is_reached() -> None:
    far = np.tile([5.0, 0, 2, 0.1, 0.5, -0.1], (3, 1))
    for mine in METRICS.values():
        values = mine.evaluate(Points(MACHINE, "pose", far))
        assert values.shape == (3,)
        assert np.isnan(values).all() or (values == mine.flags.get("none", 0)).all()


# Metrics made by users


def r_b1(points: Points) -> np.ndarray:
    return points.physical.leg_lengths[:, 0]


def test_a_metric_made_by_hand() -> None:
    mine = Metric("r_b1", "m", "length of leg r_b1", r_b1)
    points = Points(MACHINE, "legs", legs(4))
    np.testing.assert_allclose(mine.evaluate(points), points.coordinates[:, 0], rtol=1e-12)
    assert resolve_metrics([mine, "reachable"]) == (mine, METRICS["reachable"])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"function": lambda points: points.coordinates}, r"shape \(4,\).* of shape \(4, 6\)"),
        ({"function": lambda points: points.coordinates[:, 0], "dtype": "int8"}, "float64 of shape"),
        ({"function": lambda points: np.full(len(points), 300), "dtype": "int8"}, "int8 can hold, got 300"),
        ({"function": lambda points: np.full(len(points), -128), "dtype": "int8"}, "got -128"),
        ({"function": lambda points: np.full(len(points), 1j)}, "complex"),
        ({"function": lambda points: np.full(len(points), 1e300), "dtype": "float32"}, r"can hold, got 1e\+300"),
        ({"function": lambda points: np.ma.masked_equal(np.arange(4.0), 2.0)}, "masked values"),
    ],
)
def test_what_a_metric_returns_is_checked(changes: dict[str, object], says: str) -> None:
    mine = dataclasses.replace(Metric("mine", "1", "mine", r_b1), **changes)  # type: ignore[arg-type]
    with pytest.raises(spm.ArgumentError, match=says):
        mine.evaluate(Points(MACHINE, "legs", legs(4)))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Metric("a b", "1", "", r_b1), "name"),
        (lambda: Metric("a", "1", "", r_b1, "uint8"), "dtype"),
        (lambda: Metric("__a", "1", "", r_b1), "name"),
        (lambda: Metric("a", "1", "", r_b1, flags={"yes": 1}), "flags"),
        (lambda: Metric("a", "1", "", r_b1, "int8", flags={"yes no": 1}), "flags"),
        (lambda: Metric("a", "1", "", r_b1, parameters={"b": object()}), "parameters"),
        (lambda: Metric("a", "1", "", r_b1, parameters={"units": 1}), "parameters"),
        (lambda: Metric("a", "1", "", r_b1, version=1.5), "version"),  # type: ignore[arg-type]
        (lambda: Metric("a", "1", "", lambda points, *, factor: points), "factor"),
        (lambda: METRICS["payload"](push=0.0), "push"),
        (lambda: METRICS["least_stiffness"](legs=1.0), "legs: expected a parameter among leg_stiffness"),
        (lambda: resolve_metrics([]), "none"),
        (lambda: resolve_metrics(["payload", METRICS["payload"](push=5.0)]), "different names"),
    ],
)
def test_bad_metrics_are_refused(make: object, says: str) -> None:
    assert callable(make)
    with pytest.raises(spm.ArgumentError, match=says):
        make()


ARRAYS = ("coordinates", "status", "branch_readings", "branches_within", "reachable", "sigma", "determinants")


@pytest.mark.parametrize("name", [*ARRAYS, "platform_jacobians"])
@pytest.mark.parametrize("space", ["pose", "legs"])
def test_metrics_cannot_modify_shared_points(name: str, space: Space) -> None:
    points = Points(MACHINE, space, mixed_poses(20) if space == "pose" else legs(20))
    with pytest.raises(ValueError, match="read-only"):
        getattr(points, name)[...] = 0
    for array in (points.singular_values(0.3), points.physical.translation, points.solutions.leg_lengths):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize(
    "mine", [*METRICS.values(), METRICS["payload"](push=900.0, pull=400.0), METRICS["conditioning"](length=0.3)]
)
def test_a_definition_makes_a_metric_again(mine: Metric) -> None:
    again = Metric.from_definition(mine.definition())
    points = Points(MACHINE, "legs", legs(3))
    np.testing.assert_array_equal(again.evaluate(points), mine.evaluate(points))
    assert again.description == mine.description
