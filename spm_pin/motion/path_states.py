"""States of the machine along a path of the legs or of the platform, and the rules that a planned path keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_physical
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS, LegLimits
from spm_pin.motion.leg_path import LegPath
from spm_pin.multibody.trajectory import PlatformMotion, PlatformPath
from spm_pin.workspace.joint_limits import JointLimits

STEP = 0.005
"""Largest distance of two samples of a path in the leg lengths, in units of d."""

ROUNDING = 1e-9
"""Amount by which a rule may be broken, in its unit: a state at its limit keeps it."""

MotionPath = LegPath | PlatformPath
"""A path; its parameter goes from 0 to 1, of a `PlatformPath` the share of its duration."""


def states_along(geometry: Geometry, path: MotionPath, parameters: FloatArray) -> Configuration:
    """Return the states at parameters (n,) from 0 to 1; some may not exist."""
    if isinstance(path, LegPath):
        return forward_physical(geometry, path(parameters).lengths)
    return inverse_physical(geometry, platform_motion(path, parameters).pose)


def platform_motion(path: PlatformPath, parameters: FloatArray) -> PlatformMotion:
    """Return the pose at parameters (n,) from 0 to 1, and its derivatives by the path's own time."""
    # Not beyond the end by rounding.
    return path(np.minimum(path.start + parameters * path.duration, path.end))


def line_states(geometry: Geometry, start: FloatArray, end: FloatArray) -> Configuration:
    """Return the states on a straight line between leg lengths (6,), at most `STEP` apart."""
    parameters = spaced_parameters(geometry, np.array([start, end]))[:, None]
    return forward_physical(geometry, start + parameters * (end - start))


def spaced_parameters(geometry: Geometry, lengths: FloatArray) -> FloatArray:
    """Return evenly spaced parameters from 0 to 1 for a path through leg lengths (n, 6), at most `STEP` apart."""
    distance = float(np.linalg.norm(np.diff(lengths, axis=0), axis=-1).sum())
    return np.linspace(0.0, 1.0, max(int(np.ceil(distance / (STEP * geometry.nominal.middle_side))), 2) + 1)


@dataclass(frozen=True)
class PathRules:
    """The rules of a path."""

    geometry: Geometry
    """The machine; its own leg limits play no part."""
    limits: LegLimits | None
    """Leg limits; None without any."""
    joints: JointLimits
    """Limits of the joint angles and of the legs' clearance."""
    margin: float
    """Least |det J_b| and |det J_c| over d³."""

    def margins(self, states: Configuration) -> FloatArray:
        """Return how far states are inside: existence, legs [m], singularities, angles [rad], clearance [m], (..., 5).

        Where a state does not exist the first is -1 and the others are not numbers.
        """
        legs = np.full(states.shape, np.inf) if self.limits is None else self.limits.margin(states.readings)
        angles, clearance = self.joints.angle_margin(states), self.joints.clearance_margin(states)
        rows = [np.where(states.exists, 1.0, -1.0), legs, least_determinant(states) - self.margin, angles, clearance]
        return np.stack(np.broadcast_arrays(*rows), axis=-1)

    def broken(self, states: Configuration) -> BoolArray:
        """Return which states do not exist or break a rule by more than `ROUNDING`, shape (...)."""
        return np.asarray(~(self.margins(states) >= -ROUNDING).all(axis=-1))

    def explain(self, state: Configuration) -> str:
        """Return which rule a single state breaks, in words; empty if none."""
        exists, legs, least, angles, clearance = self.margins(state).tolist()
        if exists < 0.0:
            return "the physical mode cannot have these lengths"
        if legs < -ROUNDING:
            assert self.limits is not None
            leg = int(np.abs(self.limits.excess(state.readings)).argmax())
            return (
                f"{LEGS[leg]} of {state.readings[leg]:.4g} m is outside its limits, "
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
