"""Functions of a manipulator that take a stage as well, for every kind of legs, nominal and calibrated."""

from __future__ import annotations

import numpy as np
import pytest
from balancers import MACHINES, existing_states, stage_and_height

import spm_pin as spm
from spm_pin.errors import ArgumentError


@pytest.mark.parametrize("machine", MACHINES)
def test_readings_of_a_tilt_and_height_lead_back_to_them(machine: str) -> None:
    stage, height = stage_and_height(machine)
    wanted = existing_states(stage, height, 8)
    states = spm.inverse_physical(stage, wanted.height, normal=wanted.normal)
    np.testing.assert_allclose(np.linalg.norm(states.normal - wanted.normal, axis=-1), 0.0, atol=1e-12)
    back = spm.forward_physical(stage, states.readings, near=states)
    np.testing.assert_allclose(back.balls, states.balls, atol=1e-9 * stage.size)
    assert spm.inverse_displacement(stage, wanted.height, normal=wanted.normal)["T"].exists.all()
    modes = spm.forward_displacement(stage, states.readings)
    gaps = np.abs(modes.configurations.balls - states.balls[:, None]).max(axis=(-1, -2))
    np.testing.assert_allclose(np.nanmin(gaps, axis=-1), 0.0, atol=1e-8 * stage.size)
    path = spm.follow(stage, height=[height, height], roll=[0.0, 0.05], samples=4)
    np.testing.assert_allclose(path.configurations[-1].roll, 0.05, atol=1e-12)


def test_the_machine_may_be_named() -> None:
    stage, height = stage_and_height("RRS")
    assert spm.inverse_physical(machine=stage, height=height).exists
    paper = spm.Manipulator.paper()
    assert spm.forward_physical(readings=[1.3] * 6, machine=paper).exists


@pytest.mark.parametrize(
    "function",
    [spm.forward_displacement, spm.forward_physical, spm.inverse_displacement, spm.inverse_physical, spm.follow],
)
def test_what_is_no_machine_is_refused(function: object) -> None:
    with pytest.raises(ArgumentError) as error:
        function(spm.RPS(), [1.0] * 3)  # type: ignore[operator]
    assert error.value.argument == "machine"
    assert error.value.expected == "a Manipulator or a Stage"


def test_arguments_of_the_other_machine_are_named() -> None:
    stage, height = stage_and_height("RRS")
    for name, call in (
        ("height", lambda: spm.inverse_physical(spm.Manipulator.paper(), height=1.2)),
        ("pose", lambda: spm.inverse_physical(stage, pose=np.eye(4))),
    ):
        with pytest.raises(ArgumentError, match="takes a pose, a stage takes a height") as refused:
            call()  # type: ignore[no-untyped-call]
        assert refused.value.argument == name
    with pytest.raises(ArgumentError) as refused:
        spm.follow(stage, height=[height, height, height], roll=[0.0, 0.1], pitch=0.0)
    assert refused.value.argument == "height"
