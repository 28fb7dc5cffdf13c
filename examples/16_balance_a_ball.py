"""Balance a ball on three servos: a PD controller on the Gymnasium environment, from twenty random starts.

Needs `pip install ".[gym,plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import gymnasium
import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
env = gymnasium.make("spm_pin.gym:spm_pin/BallBalancer-v0", max_episode_steps=250)  # 5 s
balancer = env.unwrapped
HEIGHT, STIFFNESS, DAMPING, STEEPEST = 0.12, 3.0, 1.0, 0.2  # [m], slope per m and per m/s, sine of the largest tilt
SEEN = np.array([1e-3, 1e-3, 2e-2, 2e-2])  # standard deviations of what a camera sees [m, m/s]


def controller(ball):
    """Lean against the ball's place and velocity: where the plate is to be, in closed form, and so the servos."""
    slope = -STIFFNESS * ball[:2] - DAMPING * ball[2:]
    slope *= min(1.0, STEEPEST / np.linalg.norm(slope))
    normal = [*slope, np.sqrt(1.0 - slope @ slope)]
    return balancer.action(spm.inverse_physical(balancer.stage, HEIGHT, normal=normal).readings)


seeds, paths = range(20), []
for seed in seeds:
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    path, is_over = [observation[:2]], False
    while not is_over:
        observation, _, terminated, truncated, _ = env.step(controller(observation[:4] + SEEN * rng.standard_normal(4)))
        path.append(observation[:2])
        is_over = terminated or truncated
    paths.append(np.array(path))

held = [path for path in paths if len(path) == 251]
distances = 1e3 * np.linalg.norm(held, axis=-1)
print(f"{len(held)} of {len(paths)} balls stay on the plate for five seconds")
print(f"from {distances[:, 0].max():.0f} mm at the most, within {distances[:, 100:].max():.1f} mm after two seconds")
assert len(held) == len(paths)
assert distances[:, 100:].max() < 10.0

figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", width_ratios=(1.6, 1))
axes[0].plot(np.arange(251) / 50.0, distances.T, lw=0.7)
axes[0].set(xlabel="time [s]", ylabel="distance from the middle [mm]", xlim=(0, 5), ylim=(0, None))
for path in paths:
    axes[1].plot(*(1e3 * path.T), lw=0.7)
axes[1].add_patch(plt.Circle((0, 0), 1e3 * balancer.ball.plate(balancer.stage)[0], fill=False, color="0.6"))
axes[1].set(xlabel="x on the plate [mm]", ylabel="y [mm]", aspect="equal")
axes[1].autoscale_view()
figure.savefig(folder / "16_balance_a_ball.png", dpi=160)
