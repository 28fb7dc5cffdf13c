"""The peers of each task; the first of each is this package."""

from __future__ import annotations

from benchmarks.peers import (
    assembly_modes,
    c_loop,
    casadi_search,
    certified,
    exported,
    gp3p,
    jacobians,
    octic,
    package,
    pinocchio_search,
    scipy_search,
)
from benchmarks.peers.multistart import STARTS
from benchmarks.peers.peer import Peer

OURS = "spm_pin"
"""Name of this package's public function in every task."""

PACKAGES = ("numpy", "scipy", "numba", "poselib", "casadi", "pin", "python-flint", "eaik", "pycapacity", "mink", "jax")
"""Distributions whose versions a result depends on."""

# Problem: (machine, poses (n,)). Read as the branches of each pose, (k, 3, 3) [m], NaN where only b_2 is known.
INVERSE = (
    Peer(OURS, "`inverse_displacement`: all branches, b_1 to b_3, six lengths, status", package.inverse, 10_000),
    Peer("spm_pin, kernel alone", "the same, compiled loop, into the same arrays each time", package.kernel, 10_000),
    Peer("C loop", "the same, four quadratics in plain C, into the same arrays each time", c_loop.answered, 10_000),
    Peer("C loop, new arrays", "the same, into newly allocated arrays", c_loop.fresh, 10_000),
    Peer("C loop, exported", "`spm-pin export c`, pose by pose, -O2, with its checks", exported.answered, 10_000),
    Peer("poselib.gp3p, bare", "the call alone, lines made beforehand: platform poses", gp3p.bare, 1_000),
    Peer("poselib.gp3p", "lines, call, b_1 to b_3 and lengths, in Python", gp3p.complete, 200),
    Peer("numpy.roots, bare", "roots of the octic, coefficients made beforehand", octic.numpy_roots, 200),
    Peer("numpy.roots", "coefficients from the pose, and roots", octic.numpy_roots_complete, 50),
    Peer("companion matrices", "numpy.linalg.eigvals, stacked, coefficients made beforehand", octic.companions, 2_000),
    Peer(
        "the paper's route",
        "`crosscheck.paper`: Eqs. (5)–(20), refined, all branches",
        package.paper_inverse,
        200,
    ),
    Peer("python-flint", "the octic's roots in ball arithmetic: certified b_2", certified.roots, 20),
    Peer("CasADi Newton, compiled", f"{STARTS} starts, generated C, mapped", casadi_search.compiled_newton, 20),
    Peer(
        "CasADi Newton, mapped",
        f"{STARTS} starts, `crosscheck.nlp.batched_newton`",
        casadi_search.mapped_newton,
        4,
    ),
    Peer("CasADi IPOPT", f"{STARTS} starts", casadi_search.ipopt, 1),
    Peer("SciPy fsolve", f"{STARTS} starts", scipy_search.by_fsolve, 1),
    Peer("SciPy least_squares", f"{STARTS} starts, Levenberg–Marquardt", scipy_search.by_least_squares, 1),
    Peer("Pinocchio Newton", f"{STARTS} starts, closed chain, 18 joints", pinocchio_search.newton, 1),
)

# Problem: (machine as built, its two balls at a corner coincident, poses (n,)). Read as for `INVERSE`.
AS_BUILT = (
    Peer(OURS, "`inverse_displacement`: all branches under their labels, six lengths, status", package.inverse, 10_000),
    Peer("spm_pin, physical branch", "`inverse_physical`", package.inverse_physical, 10_000),
    Peer("poselib.gp3p, bare", "the call alone, lines made beforehand: platform poses", gp3p.bare, 1_000),
)

# Problem: Configuration (n,). Read as J_f (n, 6, 6).
JACOBIAN = (
    Peer(OURS, "`inverse_jacobian`", package.jacobian, 10_000),
    Peer("NumPy 9 × 9, bare", "stacked solve of Eq. (30b), matrices made beforehand", jacobians.nine_by_nine, 2_000),
    Peer("NumPy 9 × 9", "matrices from the states, and the solve", jacobians.nine_by_nine_complete, 2_000),
    Peer("Pinocchio", "constraint Jacobians, state by state", jacobians.pinocchio, 100),
)

# Problem: (Configuration (n,), wrenches (n, 6)). Read as leg forces (n, 6) [N].
FORCES = (
    Peer(OURS, "`leg_forces`", package.forces, 10_000),
    Peer(
        "NumPy 9 × 9, bare",
        "stacked 9 × 9 and 6 × 6, matrices made beforehand",
        jacobians.forces_by_nine_by_nine,
        2_000,
    ),
    Peer("NumPy 9 × 9", "matrices from the states, both solves", jacobians.forces_by_nine_by_nine_complete, 2_000),
    Peer("Pinocchio", "constraint Jacobians, state by state", jacobians.forces_by_pinocchio, 100),
)

# Problem: (machine, leg lengths (n, 6)). Read as b_1 to b_3, (n, 3, 3) [m], NaN where none was found.
PHYSICAL = (
    Peer(OURS, "`forward_physical`", package.physical, 10_000),
    Peer("SciPy fsolve", "once per stage, from level platforms", assembly_modes.newton_from_equal_legs, 50),
    Peer("Pinocchio", "`ClosedChain.project` from the home, legs held", assembly_modes.pinocchio, 50),
)

# Problem: (machine, leg lengths (n, 6)). Read as the number of real assembly modes (n,).
MODES = (
    Peer(OURS, "`forward_displacement`: all modes, poses and joints", package.modes, 500),
    Peer("python-flint", "degree 16 per stage, roots isolated: the number, certified", assembly_modes.certified, 4),
    Peer(
        "SciPy multi-start",
        "fsolve until as many starts again find nothing new",
        assembly_modes.multistart,
        2,
    ),
)
