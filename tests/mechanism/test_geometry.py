from __future__ import annotations

import numpy as np
import pytest

import spm_pin as spm


def test_the_papers_dimensions() -> None:
    geometry = spm.Geometry.paper()
    assert geometry.base_radius == pytest.approx(1.2 / 3**0.5, rel=1e-15)
    assert geometry.platform_radius == pytest.approx(0.6 / 3**0.5, rel=1e-15)
    assert geometry.middle_side == 0.8
    assert geometry.limits == spm.LegLimits(1.10, 1.50)


def test_joints_are_those_of_equation_1() -> None:
    geometry = spm.Geometry(2.0, 1.0, 0.5)
    q = 3**0.5
    np.testing.assert_allclose(geometry.base_joints, [[q, -1, 0], [0, 2, 0], [-q, -1, 0]], atol=1e-15)
    np.testing.assert_allclose(geometry.platform_joints, [[q / 2, -0.5, 0], [0, 1, 0], [-q / 2, -0.5, 0]], atol=1e-15)


def test_each_revolute_axis_is_parallel_to_the_opposite_side() -> None:
    a = spm.Geometry.paper().base_joints
    for i in range(3):
        opposite = a[(i + 1) % 3] - a[(i + 2) % 3]
        assert np.linalg.norm(np.cross(opposite, spm.Geometry.paper().revolute_axes[i])) < 1e-15


def test_arrays_handed_out_cannot_change_the_geometry() -> None:
    geometry = spm.Geometry.paper()
    geometry.base_joints[:] = 0.0
    geometry.revolute_axes[:] = 0.0
    assert np.abs(geometry.base_joints).max() > 0.5
    assert np.abs(geometry.revolute_axes).max() == 1.0


@pytest.mark.parametrize("name", ["base_radius", "platform_radius", "middle_side"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "1", True, 9e-10, 2e9])
def test_a_dimension_must_be_a_positive_number_of_a_sane_size(name: str, value: object) -> None:
    dimensions = {"base_radius": 1.0, "platform_radius": 0.5, "middle_side": 0.7, name: value}
    with pytest.raises(spm.GeometryError, match=f"{name}: expected a positive") as caught:
        spm.Geometry(**dimensions)  # type: ignore[arg-type]
    assert caught.value.argument == name


def test_limits_contain_their_bounds_and_measure_the_margin() -> None:
    limits = spm.LegLimits.stages((1.0, 2.0), (1.5, 3.0))
    assert limits.minimum == (1.0, 1.0, 1.0, 1.5, 1.5, 1.5)
    lengths = [[1.0, 1.5, 2.0, 1.5, 2.0, 3.0], [1.2, 1.3, 1.4, 1.6, 1.7, 3.1], [np.nan] * 6]
    np.testing.assert_array_equal(limits.contains(lengths), [True, False, False])
    np.testing.assert_allclose(limits.margin(lengths), [0.0, -0.1, np.nan], atol=1e-15)


@pytest.mark.parametrize(
    ("minimum", "maximum", "words"),
    [
        (1.5, 1.1, "exchanged"),
        (1.1, 1.1, "minimum < maximum"),
        (-0.1, 1.0, "0 <= minimum"),
        ([1, 1, 1], 2, "six in the order r_b1"),
        (float("nan"), 2, "NaN"),
        (True, 2, "minimum: expected one length or six"),
    ],
)
def test_wrong_limits_are_refused(minimum: object, maximum: object, words: str) -> None:
    with pytest.raises(spm.GeometryError, match=words):
        spm.LegLimits(minimum, maximum)  # type: ignore[arg-type]


def test_the_text_of_a_geometry_is_short() -> None:
    assert repr(spm.Geometry.paper()) == (
        "Geometry(base_radius=0.69282, platform_radius=0.34641, middle_side=0.8, limits=LegLimits(1.1, 1.5))"
    )
    assert repr(spm.Geometry(1, 1, 1)) == "Geometry(base_radius=1, platform_radius=1, middle_side=1)"
    assert repr(spm.LegLimits.stages((1, 2), (1.5, 3))) == "LegLimits.stages((1, 2), (1.5, 3))"
    assert repr(spm.LegLimits(range(6), 9)) == "LegLimits([0, 1, 2, 3, 4, 5], [9, 9, 9, 9, 9, 9])"  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [1e-9 / 0.34, 1e-6, 1e3, 1e9])
def test_results_scale_with_the_machine(scale: float) -> None:
    unit = spm.Geometry(1.2 / 3**0.5, 0.6 / 3**0.5, 0.8)
    scaled = spm.Geometry(*(scale * size for size in (unit.base_radius, unit.platform_radius, unit.middle_side)))
    position, angles, load = np.array([0.6889, 0.4963, 2.253]), np.deg2rad([-11.08, 32.97, -12.88]), np.ones(6)

    def results(geometry: spm.Geometry, length: float) -> list[np.ndarray]:
        branches = spm.inverse_displacement(geometry, spm.pose(length * position, xyx=angles))
        state = branches.physical()
        modes = spm.forward_displacement(geometry, state.leg_lengths)
        forces = spm.leg_forces(state, load * [1, 1, 1, length, length, length])
        near = spm.singularities(state)
        return [branches.leg_lengths / length, modes.translation / length, forces, near.sigma, near.scaled_determinants]

    for found, expected in zip(results(scaled, scale), results(unit, 1.0), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
