"""The joint values of a configuration, in closed form."""

from __future__ import annotations

import math

import numpy as np

from spm_pin.description.tree import JOINTS, home_leans, home_lengths
from spm_pin.errors import DescriptionError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS

__all__ = ["home_configuration_values", "joint_values"]


def home_configuration_values() -> dict[str, float]:
    """Return the joint values of the symmetric home: zero for all of `JOINTS`."""
    return dict.fromkeys(JOINTS, 0.0)


def joint_values(configuration: Configuration) -> dict[str, float]:
    """Return the values of the tree's eighteen joints in a configuration.

    Parameters
    ----------
    configuration : Configuration
        A single state that exists. Where it violates the mechanism's closure, so does the tree.

    Returns
    -------
    dict of str to float
        The values by name, without prefix, in the order of `JOINTS`: angles in [-π, π] [rad], slides [m] as
        length minus home length.

    Raises
    ------
    DescriptionError
        If `configuration` is a batch or does not exist.
    """
    if configuration.shape:
        expected = "a single configuration"
        raise DescriptionError("configuration", expected, f"a batch of shape {configuration.shape}")
    if not configuration.exists:
        raise DescriptionError("configuration", "a configuration that exists", "NaN", "Not a real branch?")
    geometry = configuration.geometry
    axes = geometry.revolute_axes
    lower_home, upper_home = home_lengths(geometry)
    leans = home_leans(geometry)

    # Hip to ball, seen from the platform the leg stands on.
    lower = configuration.leg_vectors[:3]
    upper = -configuration.leg_vectors[3:] @ configuration.rotation
    values: dict[str, float] = {}
    for i, (leg, vector) in enumerate(zip(LEGS, np.concatenate([lower, upper]), strict=True)):
        across, up = float(vector @ _second_axis(axes[i % 3])), float(vector[2])
        name = leg.removeprefix("r_")
        values[f"leg_{name}_hip"] = math.remainder(math.atan2(-across, up) - leans[i], math.tau)
        values[f"leg_{name}_slide"] = math.hypot(across, up) - (lower_home if i < 3 else upper_home)

    # Orientations in frames whose x axis is leg 1's revolute axis, z the platform's normal.
    corner = np.stack([axes[0], _second_axis(axes[0]), [0.0, 0.0, 1.0]], axis=-1)
    middle = corner.T @ configuration.middle_pose.as_matrix()[:3, :3] @ corner
    terminal = corner.T @ configuration.rotation @ corner
    x, y, z = _xyz(_about_x(values["leg_b1_hip"]).T @ middle)
    values |= {"ball_b1_x": x, "ball_b1_y": y, "ball_b1_z": z}
    # R = Rz Ry Rx from the middle platform to the rod: its transpose has the angles of X-Y-Z, negated.
    x, y, z = _xyz(_about_x(values["leg_c1_hip"]).T @ terminal.T @ middle)
    values |= {"ball_c1_x": -x, "ball_c1_y": -y, "ball_c1_z": -z}
    return {name: values[name] for name in JOINTS}


def _second_axis(axis: FloatArray) -> FloatArray:
    """Return y of a corner's frame: z × x."""
    return np.array([-axis[1], axis[0], 0.0])


def _about_x(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _xyz(rotation: FloatArray) -> tuple[float, float, float]:
    """Return the angles of R = Rx Ry Rz, the second in [-π/2, π/2]; R is met even where the second is ±π/2."""
    x = math.atan2(-rotation[1, 2], rotation[2, 2])
    y = math.atan2(rotation[0, 2], math.hypot(rotation[1, 2], rotation[2, 2]))
    # The third from what the first leaves over, hence exact where the first is not determined.
    rest = _about_x(x)[:, 1] @ rotation
    return x, y, math.atan2(rest[0], rest[1])
