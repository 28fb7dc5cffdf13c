"""Indices of the mechanism's joints in Pinocchio's q and v, and the joint values of configurations."""

from __future__ import annotations

from typing import Any

import numpy as np

from spm_pin.description.tree import ANGLES, JOINTS, SLIDES
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.mechanism.arguments import FloatArray, IntArray, first_offender, frozen
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.joint_angles import joint_angles
from spm_pin.mechanism.leg_frames import home_lengths
from spm_pin.mechanism.leg_limits import LEGS

AGREEMENT = 1e-9
"""Lengths that differ by this share of the robot's own are taken for rounded, more for another robot's."""

BALLS = (("ball_b1_x", "ball_b1_y", "ball_b1_z"), ("ball_c1_z", "ball_c1_y", "ball_c1_x"))
"""The joints that stand for one ball joint each."""


class JointLayout:
    """The eighteen joints of the mechanism in a model that has them, perhaps among others; immutable.

    `geometry` are its dimensions, and the limits that set its zero; `prefix` stands before its names in `model`.
    """

    def __init__(self, model: Any, geometry: Geometry, prefix: str) -> None:
        self.geometry = geometry
        joints = {name: model.joints[model.getJointId(prefix + name)] for name in JOINTS}
        # Without prefix in Pinocchio's order, the order of all that follows.
        self.names = tuple(sorted(JOINTS, key=lambda name: joints[name].idx_q))
        self.names_in_model = tuple(prefix + name for name in self.names)
        self._place = {name: k for k, name in enumerate(self.names)}
        # Where they are in the q and the v of the model, and where all other degrees of freedom are in v.
        self.q = np.array([joints[name].idx_q for name in self.names], dtype=np.intp)
        self.v = np.array([joints[name].idx_v for name in self.names], dtype=np.intp)
        self.others = np.setdiff1d(np.arange(model.nv), self.v)
        # Among the eighteen: the slides in the order of `LEGS`, the other joints, and those of each ball.
        self.legs = self.indices(*SLIDES)
        self.passive = np.setdiff1d(np.arange(len(JOINTS)), self.legs)
        self._slides = self.q[self.legs]
        self.balls = tuple(self.indices(*names) for names in BALLS)
        nominal = geometry.nominal
        # What leg lengths exceed the distances of ball and pivot by, and leg lengths (readings as built) at zero [m].
        self.offsets = geometry.legs.offsets
        self._home_distances = frozen(np.repeat(home_lengths(nominal), 3))
        self.home = frozen(self._home_distances + self.offsets)
        # d, and the platforms' part in the length of a loop [m].
        self.side, self.platform_sizes = float(nominal.middle_side), float(sum(nominal.dimensions))
        self.platform_frame = int(model.getFrameId(f"{prefix}terminal_platform"))
        self.corner_frames = [int(model.getFrameId(f"{prefix}middle_b{i}")) for i in "123"]
        # Of a step of order one in each joint: 1 rad, or d.
        self.units = frozen(np.where(np.isin(np.arange(len(JOINTS)), self.legs), self.side, 1.0))
        self._order = np.argsort(self.indices(*ANGLES, *SLIDES))

    def indices(self, *names: str) -> IntArray:
        """Return the indices (n,) among the eighteen of joints named without prefix."""
        unknown = [name for name in names if name not in self._place]
        if unknown:
            raise ArgumentError("names", f"joints: {', '.join(JOINTS)}", ", ".join(map(repr, unknown)))
        return np.array([self._place[name] for name in names], dtype=np.intp)

    def leg_lengths(self, q: FloatArray) -> FloatArray:
        """Return the six leg lengths (..., 6) [m] in q (..., nq) of the model, offsets included."""
        return np.asarray(self.home + q.take(self._slides, axis=-1))

    def distances(self, q: FloatArray) -> FloatArray:
        """Return the distances (..., 6) [m] of the balls from the pivots in q (..., nq) of the model."""
        return np.asarray(self._home_distances + q.take(self._slides, axis=-1))

    def require_distances(self, q: FloatArray, argument: str = "q") -> None:
        """Raise `ArgumentError` where a leg in q (..., nq) of the model has a negative length."""
        lengths = self.distances(q)
        if (min(lengths.tolist()) if lengths.ndim == 1 else lengths.min(initial=0.0)) < 0.0:
            worst = np.unravel_index(int(lengths.argmin()), lengths.shape)
            cause = "The value of a slide is the leg's length minus its length at home"
            received = f"{lengths[worst]:g} m in {LEGS[worst[-1]]}"
            raise ArgumentError(argument, "legs of no negative length", received, cause)

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return the chain's q (..., 18) of a configuration; see `ClosedChain.joint_values`."""
        geometry = check_configuration(configuration, existing=True).geometry
        if geometry is not self.geometry:
            require_dimensions(geometry, self.geometry, "configuration", "the chain")
            # With the chain's own limits: they set the zero of its slides.
            arrays = configuration.rotation, configuration.translation, configuration.middle_joints
            configuration = Configuration.from_arrays(self.geometry, *arrays)
        return self.values_of(configuration)

    def values_of(self, configuration: Configuration) -> FloatArray:
        """Return `joint_values` of a configuration that exists, of the chain's own geometry."""
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
    if not geometry.is_nominal or not expected.is_nominal:
        _require_as_built(geometry, expected, argument, owner)
        return
    for name in ("base_radius", "platform_radius", "middle_side"):
        found, sought = getattr(geometry, name), getattr(expected, name)
        if abs(found - sought) > AGREEMENT * sought:
            raise GeometryError(argument, f"the {name} of {owner}, {sought:.9g} m", f"{found:.9g} m")


def _require_as_built(geometry: Geometry, expected: Geometry, argument: str, owner: str) -> None:
    """Raise `GeometryError` unless both have the same axes, pivots, balls and offsets."""
    both = geometry, expected
    received_kind, expected_kind = ("a nominal machine" if g.is_nominal else "a machine as built" for g in both)
    found, sought = geometry, expected
    for name in ("axes", "pivots", "balls", "offsets"):
        unit, symbol = (1.0, "rad") if name == "axes" else (sought.nominal.middle_side, "m")
        apart = np.abs(getattr(found.legs, name) - getattr(sought.legs, name)).reshape(len(LEGS), -1).max(axis=-1)
        if apart.max() > AGREEMENT * unit:
            leg = int(apart.argmax())
            received = f"{received_kind} that differs by {apart[leg]:.1e} {symbol} in {LEGS[leg]}"
            raise GeometryError(argument, f"the {name} of {owner}, {expected_kind}", received)
