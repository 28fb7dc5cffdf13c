"""All branches of a pose, and the leg lengths of each.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
machine = spm.Manipulator.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
branches = spm.inverse_displacement(machine, pose)

print(branches)
real = [label for label in branches.labels if branches[label].exists]
for label in real:
    branch = branches[label]
    print(label, np.round(branch.leg_lengths, 4), "m, gap", f"{branch.closure_residual:.0e} m")

state = branches.physical()
print("The physical branch:", state)
print("500 N down on the platform:", np.round(spm.leg_forces(state, [0, 0, -500, 0, 0, 0]), 1), "N in the legs")

figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
ax.axhspan(1.10, 1.50, color="0.9", label="limits")
for leg, name in enumerate(spm.machine.LEGS):
    lengths = [branches[label].leg_lengths[leg] for label in real]
    ax.plot(real, lengths, "osv"[leg % 3], color="C0" if leg < 3 else "C1", label=name)
ax.set(xlabel="branch", ylabel="leg length [m]", title="six real branches of one pose")
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
figure.savefig(folder / "01_all_branches_of_a_pose.png", dpi=160)
