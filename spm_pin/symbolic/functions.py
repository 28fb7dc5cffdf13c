"""The closed forms as CasADi functions, for optimisation and optimal control, with derivatives of any order.

The argument `geometry` of all is the machine that is built in, `"symbolic"`, or None, see `inverse_physical`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import casadi as ca
import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.kernels import (
    branch_kernels,
    branch_tiles,
    jacobian_kernels,
    mode_kernels,
    stage_equations,
    wrench_vectors,
)
from spm_pin.kinematics.kernels.branch_tiles import DISCRIMINANT, PHYSICAL, STRAIGHT
from spm_pin.kinematics.kernels.vectors import dot, minus
from spm_pin.mechanism import BRANCHES, Geometry
from spm_pin.mechanism.arguments import LARGEST, SMALLEST, choice, type_and_value
from spm_pin.mechanism.pose import ORTHONORMALITY_TOLERANCE
from spm_pin.symbolic.tracing import table, traced

Dimensions = Geometry | Literal["symbolic"] | None
"""A machine; `"symbolic"`, for one more input `dimensions` (3,) = E, C, d [m]; or None, for the paper's machine."""

_NEWTON_STEPS = 14
_LONGEST_STEP = 0.3


class _Machine:
    """Dimensions as numbers or symbols, and the inputs that functions of them have."""

    def __init__(self, geometry: Dimensions) -> None:
        if isinstance(geometry, Geometry) and not geometry.is_nominal:
            cause = "The roots of a machine as built have no closed form"
            raise ArgumentError("geometry", "a Geometry", "a machine as built", cause)
        self.limits = None
        self.inputs: list[ca.SX] = []
        self.base: Any
        self.platform: Any
        self.side: Any
        if isinstance(geometry, str) and geometry == "symbolic":
            self.inputs = [ca.SX.sym("dimensions", 3)]
            self.base, self.platform, self.side = ca.vertsplit(self.inputs[0])
        elif geometry is None or isinstance(geometry, Geometry):
            machine = geometry or Geometry.paper()
            self.base, self.platform, self.side = machine.dimensions
            self.limits = machine.limits
        else:
            raise ArgumentError("geometry", 'a Geometry, "symbolic" or None', type_and_value(geometry))
        self.r = self.side / np.sqrt(3.0)
        self.sizes = self.r, self.base, self.platform
        self.valid: Any = ca.SX(1)
        for size in () if not self.inputs else (self.base, self.platform, self.side):
            self.valid = ca.logic_and(self.valid, ca.logic_and(size >= SMALLEST, size <= LARGEST))

    def takes(self, rotation: ca.SX, position: ca.SX) -> Any:
        """Return 1 where the package accepts a pose and the dimensions, else 0."""
        _, matrix, place = _state(rotation, rotation, position)
        rigid = traced(branch_kernels.are_rigid)(matrix[0], place[0], ORTHONORMALITY_TOLERANCE)
        return ca.logic_and(self.valid, rigid)

    def function(self, name: str, inputs: list[ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
        """Make a function; inputs are named as their symbols are."""
        every = [*inputs, *self.inputs]
        names = [x[0].name().rsplit("_", 1)[0] for x in every]
        return ca.Function(name, every, list(outputs.values()), names, list(outputs))


def inverse_physical(geometry: Dimensions = None) -> ca.Function:
    """Make the inverse displacement in the physical branch.

    Parameters
    ----------
    geometry : Geometry, "symbolic" or None
        The machine; its leg limits decide between two physical branches, as in `spm_pin.inverse_physical`.
        `"symbolic"` adds the input `dimensions` (3,) = E, C, d [m] and knows no limits. None is the paper's machine.

    Returns
    -------
    casadi.Function
        Inputs: `rotation` (3, 3) from {m} to {B}, `position` (3,) of o in {B} [m]. Outputs: `lengths` (6,) [m],
        `joints` (3, 3), rows b_i in {B} [m], `discriminant` (1,), dimensionless, not negative where the branches TT are
        real, and `exists` (1,), 1 where the physical branch does and 0 where not.

    Notes
    -----
    Where no branch is physical the other outputs go on smoothly: they are those of the branch whose stages are
    tilted less. Where `discriminant` is negative it is taken for zero, so lengths are those of a machine that does not
    close, and their derivatives finite: constrain `discriminant` to be positive. At a level platform, where there is a
    continuous family, they are finite and mean nothing; `exists` is 0. Nothing is NaN for finite arguments.

    `exists` is 0 as well where an argument is NaN or infinite, where an entry of RᵀR - I is above 1e-6 or R is a
    reflection, and where a dimension is not within 1e-9 to 1e9 m. A rotation is not repaired: up to there its error is
    one of the other outputs too.
    """
    machine, rotation, position = _Machine(geometry), *_pose()
    tiles, branches = _branches(machine, rotation, position, ("TT+", "TT-"))
    (plus, plus_sum), (minus_, minus_sum) = (_preference(machine, tiles, *branch) for branch in enumerate(branches))
    other = ca.logic_or(minus_ > plus, ca.logic_and(minus_ == plus, minus_sum > plus_sum))
    chosen = [ca.if_else(other, minus_number, plus_number) for plus_number, minus_number in zip(*branches, strict=True)]
    exists = ca.logic_and(plus + minus_ > 0.0, _is_real(machine, tiles, "TT+"))
    outputs = _outputs(tiles, "TT+", chosen) | {"exists": ca.logic_and(exists, machine.takes(rotation, position))}
    return machine.function("inverse_physical", [rotation, position], outputs)


def inverse_branch(branch: str, geometry: Dimensions = None) -> ca.Function:
    """Make the inverse displacement in one branch.

    Parameters
    ----------
    branch : str
        One of `spm_pin.mechanism.BRANCHES`.

    Returns
    -------
    casadi.Function
        As `inverse_physical`; `discriminant` is that of the branch's family, and `exists` 1 where the branch is real.

    Raises
    ------
    ArgumentError
        If there is no such branch.
    """
    choice(branch, "branch", BRANCHES)
    machine, rotation, position = _Machine(geometry), *_pose()
    tiles, (numbers,) = _branches(machine, rotation, position, (branch,))
    exists = ca.logic_and(_is_real(machine, tiles, branch), machine.takes(rotation, position))
    outputs = _outputs(tiles, branch, numbers) | {"exists": exists}
    return machine.function("inverse_branch", [rotation, position], outputs)


def forward_physical(geometry: Dimensions = None) -> ca.Function:
    """Make the forward displacement in the home's aspect, an implicit function with exact derivatives.

    Returns
    -------
    casadi.Function
        Input: `lengths` (6,) [m]. Outputs: `rotation` (3, 3), `position` (3,) [m], `joints` (3, 3) [m], `residual`
        (1,), the largest error of a stage's equations in units of r², below 1e-12 at a solution, and `exists` (1,), 1
        where that is so and both stages are in the aspect of the symmetric home.

    Notes
    -----
    Each stage is solved by 14 steps of Newton's method from the level position, then by `casadi.rootfinder`, through
    which CasADi differentiates implicitly. Where legs cannot be joined the outputs are where that ended, and `exists`
    is 0, as for lengths and dimensions that are NaN, infinite or not positive.
    """
    machine = _Machine(geometry)
    lengths, state = ca.SX.sym("lengths", 6), ca.SX.sym("state", 8)
    stages = [
        traced(stage_equations.equations)(*(lengths[k] / machine.r for k in legs), hip / machine.r)
        for legs, hip in (((0, 1, 2), machine.base), ((3, 4, 5), machine.platform))
    ]
    inputs = [lengths, *machine.inputs]
    errors = [_stage_residual(stage, ca.vertsplit(state[4 * k : 4 * k + 4])) for k, stage in enumerate(stages)]
    equations = ca.Function("equations", [state, *inputs], [ca.vertcat(*errors)])
    start = ca.Function("start", inputs, [ca.vertcat(*map(_newton, stages))])
    outputs = _composed(machine, [ca.vertsplit(state[:4]), ca.vertsplit(state[4:])])
    outputs["residual"] = ca.mmax(ca.fabs(ca.vertcat(*errors)))
    exists = ca.logic_and(machine.valid, ca.logic_and(outputs.pop("home"), outputs["residual"] < 1e-12))
    for length in ca.vertsplit(lengths):
        exists = ca.logic_and(exists, ca.logic_and(length > 0.0, length < np.inf))
    outputs["exists"] = exists
    compose = ca.Function("compose", [state, *inputs], list(outputs.values()))
    options = {"error_on_fail": False, "abstol": 1e-15, "max_iter": 4}
    root = ca.rootfinder("root", "fast_newton", equations, options)
    symbols = [ca.MX.sym("lengths", 6), *(ca.MX.sym("dimensions", 3) for _ in machine.inputs)]
    solved = root(start(*symbols), *symbols)
    names = ["lengths", *("dimensions" for _ in machine.inputs)]
    return ca.Function("forward_physical", symbols, compose.call([solved, *symbols]), names, list(outputs))


def inverse_jacobian(geometry: Dimensions = None) -> ca.Function:
    """Make J_f, which maps the platform's twist to the leg rates.

    Returns
    -------
    casadi.Function
        Inputs: `joints` (3, 3), rows b_i [m], `rotation`, `position`. Output: `jacobian` (6, 6), of the twist (v, ω)
        at o in {B}. It grows without bound towards an inverse singularity, and is not a number at one.
    """
    machine, joints, (rotation, position) = _Machine(geometry), ca.SX.sym("joints", 3, 3), _pose()
    matrices, suspect = table(1, 6, 6), table(1)
    sizes = machine.base, machine.platform, machine.side, 0.0
    traced(jacobian_kernels.inverse_jacobians)(*_state(joints, rotation, position), *sizes, matrices, suspect)
    outputs = {"jacobian": _matrix(matrices[0])}
    return machine.function("inverse_jacobian", [joints, rotation, position], outputs)


def leg_forces(geometry: Dimensions = None) -> ca.Function:
    """Make the leg forces that hold a wrench on the platform.

    Returns
    -------
    casadi.Function
        Inputs: `joints` (3, 3), rows b_i [m], `rotation`, `position`, and `wrench` (6,): force [N] and moment [N m] at
        o in {B}, applied from outside. Output: `forces` (6,) [N], positive pushes. They grow without bound towards a
        forward singularity.
    """
    machine, joints, (rotation, position) = _Machine(geometry), ca.SX.sym("joints", 3, 3), _pose()
    wrench, forces, suspect = ca.SX.sym("wrench", 6), table(1, 6), table(1)
    sizes, load = (machine.base, machine.platform, machine.side, 0.0), table(1, 1, 6)
    load[0, 0] = ca.vertsplit(wrench)
    traced(jacobian_kernels.stage_forces)(*_state(joints, rotation, position), load, *sizes, forces, suspect)
    outputs = {"forces": ca.vertcat(*forces[0])}
    return machine.function("leg_forces", [joints, rotation, position, wrench], outputs)


def closure_residual(geometry: Dimensions = None) -> ca.Function:
    """Make the nine closure equations.

    Returns
    -------
    casadi.Function
        Inputs: `joints` (3, 3), rows b_i [m], `rotation`, `position`. Output: `residual` (9,) [m]: distances of the b_i
        from the planes of their lower legs, then of their upper legs; then, for the sides 12, 23, 31, the error
        (|b_i - b_j|² - d²)/2d, smooth everywhere.
    """
    machine, joints, (rotation, position) = _Machine(geometry), ca.SX.sym("joints", 3, 3), _pose()
    tile = table(21, 1)
    traced(wrench_vectors.load)(*_state(joints, rotation, position), 0, 1, tile)
    b, o = traced(wrench_vectors.joints_of)(tile, 0), traced(wrench_vectors.position_of)(tile, 0)
    axes = traced(wrench_vectors.platform_axes)(tile, 0)
    inner, less = traced(dot), traced(minus)
    planes = [inner(b[i], wrench_vectors.BASE_AXES[i]) for i in range(3)]
    planes += [inner(less(b[i], o), axes[i]) for i in range(3)]
    sides = [less(b[i], b[(i + 1) % 3]) for i in range(3)]
    d = machine.side
    residual = ca.vertcat(*planes, *((inner(s, s) - d * d) / (2.0 * d) for s in sides))
    return machine.function("closure_residual", [joints, rotation, position], {"residual": residual})


def _pose() -> tuple[ca.SX, ca.SX]:
    return ca.SX.sym("rotation", 3, 3), ca.SX.sym("position", 3)


def _state(joints: ca.SX, rotation: ca.SX, position: ca.SX) -> tuple[Any, Any, Any]:
    """Return b, R, o as arrays of one state, as the kernels take them."""
    arrays = table(1, 1, 3, 3), table(1, 1, 3, 3), table(1, 1, 3)
    for i in range(3):
        arrays[2][0, 0, i] = position[i]
        for j in range(3):
            arrays[0][0, 0, i, j], arrays[1][0, 0, i, j] = joints[i, j], rotation[i, j]
    return arrays


def _branches(
    machine: _Machine, rotation: ca.SX, position: ca.SX, labels: tuple[str, ...]
) -> tuple[Any, list[list[Any]]]:
    """Return the tiles of a pose, and of each branch the nine numbers of its b_i and its six leg lengths."""
    tiles, roots = traced(branch_tiles.allocate)(), traced(branch_tiles.allocate_roots)()
    joints, lengths = traced(branch_tiles.allocate_joints)(), traced(branch_tiles.allocate_lengths)()
    _, matrix, place = _state(rotation, rotation, position)
    traced(branch_tiles.load_poses)(matrix[0], place[0], 0, 1, tiles[0])
    traced(branch_tiles.set_up_families)(tiles, machine.r, machine.platform, False)
    found = []
    for branch in map(BRANCHES.index, labels):
        traced(branch_tiles.put_roots)(branch // 2, tiles, machine.r, roots)
        traced(branch_tiles.put_branch)(branch, tiles, roots, machine.base, joints, lengths)
        found.append([*joints[9 * branch : 9 * branch + 9, 0], *lengths[6 * branch : 6 * branch + 6, 0]])
    return tiles, found


def _preference(machine: _Machine, tiles: Any, branch: int, numbers: list[Any]) -> tuple[Any, Any]:
    """Return 0 where a branch TT is not physical, 1 where it is, 2 where within leg limits too; and its radii' sum."""
    aspects, joints = traced(branch_tiles.allocate_aspects)(), traced(branch_tiles.allocate_joints)()
    joints[9 * branch : 9 * branch + 9, 0] = numbers[:9]
    traced(branch_tiles.put_aspect)(branch, tiles[0], machine.base, machine.platform, joints, aspects)
    inside, limits = ca.SX(1), machine.limits
    pairs = () if limits is None else zip(limits.minimum, limits.maximum, strict=True)
    for length, (low, high) in zip(numbers[9:], pairs, strict=False):
        inside = ca.logic_and(inside, ca.logic_and(length >= low, length <= high))
    return aspects[branch, PHYSICAL, 0] * (1.0 + inside), aspects[branch, STRAIGHT, 0]


def _is_real(machine: _Machine, tiles: Any, label: str) -> Any:
    """Return 1 where a branch is real, and its family not continuous, else 0."""
    family, flags = BRANCHES.index(label) // 2, tiles[3][0]
    continuous = ca.floor(flags / 2**family) - 2.0 * ca.floor(flags / 2 ** (family + 1))
    regular = ca.logic_and(continuous == 0.0, flags < branch_tiles.VERTICAL)
    return ca.logic_and(tiles[0][DISCRIMINANT + family, 0] >= 0.0, regular)


def _outputs(tiles: Any, label: str, numbers: list[Any]) -> dict[str, ca.SX]:
    joints = _matrix(numbers[3 * i : 3 * i + 3] for i in range(3))
    discriminant = tiles[0][DISCRIMINANT + BRANCHES.index(label) // 2, 0]
    return {"lengths": ca.vertcat(*numbers[9:]), "joints": joints, "discriminant": discriminant}


def _stage_residual(stage: Any, state: Any) -> Any:
    """Return the four equations of a stage: those of its mode, and the quaternion's norm."""
    errors = traced(stage_equations.residual)(stage, state)
    return ca.vertcat(*errors, state[0] * state[0] + state[1] * state[1] + state[2] * state[2] - 1.0)


def _newton(stage: Any) -> Any:
    """Return the state that damped steps of Newton's method reach from the level stage."""
    level = ca.vertcat(1.0, 0.0, 0.0, ca.sqrt(ca.fmax(stage[1], 1e-4)))
    x = ca.SX.sym("x", 4)
    parameters = ca.SX.sym("stage", 5)
    symbols = (*ca.vertsplit(parameters), None)
    error = _stage_residual(symbols, ca.vertsplit(x))
    step = -ca.solve(ca.jacobian(error, x), error)
    step /= ca.fmax(1.0, ca.norm_inf(step) / _LONGEST_STEP)
    damped_step = ca.Function("step", [x, parameters], [x + step])
    for _ in range(_NEWTON_STEPS):
        level = damped_step(level, ca.vertcat(*stage[:5]))
    return level


def _composed(machine: _Machine, states: list[Any]) -> dict[str, ca.SX]:
    """Return the configuration of two stages in mode T, and whether both are in the aspect of their home."""
    rotation, position, joints = table(3, 3), table(3), table(3, 3)
    (x0, x1, x2, zeta), (y0, y1, y2, eta) = states
    lower, upper = (x0, x1, x2, 0.0, zeta), (y0, -y1, -y2, 0.0, -eta)
    traced(mode_kernels.compose)(lower, upper, machine.r, rotation, position, joints)
    home = ca.SX(1)
    for (a, b, c, height), hip in zip(states, (machine.base, machine.platform), strict=True):
        radii, heights = traced(stage_equations.placed)(a, b, c, 0.0, height)
        home = ca.logic_and(home, traced(stage_equations.in_home_aspect)(radii, heights, hip / machine.r))
        home = ca.logic_and(home, ca.logic_and(height > 0.0, a > 0.0))
    return {"rotation": _matrix(rotation), "position": ca.vertcat(*position), "joints": _matrix(joints), "home": home}


def _matrix(rows: Iterable[Iterable[Any]]) -> Any:
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))
