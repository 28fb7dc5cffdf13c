"""Results written out: figures of results, figures in files, JSON, and numbers as text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.description.tree import SLIDES
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism import LEGS, LegLimits
from spm_pin.mechanism.arguments import FloatArray, check_instance, file_path, writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from spm_pin.calibration import Calibration
    from spm_pin.crosscheck import Report
    from spm_pin.multibody.trajectory import JointTrajectory
    from spm_pin.proofs import Certificate

FORMATS = (".png", ".svg", ".pdf")
"""File types that figures are written in."""
WIDEST = 6000
"""Largest width of a picture of the mechanism in pixels: one of 6000 takes 2 GB and a minute."""

# After Okabe and Ito's palette, distinct with any colour vision.
_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE, _PURPLE = "#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7"
_LIMIT = "#d62728"
_SMALLEST = 1e-8  # shares of a tolerance below this are drawn as this
_TILTS = (30, 60, 90, 120)  # degrees, circles in the picture of a certificate


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """Return a matplotlib figure of a size in inches."""
    require_extra("plots", "matplotlib")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), **options)


def check_appearance(width: int, narrowest: int, background: str) -> None:
    """Check the width of a picture in pixels, from `narrowest` to `WIDEST`, and the colour behind it."""
    if not isinstance(width, int) or not narrowest <= width <= WIDEST:
        expected = f"at least {narrowest}" if isinstance(width, int) and width < narrowest else f"at most {WIDEST}"
        raise ArgumentError("width", f"{expected} pixels, a whole number", width)
    require_extra("plots", "matplotlib")
    from matplotlib.colors import is_color_like

    if not is_color_like(background):
        expected = "a colour of matplotlib, such as white, #f0f0f0 or none"
        raise ArgumentError("background", expected, repr(background))


def save_figure(figure: Figure, path: str | Path, *, dpi: float = 150.0, background: str = "white") -> Path:
    """Save a figure as .png, .svg or .pdf, the same bytes for the same figure; a file that exists is replaced."""
    path = file_path(path, suffixes=FORMATS)
    from matplotlib import rc_context

    # Without the date, and with names that do not change from run to run.
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    with writing(path), rc_context({"svg.hashsalt": "spm-pin"}):
        figure.savefig(path, dpi=dpi, facecolor=background, metadata=metadata)
    return path


def fixed(value: float, digits: int) -> str:
    """Format with a number of decimals; a number that rounds to zero has no sign."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def to_json(content: Any) -> str:
    """Return JSON text of dictionaries, sequences, arrays and scalars: not finite becomes null, -0.0 becomes 0.0."""
    return json.dumps(_plain(content), indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(member) for key, member in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(member) for member in value]
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value


def agreement_figure(report: Report) -> Figure:
    """Draw the largest difference of every pair of methods as a share of its tolerance, on a logarithmic axis."""
    from spm_pin.crosscheck import Quantity, Report

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
    from spm_pin.calibration import Calibration

    check_instance(calibration, Calibration, "calibration")
    figure = new_figure(9.0, 3.8, layout="constrained")
    errors, combinations = figure.subplots(1, 2, width_ratios=(3, 2))
    residuals = {"before": (calibration.before, _VERMILION), "after": (calibration.residuals, _BLUE)}
    for name, (values, colour) in residuals.items():
        sizes = 1e6 * np.linalg.norm(values[:, :3], axis=-1)
        label = f"{name}, {np.sqrt((sizes**2).mean()):.3g} µm RMS"
        errors.semilogy(np.maximum(sizes, 1e-9), "o", ms=3.5, color=colour, label=label)
    outliers = np.flatnonzero(calibration.outliers)
    if len(outliers):
        sizes = 1e6 * np.linalg.norm(calibration.residuals[outliers, :3], axis=-1)
        errors.plot(outliers, sizes, "o", ms=9, mfc="none", color="black", label="outlier")
    errors.set(xlabel="measurement", ylabel="predicted − measured position [µm]")
    errors.legend(fontsize=8, loc="center right")
    count = len(calibration.deviations)
    combinations.semilogy(1 + np.arange(count), calibration.deviations, ".", color=_BLUE)
    combinations.set(xlabel="combination of parameters", ylabel="standard deviation [d, rad]")
    combinations.set_title(f"{count} identifiable, {len(calibration.unidentifiable)} not", fontsize=10)
    return figure


def certificate_figure(certificate: Certificate) -> Figure:
    """Draw the boxes of both stages over the tilt of the middle platform, seen along Z."""
    from spm_pin.proofs import Certificate

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


def _draw_boxes(ax: Axes, boxes: FloatArray, colour: str, label: str) -> None:
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

    check_instance(motion, JointTrajectory, "motion")
    colours = (_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE, _PURPLE)
    # The chain may have a prefix.
    slides = [next(k for k, name in enumerate(motion.joint_names) if name.endswith(slide)) for slide in SLIDES]
    figure = new_figure(8.0, 8.4, layout="constrained")
    ends = np.empty(0) if limits is None else np.concatenate([limits.minimum, limits.maximum])
    bounds = {key: np.multiply.outer([-1.0, 1.0], bound) for key, bound in (largest or {}).items()}
    rows = (
        ("reading [m]", readings, ends),
        ("rate [m/s]", motion.velocities[:, slides], bounds.get("leg_rates", [])),
        ("acceleration [m/s²]", motion.accelerations[:, slides], bounds.get("leg_accelerations", [])),
        ("force [N]", motion.efforts[:, slides], bounds.get("leg_forces", [])),
    )
    axes = figure.subplots(4, 1, sharex=True)
    for ax, (label, values, lines) in zip(axes, rows, strict=True):
        for leg, column in enumerate(values.T):
            ax.plot(motion.times, column, color=colours[leg], lw=1.4, ls="-" if leg < 3 else "--", label=LEGS[leg])
        for line in np.unique(lines):
            ax.axhline(line, color="0.55", lw=0.9, ls=":")
        ax.set_ylabel(label)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(fontsize=8, frameon=False, ncols=6, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.align_ylabels(axes)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(float(motion.times[0]), float(motion.times[-1]))
    return figure
