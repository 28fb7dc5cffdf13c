"""The kinematics in C99, for controllers: one header, one source file, a test program and a CMake file.

`STATE_FUNCTIONS` is the table of what the C computes from a state. Header, source, test program, the bindings of the
tests, the benchmark and the page's table follow from it; a recipe for one more is in CONTRIBUTING.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.casadi import functions
from spm_pin.casadi.symbolic_machine import (
    MachineInCasadi,
    NominalBranches,
    StateInCasadi,
    all_of,
    fields_of,
    in_casadi,
    parts,
    rows,
)
from spm_pin.description.masses import Masses
from spm_pin.errors import ArgumentError
from spm_pin.export.c_printer import c_function, number
from spm_pin.export.c_texts import checked_prefix, common_values, machine_text, rendered, write_sources
from spm_pin.formulas import circles, vectors
from spm_pin.formulas.planar_legs import LONGEST_CHORD, MOST_TURNED
from spm_pin.kinematics import (
    forward_physical,
    inverse_displacement,
    inverse_jacobian,
    inverse_physical,
    leg_forces,
    leg_rates,
)
from spm_pin.kinematics.random_states import random_states
from spm_pin.kinematics.singularity_kinds import SINGULAR
from spm_pin.machine import BRANCHES, FAMILIES, Configuration, Manipulator
from spm_pin.machine.joint_angles import joint_angles, joint_names, value_names
from spm_pin.machine.manipulator import check_manipulator
from spm_pin.support.arguments import FloatArray

STATUSES = {
    "OK": (0, "the result is complete and finite"),
    "UNREACHABLE": (1, "no real or no physical solution, or a ball is out of reach of its leg"),
    "DEGENERATE": (2, "the Z axes are parallel, or a family is continuous: the pose leaves the legs undetermined"),
    "SINGULAR": (3, "the state or the way to it is singular to rounding, or branches of a pose cannot be told apart"),
    "NOT_FINITE": (-1, "an argument is NaN or infinite"),
    "NOT_A_ROTATION": (-2, "an entry of R^T R - I is above 1e-6, or R is a reflection"),
    "OUT_OF_RANGE": (-3, "a length <= 0, a crank past a turn, a place past 1e5 (E + C + d), or a result infinite"),
    "BAD_GEOMETRY": (-4, "numbers that are no machine; for `all_branches`, legs that are not nominal"),
    "BAD_NEAR": (-5, "the state to begin from does not close to 1e-6 d"),
}
"""Value and meaning of what each function returns; negative ones are errors of the caller."""


@dataclass(frozen=True)
class StateFunction:
    """A function of the C that computes numbers from a state."""

    name: str
    compute: Callable[..., dict[str, Any]]  # from a `StateInCasadi` and the arguments
    arguments: dict[str, FloatArray]  # values for the test program
    result: str
    count: int
    singular: str  # the singularities it is refused at: "forward", "inverse" or none
    answer: Callable[..., npt.ArrayLike]  # from a `Configuration` and the arguments
    meaning: str
    is_of_rps: bool = False  # whether machines of RPS legs alone have it

    def parameters(self, prefix: str) -> str:
        """Return the parameters in C, where names begin with the prefix."""
        arguments = "".join(f"const double {name}[{numbers.size}], " for name, numbers in self.arguments.items())
        machine = f"const {prefix}geometry *geometry, const {prefix}state *state"
        return f"{machine}, {arguments}double {self.result}[{self.count}]"


_WRENCH = np.array([30.0, -20.0, -500.0, 4.0, -6.0, 8.0])
_TWIST = np.array([0.1, -0.2, 0.3, 0.2, -0.3, 0.1])
_WEIGHTS = {
    "bodies": np.linspace(0.3, 0.9, 32),
    "payload": np.array([2.0, 0.1, -0.2, 0.3]),
    "acceleration": np.array([0.5, -1.0, -9.7]),
}


_gravity = lru_cache(maxsize=1)(functions.gravity)  # made once for all states of an export


def _weight_forces(state: Configuration, *weights: FloatArray) -> FloatArray:
    forces = _gravity(state.machine)(state.middle_joints, state.rotation, state.translation, *weights)
    return np.asarray(forces)[:, 0]


def _joint_values(state: Configuration) -> FloatArray:
    named = dict(zip(value_names(state.machine), joint_angles(state, corners=(0,)).values, strict=True))
    return np.array([named[name] for name in joint_names(state.machine)])


STATE_FUNCTIONS = (
    StateFunction(
        *("inverse_jacobian", functions.jacobian_of, {}, "jacobian", 36, "inverse", inverse_jacobian),
        "J_f (6 x 6, row by row), from the platform's twist (v of o, omega) in {B} to the leg rates",
    ),
    StateFunction(
        *("leg_forces", functions.forces_of, {"wrench": _WRENCH}, "forces", 6, "forward", leg_forces),
        "the leg forces that balance a wrench (force, moment at o) in {B}, applied to the platform; positive pushes",
    ),
    StateFunction(
        *("leg_rates", functions.rates_of, {"twist": _TWIST}, "rates", 6, "inverse", leg_rates),
        "the leg rates of the platform's twist (v of o, omega) in {B}",
    ),
    StateFunction(
        *("gravity", functions.gravity_of, _WEIGHTS, "forces", 6, "forward", _weight_forces),
        "the leg forces that balance weights of `bodies` and a payload (kg, centre in {m}) at rest; positive pushes",
        is_of_rps=True,
    ),
    StateFunction(
        *("joint_values", functions.values_of, {}, "values", 18, ""),
        _joint_values,
        "the values of the description's eighteen joints [rad, m], in the order of its tree",
    ),
)

_NAMES = "kinematics.h", "kinematics.c", "kinematics_test.c"
_STAGES = "lower", "upper"
_CASES = 12
_SPREAD = 1e3
_LEAST_SLOPE, _LARGEST_RATE = 0.1, 1e3
"""Least slopes of legs over the largest ones, and largest entries of J_f in units of d, of states with ten digits."""
MOST_STEPS, SHORTEST = 2_000, 1e-7
"""Maximum number of steps along a path, rejected ones included, and minimum step relative to the path."""
ROOT_STEPS = 400
"""Maximum number of steps along each of the eight paths on which all branches of a pose are found."""


def c_sources(machine: Manipulator, *, prefix: str = "spm_", masses: Masses | None = None) -> dict[str, str]:
    """Return the C library of a machine, without memory allocation, dependent on `math.h` alone.

    Parameters
    ----------
    machine : Manipulator
        The machine that is built in, nominal or calibrated. The functions take others too.
    prefix : str
        Prefix of all names.
    masses : Masses, optional
        Masses of the bodies, for the weights; assumed ones by default, see `urdf_text`.

    Returns
    -------
    dict of str
        The texts of `spm_kinematics.h`, `spm_kinematics.c`, `spm_kinematics_test.c` and `CMakeLists.txt` by their
        names, of `spm_machine.txt`, the numbers of the machine, and of `spm_read_machine.h`, which reads them.
    """
    check_manipulator(machine)
    smallest, largest = min(machine.dimensions), max(machine.dimensions)
    if largest > _SPREAD * smallest:
        expected = f"dimensions within a factor of {_SPREAD:g}, for the answers of the test program to keep ten digits"
        raise ArgumentError("machine", expected, f"{smallest:g} to {largest:g} m", "Another unit in one of them?")
    prefix = checked_prefix(prefix)
    available = state_functions(machine)
    numbers, kinds = machine_fields(machine), machine.legs.kinds
    stages = list(zip(_STAGES, kinds, strict=True))
    shown = [f"of the {name} legs, {kind.name}, {kind.meaning} [{kind.unit}]" for name, kind in stages]
    values = {
        **common_values(machine, prefix),
        "header": f"{prefix}kinematics.h",
        "numbers": "(double *)geometry",
        "is_machine": f"{prefix}forward(geometry, geometry->offsets, NULL, &state) != {prefix.upper()}BAD_GEOMETRY",
    }
    reader = rendered("read_machine.h", values | {"fields": numbers})
    values |= {
        "fields": numbers,
        "functions": available,
        "formulas": _formulas(machine),
        "legs": machine.legs,
        "stages": [(name, kind, [x.name for x in fields(kind)]) for name, kind in stages],
        "readings": f"{kinds[0].meaning} [m]" if machine.legs.are_rps else "; ".join(shown),
        "turns": [unit == "rad" for unit in machine.legs.units],
        "bodies": functions.bodies(machine, masses) if machine.legs.are_rps else None,
        "statuses": STATUSES,
        "circles": circles,
        "singular": SINGULAR,
        "chord": LONGEST_CHORD,
        "most_turned": MOST_TURNED,
        "most_steps": MOST_STEPS,
        "shortest": SHORTEST,
        "root_steps": ROOT_STEPS,
        "numbers": _row,
        "table": _table,
        **_known_answers(machine, available),
    }
    texts = {f"{prefix}{name}": rendered(name, values) for name in _NAMES}
    texts[f"{prefix}read_machine.h"] = reader
    texts[f"{prefix}machine.txt"] = machine_text(values["machine_file"], numbers)
    return texts | {"CMakeLists.txt": rendered("CMakeLists.txt", values)}


def write_c(
    machine: Manipulator, directory: str | Path, *, prefix: str = "spm_", masses: Masses | None = None
) -> list[Path]:
    """Write what `c_sources` returns into a directory, made if need be; all of it or nothing. Returns the paths.

    Files of the same names are replaced.
    """
    return write_sources(directory, lambda: c_sources(machine, prefix=prefix, masses=masses))


def machine_fields(machine: Manipulator) -> dict[str, FloatArray]:
    """Return the numbers of an `spm_geometry` by the names of its fields."""
    kinds = machine.legs.kinds
    limits = machine.limits or machine.legs.free_limits
    arrays: list[npt.ArrayLike] = [machine.dimensions, *machine.legs.arrays, limits.minimum, limits.maximum]
    arrays += [kind.numbers for kind in kinds if kind.numbers.size]
    return {name: np.asarray(x, dtype=float).ravel() for name, x in zip(fields_of(kinds), arrays, strict=True)}


def state_functions(machine: Manipulator) -> list[StateFunction]:
    """Return the functions of the table that machines with these kinds of legs have."""
    return [x for x in STATE_FUNCTIONS if machine.legs.are_rps or not x.is_of_rps]


@lru_cache(maxsize=16)
def _formulas(machine: Manipulator) -> str:
    """Return the functions that the C calls, of flat arrays, matrices row by row: most of the time of an export."""
    symbolic = MachineInCasadi.of_symbols(machine)
    flat, position, balls = (ca.SX.sym(name, n) for name, n in (("r", 9), ("o", 3), ("balls", 6)))
    joints, rotation = ca.SX.sym("joints", 9), _matrix(flat)
    state, pose = StateInCasadi(symbolic, _matrix(joints), rotation, position), [flat, position]
    drawing = symbolic.nominal()
    drawn = NominalBranches(drawing, rotation, position)

    made = _stage_formulas()

    def add(name: str, inputs: list[Any], *outputs: Any) -> None:
        made.append(ca.Function(name, [*inputs, *symbolic.inputs], ca.cse([_flat(x) for x in outputs])))

    readings = ca.SX.sym("readings", 6)
    stages = [symbolic.circles(k, readings) for k in (0, 1)]
    add("circles_of_readings", [readings], *(_column([stage[k] for stage in stages]) for k in (1, 2, 3)))
    add("limits_hold", [readings], ca.vertcat(*functions.within_limits(symbolic, readings)))
    # Errors of the closure: size of terms of second order, and motion of the upper legs' planes.
    error = functions.closure_equations(symbolic, balls, rotation, position)
    points = functions.lower_balls(symbolic, balls)
    upper, weights = symbolic.all_balls(points)[3:], [[ca.fabs(x) for x in w] for w in symbolic.ball_weights()]
    arms = ca.norm_2(points[1] - points[0]) + ca.norm_2(points[2] - points[0])
    curvature = ca.vertcat(*(2.0 / s for s in symbolic.sides()), *(4.0 * w for _, _, w in weights))
    tilt = ca.vertcat(0, 0, 0, *(1.0 + 2.0 * (u + v + w * arms) for u, v, w in weights))
    lever = ca.vertcat(0, 0, 0, *(ca.norm_2(p - position) for p in upper))
    add("closure", [balls, *pose], error, ca.jacobian(error, balls), curvature, tilt, lever)
    add("lower_balls", [balls], ca.vertcat(*points))

    both = [ca.SX.sym(name, 9) for name in ("lower", "upper")]
    placed_rotation, placed_position, _ = functions.placed(symbolic, *map(_rows, both))
    add("placed_platform", both, placed_rotation, placed_position)
    levels = [functions.level_balls(symbolic, k, stage) for k, stage in enumerate(stages)]
    add("level_stages", [readings], *map(_column, levels))
    gap = ca.mmax(ca.fabs(functions.residual_of(state)["residual"])) / symbolic.side
    seen = ca.vertcat(*state.own_balls()[1])
    add("own_places", [joints, *pose], state.in_planes(), seen, gap)
    add("describe", [joints, *pose], state.readings, *functions.preference(symbolic, state))
    add("own_limits", [joints, *pose], state.reach, state.least_slope(state.readings))
    add("working_mode", [joints, *pose, readings], state.least_slope(readings))
    forces = [state.force_rows(x) for x in (state.directions, state.axes)]
    add("force_rows", [joints, *pose], *forces)

    starts = ca.vertcat(*functions.nominal_starts(symbolic, drawn)[:2])
    add("nominal_branches", pose, starts, drawn.is_degenerate("TT"))
    quaternion = ca.SX.sym("quaternion", 4)
    forms, coordinates = functions.quadrics(symbolic, quaternion, rotation, position)
    add("quadrics", pose, ca.vertcat(*(_flat(form) for form in forms)))
    add("balls_of_root", [quaternion, *pose], coordinates)
    branches = [drawn.branch(label[:2], 1.0 if label[2] == "+" else -1.0) for label in BRANCHES]
    states = [StateInCasadi(drawing, b, rotation, position) for b in branches]
    shown, discriminants = ca.vertcat(*(x.readings for x in states)), ca.vertcat(*map(drawn.discriminant, FAMILIES))
    real = [drawn.is_real(label[:2]) for label in BRANCHES]
    real = ca.vertcat(*(ca.logic_and(x, branch.reach >= 0.0) for x, branch in zip(real, states, strict=True)))
    continuous = 1.0 - all_of([ca.logic_not(drawn.is_degenerate(family)) for family in FAMILIES])
    every = ca.vertcat(*(_flat(b) for b in branches))
    add("all_drawn_branches", pose, every, shown, discriminants, real, continuous)

    areas = []
    for b in (symbolic.balls[:3], symbolic.balls[3:]):
        sides = in_casadi(circles.squared_sides)([parts(x) for x in b])
        areas.append(ca.norm_2(ca.cross(b[1] - b[0], b[2] - b[0])) / ca.mmax(ca.vertcat(*sides)))
    add("numbers_of_machine", [], ca.vertcat(*areas), symbolic.valid)
    size, pairs = sum(symbolic.radii) + symbolic.side, []
    for name, unit in (("axes", 1.0), ("pivots", size), ("balls", size)):
        pairs += [(a - b) / unit for a, b in zip(getattr(symbolic, name), getattr(drawing, name), strict=True)]
    error = ca.mmax(ca.fabs(ca.vertcat(*pairs)))
    add("drawing_error", [], error)

    for function in state_functions(machine):
        further = [ca.SX.sym(name, len(numbers)) for name, numbers in function.arguments.items()]
        (result,) = function.compute(state, *further).values()
        add(f"{function.name}_of", [joints, *pose, *further], result)
    return "\n".join(map(c_function, made))


def _stage_formulas() -> list[ca.Function]:
    """Return the functions of `spm_pin.formulas.circles` that the C calls, of flat arrays."""
    e, b, axes, share, next_share = (ca.SX.sym(n, k) for n, k in (("e", 9), ("b", 9), ("axes", 9), ("s", 1), ("t", 1)))
    names = ("centres", 9), ("radii", 3), ("squares", 3)
    ends = [[ca.SX.sym(f"{end}_{name}", count) for name, count in names] for end in ("start", "end")]
    start, end = (circles.Circles(_rows(axes), _rows(x[0]), parts(x[1]), parts(x[2])) for x in ends)
    step = in_casadi(circles.newton_step)(end, _rows(e))
    turned = in_casadi(circles.turned_back)(end, _rows(e), in_casadi(circles.limited)(step))
    between = [in_casadi(circles.circles_between)(start, end, x) for x in (0.5 * (share + next_share), next_share)]
    change = in_casadi(circles.largest_change)(start, end) * (next_share - share)
    is_safe = in_casadi(circles.is_safe_step)(
        *between, _rows(b), in_casadi(circles.first_step)(between[1], _rows(b)), change
    )
    size, last = ca.SX.sym("size"), ca.SX.sym("last")
    direction, balls = in_casadi(circles.directions_to)(end, _rows(b)), in_casadi(circles.balls_at)(end, _rows(e))
    table = (
        ("newton_step", [e, axes, *ends[1]], turned, in_casadi(vectors.largest)(step)),
        ("directions_to", [b, axes, ends[1][0]], direction),
        ("balls_at", [e, *ends[1][:2]], balls),
        ("squared_sides", [b], in_casadi(circles.squared_sides)(_rows(b))),
        ("is_safe_step", [b, axes, *ends[0], *ends[1], share, next_share], is_safe),
        ("has_converged", [size, last], in_casadi(circles.has_converged)(size, last)),
        ("is_stalled", [size, last], in_casadi(circles.is_stalled)(size, last)),
        ("is_closed", [e, axes, *ends[1]], in_casadi(circles.is_closed)(end, _rows(e))),
    )
    return [ca.Function(name, inputs, ca.cse([_column(x) for x in outputs])) for name, inputs, *outputs in table]


def _rows(numbers: Any) -> Any:
    """Return three vectors as formulas take them, of nine numbers."""
    return rows([numbers[k : k + 3] for k in (0, 3, 6)])


def _column(numbers: Any) -> Any:
    """Return a number, a vector or three vectors of a formula as a column."""
    return ca.densify(ca.vertcat(*map(_column, numbers)) if isinstance(numbers, tuple | list) else ca.SX(numbers))


def _matrix(numbers: Any) -> Any:
    return ca.reshape(numbers, 3, 3).T


def _flat(matrix: Any) -> Any:
    """Return a matrix as a column, row by row."""
    dense = ca.densify(ca.SX(matrix))
    return ca.vec(dense.T)


def _known_answers(machine: Manipulator, available: list[StateFunction]) -> dict[str, Any]:
    rng, rise = np.random.default_rng(17), sum(machine.dimensions)
    # In the home assembly region; then poses anywhere, and one out of reach.
    held = _held_states(machine, rng)[: _CASES - 4]
    turned = Rotation.random(3, rng=rng)
    far = RigidTransform.from_components(rise * rng.uniform(-1.0, 1.0, (3, 3)), turned)
    away = RigidTransform.from_components([100.0 * rise, 0.0, 0.0], Rotation.from_euler("x", 0.3))
    pose = RigidTransform.concatenate([held.pose, far, away])
    branches = inverse_displacement(machine, pose).readings
    states = [inverse_physical(machine, pose[n]) for n in range(len(pose))]

    def padded(count: int, compute: Callable[..., npt.ArrayLike], *arguments: FloatArray) -> list[FloatArray]:
        return [np.ravel(compute(s, *arguments)) if s.exists else np.zeros(count) for s in states]

    return {
        "answers": [(f, padded(f.count, f.answer, *f.arguments.values())) for f in available],
        "height": rise,
        "is_nominal": _is_nominal(machine),
        "rotations": pose.rotation.as_matrix().reshape(-1, 9),
        "positions": pose.translation,
        "branch_readings": branches.reshape(len(pose), -1),
        "joints": padded(9, lambda state: state.middle_joints),
    }


def _held_states(machine: Manipulator, rng: np.random.Generator) -> Configuration:
    """Return physical states with ten digits."""
    drawn = random_states(replace(machine, limits=None), 64, rng)
    states = inverse_physical(machine, drawn.pose)
    again = forward_physical(machine, states.readings[states.exists])
    states = states[states.exists]
    largest, unit = machine.legs.largest_slopes, np.repeat([1.0, machine.middle_side], 3)
    rates = np.abs(inverse_jacobian(states) * largest[:, None] / unit).max(axis=(-1, -2))
    regular = (rates < _LARGEST_RATE) & (np.abs(states.slopes) / largest > _LEAST_SLOPE).all(axis=-1)
    apart = np.abs(again.middle_joints - states.middle_joints).max(axis=(-1, -2))
    return states[regular & (apart < 1e-9 * machine.middle_side)]


def _is_nominal(machine: Manipulator) -> bool:
    legs = zip(machine.legs.arrays[:3], machine.nominal.legs.arrays[:3], strict=True)
    return all(np.array_equal(own, drawn) for own, drawn in legs)


def _row(numbers: npt.ArrayLike) -> str:
    return ", ".join(map(number, np.ravel(numbers)))


def _table(rows: Any) -> str:
    return ",\n".join(f"    {{{_row(row)}}}" for row in rows)
