"""IPOPT on the loop equations: one solver per geometry and set of options, the pose a parameter."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.nlp import loop_equations

_DEFAULTS: dict[str, Any] = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
"""Options that the caller's replace: no output, and the tolerance [m]."""
_INTERRUPTED = ("User_Requested_Stop", "NonIpopt_Exception_Thrown")
"""Statuses after a Ctrl-C, which CasADi swallows during a solve; the functions here throw nothing else."""
_UNUSABLE = ("Invalid_Option", "Invalid_Problem_Definition", "Insufficient_Memory", "Internal_Error")
"""Statuses of options that IPOPT cannot meet."""


class IpoptSolver:
    """The square feasibility problem: no objective, the nine loop equations as constraints.

    Options that IPOPT or CasADi refuses raise `ArgumentError`, some of them only when the solver is called.
    """

    def __init__(self, geometry: Geometry, options: Mapping[str, Any] | None = None) -> None:
        b, pose = ca.SX.sym("b", 9), ca.SX.sym("pose", 12)
        residual = loop_equations.equations(geometry, b, ca.reshape(pose[:9], 3, 3), pose[9:])
        self._options = dict(options or {})
        problem = {"x": b, "p": pose, "f": ca.SX(0), "g": residual}
        try:
            self._solver = ca.nlpsol("inverse", "ipopt", problem, {**_DEFAULTS, **self._options})
        except (RuntimeError, NotImplementedError) as refused:
            reason = str(refused).strip().splitlines()[-1].split(": ", 1)[-1]
            expected = "options of casadi.nlpsol such as {'ipopt.max_iter': 50}"
            raise ArgumentError("options", expected, self._options, reason) from refused

    def __call__(self, starts: FloatArray, matrix: FloatArray) -> tuple[FloatArray, Counter[str]]:
        """Solve from each start (n, 9) [m] for a pose (4, 4).

        Returns where each start ended (n, 9) [m], and how often IPOPT returned which status.
        """
        pose = np.concatenate([matrix[:3, :3].T.ravel(), matrix[:3, 3]])
        ends = np.empty_like(starts)
        outcomes: Counter[str] = Counter()
        for k, start in enumerate(starts):
            try:
                ends[k] = np.asarray(self._solver(x0=start, p=pose, lbg=0.0, ubg=0.0)["x"]).ravel()
            except SystemError as error:
                # At times CasADi leaves the interrupt pending, and Python blames the next call for it.
                if isinstance(error.__cause__, KeyboardInterrupt):
                    raise error.__cause__ from None
                raise
            status = str(self._solver.stats()["return_status"])
            if status in _INTERRUPTED:
                raise KeyboardInterrupt
            if status in _UNUSABLE:
                raise ArgumentError("options", "options that this IPOPT can meet", self._options, status)
            outcomes[status] += 1
        return ends, outcomes
