"""CasADi from random starts: IPOPT, the package's mapped Newton, and a Newton written out, compiled and mapped."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.compiled import FLAGS, folder, shared_object
from benchmarks.peers.lines import lines
from benchmarks.peers.multistart import STARTS, search
from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin import Manipulator

STEPS = 25
"""Newton steps from each start in the compiled version, which has no test of convergence."""
ITERATIONS = 60
"""Most Newton steps in the mapped version, which stops where the loops are closed."""


def ipopt(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare IPOPT on the feasibility problem, start by start."""
    required("casadi", "casadi")
    from spm_pin.crosscheck.nlp.branch_search import IpoptSolver

    solver = IpoptSolver(problem[0], 1e-12)
    return search(problem, solver)


def mapped_newton(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """`spm_pin.crosscheck.nlp.batched_newton`: equations mapped over the starts, steps by NumPy's batched solve."""
    required("casadi", "casadi")
    from spm_pin.crosscheck.nlp.batched_newton import LoopEquations, newton

    equations = LoopEquations(problem[0])
    return search(problem, lambda starts, matrix: newton(equations, starts, matrix, ITERATIONS)[0])


def compiled_newton(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare Newton on the three sides along the ball joints' lines, generated as C with all its steps, mapped."""
    machine, _ = problem
    function = _compiled(machine)

    def solve(starts: FloatArray, matrix: FloatArray) -> FloatArray:
        points, directions = lines(machine, matrix)
        along = ((starts.reshape(-1, 3, 3) - points) * directions).sum(axis=-1)
        ends = np.asarray(function(points.T, directions.T, along.T)).T
        return (points + ends[:, :, None] * directions).reshape(-1, 9)

    return search(problem, solve)


@functools.cache
def _compiled(machine: Manipulator) -> Any:
    ca: Any = required("casadi", "casadi")
    points, directions, along = ca.SX.sym("p", 3, 3), ca.SX.sym("e", 3, 3), ca.SX.sym("l", 3)

    def step(value: Any) -> Any:
        joints = [points[:, i] + value[i] * directions[:, i] for i in range(3)]
        gaps, rows = [], []
        for i in range(3):
            j = (i + 1) % 3
            side = joints[i] - joints[j]
            gaps.append((ca.sumsqr(side) - machine.middle_side**2) / 2.0)
            row = ca.SX.zeros(1, 3)
            row[i], row[j] = ca.dot(side, directions[:, i]), -ca.dot(side, directions[:, j])
            rows.append(row)
        a = ca.vertcat(*rows)
        # Row i has no entry in the column of the joint it leaves out: two products make the determinant.
        determinant = a[0, 0] * a[1, 1] * a[2, 2] + a[0, 1] * a[1, 2] * a[2, 0]
        adjugate = [
            [a[1, 1] * a[2, 2], -a[0, 1] * a[2, 2], a[0, 1] * a[1, 2]],
            [a[1, 2] * a[2, 0], a[0, 0] * a[2, 2], -a[0, 0] * a[1, 2]],
            [-a[1, 1] * a[2, 0], a[0, 1] * a[2, 0], a[0, 0] * a[1, 1]],
        ]
        return (
            value - ca.vertcat(*(sum(c * g for c, g in zip(row, gaps, strict=True)) for row in adjugate)) / determinant
        )

    one = ca.Function("step", [points, directions, along], [step(along)])
    value = along
    for _ in range(STEPS):
        value = one(points, directions, value)
    solve = ca.Function("solve", [points, directions, along], [value])
    mapped = solve.map(STARTS)
    generator = ca.CodeGenerator("newton.c")
    generator.add(mapped)
    generator.generate(f"{folder()}/")
    return ca.external(mapped.name(), str(shared_object(folder() / "newton.c", FLAGS)))
