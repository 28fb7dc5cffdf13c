"""Motion of a machine in time: that of its chain of `spm_pin.loops`, which ends where a leg has no length, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.loops.forward_simulation import LoopMotion, SimulationEnd, simulate
from spm_pin.multibody.constrained_model import ConstrainedModel, TreeKinematics, read_vectors, widest
from spm_pin.support.arguments import FloatArray

ForceFunction = Callable[[float, FloatArray, FloatArray], npt.ArrayLike]
"""A function of the time, q (nq,) and v (nv,): leg forces (n,), or a wrench (6,)."""

LEAST_CONSTRAINED = 1e-5
"""Smallest singular value of the scaled closures at which a run ends: the forces in the balls grow as its inverse."""
SHORTEST_LEG = 1e-6
"""Length of a leg at which a run ends, in units of the middle platform's side: less has no direction."""


@dataclass(frozen=True, repr=False)
class Simulation(LoopMotion):
    """A motion of a `ClosedChain` in time, at k times.

    A leg of no length ends it as an event, whose `detail` is the name of the leg.
    """

    readings: FloatArray
    """Readings of the legs' encoders [m] ([rad] for RRS legs), shape (k, legs)."""
    closure_gap: FloatArray
    """The widest of the gaps [m], shape (k,)."""
    limit_excess: FloatArray
    """Excess of readings above their limits, or below them (negative), shape (k, legs); 0 within."""

    @property
    def leg_forces(self) -> FloatArray:
        """Forces of the actuators [N] ([N m] for RRS legs), shape (k, legs); positive increases the reading."""
        return self.tau


def run_simulation(
    constrained: ConstrainedModel,
    q0: npt.ArrayLike,
    v0: npt.ArrayLike,
    times: npt.ArrayLike,
    forces: npt.ArrayLike | ForceFunction | None,
    wrench: npt.ArrayLike | ForceFunction | None,
    period: float | None,
    tolerance: float,
) -> Simulation:
    """Integrate the motion; see `ClosedChain.simulate`."""
    q, v = constrained.read_q(q0, "q0", single=True), read_vectors(v0, "v0", constrained.model.nv, single=True)
    kinematics = TreeKinematics(constrained)
    kinematics.evaluate(q)
    kinematics.check_closed(v, "v0")
    names, lengths = constrained.machine.legs.names, np.flatnonzero(np.isfinite(constrained.least_readings))

    def length(leg: int) -> Callable[[FloatArray], float]:
        least = constrained.least_readings[leg] + SHORTEST_LEG * constrained.side
        return lambda q: float(constrained.readings(q)[leg] - least)

    def margin(q: FloatArray) -> float:
        kinematics.evaluate(q)
        kinematics.check_ball_angles()
        return float(np.linalg.svd(kinematics.scaled_constraint_jacobian(), compute_uv=False)[-1]) - LEAST_CONSTRAINED

    events = {names[leg]: length(leg) for leg in lengths.tolist()} | {str(SimulationEnd.SINGULARITY): margin}
    try:
        motion = simulate(
            constrained.loops,
            q,
            v,
            forces,
            times,
            wrenches=None if wrench is None else {constrained.platform: wrench},
            events=events,
            period=period,
            tolerance=tolerance,
        )
    except ArgumentError as error:
        named = {"tau": "forces", "wrenches": "wrench"}.get(error.argument, error.argument)
        raise error.replaced(argument=named, index="") from error
    own = constrained.readings(motion.q)
    readings, limits = own + constrained.machine.legs.offsets, constrained.machine.limits
    excess = np.zeros(readings.shape) if limits is None else limits.excess(readings)
    gaps = []
    for joints in motion.q:
        kinematics.evaluate(joints)
        gaps.append(widest(kinematics.residual))
    if motion.detail == SimulationEnd.SINGULARITY:
        motion = replace(motion, end=SimulationEnd.SINGULARITY, detail="")
    return Simulation(**vars(motion), readings=readings, closure_gap=np.array(gaps), limit_excess=excess)
