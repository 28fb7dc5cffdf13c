"""Draw a picture of what each example shows: `python docs/site/example_figures.py`. Needs "spm-pin[plots,robots]"."""

from __future__ import annotations

import runpy
import tempfile
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from figures import IMAGES, LOWER, UPPER, plot_legs, save
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import spm_pin as spm
from spm_pin.display.plots import draw
from spm_pin.display.shell_plots import draw_shell
from spm_pin.paper import jacobian

EXAMPLES = Path(__file__).parents[2] / "examples"
Names = dict[str, Any]


def main() -> None:
    """Run each example where it can write, and draw what it has made."""
    (IMAGES / "examples").mkdir(exist_ok=True)
    for script in sorted(EXAMPLES.glob("*.py")):
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            picture = PICTURES[script.stem[:2]]
            names = runpy.run_path(str(script), run_name="__main__") if picture is not mechanism else {}
            figure = Figure(figsize=(4.2, 2.5), layout="constrained")
            picture(figure, names)
            save(figure, f"examples/{script.stem}")


def plain(figure: Figure, x: str, y: str, title: str) -> Axes:
    """Return axes without a box."""
    ax = figure.subplots()
    ax.set_xlabel(x, fontsize=8)
    ax.set_ylabel(y, fontsize=8)
    ax.set_title(title, fontsize=8)
    ax.tick_params(labelsize=7)
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def branches(figure: Figure, names: Names) -> None:
    """Draw the leg lengths of the branches between their limits."""
    ax = plain(figure, "", "leg length [m]", "leg lengths of the six real branches, and the limits")
    found = names["branches"]
    real = np.flatnonzero(found.exists)
    ax.axhspan(1.10, 1.50, color="#e3e6e9")
    for k in range(6):
        colour, mark = (LOWER if k < 3 else UPPER), "osv"[k % 3]
        ax.plot(np.arange(len(real)), found.leg_lengths[real, k], mark, color=colour, ms=4)
    ax.set_xticks(np.arange(len(real)), [found.labels[i] for i in real])


def mechanism(figure: Figure, names: Names) -> None:
    """Draw the mechanism."""
    del names
    pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    found = spm.inverse_displacement(spm.Geometry.paper(), pose)
    for ax, label in zip(figure.subplots(1, 3), ("TT+", "TF+", "FF+"), strict=True):
        draw(found[label], ax=ax, labels=False)
        ax.set_title(label, fontsize=8)


def witnesses(figure: Figure, names: Names) -> None:
    """Draw how far the witnesses are apart."""
    ax = plain(figure, "", "largest difference, relative", "J_f from three witnesses, against the closed form")
    chain, found = names["chain"], spm.inverse_displacement(names["geometry"], names["pose"])
    states, labels = list(found), [x for x, real in zip(found.labels, found.exists, strict=True) if real]
    for name, colour, witness in (
        ("paper's 9 × 9", LOWER, jacobian.J_f),
        ("Pinocchio", UPPER, lambda c: chain.inverse_jacobian(chain.joint_values(c))),
    ):
        truth = [spm.inverse_jacobian(c) for c in states]
        off = [np.abs(witness(c) - J).max() / np.abs(J).max() for c, J in zip(states, truth, strict=True)]
        ax.semilogy(labels, off, "o", color=colour, ms=5, label=name)
    ax.set_ylim(1e-17, 1e-12)
    ax.legend(fontsize=7, frameon=False)


def path(figure: Figure, names: Names) -> None:
    """Draw the distance to an inverse singularity along the path."""
    found = names["path"]
    ax = plain(figure, "parameter", "smallest singular value of K", "along a path, across an inverse singularity")
    ax.semilogy(found.parameters, spm.singularities(found.configurations).sigma[:, 2], color="black")
    for event in found.events:
        singular = event.kind is spm.closed_form.EventKind.INVERSE_SINGULARITY
        ax.axvline(event.parameter, color="#cc4778" if singular else UPPER, ls="-" if singular else ":", lw=1)


def dynamics(figure: Figure, names: Names) -> None:
    """Draw the leg forces along a motion."""
    ax = plain(figure, "time [s]", "leg force [N]", "leg forces along a motion")
    plot_legs(ax, names["times"], names["efforts"], fontsize=6)


def control(figure: Figure, names: Names) -> None:
    """Draw the position of o under control."""
    run, chain = names["run"], names["chain"]
    ax = plain(figure, "time [s]", "off by [mm]", "task-space control under a push of 30 N")
    wanted = names["path"]
    off = [
        chain.configuration(q).translation - wanted(min(t, wanted.duration)).pose.translation
        for t, q in zip(run.times, run.q, strict=True)
    ]
    ax.plot(run.times, 1e3 * np.array(off), "o-", ms=3, label=["x", "y", "z"])
    ax.legend(fontsize=7, frameon=False)


def trajectory(figure: Figure, names: Names) -> None:
    """Draw all joints over time."""
    found = names["trajectory"]
    ax = plain(figure, "time [s]", "rad, m", "eighteen joints from a platform path")
    ax.plot(found.times, found.positions - found.positions[0], lw=1)


def arm(figure: Figure, names: Names) -> None:
    """Draw the arm and the wrist as lines."""
    ax = plain(figure, "X [m]", "Z [m]", "a small manipulator as the wrist of a UR5")
    both, q = names["both"], names["q"]
    data = both.model.createData()
    pin.forwardKinematics(both.model, data, q)
    for joint in range(1, both.model.njoints):
        parent = both.model.parents[joint]
        own = both.model.names[joint].startswith("spm_")
        line = np.array([data.oMi[parent].translation, data.oMi[joint].translation])
        ax.plot(line[:, 0], line[:, 2], color=UPPER if own else "#5f6770", lw=1.5 if own else 5, solid_capstyle="round")
    ax.set_aspect("equal")


def shell(figure: Figure, names: Names) -> None:
    """Draw the shell."""
    ax = draw_shell(names["shell"], ax=figure.subplots())
    ax.axis("off")


def conditioning(figure: Figure, names: Names) -> None:
    """Draw the conditioning, and the curve on which det K is zero."""
    ax = plain(figure, "r_b1 [m]", "r_b2 [m]", "conditioning over two leg lengths, det K = 0")
    found = names["found"].transpose("r_b2", "r_b1")
    image = ax.pcolormesh(found.r_b1, found.r_b2, found.conditioning, cmap="cividis")
    ax.contour(found.r_b1, found.r_b2, found.det_structure, levels=[0.0], colors="white", linewidths=1)
    figure.colorbar(image, ax=ax).ax.tick_params(labelsize=7)


PICTURES: dict[str, Callable[[Figure, Names], None]] = {
    "01": branches,
    "02": mechanism,
    "03": witnesses,
    "04": path,
    "05": dynamics,
    "06": control,
    "07": trajectory,
    "08": arm,
    "09": shell,
    "10": conditioning,
}

if __name__ == "__main__":
    main()
