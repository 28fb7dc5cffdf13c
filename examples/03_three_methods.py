"""The same Jacobian from the closed form, from the paper's 9 x 9, and from Pinocchio's constraints.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm
from spm_pin.paper import jacobian

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
geometry = spm.Geometry.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
branches = spm.inverse_displacement(geometry, pose)
chain = spm.ClosedChain.from_urdf()

real = [label for label in branches.labels if branches[label].exists]
off = {"paper's 9 × 9": [], "Pinocchio": []}
for label in real:
    state = branches[label]
    closed_form = spm.inverse_jacobian(state)
    q = chain.joint_values(state)
    size = np.abs(closed_form).max()
    off["paper's 9 × 9"].append(np.abs(jacobian.J_f(state) - closed_form).max() / size)
    off["Pinocchio"].append(np.abs(chain.inverse_jacobian(q) - closed_form).max() / size)
    gap = np.abs(chain.closure_gap(q)).max()
    print(f"{label}: largest entry {size:8.1f}, loops open by {gap:.0e} m", end="")
    print("".join(f", {method} off by {values[-1]:.0e}" for method, values in off.items()))

figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
for method, values in off.items():
    ax.semilogy(real, values, "o", label=method)
ax.set(xlabel="branch", ylabel="largest difference, relative", ylim=(1e-17, 1e-11))
ax.set_title("J_f by two other methods, against the closed form")
ax.legend(frameon=False)
figure.savefig(folder / "03_three_methods.png", dpi=160)
