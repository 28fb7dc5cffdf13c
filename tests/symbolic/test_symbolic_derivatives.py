"""First derivatives of the symbolic displacements at a thousand states, against velocities of the closed chain.

The velocities are those that the differentiated closure equations allow, written in NumPy.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from problems import GEOMETRIES, random_branches
from symbolic.c_poses import held_states
from symbolic.test_symbolic_functions import as_columns, called

import spm_pin as spm

NAMES = "paper", "wide base"
COUNT = 1010
TOLERANCE = 1e-10
HALF = np.sqrt(3.0) / 2.0
RADIAL = np.array([[HALF, -0.5, 0.0], [0.0, 1.0, 0.0], [-HALF, -0.5, 0.0]])
AXES = np.array([[0.5, HALF, 0.0], [1.0, 0.0, 0.0], [-0.5, HALF, 0.0]])

State = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Ball joints (n, 3, 3), rotations (n, 3, 3) and positions (n, 3)."""


def inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=-1)


def leg_vectors(geometry: spm.Geometry, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of the legs (n, 6, 3), towards the terminal platform, and the axes of their revolute joints."""
    b, rotation, o = state
    ends = o[:, None] + geometry.platform_radius * np.einsum("nij,kj->nki", rotation, RADIAL)
    upper = np.einsum("nij,kj->nki", rotation, AXES)
    legs = np.concatenate([b - geometry.base_radius * RADIAL, ends - b], axis=1)
    return legs, np.concatenate([np.broadcast_to(AXES, upper.shape), upper], axis=1)


def velocities(geometry: spm.Geometry, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Rates of the ball joints (n, 9, 6) and of the legs (n, 6, 6), by the platform's twist, from the closure."""
    b, _, o = state
    legs, axes = leg_vectors(geometry, state)
    n = len(b)
    rows, right = np.zeros((n, 9, 9), b.dtype), np.zeros((n, 9, 6), b.dtype)
    for i in range(3):
        j = (i + 1) % 3
        rows[:, i, 3 * i : 3 * i + 3] = axes[:, i]
        rows[:, 3 + i, 3 * i : 3 * i + 3] = axes[:, 3 + i]
        right[:, 3 + i, :3] = axes[:, 3 + i]
        right[:, 3 + i, 3:] = np.cross(b[:, i] - o, axes[:, 3 + i])
        rows[:, 6 + i, 3 * i : 3 * i + 3] = b[:, i] - b[:, j]
        rows[:, 6 + i, 3 * j : 3 * j + 3] = b[:, j] - b[:, i]
    joints = np.linalg.solve(rows, right)
    unit = legs / np.sqrt(inner(legs, legs))[..., None]
    by_twist = joints.reshape(n, 3, 3, 6)
    lower = np.einsum("nij,nijk->nik", unit[:, :3], by_twist)
    arms = legs[:, 3:] + b - o[:, None]
    ends = np.concatenate([unit[:, 3:], np.cross(arms, unit[:, 3:])], axis=-1)
    return joints, np.concatenate([lower, ends - np.einsum("nij,nijk->nik", unit[:, 3:], by_twist)], axis=1)


def turned(rotation: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The rate of R that an angular velocity makes."""
    return np.cross(rate[:, :, None], rotation, axis=1)


def derivative(
    function: ca.Function, inputs: tuple[np.ndarray, ...], rates: tuple[np.ndarray, ...]
) -> list[np.ndarray]:
    """The rates of all outputs, by CasADi's forward mode."""
    return called(function.forward(1), *inputs, *called(function, *inputs), *rates)


def agree(found: np.ndarray, expected: np.ndarray) -> None:
    """Compare states one by one, relative to the largest number of each."""
    n = len(expected)
    error = np.abs(found - expected).reshape(n, -1).max(axis=-1)
    assert (error <= TOLERANCE * np.abs(expected).reshape(n, -1).max(axis=-1)).all()


def moving(geometry: spm.Geometry) -> tuple[State, State, np.ndarray, np.ndarray]:
    """A thousand states away from singularities, rates that the closure allows, leg rates by twist, and twists."""
    found = held_states(geometry, 12 * COUNT, 31)
    found = found[np.abs(spm.determinants(found)[..., 2]) > 0.005]
    regular = np.linalg.cond(velocities(geometry, as_columns(found))[1]) < 1000.0
    found = found[np.flatnonzero(regular)[:COUNT]]
    assert len(found) == COUNT
    state = as_columns(found)
    twist = np.random.default_rng(32).normal(size=(COUNT, 6))
    joints, legs = velocities(geometry, state)
    rates = (joints @ twist[..., None]).reshape(-1, 3, 3), turned(found.rotation, twist[:, 3:]), twist[:, :3]
    return state, rates, legs, twist


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_of_the_forward_displacement_are_velocities_of_the_closed_chain(name: str) -> None:
    geometry = GEOMETRIES[name]
    state, rates, legs, twist = moving(geometry)
    lengths = np.sqrt(inner(*[leg_vectors(geometry, state)[0]] * 2))
    found = derivative(spm.symbolic.forward_physical(geometry), (lengths,), ((legs @ twist[..., None])[..., 0],))
    # Beside a fold fourteen steps may be too few.
    there = called(spm.symbolic.forward_physical(geometry), lengths)[4][:, 0] == 1.0
    assert there.sum() >= 0.995 * COUNT
    for value, expected in zip(found[:3], (rates[1], rates[2], rates[0]), strict=True):
        agree(value[there], expected[there])


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_of_every_branch_are_velocities_of_the_closed_chain(name: str) -> None:
    geometry = GEOMETRIES[name]
    states, rng = 0, np.random.default_rng(36)
    for index, label in enumerate(spm.mechanism.BRANCHES):
        pose = random_branches(geometry, label[:2], 600, 40 + index).pose
        branch = spm.inverse_displacement(geometry, pose)[label]
        branch = branch[branch.exists]
        branch = branch[np.abs(spm.determinants(branch)[..., 2]) > 0.02]
        state = as_columns(branch)
        twist = rng.normal(size=(len(branch), 6))
        joints, legs = (rate @ twist[..., None] for rate in velocities(geometry, state))
        rates = turned(branch.rotation, twist[:, 3:]), twist[:, :3]
        found = derivative(spm.symbolic.inverse_branch(label, geometry), state[1:], rates)
        agree(found[0], legs[..., 0])
        agree(found[1], joints.reshape(-1, 3, 3))
        states += len(branch)
    assert states >= COUNT
