"""Strata of the rank of K: dimension, and how the middle platform moves, for docs/theory/literature_checks.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from assembly_mode_changes import Array, differences
from stage_placement import MACHINE, SAMPLES, compose, problems

import spm_pin as spm


@dataclass(frozen=True)
class Stratum:
    """States of one kind: their dimension, the rank of K, and how the middle platform moves between ends at rest.

    `dimension` counts the parameters of the states that matter, `bound` is that of the tangent space of the states of
    this rank, so that the dimension of the set of all of them near these lies between; `finite` is the dimension of
    the continuous family of configurations of the pose, `infinitesimal` that of the twists.
    """

    states: str
    rank: int
    dimension: int
    bound: int
    infinitesimal: int
    finite: int


HALF = 0.5 * np.pi
AXIS = np.pi / 3.0
"""Azimuth of a revolute axis."""

# Azimuths of both tilt axes and half tilts of both stages, from two random azimuths and two random half tilts.
Angles = tuple[float, float, float, float]
STRATA: dict[str, Callable[[float, float, float, float], Angles]] = {
    "in general": lambda p, q, a, b: (p, q, a, b),
    "one stage turned by a half turn": lambda p, q, a, b: (p, q, HALF, b),
    "both tilted about the revolute axis of one leg": lambda p, q, a, b: (AXIS, AXIS, a, b),
    "upside down: opposite tilts that add up to a half turn": lambda p, q, a, b: (p, p + np.pi, a, HALF - a),
    "the same about the revolute axis of one leg": lambda p, q, a, b: (AXIS, AXIS + np.pi, a, HALF - a),
    "a half turn and a tilt about the revolute axis of one leg": lambda p, q, a, b: (AXIS, AXIS, HALF, b),
    "a half turn across the revolute axis of one leg, a tilt about it": lambda p, q, a, b: (AXIS + HALF, AXIS, HALF, b),
    "equal tilts, the symmetric home among them": lambda p, q, a, b: (p, p, a, a),
    "both stages turned by half turns": lambda p, q, a, b: (p, q, HALF, HALF),
    "one stage turned by a half turn, the other level": lambda p, q, a, b: (p, q, HALF, 0.0),
    "equal half turns": lambda p, q, a, b: (p, p, HALF, HALF),
}


def strata() -> list[Stratum]:
    """Return the strata of family TT, those of lowest rank last."""
    rng = np.random.default_rng(1)
    return [_stratum(name, angles, rng) for name, angles in STRATA.items()]


def _stratum(name: str, angles: Callable[..., Angles], rng: np.random.Generator) -> Stratum:
    def states(drawn: Array) -> tuple[Array, Array]:
        p, q, a, b = np.transpose([np.broadcast_to(angles(*row), 4) for row in drawn[:, :4]])
        stages = (problems.stage_quaternion("T", azimuth, np.sin(half)) for azimuth, half in ((p, a), (q, b)))
        return np.stack(list(stages), axis=1), drawn[:, 4:]

    drawn = rng.uniform([-np.pi, -np.pi, 0.2, 0.2, 0.5, -2.0], [np.pi, np.pi, 1.3, 1.3, 2.0, -0.5], (SAMPLES, 6))
    turned, heights = states(drawn)
    configurations = compose(turned, heights)
    found = spm.singularities(configurations)
    (rank,) = np.unique(found.rank[:, 2])
    family = spm.inverse_displacement(MACHINE, configurations.pose).degeneracy
    assert family is not None
    (finite,) = np.unique(family.dimension)

    def coordinates(rows: Array) -> Array:
        return np.hstack([states(rows)[0].reshape(len(rows), -1), rows[:, 4:]])

    (dimension,) = {matrix_rank(differences(coordinates, row)) for row in drawn}
    (bound,) = {6 - matrix_rank(_linearised(turned[n], heights[n], int(rank))) for n in range(SAMPLES)}
    return Stratum(name, int(rank), dimension, bound, 6 - int(rank), int(finite))


def structure_matrix(turned: Array, heights: Array) -> Array:
    """Return K (N, 6, 6) at the middle platform's centre, lengths in units of d."""
    configuration = compose(turned, heights)
    axes = MACHINE.revolute_axes
    forces = np.concatenate(
        [np.broadcast_to(axes, (len(turned), 3, 3)), axes @ np.swapaxes(configuration.rotation, -1, -2)], axis=1
    )
    arms = configuration.middle_joints - configuration.middle_joints.mean(axis=1, keepdims=True)
    return np.concatenate([forces, np.cross(np.tile(arms, (1, 2, 1)) / MACHINE.middle_side, forces)], axis=-1)


def _linearised(turned: Array, heights: Array, rank: int) -> Array:
    """Return how the part of K that vanishes at a state changes with the six coordinates of the state."""
    left, _, right = np.linalg.svd(structure_matrix(turned[None], heights[None])[0])
    # Tangents of the sphere of quaternions without torsion, then the heights.
    basis = [np.linalg.svd(q[None, [0, 1, 3]])[2][1:] for q in turned]

    def moved(steps: Array) -> Array:
        q = turned + np.zeros((len(steps), 2, 4))
        for k in (0, 1):
            q[:, k, [0, 1, 3]] += steps[:, 2 * k : 2 * k + 2] @ basis[k]
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
        matrices = structure_matrix(q, heights + steps[:, 4:])
        return (left[:, rank:].T @ matrices @ right[rank:].T).reshape(len(steps), -1)

    return differences(moved, np.zeros(6))


def matrix_rank(matrix: Array) -> int:
    """Return the number of singular values that are not rounding."""
    return int((np.linalg.svd(matrix, compute_uv=False) > 1e-7).sum()) if matrix.size else 0
