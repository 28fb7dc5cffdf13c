"""Pictures of calibrations: errors of the measurements before and after, and how well combinations are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spm_pin.calibration import Calibration
from spm_pin.display.figure_files import new_figure
from spm_pin.mechanism.arguments import instance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["calibration_figure"]

BEFORE, AFTER, OUTLIER = "#d55e00", "#0072b2", "#000000"


def calibration_figure(calibration: Calibration) -> Figure:
    """Draw the position errors of all measurements before and after, and the uncertainties of the combinations."""
    instance(calibration, Calibration, "calibration")
    figure = new_figure(9.0, 3.8, layout="constrained")
    errors, combinations = figure.subplots(1, 2, width_ratios=(3, 2))
    rows = np.arange(len(calibration.misfit))
    for name, residuals, colour in (("before", calibration.before, BEFORE), ("after", calibration.residuals, AFTER)):
        sizes = 1e6 * np.linalg.norm(residuals[:, :3], axis=-1)
        rms = np.sqrt((sizes**2).mean())
        errors.semilogy(rows, np.maximum(sizes, 1e-9), "o", ms=3.5, color=colour, label=f"{name}, {rms:.3g} µm RMS")
    if calibration.outliers.any():
        at = np.flatnonzero(calibration.outliers)
        sizes = 1e6 * np.linalg.norm(calibration.residuals[at, :3], axis=-1)
        errors.plot(at, sizes, "o", ms=9, mfc="none", color=OUTLIER, label="outlier")
    errors.set(xlabel="measurement", ylabel="predicted − measured position [µm]")
    errors.legend(fontsize=8, loc="center right")
    combinations.semilogy(1 + np.arange(len(calibration.deviations)), calibration.deviations, ".", color=AFTER)
    count = len(calibration.deviations)
    combinations.set(xlabel="combination of parameters", ylabel="standard deviation [d, rad]")
    combinations.set_title(f"{count} identifiable, {len(calibration.unidentifiable)} not", fontsize=10)
    return figure
