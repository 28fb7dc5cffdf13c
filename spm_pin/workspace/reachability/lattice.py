"""A grid around the reachable set: which of its nodes are reachable, and where its edges leave the set."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_number
from spm_pin.workspace.reachability.edge_intersection import crossing
from spm_pin.workspace.reachability.leg_box import LegBox
from spm_pin.workspace.reachability.state_search import Progress, search_states

__all__ = ["classified", "crossings", "lattice"]

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

_STRIDES = (8, 4, 2, 1)
_PORTION = 4096
_MOST_NODES = 5_000_000


def lattice(box: LegBox, spacing: float) -> tuple[FloatArray, tuple[int, int, int]]:
    """Return the first node [m] and how many there are along each axis, wide enough to begin and to end outside."""
    spacing = real_number(spacing, "spacing", "a positive length in metres", above=0.0)
    low, high = box.extent
    pad = 0.02 * (high - low) + 1.5 * spacing
    with np.errstate(over="ignore"):
        numbers = np.ceil((high - low + 2.0 * pad) / spacing) + 1.0
    if numbers.prod() > _MOST_NODES:
        expected = f"a spacing in metres that makes at most {_MOST_NODES:.0e} nodes"
        raise ArgumentError("spacing", expected, f"{spacing:g}, which makes {numbers.prod():.0e}", "In millimetres?")
    nx, ny, nz = (int(n) for n in numbers)
    return 0.5 * (low + high - (numbers - 1.0) * spacing), (nx, ny, nz)


def classified(
    box: LegBox, origin: FloatArray, shape: tuple[int, int, int], spacing: float, progress: Progress | None
) -> tuple[BoolArray, FloatArray]:
    """Return which nodes are reachable, shape `shape`, and states there, shape `shape` + (2, 3).

    The farther away, the coarser the grid that is searched.
    """
    index = np.indices(shape).reshape(3, -1).T
    nodes = origin + spacing * index
    inside, known = np.zeros(len(nodes), dtype=bool), np.zeros(len(nodes), dtype=bool)
    states = np.full((len(nodes), 2, 3), np.nan)

    def search(what: str, chosen: IntArray, starts: FloatArray | None) -> FloatArray:
        found = search_states(box, nodes[chosen], starts, what=what, progress=progress)
        states[chosen] = found.coordinates
        known[chosen] = True
        inside[chosen] |= found.reached
        return found.distance

    for stride in _STRIDES:
        chosen = np.flatnonzero(~known & (index % stride == 0).all(axis=-1))
        distance = search(f"reachable nodes, every {stride * spacing:g} m", chosen, None) - box.margin
        # Nothing within that distance is reachable.
        remote = distance > spacing
        if remote.any() and not known.all():
            unknown = np.flatnonzero(~known)
            around = KDTree(nodes[unknown]).query_ball_point(nodes[chosen[remote]], (1.0 - 1e-9) * distance[remote])
            for members in around:
                known[unknown[members]] = True
    # What a search has overlooked beside a reachable node is found from there.
    steps = [way * stride for stride in (1, shape[2], shape[1] * shape[2]) for way in (1, -1)]
    fresh = np.flatnonzero(inside)
    while len(fresh):
        before = inside.copy()
        for step in steps:
            # No reachable node is at the end of a row: around the set there is room.
            beside = fresh[~inside[fresh + step]] + step
            search("nodes beside reachable ones", beside, states[beside - step])
        fresh = np.flatnonzero(inside & ~before)
    return inside.reshape(shape), states.reshape(*shape, 2, 3)


def crossings(
    box: LegBox,
    origin: FloatArray,
    spacing: float,
    corners: FloatArray,
    inside: BoolArray,
    states: FloatArray,
    progress: Progress | None,
) -> tuple[FloatArray, FloatArray]:
    """Move vertices of marching cubes (V, 3), in units of the grid, to the boundary; return them and leg lengths.

    `inside` and `states` are those of `classified`.
    """
    first, last = np.floor(corners).astype(int), np.ceil(corners).astype(int)
    a, b = inside[tuple(first.T)], inside[tuple(last.T)]
    nodes = np.where(a[:, None], first, last)
    inner, outer = nodes.astype(np.float64), np.where(a[:, None], last, first).astype(np.float64)
    known = states[tuple(nodes.T)]
    # A vertex in the middle of a cube, which some ambiguous ones have, is on no edge.
    for k in np.flatnonzero((a == b) | ((last - first).sum(axis=-1) != 1)):
        cube = np.floor(corners[k]).astype(int) + np.indices((2, 2, 2)).reshape(3, -1).T
        reached = inside[tuple(cube.T)]
        centre = search_states(box, origin + spacing * corners[k : k + 1])
        if centre.reached[0]:
            inner[k], outer[k], known[k] = corners[k], cube[~reached][0], centre.coordinates[0]
        else:
            inner[k], outer[k], known[k] = cube[reached][0], corners[k], states[tuple(cube[reached][0])]
    parts = []
    for begin in range(0, len(corners), _PORTION):
        if progress is not None:
            progress("vertices", begin, len(corners))
        part = slice(begin, begin + _PORTION)
        parts.append(crossing(box, origin + spacing * inner[part], origin + spacing * outer[part], known[part]))
    if progress is not None:
        progress("vertices", len(corners), len(corners))
    vertices, lengths = zip(*parts, strict=True)
    return np.concatenate(vertices), np.concatenate(lengths)
