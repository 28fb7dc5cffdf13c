"""All eighteen joints from six leg lengths and from a platform path, as CSV and as a ROS JointTrajectory.

Needs `pip install ".[plots]"`. Writes joints.csv, joints.json and a picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
chain = spm.ClosedChain.from_urdf()

# Six encoder readings, and the joint state that they give.
q = chain.forward_kinematics([1.20, 1.20, 1.40, 1.25, 1.20, 1.45])
print({name: round(float(value), 4) for name, value in zip(chain.joint_names, q, strict=True)})

# The next reading starts from the last one: a step or two of Newton's method.
q = chain.forward_kinematics([1.21, 1.20, 1.39, 1.25, 1.20, 1.46], near=q)
v = chain.state(q).joint_rates([0.01, 0.0, -0.01, 0.0, 0.0, 0.01])

# A path of the platform through poses, at 250 Hz.
lengths = [
    [1.20, 1.20, 1.40, 1.25, 1.20, 1.45],
    [1.25, 1.23, 1.40, 1.25, 1.22, 1.45],
    [1.22, 1.20, 1.42, 1.24, 1.18, 1.42],
]
poses = spm.forward_physical(chain.machine, lengths).pose
start = chain.inverse_kinematics(poses[0])
path = spm.PlatformPath([0.0, 1.0, 2.0], poses, ease=True)
trajectory = chain.joint_trajectory(path, np.linspace(0.0, 2.0, 501), near=start)
trajectory.to_csv(folder / "joints.csv")
trajectory.to_json(folder / "joints.json")
print(trajectory, f"loops open by {np.abs(chain.state(trajectory.positions).closure_gap()).max():.0e} m")

figure, (legs, passive) = plt.subplots(2, 1, figsize=(8, 6.6), sharex=True, layout="constrained", height_ratios=[1, 2])
change = trajectory.positions - trajectory.positions[0]
for ax, joints in ((legs, chain.leg_indices), (passive, np.setdiff1d(np.arange(18), chain.leg_indices))):
    for place, joint in enumerate(sorted(joints, key=chain.joint_names.__getitem__)):
        ax.plot(trajectory.times, change[:, joint], color=f"C{place % 6}", ls=["-", "--"][place // 6])
        ax.lines[-1].set_label(chain.joint_names[joint])
    ax.legend(fontsize=9, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
legs.set(ylabel="leg [m]", title="eighteen joints along a platform path, from their start")
passive.set(xlabel="time [s]", ylabel="passive joint [rad]")
figure.savefig(folder / "07_joint_trajectory.png", dpi=160)
