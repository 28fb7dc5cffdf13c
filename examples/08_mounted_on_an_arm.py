"""A small manipulator as the wrist of a UR5, in one Pinocchio model with its loops closed.

Needs `pip install ".[plots,robots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import example_robot_data
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import spm_pin as spm
from spm_pin.display import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
arm = example_robot_data.load("ur5")
wrist = spm.ClosedChain.from_urdf(machine=spm.Manipulator(0.06, 0.04, 0.05), prefix="spm_")
both = wrist.mounted_on(arm, "tool0", pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02])))
print(both)

home = wrist.leg_lengths(np.zeros(18))
q_wrist = wrist.forward_kinematics(home * [1.0, 1.05, 0.97, 1.02, 0.98, 1.04])
q = both.join([0.3, -1.2, 1.4, -0.6, 0.5, 0.2], q_wrist)
print(f"loops open by {np.abs(both.state(q).closure_gap()).max():.0e} m, wherever the arm is")

rest = np.zeros(both.model.nv)
load = [0.0, 0.0, -20.0, 0.0, 0.0, 0.0]  # on the terminal platform
forces = both.state(q, rest).inverse_dynamics(rest, load)
print("arm ", np.round(forces[:6], 2), "N m")
print("legs", np.round(forces[6:], 2), "N")
print(f"and nothing moves: {np.abs(both.state(q, rest).forward_dynamics(forces, load)).max():.0e}")

data = both.model.createData()
pin.forwardKinematics(both.model, data, q)
figure, (ax, near) = plt.subplots(1, 2, figsize=(8, 4.2), width_ratios=(3, 2), layout="constrained")
for joint in range(1, both.model.njoints):
    ends = np.array([data.oMi[both.model.parents[joint]].translation, data.oMi[joint].translation])
    of_wrist = both.model.names[joint].startswith("spm_")
    ax.plot(*ends[:, [0, 2]].T, color="C1" if of_wrist else "0.4", lw=1.5 if of_wrist else 5, solid_capstyle="round")
ax.plot([], color="0.4", lw=5, label="UR5")
ax.plot([], color="C1", label="3RPS-3SPR wrist")
ax.set(aspect="equal", xlabel="X [m]", ylabel="Z [m]")
ax.legend(frameon=False)
ax.set_title("the arm, from the side", fontsize=10)
draw(wrist.state(q_wrist).configuration(), ax=near, labels=False)
near.set_title("its wrist, with the force of each leg under 20 N", fontsize=10)
listed = (f"{leg[2:]}: {force:+.0f} N" for leg, force in zip(spm.machine.LEGS, forces[6:], strict=True))
near.text(0.5, -0.02, "   ".join(listed), transform=near.transAxes, ha="center", va="top", fontsize=7)
figure.savefig(folder / "08_mounted_on_an_arm.png", dpi=160)
