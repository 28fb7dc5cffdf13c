"""Rules that every state of a planned path keeps: leg limits, joint limits, distance to singularities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.singularity_analysis import determinants
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.as_built import AsBuiltGeometry
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, Geometry, LegLimits
from spm_pin.workspace.reachability.joint_limits import JointLimits

__all__ = ["ROUNDING", "PathRules", "least_determinant"]

ROUNDING = 1e-9
"""Amount by which a rule may be broken, in its unit: a state at its limit keeps it."""


@dataclass(frozen=True)
class PathRules:
    """The rules of a path.

    Parameters
    ----------
    geometry : Geometry or AsBuiltGeometry
        The machine; its own leg limits play no part.
    limits : LegLimits or None
        Of the leg lengths.
    joints : JointLimits
        Of the passive joints, and the distance that legs keep.
    margin : float
        Least |det J_b| and |det J_c| over d³.
    """

    geometry: Geometry | AsBuiltGeometry
    limits: LegLimits | None
    joints: JointLimits
    margin: float

    def margins(self, states: Configuration) -> FloatArray:
        """Return how far states are inside: existence, legs [m], singularities, angles [rad], clearance [m], (..., 5).

        Where a state does not exist the first is -1 and the others are not numbers.
        """
        legs = np.full(states.shape, np.inf) if self.limits is None else self.limits.margin(states.leg_lengths)
        angles, clearance = self.joints.angle_margin(states), self.joints.clearance_margin(states)
        rows = [np.where(states.exists, 1.0, -1.0), legs, least_determinant(states) - self.margin, angles, clearance]
        return np.stack(np.broadcast_arrays(*rows), axis=-1)

    def broken(self, states: Configuration) -> npt.NDArray[np.bool_]:
        """Return which states do not exist or break a rule by more than `ROUNDING`, shape (...)."""
        return np.asarray(~(self.margins(states) >= -ROUNDING).all(axis=-1))

    def explain(self, state: Configuration) -> str:
        """Return which rule a single state breaks, in words; empty if none."""
        exists, legs, least, angles, clearance = self.margins(state).tolist()
        if exists < 0.0:
            return "the physical mode cannot have these lengths"
        if legs < -ROUNDING:
            assert self.limits is not None
            leg = int(np.abs(self.limits.excess(state.leg_lengths)).argmax())
            return (
                f"{LEGS[leg]} of {state.leg_lengths[leg]:.4g} m is outside its limits, "
                f"{self.limits.minimum[leg]:g} to {self.limits.maximum[leg]:g} m"
            )
        if least < -ROUNDING:
            found = f"|det J| of {least + self.margin:.3g} d³"
            return f"a forward singularity is near: {found}, less than the margin of {self.margin:g}"
        if angles < -ROUNDING:
            return f"a passive joint is {-angles:.3g} rad beyond its limit"
        if clearance < -ROUNDING:
            return f"two legs are {-clearance * 1e3:.3g} mm too near to each other"
        return ""

    def explain_line(self, states: Configuration) -> str:
        """Return which rule the first of states (n,) that breaks one does, and where; empty if none."""
        broken = np.flatnonzero(self.broken(states))
        if not len(broken):
            return ""
        where = 100.0 * broken[0] / (len(states) - 1)
        return f"the straight line breaks a rule at {where:.0f} %: {self.explain(states[int(broken[0])])}"


def least_determinant(states: Configuration) -> FloatArray:
    """Return the smaller of |det J_b| and |det J_c| over d³, shape (...)."""
    return np.asarray(np.abs(determinants(states)[..., :2]).min(axis=-1) / states.geometry.nominal.middle_side**3)
