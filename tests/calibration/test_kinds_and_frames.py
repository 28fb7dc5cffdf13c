"""Machines of PRS and RRS legs identified, and measurements that a tracker takes in its own frame."""

from __future__ import annotations

import numpy as np
import pytest
from calibration.measured import PAPER, elsewhere, measure
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.calibration import MeasurementError, identify
from spm_pin.calibration.error_model import parameter_scale
from spm_pin.machine import PRS, RPS, RRS, LegKind, Stage

STAGES: dict[str, tuple[LegKind, tuple[float, float]]] = {
    "RPS": (RPS(), (0.30, 0.42)),
    "PRS": (PRS(rod=0.30, direction=1.4), (0.00, 0.12)),
    "RRS": (RRS(crank=0.15, rod=0.35), (0.1, 0.9)),
}


def machine_of(lower: str, upper: str) -> spm.Manipulator:
    bases = zip((0.30, 0.22), (STAGES[lower], STAGES[upper]), strict=True)
    return spm.Manipulator.of_stages(*(Stage(base, 0.25, legs, limits) for base, (legs, limits) in bases))


def states(machine: spm.Manipulator, count: int, seed: int = 0) -> spm.Configuration:
    assert machine.limits is not None
    readings = np.random.default_rng(seed).uniform(machine.limits.minimum, machine.limits.maximum, (count, 6))
    found = spm.forward_physical(machine, readings)
    return found[found.exists]


def measured(machine: spm.Manipulator, readings: np.ndarray) -> np.ndarray:
    return spm.forward_physical(machine, readings).pose.as_matrix()


@pytest.mark.parametrize(
    ("lower", "upper", "positions_only"), [("RPS", "RPS", False), ("RRS", "PRS", False), ("PRS", "RRS", True)]
)
def test_servos_and_screws_are_identified(lower: str, upper: str, positions_only: bool) -> None:
    nominal = machine_of(lower, upper)
    true = nominal.perturbed(2, length=1e-4, angle=5e-4)
    plan = states(nominal, 60)
    poses = measured(true, plan.readings)
    found = identify(nominal, poses[:, :3, 3] if positions_only else poses, plan.readings)
    assert found.status == "fits"
    count = len(nominal.parameter_names)
    assert len(found.unidentifiable) == (9 if positions_only else 6) + 3 * (lower, upper).count("PRS")
    assert len(found.unidentifiable) + len(found.deviations) == count
    other = states(nominal, 60, seed=1).readings
    before, after = (
        np.abs(measured(x, other) - measured(true, other))[:, :3, 3].max() for x in (nominal, found.machine)
    )
    assert before > 1e-4
    assert after < 1e-8
    difference = (found.machine.parameters - true.parameters) / parameter_scale(nominal)
    np.testing.assert_allclose(found.identifiable[:30] @ difference, 0.0, atol=1e-6)
    moved = (found.machine.parameters - nominal.parameters) / parameter_scale(nominal)
    np.testing.assert_allclose(found.unidentifiable @ moved, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.identifiable @ found.identifiable.T, np.eye(len(found.identifiable)), atol=1e-12)
    np.testing.assert_allclose(found.identifiable @ found.unidentifiable.T, 0.0, atol=1e-12)


TRACKER = RigidTransform.from_components([3.0, -2.0, 0.5], Rotation.from_rotvec([0.1, -0.2, 2.0]))
TARGET = RigidTransform.from_components([0.1, 0.05, 0.2], Rotation.from_rotvec([0.3, 0.2, -1.0]))


@pytest.mark.parametrize("positions_only", [False, True])
def test_a_tracker_s_frame_and_target_are_estimated_with_the_machine(positions_only: bool) -> None:
    true = PAPER.perturbed(3)
    poses, readings = measure(true, 1)
    seen = TRACKER.as_matrix() @ poses @ TARGET.as_matrix()
    found = identify(PAPER, seen[:, :3, 3] if positions_only else seen, readings, frames=True)
    assert found.status == "fits"
    # As many as without frames: what moves all legs of a stage moves a frame as well.
    assert len(found.deviations) == (45 if positions_only else 48)
    assert len(found.unidentifiable) == 18
    assert found.names[-1] == ("target.z" if positions_only else "target.turn_z")
    predicted, exact = (measured(x, elsewhere().readings) for x in (found.machine, true))
    errors = (
        found.base.as_matrix() @ predicted @ found.target.as_matrix() - TRACKER.as_matrix() @ exact @ TARGET.as_matrix()
    )
    assert np.linalg.norm(errors[:, :3, 3], axis=-1).max() < 5e-5
    assert np.linalg.norm(found.base.translation - TRACKER.translation) < 1e-3


def test_a_tracker_s_own_frame_is_named_as_a_cause() -> None:
    poses, readings = measure(PAPER.perturbed(3), 1, states=elsewhere()[:18])
    found = identify(PAPER, (TRACKER.as_matrix() @ poses @ TARGET.as_matrix())[:, :3, 3], readings)
    with pytest.raises(MeasurementError, match=r"Poses of a target in a tracker's own frame\? With frames=True"):
        _ = found.machine


def test_with_tolerances_what_is_seen_badly_stays_as_near_as_machines_are_made() -> None:
    """An offset against the height of its pivot: millimetres without, and the platform is known as well."""
    true = PAPER.perturbed(3)
    measurements = measure(true, 1)
    free, held = (identify(PAPER, *measurements, tolerances=x) for x in (None, dict.fromkeys(spm.machine.LEGS, 1e-4)))
    assert np.abs(free.machine.parameters - PAPER.parameters).max() > 2e-3
    assert np.abs(held.machine.parameters - PAPER.parameters).max() < 4e-4
    assert np.abs(held.machine.parameters - true.parameters).max() < 4e-4
    for found in (free, held):
        assert found.status == "fits"
        predicted, exact = (measured(x, elsewhere().readings) for x in (found.machine, true))
        assert np.linalg.norm((predicted - exact)[:, :3, 3], axis=-1).max() < 4e-5
