"""The spanning tree's conventions: the names and the zero of its joints, as `urdf/spm_macro.xacro` has them."""

from __future__ import annotations

import itertools
import math
import re

from spm_pin.errors import DescriptionError
from spm_pin.mechanism.geometry import Geometry

__all__ = ["JOINTS", "PASSIVE", "SLIDES", "check_prefix", "home_leans", "home_lengths", "touching_links"]

JOINTS = (
    *("leg_b1_hip", "leg_b1_slide", "ball_b1_x", "ball_b1_y", "ball_b1_z"),
    *("ball_c1_z", "ball_c1_y", "ball_c1_x", "leg_c1_slide", "leg_c1_hip"),
    *("leg_b2_hip", "leg_b2_slide", "leg_b3_hip", "leg_b3_slide"),
    *("leg_c2_hip", "leg_c2_slide", "leg_c3_hip", "leg_c3_slide"),
)
"""The eighteen joints: up the first legs to the terminal platform, then the other lower and upper legs."""

SLIDES = tuple(f"leg_{name}_slide" for name in ("b1", "b2", "b3", "c1", "c2", "c3"))
"""The actuated joints, in the order of `spm_pin.LEGS`."""

PASSIVE = tuple(name for name in JOINTS if name not in SLIDES)
"""The joints without an actuator."""

# The sign that turns a leg outwards about the revolute axis, in the paper's sense of the axes.
_OUTWARD = (1.0, -1.0, -1.0)


def home_lengths(geometry: Geometry) -> tuple[float, float]:
    """Return the leg length at home of the lower and of the upper stage [m].

    It is the middle of the limits that the stage's three legs share, if the stage can stand there: if it is
    longer than the radial distance from hip to ball. Otherwise, and without limits, it is the shortest length
    allowed plus that of legs whose stage is as high as the sum of its two radii.
    """
    limits = geometry.limits
    r = geometry.middle_radius
    lengths = []
    for stage, radius in enumerate((geometry.base_radius, geometry.platform_radius)):
        legs = slice(3 * stage, 3 * stage + 3)
        low = max(limits.minimum[legs]) if limits else 0.0
        high = min(limits.maximum[legs]) if limits else math.inf
        middle, reach = 0.5 * (low + high), abs(r - radius)
        stands = low < high and reach < middle < math.inf
        lengths.append(middle if stands else low + math.hypot(reach, r + radius))
    return lengths[0], lengths[1]


def home_leans(geometry: Geometry) -> tuple[float, ...]:
    """Return, for each leg in the order of `spm_pin.LEGS`, its direction at home [rad].

    The angle about the leg's revolute axis from the platform's normal, z of {B} or {m}, to the direction from
    hip to ball.
    """
    leans: list[float] = []
    radii = (geometry.base_radius, geometry.platform_radius)
    for radius, length, up in zip(radii, home_lengths(geometry), (1.0, -1.0), strict=True):
        offset = geometry.middle_radius - radius
        height = up * math.sqrt((length - offset) * (length + offset))
        leans.extend(math.atan2(outward * offset, height) for outward in _OUTWARD)
    return tuple(leans)


def touching_links() -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that touch by design, and whose contact says nothing: those around one joint."""
    groups: list[tuple[str, ...]] = []
    for i in "123":
        for platform, corner, leg in (("base", f"base_a{i}", "b"), ("terminal_platform", f"terminal_c{i}", "c")):
            groups.append((platform, corner, f"leg_{leg}{i}_cylinder"))
            groups.append((f"leg_{leg}{i}_cylinder", f"leg_{leg}{i}_rod"))
        legs = tuple(f"leg_{stage}{i}_{part}" for stage in "bc" for part in ("rod", "tip"))
        inner = ("ball_b1_x_link", "ball_b1_y_link", "ball_c1_z_link", "ball_c1_y_link") if i == "1" else ()
        groups.append(("middle_platform", f"middle_b{i}", *legs, *inner))
    return tuple(dict.fromkeys(pair for group in groups for pair in itertools.combinations(group, 2)))


def check_prefix(prefix: str) -> None:
    """Raise `DescriptionError` unless `prefix` can begin a name in xacro, URDF, SRDF and YAML."""
    well_formed = isinstance(prefix, str) and re.fullmatch(r"([A-Za-z_][A-Za-z0-9_./-]*)?", prefix)
    # xacro turns these words into numbers and truth values, and so into other names.
    if not well_formed or prefix.lower() in ("inf", "infinity", "nan", "true", "false"):
        expected = "a name such as left_, of letters, digits and _ . / -, beginning with a letter"
        raise DescriptionError("prefix", expected, repr(prefix))
