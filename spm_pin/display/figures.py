"""Figures of results: cross-checks, calibrations, paths, tilts, certificates, motions, and fronts of designs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.display.writing import legend_below, new_figure, write_name
from spm_pin.machine import LegLimits
from spm_pin.support.arguments import FloatArray, check_instance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from spm_pin.calibration import Calibration
    from spm_pin.crosscheck import Report
    from spm_pin.design import DesignProblem, Front
    from spm_pin.kinematics import FollowedPath
    from spm_pin.multibody.trajectory import JointTrajectory
    from spm_pin.proofs import Certificate
    from spm_pin.workspace import StageReach

# After Okabe and Ito's palette, distinct with any colour vision.
_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE, _PURPLE = "#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7"
_LIMIT = "#d62728"
_SMALLEST = 1e-8  # smaller fractions of a tolerance are drawn as this
_OPACITY = 0.75  # of a box over white
_TILTS = (30, 60, 90, 120)  # degrees, circles in the picture of a certificate


def agreement_figure(report: Report) -> Figure:
    """Draw the largest difference of every pair of methods relative to its tolerance, on a logarithmic axis."""
    from spm_pin.crosscheck import Quantity, Report

    pairs = check_instance(report, Report, "report", "compare_methods returns one").differences
    figure = new_figure(8.0, 1.6 + 0.24 * len(pairs), layout="constrained")
    ax = figure.add_subplot()
    colours = (_BLUE, _GREEN, _ORANGE, _PURPLE)
    quantities = (Quantity.POSITIONS, Quantity.JACOBIAN, Quantity.FORCES, Quantity.ASSEMBLY)
    for quantity, colour in zip(quantities, colours, strict=True):
        ratios = {row: max(pair.ratio, _SMALLEST) for row, pair in enumerate(pairs) if pair.quantity is quantity}
        if ratios:
            options: dict[str, Any] = {"left": _SMALLEST, "height": 0.7, "color": colour, "label": str(quantity)}
            ax.barh(list(ratios), list(ratios.values()), **options)
    ax.axvline(1.0, color=_LIMIT, linewidth=2.0)
    ax.set_xscale("log")
    ax.set_xlim(_SMALLEST, max(10.0, 2.0 * max((pair.ratio for pair in pairs), default=0.0)))
    ax.set_yticks(range(len(pairs)), [f"{pair.first} – {pair.second}" for pair in pairs])
    ax.invert_yaxis()
    ax.set_xlabel("largest difference over its tolerance (red line: the tolerance)")
    legend_below(figure)
    ax.spines[["top", "right"]].set_visible(False)
    count = "1 pose" if report.poses == 1 else f"{report.poses} poses"
    figure.suptitle(f"{report.verdict} {count}, {report.states} configurations")
    return figure


def calibration_figure(calibration: Calibration[Any]) -> Figure:
    """Draw the position errors of all measurements before and after, and the uncertainties of the combinations."""
    from spm_pin.calibration import Calibration

    check_instance(calibration, Calibration, "calibration")
    figure = new_figure(9.0, 3.8, layout="constrained")
    errors, combinations = figure.subplots(1, 2, width_ratios=(3, 2))
    what, unit, *both = calibration.error_sizes[0]
    for name, size, colour in zip(("before", "after"), both, (_VERMILION, _BLUE), strict=True):
        sizes = 1e6 * size
        label = f"{name}, {float(f'{np.sqrt(np.nanmean(sizes**2)):.3g}'):g} µ{unit} RMS"  # 9200, not 9.2e+03
        errors.semilogy(np.maximum(sizes, 1e-9), "o", ms=3.5, color=colour, label=label)
    outliers = np.flatnonzero(calibration.outliers)
    if len(outliers):
        errors.plot(outliers, 1e6 * both[1][outliers], "o", ms=9, mfc="none", color="black", label="outlier")
    errors.set(xlabel="measurement", ylabel=f"predicted − measured {what} [µ{unit}]")
    legend_below(figure, fontsize=8)
    count = len(calibration.deviations)
    combinations.semilogy(1 + np.arange(count), calibration.deviations, ".", color=_BLUE)
    combinations.set(xlabel="combination of parameters", ylabel="standard deviation [d,\u00a0rad]")
    combinations.set_title(f"{count} identifiable, {len(calibration.unidentifiable)}\u00a0not", fontsize=10)
    return figure


def path_figure(path: FollowedPath) -> Figure:
    """Draw the legs along a followed path, its distances to singularities, and its events as vertical lines."""
    from spm_pin.kinematics import EventKind, FollowedPath, singularities

    check_instance(path, FollowedPath, "path", "follow returns one")
    states, legs = path.configurations, path.configurations.machine.legs
    figure = new_figure(6.5, 5.0, layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for leg, (name, column) in enumerate(zip(legs.names, states.readings.T, strict=True)):
        colour, style = (_BLUE if leg < 3 else _ORANGE), ("-", "--", ":")[leg % 3]
        top.plot(path.parameters, column, color=colour, ls=style, label=f"$r_{{{name[2:]}}}$")
    top.set(ylabel=f"leg reading [{', '.join(dict.fromkeys(legs.units))}]")
    forward, inverse = [("$J_b$", _GREEN, "-"), ("$J_c$", _SKY, "-.")], ("$K$", "black", "-")
    if states.machine.is_stage:
        forward, inverse = [("forward", _GREEN, "-")], ("inverse", "black", "-")
    for column, (name, colour, style) in zip(singularities(states).sigma.T, (*forward, inverse), strict=True):
        bottom.semilogy(path.parameters, column, color=colour, ls=style, label=name)
    bottom.set(xlabel="parameter", ylabel="smallest singular value")
    kinds = {EventKind.LIMIT: (":", _VERMILION), EventKind.INVERSE_SINGULARITY: ("-", _PURPLE)}
    for ax in (top, bottom):
        for event in path.events:
            style, colour = kinds.get(event.kind, ("-", "0.5"))
            label = str(event.kind) if ax is bottom else None
            ax.axvline(event.parameter, color=colour, ls=style, lw=1.0, label=label)
        ax.spines[["top", "right"]].set_visible(False)
    legend_below(figure, fontsize=8)
    return figure


def reach_figure(reach: StageReach) -> Figure:
    """Draw the largest tilt in every direction, a line for each height; legs are marked at their azimuths on the rim.

    Parameters
    ----------
    reach : StageReach
        Result of `spm_pin.workspace.reach`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from spm_pin.workspace import StageReach

    found = check_instance(reach, StageReach, "reach", "spm_pin.workspace.reach returns one")
    figure = new_figure(6.0, 5.2, layout="constrained")
    from matplotlib import colormaps

    ax: Any = figure.add_subplot(projection="polar")
    count = len(found.heights)
    for k, (height, tilts) in enumerate(zip(found.heights, found.tilts, strict=True)):
        around = np.append(found.azimuths, found.azimuths[0] + 2.0 * np.pi)
        colour = colormaps["viridis"](k / max(count - 1, 1) * 0.92)
        label = f"{1e3 * height:.4g} mm"
        ax.plot(around, np.degrees(np.append(tilts, tilts[0])), color=colour, lw=1.5, label=label)
    ax.set_title("largest tilt [°] by the direction of the lowest point", fontsize=10)
    ax.set_thetagrids(range(0, 360, 30))
    top = float(np.nanmax(np.degrees(found.tilts), initial=1.0)) * 1.15
    ax.set_ylim(0.0, top)
    for leg, name in zip(found.stage.legs.pivots, found.stage.legs.names, strict=True):
        write_name(ax, (float(np.arctan2(leg[1], leg[0])), 0.93 * top), f"${name}$", 10, "black", 0.3)
    legend_below(figure, columns=5, fontsize=8)
    return figure


