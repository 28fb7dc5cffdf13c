"""Motion of a machine in time: that of its chain of `spm_pin.loops`, which ends where a leg has no length, too."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.loops import forward_simulation
from spm_pin.loops.closed_chain import ClosedChain as LoopChain
from spm_pin.multibody.constrained_model import ConstrainedModel, TreeKinematics, read_vectors
from spm_pin.multibody.trajectory import increasing_times
from spm_pin.support.arguments import FloatArray

ForceFunction = Callable[[float, FloatArray, FloatArray], npt.ArrayLike]
"""A function of the time, q (nq,) and v (nv,): leg forces (n,), or a wrench (6,)."""

LEAST_CONSTRAINED = 1e-5
"""Smallest singular value of the scaled closures at which a run ends: the forces in the balls grow as its inverse."""
SHORTEST_LEG = 1e-6
"""Length of a leg at which a run ends, in units of the middle platform's side: less has no direction."""


class SimulationEnd(enum.StrEnum):
    """Reason why a simulation ended."""

    COMPLETE = "complete"
    CONSTRAINT_SINGULARITY = "constraint singularity"
    COLLAPSE = "leg of no length"
    STALLED = "stalled"
    """Too fast for any step, for instance where forces are discontinuous or unbounded."""


@dataclass(frozen=True)
class Simulation:
    """A motion of a `ClosedChain` in time, at n times."""

    times: FloatArray
    """The requested times [s], shape (n,), up to the end of the motion; the last may be that of an event."""
    q: FloatArray
    """Joint values, shape (n, nq)."""
    v: FloatArray
    """Joint velocities, shape (n, nv)."""
    a: FloatArray
    """Joint accelerations, shape (n, nv)."""
    readings: FloatArray
    """Readings of the legs' encoders [m] ([rad] for RRS legs), shape (n, legs)."""
    leg_forces: FloatArray
    """Forces of the actuators [N] ([N m] for RRS legs), shape (n, legs); positive increases the reading."""
    kinetic: FloatArray
    """Kinetic energy of all bodies [J], shape (n,)."""
    potential: FloatArray
    """Potential energy of all bodies [J], shape (n,)."""
    work: FloatArray
    """Work of the leg forces and the wrench since the start [J], shape (n,)."""
    closure_gap: FloatArray
    """The widest of the gaps [m], shape (n,)."""
    end: SimulationEnd
    """Reason why it ended there."""
    detail: str
    """The leg, or the reason why no step was possible; may be empty."""
    limit_excess: FloatArray
    """Excess of readings above their limits, or below them (negative), shape (n, legs); 0 within."""

    def __repr__(self) -> str:
        last = f"t = {self.times[-1]:g} s" if self.times.size else "no time"
        return f"<Simulation: {self.times.size} times to {last}, {self.end}>"

    @property
    def complete(self) -> bool:
        """True if the simulation reached the last of the requested times."""
        return self.end is SimulationEnd.COMPLETE

    @property
    def energy(self) -> FloatArray:
        """Kinetic and potential energy [J], shape (n,)."""
        return np.asarray(self.kinetic + self.potential)

    @property
    def energy_error(self) -> FloatArray:
        """Energy gained since the start less the work done [J], shape (n,): zero but for errors of the method."""
        return np.asarray(self.energy - self.energy[0] - self.work)


def run_simulation(
    loops: LoopChain,
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

    events = {names[leg]: length(leg) for leg in lengths.tolist()} | {SimulationEnd.CONSTRAINT_SINGULARITY: margin}
    try:
        motion = forward_simulation.simulate(
            loops,
            q,
            v,
            forces,
            increasing_times(times),
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
        gaps.append(np.linalg.norm(kinematics.gaps(), axis=-1).max())
    end, detail = SimulationEnd.COMPLETE, motion.detail
    if motion.end is forward_simulation.SimulationEnd.STALLED:
        end = SimulationEnd.STALLED
    elif motion.end is forward_simulation.SimulationEnd.EVENT and detail in names:
        end = SimulationEnd.COLLAPSE
    elif not motion.complete:
        end, detail = SimulationEnd.CONSTRAINT_SINGULARITY, ""
    return Simulation(
        times=motion.times,
        q=motion.q,
        v=motion.v,
        a=motion.a,
        readings=readings,
        leg_forces=motion.tau,
        kinetic=motion.kinetic,
        potential=motion.potential,
        work=motion.work,
        closure_gap=np.array(gaps),
        end=end,
        detail=detail,
        limit_excess=excess,
    )
