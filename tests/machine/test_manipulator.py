from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from error_fields import with_fields
from problems import MANIPULATORS

import spm_pin as spm
from spm_pin.machine import PARAMETERS
from spm_pin.machine.manipulator import check_same_machine

PAPER = spm.Manipulator.paper()


def test_dimensions_joints_and_axes_are_those_of_the_paper() -> None:
    assert PAPER.dimensions == pytest.approx((1.2 / 3**0.5, 0.6 / 3**0.5, 0.8), rel=1e-15)
    assert PAPER.limits == spm.LegLimits(1.10, 1.50)
    machine, q = spm.Manipulator(2.0, 1.0, 0.5), 3**0.5
    a = machine.base_joints
    np.testing.assert_allclose(a, [[q, -1, 0], [0, 2, 0], [-q, -1, 0]], atol=1e-15)
    np.testing.assert_allclose(machine.platform_joints, a / 2, atol=1e-15)
    # Each revolute axis is parallel to the opposite side.
    opposite = np.roll(a, -1, axis=0) - np.roll(a, -2, axis=0)
    np.testing.assert_allclose(np.cross(opposite, machine.revolute_axes), 0.0, atol=1e-15)
    # What is handed out is a copy.
    machine.base_joints[:] = machine.revolute_axes[:] = 0.0
    assert np.abs(machine.base_joints).max() == 2.0
    assert np.abs(machine.revolute_axes).max() == 1.0


@pytest.mark.parametrize("name", ["base_radius", "platform_radius", "middle_side"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "1", True, 9e-10, 2e9])
def test_a_dimension_must_be_a_positive_number_of_a_sane_size(name: str, value: object) -> None:
    dimensions = {"base_radius": 1.0, "platform_radius": 0.5, "middle_side": 0.7, name: value}
    with pytest.raises(spm.GeometryError, match=f"{name}: expected a positive") as caught:
        spm.Manipulator(**dimensions)  # type: ignore[arg-type]
    assert caught.value.argument == name


def test_limits_contain_their_bounds_and_measure_the_margin() -> None:
    limits = spm.LegLimits.stages((1.0, 2.0), (1.5, 3.0))
    assert limits.minimum == (1.0, 1.0, 1.0, 1.5, 1.5, 1.5)
    lengths = [[1.0, 1.5, 2.0, 1.5, 2.0, 3.0], [1.2, 1.3, 1.4, 1.6, 1.7, 3.1], [np.nan] * 6]
    np.testing.assert_array_equal(limits.contains(lengths), [True, False, False])
    np.testing.assert_allclose(limits.margin(lengths), [0.0, -0.1, np.nan], atol=1e-15)
    # To rounding: 1e-8 of the longest limit.
    by_rounding, beyond = np.full(6, 2.0) + 1e-8, np.full(6, 2.0) + 3e-8
    assert limits.contains([by_rounding, beyond]).tolist() == [True, False]
    assert limits.margin([by_rounding, beyond]).round(12).tolist() == [0.0, -3e-8]
    assert limits.excess(by_rounding).tolist() == [0.0] * 6
    longer, lower = spm.LegLimits(1e-2, np.inf), spm.LegLimits(-np.inf, 1e-2)
    for limits, sign in ((longer, -1.0), (lower, 1.0)):
        end = np.full(len(limits.minimum), 1e-2)
        assert limits.contains(end + sign * 1e-11)
        assert not limits.contains(end + sign * 1e-9)


@pytest.mark.parametrize(
    ("dimensions", "limits", "says"),
    [
        ((692.8, 346.4, 800), (1.1, 1.5), "is base_radius 692.8 mm or cm"),
        ((69.28, 34.64, 80), (1.1, 1.5), "is base_radius 69.28 mm or cm"),
        ((0.69, 0.35, 0.8), (1100, 1500), "is it 1500 mm"),
        ((0.69, 0.35, 0.8), (110, 150), "is it 150 cm"),
    ],
)
def test_limits_in_another_unit_than_the_dimensions_are_refused(
    dimensions: tuple[float, ...], limits: tuple[float, float], says: str
) -> None:
    with pytest.raises(spm.GeometryError, match=f"^limits: .*{says}"):
        spm.Manipulator(*dimensions, spm.LegLimits(*limits))


