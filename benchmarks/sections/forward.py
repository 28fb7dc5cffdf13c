"""Forward displacement: the physical mode, and all assembly modes."""

from __future__ import annotations

import numpy as np

from benchmarks.peers import c_loop
from benchmarks.peers.assembly_modes import certified, multistart
from benchmarks.peers.package import modes
from benchmarks.peers.peer import Peer, Unavailable
from benchmarks.peers.peers_by_task import MODES, OURS, PHYSICAL
from benchmarks.poses import MACHINE, leg_space
from benchmarks.report import Facts, Section, table, three_digits
from benchmarks.sections.preparation import Progress, compare, prepare_peers
from benchmarks.timing import Pace

_UNIT = "C loop, inverse"


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time the physical mode, then all modes, and count the modes that a multi-start finds."""
    section = Section("Forward displacement")
    section.add(
        "Leg lengths drawn uniformly from the limits. The physical mode first; one inverse solve of the C loop is in "
        "the same rounds, as the unit."
    )
    limits = MACHINE.limits
    assert limits is not None
    size = max(peer.items for peer in PHYSICAL)
    lengths = np.random.default_rng(1).uniform(limits.minimum, limits.maximum, (size, 6))
    peers = prepare_peers(PHYSICAL, lambda n: (MACHINE, lengths[:n]), pace, progress)
    poses = leg_space(size)
    unit = Peer(_UNIT, "four quadratics in plain C, one pose", c_loop.answered, size)
    peers.add(prepare_peers([unit], lambda n: (MACHINE, poses[:n]), pace, progress))
    timings = compare(section, peers, pace, progress, item="set")
    if _UNIT in timings:
        facts["forward/physical"] = timings[OURS].over(timings[_UNIT])

    section.add("All assembly modes:")
    peers = prepare_peers(MODES, lambda n: (MACHINE, lengths[:n]), pace, progress)
    timings = compare(section, peers, pace, progress, item="set")
    if "SciPy multi-start" in timings:
        facts["forward/modes"] = timings["SciPy multi-start"].over(timings[OURS])
    section.add(_found(lengths[: 5 if pace.quick else 20], progress))
    return section


def _found(lengths: np.ndarray, progress: Progress) -> str:
    """Return a table: of the certified assembly modes, the share that a multi-start finds."""
    progress("counting assembly modes")
    problem = MACHINE, lengths
    ours = modes(problem)
    search = multistart(problem)
    answers = search.call()
    try:
        proof = certified(problem)
        proved = proof.read(proof.call())
    except Unavailable as reason:
        return f"Not certified: {reason}."
    sure = proved >= 0
    total = int(proved[sure].sum())
    rows = [
        [OURS, f"{int(ours.read(ours.call())[sure].sum())} of {total}", ""],
        [
            "SciPy multi-start",
            f"{int(search.read(answers)[sure].sum())} of {total}",
            three_digits(float(np.mean([answer.starts for answer in answers]))),
        ],
    ]
    return table([f"{int(sure.sum())} sets of leg lengths", "modes of those certified", "starts a set"], rows)
