"""Leg lengths, distances from singularities and leg forces of a configuration, for the instruments of the page."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics.platform_stiffness import compliance, principal_stiffness
from spm_pin.kinematics.rates_and_forces import leg_forces
from spm_pin.kinematics.singularity_analysis import determinant_gradients, singularities
from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.configuration import Configuration

SINGULARITIES = ("forward, lower stage", "forward, upper stage", "inverse")
"""The singularities that J_b, J_c and K have, in this order."""

NEAR = 0.02
"""A singularity is near where legs moved by this share of d could reach it."""

_LIMIT_ROUNDING = 1e-9  # relative to d


class Readings:
    """Readings of a single configuration that exists, under a wrench (6,) on the platform [N, N m].

    Axes of length three count J_b, J_c, K.
    """

    def __init__(self, state: Configuration, wrench: npt.ArrayLike) -> None:
        self._state = state
        self._wrench = wrench
        self.singularities = singularities(state)
        self.physical = bool(physical(state))
        """Whether the state is physical: reached from the symmetric home without a forward singularity."""

    @cached_property
    def beyond(self) -> FloatArray:
        """By how much each leg is longer than its longest (positive) or shorter than its shortest (negative) [m]."""
        limits = self._state.geometry.limits
        beyond = np.zeros(6) if limits is None else limits.excess(self._state.leg_lengths)
        return np.where(np.abs(beyond) < _LIMIT_ROUNDING * self._state.geometry.middle_side, 0.0, beyond)

    @cached_property
    def travel(self) -> FloatArray:
        """Leg travel to each singularity, shape (3,) [m], to first order; NaN where that says nothing.

        How far the leg lengths would have to move, in the Euclidean norm, to make the determinant zero: its absolute
        value over the norm of its gradient. The nearer, the more exact.
        """
        try:
            gradients = np.linalg.norm(determinant_gradients(self._state), axis=-1)
        except SingularConfigurationError:
            return np.where(self.singularities.rank < 6, 0.0, np.nan)
        return np.asarray(np.abs(self.singularities.determinants) / np.maximum(gradients, np.finfo(float).tiny))

    @property
    def near(self) -> BoolArray:
        """Which singularities are near, shape (3,); see `NEAR`."""
        return np.asarray((self.travel < NEAR * self._state.geometry.middle_side) | np.isnan(self.travel))

    @cached_property
    def forces(self) -> FloatArray | None:
        """Leg forces that hold the load (6,) [N]; None where the legs cannot hold every load."""
        try:
            return leg_forces(self._state, self._wrench) if self.softest else None
        except SingularConfigurationError:
            return None

    @cached_property
    def softest(self) -> float:
        """Translational stiffness at o where it is least, for legs of stiffness one; zero where they do not hold."""
        try:
            return float(principal_stiffness(compliance=compliance(self._state, 1.0)).translational[0])
        except SingularConfigurationError:
            return 0.0
