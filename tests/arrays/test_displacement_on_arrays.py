"""Inverse and forward displacement on NumPy's and strict arrays, against the compiled kernels."""

from __future__ import annotations

from typing import Any

import array_api_strict as strict
import numpy as np
import pytest
from arrays.array_problems import BUILT, PAPER, random_poses, random_readings
from error_fields import with_fields
from kinds_of_legs import PAIRS, states
from kinds_of_legs import machine_of_kinds as machine_of
from problems import at_end_stops

import spm_pin as spm
from spm_pin import arrays
from spm_pin.machine import RRS
from spm_pin.machine.joint_angles import joint_names, value_names

MACHINES = {"drawn": PAPER, "as built": BUILT}
COUNTS = (2000, pytest.param(50_000, marks=pytest.mark.slow))


def parts(pose: Any) -> tuple[np.ndarray, np.ndarray]:
    return pose.rotation.as_matrix(), pose.translation


def conditioning(states: spm.Configuration) -> np.ndarray:
    """Return how much larger an error of a state may be than that of its readings or pose."""
    return 1.0 / np.maximum(spm.singularities(states).sigma.min(axis=-1), 1e-9)


@pytest.mark.parametrize("count", COUNTS)
def test_all_branches_are_those_of_the_kernels(count: int) -> None:
    poses = random_poses(count)
    expected, found = spm.inverse_displacement(PAPER, poses), arrays.inverse_displacement(PAPER, *parts(poses))
    clear = np.repeat(np.abs(expected.discriminants) > 1e-12, 2, axis=-1)
    assert (found.exists == expected.exists)[clear].all()
    assert 0.2 < expected.exists.mean() < 0.8
    real = clear & expected.exists
    np.testing.assert_allclose(found.middle_joints[real], expected.middle_joints[real], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.readings[real], expected.leg_lengths[real], rtol=0, atol=1e-9)
    assert np.isfinite(found.middle_joints).all()


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("count", COUNTS)
def test_the_physical_states_of_poses_and_of_readings_are_those_of_the_kernels(name: str, count: int) -> None:
    machine, poses, readings = MACHINES[name], random_poses(count), random_readings(count)
    for expected, found, low, high in (
        (spm.inverse_physical(machine, poses), arrays.inverse_physical(machine, *parts(poses)), 0.01, 1.0),
        (spm.forward_physical(machine, readings), arrays.forward_physical(machine, readings), 0.5, 0.9),
    ):
        both = expected.exists & found.exists
        assert (found.exists == expected.exists).mean() >= 1.0 - 1e-4
        assert low < both.mean() < high
        bound = 1e-13 * conditioning(expected[both])
        for field in ("rotation", "translation", "middle_joints", "readings"):
            error = np.abs(getattr(found, field) - getattr(expected, field))[both].reshape(both.sum(), -1).max(axis=-1)
            assert (error <= bound).all(), field


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), PAIRS)
def test_legs_of_any_kind_are_those_of_the_kernels(lower: str, upper: str, built: bool) -> None:
    machine = machine_of(lower, upper, built=built)
    known = states(machine)
    sigma = spm.singularities(known).sigma.min(axis=-1)[:, None]
    wrench, names = np.random.default_rng(1).normal(size=(len(known), 6)), value_names(machine)
    values = spm.machine.joint_angles(known, (0,)).values
    values = values[:, [names.index(name) for name in joint_names(machine)]]
    for given in (machine, (machine, machine.parameters)):
        state = arrays.forward_physical(given, known.readings)
        assert state.exists.all()
        near = arrays.forward_physical(given, known.readings + 1e-6, near=state)
        back = arrays.inverse_physical(given, known.rotation, known.translation, near=state)
        assert (near.exists & back.exists).all()
        for found in (state, near, back):
            np.testing.assert_allclose(found.middle_joints, known.middle_joints, rtol=0, atol=1e-4)
        np.testing.assert_allclose(state.translation, known.translation, rtol=0, atol=1e-12)
        np.testing.assert_allclose(back.readings, known.readings, rtol=0, atol=1e-11)
        rates, expected = arrays.inverse_jacobian(given, state), spm.inverse_jacobian(known)
        assert (np.abs(rates - expected).max(axis=-1) <= 1e-11 * np.abs(expected).max() / sigma).all()
        forces, expected = arrays.leg_forces(given, state, wrench), spm.leg_forces(known, wrench)
        assert (np.abs(forces - expected) <= 1e-13 / sigma**3).all()
        np.testing.assert_allclose(arrays.joint_values(given, state), values, rtol=0, atol=1e-12)
        distances = arrays.singularity_distance(given, state)
        np.testing.assert_allclose(distances, spm.singularities(known).sigma, rtol=0, atol=1e-12)
    if not built:
        found = arrays.inverse_displacement(machine, known.rotation, known.translation)
        expected = spm.inverse_displacement(machine, known.pose)
        np.testing.assert_array_equal(found.exists, expected.exists)
        real = expected.exists
        np.testing.assert_allclose(found.readings[real], expected.readings[real], rtol=0, atol=1e-11)


