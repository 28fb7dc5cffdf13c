"""The dimensions of an imperfect machine: what is accepted, its parameters, and its file."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from problems import GEOMETRIES

import spm_pin as spm
from spm_pin.mechanism import PARAMETERS

PAPER = spm.Geometry.paper()


def machine(seed: int = 0, length: float = 1e-3, angle: float = 1e-3) -> spm.Geometry:
    return PAPER.perturbed(seed, length=length, angle=angle)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_without_errors_it_has_the_nominal_dimensions(name: str) -> None:
    geometry = GEOMETRIES[name]
    legs = geometry.legs
    np.testing.assert_array_equal(legs.pivots, np.concatenate([geometry.base_joints, geometry.platform_joints]))
    np.testing.assert_array_equal(legs.axes, np.tile(geometry.revolute_axes, (2, 1)))
    sides = np.linalg.norm(legs.balls[:3] - np.roll(legs.balls[:3], 1, axis=0), axis=-1)
    np.testing.assert_allclose(sides, geometry.middle_side, rtol=1e-15)
    assert (geometry.parameters.reshape(6, 9)[:, :2] == 0.0).all()


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-4, 0.05, 0.2])
def test_parameters_there_and_back(size: float) -> None:
    built = machine(3, size, size)
    again = built.from_parameters(built.parameters)
    for name in ("axes", "pivots", "balls", "offsets"):
        np.testing.assert_allclose(getattr(again.legs, name), getattr(built.legs, name), rtol=0, atol=4e-16)
    assert len(PARAMETERS) == 54 == len(set(PARAMETERS))
    assert PARAMETERS[0] == "r_b1.direction_1"
    assert PARAMETERS[-1] == "r_c3.offset"


def test_errors_have_the_standard_deviations_asked_for() -> None:
    many = np.stack([machine(seed, 2e-4, 5e-4).parameters - PAPER.parameters for seed in range(400)])
    scale = np.tile(np.repeat([5e-4, 2e-4], [2, 7]), 6)
    # 400 samples: the standard deviation of a standard deviation is 3.5 %.
    assert (np.abs(many.std(axis=0) / scale - 1.0) < 0.18).all()
    assert (np.abs(many.mean(axis=0)) < 0.25 * scale).all()
    turned = machine(1, 0.0, 1e-3)
    np.testing.assert_array_equal(turned.legs.pivots, PAPER.legs.pivots)
    np.testing.assert_array_equal(turned.legs.offsets, PAPER.legs.offsets)
    assert machine(5) == machine(5) != machine(6)


@pytest.mark.parametrize("limits", [None, spm.LegLimits([1.0, 1.1, 1.2, 0.9, 0.8, 0.7], [1.5, np.inf, 2, 2, 2, 2])])
def test_a_file_there_and_back_keeps_every_bit(tmp_path: Path, limits: spm.LegLimits | None) -> None:
    nominal = spm.Geometry(0.7, 1e-7, 0.8, limits)
    built = nominal.perturbed(2, length=1e-9, angle=1e-3)
    file = tmp_path / "machine.yaml"
    built.to_yaml(file)
    assert spm.Geometry.from_yaml(file) == built
    assert "r_b1:" in file.read_text(encoding="utf-8")


def test_geometry_is_frozen_and_compared_by_value() -> None:
    built = machine()
    for twin in (copy.deepcopy(built), pickle.loads(pickle.dumps(built)), copy.copy(built)):
        assert twin == built
        assert hash(twin) == hash(built)
        with pytest.raises(ValueError, match="read-only"):
            twin.legs.balls[0, 0] = 1.0
    with pytest.raises(AttributeError):
        built.legs = built.legs  # type: ignore[misc]
    pivots = np.array(built.legs.pivots)
    twin = spm.Geometry(*PAPER.dimensions, PAPER.limits, replace(built.legs, pivots=pivots))
    pivots[0, 0] = 99.0
    assert twin == built
    assert built != PAPER
    assert built.is_same_machine(replace(built, limits=None))
    assert not built.is_same_machine(PAPER)
    assert "off the drawing by up to 0.00" in repr(built)


def test_a_machine_without_errors_is_the_drawn_one() -> None:
    copies = machine(0, 0.0, 0.0), replace(PAPER, legs=replace(PAPER.legs)), pickle.loads(pickle.dumps(PAPER))
    for geometry in copies:
        assert geometry.is_nominal
        assert geometry == PAPER
        assert geometry.nominal is geometry
    built = machine()
    assert not built.is_nominal
    assert built.nominal == PAPER
    # Drawn legs follow the dimensions; legs as built stay.
    assert replace(PAPER, base_radius=0.5) == spm.Geometry(0.5, *PAPER.dimensions[1:], PAPER.limits)
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
    built = machine()
    with pytest.raises(spm.GeometryError, match=message):
        replace(built.legs, **{name: value})


def test_parameters_in_degrees_are_refused() -> None:
    with pytest.raises(spm.ArgumentError, match=r"parameters.*degrees"):
        machine().from_parameters(np.full(54, 3.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (None, "", "an empty file"),
        ("offset: 0.0", "offset: .inf", "offset"),
        ("offset: 0.0", "offset: zero", "offset"),
        ("offset: 0.0", "ofset: 0.0", "ofset"),
        ("axis: [0.5, 0.8660254037844386, 0.0]", "axis: [0.5, 0.866]", r"yaml:\d+: expected three numbers.* 2 of"),
        ("axis: [0.5, 0.8660254037844386, 0.0]", "axis: [0.5, 0.5, 0.0]", "axes in .*yaml"),
        ("r_b1:", "r_b9:", "r_b9"),
        ("base_radius: ", "base_radius: -", "base_radius"),
        ("middle_side:", "middle:", "middle"),
    ],
)
def test_errors_of_a_file_name_the_line_and_the_key(tmp_path: Path, old: str | None, new: str, message: str) -> None:
    file = tmp_path / "machine.yaml"
    legs = spm.Geometry(0.7, 0.4, 0.8).legs
    spm.Geometry(0.7, 0.4, 0.8, legs=replace(legs, offsets=[0, 0, 0, 0, 0, 1e-3])).to_yaml(file)
    text = file.read_text(encoding="utf-8")
    assert old is None or old in text, text
    file.write_text(new if old is None else text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(spm.GeometryError, match=message):
        spm.Geometry.from_yaml(file)
