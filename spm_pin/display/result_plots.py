"""Figures of results: a comparison of methods, a calibration, a certificate, a motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.calibration import Calibration
from spm_pin.crosscheck import Quantity, Report
from spm_pin.description.tree import SLIDES
from spm_pin.display.output_files import new_figure
from spm_pin.mechanism.arguments import FloatArray, check_instance
from spm_pin.mechanism.leg_limits import LEGS, LegLimits
from spm_pin.proofs import Certificate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from spm_pin.multibody.trajectory import JointTrajectory

# After Okabe and Ito's palette, distinct with any colour vision.
_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE, _PURPLE = "#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7"
_LIMIT = "#d62728"
_SMALLEST = 1e-8
"""Shares of a tolerance below this are drawn as this."""
_TILTS = (30, 60, 90, 120)
"""Tilts [degrees] marked by circles in the picture of a certificate."""


def agreement_figure(report: Report) -> Figure:
    """Draw the largest difference of every pair of methods as a share of its tolerance, on a logarithmic axis."""
    pairs = check_instance(report, Report, "report", "compare_methods returns one").differences
    figure = new_figure(8.0, 1.6 + 0.24 * len(pairs), layout="constrained")
    ax = figure.add_subplot()
    rows = range(len(pairs))
    colours = (_BLUE, _GREEN, _ORANGE, _PURPLE)
    quantities = (Quantity.POSITIONS, Quantity.JACOBIAN, Quantity.FORCES, Quantity.ASSEMBLY)
    for quantity, colour in zip(quantities, colours, strict=True):
        chosen = [k for k in rows if pairs[k].quantity is quantity]
        ratios = [max(pairs[k].ratio, _SMALLEST) for k in chosen]
        ax.barh(chosen, ratios, left=_SMALLEST, height=0.7, color=colour, label=str(quantity))
    ax.axvline(1.0, color=_LIMIT, linewidth=2.0)
    ax.set_xscale("log")
    ax.set_xlim(_SMALLEST, max(10.0, 2.0 * max((pair.ratio for pair in pairs), default=0.0)))
    ax.set_yticks(list(rows), [f"{pair.first} – {pair.second}" for pair in pairs])
    ax.invert_yaxis()
    ax.set_xlabel("largest difference over its tolerance (red line: the tolerance)")
    figure.legend(loc="outside lower center", ncols=len(quantities), frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_title(f"{report.verdict} {len(report.xyx)} poses, {report.states} configurations", loc="left")
    return figure


def calibration_figure(calibration: Calibration) -> Figure:
    """Draw the position errors of all measurements before and after, and the uncertainties of the combinations."""
    check_instance(calibration, Calibration, "calibration")
    figure = new_figure(9.0, 3.8, layout="constrained")
    errors, combinations = figure.subplots(1, 2, width_ratios=(3, 2))
    rows = np.arange(len(calibration.misfit))
    for name, residuals, colour in (
        ("before", calibration.before, _VERMILION),
        ("after", calibration.residuals, _BLUE),
    ):
        sizes = 1e6 * np.linalg.norm(residuals[:, :3], axis=-1)
        rms = np.sqrt((sizes**2).mean())
        errors.semilogy(rows, np.maximum(sizes, 1e-9), "o", ms=3.5, color=colour, label=f"{name}, {rms:.3g} µm RMS")
    if calibration.outliers.any():
        at = np.flatnonzero(calibration.outliers)
        sizes = 1e6 * np.linalg.norm(calibration.residuals[at, :3], axis=-1)
        errors.plot(at, sizes, "o", ms=9, mfc="none", color="black", label="outlier")
    errors.set(xlabel="measurement", ylabel="predicted − measured position [µm]")
    errors.legend(fontsize=8, loc="center right")
    combinations.semilogy(1 + np.arange(len(calibration.deviations)), calibration.deviations, ".", color=_BLUE)
    count = len(calibration.deviations)
    combinations.set(xlabel="combination of parameters", ylabel="standard deviation [d, rad]")
    combinations.set_title(f"{count} identifiable, {len(calibration.unidentifiable)} not", fontsize=10)
    return figure


def certificate_figure(certificate: Certificate) -> Figure:
    """Draw the boxes of both stages over the tilt of the middle platform, seen along Z."""
    check_instance(certificate, Certificate, "certificate")
    figure = new_figure(9.0, 4.6, layout="constrained")
    stages = (("lower stage", certificate.lower, 0), ("upper stage", certificate.upper, 1))
    for ax, (name, proof, k) in zip(figure.subplots(1, 2), stages, strict=True):
        _draw_boxes(ax, proof.proved, _BLUE, "proved")
        _draw_boxes(ax, proof.undecided, _VERMILION, "undecided")
        reach = max(float(np.abs(boxes[:, :2]).max()) for boxes in (proof.proved, proof.undecided) if len(boxes))
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        for tilt in _TILTS:
            radius = np.sin(np.radians(tilt) / 2.0)
            if radius < reach * 1.3:
                ax.plot(radius * np.cos(angle), radius * np.sin(angle), color="0.6", lw=0.6)
                around = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
                ax.annotate(f"{tilt}°", (0.0, radius), color="0.2", fontsize=8, ha="center", va="center", bbox=around)
        bound = certificate.bounds[k]
        ax.set_title(f"{name}: |det J_{'bc'[k]}| ≥ {bound:.3f} d³" if bound else f"{name}: undecided", fontsize=10)
        ax.set(aspect="equal", xlabel="x", ylabel="y" if k == 0 else "")
        ax.legend(fontsize=8, frameon=False, loc="upper right")
    title = "Tilt of the middle platform, vector part (x, y) of its quaternion"
    if any(certificate.errors):
        title += "; all machines within {:g} mm and {:g} mrad".format(*(1e3 * error for error in certificate.errors))
    figure.suptitle(title, fontsize=10)
    return figure


def _draw_boxes(ax: Axes, boxes: np.ndarray, colour: str, label: str) -> None:
    from matplotlib.collections import PolyCollection

    if not len(boxes):
        return
    # Boxes above one another cover the same tilts: each rectangle is drawn once.
    (x0, x1), (y0, y1) = np.moveaxis(np.unique(boxes[:, :2], axis=0), 0, -1)
    corners = np.stack([np.stack(pair, axis=-1) for pair in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1)
    ax.add_collection(
        PolyCollection(list(corners), facecolor=colour, edgecolor="white", lw=0.2, alpha=0.75, label=label)
    )
    ax.autoscale_view()


def motion_figure(
    motion: JointTrajectory,
    readings: FloatArray,
    limits: LegLimits | None = None,
    largest: dict[str, Any] | None = None,
) -> Figure:
    """Draw the six legs of a motion over time.

    Parameters
    ----------
    motion : JointTrajectory
        Times, rates, accelerations and forces.
    readings : ndarray, shape (n, 6)
        At its times [m], of `ClosedChain.readings`.
    limits : LegLimits, optional
        Drawn as lines.
    largest : dict, optional
        Limits of "leg_rates" [m/s], "leg_accelerations" [m/s²] and "leg_forces" [N], the same for both directions, one
        for all legs or six.
    """
    from spm_pin.multibody.trajectory import JointTrajectory

    colours = (_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE, _PURPLE)
    check_instance(motion, JointTrajectory, "motion")
    # The chain may have a prefix.
    slides = [next(k for k, name in enumerate(motion.joint_names) if name.endswith(slide)) for slide in SLIDES]
    figure = new_figure(8.0, 8.4, layout="constrained")
    rows = (
        ("reading [m]", readings, None),
        ("rate [m/s]", motion.velocities[:, slides], "leg_rates"),
        ("acceleration [m/s²]", motion.accelerations[:, slides], "leg_accelerations"),
        ("force [N]", motion.efforts[:, slides], "leg_forces"),
    )
    axes = figure.subplots(4, 1, sharex=True)
    for ax, (label, values, key) in zip(axes, rows, strict=True):
        for leg, column in enumerate(values.T):
            ax.plot(motion.times, column, color=colours[leg], lw=1.4, ls="-" if leg < 3 else "--", label=LEGS[leg])
        if key is None:
            lines = np.unique([limits.minimum, limits.maximum]) if limits is not None else np.empty(0)
        else:
            bound = (largest or {}).get(key)
            lines = np.unique([] if bound is None else np.multiply.outer([-1.0, 1.0], bound))
        for line in lines:
            ax.axhline(line, color="0.55", lw=0.9, ls=":")
        ax.set_ylabel(label)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(fontsize=8, frameon=False, ncols=6, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.align_ylabels(axes)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(float(motion.times[0]), float(motion.times[-1]))
    return figure
