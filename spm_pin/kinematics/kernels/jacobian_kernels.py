"""J_f, its inverse, leg forces and determinants of a batch of states, from forces through the balls of six legs.

States are arrays of two batch axes, (outer, inner), of any strides: what all branches of a pose share need not be
copied, nor are the centres of RPS legs' circles, the pivots. Results are packed. A machine is an array (9, 3): the axes
of the six legs, then the `upper_ball_weights`. Where these are zero the balls coincide in pairs, and K and J_f have a
shorter form that keeps more digits near an inverse singularity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spm_pin.formulas.leg_planes import StageLegs, carried, upper_balls
from spm_pin.formulas.vectors import Rows, Vector, differences, directions, largest
from spm_pin.formulas.wrenches import (
    Matrix,
    determinant,
    drawn_inverse_jacobian,
    inverse_jacobian,
    may_be_singular,
    may_structure_be_singular,
    stage_twists,
    structure_determinant,
)
from spm_pin.formulas.wrenches import stage_forces as forces_of_stage
from spm_pin.kinematics.kernels.compilation import (
    TILE,
    ByteArray,
    jit_inline,
    kernel,
    matrix,
    readonly_array,
    rows_at,
    vector,
)
from spm_pin.support.arguments import FloatArray

STATES = f"{readonly_array(4)}, {readonly_array(4)}, {readonly_array(3)}, {readonly_array(4)}"
MACHINE = "f8[:,::1]"
# Rows of a tile: b_1 to b_3, R, o, and the centres of the balls' circles; then the load of a state, and its results,
# the last of which is a flag.
INPUTS = 39
_LOAD, _RESULTS, _FLAG, _ROWS = 39, 45, 81, 82


class LegNumbers(NamedTuple):
    """The legs of a machine as numbers."""

    lower_axes: Rows
    upper_axes: Rows
    weights: Rows
    is_paired: bool  # the balls coincide in pairs


class StateForces(NamedTuple):
    """The forces of the legs of one state, in {B}."""

    b: Rows
    c: Rows  # balls of the upper legs
    lower: Rows  # directions from the circle's centre to the ball
    upper: Rows  # directions from the ball to the circle's centre
    a: Rows
    a_m: Rows  # axes of the upper legs
    o: Vector
    is_short: bool  # a leg has no length, hence a direction that is NaN, in a state that exists


@jit_inline
def read_machine(machine: FloatArray) -> LegNumbers:
    """Return the legs of an array (9, 3) as numbers, so that a loop over a tile reads no second array."""
    weights = rows_at(machine, 6)
    is_paired = max(largest(weights[0]), largest(weights[1]), largest(weights[2])) == 0.0
    return LegNumbers(rows_at(machine, 0), rows_at(machine, 3), weights, is_paired)


@jit_inline
def load_states(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    centres: FloatArray,
    first: int,
    width: int,
    tile: FloatArray,
) -> None:
    """Fill the first rows of a tile with states of arrays (outer, inner, ...), counted through both axes."""
    inner = joints.shape[1]
    for k in range(width):
        m, n = divmod(first + k, inner)
        for i in range(3):
            for j in range(3):
                tile[3 * i + j, k] = joints[m, n, i, j]
                tile[9 + 3 * i + j, k] = rotation[m, n, i, j]
            tile[18 + i, k] = position[m, n, i]
    # Those of RPS legs are the same in all states, and stay in the tile.
    if first == 0 or centres.strides[0] != 0 or centres.strides[1] != 0:
        for k in range(width):
            m, n = divmod(first + k, inner)
            for leg in range(6):
                for j in range(3):
                    tile[21 + 3 * leg + j, k] = centres[m, n, leg, j]


@jit_inline
def state_forces(tile: FloatArray, k: int, machine: LegNumbers) -> StateForces:
    """Return the forces of the state in place k of a tile."""
    b, o = matrix(tile, 0, k), vector(tile, 18, k)
    c = upper_balls(b, machine.weights)
    above = carried(StageLegs(machine.upper_axes, matrix(tile, 30, k)), matrix(tile, 9, k), o)
    lower, upper = directions(differences(b, matrix(tile, 21, k))), directions(differences(above.pivots, c))
    total = lower[0][0] + lower[1][0] + lower[2][0] + upper[0][0] + upper[1][0] + upper[2][0]
    is_short = (b[0][0] == b[0][0]) & (total != total)
    return StateForces(b, c, lower, upper, machine.lower_axes, above.axes, o, is_short)


@jit_inline
def _put_inverse_jacobian(tile: FloatArray, k: int, rows: tuple[Matrix, Matrix], is_suspect: bool) -> None:
    lower, upper = rows
    tile[_FLAG, k] = 1.0 if is_suspect else 0.0
    for i in range(3):
        for j in range(3):
            first = _RESULTS + 6 * i + j
            tile[first, k], tile[first + 3, k] = lower[i][0][j], lower[i][1][j]
            tile[first + 18, k], tile[first + 21, k] = upper[i][0][j], upper[i][1][j]


@jit_inline
def _put_columns(tile: FloatArray, first: int, k: int, columns: Matrix) -> None:
    for i in range(3):
        for j in range(3):
            tile[first + 6 * j + i, k], tile[first + 6 * (j + 3) + i, k] = columns[i][0][j], columns[i][1][j]


@jit_inline
def _store(tile: FloatArray, start: int, width: int, results: FloatArray, suspect: ByteArray) -> None:
    for k in range(width):
        suspect[start + k] = np.uint8(tile[_FLAG, k])
        for i in range(results.shape[1]):
            results[start + k, i] = tile[_RESULTS + i, k]


@kernel(f"void({STATES}, {MACHINE}, f8, f8, f8[:,:,::1], u1[::1])")
def inverse_jacobians(joints, rotation, position, centres, machine, side, singular, matrices, suspect):
    """Write J_f (S, 6, 6), and where K may be singular (S,)."""
    count, tile, legs = len(suspect), np.ones((_ROWS, TILE)), read_machine(machine)
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        load_states(joints, rotation, position, centres, start, width, tile)
        # Two loops, each of which goes over several states at a time.
        if legs.is_paired:
            for k in range(TILE):
                s = state_forces(tile, k, legs)
                suspected = may_be_singular(s.b, s.a_m, s.a, side, singular)
                rows = drawn_inverse_jacobian(s.b, s.lower, s.upper, s.a, s.a_m, s.o)
                _put_inverse_jacobian(tile, k, rows, s.is_short | suspected)
        else:
            for k in range(TILE):
                s = state_forces(tile, k, legs)
                suspected = may_structure_be_singular(s.b, s.c, s.a, s.a_m, side, singular)
                rows = inverse_jacobian(s.b, s.c, s.lower, s.upper, s.a, s.a_m, s.o)
                _put_inverse_jacobian(tile, k, rows, s.is_short | suspected)
        _store(tile, start, width, matrices.reshape(count, 36), suspect)


@jit_inline
def _both_twists(s: StateForces, side: float, singular: float) -> tuple[Matrix, Matrix, bool]:
    """Return the twists of unit rates of the lower and of the upper legs, and whether J_b or J_c may be singular."""
    doubtful = s.is_short | may_be_singular(s.b, s.lower, s.a, side, singular)
    doubtful = doubtful | may_be_singular(s.c, s.upper, s.a_m, side, singular)
    return stage_twists(s.b, s.lower, s.a, s.o), stage_twists(s.c, s.upper, s.a_m, s.o), doubtful


@kernel(f"void({STATES}, {MACHINE}, f8, f8, f8[:,:,::1], u1[::1])")
def platform_jacobians(joints, rotation, position, centres, machine, side, singular, matrices, suspect):
    """Write G (S, 6, 6), and where J_b or J_c may be singular (S,)."""
    count, tile, legs = len(suspect), np.ones((_ROWS, TILE)), read_machine(machine)
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        load_states(joints, rotation, position, centres, start, width, tile)
        for k in range(TILE):
            lower, upper, doubtful = _both_twists(state_forces(tile, k, legs), side, singular)
            tile[_FLAG, k] = 1.0 if doubtful else 0.0
            _put_columns(tile, _RESULTS, k, lower)
            _put_columns(tile, _RESULTS + 3, k, upper)
        _store(tile, start, width, matrices.reshape(count, 36), suspect)


@kernel(f"void({STATES}, {readonly_array(3)}, {MACHINE}, f8, f8, f8[:,::1], u1[::1])")
def stage_forces(joints, rotation, position, centres, wrench, machine, side, singular, forces, suspect):
    """Write the leg forces (S, 6) that hold wrenches (outer, inner, 6), and where J_b or J_c may be singular (S,)."""
    count, tile, legs = len(suspect), np.ones((_ROWS, TILE)), read_machine(machine)
    inner = joints.shape[1]
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        load_states(joints, rotation, position, centres, start, width, tile)
        for k in range(width):
            m, n = divmod(start + k, inner)
            for i in range(6):
                tile[_LOAD + i, k] = wrench[m, n, i]
        for k in range(TILE):
            lower, upper, doubtful = _both_twists(state_forces(tile, k, legs), side, singular)
            tile[_FLAG, k] = 1.0 if doubtful else 0.0
            load = vector(tile, _LOAD, k), vector(tile, _LOAD + 3, k)
            below, above = forces_of_stage(lower, load), forces_of_stage(upper, load)
            for i in range(3):
                tile[_RESULTS + i, k], tile[_RESULTS + 3 + i, k] = below[i], above[i]
        _store(tile, start, width, forces, suspect)


@jit_inline
def three_determinants(s: StateForces, is_paired: bool) -> Vector:
    """Return det J_b, det J_c, det K."""
    paired, mixed = determinant(s.b, s.a, s.a_m), structure_determinant(s.b, s.c, s.a, s.a_m)
    return determinant(s.b, s.lower, s.a), determinant(s.c, s.upper, s.a_m), (paired if is_paired else mixed)


@kernel(f"void({STATES}, {MACHINE}, f8[:,::1])")
def all_determinants(joints, rotation, position, centres, machine, determinants):
    """Write det J_b, det J_c, det K (S, 3)."""
    tile, legs = np.ones((_ROWS, TILE)), read_machine(machine)
    for start in range(0, len(determinants), TILE):
        width = min(TILE, len(determinants) - start)
        load_states(joints, rotation, position, centres, start, width, tile)
        for k in range(TILE):
            three = three_determinants(state_forces(tile, k, legs), legs.is_paired)
            tile[_RESULTS, k], tile[_RESULTS + 1, k], tile[_RESULTS + 2, k] = three
        for k in range(width):
            for i in range(3):
                determinants[start + k, i] = tile[_RESULTS + i, k]
