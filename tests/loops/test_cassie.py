"""Cassie as example-robot-data has it, five times: what closes, what is driven, and what the files have wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from spm_pin.loops import ClosedChain

data = pytest.importorskip("example_robot_data")
FOLDER = Path(data.getModelPath("cassie_description"), "cassie_description/robots")
MOTORS = [f"{side}-{joint}-op" for side in ("left", "right") for joint in ("roll", "yaw", "pitch", "knee", "foot")]
FILES = {
    "cassie": (16, 36, 28, 10),
    "cassie_reduced": (11, 12, 12, 8),
    "cassie_simple": (11, 16, 16, 8),
    "cassie_v2": (18, 12, 10, 10),
    "cassie_wo_gearbox_spring": (13, 16, 14, 10),
}
"""Degrees of freedom, equations, their rank, and that of the ten motors."""


def chain(name: str, held: tuple[str, ...] = ()) -> ClosedChain:
    motors = [motor.replace("-op", "-ip") for motor in MOTORS] if name == "cassie" else MOTORS
    return ClosedChain.from_sdf(FOLDER / f"{name}.sdf", actuated=motors, held=held)


@pytest.mark.parametrize("name", FILES)
def test_mobility_and_the_faults_of_the_files(name: str) -> None:
    """In two files the planar loops repeat an equation each; in two others the loops lock both feet."""
    cassie = chain(name)
    found = cassie.mobility(cassie.close())
    assert (found.dof, found.rows, found.rank, found.actuated_rank) == FILES[name]
    assert not found.is_singular
    is_locked = name in ("cassie_reduced", "cassie_simple")
    assert found.redundant == (("left-foot-op", "right-foot-op") if is_locked else ())
    assert set(found.redundant) <= set(found.locked)
    if name in ("cassie_v2", "cassie_wo_gearbox_spring"):
        assert found.dependent == {"left-plantar-foot-joint": 1, "right-plantar-foot-joint": 1}


@pytest.mark.parametrize("name", ["cassie", "cassie_v2"])
def test_loops_close_from_random_starts(name: str) -> None:
    cassie = chain(name)
    rng = np.random.default_rng(4)
    for _ in range(2):
        q = cassie.close(pin.integrate(cassie.model, cassie.q0, 0.05 * rng.normal(size=cassie.model.nv)))
        assert np.abs(cassie.state(q).gap()).max() < 1e-10
