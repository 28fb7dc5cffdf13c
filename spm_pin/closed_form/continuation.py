"""Following one assembly mode while the leg lengths change, in steps that are proved not to leave it.

Each stage goes by itself. In R⁴ its state (x0, x1, x2, ζ) solves F = (f, |x|² - 1) = 0, with a derivative that changes
by at most K |Δ| over a displacement Δ; K is known, for F is a polynomial. By the theorem of Newton and Kantorovich, if
|F'⁻¹| K |F'⁻¹ F| is at most 1/2, Newton's method converges to the only solution nearby. A step is taken so short that
this holds, with a margin, for all lengths along it: then the solutions join to a path without a singularity, and
Newton's method ends on it and on no other mode.
"""

from __future__ import annotations

import numpy as np

from spm_pin.closed_form.assembly import joined
from spm_pin.closed_form.stage_newton import BoolArray, StageEquations, polished
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, first_offender
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

__all__ = ["continued", "followed"]

_OPEN = 1e-6
"""Closure residual of a seed, relative to d, from which on it is no configuration."""

_MARGIN = 0.2
"""At most this instead of 1/2, so that `_ITERATIONS` steps of Newton's method reach rounding: 0.4^(2^5) < 1e-12."""
_ITERATIONS = 5
_SHORTEST = 1e-9
"""A step shorter than this part of the way stands before a singularity."""


def continued(geometry: Geometry, lengths: FloatArray, seed: Configuration) -> Configuration:
    """Follow `seed` to the leg lengths (..., 6), each stage by itself."""
    _check_seed(geometry, lengths, seed)
    shape = np.broadcast_shapes(lengths.shape[:-1], seed.shape)
    r = geometry.middle_radius
    end = np.broadcast_to(lengths, (*shape, 6)).reshape(-1, 2, 3)
    start = np.broadcast_to(seed.leg_lengths, (*shape, 6)).reshape(-1, 2, 3)
    b = np.broadcast_to(seed.middle_joints, (*shape, 3, 3)).reshape(-1, 3, 3)
    rotation = np.broadcast_to(seed.rotation, (*shape, 3, 3)).reshape(-1, 3, 3)
    translation = np.broadcast_to(seed.translation, (*shape, 3)).reshape(-1, 3)
    stages = []
    for k, (hips, joints) in enumerate(
        ((geometry.base_radius, b), (geometry.platform_radius, (b - translation[:, None]) @ rotation))
    ):
        states, half_turned = _states(geometry, joints)
        epsilon = np.where(half_turned, -hips, hips) / r
        states, arrived = followed(start[:, k] / r, end[:, k] / r, epsilon, states)
        x0, x1, x2, zeta = np.where(arrived[:, None], states, np.nan).T
        zero = np.zeros_like(x0)
        plain = np.stack([x1, x2, zero, x0], axis=-1)
        turned = np.stack([x2, -x1, x0, zero], axis=-1)
        stages.append((np.where(half_turned[:, None], turned, plain), np.where(half_turned, -zeta, zeta)))
    return joined(geometry, stages[0], stages[1], shape)


