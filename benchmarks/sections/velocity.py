"""J_f and leg forces of real branches: the package and its peers."""

from __future__ import annotations

import numpy as np

import spm_pin as spm
from benchmarks.peers.peers_by_task import FORCES, JACOBIAN, OURS
from benchmarks.poses import MACHINE, leg_space
from benchmarks.report import Facts, Section
from benchmarks.sections.preparation import Progress, compare, prepare_peers
from benchmarks.timing import Pace


def states(count: int, seed: int = 0) -> spm.Configuration:
    """Return real branches (count,) of poses in leg space."""
    # A pose has four branches at least.
    solutions = spm.inverse_displacement(MACHINE, leg_space(-(-count // 4) + 1, seed))
    real = solutions.exists
    return spm.Configuration.from_arrays(
        MACHINE,
        np.ascontiguousarray(np.broadcast_to(solutions.rotation, (*real.shape, 3, 3))[real][:count]),
        np.ascontiguousarray(np.broadcast_to(solutions.translation, (*real.shape, 3))[real][:count]),
        np.ascontiguousarray(solutions.middle_joints[real][:count]),
    )


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time J_f of the same states by all peers, then the leg forces."""
    section = Section("J_f and leg forces")
    section.add("Per real branch of the same poses; nothing derived from a state is kept between calls.")
    every = states(max(peer.items for peer in JACOBIAN))
    jacobian = compare(
        section, prepare_peers(JACOBIAN, lambda n: every[:n], pace, progress), pace, progress, item="state"
    )
    wrenches = np.random.default_rng(1).uniform(-1.0, 1.0, (len(every), 6))
    forces = compare(
        section,
        prepare_peers(FORCES, lambda n: (every[:n], wrenches[:n]), pace, progress),
        pace,
        progress,
        item="state",
    )
    for key, timings in (("velocity/J_f", jacobian), ("velocity/forces", forces)):
        for name, suffix in (("NumPy 9 × 9", ""), ("NumPy 9 × 9, bare", " bare")):
            if name in timings:
                facts[key + suffix] = timings[name].over(timings[OURS])
    return section
