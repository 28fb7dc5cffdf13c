"""Forces of a spanning tree with closures: the equilibrium of the cut tree, the dual of its rates.

The generalized forces of the legs f, of the cut balls λ and of a wrench w on m balance in every joint,

    Sᵀ f + Jcᵀ λ + Jmᵀ w = 0,

eighteen equations for eighteen unknowns, regular wherever [S; Jc] is: at an inverse singularity as well. J_f has
no part in it.
"""

from __future__ import annotations

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.velocity import Linearization

__all__ = ["held_forces"]


def held_forces(linearization: Linearization, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the forces that hold a wrench, or raise at a forward or constraint singularity.

    Parameters
    ----------
    linearization : Linearization
        The chain at one q.
    wrench : ndarray, shape (6,)
        (f, m) at o in {B} onto the terminal platform [N, N m].

    Returns
    -------
    legs : ndarray, shape (6,)
        Of the actuators [N], positive to extend.
    cuts : ndarray, shape (n, 3)
        Onto `frame_b` of each closure, in {B} [N]; onto `frame_a` comes the opposite.
    """
    inverse = linearization.regular_inverse(linearization.held(), "forward")
    # In the velocities u of the module `velocity`, divided by d: Ŝᵀ f + (Jc C / d)ᵀ λ = -(A Jm C)ᵀ A⁻¹ w / d.
    load = wrench / (linearization.side * linearization.twist_scale)
    unknown = -inverse.T @ (linearization.scaled_platform().T @ load)
    return unknown[:6], unknown[6:].reshape(-1, 3)
