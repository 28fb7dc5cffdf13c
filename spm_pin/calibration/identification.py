"""The parameters of a machine from measured poses and readings, by least squares, and the poses to measure.

The poses of a machine at the measured readings are compared with the poses measured, because forward displacement has
no singularity where a machine works. Errors of the readings count as the pose errors that they cause. Poses are chosen
by exchange of a D-optimal design.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from spm_pin.calibration.error_model import (
    error_jacobian,
    gauge_directions,
    parameter_scale,
    prior_deviations,
    selected,
)
from spm_pin.calibration.frames import FRAME_PARAMETERS, Frames
from spm_pin.calibration.measurements import MeasurementError, Measurements, pose_covariances
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.random_states import random_states
from spm_pin.machine import LEGS, Configuration, Manipulator, as_rigid_transform
from spm_pin.machine.configuration import check_configuration
from spm_pin.machine.legs import RADIAL
from spm_pin.support import notebook
from spm_pin.support.arguments import BoolArray, FloatArray, as_bool, check_instance, choice, generator, whole_number

_LOSSES = ("linear", "soft_l1", "huber", "cauchy")
_UNKNOWN = 0.3
"""Standard deviation, in radians or sides of the middle platform, from which on a combination is not determined."""
_CONVERGED, _EVALUATIONS = 1e-9, 100
"""Relative changes at which an iteration ends, and the most evaluations it may take."""
_DIRECT = 20
"""Evaluations of the first fit: measurements that fit one machine take five or so."""
_CHANCE = 1e-6
"""Probability that a good measurement is taken for an outlier, all measurements together."""
_GROSS = 100.0
"""Times the noise from which on residuals are no matter of the noise."""
_MISFIT = 9.0
"""Largest reduced χ² of a fit: residuals three times what the noise explains."""
_MANUFACTURE = 0.04
"""Largest correction of E, C or d, relative: for the paper's C three standard deviations where coordinates have errors
of 1 % of d."""

_SWEEPS, _GAIN = 20, 1e-6
"""Passes of exchanges over all chosen poses at most, and the relative gain below which no pose is exchanged."""
_RIDGE = 1e-6
"""Information, relative to that of a pose, from which the first choice starts."""

_TRACKER = "Poses of a target in a tracker's own frame? With frames=True, --frames, both frames are estimated too"

_Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, repr=False)
class Calibration:
    """A machine identified from N measurements, and how well it is known."""

    fitted: Manipulator
    """The machine that fits the measurements best, whatever `status` says."""
    status: str
    """"fits"; or "outliers", "misfit", "not converged" or "another nominal": then `machine` raises an error."""
    reason: str
    """The reason why the machine is not to be used, with the likely cause; empty if it fits."""
    reason_rows: tuple[int, ...]
    """The rows of the measurements that `reason` names, counted from zero."""
    chi_square: float
    """Reduced χ² of all measurements but outliers: about 1 where the noise explains the residuals, above 9 a misfit."""
    names: tuple[str, ...]
    """Names of the P parameters: those of the machine, 54 of RPS legs, and of frames that were estimated."""
    units: tuple[str, ...]
    """Their units, "m" or "rad"."""
    covariance: FloatArray
    """Covariance of the parameters [m, rad], shape (P, P), zero along what is not identifiable."""
    identifiable: FloatArray
    """Combinations of parameters [rad, sides of the middle platform] that are determined, (n, P), the best first."""
    deviations: FloatArray
    """Standard deviations of these combinations, shape (n,)."""
    unidentifiable: FloatArray
    """Combinations that change no measurement of this kind, such as a shift of {n}, (k, P), and are not changed."""
    base: RigidTransform
    """Pose of {B} in the frame of the measurements; the identity unless estimated."""
    target: RigidTransform
    """Pose of what was measured in {m}; the identity unless estimated."""
    before: FloatArray
    """Predicted less measured poses with the initial machine: displacement [m] and rotation vector [rad] in {B}, shape
    (N, 6), or displacement alone (N, 3)."""
    residuals: FloatArray
    """Predicted less measured poses with the fitted machine, in the same form."""
    misfit: FloatArray
    """Residuals in units of their expected errors, root mean square of a measurement, shape (N,); 1 is as expected."""
    outliers: BoolArray
    """Measurements that do not belong to the others, shape (N,)."""

    def __repr__(self) -> str:
        first, last = (1e3 * np.sqrt((size**2).mean()) for size in self._sizes())
        return (
            f"<Calibration: {self.status}, {len(self.deviations)} of "
            f"{len(self.deviations) + len(self.unidentifiable)} combinations from {len(self.residuals)} measurements, "
            f"position error {first:.3g} mm before, {last:.3g} mm after>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (name, f"{1e3 * np.sqrt((size**2).mean()):.3g}", f"{1e3 * size.max():.3g}")
            for name, size in zip(("before", "after"), self._sizes(), strict=True)
        ]
        rows += [("reduced χ²", f"{self.chi_square:.3g}", ""), ("outliers", f"{np.count_nonzero(self.outliers)}", "")]
        return notebook.table(repr(self), ("position error", "RMS [mm]", "largest [mm]"), rows)

    def _sizes(self) -> list[FloatArray]:
        """Return the position errors before and after [m], (N,) each."""
        return [np.linalg.norm(errors[:, :3], axis=-1) for errors in (self.before, self.residuals)]

    @property
    def machine(self) -> Manipulator:
        """The machine; raises `MeasurementError` if the measurements do not fit it, with the reason."""
        self._check_status()
        return self.fitted

    def accuracy(self, configuration: Configuration) -> FloatArray:
        """Return the covariance (..., 6, 6) of the platform's predicted pose (displacement, rotation) [m, rad], in {B}.

        The states (...) are anywhere, of this machine or of the nominal one. `MeasurementError` as for `machine`.
        """
        self._check_status()
        jacobian = error_jacobian(configuration)
        own = slice(jacobian.shape[-1])
        return np.asarray(jacobian @ self.covariance[own, own] @ jacobian.mT)

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviation of each parameter by itself [m, rad], shape (P,).

        Some are large although the platform is known well, because measurements determine combinations of parameters
        better than each of them. Judge a machine by its `accuracy`.
        """
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    def _check_status(self) -> None:
        if self.status != "fits":
            cause = "`.fitted` is the best fit all the same"
            expected = "measurements that fit one machine, near the nominal one"
            raise MeasurementError("poses", expected, self.reason, cause, rows=self.reason_rows)