def test_balls_out_of_reach_and_other_working_modes_are_no_states() -> None:
    machine = machine_of("RRS", "PRS")
    known = states(machine)
    wound = known.readings + 4.0 * np.pi * (np.array(machine.legs.units) == "rad")
    assert not arrays.forward_physical(machine, wound).exists.any()
    assert spm.casadi.forward_physical(machine)(wound[0])[4] == 0.0
    up = known.translation + np.array([0.0, 0.0, 1.5])
    assert not arrays.inverse_physical(machine, known.rotation, up).exists.any()
    assert not arrays.inverse_displacement(machine, known.rotation, up).exists[:, :2].any()
    # The same circles, on whose other side crank and rod would be.
    places = known.places[:, :3]
    angle = np.arctan2(places[..., 1], places[..., 0])
    mirrored = np.concatenate([2.0 * angle - known.readings[:, :3], known.readings[:, 3:]], axis=-1)
    other = spm.Manipulator.of_stages(
        spm.machine.Stage(machine.base_radius, machine.middle_radius, RRS(crank=1.1, rod=0.9, sign=1)),
        spm.machine.Stage(machine.platform_radius, machine.middle_radius, machine.legs.kinds[1]),
    )
    both = spm.forward_physical(other, mirrored)
    assert both.exists.any()
    assert not (arrays.forward_physical(machine, mirrored).exists & both.exists).any()
    np.testing.assert_array_equal(arrays.forward_physical(other, mirrored).exists, both.exists)


@pytest.mark.parametrize("name", MACHINES)
def test_states_at_end_stops_keep_their_branch(name: str) -> None:
    states = at_end_stops(MACHINES[name], 4_000)
    found = arrays.inverse_physical(MACHINES[name], *parts(states.pose))
    assert found.exists.mean() > 0.998
    expected = spm.inverse_physical(MACHINES[name], states.pose).readings
    apart = np.abs(found.readings - expected)[found.exists].max(axis=-1) > 1e-9
    assert apart.mean() <= (0.0 if MACHINES[name].is_nominal else 1e-3)


def test_an_unphysical_state_is_followed_on_its_branch() -> None:
    branch = spm.inverse_displacement(PAPER, spm.pose([0.6889, 0.4963, 2.253], xyx=[-0.1934, 0.5754, -0.2248]))["FF+"]
    followed = arrays.inverse_physical(PAPER, branch.rotation, branch.translation, near=branch)
    assert followed.exists
    np.testing.assert_allclose(followed.middle_joints, branch.middle_joints, atol=1e-12)


def test_dimensions_and_parameters_are_machines_of_their_own() -> None:
    readings = random_readings(200)
    for numbers, machine in ((np.array(PAPER.dimensions), PAPER), (BUILT.parameters, BUILT)):
        found, expected = arrays.forward_physical(numbers, readings), arrays.forward_physical(machine, readings)
        assert (found.exists == expected.exists).all()
        np.testing.assert_allclose(found.rotation[found.exists], expected.rotation[found.exists], rtol=0, atol=1e-10)
    machines = [PAPER.perturbed(k) for k in range(3)]
    together = arrays.forward_physical(np.stack([m.parameters for m in machines])[:, None], readings)
    assert together.rotation.shape == (3, 200, 3, 3)
    alone = arrays.forward_physical(machines[1], readings)
    np.testing.assert_allclose(together.translation[1][alone.exists], alone.translation[alone.exists], atol=1e-10)


def test_numbers_that_are_none_or_too_large_have_no_state_and_finite_results() -> None:
    readings, (rotation, translation) = random_readings(1)[0], parts(random_poses(1)[0])
    forward, inverse = arrays.forward_physical, arrays.inverse_physical
    states = [forward(PAPER, np.full(6, size)) for size in (np.nan, np.inf, 1e15)]
    states += [inverse(PAPER, rotation, np.full(3, size)) for size in (np.nan, 1e15)]
    states += [inverse(BUILT, rotation * np.nan, translation), inverse(PAPER, rotation * 1e200, translation)]
    for size in (1e200, 1e-200, np.nan):
        states += [forward(np.full(3, size), readings), inverse(np.full(3, size), rotation, translation)]
    states += [forward(np.full(54, np.nan), readings), inverse(np.full(54, 1e200), rotation, translation)]
    for state in states:
        assert not state.exists
        assert all(np.isfinite(x).all() for x in state)
    for function in (arrays.joint_values, arrays.singularity_distance):
        assert all(np.isfinite(function(PAPER, state)).all() for state in states)


