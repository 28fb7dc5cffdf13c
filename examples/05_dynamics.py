"""Leg forces along a motion of the platform, and a free fall that keeps its energy.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
chain = spm.ClosedChain.from_urdf()
lengths = [
    [1.20, 1.20, 1.40, 1.25, 1.20, 1.45],
    [1.25, 1.23, 1.40, 1.25, 1.22, 1.45],
    [1.22, 1.20, 1.42, 1.24, 1.18, 1.42],
]
poses = spm.forward_physical(chain.machine, lengths).pose
q0 = chain.inverse_kinematics(poses[0])

# Inverse dynamics: all joints of the path, and what the actuators give.
times = np.linspace(0.0, 2.0, 201)
motion = chain.joint_trajectory(spm.PlatformPath([0.0, 1.0, 2.0], poses, ease=True), times, q0)
efforts = motion.efforts[:, chain.leg_indices]
print("at rest    ", np.round(efforts[0], 1), "N")
print("on its way ", np.round(efforts[100], 1), "N")

# Forward dynamics: let the legs fall from there.
fall = chain.simulate(q0, np.zeros(18), None, np.linspace(0.0, 0.3, 31))
print(fall)
print(
    f"fallen by {fall.potential[0] - fall.potential[-1]:.0f} J, of which {np.abs(fall.energy_error).max():.0e} J lost"
)
print(f"loops open by {fall.closure_gap.max():.0e} m")

figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
for leg, name in enumerate(spm.machine.LEGS):
    ax.plot(times, efforts[:, leg], ["-", "--", ":"][leg % 3], color="C0" if leg < 3 else "C1", label=name)
ax.set(xlabel="time [s]", ylabel="leg force [N]", title="forces of the legs along a motion")
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
figure.savefig(folder / "05_dynamics.png", dpi=160)