def _states(geometry: Geometry, joints: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the states (M, 4) of one stage with corners (M, 3, 3) [m], and which are in mode F; see `followed`."""
    pose = Configuration.from_arrays(geometry, np.eye(3), np.zeros(3), joints).middle_pose
    x1, x2, x3, x0 = np.moveaxis(pose.rotation.as_quat(), -1, 0)
    zeta = pose.translation[..., 2] / geometry.middle_radius
    half_turned = np.abs(x3) > np.abs(x0)
    states = np.where(
        half_turned[:, None], np.stack([x3, -x2, x1, -zeta], axis=-1), np.stack([x0, x1, x2, zeta], axis=-1)
    )
    # The other of x0 and x3 is rounding.
    length = np.sqrt((states[:, :3] ** 2).sum(axis=-1))
    states[:, :3] /= np.where(states[:, 0] < 0.0, -length, length)[:, None]
    return states, half_turned


def _check_seed(geometry: Geometry, lengths: FloatArray, seed: Configuration) -> None:
    if not isinstance(seed, Configuration):
        raise ArgumentError("seed", "a Configuration", type(seed).__name__)
    dimensions = [(g.base_radius, g.platform_radius, g.middle_side) for g in (geometry, seed.geometry)]
    if dimensions[0] != dimensions[1]:
        expected = f"a configuration of this geometry, with E, C, d = {dimensions[0]} m"
        raise ArgumentError("seed", expected, dimensions[1])
    try:
        np.broadcast_shapes(lengths.shape[:-1], seed.shape)
    except ValueError:
        expected = f"leading axes that broadcast with those of leg_lengths, {lengths.shape[:-1]}"
        raise ArgumentError("seed", expected, seed.shape) from None
    if not seed.exists.all():
        raise ArgumentError("seed", "states that exist", f"NaN at index {first_offender(~seed.exists)}")
    torn = float(seed.closure_residual.max(initial=0.0))
    if torn > _OPEN * geometry.middle_side:
        received = f"a closure residual of {torn:.1e} m"
        raise ArgumentError("seed", "a configuration that closes", received)


def followed(
    start: FloatArray, end: FloatArray, epsilon: FloatArray, states: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Follow states along straight paths of leg lengths.

    Parameters
    ----------
    start, end : ndarray, shape (K, 3)
        Leg lengths in units of r.
    epsilon : ndarray, shape (K,)
        E/r, negative in mode F.
    states : ndarray, shape (K, 4)
        Solutions at `start`, unit quaternions with x0 >= 0; see `spm_pin.closed_form.stage_newton`.

    Returns
    -------
    states : ndarray, shape (K, 4)
        Solutions at `end`, ζ of either sign.
    arrived : ndarray of bool, shape (K,)
        False where a forward singularity was met on the way.
    """
    states = states.copy()
    done = np.zeros(len(states))
    active = np.arange(len(states))
    while len(active):
        here, there = start[active], end[active] - start[active]
        step = _safe_step(here + done[active, None] * there, there, epsilon[active], states[active])
        done[active] = np.minimum(done[active] + step, 1.0)
        target = StageEquations.of(here + done[active, None] * there, epsilon[active])
        states[active] = _corrected(target, states[active])
        active = active[(done[active] < 1.0) & (step >= _SHORTEST)]
    arrived = done >= 1.0
    states[states[:, 0] < 0.0, :3] *= -1.0
    every = np.arange(len(states))
    owner, ends, _ = polished(StageEquations.of(end, epsilon), every, states)
    # What had gone below the hips comes back reflected.
    reflected = (ends[:, 1:] * states[owner, 1:]).sum(axis=-1) < 0.0
    ends[reflected, 1:] *= -1.0
    states[owner] = ends
    return states, arrived & np.isin(every, owner)


def _safe_step(lengths: FloatArray, change: FloatArray, epsilon: FloatArray, states: FloatArray) -> FloatArray:
    """Return by how much of `change` (K, 3) the lengths may change, shape (K,)."""
    equations = StageEquations.of(lengths, epsilon)
    inverse = np.linalg.inv(_derivatives(equations, states))
    gain = np.sqrt((inverse * inverse).sum(axis=(-1, -2)))

    def reach(value: FloatArray) -> FloatArray:
        moved = inverse[:, :, : value.shape[-1]] @ value[..., None]
        return np.asarray(np.sqrt((moved * moved).sum(axis=(-1, -2))))

    # The squared lengths, of which f is a linear function, change by 2 l dl s + dl² s².
    allowed = _MARGIN / (gain * _curvature(epsilon, states[:, 3])) - reach(_residual(equations, states))
    first, second = reach(_harmonics(2.0 * lengths * change)), reach(_harmonics(change * change))
    allowed = np.maximum(allowed, 0.0)
    slowest = first + np.sqrt(first * first + 4.0 * second * allowed)
    return np.asarray(np.where(slowest > 0.0, 2.0 * allowed / np.where(slowest > 0.0, slowest, 1.0), 1.0))


def _corrected(equations: StageEquations, states: FloatArray) -> FloatArray:
    for _ in range(_ITERATIONS):
        step = np.linalg.solve(_derivatives(equations, states), _residual(equations, states)[..., None])
        states = states - step[..., 0]
    return states


def _residual(equations: StageEquations, states: FloatArray) -> FloatArray:
    """Return F (K, 4)."""
    x = states[:, :3]
    return np.concatenate([equations.residual(states), (x * x).sum(axis=-1, keepdims=True) - 1.0], axis=-1)


def _derivatives(equations: StageEquations, states: FloatArray) -> FloatArray:
    """Return F' (K, 4, 4)."""
    sphere = np.concatenate([2.0 * states[:, :3], np.zeros_like(states[:, 3:])], axis=-1)
    return np.concatenate([equations.derivatives(states), sphere[:, None]], axis=-2)


def _harmonics(squares: FloatArray) -> FloatArray:
    """Return by how much λ and m change with the squared lengths, shape (K, 3)."""
    first, second, third = squares.T
    real, imag = (2.0 * second - first - third) / 6.0, (first - third) * (np.sqrt(0.75) / 3.0)
    return np.stack([real, imag, (first + second + third) / 3.0], axis=-1)


def _curvature(epsilon: FloatArray, zeta: FloatArray) -> FloatArray:
    """Return a bound K of the second derivative of F around a state, shape (K,).

    Term by term, for |x| <= 1.05 and ζ within 0.05 of its value: F'⁻¹ is at least 1/2, for the last row of F' is 2x,
    and K at least 20, so no step of Newton's method leaves that region.
    """
    size, reach = 1.05, np.abs(zeta) + 0.05
    harmonic = 4.0 * np.abs(epsilon) + 18.0 * size**2 + 4.0 * size + 2.0 * reach
    height = 4.0 * np.abs(epsilon) + 12.0 * size**2
    return np.sqrt(harmonic * harmonic + height * height + 4.0)
