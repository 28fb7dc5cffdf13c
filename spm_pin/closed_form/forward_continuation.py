"""Following one assembly mode while the leg lengths change, in steps that are proved not to leave it.

Each stage goes by itself. In R⁴ its state (x0, x1, x2, ζ) solves F = (f, |x|² - 1) = 0, with a derivative that changes
by at most K |Δ| over a displacement Δ; K is known, for F is a polynomial. By the theorem of Newton and Kantorovich, if
|F'⁻¹| K |F'⁻¹ F| is at most 1/2, Newton's method converges to the only solution nearby. A step is taken so short that
this holds, with a margin, for all lengths along it: then the solutions join to a path without a singularity, and
Newton's method ends on it and on no other mode.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.threads import in_parts
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, first_offender
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

__all__ = ["continued"]

BoolArray = npt.NDArray[np.bool_]

_OPEN = 1e-6
"""Closure residual of a seed, relative to d, from which on it is no configuration."""

_ENOUGH = 1 << 10
"""Stages that are worth a thread."""


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
    count = len(end)
    states, epsilon, turned = np.empty((2, count, 4)), np.empty((2, count)), np.empty((2, count), dtype=np.bool_)
    for k, (hips, corners) in enumerate(
        ((geometry.base_radius, b), (geometry.platform_radius, (b - translation[:, None]) @ rotation))
    ):
        states[k], turned[k] = _states(geometry, corners)
        epsilon[k] = np.where(turned[k], -hips, hips) / r
    arrived = _follow(np.swapaxes(start, 0, 1) / r, np.swapaxes(end, 0, 1) / r, epsilon, states)
    states[~arrived] = np.nan
    x0, x1, x2, zeta = np.moveaxis(states, -1, 0)
    zero = np.zeros_like(x0)
    plain, half_turned = np.stack([x0, x1, x2, zero, zeta], -1), np.stack([zero, x2, -x1, x0, -zeta], -1)
    return _joined(geometry, np.where(turned[..., None], half_turned, plain), shape)


def _joined(geometry: Geometry, stages: FloatArray, shape: tuple[int, ...]) -> Configuration:
    """Return the configurations of shape (...) of stages (2, N, 5), see `kernels.forward`; NaN where one is."""
    from spm_pin.closed_form.kernels.mode_kernels import compose_all

    count = stages.shape[1]
    rotation, translation, joints = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3, 3))
    compose_all(stages[0], stages[1], geometry.middle_radius, rotation, translation, joints)
    return Configuration.from_arrays(
        geometry, rotation.reshape(*shape, 3, 3), translation.reshape(*shape, 3), joints.reshape(*shape, 3, 3)
    )


def _follow(start: FloatArray, end: FloatArray, epsilon: FloatArray, states: FloatArray) -> BoolArray:
    """Move states (2, N, 4) from the lengths `start` to `end`, (2, N, 3), and tell which arrived (2, N)."""
    from spm_pin.closed_form.kernels.continuation_kernel import follow_stages

    arrived = np.empty(epsilon.shape, dtype=np.bool_)
    starts, ends, signed = start.reshape(-1, 3), end.reshape(-1, 3), epsilon.reshape(-1)
    moved, done = states.reshape(-1, 4), arrived.reshape(-1)
    in_parts(lambda at: follow_stages(starts[at], ends[at], signed[at], moved[at], done[at]), len(done), _ENOUGH)
    return arrived


def _states(geometry: Geometry, joints: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return states (M, 4), see `kernels.stage`, of one stage's corners (M, 3, 3) [m], and which are in mode F."""
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
