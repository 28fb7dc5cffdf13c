"""The spanning tree of `urdf/spm_macro.xacro`: its joints, their values, and the files with their names."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from spm_pin.description.source_files import check_prefix, machine_or_paper, read_closures
from spm_pin.errors import DescriptionError
from spm_pin.machine import Configuration, joint_angles
from spm_pin.machine.configuration import check_configuration
from spm_pin.machine.joint_angles import actuated_joints, joint_names, value_names
from spm_pin.machine.machine import Machine

HOME = "home"
"""Name of the state in which all joints are at zero."""


def extended_urdf_text(machine: Machine | None = None, *, prefix: str = "") -> str:
    """Return closures and motors as an Extended-URDF file for the URDF of a machine, by default the paper's.

    The layout is that of https://github.com/Gepetto/example-parallel-robots, which has no names of closures. No
    joint changes its type when loaded: `joint_name` and `joint_type` are empty.
    """
    closures = read_closures(machine, prefix=prefix)
    pairs = ",\n  ".join(f"['{closure.frame_a}', '{closure.frame_b}']" for closure in closures)
    types, motors = ["3d"] * len(closures), [prefix + joint for joint in actuated_joints(machine)]
    return f"closed_loop: [\n  {pairs}\n]\ntype: {types}\nname_mot: {motors}\njoint_name: []\njoint_type: []\n"


def joint_values(configuration: Configuration) -> dict[str, float]:
    """Return the values of the tree's joints, eighteen or nine, for a single configuration that exists.

    They are by name, without prefix, in the order of `joint_names`: for passive joints angles in [-π, π] [rad], for
    actuated joints the reading without offset minus that in the home [m, rad]. If the configuration violates the
    closure equations, so does the tree.
    """
    check_configuration(configuration, single=True, existing=True)
    machine, angles = configuration.machine, joint_angles(configuration, corners=(0,)).values
    values = dict(zip(value_names(machine), angles.tolist(), strict=True))
    return {name: values[name] for name in joint_names(machine)}


def machine_of(states: Mapping[str, Configuration], machine: Machine | None) -> Machine:
    """Return the common machine of named states and of a URDF; raise an error if they differ."""
    if not isinstance(states, Mapping):
        raise DescriptionError("states", "a mapping of names to configurations", type(states).__name__)
    machines = [check_configuration(state, "states").machine for state in states.values()]
    machine = machine_or_paper(next(iter(machines), None) if machine is None else machine)
    for name, other in zip(states, machines, strict=True):
        if other != machine:
            raise DescriptionError(
                "states", "states of the robot's own machine", f"a state of another machine at {name}"
            )
    return machine


def state_values(states: Mapping[str, Configuration], machine: Machine, prefix: str) -> dict[str, dict[str, float]]:
    """Return the values of the joints, named with the prefix, in `home` and in named states of a machine."""
    values = {HOME: dict.fromkeys((prefix + joint for joint in joint_names(machine)), 0.0)}
    for name, configuration in states.items():
        if not isinstance(name, str) or name == HOME:
            raise DescriptionError("states", "names other than home, which is all joints at zero", repr(name))
        values[name] = {prefix + joint: value for joint, value in joint_values(configuration).items()}
    return values


def srdf_text(
    states: Mapping[str, Configuration] | None = None,
    *,
    machine: Machine | None = None,
    prefix: str = "",
) -> str:
    """Return the SRDF: groups, named states, passive joints, and pairs of links that touch by design.

    Parameters
    ----------
    states : mapping of str to Configuration, optional
        The states by name, all of the URDF's machine; `home` is added.
    machine : Manipulator or Stage, optional
        The machine of the URDF; by default that of the states, or else the paper's.
    prefix : str
        As for `urdf_text`.
    """
    check_prefix(prefix)
    states = {} if states is None else states
    machine = machine_of(states, machine)
    actuated, every = actuated_joints(machine), joint_names(machine)
    lines = ['<?xml version="1.0" ?>', f'<robot name="{"spm" if len(actuated) == 6 else "stage"}">']
    for group, joints in (("legs", actuated), ("mechanism", every)):
        lines.append(f'  <group name="{group}">')
        lines += [f'    <joint name="{prefix}{name}"/>' for name in joints]
        lines.append("  </group>")
    for name, values in state_values(states, machine, prefix).items():
        limits = None if name == HOME else machine.limits
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


def touching_links(machine: Machine) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that touch by design: those around one joint."""
    groups: list[tuple[str, ...]] = []
    is_robot = not machine.is_stage
    platform, middle = ("middle_platform", "middle_b") if is_robot else ("platform", "platform_b")
    names = [leg[2:] for leg in machine.legs.names]
    for k, leg in enumerate(names):
        plate, corner = ("base", "base_a") if k < 3 else ("terminal_platform", "terminal_c")
        body = f"leg_{leg}_{machine.legs.kinds[k // 3].body}"
        groups += [(plate, f"{corner}{k % 3 + 1}", body), (body, f"leg_{leg}_rod")]
    for k in range(3):
        legs = tuple(f"leg_{leg}_{part}" for leg in names[k::3] for part in ("rod", "tip"))
        ball = (
            f"ball_{leg}_{axis}_link" for leg, first in zip(names[::3], "xz", strict=False) for axis in (first, "y")
        )
        upper = (f"{middle}{k + 1}_upper",) if is_robot else ()
        groups.append((platform, f"{middle}{k + 1}", *legs, *(upper if k else ball)))
    return tuple(dict.fromkeys(pair for group in groups for pair in itertools.combinations(group, 2)))
