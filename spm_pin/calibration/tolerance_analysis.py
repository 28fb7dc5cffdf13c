"""Accuracy of the platform from tolerances of the dimensions, and which dimensions it depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.calibration.error_model import error_jacobian, pose_errors, prior_deviations
from spm_pin.calibration.identification import given_or_drawn
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.machine import Configuration, Machine
from spm_pin.machine.machine import check_machine
from spm_pin.support.arguments import FloatArray, choice, generator, real_number, whole_number


@dataclass(frozen=True, repr=False)
class ToleranceAnalysis:
    """Errors of the platform of machines whose dimensions are normally distributed, at N states."""

    states: Configuration
    """The states of the machine without errors, shape (N,)."""
    deviations: FloatArray
    """Standard deviations of the parameters [m, rad], `Machine.parameter_names`, shape (n,)."""
    covariance: FloatArray
    """Covariance of the platform's error (displacement, rotation vector) [m, rad] in {B}, to first order, shape
    (N, 6, 6)."""
    shares: FloatArray
    """Part of the mean variance of the position that each parameter causes, shape (n,); they add up to 1."""
    samples: FloatArray
    """Errors of S random machines, not linearised, shape (S, N, 6); NaN where a machine cannot have the readings."""

    def __repr__(self) -> str:
        position, angle = self.rms
        return (
            f"<ToleranceAnalysis: {1e3 * position:.3g} mm and {1e3 * angle:.3g} mrad RMS, {len(self.samples)} samples>"
        )

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean squares of the displacement [m] and of the rotation angle [rad], to first order."""
        variances = np.diagonal(self.covariance, axis1=-2, axis2=-1).reshape(-1, 2, 3).sum(axis=-1)
        position, angle = np.sqrt(variances.mean(axis=0))
        return float(position), float(angle)

    @property
    def sampled_rms(self) -> tuple[float, float]:
        """Root mean squares of displacement [m] and angle [rad] of the samples, NaN if missing."""
        if not len(self.samples):
            return float("nan"), float("nan")
        position, angle = np.sqrt(np.nanmean((self.samples.reshape(-1, 2, 3) ** 2).sum(axis=-1), axis=0))
        return float(position), float(angle)

    def percentile(self, percent: float = 95.0) -> tuple[float, float]:
        """Return the displacement [m] and the angle [rad] that this part of the samples does not exceed."""
        level = real_number(percent, "percent", "a percentage from 0 to 100", least=0.0, most=100.0)
        if not len(self.samples):
            raise ArgumentError("samples", "a Monte Carlo analysis, samples > 0", 0)
        sizes = np.linalg.norm(self.samples.reshape(-1, 2, 3), axis=-1)
        position, angle = np.nanpercentile(sizes, level, axis=0)
        return float(position), float(angle)

    def ranking(self, by: str = "parameter") -> list[tuple[str, float]]:
        """Return names and shares, the largest first, added up by "parameter", "component", "kind" or "leg"."""
        choice(by, "by", ("parameter", "component", "kind", "leg"))
        totals: dict[str, float] = {}
        for name, share in zip(self.states.machine.parameter_names, self.shares, strict=True):
            leg, component = name.split(".")
            keys = {"parameter": name, "component": component, "kind": component.split("_")[0], "leg": leg}
            totals[keys[by]] = totals.get(keys[by], 0.0) + float(share)
        return sorted(totals.items(), key=lambda item: -item[1])


def tolerance(
    machine: Machine,
    tolerances: Mapping[str, float] | npt.ArrayLike,
    states: Configuration | int = 60,
    *,
    samples: int = 200,
    rng: Any = None,
) -> ToleranceAnalysis:
    """Predict the accuracy of the platform from tolerances of the dimensions.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine whose readings are commanded.
    tolerances : mapping of str to float, or array_like, shape (n,)
        Standard deviations [m, rad]: of each of `Machine.parameter_names`, or under names of parameters, components
        such as "pivot_x", kinds ("direction", "pivot", "ball", "offset", and "rod", "crank" of legs that have them) or
        legs; a later name replaces an earlier one, and parameters without a name have no error.
    states : Configuration or int
        States of shape (N,), or the number of states to draw uniformly within the leg limits.
    samples : int
        Random machines for the Monte Carlo analysis; 0 for none.
    rng : numpy.random.Generator, seed, or None
        Source of states and samples.

    Examples
    --------
    >>> import spm_pin as spm
    >>> table = {"direction": 1e-4, "pivot": 1e-4, "ball": 1e-4, "offset": 1e-4}
    >>> analysis = spm.calibration.tolerance(spm.Manipulator.paper(), table, samples=0, rng=0)
    >>> [f"{name} {share:.0%}" for name, share in analysis.ranking("kind")]
    ['ball 33%', 'pivot 33%', 'offset 31%', 'direction 4%']
    """
    machine, random = check_machine(machine), generator(rng)
    deviations = prior_deviations(machine, tolerances)
    samples = whole_number(samples, "samples", least=0, most=10**6)
    places = given_or_drawn(machine, states, "states", random)
    if places.machine != machine:
        raise ArgumentError("states", "states of this machine", repr(places.machine))
    scaled = error_jacobian(places) * deviations
    variances = (scaled[:, :3] ** 2).sum(axis=1).mean(axis=0)
    errors = np.empty((samples, len(places), 6))
    for sample in range(samples):
        built: Any = machine.from_parameters(machine.parameters + deviations * random.standard_normal(len(deviations)))
        states_of_built = forward_physical(built, places.readings)
        errors[sample] = pose_errors(states_of_built.pose.as_matrix(), places.pose.as_matrix())
    return ToleranceAnalysis(
        states=places,
        deviations=deviations,
        covariance=scaled @ np.swapaxes(scaled, -1, -2),
        shares=variances / max(variances.sum(), np.finfo(float).tiny),
        samples=errors,
    )
