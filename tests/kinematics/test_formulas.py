"""Formulas: the same functions on many kinds of numbers, and derivatives and determinants against plain matrices."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import flint
import mpmath
import numba
import numpy as np
import pytest
from numba.extending import register_jitable

import spm_pin as spm
from spm_pin.kinematics.formulas import branches, joint_values, legs, operations, quadrics, stages, vectors, wrenches
from spm_pin.kinematics.formulas.operations import COS_30, bind
from spm_pin.kinematics.intervals import Interval

PAPER = spm.Geometry.paper()
R, E, C = PAPER.middle_radius, PAPER.base_radius, PAPER.platform_radius
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88])).as_matrix()
BRANCHES = spm.inverse_displacement(PAPER, POSE)
STATE = spm.inverse_physical(PAPER, POSE)
EPS = np.finfo(float).eps


def rows(matrix: Any) -> Any:
    return tuple(map(tuple, np.asarray(matrix).tolist()))


def flat(value: Any) -> list[Any]:
    return [x for item in value for x in flat(item)] if isinstance(value, tuple) else [value]


def mapped(convert: Callable[[float], Any], value: Any) -> Any:
    if not isinstance(value, tuple):
        return convert(value)
    items = [mapped(convert, item) for item in value]
    return type(value)(*items) if hasattr(value, "_fields") else tuple(items)


@dataclass
class Runner:
    """A kind of number: how formulas are run on it, and how it is made of a float and read."""

    run: Callable[..., Any]
    convert: Callable[[float], Any]
    read: Callable[[Any], float]


def interpreted(**own: Any) -> Callable[..., Any]:
    return lambda formula, *arguments: bind(formula, **own)(*arguments)


def of_casadi(formula: Any, *arguments: Any) -> Any:
    """Trace a formula with symbols, then evaluate it."""
    numbers = [float(x) for x in flat(arguments)]
    symbols = iter(ca.vertsplit(ca.SX.sym("x", len(numbers))))
    inputs = mapped(lambda _: next(symbols), arguments)
    own = {"sqrt": ca.sqrt, "where": ca.if_else, "both": ca.logic_and, "either": ca.logic_or}
    result = bind(formula, **own)(*inputs)
    outputs = ca.Function("f", [ca.vertcat(*flat(inputs))], [ca.vertcat(*flat(result))])(numbers)
    values = iter(np.asarray(outputs).ravel().tolist())
    return mapped(lambda _: next(values), result)


COMPILED: dict[Any, Any] = {}


def of_numba(formula: Any, *arguments: Any) -> Any:
    """Compile a formula as the kernels do: what it calls is registered with Numba as it stands."""
    if not COMPILED:
        for module in (operations, vectors, stages, branches, wrenches, legs, joint_values, quadrics):
            for member in vars(module).values():
                if callable(member) and getattr(member, "__module__", "") == module.__name__ and hasattr(member, "__code__"):
                    register_jitable(error_model="numpy")(member)
    if formula not in COMPILED:
        COMPILED[formula] = numba.njit(error_model="numpy")(formula)
    return COMPILED[formula](*arguments)


RUNNERS = {
    "float": Runner(lambda formula, *arguments: formula(*arguments), float, float),
    "NumPy": Runner(
        interpreted(where=np.where, both=np.logical_and, either=np.logical_or),
        lambda x: np.full(2, x),
        lambda x: float(x[1]),
    ),
    "Numba": Runner(of_numba, float, float),
    "CasADi": Runner(of_casadi, float, float),
    "mpmath": Runner(interpreted(sqrt=mpmath.sqrt, COS_30=mpmath.sqrt(3) / 2), mpmath.mpf, float),
    "arb": Runner(interpreted(sqrt=lambda x: x.sqrt(), COS_30=flint.arb(3).sqrt() / 2), flint.arb, float),
}
PHYSICAL = 0  # TT+, of the pose above


@pytest.mark.parametrize("name", RUNNERS)
def test_all_branches_on_every_kind_of_number(name: str) -> None:
    runner = RUNNERS[name]
    rotation, position = mapped(runner.convert, rows(POSE[:3, :3])), mapped(runner.convert, tuple(POSE[:3, 3].tolist()))
    r, e, c = map(runner.convert, (R, E, C))
    frame = runner.run(branches.pose_frame, rotation, position, r)
    corners = runner.run(branches.platform_corners, rotation, position, c)
    families = runner.run(branches.families, frame, r)
    discriminants = [runner.run(branches.discriminant, family) for family in families]
    np.testing.assert_allclose([runner.read(x) / R**2 for x in discriminants], BRANCHES.discriminants, rtol=1e-12)
    for k in np.flatnonzero(BRANCHES.exists):
        family = families[k // 2]
        sign, square_root = runner.convert(1.0 - 2.0 * (k % 2)), math.sqrt(runner.read(discriminants[k // 2]))
        u, v, square = runner.run(branches.root, family, sign, runner.convert(square_root))
        radii, heights = runner.run(branches.middle_joints, u, v, r / square, family, frame, position)
        b = [runner.read(x) for x in flat(runner.run(stages.cartesian, radii, heights))]
        np.testing.assert_allclose(b, BRANCHES.middle_joints[k].ravel(), rtol=0, atol=1e-13)
        lengths = runner.run(branches.leg_lengths, radii, heights, corners, e)
        np.testing.assert_allclose([runner.read(x) for x in lengths], BRANCHES.leg_lengths[k], rtol=1e-12)
        if k < 2:
            home, _ = runner.run(branches.stands_at_home, radii, heights, rotation, position, e, c)
            assert bool(runner.read(home)) == (k == PHYSICAL)


def state_arguments() -> dict[str, Any]:
    """Return a state of a machine as built as tuples: balls, legs in {B}, directions."""
    machine = PAPER.perturbed(3, length=1e-2, angle=1e-2)
    state = spm.inverse_physical(machine, POSE)
    return {"machine": machine, "state": state}
