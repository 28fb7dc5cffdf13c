"""All eighteen joints from six leg lengths and from a platform path, as CSV and as a ROS JointTrajectory.

Needs: spm-pin.
"""

import numpy as np

import spm_pin as spm

chain = spm.ClosedChain.from_urdf()

# What a robot's encoders say, and the joint state that shows it.
q = chain.forward_kinematics([1.20, 1.20, 1.40, 1.25, 1.20, 1.45])
print({name: round(float(value), 4) for name, value in zip(chain.joint_names, q, strict=True)})

# The next reading starts from the last one: a step or two of Newton's method.
q = chain.forward_kinematics([1.21, 1.20, 1.39, 1.25, 1.20, 1.46], near=q)
v = chain.joint_rates(q, [0.01, 0.0, -0.01, 0.0, 0.0, 0.01])

# A path of the platform through poses, at 250 Hz.
poses = spm.pose(
    [[0.6889, 0.4963, 2.253], [0.70, 0.48, 2.28], [0.68, 0.50, 2.28]],
    xyx=np.deg2rad([[-11.08, 32.97, -12.88], [-12.0, 33.5, -12.0], [-11.0, 33.0, -13.0]]),
)
start = chain.joint_values(spm.inverse_displacement(chain.geometry, poses[0]).physical())
path = spm.PlatformPath([0.0, 1.0, 2.0], poses, ease=True)
trajectory = chain.joint_trajectory(path, np.linspace(0.0, 2.0, 501), near=start)
trajectory.to_csv("joints.csv")
trajectory.to_json("joints.json")
print(trajectory, f"loops open by {np.abs(chain.closure_gap(trajectory.positions)).max():.0e} m")
