"""Pictures of certificates: which tilts of the middle platform are proved, and which are undecided."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spm_pin.display.figure_files import new_figure
from spm_pin.mechanism.arguments import instance
from spm_pin.proofs import Certificate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["certificate_figure"]

PROVED, UNDECIDED = "#0072b2", "#d55e00"
TILTS = (30, 60, 90, 120)
"""Tilts [degrees] marked by circles."""


def certificate_figure(certificate: Certificate) -> Figure:
    """Draw the boxes of both stages over the tilt of the middle platform, seen along Z."""
    instance(certificate, Certificate, "certificate")
    figure = new_figure(9.0, 4.6, layout="constrained")
    stages = (("lower stage", certificate.lower, 0), ("upper stage", certificate.upper, 1))
    for ax, (name, proof, k) in zip(figure.subplots(1, 2), stages, strict=True):
        _draw_boxes(ax, proof.proved, PROVED, "proved")
        _draw_boxes(ax, proof.undecided, UNDECIDED, "undecided")
        reach = max(float(np.abs(boxes[:, :2]).max()) for boxes in (proof.proved, proof.undecided) if len(boxes))
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        for tilt in TILTS:
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
