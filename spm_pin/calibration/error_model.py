"""The derivative of the platform's pose by errors of the 54 parameters, and combinations of errors that do not move it.

At constant readings every leg gives two equations in the errors and in the twists t_L of the middle platform and t of
the terminal one. With δ along the leg, n its axis, b its ball and a its pivot, all in {B}, and the errors dp, da, dn
and do of ball, pivot, axis and offset:

    lower:  δ·t_L(b) = δ·da - δ·dp - do,              n·t_L(b) = n·da - n·dp - dn·(b - a),
    upper:  δ·(t - t_L)(b) = δ·dp - δ·da - do,        n·(t - t_L)(b) = n·dp - n·da + dn·(b - a).

On the left are the matrices J_b and J_c of `spm_pin.kinematics.rates_and_forces`.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.rates_and_forces import stage_inverses
from spm_pin.mechanism import LEGS, PARAMETERS, Configuration, Geometry
from spm_pin.mechanism.arguments import BoolArray, FloatArray, check_instance
from spm_pin.mechanism.configuration import check_configuration
from spm_pin.mechanism.geometry import check_rps


def error_jacobian(configuration: Configuration) -> FloatArray:
    """Return how the platform moves per error of each parameter, at constant readings.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).

    Returns
    -------
    ndarray, shape (..., 6, 54)
        Rows (v, ω): displacement of o [m] and rotation of m [rad], in {B}; columns `PARAMETERS`, per metre or radian.
        NaN for a member of a batch that does not exist, or is at a forward or a constraint singularity, where a single
        state raises `SingularConfigurationError`.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> state = spm.forward_physical(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> jacobian = spm.calibration.error_jacobian(state)
    >>> errors = np.full(54, 1e-4)  # 0.1 mm and 0.1 mrad everywhere
    >>> (jacobian @ errors)[:3].round(6)
    array([-6.0e-06,  6.9e-05, -3.9e-05])
    """
    check_configuration(configuration)
    state, geometry = configuration, configuration.geometry
    check_rps(geometry, "errors of the legs")
    outward = np.where(np.arange(6) < 3, 1.0, -1.0)[:, None]
    # The arms from pivots to balls, and unit vectors along the legs, those of the upper ones from ball to pivot.
    arms, axes = outward * state.leg_vectors, state.leg_axes
    with np.errstate(invalid="ignore"):
        along = state.leg_vectors / state.leg_lengths[..., None]
    frames = np.empty((*state.shape, 6, 3, 3))
    frames[..., :3, :, :], frames[..., 3:, :, :] = np.eye(3), state.rotation[..., None, :, :]
    middle = state.middle_pose.as_matrix()[..., None, :3, :3]
    rows = np.zeros((*state.shape, 6, 2, 9))
    turned = frames @ geometry.axis_derivatives
    for row, direction in enumerate((along, axes)):
        rows[..., row, 2:5] = outward * (direction[..., None, :] @ frames)[..., 0, :]
        rows[..., row, 5:8] = -outward * (direction[..., None, :] @ middle)[..., 0, :]
    rows[..., 0, 8] = -1.0
    rows[..., 1, :2] = -outward * (arms[..., None, :] @ turned)[..., 0, :]
    inverses = stage_inverses(state)
    moved = np.empty((*state.shape, 6, 6, 9))
    for leg in range(6):
        columns = inverses[..., leg // 3, :, [leg % 3, 3 + leg % 3]]
        # Advanced indices move to the front: (2, ..., 6).
        moved[..., leg, :, :] = np.einsum("k...i,...kj->...ij", columns, rows[..., leg, :, :])
    return np.asarray(np.swapaxes(moved, -3, -2).reshape(*state.shape, 6, 54))


def platform_error(state: Configuration, rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Return the displacements [m] and rotation vectors [rad] (N, 6) from poses (N, 3, 3), (N, 3) to states (N,)."""
    turn = np.full((len(position), 3), np.nan)
    exists = state.exists
    if exists.any():
        relative = state.rotation[exists] @ np.swapaxes(rotation[exists], -1, -2)
        turn[exists] = Rotation.from_matrix(relative).as_rotvec()
    return np.concatenate([state.translation - position, turn], axis=-1)


def gauge_directions(geometry: Geometry, positions_only: bool) -> FloatArray:
    """Return the errors that change no measurement, (54, 6), or (54, 9) if only positions of o are measured.

    Six move the frame {n} and with it the coordinates of all balls; the other three turn the frame {m} about o.
    """
    directions = np.zeros((6, 9, 9 if positions_only else 6))
    first = np.linalg.pinv(geometry.axis_derivatives)
    for k in range(3):
        axis = np.eye(3)[k]
        directions[:, 5 + k, k] = 1.0
        directions[:, 5:8, 3 + k] = np.cross(axis, geometry.legs.balls)
        if positions_only:
            directions[3:, 2:5, 6 + k] = np.cross(axis, geometry.legs.pivots[3:])
            directions[3:, :2, 6 + k] = (first[3:] @ np.cross(axis, geometry.legs.axes[3:])[..., None])[..., 0]
    return directions.reshape(54, -1)


def parameter_scale(geometry: Geometry) -> FloatArray:
    """Return the unit of each parameter's error (54,): a radian, or the side of the middle platform [m]."""
    return np.tile(np.repeat([1.0, geometry.middle_side], [2, 7]), 6)


def selected(names: Collection[str] | str, argument: str) -> BoolArray:
    """Return which of `PARAMETERS` are meant by names of parameters, legs, components or kinds, such as `ball`."""
    several = [names] if isinstance(names, str) else check_instance(names, Collection, argument)  # type: ignore[type-abstract]
    wanted = {name if isinstance(name, str) else repr(name) for name in several}
    parts = [name.split(".") for name in PARAMETERS]
    keys = [{name, leg, part, part.split("_")[0]} for name, (leg, part) in zip(PARAMETERS, parts, strict=True)]
    unknown = sorted(name for name in wanted if not any(name in key for key in keys))
    if unknown or not wanted:
        expected = (
            "names of parameters such as r_b1.pivot_x, components such as pivot_x, direction, pivot, ball, offset"
        )
        raise ArgumentError(argument, f"{expected}, or legs {', '.join(LEGS)}", ", ".join(unknown) or "none")
    return np.array([bool(wanted & key) for key in keys])
