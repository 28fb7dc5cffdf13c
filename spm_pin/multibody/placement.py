"""Joint values by name, Pinocchio's vector q, and the configurations they stand for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.description.tree import ANGLES, JOINTS, SLIDES
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.mechanism.arguments import FloatArray, first_offender, frozen, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, Geometry
from spm_pin.mechanism.joint_angles import home_lengths, joint_angles

__all__ = ["AGREEMENT", "DIMENSIONS", "Placement", "one_vector"]

AGREEMENT = 1e-9
"""Lengths that differ by this share of the robot's own are taken for rounded, more for another robot's."""

DIMENSIONS = ("base_radius", "platform_radius", "middle_side")
"""What makes two geometries the same mechanism; limits only choose the home, the tree's zero."""


class Placement:
    """Where the joints of a model are in q, and which frames make a configuration.

    Parameters
    ----------
    model : pinocchio.Model
        A model of the description's tree.
    geometry : Geometry
        Its dimensions, and the limits that set its zero.
    prefix : str
        Before every name in `model`.
    """

    def __init__(self, model: Any, geometry: Geometry, prefix: str) -> None:
        self.model = model
        self.geometry = geometry
        joints = {name: model.joints[model.getJointId(prefix + name)] for name in JOINTS}
        self._index = {name: int(joint.idx_q) for name, joint in joints.items()}
        # All joints have one degree of freedom, but that q and v agree is Pinocchio's choice.
        assert all(joint.idx_v == joint.idx_q for joint in joints.values())
        self.legs = self.indices(*SLIDES)
        self._order = np.argsort(self.indices(*ANGLES, *SLIDES))
        self.home = frozen(np.repeat(home_lengths(geometry), 3))
        self.platform = int(model.getFrameId(f"{prefix}terminal_platform"))
        self._corners = [int(model.getFrameId(f"{prefix}middle_b{i}")) for i in "123"]

    def indices(self, *names: str) -> npt.NDArray[np.intp]:
        """Return where joints, named without prefix, are in q and in v, shape (n,)."""
        unknown = [name for name in names if name not in self._index]
        if unknown:
            raise ArgumentError("names", f"joints: {', '.join(JOINTS)}", ", ".join(map(repr, unknown)))
        return np.array([self._index[name] for name in names], dtype=np.intp)

    def leg_lengths(self, q: FloatArray) -> FloatArray:
        """Return the six leg lengths (..., 6) [m] in q (..., 18)."""
        return np.asarray(self.home + q[..., self.legs])

    def checked(self, q: npt.ArrayLike, argument: str = "q", *, single: bool = False) -> FloatArray:
        """Return a copy of q (..., 18), or raise `ArgumentError`."""
        read = one_vector if single else real_array
        array = read(q, argument, (len(JOINTS),), "joint values in rad and m in Pinocchio's order")
        lengths = self.leg_lengths(array)
        if (lengths < 0.0).any():
            worst = np.unravel_index(int(lengths.argmin()), lengths.shape)
            cause = "The value of a slide is the leg's length minus its length at home"
            received = f"{lengths[worst]:g} m in {LEGS[worst[-1]]}"
            raise ArgumentError(argument, "legs of no negative length", received, cause)
        return array.copy()

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return q (..., 18) of a configuration; see `ClosedChain.place`."""
        if not isinstance(configuration, Configuration):
            cause = "One of several solutions? .physical(), or an index, takes one"
            raise ArgumentError("configuration", "a Configuration", type(configuration).__name__, cause)
        geometry = configuration.geometry
        for name in DIMENSIONS:
            own, other = getattr(self.geometry, name), getattr(geometry, name)
            if abs(other - own) > AGREEMENT * own:
                raise GeometryError("configuration", f"the chain's {name}, {own:.9g} m", f"{other:.9g} m")
        # With the chain's own limits: they set the zero of its slides.
        arrays = configuration.rotation, configuration.translation, configuration.middle_joints
        angles = joint_angles(Configuration.from_arrays(self.geometry, *arrays), corners=(0,))
        residual = angles.closure_residual
        if not (residual <= AGREEMENT * self.geometry.middle_side).all():
            absent = np.isnan(residual)
            wrong = absent if absent.any() else residual > AGREEMENT * self.geometry.middle_side
            index = first_offender(wrong)
            where = f" at batch index {index}" if index else ""
            if absent.any():
                cause = "Not a real branch? .exists says which are"
                raise ArgumentError("configuration", "a configuration that exists", f"NaN{where}", cause)
            received = f"a closure residual of {residual[index]:.1e} m{where}"
            cause = "Rounded numbers? inverse_displacement closes the loops for a pose"
            raise ArgumentError("configuration", "a closed mechanism", received, cause)
        parts = angles.hip, angles.ball_x, angles.ball_y, angles.ball_z, angles.slide
        return np.asarray(np.concatenate(parts, axis=-1)[..., self._order])

    def frames(self, q: FloatArray, data: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the rotation (3, 3) and translation (3,) of m and the corners b (3, 3) at q (18,), from `data`."""
        pin.framesForwardKinematics(self.model, data, q)
        terminal = data.oMf[self.platform]
        corners = np.array([data.oMf[corner].translation for corner in self._corners])
        # Pinocchio returns views of its data: copies are what the caller keeps.
        return terminal.rotation.copy(), terminal.translation.copy(), corners


def one_vector(value: npt.ArrayLike, argument: str, trailing: tuple[int], meaning: str) -> FloatArray:
    """Read `value` as float64 of shape `trailing`, or raise `ArgumentError`."""
    array = real_array(value, argument, trailing, meaning)
    if array.ndim != 1:
        cause = "One motion a call"
        raise ArgumentError(argument, f"shape ({trailing[0]},), {meaning}", f"shape {array.shape}", cause)
    return array
