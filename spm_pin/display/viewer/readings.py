"""Leg lengths, distances from singularities and leg forces of a configuration, for the instruments of the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.leg_forces import leg_forces
from spm_pin.closed_form.singularity_analysis import SingularityKind, determinant_gradients, singularities
from spm_pin.closed_form.stiffness import compliance, principal_stiffness
from spm_pin.errors import SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.configuration import Configuration

__all__ = ["NEAR", "SINGULARITIES", "Readings"]

SINGULARITIES = ("forward, lower stage", "forward, upper stage", "inverse")
"""The singularities that J_b, J_c and K have, in this order."""

NEAR = 0.02
"""A singularity is near where legs moved by this share of d could reach it."""

_LIMIT_ROUNDING = 1e-9  # relative to d


@dataclass(frozen=True)
class Readings:
    """Readings of one configuration; axes of length three count J_b, J_c, K."""

    leg_lengths: FloatArray
    """[m], shape (6,)."""
    beyond: FloatArray
    """By how much each leg is longer than its longest (positive) or shorter than its shortest (negative) [m]."""
    sigma: FloatArray
    """Smallest singular values, shape (3,); these and the next two as in `Singularities`."""
    condition: FloatArray
    index: FloatArray
    """Determinants over d³."""
    travel: FloatArray
    """To first order, how far the leg lengths would have to move, in the Euclidean norm, to make the determinant zero
    [m]: its absolute value over the norm of its gradient. The nearer, the more exact."""
    kind: SingularityKind
    physical: bool
    """Whether a real machine can be in it: reached from the symmetric home without a forward singularity."""
    forces: FloatArray | None
    """Leg forces that hold the load (6,) [N]; None where the legs cannot hold every load."""
    softest: float
    """Translational stiffness at o where it is least, for legs of stiffness one; zero where they do not hold."""

    @classmethod
    def of(cls, state: Configuration, wrench: npt.ArrayLike) -> Readings:
        """Compute the readings of a single configuration that exists, under a wrench (6,) on the platform."""
        lengths = np.array(state.leg_lengths)
        beyond = np.zeros(6)
        limits = state.geometry.limits
        if limits is not None:
            beyond = limits.excess(lengths)
            beyond[np.abs(beyond) < _LIMIT_ROUNDING * state.geometry.middle_side] = 0.0
        found = singularities(state)
        try:
            gradients = np.linalg.norm(determinant_gradients(state), axis=-1)
            travel = np.abs(found.determinants) / np.maximum(gradients, np.finfo(float).tiny)
        except SingularConfigurationError:
            travel = np.where(found.rank < 6, 0.0, np.nan)
        try:
            forces = leg_forces(state, wrench)
            softest = float(principal_stiffness(compliance=compliance(state, 1.0)).translational[0])
        except SingularConfigurationError:
            forces, softest = None, 0.0
        return cls(
            leg_lengths=lengths,
            beyond=beyond,
            sigma=found.sigma,
            condition=found.condition,
            index=found.index,
            travel=travel,
            kind=SingularityKind(int(found.kind)),
            physical=bool(physical(state)),
            forces=forces,
            softest=softest,
        )

    def near(self, middle_side: float) -> npt.NDArray[np.bool_]:
        """Return which singularities are near, shape (3,); see `NEAR`."""
        return np.asarray((self.travel < NEAR * middle_side) | np.isnan(self.travel))
