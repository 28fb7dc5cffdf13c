"""Certificates for all machines within errors, against machines drawn from them."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from proofs.machines_within_errors import machine_within
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.proofs import certify_inverse

PAPER = spm.Manipulator.paper()
LIMITS = spm.LegLimits(1.1, 1.5)


@pytest.fixture(scope="module")
def certificate() -> spm.Certificate:
    return spm.certify(PAPER, LIMITS, length_error=1e-4, angle_error=1e-4)


def test_small_errors_cost_little_of_the_bounds(certificate: spm.Certificate) -> None:
    assert certificate.holds
    plain = spm.certify(PAPER, LIMITS)
    assert all(0.95 * most < bound <= most for bound, most in zip(certificate.bounds, plain.bounds, strict=True))
    assert "within 0.1 mm and 0.1 mrad" in certificate.explain()


def test_a_machine_as_built_is_proved_with_its_own_errors() -> None:
    machine = machine_within(PAPER, 2e-4, 3e-4, np.random.default_rng(1))
    found = spm.certify(machine, LIMITS)
    assert found.holds
    assert found.machine == PAPER
    assert found.errors[0] <= 2e-4 * (1.0 + 1e-9)
    assert found.errors[1] <= 3e-4 * (1.0 + 1e-9)
    assert found.covers(spm.forward_physical(machine, np.full(6, 1.3)))
    far = PAPER.from_parameters(PAPER.parameters + 0.3)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="machine")):
        spm.certify(far, LIMITS)


def test_machines_beyond_the_errors_are_refused(certificate: spm.Certificate) -> None:
    # A ball alone is half as far in a better frame {n}.
    for index, error in ((2, 1.01e-4), (5, 2.5e-4), (8, 1.01e-4)):
        parameters = PAPER.parameters.copy()
        parameters[index] += error
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="configuration")):
            certificate.covers(spm.forward_physical(PAPER.from_parameters(parameters), np.full(6, 1.3)))
    parameters = PAPER.parameters.copy()
    parameters[:2] = 1e-4
    assert certificate.covers(spm.forward_physical(PAPER.from_parameters(parameters), np.full(6, 1.3)))


@pytest.mark.parametrize("errors", [(1e-4, 0.0), (0.0, 1e-4)])
def test_errors_of_one_kind_cover_machines_with_errors_of_this_kind(errors: tuple[float, float]) -> None:
    limits, length, angle = spm.LegLimits(1.25, 1.35), *errors
    found = spm.certify(PAPER, limits, length_error=length, angle_error=angle)
    rng = np.random.default_rng(6)
    for _ in range(5):
        assert found.covers(spm.forward_physical(machine_within(PAPER, length, angle, rng), np.full(6, 1.3)))


@pytest.mark.parametrize("signs", [[1, 1, 1], [-1, 1, -1]])
def test_other_dimensions_are_errors_of_pivots_and_balls(certificate: spm.Certificate, signs: list[int]) -> None:
    other = spm.Manipulator(*(np.array(PAPER.dimensions) + 0.999e-4 * np.array(signs)))
    assert certificate.covers(spm.forward_physical(other, np.full(6, 1.4)))


def test_the_inverse_certificate_takes_a_certificate_of_the_same_limits(certificate: spm.Certificate) -> None:
    limits = spm.LegLimits(1.29, 1.3)
    forward = spm.certify(PAPER, limits)
    assert certify_inverse(PAPER, limits, forward=forward).bound == certify_inverse(PAPER, limits).bound
    for wrong in (certificate, spm.certify(PAPER, LIMITS)):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="forward")):
            certify_inverse(PAPER, limits, forward=wrong)


def test_a_machine_with_larger_errors_has_a_singular_configuration() -> None:
    # Found by constrained minimisation of the errors: 5.13 mm and 5.13 mrad are the least it found.
    error, signs = 5.2e-3, np.zeros((6, 9))
    signs[:3] = [
        [-1, -1, 1, -1, -1, -1, 1, 0, 1],
        [-1, 1, -1, -1, 1, 1, -1, 1, -1],
        [1, -1, -1, 1, 1, 1, -1, -1, -1],
    ]
    machine = PAPER.from_parameters(PAPER.parameters + error * signs.ravel())
    axes, pivots, balls = machine.legs.axes[:3], machine.legs.pivots[:3], machine.legs.balls[:3]

    def state(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return distances from the legs' planes, readings, and D."""
        x, y, x3 = pose[:3]
        turn = Rotation.from_quat([x, y, x3, np.sqrt(1.0 - x * x - y * y - x3 * x3)])
        b = balls @ turn.as_matrix().T + pose[3:]
        legs = b - pivots
        swings = np.cross(axes, legs)
        c = (b[:, None] - b[None]) @ swings[:, :, None]
        determinant = c[0, 1] * c[1, 2] * c[2, 0] + c[1, 0] * c[2, 1] * c[0, 2]
        return (
            (axes * legs).sum(axis=-1),
            np.linalg.norm(legs, axis=-1) + machine.legs.offsets[:3],
            float(determinant[0]),
        )

    def equations(pose: np.ndarray) -> np.ndarray:
        planes, readings, determinant = state(pose)
        # The first leg is left as it comes.
        return np.array([*planes, determinant, readings[1] - 1.4999, readings[2] - 1.4999])

    pose = fsolve(equations, [0.23716, 0.42017, 0.00318, -0.10947, 0.06726, 1.30468], xtol=1e-14)
    assert np.abs(equations(pose)).max() < 1e-12
    readings = state(pose)[1]
    assert ((readings > 1.1) & (readings < 1.5)).all()
    ahead, behind = (state(pose + h * np.eye(6)[5])[2] for h in (1e-6, -1e-6))
    assert ahead * behind < 0.0, "D changes its sign there"
    # With so many boxes these limits are proved without errors.
    assert spm.certify(PAPER, LIMITS, boxes=40_000).holds
    assert not spm.certify(PAPER, LIMITS, length_error=error, angle_error=error, boxes=40_000).holds
