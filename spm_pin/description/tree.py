"""The joints of the spanning tree, as `urdf/spm_macro.xacro` has them: names, values in a configuration, neighbours."""

from __future__ import annotations

import itertools

from spm_pin.mechanism import Configuration, joint_angles
from spm_pin.mechanism.configuration import check_configuration

JOINTS = (
    *("leg_b1_hip", "leg_b1_slide", "ball_b1_x", "ball_b1_y", "ball_b1_z"),
    *("ball_c1_z", "ball_c1_y", "ball_c1_x", "leg_c1_slide", "leg_c1_hip"),
    *("leg_b2_hip", "leg_b2_slide", "leg_b3_hip", "leg_b3_slide"),
    *("leg_c2_hip", "leg_c2_slide", "leg_c3_hip", "leg_c3_slide"),
)
"""The eighteen joints: up the first legs to the terminal platform, then the other lower and upper legs."""

SLIDES = tuple(f"leg_{name}_slide" for name in ("b1", "b2", "b3", "c1", "c2", "c3"))
"""The actuated joints, in the order of `spm_pin.LEGS`."""

ANGLES = (
    *(f"leg_{name}_hip" for name in ("b1", "b2", "b3", "c1", "c2", "c3")),
    *(f"ball_{leg}_{axis}" for axis in "xyz" for leg in ("b1", "c1")),
)
"""The joints that turn, in the order of `spm_pin.mechanism.joint_angles` for the balls of the first legs."""

PASSIVE = tuple(name for name in JOINTS if name not in SLIDES)
"""The joints without an actuator."""


def joint_values(configuration: Configuration) -> dict[str, float]:
    """Return the values of the tree's eighteen joints in a single configuration that exists.

    By name, without prefix, in the order of `JOINTS`: angles in [-π, π] [rad], slides [m] as length minus home length.
    Where the configuration violates the mechanism's closure, so does the tree.
    """
    check_configuration(configuration, single=True, existing=True)
    found = joint_angles(configuration, corners=(0,)).values
    values = dict(zip((*ANGLES, *SLIDES), found.tolist(), strict=True))
    return {name: values[name] for name in JOINTS}


def touching_links() -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that touch by design: those around one joint."""
    groups: list[tuple[str, ...]] = []
    for i in "123":
        for platform, corner, leg in (("base", f"base_a{i}", "b"), ("terminal_platform", f"terminal_c{i}", "c")):
            groups.append((platform, corner, f"leg_{leg}{i}_cylinder"))
            groups.append((f"leg_{leg}{i}_cylinder", f"leg_{leg}{i}_rod"))
        legs = tuple(f"leg_{stage}{i}_{part}" for stage in "bc" for part in ("rod", "tip"))
        inner = ("ball_b1_x_link", "ball_b1_y_link", "ball_c1_z_link", "ball_c1_y_link") if i == "1" else ()
        groups.append(("middle_platform", f"middle_b{i}", *legs, *inner))
    return tuple(dict.fromkeys(pair for group in groups for pair in itertools.combinations(group, 2)))
