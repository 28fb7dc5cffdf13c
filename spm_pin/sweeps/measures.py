"""How indices are computed: functions of `Points`, each value of shape (N,)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_displacement
from spm_pin.closed_form.singularity_analysis import determinants
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.sweeps.points import Points

__all__ = [
    "assembly_modes",
    "branch",
    "branches",
    "branches_within",
    "conditioning",
    "determinant",
    "distance",
    "isotropy",
    "leg_margin",
    "payload",
    "payload_down",
    "position",
    "reachable",
    "stiffness",
]

IntArray = npt.NDArray[np.intp]

_MODES_AT_A_TIME = 64
"""Problems of forward displacement solved together: each takes 43 kB."""


def reachable(points: Points) -> IntArray:
    """Return 1 where a real machine can be, else 0."""
    return points.reachable.astype(np.intp)


def branches(points: Points) -> IntArray:
    """Return the number of real branches."""
    return points.solutions.count


def branches_within(points: Points) -> IntArray:
    """Return the number of real branches within the leg limits."""
    return points.solutions.within(points.limits).count


def branch(points: Points) -> IntArray:
    """Return which branch the machine is in, -1 where there is none."""
    # Where the machine was found from leg lengths it is one of the branches up to rounding.
    gaps = np.abs(points.solutions.middle_joints - points.machine.middle_joints[:, None]).max(axis=(-1, -2))
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    return np.where(np.isfinite(gaps.min(axis=-1)), gaps.argmin(axis=-1), -1)


def assembly_modes(points: Points) -> IntArray:
    """Return the number of assembly modes that the machine's leg lengths allow, 0 where there is no machine."""
    lengths = points.reached.leg_lengths
    parts = range(0, len(lengths), _MODES_AT_A_TIME)
    counts = [forward_displacement(points.geometry, lengths[k : k + _MODES_AT_A_TIME]).count for k in parts]
    return points.spread(np.concatenate([*counts, np.zeros(0)]), absent=0.0).astype(np.intp)


def position(points: Points, coordinate: int) -> FloatArray:
    """Return a coordinate of o."""
    return np.asarray(points.machine.translation[:, coordinate])


def leg_margin(points: Points) -> FloatArray:
    """Return how far the worst leg is inside its limits."""
    return points.margin


def distance(points: Points, first: int, last: int) -> FloatArray:
    """Return the least singular value of the matrices from `first` to `last` of J_b, J_c, K."""
    return points.spread(points.singularities.sigma[:, first : last + 1].min(axis=-1))


def determinant(points: Points, which: int) -> FloatArray:
    """Return det J_b, det J_c or det K over d³."""
    return points.spread(determinants(points.reached)[:, which] / points.geometry.middle_side**3)


def conditioning(points: Points, length: float | None) -> FloatArray:
    """Return the inverse condition number, 0 where forward singular."""
    values, held = _singular_values(points, length)
    return points.spread(np.where(held, values[:, -1] / values[:, 0], 0.0))


def isotropy(points: Points, length: float | None) -> FloatArray:
    """Return geometric over arithmetic mean of the squared singular values, 0 where forward singular."""
    values, held = _singular_values(points, length)
    squares = (values / values[:, :1]) ** 2
    return points.spread(np.where(held, squares.prod(axis=-1) ** (1.0 / 6.0) / squares.mean(axis=-1), 0.0))


def _singular_values(points: Points, length: float | None) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return those of G for (v, Lω), shape (M, 6), and which of the M points are not forward singular."""
    jacobians = points.platform_jacobians
    held = ~np.isnan(jacobians[:, 0, 0])
    scale = np.repeat([1.0, points.geometry.platform_radius if length is None else length], 3)
    regular = np.where(held[:, None, None], jacobians * scale[:, None], np.eye(6))
    return np.linalg.svd(regular, compute_uv=False), held


def payload(points: Points, push: float, pull: float) -> FloatArray:
    """Return the force held in every direction, 0 where forward singular."""
    # f = -Gᵀ w: a unit force u asks -G_v[:, i] · u of leg i, at most |G_v[:, i]| in either sense.
    asked = np.linalg.norm(points.platform_jacobians[:, :3], axis=-2).max(axis=-1)
    return points.spread(np.where(np.isnan(asked), 0.0, min(push, pull) / asked))


def payload_down(points: Points, push: float, pull: float) -> FloatArray:
    """Return the force held along -Z, 0 where forward singular."""
    forces = points.platform_jacobians[:, 2]
    share = np.maximum(forces / push, -forces / pull).max(axis=-1)
    return points.spread(np.where(np.isnan(share), 0.0, 1.0 / share))


def stiffness(points: Points, leg: float) -> FloatArray:
    """Return the least translational stiffness, 0 where forward singular."""
    moved = points.platform_jacobians[:, :3]
    held = ~np.isnan(moved[:, 0, 0])
    largest = np.linalg.svd(np.where(held[:, None, None], moved, np.eye(3, 6)), compute_uv=False)[:, 0]
    return points.spread(np.where(held, leg / largest**2, 0.0))
