"""Positions of a camera at which the robot fills the picture."""

from __future__ import annotations

import numpy as np

from spm_pin.display.rendering import camera_axes
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration

VIEWS = {"Home": (15.0, 25.0), "Front": (0.0, 4.0), "Side": (90.0, 4.0), "Top": (0.0, 89.0)}
"""Azimuth and elevation of the viewer in {B} [degrees]; the first is that of the pictures."""

FIELD_OF_VIEW = np.deg2rad(28.0)
"""Vertical [rad]: narrow, as the pictures are parallel projections."""


def robot_points(configuration: Configuration, margin: float) -> FloatArray:
    """Return corners (n, 3) of boxes of half a side `margin` around the joints and o [m]; a picture shows them all."""
    joints = [configuration.leg_bases, configuration.middle_joints, configuration.translation[None]]
    corners = margin * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)
    return np.asarray((np.concatenate(joints)[:, None] + corners).reshape(-1, 3))


def fit_camera(
    points: FloatArray, view: tuple[float, float], aspect: float, covered: float = 0.0, border: float = 0.06
) -> tuple[FloatArray, FloatArray]:
    """Return the position of a camera and the point that it looks at [m], for points (n, 3) to fill its picture.

    `view` is the azimuth and elevation of the viewer [degrees], `aspect` width over height of the whole picture. From
    below something covers the share `covered` of it; a `border`, in shares of its height, stays empty at every edge.
    """
    azimuth, elevation = np.deg2rad(view)
    axes = camera_axes((float(azimuth), float(elevation)))
    half = np.tan(0.5 * FIELD_OF_VIEW)
    # Tangents of the viewing angles at the edges of the free part.
    high = half * np.array([aspect - 2.0 * border, 1.0 - 2.0 * border])
    low = np.array([-high[0], half * (2.0 * covered - 1.0 + 2.0 * border)])
    local = points @ axes.T
    centre, distance = local.mean(axis=0), 4.0 * float(np.ptp(local, axis=0).max())
    for _ in range(30):
        offset = local - centre
        tangents = offset[:, :2] / (distance - offset[:, 2:])
        least, most = tangents.min(axis=0), tangents.max(axis=0)
        centre[:2] += 0.5 * (least + most - low - high) * distance
        distance *= float(((most - least) / (high - low)).max())
    return (centre + np.array([0.0, 0.0, distance])) @ axes, centre @ axes
