"""Inverse displacement: the package, a C loop, and all peers of the same task."""

from __future__ import annotations

import numpy as np

from benchmarks.peers import arms, package
from benchmarks.peers.peer import Peer
from benchmarks.peers.peers_by_task import AS_BUILT, INVERSE, OURS
from benchmarks.poses import MACHINE, as_built, leg_space
from benchmarks.report import Facts, Section, microseconds
from benchmarks.sections.preparation import Progress, compare, prepare_peers
from benchmarks.timing import Pace

_FACTS = {
    "inverse/gp3p bare": "poselib.gp3p, bare",
    "inverse/numpy.roots": "numpy.roots",
    "inverse/numpy.roots bare": "numpy.roots, bare",
}


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time all peers on the same poses, and EAIK's arms on theirs, in the same rounds."""
    section = Section("Inverse displacement")
    section.add(
        "Poses of leg lengths drawn uniformly from the limits. Every peer gets the first of the same list, as many a "
        "call as the third column says; those with few are slow. The arms are serial ones in EAIK, on poses of their "
        "own: another problem, and the yardstick of analytic inverse kinematics."
    )
    poses = leg_space(max(peer.items for peer in INVERSE))
    peers = prepare_peers(INVERSE, lambda n: (MACHINE, poses[:n]), pace, progress)
    lengths = Peer(f"{OURS}, lengths only", "`branch_lengths`: six lengths and status", package.lengths_only, 10_000)
    peers.add(prepare_peers([lengths], lambda n: (MACHINE, poses[:n]), pace, progress))
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (1000, 6))
    for arm in arms.ARMS:
        serial = Peer(f"EAIK, {arm}", "all branches of a serial arm, one thread", arms.solve, len(angles))
        peers.add(prepare_peers([serial], lambda n, arm=arm: (arm, arms.poses_of(arm, angles[:n])), pace, progress))
    timings = compare(section, peers, pace, progress)
    for key, name in _FACTS.items():
        if name in timings:
            facts[key] = timings[name].over(timings[OURS])
    if "C loop" in timings:
        facts["inverse/C loop"] = timings[OURS].over(timings["C loop"])
    for size in (1e-4, 1e-3):
        section.add(
            f"A machine as built, with errors of {1e3 * size:g} mm and {1e3 * size:g} mrad. Its two balls at a corner "
            "coincide, for the peer's sake:"
        )
        machine = as_built(size)
        peers = prepare_peers(AS_BUILT, lambda n, machine=machine: (machine, poses[:n]), pace, progress)
        timings = compare(section, peers, pace, progress)
        if size == 1e-4:
            facts["inverse/as built"] = microseconds(timings[OURS].spread)
            facts["inverse/as built, physical"] = microseconds(timings[AS_BUILT[1].name].spread)
    return section
