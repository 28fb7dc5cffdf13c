"""Legs of a calibrated machine: the sense of hinges' axes, the order of legs, and what its text says of them."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from balancers import STAGES

import spm_pin as spm
from spm_pin.machine.legs import Legs


@pytest.mark.parametrize("machine", STAGES)
def test_either_sense_of_an_axis_is_the_same_machine(machine: str) -> None:
    legs = STAGES[machine].perturbed(3).legs
    for senses in itertools.product((1.0, -1.0), repeat=3):
        assert Legs(legs.axes * np.array(senses)[:, None], *legs.arrays[1:], legs.kinds) == legs


def test_a_stage_with_an_axis_reversed_has_the_small_tilt_of_its_lengths() -> None:
    stage = spm.Stage(0.4, 0.3)
    axes = stage.legs.axes * [[1.0], [-1.0], [1.0]]
    reversed_axis = spm.Stage(0.4, 0.3, Legs(axes, *stage.legs.arrays[1:], stage.legs.kinds))
    states = [spm.stages.forward_physical(x, [0.5, 0.52, 0.51]) for x in (stage, reversed_axis)]
    np.testing.assert_allclose(states[1].pose.as_matrix(), states[0].pose.as_matrix(), rtol=0, atol=1e-14)
    assert states[0].pose.as_matrix()[2, 2] > np.cos(np.radians(3.0))


@pytest.mark.parametrize("machine", STAGES)
def test_legs_listed_clockwise_are_refused(machine: str) -> None:
    legs = STAGES[machine].legs
    arrays = (array[::-1] for array in legs.arrays)
    with pytest.raises(spm.GeometryError) as error:
        Legs(*arrays, legs.kinds)
    assert "opposite order" in error.value.cause


def test_offsets_of_cranks_are_angles_in_the_text() -> None:
    stage = next(x for x in STAGES.values() if x.unit == "rad")
    legs = stage.legs
    built = spm.Stage(stage.base_radius, stage.platform_radius, Legs(*legs.arrays[:3], [0.02, 0.0, 0.0], legs.kinds))
    length, angle = re.findall(r"([0-9.e+-]+) (?:m|rad)\b", repr(built).split("off the drawing by up to")[1])
    assert float(length) < 1e-12
    assert float(angle) == 0.02


@pytest.mark.parametrize("kind", ["[1]", "{a: 1}"])
def test_a_kind_that_is_no_text_is_refused(kind: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "stage.yaml"
    file.write_text(f"base_radius: 0.4\nplatform_radius: 0.3\nlegs: {{kind: {kind}}}\n")
    with pytest.raises(spm.GeometryError):
        spm.Stage.from_yaml(file)


def test_nested_aliases_are_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "stage.yaml"
    rows = "".join(f", &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 10))
    file.write_text(f"base_radius: [&a0 [1.0, 1.0]{rows}]\nplatform_radius: 0.3\nlegs: {{kind: RPS}}\n")
    with pytest.raises(spm.ArgumentError) as error:
        spm.Stage.from_yaml(file)
    assert error.value.expected == "a YAML file"
    file.write_text("base_radius: &radius 0.4\nplatform_radius: *radius\nlegs: {kind: RPS}\n")
    assert spm.Stage.from_yaml(file).platform_radius == 0.4