@pytest.mark.parametrize(
    ("minimum", "maximum", "words"),
    [
        (1.5, 1.1, "exchanged"),
        (1.1, 1.1, "minimum < maximum"),
        ([1, 1], 2, "six in the order r_b1"),
        ([1, 1, 1], [2] * 6, "as many minima as maxima"),
        (float("nan"), 2, "NaN"),
        (True, 2, "minimum: expected one reading, or six"),
    ],
)
def test_wrong_limits_are_refused(minimum: object, maximum: object, words: str) -> None:
    with pytest.raises(spm.GeometryError, match=words):
        spm.LegLimits(minimum, maximum)  # type: ignore[arg-type]


def test_limits_of_one_number_or_a_pair_are_those_of_all_legs_of_either_machine() -> None:
    stage = spm.Stage(0.7, 0.46)
    for machine in (PAPER, stage):
        count = len(machine.legs.names)
        for limits in ((1.15, 1.4), spm.LegLimits(1.15, 1.4), spm.LegLimits([1.15] * 3, 1.4), ([1.15] * count, 1.4)):
            read = machine.check_limits(limits)
            assert (read.legs, read.minimum, read.maximum) == (machine.legs.names, (1.15,) * count, (1.4,) * count)
            assert replace(machine, limits=limits).limits == read
    for machine, other in ((PAPER, ([1.1, 1.2, 1.1], 1.5)), (stage, ([1.1] * 5 + [1.2], 1.5))):
        with pytest.raises(spm.GeometryError, check=with_fields(argument="limits")):
            machine.check_limits(other)


def test_the_text_of_a_geometry_is_short() -> None:
    assert repr(PAPER) == (
        "Manipulator(base_radius=0.69282, platform_radius=0.34641, middle_side=0.8, limits=LegLimits(1.1, 1.5))"
    )
    assert repr(spm.Manipulator(1, 1, 1)) == "Manipulator(base_radius=1, platform_radius=1, middle_side=1)"
    assert repr(spm.LegLimits.stages((1, 2), (1.5, 3))) == "LegLimits.stages((1, 2), (1.5, 3))"
    assert repr(spm.LegLimits(range(6), 9)) == "LegLimits([0, 1, 2, 3, 4, 5], [9, 9, 9, 9, 9, 9])"  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore:.*another unit")
@pytest.mark.parametrize("scale", [1e-9 / 0.34, 1e-6, 1e3, 1e9])
def test_results_scale_with_the_machine(scale: float) -> None:
    unit = spm.Manipulator(1.2 / 3**0.5, 0.6 / 3**0.5, 0.8)
    scaled = spm.Manipulator(*(scale * size for size in (unit.base_radius, unit.platform_radius, unit.middle_side)))
    position, angles, load = np.array([0.6889, 0.4963, 2.253]), np.deg2rad([-11.08, 32.97, -12.88]), np.ones(6)

    def results(machine: spm.Manipulator, length: float) -> list[np.ndarray]:
        branches = spm.inverse_displacement(machine, spm.pose(length * position, xyx=angles))
        state = branches.physical()
        modes = spm.forward_displacement(machine, state.leg_lengths)
        forces = spm.leg_forces(state, load * [1, 1, 1, length, length, length])
        near = spm.singularities(state)
        return [branches.leg_lengths / length, modes.translation / length, forces, near.sigma, near.scaled_determinants]

    for found, expected in zip(results(scaled, scale), results(unit, 1.0), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def built_machine(seed: int = 0, length: float = 1e-3, angle: float = 1e-3) -> spm.Manipulator:
    return PAPER.perturbed(seed, length=length, angle=angle)


@pytest.mark.parametrize("name", MANIPULATORS)
def test_without_errors_it_has_the_nominal_dimensions(name: str) -> None:
    machine = MANIPULATORS[name]
    legs = machine.legs
    np.testing.assert_array_equal(legs.pivots, np.concatenate([machine.base_joints, machine.platform_joints]))
    np.testing.assert_array_equal(legs.axes, np.tile(machine.revolute_axes, (2, 1)))
    sides = np.linalg.norm(legs.balls[:3] - np.roll(legs.balls[:3], 1, axis=0), axis=-1)
    np.testing.assert_allclose(sides, machine.middle_side, rtol=1e-15)
    assert (machine.parameters.reshape(6, 9)[:, :2] == 0.0).all()


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-4, 0.05, 0.2])
def test_parameters_there_and_back(size: float) -> None:
    built = built_machine(3, size, size)
    again = built.from_parameters(built.parameters)
    for name in ("axes", "pivots", "balls", "offsets"):
        np.testing.assert_allclose(getattr(again.legs, name), getattr(built.legs, name), rtol=0, atol=4e-16)
    assert len(PARAMETERS) == 54 == len(set(PARAMETERS))
    assert PARAMETERS[0] == "r_b1.direction_1"
    assert PARAMETERS[-1] == "r_c3.offset"


