"""From one closed configuration to another without leaving the mode: Newton's method in steps that a theorem accepts.

On the way a share s from 0 to 1 of the change of the driven joints, or of the target's pose, is done. Unknown are the
other joints x, and the equations c(x, s) = 0 have a Jacobian J of full column rank: it may have more rows than columns,
of which some depend on others. With A = (Jᵀ J)⁻¹ Jᵀ at the end of a step, A c(x, s) = 0 has as many equations as
unknowns, and Krawczyk's theorem says where it has one solution. Where a box of radii r about the chord from the start
to the end of the step, at every s, satisfies

    |A c| + |A J - 1| r < r,

one branch of solutions leads from the start to the end, J is regular all along, and no other solution is in the box:
neither a fold nor another mode. All quantities are dimensionless, absolute values are of each element. Bounds:

- c vanishes at both ends and is computed in the middle, J is computed at both ends. In between, c differs from a
  parabola by at most 0.0081 of a bound of its third derivative, J from a straight line by 1/8 of that of its second.
- Let a joint i turn frame 2 of a closure by ρ_i and move its point by τ_i, per unit, at the end of the step. A joint
  nearer to frame 1 only turns what the others do: |∂²p/∂x_i∂x_j| <= ρ_i τ_j, with the farther one as j. For
  displacements u and w, with ρ(u) = Σ ρ_i |u_i| and τ(u) alike, second derivatives are at most ρ(u) τ(w) + ρ(w) τ(u),
  of angles ρ(u) ρ(w), third ones are alike, and on the way τ_i grows by at most e^ρ τ of all the displacement.

The theorem is for hinges and slides. In ball and free joints, whose rotations do not commute, and in joint equalities
of a degree above one, whose curvature is not in the bounds, it is a rule of thumb. Where c = 0 has rows that depend on
others, a solution of A c = 0 is one of c = 0 as long as they do so; that c is zero is checked at the end of each step.

The functions are compiled for a tree of arrays, and interpreted over Pinocchio: `make_follower` takes what they differ
in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

DONE, SINGULAR_START, NO_FURTHER, OPEN_START = 0, 1, 2, 3
"""How a path ends: at its target; nowhere, since the unknown joints are not determined; in between; or nowhere, since
the loops are open at its start."""
LONGEST = 1.0
"""Largest step tried in any joint, dimensionless: in rad, or in units of `ConstraintRows.units`."""
SHORTEST_STEP = 1e-7
"""Size of a step, dimensionless, below which a path ends: nearer to a singularity rounding is no small part of it."""
SHORTEST_SHARE = 2.0**-36
MOST_CORRECTIONS = 12
CLOSED, ROUNDED = 1e-10, 1e-9
"""Loops are closed if their equations, dimensionless, hold to `CLOSED`; mostly they do so to rounding, a few 1e-16. At
the start of a path, joint values that were rounded are taken for closed to `ROUNDED`."""
ROUNDING = 1e-15


def same(function: Any) -> Any:
    """Return the function: it is interpreted."""
    return function


def make_follower(
    residual: Callable[..., Any],
    linearised: Callable[..., Any],
    moved: Callable[..., Any],
    left_inverse: Callable[..., Any],
    jit: Callable[[Any], Any] = same,
) -> Callable[..., Any]:
    """Return `follow(problem, q)`, which leads from a closed q to the problem's target.

    Parameters
    ----------
    residual : callable
        c (m,) of (problem, q, s).
    linearised : callable
        c, J (m, p), and speeds and turns (closures, nv) of (problem, q, s).
    moved : callable
        q of (problem, q, s, x): after unknown joints have moved by x (p,) from q, and with driven joints at s.
    left_inverse : callable
        A (p, m) of J, and whether J is of full column rank.
    jit : callable
        Applied to each function: Numba's compiler, or nothing.
    """

    @jit
    def is_safe(problem, middle, jacobian, inverse, speeds, turns, x, share):  # type: ignore[no-untyped-def]
        """Return the left side of Krawczyk's inequality as a share of the right one; a step is safe below 1."""
        unknown = problem.columns
        moved_by = np.abs(problem.driven_rates) * share
        moved_by[unknown] = np.abs(x)
        rho, tau = turns @ moved_by, speeds @ moved_by
        # A pose to be reached turns like one joint more.
        if problem.pose >= 0:
            rho[problem.pose] += problem.pose_turn * share
        position = np.empty((len(unknown), len(problem.first_rows)))
        rotation = np.empty((len(unknown), len(problem.first_rows)))
        for k in range(len(problem.first_rows)):
            first = problem.first_rows[k]
            between, last = first + problem.position_counts[k], first + problem.row_counts[k]
            position[:, k] = np.sqrt((inverse[:, first:between] ** 2).sum(axis=1))
            rotation[:, k] = np.abs(inverse[:, between:last]).sum(axis=1)
        cubic = position @ (3.0 * rho * rho * tau) + rotation @ (rho * rho * rho)
        eta = np.abs(inverse @ middle) + 0.0081 * cubic + ROUNDING
        radii = 2.0 * eta + 0.5 * eta.max()
        wide = np.zeros(len(moved_by))
        wide[unknown] = radii
        rho_r, tau_r = turns @ wide, speeds @ wide
        growth = np.exp(rho + rho_r) * (tau + tau_r)
        tau, tau_r = tau + growth * rho, tau_r + growth * rho_r
        cubic = position @ (3.0 * rho * rho * tau) + rotation @ (rho * rho * rho)
        eta = np.abs(inverse @ middle) + 0.0081 * cubic + ROUNDING
        change = inverse @ jacobian
        for k in range(len(radii)):
            change[k, k] -= 1.0
        spread = np.abs(change) @ radii
        spread += position @ (0.125 * (rho * rho * tau_r + 2.0 * rho * rho_r * tau) + 2.0 * rho_r * tau_r)
        spread += rotation @ (0.125 * rho * rho * rho_r + rho_r * rho_r)
        return ((eta + spread) / radii).max()

    @jit
    def step(problem, q, done, share, jacobian, inverse):  # type: ignore[no-untyped-def]
        """Return whether a step has converged, q, J and A at its end, its size, and the share of `is_safe`."""
        end = done + share
        if end > 1.0 - 1e-12:
            end = 1.0
        x = np.zeros(len(problem.columns))
        tried = moved(problem, q, end, x)
        change = -(inverse @ residual(problem, tried, end))
        size = np.abs(change).max() if len(change) else 0.0
        if not size <= LONGEST:
            return False, q, jacobian, inverse, size, 2.0 * size
        x += change
        tried = moved(problem, tried, end, change)
        c, at_end, speeds, turns = linearised(problem, tried, end)
        new, regular = left_inverse(at_end)
        if not regular:
            return False, q, jacobian, inverse, size, 4.0
        last = np.inf
        for _ in range(MOST_CORRECTIONS):
            change = -(new @ c)
            correction = np.abs(change).max() if len(change) else 0.0
            if not correction <= 0.5 * last or correction <= ROUNDING:
                break
            x += change
            tried = moved(problem, tried, end, change)
            c = residual(problem, tried, end)
            last = correction
        if not (correction <= 1e-9 and (len(c) == 0 or np.abs(c).max() <= CLOSED)):
            return False, q, jacobian, inverse, size, 4.0
        if size <= 1e-12 or len(x) == 0:
            return True, tried, at_end, new, size, 0.0
        half = 0.5 * (done + end)
        middle = residual(problem, moved(problem, q, half, 0.5 * x), half)
        used = is_safe(problem, middle, jacobian, new, speeds, turns, x, end - done)
        return used <= 1.0, tried, at_end, new, size, used

    @jit
    def follow(problem, q):  # type: ignore[no-untyped-def]
        """Return q at the end of the path, or as far as it leads, the status, the share of the path, and the steps."""
        c, jacobian, _, _ = linearised(problem, q, 0.0)
        if len(c) > 0 and not np.abs(c).max() <= ROUNDED:
            return q, OPEN_START, 0.0, 0
        inverse, regular = left_inverse(jacobian)
        if not regular:
            return q, SINGULAR_START, 0.0, 0
        done, share, steps = 0.0, 1.0, 0
        while done < 1.0:
            share = min(share, 1.0 - done)
            accepted, end, at_end, new, size, used = step(problem, q, done, share, jacobian, inverse)
            steps += 1
            if accepted:
                q, jacobian, inverse = end, at_end, new
                done += share
                if done > 1.0 - 1e-12:
                    done = 1.0
                # What is used of the bounds grows with the step: the next one is to use most of it.
                share *= min(4.0, 0.7 / max(used, 0.1))
                continue
            share *= max(0.1, min(0.5, 0.7 / used)) if used == used else 0.1
            if share < SHORTEST_SHARE or size < SHORTEST_STEP:
                return q, NO_FURTHER, done, steps
        return q, DONE, done, steps

    following: Callable[..., Any] = follow
    return following
