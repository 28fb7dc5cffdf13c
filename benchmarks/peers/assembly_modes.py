"""Forward displacement by other methods: per stage, on its three distance equations in the angles of the legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import fsolve

from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin import Manipulator

CLOSED = 1e-9


@dataclass(frozen=True)
class Found:
    """Assembly modes of one set of leg lengths: solutions of the two stages and the starts they took."""

    stages: tuple[int, int]
    starts: int

    @property
    def modes(self) -> int:
        """Number of assembly modes: every solution of one stage goes with every solution of the other."""
        return self.stages[0] * self.stages[1]


def sides(theta: FloatArray, lengths: FloatArray, hip: float, side: float) -> FloatArray:
    """Return the errors of the three squared sides [m²] at leg angles theta (3,)."""
    rho, z = hip + lengths * np.cos(theta), lengths * np.sin(theta)
    rho2, z2 = rho[[1, 2, 0]], z[[1, 2, 0]]
    return np.asarray(rho**2 + rho2**2 + rho * rho2 + (z - z2) ** 2 - side**2)


def slopes(theta: FloatArray, lengths: FloatArray, hip: float, side: float) -> FloatArray:
    """Return the Jacobian (3, 3) of `sides`."""
    x, z = lengths * np.cos(theta), lengths * np.sin(theta)
    rho = hip + x
    jacobian = np.zeros((3, 3))
    for k in range(3):
        j = (k + 1) % 3
        jacobian[k, k] = -(2 * rho[k] + rho[j]) * z[k] + 2 * (z[k] - z[j]) * x[k]
        jacobian[k, j] = -(2 * rho[j] + rho[k]) * z[j] - 2 * (z[k] - z[j]) * x[j]
    return jacobian


def multistart(problem: tuple[Manipulator, FloatArray]) -> Prepared:
    """Prepare fsolve from random angles, until no start of as many as found the last solution brings a new one."""
    machine, problems = problem

    def stage(lengths: FloatArray, hip: float, rng: np.random.Generator) -> tuple[int, int]:
        found: list[FloatArray] = []
        tried = last = 0
        while tried < max(50, 2 * last):
            tried += 1
            theta, good = _fsolve(rng.uniform(-np.pi, np.pi, 3), lengths, hip, machine.middle_side)
            if not good:
                continue
            point = np.concatenate([np.cos(theta), np.sin(theta)])
            if all(np.abs(point - other).max() > 1e-5 for other in found):
                found.append(point)
                last = tried
        return len(found), tried

    def solve(lengths: FloatArray) -> Found:
        rng = np.random.default_rng(0)
        lower = stage(lengths[:3], machine.base_radius, rng)
        upper = stage(lengths[3:], machine.platform_radius, rng)
        return Found((lower[0], upper[0]), lower[1] + upper[1])

    return Prepared(
        lambda: [solve(lengths) for lengths in problems], lambda found: np.array([each.modes for each in found])
    )


def certified(problem: tuple[Manipulator, FloatArray]) -> Prepared:
    """Prepare the number of modes, proved: elimination to degree 16, roots isolated by python-flint."""
    machine, problems = problem
    required("flint", "python-flint")
    from stage_oracle import certified_modes

    def solve(lengths: FloatArray) -> int:
        lower = certified_modes(lengths[:3], machine.base_radius, machine.middle_side)
        upper = certified_modes(lengths[3:], machine.platform_radius, machine.middle_side)
        return -1 if lower is None or upper is None else lower * upper

    return Prepared(lambda: [solve(lengths) for lengths in problems], np.array)


def newton_from_equal_legs(problem: tuple[Manipulator, FloatArray]) -> Prepared:
    """Prepare fsolve once per stage, from level platforms; read as ball joints (n, 3, 3), NaN where it failed."""
    machine, problems = problem
    hips = (machine.base_radius, machine.platform_radius)

    def solve(lengths: FloatArray) -> tuple[FloatArray, bool]:
        angles, good = [], True
        for part, hip in zip((lengths[:3], lengths[3:]), hips, strict=True):
            theta, fine = _fsolve(np.arccos((machine.middle_radius - hip) / part), part, hip, machine.middle_side)
            angles.append(theta)
            good &= fine
        return np.array(angles), good

    def read(found: list[tuple[FloatArray, bool]]) -> FloatArray:
        radial = machine.radial_directions
        joints = np.full((len(found), 3, 3), np.nan)
        for k, ((angles, good), lengths) in enumerate(zip(found, problems, strict=True)):
            if good:
                joints[k] = (hips[0] + lengths[:3] * np.cos(angles[0]))[:, None] * radial
                joints[k, :, 2] = lengths[:3] * np.sin(angles[0])
        return joints

    return Prepared(lambda: [solve(lengths) for lengths in problems], read)


def pinocchio(problem: tuple[Manipulator, FloatArray]) -> Prepared:
    """Prepare `ClosedChain.forward_kinematics` from the home: Newton on Pinocchio's closures."""
    required("pinocchio", "pin")
    from spm_pin.multibody.chain import ClosedChain

    machine, problems = problem
    chain = ClosedChain.from_urdf(machine=machine)
    home = np.zeros(chain.model.nq)

    def solve(lengths: FloatArray) -> FloatArray:
        return np.asarray(chain.forward_kinematics(lengths, near=home))

    def read(found: list[FloatArray]) -> FloatArray:
        return np.array([chain.state(q).configuration().middle_joints for q in found])

    return Prepared(lambda: [solve(lengths) for lengths in problems], read)


def _fsolve(start: FloatArray, lengths: FloatArray, hip: float, side: float) -> tuple[FloatArray, bool]:
    theta, account, _, _ = fsolve(sides, start, (lengths, hip, side), slopes, full_output=True, xtol=1e-13)
    return theta, bool(np.abs(account["fvec"]).max() < CLOSED)
