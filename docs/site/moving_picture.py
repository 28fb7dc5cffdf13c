"""Draw the README's moving picture: `python docs/site/moving_picture.py [FRAMES]`. Needs `pip install ".[plots]"`.

A pose moves along a closed path. On the left the physical branch carries a load, its legs in the colour of their force;
on the right all branches of the same pose. Legs of the physical branch stay within the limits of the paper.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from figures import IMAGES, MACHINE
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.description.visuals import section_size
from spm_pin.display.rendering import VIEW, Colour, Solid, arrow, bounds, camera_axes, render, robot_solids

FRAMES, SECONDS = 36, 4.0
WIDTH, HEIGHT, DPI = 1200, 700, 100
INK, PALE, LOAD = "#20262d", "#8a929a", (0.125, 0.149, 0.176)
LARGEST = 700.0  # end of the scale of forces [N]
# Blue and orange are the legs of the lower and of the upper stage.
FORCES = LinearSegmentedColormap.from_list("forces", ["#1b7837", "#8fc49a", "#eceae4", "#b99bc6", "#762a83"])
BODIES = "base", "terminal"
GREY: Colour = (0.88, 0.89, 0.9)
CAMERA = camera_axes(VIEW)
# Lengths of the six legs: mean and amplitude [m], and where in the cycle each begins [degrees].
MEAN, AMPLITUDE = np.array([1.36, 1.20, 1.23, 1.32, 1.39, 1.22]), np.array([0.05, 0.08, 0.05, 0.14, 0.06, 0.05])
PHASE = np.array([53.0, 77.0, 71.0, 102.0, 140.0, 261.0])


def main(frames: int) -> None:
    """Draw all frames and write them as one WebP that repeats."""
    turns = np.linspace(0.0, 360.0, frames, endpoint=False)
    states = spm.forward_physical(MACHINE, MEAN + AMPLITUDE * np.cos(np.deg2rad(turns[:, None] + PHASE)))
    branches = spm.inverse_displacement(MACHINE, states.pose)
    forces = spm.leg_forces(states, [0.0, 0.0, -500.0, 0.0, 0.0, 0.0])
    assert MACHINE.limits is not None
    assert MACHINE.limits.contains(states.readings).all()
    assert np.abs(forces).max() < LARGEST
    loaded = [_loaded(states[k], forces[k]) for k in range(frames)]
    others = [[_solids(state) for state in branches[k]] for k in range(frames)]
    film = Film(_window(loaded), _window([solids for frame in others for solids in frame]))
    pictures = [film.frame(loaded[k], branches[k]) for k in range(frames)]
    path = IMAGES / "moving.webp"
    first, *following = pictures
    duration = round(1000.0 * SECONDS / frames)
    first.save(path, save_all=True, append_images=following, duration=duration, loop=0, quality=78, method=4)
    print(f"{path.name}: {path.stat().st_size // 1024} kB, {frames} frames")


def _solids(state: spm.Configuration) -> list[Solid]:
    return robot_solids(state, frames=False)


def _loaded(state: spm.Configuration, forces: np.ndarray) -> list[Solid]:
    """Return the solids with the tubes of the legs in the colours of their forces, and an arrow for the load."""
    colours = dict(zip(spm.machine.LEGS, FORCES(0.5 + 0.5 * forces / LARGEST)[:, :3], strict=True))
    solids = []
    for solid in _solids(state):
        leg = colours.get(f"r_{solid.name[4:6]}") if solid.name.endswith(" tube") else None
        solids.append(solid if leg is None else replace(solid, colour=tuple(leg)))
    length = 1.4 * section_size(MACHINE)
    downward = np.diag([1.0, -1.0, -1.0])
    return [*solids, arrow("load", LOAD, downward, state.translation + np.array([0.0, 0.0, length]), length)]


def _window(pictures: list[list[Solid]]) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([bounds(solids, CAMERA) for solids in pictures])
    return corners[:, 0].min(axis=0) - 0.02, corners[:, 1].max(axis=0) + 0.02


class Film:
    """Frames of one size, whose pictures have the same windows [m]."""

    def __init__(self, loaded: tuple[np.ndarray, np.ndarray], branch: tuple[np.ndarray, np.ndarray]) -> None:
        self.windows = loaded, branch

    def frame(self, loaded: list[Solid], branches: spm.SolutionSet) -> Image.Image:
        """Draw one frame."""
        figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        self._picture(figure, loaded, 0, (8, 36, 432, 590))
        figure.text(220 / WIDTH, 0.945, "the physical state under 500 N", fontsize=15, color=INK, ha="center")
        bar = figure.colorbar(
            ScalarMappable(Normalize(-LARGEST, LARGEST), FORCES),
            cax=figure.add_axes((95 / WIDTH, 36 / HEIGHT, 250 / WIDTH, 10 / HEIGHT)),
            orientation="horizontal",
            ticks=[-LARGEST, 0.0, LARGEST],
        )
        bar.outline.set_visible(False)
        bar.ax.set_xticklabels([f"{LARGEST:g} N pull", "leg force", f"{LARGEST:g} N push"], fontsize=11, color=INK)
        bar.ax.tick_params(length=0)
        count = int(branches.count)
        title = f"all branches of the same pose: {count} of 8 real"
        figure.text(820 / WIDTH, 0.945, title, fontsize=15, color=INK, ha="center")
        ghost = [replace(s, colour=GREY) for s in loaded if s.name.startswith(BODIES)]
        physical = branches.is_physical
        for k, label in enumerate(branches.labels):
            real = bool(branches.exists[k])
            column, row = k // 2, k % 2
            left, bottom = 448 + 188 * column, 345 - 330 * row
            self._picture(figure, _solids(branches[k]) if real else ghost, 1, (left, bottom, 180, 280))
            name = label.replace("-", "\N{MINUS SIGN}") + (
                ", physical" if physical[k] else "" if real else ", not real"
            )
            colour = INK if real else PALE
            weight = "bold" if physical[k] else "normal"
            figure.text(
                (left + 90) / WIDTH,
                (bottom + 284) / HEIGHT,
                name,
                fontsize=12,
                color=colour,
                ha="center",
                weight=weight,
            )
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())

    def _picture(self, figure: Figure, solids: list[Solid], window: int, box: tuple[int, int, int, int]) -> None:
        """Render solids into the middle of a box (left, bottom, width, height) of pixels."""
        low, high = self.windows[window]
        left, bottom, width, height = box
        resolution = float(((np.array([width, height]) - 2.0) / (high - low)).min())
        image = render(solids, CAMERA, resolution, 1.0 if window == 0 else 0.7, (low, high)).image
        rows, columns = image.shape[:2]
        figure.figimage(image, left + (width - columns) // 2, bottom + (height - rows) // 2)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else FRAMES)
