"""Result of a simulation: the motion in time, and the reason of its end."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from spm_pin.mechanism.arguments import FloatArray

__all__ = ["Simulation", "SimulationEnd"]


class SimulationEnd(enum.StrEnum):
    """Why a simulation ended."""

    COMPLETE = "complete"
    LIMIT = "leg limit"
    INVERSE_SINGULARITY = "inverse singularity"
    FORWARD_SINGULARITY = "forward singularity"
    CONSTRAINT_SINGULARITY = "constraint singularity"
    COLLAPSE = "leg of no length"
    STOPPED = "stopped"
    STALLED = "stalled"


@dataclass(frozen=True)
class Simulation:
    """A motion of a `ClosedChain` in time.

    Attributes
    ----------
    times : ndarray, shape (n,)
        The requested times [s], as far as the motion went; the last is that of the event, if one ended it.
    q, v, a : ndarray, shape (n, 18)
        Joint values, velocities and accelerations.
    leg_lengths : ndarray, shape (n, 6)
        [m].
    leg_forces : ndarray, shape (n, 6)
        What the actuators gave [N]; positive pushes.
    kinetic, potential : ndarray, shape (n,)
        Energy of all bodies [J].
    work : ndarray, shape (n,)
        Of the leg forces and the wrenches since the start [J].
    closure_gap : ndarray, shape (n,)
        The widest of the four gaps [m].
    end : SimulationEnd
        Why it ended there. STALLED: the motion became too fast for any step, as where forces are discontinuous or
        have no bound.
    detail : str
        Which leg and which limit; empty if there is nothing to say.
    steps, evaluations : int
        Steps of the integrator, evaluations of the forward dynamics.
    """

    times: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    leg_lengths: FloatArray
    leg_forces: FloatArray
    kinetic: FloatArray
    potential: FloatArray
    work: FloatArray
    closure_gap: FloatArray
    end: SimulationEnd
    detail: str
    steps: int
    evaluations: int

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
