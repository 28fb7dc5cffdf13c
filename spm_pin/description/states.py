"""The joint values of a configuration by name."""

from __future__ import annotations

from spm_pin.description.tree import ANGLES, JOINTS, SLIDES
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.joint_angles import joint_angles

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
    ArgumentError
        If `configuration` is none, is a batch or does not exist.
    """
    check_configuration(configuration, single=True, existing=True)
    found = joint_angles(configuration, corners=(0,)).values
    values = dict(zip((*ANGLES, *SLIDES), found.tolist(), strict=True))
    return {name: values[name] for name in JOINTS}
