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

__all__ = ["INTERRUPTED", "QUIET", "Ipopt", "build", "status_of"]

QUIET: dict[str, Any] = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
# CasADi swallows a Ctrl-C during a solve and reports it by these alone; the functions here throw nothing else.
INTERRUPTED = ("User_Requested_Stop", "NonIpopt_Exception_Thrown")
_UNUSABLE = ("Invalid_Option", "Invalid_Problem_Definition", "Insufficient_Memory", "Internal_Error")


def build(name: str, problem: dict[str, ca.SX], options: Mapping[str, Any] | None, defaults: dict[str, Any]) -> Any:
    """Make an IPOPT solver that prints nothing.

    Raises
    ------
    ArgumentError
        If IPOPT or CasADi refuses an option.
    """
    chosen = {**QUIET, **defaults, **(options or {})}
    try:
        return ca.nlpsol(name, "ipopt", problem, chosen)
    except (RuntimeError, NotImplementedError) as refused:
        reason = str(refused).strip().splitlines()[-1].split(": ", 1)[-1]
        raise ArgumentError(
            "options", "options of casadi.nlpsol such as {'ipopt.max_iter': 50}", options, reason
        ) from (refused)


def status_of(solver: Any, options: Mapping[str, Any] | None) -> str:
    """Return how the last call of a solver ended.

    Raises
    ------
    ArgumentError
        If IPOPT found out only now that an option cannot be met, such as a linear solver it lacks.
    KeyboardInterrupt
        If it was stopped from outside.
    """
    status = str(solver.stats()["return_status"])
    if status in INTERRUPTED:
        raise KeyboardInterrupt
    if status in _UNUSABLE:
        raise ArgumentError("options", "options that this IPOPT can meet", dict(options or {}), status)
    return status


class Ipopt:
    """The square feasibility problem: no objective, the nine loop equations as constraints."""

    def __init__(self, geometry: Geometry, options: Mapping[str, Any] | None = None) -> None:
        b, pose = ca.SX.sym("b", 9), ca.SX.sym("pose", 12)
        residual = loop_equations.equations(geometry, b, ca.reshape(pose[:9], 3, 3), pose[9:])
        self._options = options
        self._solver = build(
            "inverse", {"x": b, "p": pose, "f": ca.SX(0), "g": residual}, options, {"ipopt.tol": 1e-10}
        )

    def __call__(self, starts: FloatArray, matrix: FloatArray) -> tuple[FloatArray, Counter[str]]:
        """Solve from each start (n, 9) [m]; return where it ended (n, 9) and how often IPOPT ended how."""
        pose = np.concatenate([matrix[:3, :3].T.ravel(), matrix[:3, 3]])
        ends = np.empty_like(starts)
        outcomes: Counter[str] = Counter()
        for k, start in enumerate(starts):
            ends[k] = np.asarray(self._solver(x0=start, p=pose, lbg=0.0, ubg=0.0)["x"]).ravel()
            outcomes[status_of(self._solver, self._options)] += 1
        return ends, outcomes
