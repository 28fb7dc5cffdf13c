"""Polytopes of wrenches beside pycapacity, and many designs in one call."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import spm_pin as spm
from benchmarks.poses import MACHINE
from benchmarks.report import Facts, Section, count, spread_of_seconds, table, times
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, Spread, TimedCall, time_in_turns

LIMIT = 1000.0
_MANY, _FEW, _DESIGNS, _STATES = 10_000, 20, 16, 10_000
METRICS = ("conditioning", "payload", "least_stiffness", "inverse_distance")


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time facets with inscribed balls, and vertices, by both; then a table of designs."""
    section = Section("What the platform can push")
    section.add(
        "Wrenches that legs of 1 kN hold, of states whose J_f pycapacity is given. It answers one state at a time; "
        "facets are those of its `hyper_plane_shift_method`, vertices those of `force_polytope`."
    )
    states = spm.forward_physical(MACHINE, np.random.default_rng(0).uniform(1.15, 1.45, (_MANY, 6)))
    jacobians, inverses = (f(states[:_FEW]) for f in (spm.inverse_jacobian, spm.kinematics.platform_jacobian))

    def facets() -> None:
        held = spm.capability.wrench_polytope(states, LIMIT)
        _ = held.half_spaces, held.ball()

    def by_peer(function: Callable[[np.ndarray], object], matrices: np.ndarray) -> Callable[[], None]:
        return lambda: [function(matrix) for matrix in matrices] and None

    pairs = {
        "facets, and the largest ball of forces": (facets, by_peer(facets_by_pycapacity, jacobians)),
        "vertices": (
            lambda: spm.capability.wrench_polytope(states, LIMIT).vertices,
            by_peer(vertices_by_pycapacity, inverses),
        ),
    }
    rows = []
    with spm.threads(1):
        for name, (ours, peer) in pairs.items():
            timed = [TimedCall("spm_pin", ours, _MANY), TimedCall("pycapacity", peer, _FEW)]
            timings = time_in_turns(timed, pace, progress)
            ratio = timings["pycapacity"].over(timings["spm_pin"])
            for call in timed:
                shown = times(ratio) if call.name == "pycapacity" else ["1", ""]
                rows.append([name, call.name, count(call.items), *spread_of_seconds(timings[call.name].spread), *shown])
            if name != "vertices":
                own = timings["spm_pin"].spread
                facts["capability/facets"] = Spread(*(1e6 * x for x in (own.median, own.low, own.high)))
                facts["capability/pycapacity"] = ratio
        section.add(table(["", "", "states a call", "per state", "quartiles", "× spm_pin", "quartiles"], rows))
        _designs(section, pace, progress, facts)
    return section


def facets_by_pycapacity(jacobian: np.ndarray) -> float:
    """Return the radius of the largest ball of forces from pycapacity's facets of the wrenches J_fᵀ f."""
    from pycapacity.algorithms import hyper_plane_shift_method

    normals, ends = hyper_plane_shift_method(jacobian.T, np.full(6, -LIMIT), np.full(6, LIMIT))
    return float((ends.ravel() / np.linalg.norm(normals[:, :3], axis=-1)).min())


def vertices_by_pycapacity(inverse: np.ndarray) -> np.ndarray:
    """Return the vertices (6, 64) by pycapacity."""
    from pycapacity.robot import force_polytope

    return np.asarray(force_polytope(inverse, np.full(6, LIMIT), np.full(6, -LIMIT)).vertices)


def _designs(section: Section, pace: Pace, progress: Progress, facts: Facts) -> None:
    """Time a table of designs, whose peer is NumPy's way to the same four metrics of one of them."""
    rng = np.random.default_rng(0)
    sizes = rng.uniform([0.6, 0.3, 0.7], [0.8, 0.45, 0.95], (_DESIGNS, 3))
    designs = [spm.Manipulator(*map(float, row), spm.LegLimits(1.1, 1.45)) for row in sizes]
    readings = rng.uniform(1.1, 1.45, (_STATES, 6))

    def by_numpy() -> None:
        for design in designs[:2]:
            states = spm.forward_physical(design, readings)
            g = np.linalg.inv(spm.inverse_jacobian(states))
            np.linalg.svd(g * np.repeat([1.0, design.platform_radius], 3)[:, None], compute_uv=False)
            np.linalg.norm(g[:, :3], axis=-2).max(axis=-1)
            np.linalg.eigvalsh(g[:, :3] @ g[:, :3].swapaxes(-1, -2))
            spm.singularities(states)

    def evaluate(boxes: int) -> Callable[[], object]:
        return lambda: spm.design.evaluate_designs(designs, METRICS, states=_STATES, boxes=boxes)

    calls = [
        TimedCall("spm_pin, `evaluate_designs`", evaluate(0), _DESIGNS),
        TimedCall("the same, with the certificate", evaluate(30_000), _DESIGNS),
        TimedCall("J_f and `numpy.linalg`, stacked", by_numpy, 2),
    ]
    timings = time_in_turns(calls, Pace(3, pace.turn, pace.quick), progress)
    first = timings[calls[0].name]
    rows = []
    for call in calls:
        timing = timings[call.name]
        ratio = ["1", ""] if timing is first else times(timing.over(first))
        rows.append([call.name, count(call.items), *spread_of_seconds(timing.spread), *ratio])
    section.add(f"**Designs of {count(_STATES)} states: {', '.join(METRICS)}**")
    section.add(table(["", "designs a call", "per design", "quartiles", "× the first", "quartiles"], rows))
    facts["capability/design"] = Spread(*(1e3 * x for x in _numbers(timings[calls[1].name].spread)))


def _numbers(spread: Spread) -> tuple[float, float, float]:
    return spread.median, spread.low, spread.high