def certificate_figure(certificate: Certificate) -> Figure:
    """Draw the boxes of each stage over the tilt of the platform on its balls, seen along Z."""
    from spm_pin.proofs import Certificate

    check_instance(certificate, Certificate, "certificate")
    count = len(certificate.stages)
    figure = new_figure(4.5 * count, 4.6, layout="constrained")
    places = figure.subplots(1, count, squeeze=False)[0]
    for k, (ax, name, proof) in enumerate(zip(places, certificate.names, certificate.stages, strict=True)):
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
        bound, whose = certificate.bounds[k], "" if count == 1 else f"{('lower', 'upper')[k]} stage: "
        ax.set_title(f"{whose}|det {name}| ≥ {bound:.3f} d³" if bound else f"{whose}{certificate.verdict}", fontsize=10)
        ax.set(aspect="equal", xlabel="x", ylabel="y" if k == 0 else "")
    legend_below(figure, fontsize=8)
    title = f"Tilt of the {'middle ' * (count == 2)}platform, vector part (x, y) of its quaternion"
    if any(certificate.errors):
        title += "; all machines within {:g} mm and {:g} mrad".format(*(1e3 * error for error in certificate.errors))
    figure.suptitle(title, fontsize=10)
    return figure


def _draw_boxes(ax: Axes, boxes: FloatArray, colour: str, label: str) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    if not len(boxes):
        return
    # Boxes above one another cover the same tilts: each rectangle is drawn once.
    (x0, x1), (y0, y1) = np.moveaxis(np.unique(boxes[:, :2], axis=0), 0, -1)
    corners = np.stack([np.stack(pair, axis=-1) for pair in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1)
    # Opaque: tilts covered by several boxes have the shade of the others.
    pale = 1.0 - _OPACITY * (1.0 - np.array(to_rgb(colour)))
    ax.add_collection(PolyCollection(list(corners), facecolor=pale, edgecolor="white", lw=0.2, label=label))
    ax.autoscale_view()


def motion_figure(
    motion: JointTrajectory, limits: LegLimits | None = None, largest: dict[str, Any] | None = None
) -> Figure:
    """Draw the legs of a motion over time.

    Parameters
    ----------
    motion : JointTrajectory
        Times, readings, rates, accelerations and forces.
    limits : LegLimits, optional
        Limits drawn as lines.
    largest : dict, optional
        Limits of "leg_rates" [m/s], "leg_accelerations" [m/s²] and "leg_forces" [N], the same for both directions, one
        for all legs or six.
    """
    from spm_pin.multibody.trajectory import JointTrajectory

    check_instance(motion, JointTrajectory, "motion")
    colours = (_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE, _PURPLE)
    columns, (unit, rate, acceleration, effort) = list(motion.actuated), motion.leg_units
    figure = new_figure(8.0, 8.4, layout="constrained")
    ends = np.empty(0) if limits is None else np.concatenate([limits.minimum, limits.maximum])
    bounds = {key: np.multiply.outer([-1.0, 1.0], bound) for key, bound in (largest or {}).items()}
    rows = (
        (f"reading [{unit}]", motion.readings, ends),
        (f"rate [{rate}]", motion.velocities[:, columns], bounds.get("leg_rates", [])),
        (f"acceleration [{acceleration}]", motion.accelerations[:, columns], bounds.get("leg_accelerations", [])),
        (f"force [{effort}]", motion.efforts[:, columns], bounds.get("leg_forces", [])),
    )
    axes = figure.subplots(4, 1, sharex=True)
    for ax, (label, values, lines) in zip(axes, rows, strict=True):
        for leg, (name, column) in enumerate(zip(motion.legs, values.T, strict=True)):
            ax.plot(motion.times, column, color=colours[leg], lw=1.4, ls="-" if leg < 3 else "--", label=name)
        for line in np.unique(lines):
            ax.axhline(line, color="0.55", lw=0.9, ls=":")
        ax.set_title(label, loc="left", fontsize=10)
        ax.spines[["top", "right"]].set_visible(False)
    legend_below(figure, columns=6, fontsize=8)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(float(motion.times[0]), float(motion.times[-1]))
    return figure


def front_figure(front: Front) -> Figure:
    """Draw a search for dimensions in its first two aims: all machines, the front, and the machine at the start.

    A third aim is the colour of the front. With a single aim the other axis is a bound, or the area of the base.
    """
    from spm_pin.design import Front

    problem = check_instance(front, Front, "front", "pareto_front returns one").problem
    names = list(problem.aims)
    if len(names) == 1:
        others = (*problem.columns, "footprint", "volume")
        names.append(next(name for name in others if name not in (*names, "certified", "assembled")))
    figure = new_figure(7.0, 5.0, layout="constrained")
    ax = figure.add_subplot()
    x, y = names[:2]
    every, chosen, start = (part.columns for part in (front.evaluated, front.designs, front.reference))
    ax.scatter(every[x], every[y], s=6, color="0.82", label="evaluated")
    colour: Any = chosen[names[2]] if len(names) > 2 else _BLUE
    points = ax.scatter(chosen[x], chosen[y], s=30, c=colour, label="front", zorder=3)
    if len(names) > 2:
        figure.colorbar(points, ax=ax, label=_aim(problem, names[2]))
    label = "machine at the start"
    ax.scatter(start[x], start[y], s=110, marker="*", color=_VERMILION, edgecolor="white", label=label, zorder=4)
    # Machines without states are far from all others.
    for set_limits, name in ((ax.set_xlim, x), (ax.set_ylim, y)):
        shown = np.concatenate([chosen[name], start[name]])
        room = 0.15 * max(float(np.ptp(shown)), 1e-9 + 0.1 * float(np.abs(shown).max()))
        set_limits(float(shown.min()) - room, float(shown.max()) + room)
    ax.set(xlabel=_aim(problem, x), ylabel=_aim(problem, y))
    ax.ticklabel_format(scilimits=(-3, 4), useMathText=True)
    legend_below(figure, fontsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    return figure


def _aim(problem: DesignProblem, name: str) -> str:
    # The limit of a payload is 1 N. Lines are not broken within a unit.
    unit = "of a leg's force" if name.rpartition("_")[0] in ("payload", "payload_down") else problem.column_unit(name)
    sense, unit = problem.aims.get(name), unit.replace(" ", "\u00a0")
    return name + f" [{unit}]" * (unit != "1") + f", {sense}" * bool(sense)
