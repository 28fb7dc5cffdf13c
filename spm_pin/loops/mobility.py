"""Mobility of a closed chain at one configuration: degrees of freedom, dependent equations and undriven joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.loops.null_space import INDEPENDENT
from spm_pin.loops.state_kinematics import DEPENDENCE, DETERMINED, StateKinematics, read_joint_values
from spm_pin.support.arguments import FloatArray

NEIGHBOURS = (0.02, 0.05, 0.1) * 4
"""Steps along admissible motions, dimensionless, after which the rank is that of regular configurations."""
ENOUGH = 3
"""Number of such configurations that are compared; from a singularity, assembly mostly leads back to it."""


@dataclass(frozen=True)
class Mobility:
    """Degrees of freedom of a `ClosedChain` at one closed configuration, from the rank of its equations there."""

    dof: int
    """Degrees of freedom: velocities of the tree less independent equations."""
    rows: int
    """Number of scalar equations of closures and joint equalities, and of velocities of joints that are held."""
    rank: int
    """Number of independent ones among them."""
    actuators: int
    """Number of actuators."""
    actuated_rank: int
    """Number of degrees of freedom that the actuators drive."""
    dependent: dict[str, int]
    """By closure or joint equality: how many of its equations follow from all others. Each number holds by itself: two
    closures that repeat each other both count."""
    undriven: tuple[str, ...]
    """Joints that can move while all actuators stand still."""
    redundant: tuple[str, ...]
    """Actuated joints whose rate follows from those of the other actuators, or is zero."""
    locked: tuple[str, ...]
    """Joints that the loops do not let move."""
    regular_dof: int
    """Degrees of freedom nearby: fewer than `dof` where the configuration is a singularity of the loops."""

    @property
    def is_singular(self) -> bool:
        """True at a singularity of the loops, where some velocities lead to no motion, or to one of several modes."""
        return self.dof != self.regular_dof

    @property
    def is_fully_driven(self) -> bool:
        """True if the actuators determine all motions."""
        return self.actuated_rank == self.dof

    def __repr__(self) -> str:
        text = f"<Mobility: {self.dof} degrees of freedom, {self.actuated_rank} of them driven by {self.actuators} "
        text += f"actuators; {self.rows} equations of rank {self.rank}"
        if self.is_singular:
            text += f"; singular: {self.regular_dof} degrees of freedom nearby"
        dependent = ", ".join(f"{name} ({count})" for name, count in self.dependent.items())
        named = [("dependent equations", dependent), *((k, ", ".join(getattr(self, k))) for k in _LISTS)]
        return text + "".join(f"; {what}: {names}" for what, names in named if names) + ">"


_LISTS = ("undriven", "redundant", "locked")


def mobility(chain: Any, q: npt.ArrayLike) -> Mobility:
    """Return the mobility of a chain at closed joint values q (nq,); see `ClosedChain.mobility`."""
    values = read_joint_values(chain.model, q)
    if values.ndim != 1:
        raise ArgumentError("q", f"shape ({chain.model.nq},), one configuration", f"shape {values.shape}")
    kinematics = StateKinematics(chain)
    kinematics.evaluate(values)
    kinematics.check_closed()
    left, basis = _spaces(kinematics)
    dependent: dict[str, int] = {}
    for name in dict.fromkeys(kinematics.labels):
        # The rank of the null vectors of Jᵀ at a closure's rows is how much of the dependence ends without it.
        at_name = left[[label == name for label in kinematics.labels]]
        if count := int((np.linalg.svd(at_name, compute_uv=False) > DETERMINED).sum()):
            dependent[name] = count
    driven = (basis / kinematics.units[:, None])[kinematics.actuated]
    left_driven, sizes, right = np.linalg.svd(driven)
    rank = int((sizes > DETERMINED).sum())
    repeated = np.abs(left_driven[:, rank:]).max(axis=1, initial=0.0) > DETERMINED
    # Some joints stand still for a moment, as at a dead centre.
    nearby = [basis, *_nearby(chain, values, basis)]
    moving = {name for near in nearby for name in kinematics.moving_joints(near)}
    return Mobility(
        dof=basis.shape[1],
        rows=len(kinematics.labels),
        rank=chain.model.nv - basis.shape[1],
        actuators=len(chain.actuated),
        actuated_rank=rank,
        dependent=dependent,
        undriven=tuple(kinematics.moving_joints(basis @ right[rank:].T)),
        redundant=tuple(
            name for name, is_repeated in zip(chain.actuated, repeated.tolist(), strict=True) if is_repeated
        ),
        locked=tuple(name for name in chain.joint_names if name not in moving),
        regular_dof=min(near.shape[1] for near in nearby),
    )


def _spaces(kinematics: StateKinematics) -> tuple[FloatArray, FloatArray]:
    """Return the null vectors (m, any) of the scaled Jᵀ, and the admissible velocities (nv, dof)."""
    scaled = kinematics.jacobian / kinematics.row_units[:, None] * kinematics.units
    left, sizes, right = np.linalg.svd(scaled)
    least = max(INDEPENDENT, DEPENDENCE * kinematics.widest_gap) * max(sizes.max(initial=0.0), 1e-300)
    rank = int((sizes > least).sum())
    return left[:, rank:], kinematics.units[:, None] * right[rank:].T


def check_regular(chain: Any, kinematics: StateKinematics) -> None:
    """Raise `SingularConfigurationError` at a singularity of the loops, where some velocities lead to no motion."""
    space = kinematics.space
    dof = space.basis.shape[1]
    # If all rows are independent, the configuration is regular.
    if space.rank == len(kinematics.labels) or dof <= chain.regular_dof:
        return
    chain.regular_dof = min([dof, *(near.shape[1] for near in _nearby(chain, kinematics.q, space.basis))])
    if dof > chain.regular_dof:
        raise SingularConfigurationError("constraint", space.least)


def _nearby(chain: Any, q: FloatArray, basis: FloatArray) -> list[FloatArray]:
    """Return the admissible velocities (nv, any) at some closed configurations near q, of those at q (nv, dof)."""
    bases: list[FloatArray] = []
    kinematics, rng = StateKinematics(chain), np.random.default_rng(0)
    held = chain.indices_in_q(*chain.held)
    for size in NEIGHBOURS if basis.shape[1] else ():
        direction = basis @ rng.normal(size=basis.shape[1])
        guess = pin.integrate(chain.model, q, size * direction / np.abs(direction / kinematics.units).max())
        guess[held] = q[held]
        try:
            near = chain.close(guess)
        except ClosureError:
            continue
        if np.abs(pin.difference(chain.model, q, near) / kinematics.units).max() >= 0.25 * size:
            kinematics.evaluate(near)
            bases.append(_spaces(kinematics)[1])
            if len(bases) == ENOUGH:
                break
    return bases
