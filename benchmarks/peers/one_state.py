"""Dynamics of one state by Pinocchio alone: the calls and the matrices that the package makes, and no checks."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import lapack

from benchmarks.peers.peer import FloatArray


class PlainPinocchio:
    """Calls to Pinocchio as a user of its Python interface writes them for a chain with four closures.

    Parameters
    ----------
    chain : ClosedChain
        Whose model, closures and legs these are.
    """

    def __init__(self, chain: Any) -> None:
        import pinocchio as pin

        self.pin, self.model = pin, chain.model
        self.data, self.solver_data = pin.Data(chain.model), pin.Data(chain.model)
        names = sorted({name for closure in chain.closures for name in (closure.frame_a, closure.frame_b)})
        self.frames = [chain.model.getFrameId(name) for name in names]
        self.pairs = [(names.index(c.frame_a), names.index(c.frame_b)) for c in chain.closures]
        self.legs = chain.leg_indices
        self.passive = np.setdiff1d(np.arange(chain.model.nv), self.legs)
        self.constraints, self.solver_states = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for a, b in self.pairs:
            ends = [chain.model.frames[self.frames[k]] for k in (a, b)]
            places = ends[0].parentJoint, ends[0].placement, ends[1].parentJoint, ends[1].placement
            self.constraints.append(
                pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self.model, *places, pin.LOCAL)
            )
            self.solver_states.append(self.constraints[-1].createData())
        pin.initConstraintDynamics(self.model, self.solver_data, self.constraints, self.solver_states)
        self.settings = pin.ProximalSettings(0.0, 0.0, 1)
        self.still = np.zeros(self.model.nv)

    def closures(self, q: FloatArray) -> FloatArray:
        """Return the Jacobian of the closures (12, 18), after the kinematics of frames at q."""
        pin, model, data = self.pin, self.model, self.data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        rows = [pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3] for frame in self.frames]
        return np.concatenate([rows[b] - rows[a] for a, b in self.pairs])

    def gaps(self, q: FloatArray) -> FloatArray:
        """Return by how much the closures are open at q (12,)."""
        pin, model, data = self.pin, self.model, self.data
        pin.framesForwardKinematics(model, data, q)
        places = [data.oMf[frame].translation for frame in self.frames]
        return np.concatenate([places[b] - places[a] for a, b in self.pairs])

    def forward(self, q: FloatArray, v: FloatArray, forces: FloatArray) -> FloatArray:
        """Return joint accelerations (18,) under leg forces (6,)."""
        lapack.dgetrf(self.closures(q)[:, self.passive])
        torques = np.zeros(self.model.nv)
        torques[self.legs] = forces
        constraints = self.constraints, self.solver_states, self.settings
        return np.array(self.pin.constraintDynamics(self.model, self.solver_data, q, v, torques, *constraints))

    def inverse(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the leg forces (6,) of joint accelerations (18,)."""
        pin, model, data = self.pin, self.model, self.data
        closures = self.closures(q)
        pin.forwardKinematics(model, data, q, v, self.still)
        rates = [
            pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
            for frame in self.frames
        ]
        np.concatenate([rates[b] - rates[a] for a, b in self.pairs])
        torques = pin.rnea(model, data, q, v, a)
        lu, pivots, _ = lapack.dgetrf(closures[:, self.passive])
        cuts = lapack.dgetrs(lu, pivots, torques[self.passive], trans=1)[0]
        return np.asarray(torques[self.legs] - cuts @ closures[:, self.legs])
