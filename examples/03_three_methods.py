"""The same Jacobian from the closed form, from the paper's 9 x 9, and from Pinocchio's constraints.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm
from spm_pin.crosscheck.paper import jacobian

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
machine = spm.Manipulator.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
branches = spm.inverse_displacement(machine, pose)
chain = spm.ClosedChain.from_urdf()

real = [label for label in branches.labels if branches[label].exists]
off = {"paper's 9 × 9": [], "Pinocchio": []}
for label in real:
    state = branches[label]
    closed_form = spm.inverse_jacobian(state)
    q = chain.joint_values(state)
    size = np.abs(closed_form).max()
    off["paper's 9 × 9"].append(np.abs(jacobian.J_f(state) - closed_form).max() / size)
    off["Pinocchio"].append(np.abs(chain.state(q).inverse_jacobian() - closed_form).max() / size)
    gap = np.abs(chain.state(q).closure_gap()).max()
    print(f"{label}: largest entry {size:8.1f}, loops open by {gap:.0e} m", end="")
    print("".join(f", {method} off by {values[-1]:.0e}" for method, values in off.items()))

# At random states the methods differ by rounding, and by nothing else: more only as the Jacobian is worse conditioned.
states = spm.forward_physical(machine, np.random.default_rng(0).uniform(1.1, 1.5, (300, 6)))
closed_form = spm.inverse_jacobian(states)
size = np.abs(closed_form).max(axis=(1, 2))
others = {
    "paper's 9 × 9": np.array([jacobian.J_f(state) for state in states]),
    "Pinocchio": np.array([chain.state(chain.joint_values(state)).inverse_jacobian() for state in states]),
}
condition = np.linalg.cond(closed_form)
figure, ax = plt.subplots(figsize=(6, 3.4), layout="constrained")
for (method, values), colour in zip(others.items(), ("#d55e00", "#0072b2"), strict=True):
    differences = np.maximum(np.abs(values - closed_form).max(axis=(1, 2)) / size, 1e-17)
    ax.loglog(condition, differences, ".", ms=4, color=colour, label=method)
ends = np.array([condition.min(), condition.max()])
ax.loglog(ends, np.finfo(float).eps * ends, color="0.4", lw=1, label="rounding × condition number")
ax.set(xlabel="condition number of the Jacobian", ylabel="difference from the closed form")
ax.set_title("three methods without common code, 300 states", fontsize=10)
ax.legend(frameon=False)
figure.savefig(folder / "03_three_methods.png", dpi=160)
