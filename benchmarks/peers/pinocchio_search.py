"""Pinocchio: Newton's method on the closed chain, all joints of the tree unknown, the platform held in the pose.

The twelve gaps of the closures and the six errors of the platform's pose, with Pinocchio's frame Jacobians.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.multistart import STARTS, branches
from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin import Manipulator

STEPS = 60
LONGEST = 1.0
"""Longest step in any joint [rad, m]."""
CLOSED = 1e-13


def newton(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare Newton from random joint values, pose by pose."""
    pin: Any = required("pinocchio", "pin")
    from spm_pin.multibody.chain import ClosedChain

    machine, poses = problem
    chain = ClosedChain.from_urdf(machine=machine)
    model = chain.model
    data = model.createData()
    platform = model.getFrameId("terminal_platform")
    corners = [model.getFrameId(f"middle_b{i}") for i in "123"]
    ends = [[model.getFrameId(name) for name in (closure.frame_a, closure.frame_b)] for closure in chain.closures]

    def system(q: FloatArray, wanted: Any) -> tuple[FloatArray, FloatArray]:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        error = wanted.actInv(data.oMf[platform])
        parts, rows = (
            [pin.log6(error).vector],
            [pin.Jlog6(error) @ pin.getFrameJacobian(model, data, platform, pin.LOCAL)],
        )
        for a, b in ends:
            parts.append(data.oMf[b].translation - data.oMf[a].translation)
            both = (pin.getFrameJacobian(model, data, end, pin.LOCAL_WORLD_ALIGNED)[:3] for end in (b, a))
            rows.append(next(both) - next(both))
        return np.concatenate(parts), np.concatenate(rows)

    def solve(matrix: FloatArray, starts: FloatArray) -> FloatArray:
        wanted = pin.SE3(matrix)
        found = np.full((len(starts), 9), np.nan)
        for k, start in enumerate(starts):
            q = start
            for _ in range(STEPS):
                gap, jacobian = system(q, wanted)
                if np.abs(gap).max() <= CLOSED:
                    found[k] = np.concatenate([data.oMf[corner].translation for corner in corners])
                    break
                try:
                    step = np.linalg.solve(jacobian, gap)
                except np.linalg.LinAlgError:
                    break
                q = q - step * min(1.0, LONGEST / float(np.abs(step).max()))
        return found

    rng = np.random.default_rng(0)
    starts = rng.uniform(-np.pi, np.pi, (len(poses), STARTS, model.nq))
    starts[:, :, chain.leg_indices] = rng.uniform(-machine.middle_side, machine.middle_side, (len(poses), STARTS, 6))
    matrices = poses.as_matrix()

    def read(answers: list[FloatArray]) -> list[FloatArray]:
        return [branches(machine, matrix, found) for matrix, found in zip(matrices, answers, strict=True)]

    return Prepared(lambda: [solve(matrix, guesses) for matrix, guesses in zip(matrices, starts, strict=True)], read)
