"""The parameters of a machine from measured poses and readings, by least squares.

What is compared are the poses that the machine would have at the measured readings with the poses measured: forward
displacement has no singularity where a machine works. Errors of the readings count as the pose errors that they cause.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from scipy.special import gammainccinv

from spm_pin.calibration.error_model import error_jacobian, invisible_errors, parameter_scale, selected
from spm_pin.calibration.measurements import MeasurementError, Measurements, pose_covariances
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism import PARAMETERS, Configuration, Geometry
from spm_pin.mechanism.arguments import BoolArray, FloatArray, choice

_LOSSES = ("linear", "soft_l1", "huber", "cauchy")
_UNKNOWN = 0.3
"""Standard deviation, in radians or sides of the middle platform, from which on a combination is not determined."""
_CONVERGED, _EVALUATIONS = 1e-9, 60
"""Relative changes at which an iteration ends, and the most evaluations it may take."""
_CHANCE = 1e-6
"""Probability that a good measurement is taken for an outlier, all measurements together."""


@dataclass(frozen=True, repr=False)
class Calibration:
    """A machine identified from N measurements, and how well it is known."""

    geometry: Geometry
    """The machine."""
    covariance: FloatArray
    """Covariance of the parameters [m, rad], shape (54, 54), zero along what is not identifiable."""
    identifiable: FloatArray
    """Combinations of parameters that the measurements determine, shape (n, 54), the best first: rows of length one,
    for parameters in radians and in sides of the middle platform."""
    deviations: FloatArray
    """Their standard deviations, shape (n,)."""
    unidentifiable: FloatArray
    """Combinations that change no measurement of this kind, such as a shift of {n}, shape (k, 54); kept at their
    initial values."""
    before: FloatArray
    """Predicted less measured poses before the identification: displacement [m] and rotation vector [rad] in {B}, shape
    (N, 6), or displacement alone (N, 3)."""
    residuals: FloatArray
    """The same after the identification, of the same units and shape."""
    misfit: FloatArray
    """Residuals in units of their expected errors, root mean square of a measurement, shape (N,); 1 is as expected."""
    outliers: BoolArray
    """Measurements that do not belong to the others, shape (N,)."""

    def __repr__(self) -> str:
        first, last = (1e3 * np.sqrt((e[:, :3] ** 2).sum(axis=-1).mean()) for e in (self.before, self.residuals))
        return (
            f"<Calibration: {len(self.deviations)} of {len(self.deviations) + len(self.unidentifiable)} combinations "
            f"from {len(self.residuals)} measurements, position error {first:.3g} mm before, {last:.3g} mm after>"
        )

    def accuracy(self, configuration: Configuration) -> FloatArray:
        """Return the covariance (..., 6, 6) of the platform's predicted pose (displacement, rotation) [m, rad], in {B}.

        The states (...) are anywhere in the workspace, of this machine or of the nominal one.
        """
        jacobian = error_jacobian(configuration)
        return np.asarray(jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2))


def identify(
    geometry: Geometry,
    poses: Any,
    leg_lengths: npt.ArrayLike,
    *,
    parameters: Collection[str] | str | None = None,
    pose_noise: npt.ArrayLike = (1e-5, 1e-5),
    length_noise: npt.ArrayLike = 1e-6,
    loss: str = "linear",
) -> Calibration:
    """Identify a machine from measured poses and readings.

    Parameters
    ----------
    geometry : Geometry
        The machine as it is known before.
    poses : RigidTransform of shape (N,), array_like (N, 4, 4), or array_like (N, 3)
        Measured poses of {m} in {B}; or positions of o alone [m].
    leg_lengths : array_like, shape (N, 6)
        Readings of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 at these poses [m].
    parameters : collection of str, optional
        What to identify: names of `PARAMETERS`, components such as "pivot_x", "direction", "pivot", "ball", "offset",
        or legs; all if not given. The others keep their values.
    pose_noise : array_like
        Standard deviations of the measured position [m] and orientation [rad], or covariances (6, 6) or (N, 6, 6) of
        (displacement, rotation vector) in {B}; one number, (3, 3) or (N, 3, 3) for positions.
    length_noise : array_like
        Standard deviation of the readings [m], one or six, or covariances (6, 6) or (N, 6, 6).
    loss : {"linear", "soft_l1", "huber", "cauchy"}
        "linear" refuses outliers. The others, see `scipy.optimize.least_squares`, take them in with less weight, and
        mark them.

    Returns
    -------
    Calibration
        The machine, its covariance, residuals and outliers.

    Raises
    ------
    PoseError, ArgumentError
        If an argument has the wrong kind or shape, or is not finite.
    MeasurementError
        If readings are in another unit or such that the machine has no state, columns are exchanged, a row is an
        outlier, or the measurements are too few or too much alike to determine the parameters.
    """
    start = geometry
    wanted = selected(PARAMETERS if parameters is None else parameters, "parameters")
    choice(loss, "loss", _LOSSES)
    data = Measurements.check(start, poses, leg_lengths)
    count, components = len(data.position), data.components
    total = pose_covariances(forward_physical(start, data.readings), components, pose_noise, length_noise)
    # Matrices (N, n, n) that give residuals unit covariance.
    whitening = np.linalg.inv(np.linalg.cholesky(total))
    basis, invisible = visible_basis(start, wanted, components == 3)
    if count * components < basis.shape[1]:
        few = -(-basis.shape[1] // components)
        expected = f"at least {few} measurements for {basis.shape[1]} unknowns"
        raise MeasurementError("poses", expected, f"{count}", "Measure more, or name fewer `parameters`")
    scaled = parameter_scale(start)[:, None] * basis

    def machine(unknown: FloatArray) -> Geometry:
        return start.from_parameters(start.parameters + scaled @ unknown)

    def residuals(unknown: FloatArray) -> FloatArray:
        errors = data.errors(machine(unknown))
        # A machine that cannot have these readings is far off.
        whitened = (whitening @ np.nan_to_num(errors, nan=1e3 * start.nominal.middle_side)[..., None]).reshape(-1)
        return np.asarray(whitened)

    def jacobian(unknown: FloatArray) -> FloatArray:
        state = forward_physical(machine(unknown), data.readings)
        rows = np.nan_to_num(error_jacobian(state)[:, :components])
        return np.asarray((whitening @ rows @ scaled).reshape(-1, scaled.shape[1]))

    first = np.zeros(basis.shape[1])
    _check_determined(jacobian(first), basis, count)
    solution = _solved(residuals, jacobian, first, "soft_l1" if loss == "linear" else loss)
    outliers = _outliers(residuals(solution).reshape(count, components))
    if loss == "linear":
        if outliers.any():
            rows = np.flatnonzero(outliers)
            shown = ", ".join(map(str, rows[:10])) + (", …" if len(rows) > 10 else "")
            cause = "Look at these rows, leave them out, or give loss='soft_l1'"
            raise MeasurementError("poses", "measurements that fit one machine", f"outliers in the rows {shown}", cause)
        solution = _solved(residuals, jacobian, solution, loss)
    slopes = jacobian(solution)[np.repeat(~outliers, components)]
    _, values, right = np.linalg.svd(slopes, full_matrices=False)
    found, whitened = machine(solution), residuals(solution).reshape(count, components)
    spread = scaled @ (right.T / values)
    return Calibration(
        geometry=found,
        covariance=spread @ spread.T,
        identifiable=right @ basis.T,
        deviations=1.0 / values,
        unidentifiable=invisible,
        before=data.errors(start),
        residuals=data.errors(found),
        misfit=np.sqrt((whitened**2).mean(axis=-1)),
        outliers=outliers,
    )


def visible_basis(start: Geometry, wanted: BoolArray, positions_only: bool) -> tuple[FloatArray, FloatArray]:
    """Return orthonormal combinations of scaled parameters that measurements show, (54, n), and the others, (k, 54)."""
    scale = parameter_scale(start)
    hidden = invisible_errors(start, positions_only) / scale[:, None]
    # Those combinations of the invisible errors that leave the other parameters alone.
    _, values, right = np.linalg.svd(hidden[~wanted], full_matrices=True)
    rank = int((values > 1e-9).sum())
    inside = hidden @ right[rank:].T
    left, values, _ = np.linalg.svd(inside, full_matrices=False)
    hidden = left[:, values > 1e-9]
    chosen = np.eye(54)[:, wanted]
    chosen = chosen - hidden @ (hidden.T @ chosen)
    left, values, _ = np.linalg.svd(chosen, full_matrices=False)
    return left[:, values > 1e-9], hidden.T


def _solved(residuals: Any, jacobian: Any, first: FloatArray, loss: Any) -> FloatArray:
    tolerances: Any = dict.fromkeys(("xtol", "ftol", "gtol"), _CONVERGED)
    result = scipy.optimize.least_squares(
        residuals, first, jac=jacobian, loss=loss, max_nfev=_EVALUATIONS, **tolerances
    )
    return np.asarray(result.x)


def _check_determined(slopes: FloatArray, basis: FloatArray, count: int) -> None:
    """Raise if a combination of the unknowns is not determined by the measurements."""
    _, values, right = np.linalg.svd(slopes, full_matrices=False)
    unknown = values * _UNKNOWN < 1.0
    if unknown.any():
        worst = basis @ right[-1]
        names = ", ".join(PARAMETERS[k] for k in np.argsort(-np.abs(worst))[:3])
        received = f"{count} poses that determine {int((~unknown).sum())}; the least determined one moves {names}"
        cause = (
            "Measure at poses further apart, see choose_poses, or name fewer `parameters`. "
            "Are pose_noise and length_noise too large?"
        )
        raise MeasurementError("poses", f"poses that determine {len(unknown)} combinations", received, cause)


def _outliers(whitened: FloatArray) -> BoolArray:
    """Return which rows (N, n) of whitened residuals do not belong to the others."""
    squares, freedom = (whitened**2).sum(axis=-1), whitened.shape[1]
    # The fit takes part of the noise away, or the noise was given too small: the median tells its size.
    median, largest = (2.0 * gammainccinv(0.5 * freedom, p) for p in (0.5, _CHANCE / len(squares)))  # of χ²
    return np.asarray(squares > max(np.median(squares) / median, 1e-12) * largest)
