"""Draw the moving picture of the page on a ball in simulation: `python docs/site/balancing_picture.py`.

Needs `pip install ".[plots,gym]"`, and without a screen EGL, or OSMesa by MUJOCO_GL=osmesa. A controller rolls
the ball along a circle.
"""

from __future__ import annotations

import os

os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported

import mujoco
import numpy as np
from figures import IMAGES
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.gym import BallBalancer

SETTLING, PERIOD, RADIUS = 160, 80, 0.065  # steps of 20 ms until the ball is on the circle, and of a round; [m]
EVERY = 2  # steps of a picture
WIDTH, HEIGHT, DPI = 900, 440, 100
SIDE = 490  # pixels of MuJoCo's picture, in width
ORANGE, INK, PALE = "#d55e00", "#20262d", "#c9ced4"


def main() -> None:
    """Draw one round of the ball as a WebP that repeats."""
    balancer = BallBalancer()
    observation, _ = balancer.reset(seed=4)
    renderer = mujoco.Renderer(balancer.model, HEIGHT, SIDE)
    pictures, places = [], []
    for step in range(SETTLING + PERIOD):
        angle = 2.0 * np.pi * (step - SETTLING) / PERIOD
        observation, *_ = balancer.step(control(balancer, observation, angle))
        if step >= SETTLING:
            places.append(1e3 * observation[:2])
            if (step - SETTLING) % EVERY == 0:
                pictures.append(frame(picture(balancer, renderer), places, angle))
    path = IMAGES / "balancing.webp"
    first, *others = pictures
    first.save(path, save_all=True, append_images=others, duration=20 * EVERY, loop=0, quality=72, method=4)
    print(f"{path.name}: {path.stat().st_size // 1024} kB, {len(pictures)} frames")


def control(balancer: BallBalancer, observation: np.ndarray, angle: float) -> np.ndarray:
    """Return the action that leads the ball to the point of the circle at an angle."""
    rate, around = 2.0 * np.pi / (0.02 * PERIOD), np.array([np.cos(angle), np.sin(angle)])
    place, velocity = RADIUS * around, RADIUS * rate * np.array([-around[1], around[0]])
    # The slope that rolls a solid ball along the circle, and against what it is off.
    slope = -7.0 / 5.0 / 9.81 * rate**2 * place - 4.0 * (observation[:2] - place) - 1.2 * (observation[2:4] - velocity)
    slope *= min(1.0, 0.2 / np.linalg.norm(slope))
    normal = [*slope, np.sqrt(1.0 - slope @ slope)]
    return balancer.action(spm.inverse_physical(balancer.stage, 0.12, normal=normal).readings)


def picture(balancer: BallBalancer, renderer: mujoco.Renderer) -> np.ndarray:
    """Return MuJoCo's picture, its black background white."""
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (0.0, 0.0, 0.085), 0.44, 120.0, -22.0
    seen = mujoco.MjvOption()
    seen.sitegroup[:] = 0
    renderer.update_scene(balancer.data, camera, seen)
    image = renderer.render().copy()
    image[(image == 0).all(axis=-1)] = 255
    return image


def frame(image: np.ndarray, places: list[np.ndarray], angle: float) -> Image.Image:
    """Return a picture of the machine beside the plate from above, with the ball's way."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    figure.figimage(image, 0, 0)
    ax = figure.add_axes((SIDE / WIDTH + 0.08, 0.13, 0.36, 0.74))
    around = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(135.0 * np.cos(around), 135.0 * np.sin(around), color=PALE)
    ax.plot(1e3 * RADIUS * np.cos(around), 1e3 * RADIUS * np.sin(around), color=PALE, ls="--")
    ax.plot(*np.transpose(places), color=ORANGE, lw=1.5)
    ax.plot(*places[-1], "o", color=ORANGE, ms=14)
    ax.plot(1e3 * RADIUS * np.cos(angle), 1e3 * RADIUS * np.sin(angle), "+", color=INK, ms=9)
    ax.set(aspect="equal", xlim=(-140, 140), ylim=(-140, 140), xlabel="x and y on the plate [mm]")
    ax.set_title("the ball, and where it is wanted", fontsize=11, color=INK)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


if __name__ == "__main__":
    main()
