"""Completeness: branches found of the certified ones, and reported branches that do not exist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.certified import real_coordinates
from benchmarks.peers.lines import coordinates
from benchmarks.peers.peer import FloatArray, Peer, Unavailable
from benchmarks.peers.peers_by_task import INVERSE, OURS
from benchmarks.poses import KINDS, MACHINE, mixture
from benchmarks.report import Facts, Section, table, three_digits
from benchmarks.sections.preparation import Progress, failure
from benchmarks.timing import Pace, Spread

NEAR = 1e-4
"""Largest distance in units of d at which a result is matched with a certified branch."""


@dataclass
class Tally:
    """Branches certified, found, and reported though there is none; and errors of those found [m]."""

    certified: int
    found: int
    spurious: int
    errors: FloatArray


def tally(certified: list[FloatArray], answers: list[FloatArray], side: float) -> Tally:
    """Match answers with certified branches, both as ascending coordinates of b_2 on its line, pose by pose."""
    found = spurious = 0
    errors: list[float] = []
    for truth, answer in zip(certified, answers, strict=True):
        distance = np.abs(np.subtract.outer(truth, answer))
        pairs = distance[linear_sum_assignment(distance)]
        good = pairs[pairs <= NEAR * side]
        found += len(good)
        spurious += len(answer) - len(good)
        errors.extend(good)
    return Tally(sum(map(len, certified)), found, spurious, np.array(errors))


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Count the branches that every peer finds in every kind of pose."""
    section = Section("Completeness")
    section.add(
        "Branches found of those that ball arithmetic (python-flint) proves to be real; after a plus sign, what was "
        "reported besides. Errors are those of b_2 along its line, against the certified value, over all kinds: median "
        "and largest. Answers and certified branches are paired one to one, within 10⁻⁴ d. In nearly level poses the "
        "coordinate itself is defined no better than rounding over the tilt. Slower peers get fewer poses."
    )
    most = 100 if pace.quick else 2000
    certified: dict[str, list[FloatArray]] = {}
    poses: dict[str, RigidTransform] = {}
    for kind in KINDS:
        progress(f"certifying poses: {kind}")
        made = mixture(kind, most)
        try:
            proved = [
                real_coordinates(q, o, MACHINE.middle_side)
                for q, o in zip(made.rotation.as_quat(), made.translation, strict=True)
            ]
        except Unavailable as reason:
            section.add(f"*Not measured: {reason}.*")
            return section
        sure = [k for k, values in enumerate(proved) if values is not None]
        poses[kind] = made[np.array(sure)]
        certified[kind] = [values for values in proved if values is not None]
    rows = []
    for peer in INVERSE:
        if peer.name == "python-flint" or peer.name.endswith(", new arrays"):
            continue
        progress(f"counting branches: {peer.name}")
        n = _allowance(peer, most)
        cells: list[str] = []
        errors = []
        try:
            for kind in KINDS:
                result = _tally_of(peer, poses[kind][:n], certified[kind][:n])
                cells.append(f"{result.found} of {result.certified}" + f" + {result.spurious}" * bool(result.spurious))
                errors.append(result.errors)
                if peer.name == OURS:
                    facts["completeness/missed"] = _plus(facts, "completeness/missed", result.certified - result.found)
                    facts["completeness/spurious"] = _plus(facts, "completeness/spurious", result.spurious)
        except Exception as reason:
            if peer.name == OURS:
                raise
            text = str(reason) if isinstance(reason, Unavailable) else failure(reason)
            rows.append([peer.name, f"*missing: {text}*", *[""] * (len(KINDS) + 1)])
            continue
        joined = np.concatenate(errors)
        worst = f"{np.median(joined):.0e} / {joined.max():.0e} m" if len(joined) else "–"
        rows.append([peer.name, str(min(n, *map(len, poses.values()))), *cells, worst])
    section.add(table(["", "poses of each kind", *KINDS, "error"], rows))
    shares = ", ".join(f"{len(certified[kind])} {kind} ({_mean(certified[kind])} branches a pose)" for kind in KINDS)
    section.add(f"Certified poses: {shares}.")
    return section


def _allowance(peer: Peer, most: int) -> int:
    """Return the number of poses of each kind for a peer."""
    return most if peer.items >= 1000 else most // 10 if peer.items >= 20 else most // 100


def _tally_of(peer: Peer, poses: RigidTransform, certified: list[FloatArray]) -> Tally:
    prepared = peer.prepare((MACHINE, poses))
    answers = coordinates(MACHINE, poses, prepared.read(prepared.call()))
    return tally(certified, answers, MACHINE.middle_side)


def _plus(facts: Facts, key: str, more: int) -> Spread:
    total = (facts[key].median if key in facts else 0.0) + more
    return Spread(total, total, total)


def _mean(certified: list[FloatArray]) -> str:
    return three_digits(float(np.mean([len(values) for values in certified])))
