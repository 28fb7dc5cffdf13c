"""Many machines over one sample: rows against each machine's own functions."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from scipy.stats import qmc

import spm_pin as spm
from spm_pin.design import evaluate_designs

LIMITS = spm.LegLimits(1.2, 1.4)
MACHINES = [spm.Manipulator(0.7, c, 0.8, LIMITS) for c in (0.3, 0.35, 0.5)]
WIDE = spm.Manipulator(0.7, 0.35, 0.8, spm.LegLimits(0.6, 1.6))
SHORT = spm.Manipulator(0.7, 0.35, 0.1, spm.LegLimits(0.01, 0.02))
METRICS = ("payload", "least_stiffness")


def test_rows_are_what_each_machine_gives_by_itself() -> None:
    found = evaluate_designs(MACHINES, METRICS, states=512, seed=3)
    assert len(found) == 3
    for row, machine in enumerate(MACHINES):
        rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(0,)))
        shares = qmc.Sobol(6, rng=rng).random_base2(9)
        states = spm.forward_physical(machine, 1.2 + 0.2 * shares)
        g = spm.kinematics.platform_jacobian(states)
        payload = 1.0 / np.linalg.norm(g[:, :3], axis=1).max(axis=-1)
        stiffness = spm.kinematics.principal_stiffness(states, 1.0).translational[:, 0]
        expected = {
            "assembled": 1.0,
            "volume": np.abs(np.linalg.det(g)).mean() * 0.2**6,
            "footprint": np.pi * 0.49,
            "payload_mean": payload.mean(),
            "payload_low": np.quantile(payload, 0.05),
            "least_stiffness_mean": stiffness.mean(),
            "least_stiffness_low": np.quantile(stiffness, 0.05),
        }
        assert found.columns.keys() == expected.keys()
        for name, value in expected.items():
            assert found.columns[name][row] == pytest.approx(value, rel=1e-9), name


def test_the_volume_is_that_of_the_poses_where_each_has_one_state() -> None:
    machine = spm.Manipulator(0.7, 0.35, 0.8, spm.LegLimits(1.25, 1.3))
    volume = evaluate_designs([machine], states=4096).columns["volume"][0]
    expected = spm.workspace.pose_volume(machine, samples=20_000, rng=1)
    # A narrow box around the inverse singularity of the home, on both sides of which a pose has a state.
    assert expected.low < volume < 2.0 * expected.high


def test_machines_that_cannot_be_assembled_or_certified_stop_nothing() -> None:
    found = evaluate_designs([MACHINES[0], WIDE, SHORT], METRICS, states=256, boxes=30_000).columns
    assert found["certified"].tolist() == [1.0, 0.0, 0.0]
    assert found["assembled"][0] == 1.0
    assert 0.0 < found["assembled"][1] < 1.0
    assert found["assembled"][2] == found["volume"][2] == 0.0
    assert np.isnan(found["payload_low"]).tolist() == [False, False, True]
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="machines")):
        evaluate_designs(MACHINES[0])  # type: ignore[arg-type]
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="machines")):
        evaluate_designs([MACHINES[0], spm.Manipulator(0.7, 0.3, 0.8)])
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="machines")):
        evaluate_designs([])
