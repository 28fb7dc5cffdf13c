"""Readings with their physical states, for every runner of Newton's method on a stage: drawn and as built.

The states are composed from known placements of both stages, or brought to a machine as built with 30 digits by mpmath,
on the coordinates of the balls. No solver of the package takes part.
"""

from __future__ import annotations

from typing import NamedTuple

import mpmath
import numpy as np
import numpy.typing as npt
from problems import MANIPULATORS, PAPER, Array, as_built, in_leg_space

import spm_pin as spm
from spm_pin.machine.legs import triangle_frames

ABSENT = np.array([[0.6, 0.6, 2.0, 1.3, 1.3, 1.3], [1.3, 1.3, 1.3, 0.7, 1.9, 1.2], [0.61, 1.9, 1.9, 2.0, 0.7, 0.7]])
"""Lengths [m] with which no stage like the paper's closes in its home's aspect."""


class Case(NamedTuple):
    """A machine with readings (N, 6) [m]; R, o and the b_i of their states, NaN of those that do not exist."""

    machine: spm.Manipulator
    readings: Array
    rotation: Array
    translation: Array
    middle_joints: Array


def cases(count: int = 4) -> dict[str, Case]:
    """Return a few readings of each of some machines, of which the last of the paper's have no state."""
    table = {}
    for name, size in (("paper", 0.0), ("paper", 1e-3), ("paper", 1e-2), ("equal triangles", 1e-3)):
        drawn = MANIPULATORS[name]
        legs = np.random.default_rng(7).uniform(1.1, 1.5, (count, 6)) * drawn.middle_side / PAPER.middle_side
        state = in_leg_space(drawn, count, 0, legs=legs).configuration
        machine, readings = (as_built(drawn, size), legs) if size else (drawn, legs)
        readings = readings + machine.legs.offsets
        arrays = state.rotation, state.translation, state.middle_joints
        if size:
            arrays = tuple(
                map(np.array, zip(*(_built(machine, *x) for x in zip(legs, state, strict=True)), strict=True))
            )
        if drawn is PAPER:
            nowhere = (np.full((len(ABSENT), *x.shape[1:]), np.nan) for x in arrays)
            arrays = tuple(np.concatenate(pair) for pair in zip(arrays, nowhere, strict=True))
            readings = np.concatenate([readings, ABSENT + machine.legs.offsets])
        table[f"{name}, {size:g}"] = Case(machine, readings, *arrays)
    return table


def _built(machine: spm.Manipulator, lengths: Array, near: spm.Configuration) -> tuple[Array, Array, Array]:
    """Return R, o and the b_i of a machine as built that has the lengths, beside a state of the drawn one."""
    back = (near.middle_joints - near.translation) @ near.rotation
    placed = []
    for first, start in ((0, near.middle_joints), (3, back)):
        legs = slice(first, first + 3)
        own = machine.legs.balls[legs]
        b = _balls(machine.legs.axes[legs], machine.legs.pivots[legs], lengths[legs], own, start)
        turn = triangle_frames(b) @ triangle_frames(own).T
        placed.append((turn, b.mean(axis=0) - turn @ own.mean(axis=0), b))
    (turn, place, b), (turn_m, place_m, _) = placed
    rotation = turn @ turn_m.T
    return rotation, place - rotation @ place_m, b


def _balls(axes: Array, pivots: Array, lengths: Array, own: Array, start: Array) -> npt.NDArray[np.float64]:
    """Return balls in three planes, at distances from the pivots and as far from each other as in their own frame."""

    def errors(*x: mpmath.mpf) -> list[mpmath.mpf]:
        b = [mpmath.matrix(x[3 * i : 3 * i + 3]) for i in range(3)]
        values = []
        for i in range(3):
            arm, side = b[i] - mpmath.matrix(pivots[i]), b[i] - b[(i + 1) % 3]
            gap = mpmath.matrix(own[i]) - mpmath.matrix(own[(i + 1) % 3])
            values += [(mpmath.matrix(axes[i]).T * arm)[0], (arm.T * arm)[0] - mpmath.mpf(lengths[i]) ** 2]
            values += [(side.T * side)[0] - (gap.T * gap)[0]]
        return values

    with mpmath.workdps(30):
        return np.array(mpmath.findroot(errors, start.ravel().tolist()).tolist(), dtype=float).reshape(3, 3)
