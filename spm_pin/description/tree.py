"""The spanning tree, as `urdf/spm_macro.xacro` has it: its joints and their values, and the files that name them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from spm_pin.description.source_files import check_prefix, read_closures
from spm_pin.errors import DescriptionError
from spm_pin.mechanism import Configuration, Geometry, joint_angles
from spm_pin.mechanism.arguments import check_instance
from spm_pin.mechanism.configuration import check_configuration
from spm_pin.mechanism.joint_angles import actuated_joints, joint_names, value_names

SLIDES = actuated_joints()
"""The actuated joints of RPS legs, in the order of `spm_pin.mechanism.LEGS`; see `actuated_joints`."""

HOME = "home"
"""Name of the state in which all joints are at zero."""


def extended_urdf_text(geometry: Geometry | None = None, *, prefix: str = "") -> str:
    """Return closures and motors as an Extended-URDF file, to lie beside the URDF of a machine, by default the paper's.

    Layout of https://github.com/Gepetto/example-parallel-robots. The names of the closures have no place in it. No
    joint changes its type when loaded: `joint_name` and `joint_type` are empty.
    """
    closures = read_closures(prefix=prefix)
    pairs = ",\n  ".join(f"['{closure.frame_a}', '{closure.frame_b}']" for closure in closures)
    types, motors = ["3d"] * len(closures), [prefix + joint for joint in actuated_joints(geometry)]
    return f"closed_loop: [\n  {pairs}\n]\ntype: {types}\nname_mot: {motors}\njoint_name: []\njoint_type: []\n"


def joint_values(configuration: Configuration) -> dict[str, float]:
    """Return the values of the tree's eighteen joints in a single configuration that exists.

    By name, without prefix, in the order of `joint_names`: of passive joints angles in [-π, π] [rad], of actuated ones
    the reading without offset minus that at home [m, rad]. Where the configuration violates the mechanism's closure, so
    does the tree.
    """
    check_configuration(configuration, single=True, existing=True)
    geometry, angles = configuration.geometry, joint_angles(configuration, corners=(0,)).values
    values = dict(zip(value_names(geometry), angles.tolist(), strict=True))
    return {name: values[name] for name in joint_names(geometry)}


def machine_of(states: Mapping[str, Configuration], geometry: Geometry | None) -> Geometry:
    """Return the machine of named states and of a URDF, or raise unless they have one."""
    if not isinstance(states, Mapping):
        raise DescriptionError("states", "a mapping of names to configurations", type(states).__name__)
    machines = [check_configuration(state, "states").geometry for state in states.values()]
    machine = next(iter(machines), None) or Geometry.paper()
    machine = machine if geometry is None else check_instance(geometry, Geometry, "geometry")
    for name, other in zip(states, machines, strict=True):
        if other != machine:
            raise DescriptionError("states", "one geometry in all states, the robot's", f"another one in {name}")
    return machine


def state_values(states: Mapping[str, Configuration], geometry: Geometry, prefix: str) -> dict[str, dict[str, float]]:
    """Return the values of the joints, named with the prefix, in `home` and in named states of a geometry."""
    values = {HOME: dict.fromkeys((prefix + joint for joint in joint_names(geometry)), 0.0)}
    for name, configuration in states.items():
        if not isinstance(name, str) or name == HOME:
            raise DescriptionError("states", "names other than home, which is all joints at zero", repr(name))
        values[name] = {prefix + joint: value for joint, value in joint_values(configuration).items()}
    return values


def srdf_text(
    states: Mapping[str, Configuration] | None = None, *, geometry: Geometry | None = None, prefix: str = ""
) -> str:
    """Return the SRDF: groups, named states, passive joints, and pairs of links that touch by design.

    Parameters
    ----------
    states : mapping of str to Configuration, optional
        The states by name, all of one geometry, that of the URDF; `home` is added.
    geometry : Geometry, optional
        That of the URDF; by default that of the states, or else the paper's.
    prefix : str
        As for `urdf_text`.
    """
    check_prefix(prefix)
    states = {} if states is None else states
    machine = machine_of(states, geometry)
    actuated, every = actuated_joints(machine), joint_names(machine)
    lines = ['<?xml version="1.0" ?>', '<robot name="spm">']
    for group, joints in (("legs", actuated), ("mechanism", every)):
        lines.append(f'  <group name="{group}">')
        lines += [f'    <joint name="{prefix}{name}"/>' for name in joints]
        lines.append("  </group>")
    for name, values in state_values(states, machine, prefix).items():
        limits = None if name == HOME else states[name].geometry.limits
        if limits is not None and not limits.contains(states[name].readings):
            excess = np.abs(states[name].limit_excess)
            unit = machine.legs.units[int(excess.argmax())]
            lines.append(f"  <!-- A solution outside the leg limits, by {1e3 * excess.max():.1f} m{unit}. -->")
        lines.append(f'  <group_state name="{name}" group="mechanism">')
        lines += [f'    <joint name="{joint}" value="{value!r}"/>' for joint, value in values.items()]
        lines.append("  </group_state>")
    lines += [f'  <passive_joint name="{prefix}{name}"/>' for name in every if name not in actuated]
    for a, b in touching_links(machine):
        lines.append(f'  <disable_collisions link1="{prefix}{a}" link2="{prefix}{b}" reason="Adjacent"/>')
    return "\n".join([*lines, "</robot>", ""])


def touching_links(geometry: Geometry) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that touch by design: those around one joint."""
    groups: list[tuple[str, ...]] = []
    bodies = {stage: kind.body for stage, kind in zip("bc", geometry.legs.kinds, strict=True)}
    for i in "123":
        for platform, corner, leg in (("base", f"base_a{i}", "b"), ("terminal_platform", f"terminal_c{i}", "c")):
            groups.append((platform, corner, f"leg_{leg}{i}_{bodies[leg]}"))
            groups.append((f"leg_{leg}{i}_{bodies[leg]}", f"leg_{leg}{i}_rod"))
        legs = tuple(f"leg_{stage}{i}_{part}" for stage in "bc" for part in ("rod", "tip"))
        inner = ("ball_b1_x_link", "ball_b1_y_link", "ball_c1_z_link", "ball_c1_y_link")
        groups.append(("middle_platform", f"middle_b{i}", *legs, *(inner if i == "1" else (f"middle_b{i}_upper",))))
    return tuple(dict.fromkeys(pair for group in groups for pair in itertools.combinations(group, 2)))
