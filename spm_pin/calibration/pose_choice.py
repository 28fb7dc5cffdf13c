"""Poses whose measurement identifies a machine best: exchange of a D-optimal design."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from spm_pin.calibration.error_model import error_jacobian, parameter_scale, selected
from spm_pin.calibration.identification import visible_basis
from spm_pin.calibration.measurements import pose_covariances
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism import PARAMETERS, Configuration, Geometry
from spm_pin.mechanism.arguments import FloatArray, as_bool, check_instance, generator, whole_number
from spm_pin.mechanism.configuration import check_configuration

_SWEEPS = 20
"""Passes of exchanges over all chosen poses at most."""
_GAIN = 1e-6
"""Relative gain below which no pose is exchanged any more."""
_RIDGE = 1e-6
"""Information, relative to that of a pose, from which the first choice starts."""


def choose_poses(
    geometry: Geometry,
    count: int = 40,
    *,
    candidates: int | Configuration = 500,
    parameters: Collection[str] | str | None = None,
    positions_only: bool = False,
    pose_noise: npt.ArrayLike = (1e-5, 1e-5),
    length_noise: npt.ArrayLike = 1e-6,
    rng: object = None,
) -> Configuration:
    """Choose the poses whose measurement identifies a machine best: with the smallest ellipsoid of uncertainty.

    Parameters
    ----------
    geometry : Geometry
        The machine as it is known before.
    count : int
        Number of poses.
    candidates : int or Configuration
        What to choose from: states of shape (M,), or the number of states drawn uniformly within the leg limits.
    parameters, pose_noise, length_noise
        As for `identify`.
    positions_only : bool
        Positions of o will be measured, no orientations.
    rng : numpy.random.Generator, seed, or None
        Source of the candidates.

    Returns
    -------
    Configuration
        States of shape (count,), the most informative first; each candidate at most once.
    """
    machine = check_instance(geometry, Geometry, "geometry")
    wanted = selected(PARAMETERS if parameters is None else parameters, "parameters")
    basis, _ = visible_basis(machine, wanted, as_bool(positions_only, "positions_only"))
    components = 3 if positions_only else 6
    few = -(-basis.shape[1] // components)
    count = whole_number(count, "count", f"a number of poses, at least {few} for {basis.shape[1]} unknowns", least=few)
    if isinstance(candidates, Configuration):
        states = check_configuration(candidates, "candidates", existing=True)
    else:
        states = random_states(machine, whole_number(candidates, "candidates", least=1), rng)
    if len(states.shape) != 1 or len(states) < count:
        raise ArgumentError("candidates", f"at least {count} states along one axis", f"shape {states.shape}")
    total = pose_covariances(states, components, pose_noise, length_noise)
    rows = error_jacobian(states)[:, :components] @ (parameter_scale(machine)[:, None] * basis)
    rows = np.linalg.solve(np.linalg.cholesky(total), rows)
    return states[np.array(_exchanged(rows, count))]


def random_states(geometry: Geometry, count: int, rng: object) -> Configuration:
    """Return states at leg readings drawn uniformly from the limits, (count,)."""
    if geometry.limits is None or not np.isfinite(geometry.limits.maximum).all():
        cause = "Give the limits to the Geometry, or the states to choose from"
        raise ArgumentError("geometry", "a machine with leg limits to draw states from", "none", cause)
    random, readings, wanted = generator(rng), [], count
    for _ in range(100):
        low, high = np.array(geometry.limits.minimum), np.array(geometry.limits.maximum)
        states = forward_physical(geometry, random.uniform(low, high, (2 * wanted, 6)))
        readings.append(states.readings[states.exists][:wanted])
        wanted -= len(readings[-1])
        if not wanted:
            return forward_physical(geometry, np.concatenate(readings))
    raise ArgumentError("geometry", "leg limits within which the machine has states", repr(geometry.limits))


def _exchanged(rows: FloatArray, count: int) -> list[int]:
    """Choose `count` of M whitened Jacobians (M, c, n): one after the other, then by exchange."""
    information = np.swapaxes(rows, -1, -2) @ rows
    total = _RIDGE * np.trace(information, axis1=-2, axis2=-1).mean() * np.eye(rows.shape[-1])
    chosen: list[int] = []

    def best(base: FloatArray) -> tuple[int, FloatArray]:
        """Return the candidate that adds most to the determinant of this information, and what each candidate adds."""
        inner = np.eye(rows.shape[1]) + rows @ np.linalg.inv(base) @ np.swapaxes(rows, -1, -2)
        gains = np.linalg.slogdet(inner)[1]
        free = np.where(np.isin(np.arange(len(rows)), chosen), -np.inf, gains)
        return int(free.argmax()), gains

    for _ in range(count):
        index, _ = best(total)
        chosen.append(index)
        total = total + information[index]
    for _ in range(_SWEEPS):
        changed = False
        for place, index in enumerate(list(chosen)):
            base = total - information[index]
            other, gains = best(base)
            if gains[other] > gains[index] + _GAIN * abs(gains[index]):
                chosen[place], total, changed = other, base + information[other], True
        if not changed:
            break
    return chosen