def test_an_index_is_one_of_the_batch_and_one_problem_has_no_axes() -> None:
    readings = random_readings(12).reshape(3, 4, 6)
    states = arrays.forward_physical(PAPER, readings)
    for index in (1, (slice(None), 2), states.exists):
        assert isinstance(states[index], arrays.State)
        for x, y in zip(states[index], states, strict=True):
            np.testing.assert_array_equal(x, y[index])
    one = arrays.forward_physical(PAPER, readings[1, 2])
    for x, y in zip(one, states, strict=True):
        np.testing.assert_array_equal(x, y[1, 2])
    branches = arrays.inverse_displacement(PAPER, one.rotation, one.translation)
    assert [x.shape for x in (branches.middle_joints, branches.readings, branches.exists)] == [(8, 3, 3), (8, 6), (8,)]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", MACHINES)
def test_the_kind_of_array_that_comes_in_goes_out(name: str, dtype: str) -> None:
    machine = MACHINES[name]
    readings = strict.asarray(random_readings(5), dtype=getattr(strict, dtype))
    state = arrays.forward_physical(machine, readings)
    again = arrays.inverse_physical(machine, state.rotation, state.translation)
    results = [
        *list(state)[:4],
        *list(again)[:4],
        arrays.joint_values(machine, state),
        arrays.inverse_jacobian(machine, state),
    ]
    results += [arrays.leg_forces(machine, state, readings), arrays.singularity_distance(machine, state)]
    if machine is PAPER:
        results += list(arrays.inverse_displacement(machine, state.rotation, state.translation))[:2]
    for array in results:
        assert isinstance(array, type(readings))
        assert array.dtype == readings.dtype
    assert state.exists.dtype == strict.bool


@pytest.mark.parametrize("name", MACHINES)
def test_single_precision_keeps_five_digits_away_from_singularities(name: str) -> None:
    machine, readings = MACHINES[name], random_readings(5_000)
    exact = arrays.forward_physical(machine, readings.astype(np.float32).astype(float))
    single = arrays.forward_physical(machine, readings.astype(np.float32))
    sigma = arrays.singularity_distance(machine, exact).min(axis=-1)
    assert (exact.exists == single.exists).mean() > 0.999
    well = exact.exists & single.exists & (sigma > 0.05)
    assert well.mean() > 0.3
    assert np.abs(single.rotation - exact.rotation)[well].max() < 2e-5
    assert np.abs(single.translation - exact.translation)[well].max() < 2e-5


STATE = arrays.forward_physical(PAPER, random_readings(2))
TORN = STATE._replace(middle_joints=np.ones((2, 3)))


@pytest.mark.parametrize(
    ("function", "arguments", "argument"),
    [
        (arrays.inverse_physical, (PAPER, np.eye(4), np.zeros(3)), "rotation"),
        (arrays.inverse_physical, (PAPER, STATE.rotation, strict.asarray(STATE.translation)), "rotation, translation"),
        (arrays.inverse_physical, (PAPER, STATE.rotation, np.ones((3, 3))), "translation"),
        (arrays.inverse_displacement, (BUILT, STATE.rotation, STATE.translation), "machine"),
        (arrays.inverse_displacement, (BUILT.parameters, STATE.rotation, STATE.translation), "machine"),
        *((arrays.forward_physical, (PAPER, np.ones(6, x)), "readings") for x in (int, np.float16, np.longdouble)),
        (arrays.forward_physical, (np.ones(7), np.ones(6)), "machine"),
        (arrays.forward_physical, (PAPER, STATE.readings, TORN), "near.middle_joints"),
        (arrays.forward_physical, (np.array(PAPER.dimensions), strict.asarray(STATE.readings)), "machine, readings"),
        (arrays.forward_physical, (PAPER, np.ones(6), np.ones(6)), "near"),
        (arrays.forward_physical, (PAPER, [1.2] * 6), "readings"),
        (arrays.forward_physical, ((PAPER, np.ones(60)), np.ones(6)), "machine"),
    ],
)
def test_what_is_wrong_is_named(function: Any, arguments: tuple[Any, ...], argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        function(*arguments)