def test_errors_have_the_standard_deviations_asked_for() -> None:
    many = np.stack([built_machine(seed, 2e-4, 5e-4).parameters - PAPER.parameters for seed in range(400)])
    scale = np.tile(np.repeat([5e-4, 2e-4], [2, 7]), 6)
    # 400 samples: the standard deviation of a standard deviation is 3.5 %.
    assert (np.abs(many.std(axis=0) / scale - 1.0) < 0.18).all()
    assert (np.abs(many.mean(axis=0)) < 0.25 * scale).all()
    turned = built_machine(1, 0.0, 1e-3)
    np.testing.assert_array_equal(turned.legs.pivots, PAPER.legs.pivots)
    np.testing.assert_array_equal(turned.legs.offsets, PAPER.legs.offsets)
    assert built_machine(5) == built_machine(5) != built_machine(6)


def test_geometry_is_frozen_and_compared_by_value() -> None:
    built = built_machine()
    for twin in (copy.deepcopy(built), pickle.loads(pickle.dumps(built)), copy.copy(built)):
        assert twin == built
        assert hash(twin) == hash(built)
        with pytest.raises(ValueError, match="read-only"):
            twin.legs.balls[0, 0] = 1.0
    with pytest.raises(AttributeError):
        built.legs = built.legs  # type: ignore[misc]
    pivots = np.array(built.legs.pivots)
    twin = spm.Manipulator(*PAPER.dimensions, PAPER.limits, replace(built.legs, pivots=pivots))
    pivots[0, 0] = 99.0
    assert twin == built
    assert built != PAPER
    check_same_machine(replace(built, limits=None), built, "near", "the machine")
    with pytest.raises(spm.GeometryError, check=with_fields(argument="near")):
        check_same_machine(twin, PAPER, "near", "the machine")
    assert "legs differ from nominal by up to 0.00" in repr(built)


def test_a_machine_without_errors_is_the_drawn_one() -> None:
    copies = built_machine(0, 0.0, 0.0), replace(PAPER, legs=replace(PAPER.legs)), pickle.loads(pickle.dumps(PAPER))
    for machine in copies:
        assert machine.is_nominal
        assert machine == PAPER
        assert machine.nominal is machine
    built = built_machine()
    assert not built.is_nominal
    assert built.nominal == PAPER
    # Drawn legs follow the dimensions; legs as built stay.
    assert replace(PAPER, base_radius=0.5) == spm.Manipulator(0.5, *PAPER.dimensions[1:], PAPER.limits)
    assert replace(built, base_radius=0.5).legs == built.legs


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("axes", np.eye(3), "axes"),
        ("axes", 2.0 * np.ones((6, 3)), "r_b1.*Divide it by its length"),
        ("pivots", np.full((6, 3), np.nan), "pivots: expected finite"),
        ("pivots", np.full((6, 3), 1e10), "pivots.*1e\\+10"),
        ("balls", np.outer(np.arange(6.0), [1.0, 2.0, 3.0]), "balls.*lower legs on one line"),
        ("balls", np.zeros((6, 3)), "on one line"),
        ("offsets", np.zeros((2, 6)), "offsets"),
    ],
)
def test_what_is_no_machine_is_an_error_that_names_the_argument(name: str, value: object, message: str) -> None:
    built = built_machine()
    with pytest.raises(spm.GeometryError, match=message):
        replace(built.legs, **{name: value})
    with pytest.raises(spm.ArgumentError, match=r"parameters.*degrees"):
        built.from_parameters(np.full(54, 3.0))
