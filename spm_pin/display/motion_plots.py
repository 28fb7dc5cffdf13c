"""Picture of a motion: leg lengths, rates, accelerations and forces over time, with their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.description.tree import SLIDES
from spm_pin.display.figure_files import new_figure
from spm_pin.mechanism.arguments import FloatArray, instance
from spm_pin.mechanism.geometry import LEGS, LegLimits
from spm_pin.multibody.trajectory import JointTrajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["motion_figure"]

COLOURS = ("#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7")
"""Colours of r_b1 to r_c3, distinct with any colour vision."""


def motion_figure(
    motion: JointTrajectory,
    leg_lengths: FloatArray,
    limits: LegLimits | None = None,
    largest: dict[str, Any] | None = None,
) -> Figure:
    """Draw the six legs of a motion over time.

    Parameters
    ----------
    motion : JointTrajectory
        Times, rates, accelerations and forces.
    leg_lengths : ndarray, shape (n, 6)
        At its times [m], of `ClosedChain.leg_lengths`.
    limits : LegLimits, optional
        Drawn as lines.
    largest : dict, optional
        Limits of "leg_rates" [m/s], "leg_accelerations" [m/s²] and "leg_forces" [N], the same for both directions, one
        for all legs or six.
    """
    instance(motion, JointTrajectory, "motion")
    # The chain may have a prefix.
    slides = [next(k for k, name in enumerate(motion.joint_names) if name.endswith(slide)) for slide in SLIDES]
    figure = new_figure(8.0, 8.4, layout="constrained")
    rows = (
        ("length [m]", leg_lengths, None),
        ("rate [m/s]", motion.velocities[:, slides], "leg_rates"),
        ("acceleration [m/s²]", motion.accelerations[:, slides], "leg_accelerations"),
        ("force [N]", motion.efforts[:, slides], "leg_forces"),
    )
    axes = figure.subplots(4, 1, sharex=True)
    for ax, (label, values, key) in zip(axes, rows, strict=True):
        for leg, column in enumerate(values.T):
            ax.plot(motion.times, column, color=COLOURS[leg], lw=1.4, ls="-" if leg < 3 else "--", label=LEGS[leg])
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
