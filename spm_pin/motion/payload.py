"""A body fixed to the terminal platform, and the wrench that its motion exerts there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, frozen, real_array, real_number, symmetric_matrices


@dataclass(frozen=True, eq=False)
class Payload:
    """A rigid body that the terminal platform carries.

    Parameters
    ----------
    mass : float
        [kg], not negative.
    centre : array_like, shape (3,)
        Its centre of mass in {m} [m].
    inertia : array_like, shape (3, 3), optional
        About its centre of mass in the axes of {m} [kg m²]; a point mass by default.

    Raises
    ------
    ArgumentError
        If the mass is negative, or no rigid body has this inertia.
    """

    mass: float
    centre: npt.ArrayLike = (0.0, 0.0, 0.0)
    inertia: npt.ArrayLike = ((0.0,) * 3,) * 3

    def __post_init__(self) -> None:
        mass = real_number(self.mass, "mass", "a mass in kg, not negative", least=0.0)
        centre = real_array(self.centre, "centre", (3,), "the centre of mass in {m} in metres")
        inertia = symmetric_matrices(self.inertia, "inertia", 3, "about the centre of mass in kg m²")
        if centre.ndim != 1 or inertia.ndim != 2:
            raise ArgumentError("centre, inertia", "shapes (3,) and (3, 3)", f"{centre.shape} and {inertia.shape}")
        moments = np.linalg.eigvalsh(inertia)
        rounding = 1e-9 * abs(moments).max()
        if moments[0] < -rounding or moments[:2].sum() < moments[2] - rounding:
            expected = "principal moments of a body: none negative or above the sum"
            raise ArgumentError("inertia", expected + " of the other two", f"moments {moments}", "About another point?")
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "centre", frozen(centre.copy()))
        object.__setattr__(self, "inertia", frozen(inertia.copy()))

    def wrench(
        self, rotation: FloatArray, twist: FloatArray, acceleration: FloatArray, gravity: npt.ArrayLike
    ) -> FloatArray:
        """Return the wrench (f, m) that the body exerts onto the platform at o, in {B} [N, N m].

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
            Of {m} in {B}.
        twist, acceleration : ndarray, shape (6,)
            (v, ω) of m at o and its time derivative, in {B}.
        gravity : array_like, shape (3,)
            [m/s²] in {B}.
        """
        arm, inertia = rotation @ np.asarray(self.centre), rotation @ np.asarray(self.inertia) @ rotation.T
        spin, change = twist[3:], acceleration[3:]
        push = acceleration[:3] + np.cross(change, arm) + np.cross(spin, np.cross(spin, arm)) - np.asarray(gravity)
        force = self.mass * push
        moment = inertia @ change + np.cross(spin, inertia @ spin) + np.cross(arm, force)
        return -np.concatenate([force, moment])
