from __future__ import annotations

import numpy as np
import pytest
from kinds_of_legs import machine_of_kinds, states
from problems import PAPER, random_branches

import spm_pin as spm
from spm_pin.crosscheck import nlp


def arguments(state: spm.Configuration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state.middle_joints.ravel(), state.rotation, state.translation


def test_residuals_are_distances_from_planes_and_errors_of_sides_and_lengths_those_of_the_state() -> None:
    machine = PAPER
    state = random_branches(machine, "TT", 1, 0).configuration[0]
    closure = nlp.closure(machine)
    b, rotation, translation = arguments(state)
    step = 1e-3
    for i in range(3):
        moved = b.copy()
        moved[3 * i : 3 * i + 3] += step * machine.revolute_axes[i]
        residual = np.asarray(closure(moved, rotation, translation)[0]).ravel()
        assert residual[i] == pytest.approx(step, rel=1e-9)
        moved = b.copy()
        moved[3 * i : 3 * i + 3] += step * state.platform_axes[i]
        residual = np.asarray(closure(moved, rotation, translation)[0]).ravel()
        assert residual[3 + i] == pytest.approx(step, rel=1e-9)
    sides = np.asarray(closure(1.5 * b, np.eye(3), np.zeros(3))[0]).ravel()[6:]
    np.testing.assert_allclose(sides, (1.5**2 - 1.0) * machine.middle_side / 2.0, rtol=1e-12)
    lengths = np.asarray(nlp.readings(machine)(b, rotation, translation)).ravel()
    np.testing.assert_allclose(lengths, state.readings, rtol=1e-13)


def test_equations_and_their_jacobian_in_a_machine_as_built() -> None:
    built = PAPER.perturbed(2, length=3e-3, angle=3e-3)
    state = spm.forward_physical(built, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
    closure = nlp.closure(built)
    b, rotation, translation = arguments(state)
    residual, jacobian = (np.asarray(part) for part in closure(b, rotation, translation))
    assert np.abs(residual).max() < 1e-14
    lengths = np.asarray(nlp.readings(built)(b, rotation, translation)).ravel()
    np.testing.assert_allclose(lengths, state.readings, rtol=1e-13)
    rates = nlp.inverse_jacobian(nlp.leg_jacobian(built)(b, rotation, translation))
    np.testing.assert_allclose(rates, spm.inverse_jacobian(state), atol=1e-9)
    # The equations are quadratic: central differences have no truncation error.
    step = 2.0**-10
    for k in range(9):
        up, down = b.copy(), b.copy()
        up[k] += step
        down[k] -= step
        values = [np.asarray(closure(point, rotation, translation)[0]).ravel() for point in (up, down)]
        np.testing.assert_allclose((values[0] - values[1]) / (2 * step), jacobian[:, k], atol=1e-12)


@pytest.mark.parametrize(("lower", "upper"), [("RRS", "PRS"), ("PRS", "RRS")])
def test_readings_and_rates_of_legs_of_any_kind(lower: str, upper: str) -> None:
    machine = machine_of_kinds(lower, upper, built=True)
    shown, derivatives = nlp.readings(machine), nlp.leg_jacobian(machine)
    for state in states(machine)[:10]:
        np.testing.assert_allclose(np.asarray(shown(*arguments(state))).ravel(), state.readings, rtol=0, atol=1e-13)
        rates, expected = nlp.inverse_jacobian(derivatives(*arguments(state))), spm.inverse_jacobian(state)
        np.testing.assert_allclose(rates, expected, rtol=0, atol=1e-11 * np.abs(expected).max() ** 2)
