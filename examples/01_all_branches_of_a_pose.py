"""All branches of a pose, and what each asks of the legs.

Needs: spm-pin.
"""

import numpy as np

import spm_pin as spm

geometry = spm.Geometry.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
branches = spm.inverse_displacement(geometry, pose)

print(branches)
for label in branches.labels:
    branch = branches[label]
    if branch.exists:
        print(label, np.round(branch.leg_lengths, 4), "m, gap", f"{branch.closure_residual:.0e} m")

machine = branches.physical()
print("A real machine:", machine)
print("500 N down on the platform:", np.round(spm.leg_forces(machine, [0, 0, -500, 0, 0, 0]), 1), "N in the legs")
