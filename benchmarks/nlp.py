"""Multi-start solvers of the loop equations side by side: time per start and per pose, and what they find.

    python benchmarks/nlp.py [--poses N] [--starts N]

Every solver gets the same random starts at the same poses in leg space. "found" counts branches of the closed form
among the ends; times are those of one process, and the last column is the time per pose in units of the first row.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.optimize import root

import spm_pin as spm
from spm_pin.crosscheck.sampling import in_leg_space
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.nlp import loop_equations, search
from spm_pin.nlp.newton import LoopEquations, newton
from spm_pin.nlp.starts import random_starts

GEOMETRY = spm.Geometry.paper()
Solver = Callable[[FloatArray, FloatArray], FloatArray]

QUIET = {
    "ipopt": {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False},
    "fatrop": {"fatrop.print_level": 0, "print_time": False},
    "sqpmethod": {
        "print_header": False,
        "print_iteration": False,
        "print_status": False,
        "print_time": False,
        "error_on_fail": False,
        "qpsol": "qrqp",
        "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
    },
}


def symbols() -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return b, the pose's parameters, and the loop equations in them."""
    b, pose = ca.SX.sym("b", 9), ca.SX.sym("pose", 12)
    return b, pose, loop_equations.equations(GEOMETRY, b, ca.reshape(pose[:9], 3, 3), pose[9:])


def parameters(matrix: FloatArray) -> FloatArray:
    """Return the pose (4, 4) as the solvers take it, (12,)."""
    return np.concatenate([matrix[:3, :3].T.ravel(), matrix[:3, 3]])


def mapped_newton() -> Solver:
    """Newton's method as the package has it."""
    equations = LoopEquations(GEOMETRY)
    return lambda starts, matrix: newton(equations, starts, matrix, 60)[0]


def rootfinder(plugin: str) -> Solver:
    """One of CasADi's rootfinders, start by start."""
    b, pose, residual = symbols()
    solver = ca.rootfinder("solver", plugin, {"x": b, "p": pose, "g": residual}, {"error_on_fail": False})

    def run(starts: FloatArray, matrix: FloatArray) -> FloatArray:
        return np.array([np.asarray(solver(start, parameters(matrix))).ravel() for start in starts])

    return run


def nlp(plugin: str) -> Solver:
    """One of CasADi's NLP solvers, without an objective."""
    b, pose, residual = symbols()
    solver = ca.nlpsol("solver", plugin, {"x": b, "p": pose, "f": 0, "g": residual}, QUIET[plugin])

    def run(starts: FloatArray, matrix: FloatArray) -> FloatArray:
        ends = (solver(x0=start, p=parameters(matrix), lbg=0.0, ubg=0.0)["x"] for start in starts)
        return np.array([np.asarray(end).ravel() for end in ends])

    return run


def scipy_root() -> Solver:
    """SciPy's hybrid method with CasADi's Jacobian."""
    function = loop_equations.closure(GEOMETRY)

    def run(starts: FloatArray, matrix: FloatArray) -> FloatArray:
        def residual(b: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian = function(b, matrix[:3, :3], matrix[:3, 3])
            return np.asarray(value).ravel(), np.asarray(jacobian)

        return np.array([root(residual, start, jac=True).x for start in starts])

    return run


def main() -> None:
    """Run all solvers and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=4)
    parser.add_argument("--starts", type=int, default=128)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    poses = in_leg_space(GEOMETRY, options.poses, rng)
    truth = spm.inverse_displacement(GEOMETRY, poses)
    solvers = {
        "Newton, mapped over the starts": mapped_newton(),
        "casadi.rootfinder fast_newton": rootfinder("fast_newton"),
        "casadi.rootfinder newton": rootfinder("newton"),
        "casadi.nlpsol sqpmethod": nlp("sqpmethod"),
        "casadi.nlpsol fatrop": nlp("fatrop"),
        "casadi.nlpsol ipopt": nlp("ipopt"),
        "scipy.optimize.root hybr": scipy_root(),
    }
    matrices = poses.as_matrix()
    batches = [random_starts(GEOMETRY, matrix, options.starts, rng) for matrix in matrices]
    print(f"{options.poses} poses, {options.starts} starts each, {int(truth.count.sum())} branches")
    print(f"{'':32} {'µs/start':>9} {'converged':>10} {'found':>7} {'ms/pose':>9} {'ratio':>7}")
    unit = 0.0
    for name, solver in solvers.items():
        solver(batches[0], matrices[0])
        began = time.perf_counter()
        ends = [solver(starts, matrix) for starts, matrix in zip(batches, matrices, strict=True)]
        seconds = (time.perf_counter() - began) / options.poses
        unit = unit or seconds
        found = converged = 0
        for k, end in enumerate(ends):
            branches = truth[k].middle_joints[truth[k].exists].reshape(-1, 9)
            near = np.abs(end[:, None] - branches).max(axis=-1) < 1e-6 * GEOMETRY.middle_side
            found += int(near.any(axis=0).sum())
            converged += int(near.any(axis=1).sum())
        share = converged / (options.poses * options.starts)
        print(
            f"{name:32} {1e6 * seconds / options.starts:9.1f} {100 * share:9.1f}% {found:7d} "
            f"{1e3 * seconds:9.2f} {seconds / unit:7.1f}"
        )
    began = time.perf_counter()
    account = search(GEOMETRY, poses)
    seconds = (time.perf_counter() - began) / options.poses
    print(
        f"\nspm_pin.nlp.search, certified, until 99.9 % sure: {1e3 * seconds:.1f} ms/pose, "
        f"{account.starts.mean():.0f} starts, {int(account.solutions.count.sum())} branches"
    )
    began = time.perf_counter()
    spm.inverse_displacement(GEOMETRY, poses)
    print(f"the closed form: {1e3 * (time.perf_counter() - began) / options.poses:.3f} ms/pose")


if __name__ == "__main__":
    main()
