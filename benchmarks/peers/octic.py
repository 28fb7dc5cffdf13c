"""The paper's polynomial of degree eight, solved by NumPy: |U| = 0 of Eq. (19) in b_2y, its coefficients given."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.peer import FloatArray, Prepared
from spm_pin import Manipulator
from spm_pin.crosscheck.paper.resultant import Resultant

DEGREE = 8
REAL = 1e-6
"""Imaginary parts up to this share of the interval are taken for rounding."""


def numpy_roots(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare `numpy.roots`, polynomial by polynomial, the coefficients computed beforehand."""
    machine, poses = problem
    polynomials, reach, lines = _polynomials(machine, poses)

    def read(roots: list[FloatArray]) -> list[FloatArray]:
        return _second_joints(np.array(roots), reach, lines)

    return Prepared(lambda: [np.roots(polynomial) for polynomial in polynomials], read)


def numpy_roots_complete(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the coefficients and `numpy.roots`, pose by pose."""
    machine, poses = problem
    singles = [poses[k] for k in range(len(poses))]
    _, reach, lines = _polynomials(machine, poses)

    def read(roots: list[FloatArray]) -> list[FloatArray]:
        return _second_joints(np.array(roots), reach, lines)

    return Prepared(lambda: [np.roots(_polynomials(machine, pose)[0][0]) for pose in singles], read)


def companions(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the eigenvalues of all companion matrices, one call for all."""
    machine, poses = problem
    polynomials, reach, lines = _polynomials(machine, poses)

    def call() -> FloatArray:
        matrices = np.zeros((len(polynomials), DEGREE, DEGREE))
        rows = np.arange(DEGREE - 1)
        matrices[:, rows + 1, rows] = 1.0
        matrices[:, 0] = -polynomials[:, 1:] / polynomials[:, :1]
        return np.asarray(np.linalg.eigvals(matrices))

    return Prepared(call, lambda roots: _second_joints(roots, reach, lines))


def _polynomials(machine: Manipulator, poses: RigidTransform) -> tuple[FloatArray, float, FloatArray]:
    """Return coefficients (n, 9), highest first, in b_2y/reach; the reach [m]; and s_21, s_22 of Eq. (10c), (n, 2)."""
    resultant = Resultant.from_pose(machine, poses)
    reach = 2.0 * machine.middle_radius
    nodes = np.cos((np.arange(DEGREE + 1) + 0.5) * np.pi / (DEGREE + 1))
    values = resultant.determinant(reach * nodes)
    series = np.linalg.solve(chebyshev.chebvander(nodes, DEGREE), values.T).T
    highest_first = np.array([chebyshev.cheb2poly(row)[::-1] for row in series])
    return highest_first / np.abs(highest_first).max(axis=-1, keepdims=True), reach, resultant.s[:, 1]


def _second_joints(roots: FloatArray, reach: float, lines: FloatArray) -> list[FloatArray]:
    """Complete real roots to b_2, Eq. (11), and leave b_1 and b_3, which they are not enough for."""
    found = []
    for values, (s_21, s_22) in zip(roots, lines, strict=True):
        y = reach * values[np.abs(values.imag) <= REAL].real
        joints = np.full((len(y), 3, 3), np.nan)
        joints[:, 1] = np.stack([0.0 * y, y, s_21 + s_22 * y], axis=-1)
        found.append(joints)
    return found
