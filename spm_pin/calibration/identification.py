"""The parameters of a machine from measurements and readings, by least squares, and the poses to measure.

The poses of a machine at the measured readings are compared with what was measured of them, because forward
displacement has no singularity where a machine works. Errors of the readings count as the pose errors that they cause.
Poses are chosen by exchange of a D-optimal design.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

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
from spm_pin.calibration.measurements import MeasurementError, Measurements, total_covariances
from spm_pin.calibration.observables import OBSERVABLES, Observable
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.random_states import random_states
from spm_pin.machine import Configuration, Machine, as_rigid_transform
from spm_pin.machine.configuration import check_configuration
from spm_pin.machine.machine import check_machine
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, as_bool, choice, generator, whole_number

_LOSSES = ("linear", "soft_l1", "huber", "cauchy")
_UNKNOWN = 0.3
"""Standard deviation, in radians or sides of the middle platform, above which a combination is not determined."""
_CONVERGED, _EVALUATIONS = 1e-9, 100
"""Relative changes at which an iteration ends, and the most evaluations it may take."""
_DIRECT = 20
"""Evaluations of the first fit: measurements that fit one machine take five or so."""
_CHANCE = 1e-6
"""Probability that a good measurement is taken for an outlier, all measurements together."""
_GROSS = 100.0
"""Ratio of residuals to the noise above which noise does not explain them."""
_MISFIT = 9.0
"""Largest reduced χ² of a fit: residuals three times what the noise explains."""
_MANUFACTURE = 0.04
"""Largest correction of a nominal dimension, relative: for the paper's C three standard deviations where coordinates
have errors of 1 % of d."""

_SWEEPS, _GAIN = 20, 1e-6
"""Maximum number of exchange passes over all chosen poses, and the relative gain below which no pose is exchanged."""
_RIDGE = 1e-6
"""Information, relative to that of a pose, from which the first choice starts."""

_ESTIMATED = "With frames=True, --frames, both frames are estimated too"
_TRACKER = f"Poses of a target in a tracker's own frame? {_ESTIMATED}"
_ASKEW = f"The IMU turned on the platform, the base not level, or heights of another point? {_ESTIMATED}"

M = TypeVar("M", bound=Machine)
_Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, repr=False)
class Calibration(Generic[M]):
    """A machine identified from N measurements, and how well it is known."""

    fitted: M
    """The `Manipulator` or `Stage` that fits the measurements best, whatever `status` says."""
    status: str
    """"fits"; or "outliers", "misfit", "not converged" or "another nominal": then `machine` raises an error."""
    reason: str
    """Reason why the machine must not be used, with the likely cause; empty if it fits."""
    reason_rows: tuple[int, ...]
    """The rows of the measurements that `reason` names, counted from zero."""
    chi_square: float
    """Reduced χ² of all measurements but outliers: about 1 where the noise explains the residuals, above 9 a misfit."""
    names: tuple[str, ...]
    """Names of the P parameters: those of the machine, nine of each RPS leg, and of frames that were estimated."""
    units: tuple[str, ...]
    """Their units, "m" or "rad"."""
    covariance: FloatArray
    """Covariance of the parameters [m, rad], shape (P, P), zero along directions that are not identifiable."""
    identifiable: FloatArray
    """Combinations of parameters [rad, sides of the middle platform] that are determined, (n, P), the best first."""
    deviations: FloatArray
    """Standard deviations of these combinations, shape (n,)."""
    unidentifiable: FloatArray
    """Combinations that change no measurement of this kind, such as a shift of {n}, (k, P), and are not changed."""
    base: RigidTransform
    """Pose of {B} in the frame of the measurements, whose z is the IMU's vertical; the identity unless estimated."""
    target: RigidTransform
    """Pose of the target or of the IMU in the platform's frame; the identity unless estimated."""
    components: tuple[str, ...]
    """Measured components: "x", "y", "z" [m], "turn_x", "turn_y", "turn_z" [rad], or some of them."""
    before: FloatArray
    """Predicted less measured components with the initial machine [m, rad], shape (N, components): displacements and
    the rotation vector in {B}, or height and turns of the levelled platform; NaN where nothing was measured."""
    residuals: FloatArray
    """Predicted less measured components with the fitted machine, in the same form."""
    misfit: FloatArray
    """Residuals in units of their expected errors, root mean square of a measurement, shape (N,); 1 is as expected."""
    outliers: BoolArray
    """Measurements that do not belong to the others, shape (N,)."""

    def __repr__(self) -> str:
        name, unit, *sizes = self.error_sizes[0]
        first, last = (1e3 * np.sqrt(np.nanmean(size**2)) for size in sizes)
        return (
            f"<Calibration: {self.status}, {len(self.deviations)} of "
            f"{len(self.deviations) + len(self.unidentifiable)} combinations from {len(self.residuals)} measurements, "
            f"{name} error {first:.3g} m{unit} before, {last:.3g} m{unit} after>"
        )

    @property
    def error_sizes(self) -> list[tuple[str, str, FloatArray, FloatArray]]:
        """Name and unit of what was measured, and the sizes of its errors before and after, shape (N,) each.

        "position" or "height" [m], "orientation" or "tilt" [rad].
        """
        lengths, rows = np.array([not name.startswith("turn") for name in self.components]), []
        is_pose = not {"x", "turn_z"}.isdisjoint(self.components)
        names = ("position", "orientation") if is_pose else ("height", "tilt")
        for name, unit, part in zip(names, ("m", "rad"), (lengths, ~lengths), strict=True):
            if part.any():
                before, after = (np.linalg.norm(errors[:, part], axis=-1) for errors in (self.before, self.residuals))
                rows.append((name, unit, before, after))
        return rows

    @property
    def machine(self) -> M:
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
    machine: M,
    poses: Any,
    readings: npt.ArrayLike,
    *,
    parameters: Collection[str] | str | None = None,
    pose_noise: npt.ArrayLike | None = None,
    reading_noise: npt.ArrayLike = 1e-6,
    frames: bool = False,
    tolerances: Mapping[str, float] | npt.ArrayLike | None = None,
    loss: str = "linear",
) -> Calibration[M]:
    """Identify a machine from measured poses, or from what an IMU and a ruler show, and readings.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine as it is known before.
    poses : RigidTransform of shape (N,), array_like (N, 4, 4), array_like (N, 3), or Inclinations
        Measured poses of the platform in {B}; positions of its origin alone [m]; or tilts and heights. With `frames`,
        those of a target on the platform in a tracker's frame, or of an IMU and a mark.
    readings : array_like, shape (N, legs)
        Readings of the legs, in the order of `Legs.names`, at these poses [m] ([rad] for RRS legs).
    parameters : collection of str, optional
        What to identify: `Machine.parameter_names`, components such as "pivot_x", "direction", "pivot", "ball",
        "offset", "crank", "rod", or legs; all if not given. The others keep their values.
    pose_noise : array_like
        Standard deviations of the measured position or height [m] and of orientation or tilt [rad], or covariances
        (6, 6) or (N, 6, 6) of (displacement, rotation vector) in the frame of the measurements; one number, (3, 3) or
        (N, 3, 3) for positions. If not given those of a laser tracker, 1e-5 each, or of `Inclinations` (5e-4, 2e-3).
    reading_noise : array_like
        Standard deviation of the readings [m, rad], one or one of each leg, or covariances (legs, legs) or
        (N, legs, legs).
    frames : bool
        Whether to estimate the pose of {B} in the tracker's frame, `Calibration.base`, and of its target on the
        platform, `Calibration.target`. Errors that move all legs of a stage as one body are then not observable, since
        they equal a motion of such a frame. An IMU's frames are the tilt of the base and the mounting on the platform,
        and those of a ruler its zero and the mark that it measures.
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
        If readings are in another unit, or the machine has no state with them, columns are exchanged, rows shifted or
        rotations transposed, or if the measurements are too few or too much alike to determine the parameters.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> balancer = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))
    >>> plan = spm.calibration.choose_poses(balancer, 40, measured="inclinations", rng=0)
    >>> seen = spm.forward_physical(balancer.perturbed(1, length=2e-4, angle=2e-3), plan.readings)
    >>> shown = spm.calibration.Inclinations(seen.roll, seen.pitch, seen.height)
    >>> spm.calibration.identify(balancer, shown, plan.readings, parameters=["offset", "crank", "rod"]).status
    'fits'
    """
    check_machine(machine)
    start = machine
    unknown_frames = as_bool(frames, "frames")
    wanted = selected(start, start.parameter_names if parameters is None else parameters, "parameters")
    choice(loss, "loss", _LOSSES)
    data = Measurements.check(start, poses, readings, frames=unknown_frames)
    count, own, present = len(data.position), len(wanted), data.present
    made = prior_deviations(start, np.zeros(own) if tolerances is None else tolerances)
    total = total_covariances(data.states(start), data.frames, data.observable, data.poses, pose_noise, reading_noise)
    # Matrices (N, n, n) that give residuals unit covariance.
    whitening = np.linalg.inv(np.linalg.cholesky(total))
    basis, invisible = _visible_basis(start, wanted, data.observable, data.frames, unknown_frames)
    if present.sum() < basis.shape[1]:
        few = -(-basis.shape[1] // present.shape[1])
        expected = f"at least {few} measurements for {basis.shape[1]} unknowns"
        raise MeasurementError("poses", expected, f"{count}", "Measure more, or identify fewer parameters")
    scaled = _scale(start)[:, None] * basis

    def machine_of(unknown: FloatArray) -> tuple[M, Frames]:
        changes = scaled @ unknown
        return start.from_parameters(start.parameters + changes[:own]), data.frames.changed(changes[own:])

    def whitened(unknown: FloatArray) -> FloatArray:
        try:
            errors = data.errors(*machine_of(unknown))
        except ArgumentError:  # A step to parameters that no machine has.
            errors = np.full(present.shape, np.nan)
        # A machine that cannot have these readings is far off.
        errors = np.where(present, np.nan_to_num(errors, nan=1e3 * start.ball_side), 0.0)
        return np.asarray((whitening @ errors[..., None])[..., 0])

    def jacobian(unknown: FloatArray) -> FloatArray:
        return np.asarray(whitening @ data.slopes(*machine_of(unknown)) @ scaled)

    first = np.zeros(basis.shape[1])
    # Prior knowledge, as further rows.
    prior = scaled[:own][made > 0.0] / made[made > 0.0, None]
    names = *start.parameter_names, *FRAME_PARAMETERS
    _check_determined(np.concatenate([*jacobian(first), prior]), basis, count, names)
    fit = _fit(whitened, jacobian, prior, first, loss, present.sum(axis=-1))
    used = ~fit.outliers if present[~fit.outliers].sum() >= len(first) else fit.outliers
    _, values, right = np.linalg.svd(np.concatenate([*jacobian(fit.unknown)[used], prior]), full_matrices=False)
    spread = scaled @ (right.T / values)
    (fitted, last_frames), covariance = machine_of(fit.unknown), spread @ spread.T
    if fit.status == "fits" and (other := _other_nominal(start, fitted, covariance)):
        fit = replace(fit, status="another nominal", reason=other)
    if fit.status not in ("fits", "outliers") and data.are_in_other_frames(start):
        fit = replace(fit, reason=f"{fit.reason} {_ASKEW if data.observable.is_levelled else _TRACKER}")
    known = np.concatenate([np.full(own, True), data.observable.frames & unknown_frames])
    units = *start.parameter_units, *("rad" if "turn" in name else "m" for name in FRAME_PARAMETERS)
    return Calibration(
        fitted=fitted,
        status=fit.status,
        reason=fit.reason,
        reason_rows=fit.reason_rows,
        chi_square=fit.chi_square,
        names=tuple(itertools.compress(names, known)),
        units=tuple(itertools.compress(units, known)),
        covariance=covariance[np.ix_(known, known)],
        identifiable=(right @ basis.T)[:, known],
        deviations=1.0 / values,
        unidentifiable=invisible[:, known],
        base=as_rigid_transform(last_frames.base),
        target=as_rigid_transform(last_frames.target),
        components=data.observable.components,
        before=np.where(present, data.errors(start), np.nan),
        residuals=np.where(present, data.errors(fitted, last_frames), np.nan),
        misfit=np.sqrt((whitened(fit.unknown) ** 2).sum(axis=-1) / present.sum(axis=-1)),
        outliers=fit.outliers,
    )


def _scale(start: Machine) -> FloatArray:
    """Return the units of the parameters and of those of the frames, (n + 12,)."""
    return np.concatenate([parameter_scale(start), np.tile(np.repeat([start.ball_side, 1.0], 3), 2)])


def _visible_basis(
    start: Machine, wanted: BoolArray, observable: Observable, frames: Frames, are_unknown: bool
) -> tuple[FloatArray, FloatArray]:
    """Return orthonormal combinations of scaled parameters that measurements show, (n + 12, k), and the others.

    The others are (l, n + 12). Only `wanted` parameters of the machine are used, and those of frames if they are
    unknown.
    """
    hidden = gauge_directions(start, frames.base, frames.target, has_lengths=observable.lengths > 0)
    hidden = hidden / _scale(start)[:, None]
    # Components of the frames that are not observable, such as the turn of a target whose position alone is measured,
    # are free.
    used = np.concatenate([np.full(len(wanted), True), observable.frames])
    free = np.concatenate([wanted, np.full(12, are_unknown)]) & used
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


def _other_nominal(start: Machine, fitted: Machine, covariance: FloatArray) -> str:
    """Return how a nominal dimension differs by more than manufacture and the noise explain; empty if none does."""
    nominal, legs, (outward, _) = np.array(start.dimensions), start.legs.names, start.legs.planes
    weights = np.zeros((len(nominal), len(legs), 9))  # of pivots and balls in dimensions of the drawing nearest to them
    for stage in range(len(start.legs.kinds)):
        part = slice(3 * stage, 3 * stage + 3)
        weights[stage, part, 2:5] = outward[part] / 3.0
    weights[-1, :, 5:8] = nominal[-1] / start.stage_radii[0][1] * outward / len(legs)
    means = weights.reshape(len(nominal), -1)
    own = slice(means.shape[1])
    corrections, covariance = (fitted.parameters - start.parameters)[own], covariance[own, own]
    changes = means @ corrections
    known = np.abs(changes) - 3.0 * np.sqrt(np.diagonal(means @ covariance @ means.T))
    if (known <= _MANUFACTURE * nominal).all():
        return ""
    worst = int((known / nominal).argmax())
    corrected, given = 1e3 * (nominal + changes)[worst], 1e3 * nominal[worst]
    points = np.linalg.norm(corrections.reshape(-1, 9)[:, 2:8].reshape(-1, 2, 3), axis=-1)
    leg, kind = divmod(int(points.argmax()), 2)
    name = ("base_radius", "platform_radius") if len(nominal) == 2 else "ECd"
    return (
        f"a machine whose {name[worst]} is {corrected:.4g} mm instead of {given:.4g} mm, more than the "
        f"{_MANUFACTURE:.0%} that errors of manufacture explain; the largest correction is {1e3 * points.max():.3g} "
        f"mm, of the {('pivot', 'ball')[kind]} of {legs[leg]}. Another nominal machine?"
    )


@dataclass(frozen=True)
class _Fit:
    unknown: FloatArray
    outliers: BoolArray
    chi_square: float
    status: str = "fits"
    reason: str = ""
    reason_rows: tuple[int, ...] = ()


def _fit(
    whitened: _Function, jacobian: _Function, prior: FloatArray, first: FloatArray, loss: str, counts: IntArray
) -> _Fit:
    """Fit residuals (N, n), `counts` (N,) of a row, by least squares or by a robust loss that finds outliers."""

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
    fit = _judged(whitened(direct), direct, converged, counts)
    if fit.status == "fits":
        if loss == "linear":
            return fit
        robust, converged = minimize(direct, loss)
        return _judged(whitened(robust), robust, converged, counts, accept_outliers=True)
    unknown, scale, converged = first, max(float(np.median(np.abs(whitened(first)))), 1.0), True
    # At first even large residuals count as good; the threshold then decreases to the noise.
    while converged:
        unknown, converged = minimize(unknown, "soft_l1" if loss == "linear" else loss, scale)
        if scale == 1.0:
            break
        scale = max(0.1 * scale, 1.0)
    robust_fit = _judged(whitened(unknown), unknown, converged, counts, accept_outliers=loss != "linear")
    if loss != "linear" or not robust_fit.outliers.any() or robust_fit.status == "not converged":
        return robust_fit
    outliers = robust_fit.outliers
    while True:
        if counts[~outliers].sum() <= len(first):
            return robust_fit
        unknown, converged = minimize(unknown, rows=~outliers)
        residuals = whitened(unknown)
        # Rows that fit the machine of the other rows were only outliers while wrong rows distorted the fit.
        left = outliers & _outliers(residuals, len(unknown), counts)
        if not converged or not left.any() or np.array_equal(left, outliers):
            return _judged(residuals, unknown, converged, counts, outliers)
        outliers = left


def _judged(
    residuals: FloatArray,
    unknown: FloatArray,
    converged: bool,
    counts: IntArray,
    outliers: BoolArray | None = None,
    accept_outliers: bool = False,
) -> _Fit:
    """Return a fit with its status; residuals (N, n) are whitened."""
    if outliers is None:
        outliers = _outliers(residuals, len(unknown), counts)
    squares = (residuals**2).sum(axis=-1)
    freedom = int(counts[~outliers].sum()) - len(unknown)
    chi_square = float(squares[~outliers].sum()) / freedom if freedom > 0 else float("nan")
    limit = max(_MISFIT, float(chdtri(freedom, _CHANCE)) / freedom) if freedom > 0 else _MISFIT
    rows = np.flatnonzero(outliers)
    named = tuple(rows[:10].tolist())
    shown = f"row{'s' * (len(rows) > 1)} {', '.join(map(str, named))}" + (", …" if len(rows) > 10 else "")
    fit, failed = _Fit(unknown, outliers, chi_square), "misfit" if converged else "not converged"
    if freedom < 0 or (len(rows) and not freedom):
        reason = f"too few rows to find the wrong ones: without {shown} none is left over to compare. Measure more"
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
        cause = (
            "Measure at poses further apart, see spm.calibration.choose_poses, identify fewer parameters, or say by "
        )
        cause += "tolerances how machines are made. Is the noise given too large?"
        raise MeasurementError("poses", f"poses that determine {len(unknown)} combinations", received, cause)


def _outliers(whitened: FloatArray, unknowns: int, counts: IntArray) -> BoolArray:
    """Return which rows (N, n) of whitened residuals, `counts` (N,) numbers each, do not belong to the others."""
    squares, total = (whitened**2).sum(axis=-1), int(counts.sum())
    # The given noise may be too small: the median estimates it. The fit absorbs a part of it.
    medians, largest = (chdtri(counts, p) for p in (0.5, _CHANCE / len(squares)))
    left = max(1.0 - unknowns / total, 1.0 / total)
    return np.asarray(squares > max(float(np.median(squares / medians)), left) * largest)


def choose_poses(
    machine: Machine,
    count: int = 40,
    *,
    candidates: int | Configuration = 500,
    parameters: Collection[str] | str | None = None,
    measured: str = "poses",
    pose_noise: npt.ArrayLike | None = None,
    reading_noise: npt.ArrayLike = 1e-6,
    frames: bool = False,
    rng: object = None,
) -> Any:
    """Choose the poses whose measurement identifies a machine best: with the smallest ellipsoid of uncertainty.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine as it is known before.
    count : int
        Number of poses.
    candidates : int, Configuration
        Candidates: states of shape (M,), or the number of states drawn uniformly within the leg limits.
    parameters, pose_noise, reading_noise, frames
        As for `identify`.
    measured : {"poses", "positions", "inclinations"}
        Quantities to be measured: poses, positions of the origin alone, or tilts and heights, see `Inclinations`.
    rng : numpy.random.Generator, seed, or None
        Source of the candidates.

    Returns
    -------
    Configuration
        States of shape (count,), the most informative first; each candidate at most once.
    """
    machine = check_machine(machine)
    wanted = selected(machine, machine.parameter_names if parameters is None else parameters, "parameters")
    observable, seen_from = OBSERVABLES[choice(measured, "measured", tuple(OBSERVABLES))], Frames.as_defined()
    basis, _ = _visible_basis(machine, wanted, observable, seen_from, as_bool(frames, "frames"))
    few = -(-basis.shape[1] // len(observable.components))
    count = whole_number(count, "count", f"a number of poses, at least {few} for {basis.shape[1]} unknowns", least=few)
    states = given_or_drawn(machine, candidates, "candidates", rng)
    if len(states) < count:
        raise ArgumentError("candidates", f"at least {count} states", f"{len(states)}")
    poses = seen_from.seen(states)
    total = total_covariances(states, seen_from, observable, poses, pose_noise, reading_noise)
    rows = observable.slopes(poses, poses, seen_from.jacobian(states)) @ (_scale(machine)[:, None] * basis)
    rows = np.linalg.solve(np.linalg.cholesky(total), rows)
    return states[np.array(_exchanged(rows, count))]


def given_or_drawn(machine: Machine, states: Configuration | int, argument: str, rng: object) -> Any:
    """Return the states (N,) given, or a number of them at leg readings drawn uniformly from the limits."""
    if isinstance(states, Configuration):
        if len(check_configuration(states, argument, existing=True).shape) != 1:
            raise ArgumentError(argument, "states along one axis", f"shape {states.shape}")
        return states
    wanted = whole_number(states, argument, least=1)
    if machine.limits is None or not np.isfinite(machine.limits.maximum).all():
        cause = f"Give the limits to the {type(machine).__name__}, or the states to choose from"
        raise ArgumentError(
            "machine", "a machine with leg limits, from which states are drawn", "a machine without limits", cause
        )
    return random_states(machine, wanted, generator(rng))


def _exchanged(rows: FloatArray, count: int) -> list[int]:
    """Choose `count` of M whitened Jacobians (M, c, n): one after the other, then by exchange."""
    information = np.swapaxes(rows, -1, -2) @ rows
    total = _RIDGE * np.trace(information, axis1=-2, axis2=-1).mean() * np.eye(rows.shape[-1])
    chosen: list[int] = []

    def best(base: FloatArray) -> tuple[int, FloatArray]:
        """Return the candidate that increases the determinant of this information most, and each one's increase."""
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
