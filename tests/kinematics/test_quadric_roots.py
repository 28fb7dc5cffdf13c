"""Steps on the way to the common points of three quadrics, each from points that are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import null_space

from spm_pin.kinematics.kernels.quadric_newton import (
    CONVERGED,
    FAILED,
    POINTS,
    ROWS,
    STATE,
    imaginary_part,
    polish,
    product,
    put_imaginary_part,
    put_real_part,
    real_part,
    symmetric,
    symmetric_product,
)
from spm_pin.kinematics.kernels.quadric_roots import _identities, _made_real, _put_partner


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


def test_the_identities_vanish_at_a_common_point() -> None:
    rng = np.random.default_rng(1)
    x, y, z = rng.normal(size=3)
    right_sides = rng.normal(size=(3, 7))
    right_sides[:, 6] = [x * x, y * y, x * y] - right_sides[:, :6] @ [z * x, x, z * y, y, z * z, z]
    np.testing.assert_allclose(np.array(_identities(right_sides, complex(z))) @ [x, y, 1.0], 0.0, atol=1e-13)


def values(forms: Any, x: np.ndarray) -> list[float]:
    quadrics = (symmetric(forms, k) for k in range(3))
    return [product(tuple(x), symmetric_product(quadric, tuple(x))) for quadric in quadrics]


def quadrics_through(*points: np.ndarray) -> np.ndarray:
    monomials = [[values(np.eye(10)[[k, k, k]], x)[0] for k in range(10)] for x in points]
    forms: np.ndarray = np.random.default_rng(0).normal(size=(3, 10 - len(points))) @ null_space(monomials).T
    np.testing.assert_allclose([values(forms, x) for x in points], 0.0, atol=1e-15)
    return forms


def projector(points: np.ndarray) -> np.ndarray:
    found = np.array(real_part(points, 1)) + 1j * np.array(imaginary_part(points, 1))
    return np.outer(found, found.conj())


def test_the_partner_of_a_root_is_where_newton_s_method_leads_from_the_start_beside_it() -> None:
    first = np.array([0.1, -0.7, 0.5, 0.5])
    second = first + 1e-3 * np.array([0.7, 0.1, 0.5, -0.5])
    second /= np.linalg.norm(second)
    forms = quadrics_through(first, second)
    roots, points = np.zeros((2, ROWS * POINTS))
    for k in range(POINTS):
        put_real_part(roots, k, tuple(first))
        _put_partner(forms, roots, points, k)
    polish(forms, points, True, False, 30)
    np.testing.assert_allclose(projector(points), np.outer(second, second), atol=1e-10)


@pytest.mark.parametrize(("away", "state"), [(0.01, CONVERGED), (0.12, FAILED)])
def test_only_a_point_next_to_a_root_passes_as_such(away: float, state: float) -> None:
    """From far away Newton's method leads to the root, too, but not by a short first step."""
    root = np.array([0.1, -0.7, 0.5, 0.5])
    forms = quadrics_through(root)
    for contracting, expected in ((True, state), (False, CONVERGED)):
        points = np.zeros(ROWS * POINTS)
        for k in range(POINTS):
            put_real_part(points, k, tuple(root + away * np.array([0.6, 0.3, -0.3, 0.6])))
        polish(forms, points, False, contracting, 30)
        assert points[STATE + 1] == expected
        if expected == CONVERGED:
            np.testing.assert_allclose(projector(points), np.outer(root, root), atol=1e-12)
