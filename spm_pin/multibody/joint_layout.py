"""Indices of the mechanism's joints in Pinocchio's q and v, and the joint values of configurations."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.description.tree import ANGLES, JOINTS, SLIDES
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.mechanism.arguments import FloatArray, first_offender, frozen
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import LEGS, Geometry
from spm_pin.mechanism.joint_angles import home_lengths, joint_angles
from spm_pin.multibody.vector_arguments import read_vector, read_vectors

__all__ = ["AGREEMENT", "BALLS", "JointLayout", "require_dimensions"]

AGREEMENT = 1e-9
"""Lengths that differ by this share of the robot's own are taken for rounded, more for another robot's."""

BALLS = (("ball_b1_x", "ball_b1_y", "ball_b1_z"), ("ball_c1_z", "ball_c1_y", "ball_c1_x"))
"""The joints that stand for one ball joint each."""


class JointLayout:
    """The eighteen joints of the mechanism in a model that has them, perhaps among others; immutable.

    Parameters
    ----------
    model : pinocchio.Model
        A model of the description's tree, or one that holds it.
    geometry : Geometry
        Its dimensions, and the limits that set its zero.
    prefix : str
        Before the names of the mechanism in `model`.

    Attributes
    ----------
    names : tuple of str
        The joints without prefix in Pinocchio's order, the order of all that follows.
    q, v : ndarray of int, shape (18,)
        Where they are in the q and the v of the model.
    legs, passive : ndarray of int, shapes (6,), (12,)
        The slides in the order of `LEGS`, and the other joints, among the eighteen.
    balls : tuple of ndarray of int, shape (3,)
        The joints of each ball, among the eighteen.
    others : ndarray of int, shape (nv - 18,)
        Where all other degrees of freedom are in v.
    home : ndarray, shape (6,)
        Leg lengths at zero [m].
    side : float
        d, the side of the middle platform [m].
    units : ndarray, shape (18,)
        Of a step of order one in each joint: 1 rad, or d.
    platform : int
        The frame of the terminal platform.
    corners : list of int
        The frames b_1, b_2 and b_3 of the middle platform.
    """

    def __init__(self, model: Any, geometry: Geometry, prefix: str) -> None:
        self.geometry = geometry
        joints = {name: model.joints[model.getJointId(prefix + name)] for name in JOINTS}
        self.names = tuple(sorted(JOINTS, key=lambda name: joints[name].idx_q))
        self._place = {name: k for k, name in enumerate(self.names)}
        self.q = np.array([joints[name].idx_q for name in self.names], dtype=np.intp)
        self.v = np.array([joints[name].idx_v for name in self.names], dtype=np.intp)
        self.others = np.setdiff1d(np.arange(model.nv), self.v)
        self.legs = self.indices(*SLIDES)
        self.passive = np.setdiff1d(np.arange(len(JOINTS)), self.legs)
        self.balls = tuple(self.indices(*names) for names in BALLS)
        self.home = frozen(np.repeat(home_lengths(geometry), 3))
        self.side = float(geometry.middle_side)
        self.platform = int(model.getFrameId(f"{prefix}terminal_platform"))
        self.corners = [int(model.getFrameId(f"{prefix}middle_b{i}")) for i in "123"]
        units = np.ones(len(JOINTS))
        units[self.legs] = self.side
        self.units = frozen(units)
        self._order = np.argsort(self.indices(*ANGLES, *SLIDES))

    def indices(self, *names: str) -> npt.NDArray[np.intp]:
        """Return where joints, named without prefix, are among the eighteen, shape (n,)."""
        unknown = [name for name in names if name not in self._place]
        if unknown:
            raise ArgumentError("names", f"joints: {', '.join(JOINTS)}", ", ".join(map(repr, unknown)))
        return np.array([self._place[name] for name in names], dtype=np.intp)

    def leg_lengths(self, q: FloatArray) -> FloatArray:
        """Return the six leg lengths (..., 6) [m] in the chain's q (..., 18)."""
        return np.asarray(self.home + q.take(self.legs, axis=-1))

    def checked(self, q: npt.ArrayLike, argument: str = "q", *, single: bool = False) -> FloatArray:
        """Return the chain's q (..., 18) as an array, or raise `ArgumentError`."""
        array = (read_vector if single else read_vectors)(q, argument, len(JOINTS))
        lengths = self.leg_lengths(array)
        if (min(lengths.tolist()) if lengths.ndim == 1 else lengths.min(initial=0.0)) < 0.0:
            worst = np.unravel_index(int(lengths.argmin()), lengths.shape)
            cause = "The value of a slide is the leg's length minus its length at home"
            received = f"{lengths[worst]:g} m in {LEGS[worst[-1]]}"
            raise ArgumentError(argument, "legs of no negative length", received, cause)
        return array

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return the chain's q (..., 18) of a configuration; see `ClosedChain.joint_values`."""
        geometry = check_configuration(configuration, existing=True).geometry
        if geometry is not self.geometry:
            require_dimensions(geometry, self.geometry, "configuration", "the chain")
            # With the chain's own limits: they set the zero of its slides.
            arrays = configuration.rotation, configuration.translation, configuration.middle_joints
            configuration = Configuration.from_arrays(self.geometry, *arrays)
        angles = joint_angles(configuration, corners=(0,))
        open_ = angles.closure_residual > AGREEMENT * self.side
        if open_.any():
            index = first_offender(open_)
            where = f" at batch index {index}" if index else ""
            received = f"a closure residual of {angles.closure_residual[index]:.1e} m{where}"
            cause = "Rounded numbers? inverse_displacement closes the loops for a pose"
            raise ArgumentError("configuration", "a closed mechanism", received, cause)
        return angles.values.take(self._order, axis=-1)


def require_dimensions(geometry: Geometry, expected: Geometry, argument: str, owner: str) -> None:
    """Raise `GeometryError` unless both are the same mechanism; limits only choose the home, the tree's zero."""
    for name in ("base_radius", "platform_radius", "middle_side"):
        found, sought = getattr(geometry, name), getattr(expected, name)
        if abs(found - sought) > AGREEMENT * sought:
            raise GeometryError(argument, f"the {name} of {owner}, {sought:.9g} m", f"{found:.9g} m")
