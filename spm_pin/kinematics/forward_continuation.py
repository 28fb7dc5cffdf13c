"""Following one assembly mode while the leg lengths change, in steps that are proved not to leave it.

Each stage goes by itself. In R⁴ its state (x0, x1, x2, ζ) solves F = (f, |x|² - 1) = 0, with a derivative that changes
by at most K |Δ| over a displacement Δ; K is known, for F is a polynomial. By the theorem of Newton and Kantorovich, if
|F'⁻¹| K |F'⁻¹ F| is at most 1/2, Newton's method converges to the only solution nearby. A step is taken so short that
this holds, with a margin, for all lengths along it: then the solutions join to a path without a singularity, and
Newton's method ends on it and on no other mode.
"""

from __future__ import annotations

import numpy as np

from spm_pin.kinematics.batches import flat_batch, run_kernel, with_batch_shape
from spm_pin.kinematics.forward_displacement_arguments import check_seed
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

_MIN_BATCH_PER_THREAD = 1 << 10


def follow_seed(geometry: Geometry, lengths: FloatArray, seed: Configuration) -> Configuration:
    """Follow `seed` to the leg lengths (..., 6), each stage by itself; NaN where a stage meets a singularity."""
    from spm_pin.kinematics.kernels.continuation_kernel import follow_stages, stage_states
    from spm_pin.kinematics.kernels.mode_kernels import compose_all

    check_seed(geometry, lengths, seed)
    shape = np.broadcast_shapes(lengths.shape[:-1], seed.shape)
    r = geometry.middle_radius
    legs = [flat_batch(x, shape, 1) / r for x in (seed.leg_lengths, lengths)]
    start, end = (np.concatenate([x[:, :3], x[:, 3:]]) for x in legs)
    b, rotation = flat_batch(seed.middle_joints, shape, 2), flat_batch(seed.rotation, shape, 2)
    translation = flat_batch(seed.translation, shape, 1)
    count = len(b)
    # The lower stages, then the upper ones as they are seen from {m}.
    corners = np.concatenate([b, (b - translation[:, None]) @ rotation])
    hips = np.repeat([geometry.base_radius / r, geometry.platform_radius / r], count)
    stage = ((4,), np.float64), ((), np.bool_)
    seeds, half_turned = run_kernel(stage_states, (corners,), (r,), stage, _MIN_BATCH_PER_THREAD)
    epsilon = np.where(half_turned, -hips, hips)
    states, arrived = run_kernel(follow_stages, (start, end, epsilon, seeds), (), stage, _MIN_BATCH_PER_THREAD)
    states[~arrived] = np.nan
    x0, x1, x2, zeta = states.T
    zero = 0.0 * x0  # NaN where a stage has not arrived
    plain, turned = np.stack([x0, x1, x2, zero, zeta], -1), np.stack([zero, x2, -x1, x0, -zeta], -1)
    stages = np.where(half_turned[:, None], turned, plain)
    results = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64)
    found = run_kernel(compose_all, (stages[:count], stages[count:]), (r,), results, _MIN_BATCH_PER_THREAD)
    return Configuration.from_arrays(geometry, *with_batch_shape(found, shape))
