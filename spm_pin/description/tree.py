"""The spanning tree, as `urdf/spm_macro.xacro` has it: its joints and their values, and the files that name them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

from spm_pin.description.source_files import check_prefix, read_closures
from spm_pin.errors import DescriptionError
from spm_pin.mechanism import Configuration, joint_angles
from spm_pin.mechanism.configuration import check_configuration
from spm_pin.mechanism.joint_angles import JOINTS

SLIDES = tuple(f"leg_{name}_slide" for name in ("b1", "b2", "b3", "c1", "c2", "c3"))
"""The actuated joints, in the order of `spm_pin.mechanism.LEGS`."""

ANGLES = (
    *(f"leg_{name}_hip" for name in ("b1", "b2", "b3", "c1", "c2", "c3")),
    *(f"ball_{leg}_{axis}" for axis in "xyz" for leg in ("b1", "c1")),
)
"""The joints that turn, in the order of `spm_pin.mechanism.joint_angles` for the balls of the first legs."""

PASSIVE = tuple(name for name in JOINTS if name not in SLIDES)
"""The joints without an actuator."""

HOME = "home"
"""Name of the state in which all joints are at zero."""


def extended_urdf_text(*, prefix: str = "") -> str:
    """Return closures and motors as an Extended-URDF file, to lie beside the URDF of any geometry.

    Layout of https://github.com/Gepetto/example-parallel-robots. The names of the closures have no place in it. No
    joint changes its type when loaded: `joint_name` and `joint_type` are empty.
    """
    closures = read_closures(prefix=prefix)
    pairs = ",\n  ".join(f"['{closure.frame_a}', '{closure.frame_b}']" for closure in closures)
    types, motors = ["3d"] * len(closures), [prefix + slide for slide in SLIDES]
    return f"closed_loop: [\n  {pairs}\n]\ntype: {types}\nname_mot: {motors}\njoint_name: []\njoint_type: []\n"


def joint_values(configuration: Configuration) -> dict[str, float]:
    """Return the values of the tree's eighteen joints in a single configuration that exists.

    By name, without prefix, in the order of `JOINTS`: angles in [-π, π] [rad], slides [m] as length minus home length.
    Where the configuration violates the mechanism's closure, so does the tree.
    """
    check_configuration(configuration, single=True, existing=True)
    angles = joint_angles(configuration, corners=(0,)).values
    values = dict(zip((*ANGLES, *SLIDES), angles.tolist(), strict=True))
    return {name: values[name] for name in JOINTS}


def state_values(states: Mapping[str, Configuration], prefix: str) -> dict[str, dict[str, float]]:
    """Return the values of the joints, named with the prefix, in `home` and in named states of one geometry."""
    if not isinstance(states, Mapping):
        raise DescriptionError("states", "a mapping of names to configurations", type(states).__name__)
    values = {HOME: dict.fromkeys((prefix + joint for joint in JOINTS), 0.0)}
    for name, configuration in states.items():
        if not isinstance(name, str) or name == HOME:
            raise DescriptionError("states", "names other than home, which is all joints at zero", repr(name))
        values[name] = {prefix + joint: value for joint, value in joint_values(configuration).items()}
        if configuration.geometry != next(iter(states.values())).geometry:
            raise DescriptionError("states", "one geometry in all states", f"another one in {name}")
    return values


def srdf_text(states: Mapping[str, Configuration] | None = None, *, prefix: str = "") -> str:
    """Return the SRDF: groups, named states, passive joints, and pairs of links that touch by design.

    Parameters
    ----------
    states : mapping of str to Configuration, optional
        The states by name, all of one geometry, that of the URDF; `home` is added.
    prefix : str
        As for `urdf_text`.
    """
    check_prefix(prefix)
    states = {} if states is None else states
    lines = ['<?xml version="1.0" ?>', '<robot name="spm">']
    for group, joints in (("legs", SLIDES), ("mechanism", JOINTS)):
        lines.append(f'  <group name="{group}">')
        lines += [f'    <joint name="{prefix}{name}"/>' for name in joints]
        lines.append("  </group>")
    for name, values in state_values(states, prefix).items():
        limits = None if name == HOME else states[name].geometry.limits
        if limits is not None and not limits.contains(states[name].readings):
            excess = -1e3 * float(limits.margin(states[name].readings))
            lines.append(f"  <!-- A solution outside the leg limits, by {excess:.1f} mm. -->")
        lines.append(f'  <group_state name="{name}" group="mechanism">')
        lines += [f'    <joint name="{joint}" value="{value!r}"/>' for joint, value in values.items()]
        lines.append("  </group_state>")
    lines += [f'  <passive_joint name="{prefix}{name}"/>' for name in PASSIVE]
    for a, b in touching_links():
        lines.append(f'  <disable_collisions link1="{prefix}{a}" link2="{prefix}{b}" reason="Adjacent"/>')
    return "\n".join([*lines, "</robot>", ""])


def touching_links() -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that touch by design: those around one joint."""
    groups: list[tuple[str, ...]] = []
    for i in "123":
        for platform, corner, leg in (("base", f"base_a{i}", "b"), ("terminal_platform", f"terminal_c{i}", "c")):
            groups.append((platform, corner, f"leg_{leg}{i}_cylinder"))
            groups.append((f"leg_{leg}{i}_cylinder", f"leg_{leg}{i}_rod"))
        legs = tuple(f"leg_{stage}{i}_{part}" for stage in "bc" for part in ("rod", "tip"))
        inner = ("ball_b1_x_link", "ball_b1_y_link", "ball_c1_z_link", "ball_c1_y_link")
        groups.append(("middle_platform", f"middle_b{i}", *legs, *(inner if i == "1" else (f"middle_b{i}_upper",))))
    return tuple(dict.fromkeys(pair for group in groups for pair in itertools.combinations(group, 2)))
