"""Forward displacement: the package's solvers and general ones, on the same leg lengths in one run.

General ones, per stage on its three distance equations in the legs' angles:

- scipy.optimize.root from random angles, until no start of as many as found the last one brings a new solution;
- scipy.optimize.root once, from equal legs, for the physical one;
- Newton's method on Pinocchio's closures, from the home, with the legs held (`ClosedChain.project`), for the same;
- a polynomial solver: elimination to degree 16 and the isolation of its roots (python-flint), which gives one
  coordinate of every solution, in certified digits.

`python benchmarks/forward.py` takes some ten seconds; `--problems 200` is steadier.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import root

import spm_pin as spm
from spm_pin.closed_form.forward import forward_displacement, forward_physical

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from stage_oracle import certified_modes

GEOMETRY = spm.Geometry.paper()
HIPS = (GEOMETRY.base_radius, GEOMETRY.platform_radius)


def sides(theta: np.ndarray, lengths: np.ndarray, hips: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the three squared sides and their Jacobian."""
    rho, z = hips + lengths * np.cos(theta), lengths * np.sin(theta)
    rho2, z2 = np.roll(rho, -1), np.roll(z, -1)
    gap = rho**2 + rho2**2 + rho * rho2 + (z - z2) ** 2 - GEOMETRY.middle_side**2
    own = -(2 * rho + rho2) * z + 2 * (z - z2) * (rho - hips)
    following = -(2 * rho2 + rho) * z2 - 2 * (z - z2) * (rho2 - hips)
    return gap, np.diag(own) + np.roll(np.diag(following), 1, axis=1)


def stage_by_multistart(lengths: np.ndarray, hips: float, rng: np.random.Generator) -> int:
    """Return how many solutions of one stage random starts find."""
    found: list[np.ndarray] = []
    tried, last = 0, 0
    while tried < max(50, 2 * last):
        tried += 1
        answer = root(sides, rng.uniform(-np.pi, np.pi, 3), args=(lengths, hips), jac=True)
        if not answer.success or np.abs(answer.fun).max() > 1e-9:
            continue
        point = np.concatenate([np.cos(answer.x), np.sin(answer.x)])
        if all(np.abs(point - other).max() > 1e-5 for other in found):
            found.append(point)
            last = tried
    return len(found)


def multistart(lengths: np.ndarray) -> int:
    """Return how many assembly modes random starts find."""
    rng = np.random.default_rng(0)
    return stage_by_multistart(lengths[:3], HIPS[0], rng) * stage_by_multistart(lengths[3:], HIPS[1], rng)


def newton_from_equal_legs(lengths: np.ndarray) -> int:
    """Return whether the angles of the level platform lead to a solution, which need not be the physical one."""
    good = True
    for part, hips in zip((lengths[:3], lengths[3:]), HIPS, strict=True):
        start = np.arccos((GEOMETRY.middle_radius - hips) / part)
        good &= bool(root(sides, start, args=(part, hips), jac=True).success)
    return int(good)


def polynomial(lengths: np.ndarray) -> int:
    """Return the number of assembly modes by elimination."""
    counts = [
        certified_modes(part, hips, GEOMETRY.middle_side)
        for part, hips in zip((lengths[:3], lengths[3:]), HIPS, strict=True)
    ]
    return int(np.prod([count or 0 for count in counts]))


def one_by_one(solve: Callable[[np.ndarray], int], problems: np.ndarray) -> tuple[float, int]:
    """Return the time per problem [s] and the number of solutions found."""
    begin = time.perf_counter()
    found = sum(solve(lengths) for lengths in problems)
    return (time.perf_counter() - begin) / len(problems), found


def batched(solve: Callable[[np.ndarray], int], problems: np.ndarray, repeat: int) -> tuple[float, int]:
    """Return the time per problem [s] of one call with many, and the number of solutions of the first ones."""
    many = np.tile(problems, (repeat, 1))
    begin = time.perf_counter()
    solve(many)
    return (time.perf_counter() - begin) / len(many), solve(problems)


def main() -> None:
    """Print the times and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=10, help="how many sets of leg lengths (10)")
    count = parser.parse_args().problems
    problems = np.random.default_rng(1).uniform(1.1, 1.5, (count, 6))

    def modes(lengths: np.ndarray) -> int:
        return int(forward_displacement(GEOMETRY, lengths).count.sum())

    def physical(lengths: np.ndarray) -> int:
        return int(np.count_nonzero(forward_physical(GEOMETRY, lengths).exists))

    forward_displacement(GEOMETRY, problems[0])
    repeat = max(1, 1000 // count)
    every = {
        "forward_displacement, many at once": batched(modes, problems, repeat),
        "forward_displacement, one by one": one_by_one(modes, problems),
        "elimination and root isolation": one_by_one(polynomial, problems),
        "scipy root, multistart": one_by_one(multistart, problems),
    }
    chain = spm.ClosedChain.from_urdf()
    memory, home = chain.workspace(), np.zeros(chain.model.nq)

    def projected(lengths: np.ndarray) -> int:
        chain.project(chain.with_leg_lengths(home, lengths), hold_legs=True, workspace=memory)
        return 1

    only = {
        "forward_physical, many at once": batched(physical, problems, 10 * repeat),
        "forward_physical, one by one": one_by_one(physical, problems),
        "scipy root, from equal legs": one_by_one(newton_from_equal_legs, problems),
        "Pinocchio's closures, from home": one_by_one(projected, problems),
    }
    for title, results in (("All assembly modes", every), ("The physical one", only)):
        fastest = next(iter(results.values()))[0]
        print(f"{title}, {count} sets of leg lengths")
        for name, (seconds, found) in results.items():
            print(f"  {name:36} {1e6 * seconds:12.1f} µs  {seconds / fastest:9.1f} x  {found:6} solutions")


if __name__ == "__main__":
    main()
