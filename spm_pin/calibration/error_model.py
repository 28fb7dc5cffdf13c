"""The derivative of the platform's pose by errors of a machine's parameters, and errors that no measurement shows.

At constant readings every leg gives two equations in the errors and in the twists t_L of the middle platform and t of
the terminal one. With u from the centre c of its circle to its ball b, n its axis and a its pivot, all in {B}, the
errors dp, da, dn and do of ball, pivot, axis and offset, and those dν of the numbers that are fixed in a leg of its
kind, on which c and the radius ρ depend:

    lower:  u·t_L(b) = u·da - u·dp - κ do + Σ (u·∂c/∂ν + ∂ρ/∂ν) dν + φ u×(c - a),   n·t_L(b) = n·da - n·dp - dn·(b - a),
    upper:  the same with the twist t_L - t.

A stage alone has the lower legs, and t_L is the twist of its platform.

φ is the turn of the leg's plane about n that dn makes, and × the product in that plane. On the left are the matrices
J_b and J_c of `spm_pin.kinematics.rates_and_forces`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.rates_and_forces import stage_inverses
from spm_pin.machine import Configuration, Machine
from spm_pin.machine.configuration import check_configuration
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, real_array, real_number


def error_jacobian(configuration: Configuration) -> FloatArray:
    """Return how the platform moves in states (...) per error of each parameter, at constant readings.

    Returns
    -------
    ndarray, shape (..., 6, n)
        Rows (v, ω): displacement of the platform's origin [m] and rotation [rad], in {B}; columns
        `Machine.parameter_names`, nine for each RPS leg, per metre or radian. At singularities as
        `spm_pin.platform_jacobian`.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> jacobian = spm.calibration.error_jacobian(state)
    >>> errors = np.full(54, 1e-4)  # 0.1 mm and 0.1 mrad everywhere
    >>> (jacobian @ errors)[:3].round(6)
    array([-1.83e-04, -2.16e-04, -3.50e-05])
    """
    state = check_configuration(configuration)
    legs = state.machine.legs
    count = len(legs.names)
    outward = np.where(np.arange(count) < 3, 1.0, -1.0)[:, None]
    # Unit vectors from the circles' centres to the balls, in {B}, and in the planes of the legs.
    with np.errstate(invalid="ignore"):
        along = outward * state.leg_vectors / np.linalg.norm(state.leg_vectors, axis=-1, keepdims=True)
    across, centres = (
        np.stack([(points * axis).sum(axis=-1) for axis in state.leg_planes], axis=-1)
        for points in (along, state.circle_centres - state.leg_bases)
    )
    turning = centres[..., 0] * across[..., 1] - centres[..., 1] * across[..., 0]
    frames = np.empty((*state.shape, count, 3, 3))
    frames[..., :3, :, :], frames[..., 3:, :, :] = np.eye(3), state.rotation[..., None, :, :]
    middle = state.middle_pose.as_matrix()[..., None, :3, :3]
    tilts = legs.axis_derivatives
    rows = np.zeros((*state.shape, count, 2, 9))
    for row, direction in enumerate((along, state.leg_axes)):
        rows[..., row, 2:5] = (direction[..., None, :] @ frames)[..., 0, :]
        rows[..., row, 5:8] = -(direction[..., None, :] @ middle)[..., 0, :]
    rows[..., 0, 8] = -state.slopes
    rows[..., 0, :2] = turning[..., None] * (legs.plane_turns[:, None] @ tilts)[:, 0]
    rows[..., 1, :2] = -((state.balls - state.leg_bases)[..., None, :] @ (frames @ tilts))[..., 0, :]
    rows[..., 1, :] *= outward
    # Motions (..., legs, 6) that the two equations of each leg cause.
    sides = np.swapaxes(stage_inverses(state), -1, -2).reshape(*state.shape, len(legs.kinds), 2, 3, 6)
    along_leg, along_axis = (sides[..., k, :, :].reshape(*state.shape, count, 6) for k in range(2))
    moved = along_leg[..., None] * rows[..., 0, None, :] + along_axis[..., None] * rows[..., 1, None, :]
    columns = [_of_legs(moved)]
    for stage, derivatives in enumerate(legs.circle_derivatives(state.readings)):
        own = slice(3 * stage, 3 * stage + 3)
        slopes = (across[..., own, None, :] @ derivatives[..., :2, 1:])[..., 0, :] + derivatives[..., 2, 1:]
        columns.append(_of_legs(along_leg[..., own, :, None] * slopes[..., None, :]))
    return np.concatenate(columns, axis=-1)


def _of_legs(motions: FloatArray) -> FloatArray:
    """Return motions (..., legs, 6, n) by the parameters of each leg as columns (..., 6, legs n)."""
    return np.swapaxes(motions, -3, -2).reshape(*motions.shape[:-3], 6, motions.shape[-3] * motions.shape[-1])


def pose_errors(predicted: FloatArray, measured: FloatArray) -> FloatArray:
    """Return displacements [m] and rotation vectors [rad] (N, 6) from measured to predicted poses (N, 4, 4)."""
    turn, exists = np.full((len(measured), 3), np.nan), ~np.isnan(predicted[:, 0, 3])
    if exists.any():
        relative = predicted[exists, :3, :3] @ measured[exists, :3, :3].mT
        turn[exists] = Rotation.from_matrix(relative).as_rotvec()
    return np.concatenate([predicted[:, :3, 3] - measured[:, :3, 3], turn], axis=-1)


def gauge_directions(machine: Machine, base: FloatArray, target: FloatArray, *, has_lengths: bool = True) -> FloatArray:
    """Return the errors that change no measurement, of the parameters and of `Frames` (4, 4) each, (n + 12, k).

    Each of the frames {n}, {B} and {m} may move: {n} changes the coordinates of all balls, {B} and {m} those of a
    stage's axes and pivots, and what is measured from them; the {n} of a stage alone is what is measured. Where a
    circle moves straight, on a slide, the pivot may be anywhere on it. Where no length is measured the balls of a stage
    may be shifted, and where no reading is one, all its lengths may be in proportion.
    """
    legs, directions, point = machine.legs, [], target[:3, 3]
    count, is_alone = len(legs.names), machine.is_stage
    shown, (outward, forward) = np.linalg.pinv(legs.axis_derivatives), legs.planes
    turned = [np.array(kind.turned) for kind in legs.kinds]

    def add(own: FloatArray, links: FloatArray | float = 0.0, frames: FloatArray | float = 0.0) -> None:
        """Add errors of the legs (legs, 9), with a turn (legs,) of their links, and of the frames (12,)."""
        stages = (links + np.zeros(count)).reshape(-1, 3)
        changes = [np.outer(of_stage, by) for of_stage, by in zip(stages, turned, strict=True)]
        own[:, 8] += np.concatenate([x[:, 0] for x in changes])
        directions.append(np.concatenate([own.ravel(), *(x[:, 1:].ravel() for x in changes), frames + np.zeros(12)]))

    for shift, turn in zip(np.eye(6)[:, :3], np.eye(6)[:, 3:], strict=True):
        own, seen = np.zeros((count, 9)), np.concatenate([np.zeros(6), shift + np.cross(turn, point), turn])
        own[:, 5:8] = shift + np.cross(turn, legs.balls)
        add(own, frames=seen if is_alone else 0.0)
        tilts = np.cross(turn, legs.axes)
        # What is left of a turn in each leg's plane, whose own x stays level.
        links = (np.cross(turn, outward) * forward).sum(axis=-1) - (legs.plane_turns * tilts).sum(axis=-1)
        seen_from = np.concatenate([-base[:3, :3] @ shift, -base[:3, :3] @ turn, np.zeros(6)])
        for part, frames in ((slice(3), seen_from), (slice(3, 6), seen))[: len(legs.kinds)]:
            own, moved = np.zeros((count, 9)), np.zeros(count)
            own[part, :2] = (shown @ tilts[..., None])[part, :, 0]
            own[part, 2:5] = shift + np.cross(turn, legs.pivots[part])
            moved[part] = links[part]
            add(own, moved, frames)
    rates, later = (legs.centre_rates(np.full(count, reading)) for reading in (0.0, 1.0))
    for leg in np.flatnonzero((rates == later).all(axis=-1) & rates.any(axis=-1)):
        own = np.zeros((count, 9))
        own[leg, 2:5] = rates[leg, 0] * outward[leg] + rates[leg, 1] * forward[leg]
        own[leg, 8] = 1.0
        add(own)
    if not has_lengths:
        owners = np.array([name.partition(".")[0] for name in legs.parameter_names])
        lengths = np.where(np.array(legs.parameter_units) == "m", legs.parameters, 0.0)
        for stage, kind in enumerate(legs.kinds):
            part = slice(3 * stage, 3 * stage + 3)
            for shift in np.eye(3):
                own = np.zeros((count, 9))
                own[part, 5:8] = shift
                add(own)
            if kind.unit == "rad":
                scaled = np.where(np.isin(owners, legs.names[part]), lengths, 0.0)
                directions.append(np.concatenate([scaled, np.zeros(12)]))
    return np.array(directions).T


def parameter_scale(machine: Machine) -> FloatArray:
    """Return the unit of each parameter's error (n,): a radian, or the side of the triangle of balls [m]."""
    return np.where(np.array(machine.parameter_units) == "rad", 1.0, machine.ball_side)


