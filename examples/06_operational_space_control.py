"""Hold the platform against a push, and bring it elsewhere: control in task space, at 1 kHz.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
chain = spm.ClosedChain.from_urdf()
poses = spm.pose(
    [[0.6889, 0.4963, 2.253], [0.69, 0.485, 2.27]], xyx=np.deg2rad([[-11.08, 32.97, -12.88], [-11.5, 33.2, -12.4]])
)
path = spm.PlatformPath([0.0, 0.4], poses, ease=True)


def controller(stiffness, damping):
    """Leg forces for Λ (ẗ_d + damping ė + stiffness e) + C t + G, at the twist t."""

    def forces(t, q, v):
        wanted = path(min(t, path.duration))
        state.update(q, v)
        here = state.configuration()
        twist = np.linalg.solve(state.inverse_jacobian(), v[chain.leg_indices])
        turn = Rotation.from_matrix(wanted.pose.rotation.as_matrix() @ here.rotation.T).as_rotvec()
        error = np.concatenate([wanted.pose.translation - here.translation, turn])
        platform = state.platform_dynamics()
        change = wanted.acceleration + damping * (wanted.twist - twist) + stiffness * error
        wrench = platform.mass @ change + platform.bias + platform.gravity
        # J_fᵀ f = wrench, as the legs hold the opposite of a load.
        return state.leg_forces(-wrench)

    return forces


q0 = chain.joint_values(spm.inverse_displacement(chain.machine, poses[0]).physical())
state = chain.state(q0)  # what one call about q and v computes, the next one finds
times = np.linspace(0.0, 0.6, 25)
off = {}
# With 400 1/s² and 40 1/s the error decays like a critically damped oscillator.
for name, gains in (("feed-forward alone", (0.0, 0.0)), ("with feedback", (400.0, 40.0))):
    run = chain.simulate(q0, np.zeros(18), controller(*gains), times, wrench=[30.0, 0, 0, 0, 0, 0], period=1e-3)
    wanted = path(np.minimum(run.times, path.duration)).pose.translation
    off[name] = 1e3 * np.linalg.norm(chain.state(run.q).configuration().translation - wanted, axis=-1)
    print(f"{name}: {off[name][-1]:.2f} mm from where it should be after {run.times[-1]:.1f} s")
print("the push is held off by the stiffness alone: no integral term")
print(run, f"energy known to {np.abs(run.energy_error).max():.0e} J")

figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
for (name, distances), colour in zip(off.items(), ("#d55e00", "#0072b2"), strict=True):
    ax.plot(times[: len(distances)], distances, "o-", ms=3, color=colour, label=name)
ax.axvspan(0.0, path.duration, color="0.93", label="the platform moves")
ax.set(xlabel="time [s]", ylabel="distance of o from its path [mm]", xlim=(0.0, times[-1]), ylim=(0.0, None))
ax.set_title("a push of 30 N on a moving platform", fontsize=10)
ax.legend(frameon=False)
figure.savefig(folder / "06_operational_space_control.png", dpi=160)
