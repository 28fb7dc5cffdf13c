"""The coordinates (x, y, Z) of the stages of a configuration without torsion, and back.

The middle platform's quaternion against the base is (x0, x, y, 0) with x0 > 0, and its centre is at
(-2r xy, r (y² - x²), Z) over the base's centre, r = d/√3. The upper stage is the same stage upside down, seen from the
terminal platform and mirrored at its plane, so that Z is positive at home in both. See
`docs/theory/inverse_displacement.md`.

`spm_pin.workspace.states` does not mirror the upper stage, and divides heights by r: its coordinates of drawn machines
are (x, y, Z/r) of the lower stage and (-x, -y, -Z/r) of the upper one.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

_MIRROR = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
"""Sign of x, y and Z of each stage against those of the frame that it is seen from."""

_TORSION = 1e-9
"""Part x3 of the quaternion from which on a stage of the nominal machine has torsion."""


def stage_coordinates(configuration: Configuration) -> FloatArray:
    """Return (x, y, Z [m]) of the lower and upper stage, shape (..., 2, 3); NaN where there is none or in mode F.

    The stages of a machine as built have torsion; they are not in mode F as long as it is less than half a turn.
    """
    most = np.inf if not configuration.geometry.is_nominal else _TORSION
    middle = configuration.middle_pose.as_matrix()
    turned, centre = middle[..., :3, :3], middle[..., :3, 3]
    to_platform = np.swapaxes(configuration.rotation, -1, -2)
    offset = (to_platform @ (centre - configuration.translation)[..., None])[..., 0]
    states = []
    for sign, matrix, position in zip(_MIRROR, (turned, to_platform @ turned), (centre, offset), strict=True):
        there = np.asarray(np.isfinite(matrix).all(axis=(-2, -1)))
        quaternion = Rotation.from_matrix(np.where(there[..., None, None], matrix, np.eye(3))).as_quat()
        x, y, x3, x0 = np.moveaxis(np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion), -1, 0)
        straight = there & (np.abs(x3) <= most) & (x0 > np.abs(x3) + _TORSION)
        state = sign * np.stack([x, y, position[..., 2]], axis=-1)
        states.append(np.where(straight[..., None], state, np.nan))
    return np.stack(states, axis=-2)


def configuration_of_stages(geometry: Geometry, states: FloatArray) -> Configuration:
    """Return the configurations (...) of stage coordinates (..., 2, 3), as `stage_coordinates` returns them."""
    r = geometry.middle_radius
    poses = []
    for k, sign in enumerate(_MIRROR):
        x, y, z = np.moveaxis(sign * states[..., k, :], -1, 0)
        quaternion = np.stack([x, y, np.zeros_like(x), np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=-1)
        centre = np.stack([-2.0 * r * x * y, r * (y * y - x * x), z], axis=-1)
        poses.append(RigidTransform.from_components(centre, Rotation.from_quat(quaternion)))
    pose = poses[0] * poses[1].inv()
    corners = r * geometry.radial_directions
    joints = np.einsum("...ij,kj->...ki", poses[0].rotation.as_matrix(), corners)
    joints += poses[0].translation[..., None, :]
    return Configuration(geometry, pose, joints)