def selected(machine: Machine, names: Collection[str] | str, argument: str) -> BoolArray:
    """Return which parameters are meant by names of parameters, legs, components or kinds, such as `ball`."""
    several = [names] if isinstance(names, str) else check_instance(names, Collection, argument)  # type: ignore[type-abstract]
    wanted = {name if isinstance(name, str) else repr(name) for name in several}
    parts = [name.split(".") for name in machine.parameter_names]
    keys = [{".".join(pair), *pair, pair[1].split("_")[0]} for pair in parts]
    unknown = sorted(name for name in wanted if not any(name in key for key in keys))
    if unknown or not wanted:
        known = ", ".join(dict.fromkeys(part.split("_")[0] for _, part in parts))
        expected = f"names of parameters such as r_b1.pivot_x, components such as pivot_x, {known}"
        raise ArgumentError(
            argument, f"{expected}, or legs {', '.join(machine.legs.names)}", ", ".join(unknown) or "none"
        )
    return np.array([bool(wanted & key) for key in keys])


def prior_deviations(machine: Machine, tolerances: Mapping[str, float] | npt.ArrayLike) -> FloatArray:
    """Return the standard deviations (n,) of the parameters, 0 of those not named."""
    count = len(machine.parameter_names)
    if isinstance(tolerances, Mapping):
        deviations = np.zeros(count)
        for name, value in tolerances.items():
            expected = "a standard deviation in metres or radians, not negative"
            deviation = real_number(value, f"tolerances[{name!r}]", expected, least=0.0)
            deviations[selected(machine, [name], "tolerances")] = deviation
        return deviations
    deviations = real_array(tolerances, "tolerances", (count,), "standard deviations of the parameters")
    if deviations.shape != (count,) or (deviations < 0.0).any():
        expected = f"{count} standard deviations, none negative, or a mapping of names to them"
        raise ArgumentError("tolerances", expected, deviations)
    return deviations
