"""The SRDF: groups, named states, passive joints, and pairs of links that touch by design."""

from __future__ import annotations

from collections.abc import Mapping

from spm_pin.description.tree import JOINTS, PASSIVE, SLIDES, joint_values, touching_links
from spm_pin.description.xml_nodes import check_prefix
from spm_pin.errors import DescriptionError
from spm_pin.mechanism.configuration import Configuration

HOME = "home"
"""Name of the state in which all joints are at zero."""


def srdf_text(configurations: Mapping[str, Configuration], *, prefix: str = "") -> str:
    """Return the SRDF of the robot with named states.

    Parameters
    ----------
    configurations : mapping of str to Configuration
        The states by name; `home` is added. All of one geometry: that of the URDF.
    prefix : str
        As for `expand`.

    Raises
    ------
    DescriptionError
        If a state is called `home`, or has another geometry than the rest.
    ArgumentError
        If a state is no single configuration that exists.
    """
    check_prefix(prefix)
    lines = ['<?xml version="1.0" ?>', '<robot name="spm">']
    for group, joints in (("legs", SLIDES), ("mechanism", JOINTS)):
        lines.append(f'  <group name="{group}">')
        lines += [f'    <joint name="{prefix}{name}"/>' for name in joints]
        lines.append("  </group>")
    lines += _state(HOME, dict.fromkeys(JOINTS, 0.0), prefix)
    geometries = set()
    for name, configuration in configurations.items():
        if name == HOME:
            raise DescriptionError("configurations", "other names than home, which is all joints at zero", name)
        geometries.add(configuration.geometry)
        if len(geometries) > 1:
            raise DescriptionError("configurations", "one geometry in all states", f"another one in {name}")
        values = joint_values(configuration)
        limits = configuration.geometry.limits
        if limits is not None and not limits.contains(configuration.readings):
            beyond = -1e3 * float(limits.margin(configuration.readings))
            lines.append(f"  <!-- A solution outside the leg limits, by {beyond:.1f} mm. -->")
        lines += _state(name, values, prefix)
    lines += [f'  <passive_joint name="{prefix}{name}"/>' for name in PASSIVE]
    for a, b in touching_links():
        lines.append(f'  <disable_collisions link1="{prefix}{a}" link2="{prefix}{b}" reason="Adjacent"/>')
    return "\n".join([*lines, "</robot>", ""])


def _state(name: str, values: Mapping[str, float], prefix: str) -> list[str]:
    joints = [f'    <joint name="{prefix}{joint}" value="{value!r}"/>' for joint, value in values.items()]
    return [f'  <group_state name="{name}" group="mechanism">', *joints, "  </group_state>"]
