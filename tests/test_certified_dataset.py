"""The data set of certified poses: files, checksums, and what it claims, against exact arithmetic."""

from __future__ import annotations

import hashlib
import runpy
from pathlib import Path

import numpy as np
import pytest
from calibrated_oracle import root_near
from oracle import certified_counts

import spm_pin as spm

pytestmark = pytest.mark.documents

SCRIPT = Path(__file__).parents[1] / "scripts/certified_dataset.py"


def test_the_data_set_holds_what_it_says(tmp_path: Path) -> None:
    machine = spm.Manipulator.paper()
    folder = tmp_path / "data"
    runpy.run_path(str(SCRIPT))["write"](folder, 12, 0)
    listed = dict(reversed(line.split()) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert listed == {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in folder.iterdir()
        if file.name != "SHA256SUMS"
    }
    data = {file.stem: np.load(file) for file in folder.glob("*.npy")}
    assert {name for name in data if f"`{name}.npy`" in (folder / "README.md").read_text()} == set(data)
    poses = spm.pose(data["position"], rotation=data["rotation"])
    exists = np.isfinite(data["error"])
    np.testing.assert_array_equal(np.isfinite(data["leg_lengths"]).all(axis=-1), exists)
    np.testing.assert_array_equal(exists.sum(axis=-1), certified_counts(poses, machine.middle_side))
    assert data["covered"].any(axis=-1).all()
    solutions = spm.inverse_displacement(machine, poses)
    for n, branch in np.argwhere(exists)[::5]:
        rotation, position = data["rotation"][n], data["position"][n]
        root = root_near(machine, rotation, position, solutions.middle_joints[n, branch])
        joints = np.array([float(x) for x in root]).reshape(3, 3)
        ends = machine.base_joints, position + machine.platform_joints @ rotation.T
        exact = np.concatenate([np.linalg.norm(joints - end, axis=-1) for end in ends])
        assert np.abs(exact - data["leg_lengths"][n, branch]).max() <= data["error"][n, branch]
