"""Common points of three quadrics: of a real point, only the phase is not real."""

from __future__ import annotations

import numpy as np
import pytest

from spm_pin.kinematics.kernels.quadric_newton import (
    POINTS,
    ROWS,
    imaginary_part,
    put_imaginary_part,
    put_real_part,
    real_part,
)
from spm_pin.kinematics.kernels.quadric_roots import _made_real


@pytest.mark.parametrize("factor", [1.0, np.exp(0.7j), np.exp(2.0j)])
def test_a_real_point_times_any_number_is_made_real_and_no_other(factor: complex) -> None:
    real = np.array([0.1, -0.7, 0.5, 0.4])
    for beside in (*1e-3 * np.eye(4), np.zeros(4)):
        z, points = factor * (real + 1j * beside), np.zeros(ROWS * POINTS)
        put_real_part(points, 2, tuple(z.real))
        put_imaginary_part(points, 2, tuple(z.imag))
        assert _made_real(points, 2) == (not beside.any())
    found = np.array(real_part(points, 2))
    np.testing.assert_allclose(np.outer(found, found), np.outer(real, real), atol=1e-15)
    assert not any(imaginary_part(points, 2))
