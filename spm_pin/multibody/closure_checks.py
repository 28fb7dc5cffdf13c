"""Checks that joint values are closed and velocities keep them so."""

from __future__ import annotations

from spm_pin.errors import ArgumentError, ClosureError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.constrained_model import TreeKinematics
from spm_pin.multibody.joint_layout import AGREEMENT


def require_closed(kinematics: TreeKinematics, v: FloatArray | None = None, argument: str = "v") -> None:
    """Raise unless q is closed and v keeps it so, to `AGREEMENT`."""
    gap, most = kinematics.gap.ravel(), AGREEMENT * kinematics.layout.side
    # None is wider than all of them together: quicker, and mostly enough.
    if gap.dot(gap) > most * most and (residual := kinematics.widest_gap()) > most:
        raise ClosureError(residual, 0, "Rounded or guessed joint values? The method project closes the loops")
    if v is None:
        return
    opening = largest(kinematics.constraint_jacobian.dot(v))
    # A leg's own rate is part of the speed, along one axis or more: quicker, and mostly enough.
    rate = largest(v.take(kinematics.constrained.actuated[-6:]))
    if opening > 0.5 * AGREEMENT * rate and opening > AGREEMENT * kinematics.gap_rate_bound(v):
        expected = "joint velocities that keep the loops closed"
        cause = "joint_velocities makes them from a twist, joint_rates from leg rates"
        raise ArgumentError(argument, expected, f"gaps that open at {opening:.1e} m/s", cause)


def largest(vector: FloatArray) -> float:
    """Return the largest absolute value of a short vector: quicker than NumPy."""
    return float(max(map(abs, vector.tolist())))
