"""Rotations that are none, alone and among others."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields

import spm_pin as spm

SHEARED = np.array([[1.0, 0.6, 0.0, 0.0], [0.0, 0.8, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize("wrong", [np.diag([1.01, 1.01, 1.01, 1.0]), SHEARED, SHEARED.T])
def test_a_matrix_that_is_no_rotation_is_refused(wrong: np.ndarray) -> None:
    for pose in (wrong, np.stack([np.eye(4), wrong])):
        with pytest.raises(spm.PoseError, check=with_fields(argument="pose")):
            spm.inverse_displacement(spm.Manipulator.paper(), pose)
