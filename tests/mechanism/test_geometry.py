from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.mechanism.geometry import config_directory


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
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), "wide", None])
def test_a_dimension_must_be_positive_and_finite(name: str, value: object) -> None:
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
    ],
)
def test_limits_that_make_no_sense(minimum: object, maximum: object, words: str) -> None:
    with pytest.raises(spm.GeometryError, match=words):
        spm.LegLimits(minimum, maximum)  # type: ignore[arg-type]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_yaml_with_radii_and_without_limits(tmp_path: Path) -> None:
    path = write(tmp_path / "robot.yaml", "base_radius: 0.5\nplatform_side: 0.3\nmiddle_side: 0.4\n")
    assert spm.Geometry.from_yaml(path) == spm.Geometry(0.5, 0.3 / 3**0.5, 0.4)


def test_yaml_with_limits_leg_by_leg(tmp_path: Path) -> None:
    legs = "".join(f"  {leg}: [{1 + k / 10}, {2 + k / 10}]\n" for k, leg in enumerate(spm.mechanism.LEGS))
    path = write(tmp_path / "robot.yaml", "base_side: 1\nplatform_side: 1\nmiddle_side: 1\nleg_limits:\n" + legs)
    limits = spm.Geometry.from_yaml(path).limits
    assert limits == spm.LegLimits([1.0, 1.1, 1.2, 1.3, 1.4, 1.5], [2.0, 2.1, 2.2, 2.3, 2.4, 2.5])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base_side: 1\nmiddle_side: 1", "platform_side and platform_radius"),
        ("base_side: 1\nbase_radius: 1\nplatform_side: 1\nmiddle_side: 1", "base_side, base_radius"),
        ("base_side: 1\nplatform_side: 1", "middle_side"),
        ("base_side: 1\nplatform_side: 1\nmiddle_side: 1\ncolour: red", "colour"),
        ("base_side: wide\nplatform_side: 1\nmiddle_side: 1", "number of metres"),
        ("base_side: 1\nplatform_side: 1\nmiddle_side: 1\nleg_limits: [1, 2]", "lower and upper"),
        ("base_side: 1\nplatform_side: 1\nmiddle_side: 1\nleg_limits: {lower: [1], upper: [1, 2]}", "a pair"),
        ("base_side: 1\nplatform_side: 1\nmiddle_side: 1\nleg_limits: {lower: [a, b], upper: [1, 2]}", "a pair"),
        ("base_side: 1\nplatform_side: 1\nmiddle_side: 1\nleg_limits: {lower: [2, 1], upper: [1, 2]}", "exchanged"),
        ("[1, 2", "YAML file"),
        ("- 1\n- 2", "mapping"),
        ("", "mapping"),
    ],
)
def test_yaml_that_describes_no_manipulator(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(spm.GeometryError, match=words):
        spm.Geometry.from_yaml(write(tmp_path / "robot.yaml", text))


def test_yaml_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(spm.GeometryError, match="No such file"):
        spm.Geometry.from_yaml(tmp_path / "missing.yaml")


def test_numbers_of_the_description_are_found() -> None:
    assert (config_directory() / "geometry.yaml").is_file()


def test_errors_survive_the_way_home_from_a_worker() -> None:
    with pytest.raises(spm.GeometryError) as caught:
        spm.LegLimits(2.0, 1.0)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert again.expected == caught.value.expected
