"""Coordinates (x, y, height) of both stages, and the middle platform from them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.machine.branch_of_state import stage_coordinates

POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
BRANCHES = spm.inverse_displacement(spm.Manipulator.paper(), POSE)


@pytest.mark.parametrize("mode", ["TT", "FF"])
def test_they_are_those_of_the_middle_platform_seen_from_either_end(mode: str) -> None:
    """In mode F, after half a turn about z."""
    state = BRANCHES[f"{mode}+"]
    middle = state.middle_pose.as_matrix()
    half_turn = [-1.0, -1.0, 1.0] if mode == "FF" else np.ones(3)
    coordinates = stage_coordinates(state, mode)
    for (x, y, height), seen in zip(coordinates, (middle, np.linalg.inv(POSE.as_matrix()) @ middle), strict=True):
        turn = Rotation.from_quat([x, y, 0.0, np.sqrt(1.0 - x * x - y * y)]).as_matrix()
        np.testing.assert_allclose(turn * half_turn, seen[:3, :3], atol=1e-14)
        assert height == pytest.approx(seen[2, 3], abs=1e-14)
    other = {"TT": "FF", "FF": "TT"}[mode]
    assert np.isnan(stage_coordinates(state, other)).all()
