"""J_f, its inverse, leg forces and determinants of a batch of states, from forces through the balls of six legs.

States are arrays of two batch axes, (outer, inner), of any strides: what all branches of a pose share need not be
copied. Results are packed. A machine is an array (15, 3): the axes and the pivots of the six legs, then the
`upper_ball_weights`. Where these are zero the balls coincide in pairs, and K and J_f have a shorter form that keeps
more digits near an inverse singularity.
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
from spm_pin.mechanism.arguments import FloatArray

STATES = f"{readonly_array(4)}, {readonly_array(4)}, {readonly_array(3)}"
MACHINE = "f8[:,::1]"
# Rows of a tile: b_1 to b_3, R, o; then the load of a state, and its results, the last of which is a flag.
INPUTS = 21
_LOAD, _RESULTS, _FLAG, _ROWS = 21, 27, 63, 64


class Machine(NamedTuple):
    """The legs of a machine as numbers."""

    lower: StageLegs
    upper: StageLegs
    weights: Rows
    is_paired: bool  # the balls coincide in pairs


class StateForces(NamedTuple):
    """The forces of the legs of one state, in {B}."""

    b: Rows
    c: Rows  # balls of the upper legs
    lower: Rows  # directions from pivot to ball
    upper: Rows  # directions from ball to pivot
    a: Rows
    a_m: Rows  # axes of the upper legs
    o: Vector
    is_short: bool  # a leg has no length, hence a direction that is NaN, in a state that exists


@jit_inline
def read_machine(machine: FloatArray) -> Machine:
    """Return the legs of an array (15, 3) as numbers, so that a loop over a tile reads no second array."""
    lower, weights = StageLegs(rows_at(machine, 0), rows_at(machine, 6)), rows_at(machine, 12)
    is_paired = max(largest(weights[0]), largest(weights[1]), largest(weights[2])) == 0.0
    return Machine(lower, StageLegs(rows_at(machine, 3), rows_at(machine, 9)), weights, is_paired)


@jit_inline
def load_states(
    joints: FloatArray, rotation: FloatArray, position: FloatArray, first: int, width: int, tile: FloatArray
) -> None:
    """Fill rows b, R, o of a tile with states of arrays (outer, inner, ...), counted through both axes."""
    inner = joints.shape[1]
    for k in range(width):
        m, n = divmod(first + k, inner)
        for i in range(3):
            for j in range(3):
                tile[3 * i + j, k] = joints[m, n, i, j]
                tile[9 + 3 * i + j, k] = rotation[m, n, i, j]
            tile[18 + i, k] = position[m, n, i]


@jit_inline
def state_forces(tile: FloatArray, k: int, machine: Machine) -> StateForces:
    """Return the forces of the state in place k of a tile."""
    b, o = matrix(tile, 0, k), vector(tile, 18, k)
    c, above = upper_balls(b, machine.weights), carried(machine.upper, matrix(tile, 9, k), o)
    lower, upper = directions(differences(b, machine.lower.pivots)), directions(differences(above.pivots, c))
    total = lower[0][0] + lower[1][0] + lower[2][0] + upper[0][0] + upper[1][0] + upper[2][0]
    is_short = (b[0][0] == b[0][0]) & (total != total)
    return StateForces(b, c, lower, upper, machine.lower.axes, above.axes, o, is_short)


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
def inverse_jacobians(joints, rotation, position, machine, side, singular, matrices, suspect):
    """Write J_f (S, 6, 6), and where K may be singular (S,)."""
    count, tile, legs = len(suspect), np.ones((_ROWS, TILE)), read_machine(machine)
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        load_states(joints, rotation, position, start, width, tile)
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
def platform_jacobians(joints, rotation, position, machine, side, singular, matrices, suspect):
    """Write G (S, 6, 6), and where J_b or J_c may be singular (S,)."""
    count, tile, legs = len(suspect), np.ones((_ROWS, TILE)), read_machine(machine)
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        load_states(joints, rotation, position, start, width, tile)
        for k in range(TILE):
            lower, upper, doubtful = _both_twists(state_forces(tile, k, legs), side, singular)
            tile[_FLAG, k] = 1.0 if doubtful else 0.0
            _put_columns(tile, _RESULTS, k, lower)
            _put_columns(tile, _RESULTS + 3, k, upper)
        _store(tile, start, width, matrices.reshape(count, 36), suspect)


@kernel(f"void({STATES}, {readonly_array(3)}, {MACHINE}, f8, f8, f8[:,::1], u1[::1])")
def stage_forces(joints, rotation, position, wrench, machine, side, singular, forces, suspect):
    """Write the leg forces (S, 6) that hold wrenches (outer, inner, 6), and where J_b or J_c may be singular (S,)."""
    count, tile, legs = len(suspect), np.ones((_ROWS, TILE)), read_machine(machine)
    inner = joints.shape[1]
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        load_states(joints, rotation, position, start, width, tile)
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
def all_determinants(joints, rotation, position, machine, determinants):
    """Write det J_b, det J_c, det K (S, 3)."""
    tile, legs = np.ones((_ROWS, TILE)), read_machine(machine)
    for start in range(0, len(determinants), TILE):
        width = min(TILE, len(determinants) - start)
        load_states(joints, rotation, position, start, width, tile)
        for k in range(TILE):
            three = three_determinants(state_forces(tile, k, legs), legs.is_paired)
            tile[_RESULTS, k], tile[_RESULTS + 1, k], tile[_RESULTS + 2, k] = three
        for k in range(width):
            for i in range(3):
                determinants[start + k, i] = tile[_RESULTS + i, k]