def identify(
    machine: Manipulator,
    poses: Any,
    readings: npt.ArrayLike,
    *,
    parameters: Collection[str] | str | None = None,
    pose_noise: npt.ArrayLike = (1e-5, 1e-5),
    reading_noise: npt.ArrayLike = 1e-6,
    frames: bool = False,
    tolerances: Mapping[str, float] | npt.ArrayLike | None = None,
    loss: str = "linear",
) -> Calibration:
    """Identify a machine from measured poses and readings.

    Parameters
    ----------
    machine : Manipulator
        The machine as it is known before.
    poses : RigidTransform of shape (N,), array_like (N, 4, 4), or array_like (N, 3)
        Measured poses of {m} in {B}; or positions of o alone [m]. With `frames`, those of a target on m as a tracker
        sees them.
    readings : array_like, shape (N, 6)
        Readings of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 at these poses [m], of RRS legs [rad].
    parameters : collection of str, optional
        What to identify: `Manipulator.parameter_names`, components such as "pivot_x", "direction", "pivot", "ball",
        "offset", "crank", "rod", or legs; all if not given. The others keep their values.
    pose_noise : array_like
        Standard deviations of the measured position [m] and orientation [rad], or covariances (6, 6) or (N, 6, 6) of
        (displacement, rotation vector) in the frame of the measurements; one number, (3, 3) or (N, 3, 3) for positions.
    reading_noise : array_like
        Standard deviation of the readings [m, rad], one or six, or covariances (6, 6) or (N, 6, 6).
    frames : bool
        Whether to estimate where the tracker sees {B}, `Calibration.base`, and where its target is on m,
        `Calibration.target`. Errors that move all legs of a stage alike are then not seen, as they move such a frame.
    tolerances : mapping of str to float, or array_like, optional
        Standard deviations of the parameters of machines as they are made, as for `tolerance`. What the measurements
        show badly then stays as near to `machine`, with the platform known as well as without.
    loss : {"linear", "soft_l1", "huber", "cauchy"}
        With "linear", outliers are a reason not to use the machine. The others, see `scipy.optimize.least_squares`,
        take them in with less weight, and mark them.

    Returns
    -------
    Calibration
        The machine, its covariance, residuals and outliers. Its `status` says whether the measurements fit.

    Raises
    ------
    MeasurementError
        If readings are in another unit or such that the machine has no state, columns are exchanged, rows shifted or
        rotations transposed, or if the measurements are too few or too much alike to determine the parameters.
    """
    start = check_instance(machine, Manipulator, "machine")
    unknown_frames = as_bool(frames, "frames")
    wanted = selected(start, start.parameter_names if parameters is None else parameters, "parameters")
    choice(loss, "loss", _LOSSES)
    data = Measurements.check(start, poses, readings, frames=unknown_frames)
    count, components, own = len(data.position), data.components, len(wanted)
    made = prior_deviations(start, np.zeros(own) if tolerances is None else tolerances)
    total = pose_covariances(data.states(start), data.frames, components, pose_noise, reading_noise)
    # Matrices (N, n, n) that give residuals unit covariance.
    whitening = np.linalg.inv(np.linalg.cholesky(total))
    basis, invisible = _visible_basis(start, wanted, components, data.frames if unknown_frames else None)
    if count * components < basis.shape[1]:
        few = -(-basis.shape[1] // components)
        expected = f"at least {few} measurements for {basis.shape[1]} unknowns"
        raise MeasurementError("poses", expected, f"{count}", "Measure more, or identify fewer parameters")
    scaled = _scale(start)[:, None] * basis

    def machine_of(unknown: FloatArray) -> tuple[Manipulator, Frames]:
        changes = scaled @ unknown
        return start.from_parameters(start.parameters + changes[:own]), data.frames.changed(changes[own:])

    def whitened(unknown: FloatArray) -> FloatArray:
        try:
            errors = data.errors(*machine_of(unknown))
        except ArgumentError:  # A step to parameters that no machine has.
            errors = np.full((count, components), np.nan)
        # A machine that cannot have these readings is far off.
        errors = np.nan_to_num(errors, nan=1e3 * start.middle_side)
        return np.asarray((whitening @ errors[..., None])[..., 0])

    def jacobian(unknown: FloatArray) -> FloatArray:
        changed, seen_from = machine_of(unknown)
        slopes = seen_from.jacobian(data.states(changed))[:, :components]
        return np.asarray(whitening @ np.nan_to_num(slopes) @ scaled)

    first = np.zeros(basis.shape[1])
    # What is known before, as further rows.
    prior = scaled[:own][made > 0.0] / made[made > 0.0, None]
    names = *start.parameter_names, *FRAME_PARAMETERS
    _check_determined(np.concatenate([*jacobian(first), prior]), basis, count, names)
    fit = _fit(whitened, jacobian, prior, first, loss)
    used = ~fit.outliers if fit.outliers.sum() * components + len(first) <= count * components else fit.outliers
    _, values, right = np.linalg.svd(np.concatenate([*jacobian(fit.unknown)[used], prior]), full_matrices=False)
    spread = scaled @ (right.T / values)
    (fitted, last_frames), covariance = machine_of(fit.unknown), spread @ spread.T
    if fit.status == "fits" and (other := _other_nominal(start, fitted, covariance)):
        fit = replace(fit, status="another nominal", reason=other)
    if fit.status not in ("fits", "outliers") and data.are_in_other_frames(start):
        fit = replace(fit, reason=f"{fit.reason} {_TRACKER}")
    known = own + (6 + components if unknown_frames else 0)
    return Calibration(
        fitted=fitted,
        status=fit.status,
        reason=fit.reason,
        reason_rows=fit.reason_rows,
        chi_square=fit.chi_square,
        names=names[:known],
        units=(*start.parameter_units, *("rad" if "turn" in name else "m" for name in FRAME_PARAMETERS))[:known],
        covariance=covariance[:known, :known],
        identifiable=(right @ basis.T)[:, :known],
        deviations=1.0 / values,
        unidentifiable=invisible[:, :known],
        base=as_rigid_transform(last_frames.base),
        target=as_rigid_transform(last_frames.target),
        before=data.errors(start),
        residuals=data.errors(fitted, last_frames),
        misfit=np.sqrt((whitened(fit.unknown) ** 2).mean(axis=-1)),
        outliers=fit.outliers,
    )


def _scale(start: Manipulator) -> FloatArray:
    """Return the units of the parameters and of those of the frames, (n + 12,)."""
    return np.concatenate([parameter_scale(start), np.tile(np.repeat([start.middle_side, 1.0], 3), 2)])


def _visible_basis(
    start: Manipulator, wanted: BoolArray, components: int, frames: Frames | None
) -> tuple[FloatArray, FloatArray]:
    """Return orthonormal combinations of scaled parameters that measurements show, (n + 12, k), and the others.

    Those are (l, n + 12). Of `wanted` parameters of the machine, and of frames if they are unknown.
    """
    target = np.zeros(3) if frames is None else frames.target[:3, 3]
    hidden = gauge_directions(start, target) / _scale(start)[:, None]
    # The turn of a target of which positions alone are measured is no parameter.
    used = np.arange(len(hidden)) < len(wanted) + 6 + components
    free = np.concatenate([wanted, np.full(12, frames is not None)]) & used
    # Those combinations of the invisible errors that leave the other parameters alone.
    _, values, right = np.linalg.svd(hidden[used & ~free], full_matrices=True)
    rank = int((values > 1e-9).sum())
    inside = np.where(free[:, None], hidden, 0.0) @ right[rank:].T
    left, values, _ = np.linalg.svd(inside, full_matrices=False)
    hidden = left[:, values > 1e-9]
    chosen = np.eye(len(free))[:, free]
    chosen = chosen - hidden @ (hidden.T @ chosen)
    left, values, _ = np.linalg.svd(chosen, full_matrices=False)
    return left[:, values > 1e-9], hidden.T


def _other_nominal(start: Manipulator, fitted: Manipulator, covariance: FloatArray) -> str:
    """Return how E, C or d differ by more than manufacture and the noise explain; empty if none does."""
    weights = np.zeros((3, 6, 9))  # of pivots and balls in E, C and d of the drawing nearest to them
    weights[0, :3, 2:5] = weights[1, 3:, 2:5] = RADIAL / 3.0
    weights[2, :, 5:8] = np.sqrt(3.0) / 6.0 * np.tile(RADIAL, (2, 1))
    means = weights.reshape(3, 54)
    corrections, covariance = (fitted.parameters - start.parameters)[:54], covariance[:54, :54]
    changes, nominal = means @ corrections, np.array(start.dimensions)
    known = np.abs(changes) - 3.0 * np.sqrt(np.diagonal(means @ covariance @ means.T))
    if (known <= _MANUFACTURE * nominal).all():
        return ""
    worst = int((known / nominal).argmax())
    corrected, given = 1e3 * (nominal + changes)[worst], 1e3 * nominal[worst]
    points = np.linalg.norm(corrections.reshape(6, 9)[:, 2:8].reshape(6, 2, 3), axis=-1)
    leg, kind = divmod(int(points.argmax()), 2)
    return (
        f"a machine whose {'ECd'[worst]} is {corrected:.4g} mm instead of {given:.4g} mm, more than the "
        f"{_MANUFACTURE:.0%} that errors of manufacture explain; the largest correction is {1e3 * points.max():.3g} "
        f"mm, of the {('pivot', 'ball')[kind]} of {LEGS[leg]}. Another nominal machine?"
    )


@dataclass(frozen=True)
class _Fit:
    unknown: FloatArray
    outliers: BoolArray
    chi_square: float
    status: str = "fits"
    reason: str = ""
    reason_rows: tuple[int, ...] = ()


def _fit(whitened: _Function, jacobian: _Function, prior: FloatArray, first: FloatArray, loss: str) -> _Fit:
    """Fit residuals (N, n), and `prior` times the unknowns.

    By least squares if that explains them, else by a robust loss that finds the outliers.
    """

    def minimize(
        begin: FloatArray, loss: str = "linear", scale: float = 1.0, evaluations: int = _EVALUATIONS, rows: Any = ...
    ) -> tuple[FloatArray, bool]:
        """Return the unknowns that fit these rows best, from a first guess, and whether the search converged."""
        options: Any = dict.fromkeys(("xtol", "ftol", "gtol"), _CONVERGED)
        options |= {"loss": loss, "f_scale": scale, "max_nfev": evaluations}

        def flat(unknown: FloatArray) -> FloatArray:
            return np.concatenate([whitened(unknown)[rows].ravel(), prior @ unknown])

        def slopes(unknown: FloatArray) -> FloatArray:
            return np.concatenate([*jacobian(unknown)[rows], prior])

        result = scipy.optimize.least_squares(flat, begin, jac=slopes, **options)
        return np.asarray(result.x), result.status > 0

    direct, converged = minimize(first, evaluations=_DIRECT)
    fit = _judged(whitened(direct), direct, converged)
    if fit.status == "fits":
        if loss == "linear":
            return fit
        robust, converged = minimize(direct, loss)
        return _judged(whitened(robust), robust, converged, accept_outliers=True)
    unknown, scale, converged = first, max(float(np.median(np.abs(whitened(first)))), 1.0), True
    # First what is far off at the start too counts as good, then less and less, down to the noise.
    while converged:
        unknown, converged = minimize(unknown, "soft_l1" if loss == "linear" else loss, scale)
        if scale == 1.0:
            break
        scale = max(0.1 * scale, 1.0)
    robust_fit = _judged(whitened(unknown), unknown, converged, accept_outliers=loss != "linear")
    if loss != "linear" or not robust_fit.outliers.any() or robust_fit.status == "not converged":
        return robust_fit
    outliers = robust_fit.outliers
    while True:
        if whitened(unknown)[~outliers].size <= len(first):
            return robust_fit
        unknown, converged = minimize(unknown, rows=~outliers)
        residuals = whitened(unknown)
        # Rows that fit the machine of the others were only far off while wrong rows bent the fit.
        left = outliers & _outliers(residuals, len(unknown))
        if not converged or not left.any() or np.array_equal(left, outliers):
            return _judged(residuals, unknown, converged, outliers)
        outliers = left


def _judged(
    residuals: FloatArray,
    unknown: FloatArray,
    converged: bool,
    outliers: BoolArray | None = None,
    accept_outliers: bool = False,
) -> _Fit:
    """Return a fit with its status; residuals (N, n) are whitened."""
    if outliers is None:
        outliers = _outliers(residuals, len(unknown))
    squares = (residuals**2).sum(axis=-1)
    freedom = int((~outliers).sum()) * residuals.shape[1] - len(unknown)
    chi_square = float(squares[~outliers].sum()) / freedom if freedom > 0 else float("nan")
    limit = max(_MISFIT, float(chdtri(freedom, _CHANCE)) / freedom) if freedom > 0 else _MISFIT
    rows = np.flatnonzero(outliers)
    named = tuple(rows[:10].tolist())
    shown = f"row{'s' * (len(rows) > 1)} {', '.join(map(str, named))}" + (", …" if len(rows) > 10 else "")
    fit, failed = _Fit(unknown, outliers, chi_square), "misfit" if converged else "not converged"
    if freedom < 0 or (len(rows) and not freedom):
        reason = f"too few rows to tell which are wrong: without {shown} none is left over to compare. Measure more"
        return replace(fit, status=failed, reason=reason, reason_rows=named)
    if chi_square > limit or not converged:
        times = f"residuals {np.sqrt(chi_square):.3g} times what the noise explains"
        size = times if freedom else "no residuals to compare"
        ended = "" if converged else ", when the search for a better fit was given up"
        causes = (
            "Larger noise than given, or errors that are not among the parameters?"
            if chi_square < _GROSS**2
            else "Another nominal machine or unit, legs or axes exchanged, poses and readings of different rows, or "
            "many wrong rows?"
        )
        worst = int(squares.argmax())
        reason = f"{size}{ended}, largest in row {worst}. {causes}"
        return replace(fit, status=failed, reason=reason, reason_rows=(worst,))
    if len(rows) and not accept_outliers:
        these = "this row, leave it" if len(rows) == 1 else "these rows, leave them"
        reason = f"outlier{'s' * (len(rows) > 1)} in {shown}. Look at {these} out, or use the loss soft_l1"
        return replace(fit, status="outliers", reason=reason, reason_rows=named)
    return fit


def _check_determined(slopes: FloatArray, basis: FloatArray, count: int, parameters: Sequence[str]) -> None:
    """Raise if a combination of the unknowns is not determined by the measurements."""
    _, values, right = np.linalg.svd(slopes, full_matrices=False)
    unknown = values * _UNKNOWN < 1.0
    if unknown.any():
        worst = basis @ right[-1]
        names = ", ".join(parameters[k] for k in np.argsort(-np.abs(worst))[:3])
        received = f"{count} poses that determine {int((~unknown).sum())}; the least determined one moves {names}"
        cause = "Measure at poses further apart, see spm.calibration.choose_poses, or identify fewer parameters"
        cause += ". Is the noise given too large?"
        raise MeasurementError("poses", f"poses that determine {len(unknown)} combinations", received, cause)


def _outliers(whitened: FloatArray, unknowns: int) -> BoolArray:
    """Return which rows (N, n) of whitened residuals do not belong to the others."""
    squares, freedom = (whitened**2).sum(axis=-1), whitened.shape[1]
    # The noise may have been given too small: the median tells its size. The fit takes part of it away.
    median, largest = (float(chdtri(freedom, p)) for p in (0.5, _CHANCE / len(squares)))
    left = max(1.0 - unknowns / whitened.size, 1.0 / whitened.size)
    return np.asarray(squares > max(float(np.median(squares)) / median, left) * largest)


def choose_poses(
    machine: Manipulator,
    count: int = 40,
    *,
    candidates: int | Configuration = 500,
    parameters: Collection[str] | str | None = None,
    positions_only: bool = False,
    pose_noise: npt.ArrayLike = (1e-5, 1e-5),
    reading_noise: npt.ArrayLike = 1e-6,
    frames: bool = False,
    rng: object = None,
) -> Configuration:
    """Choose the poses whose measurement identifies a machine best: with the smallest ellipsoid of uncertainty.

    Parameters
    ----------
    machine : Manipulator
        The machine as it is known before.
    count : int
        Number of poses.
    candidates : int or Configuration
        What to choose from: states of shape (M,), or the number of states drawn uniformly within the leg limits.
    parameters, pose_noise, reading_noise, frames
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
    machine = check_instance(machine, Manipulator, "machine")
    wanted = selected(machine, machine.parameter_names if parameters is None else parameters, "parameters")
    components = 3 if as_bool(positions_only, "positions_only") else 6
    seen_from = Frames.as_defined()
    basis, _ = _visible_basis(machine, wanted, components, seen_from if as_bool(frames, "frames") else None)
    few = -(-basis.shape[1] // components)
    count = whole_number(count, "count", f"a number of poses, at least {few} for {basis.shape[1]} unknowns", least=few)
    states = given_or_drawn(machine, candidates, "candidates", rng)
    if len(states) < count:
        raise ArgumentError("candidates", f"at least {count} states", f"{len(states)}")
    total = pose_covariances(states, seen_from, components, pose_noise, reading_noise)
    rows = seen_from.jacobian(states)[:, :components] @ (_scale(machine)[:, None] * basis)
    rows = np.linalg.solve(np.linalg.cholesky(total), rows)
    return states[np.array(_exchanged(rows, count))]


def given_or_drawn(machine: Manipulator, states: Configuration | int, argument: str, rng: object) -> Configuration:
    """Return the states (N,) given, or a number of them at leg readings drawn uniformly from the limits."""
    if isinstance(states, Configuration):
        if len(check_configuration(states, argument, existing=True).shape) != 1:
            raise ArgumentError(argument, "states along one axis", f"shape {states.shape}")
        return states
    wanted = whole_number(states, argument, least=1)
    if machine.limits is None or not np.isfinite(machine.limits.maximum).all():
        cause = "Give the limits to the Manipulator, or the states to choose from"
        raise ArgumentError("machine", "a machine with leg limits to draw states from", "none", cause)
    return random_states(machine, wanted, generator(rng))


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
