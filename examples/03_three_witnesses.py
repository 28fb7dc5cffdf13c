"""The same rates and forces from the closed form, from the paper's 9 x 9, and from Pinocchio's constraints.

Needs: spm-pin.
"""

import numpy as np

import spm_pin as spm
from spm_pin.paper import jacobian

geometry = spm.Geometry.paper()
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
chain = spm.ClosedChain.from_urdf()

for state in spm.inverse_displacement(geometry, pose):
    closed_form = spm.inverse_jacobian(state)
    q = chain.joint_values(state)
    paper, pinocchio = jacobian.J_f(state), chain.inverse_jacobian(q)
    size = np.abs(closed_form).max()
    print(
        f"largest entry {size:8.1f}, paper off by {np.abs(paper - closed_form).max() / size:.0e}, "
        f"Pinocchio by {np.abs(pinocchio - closed_form).max() / size:.0e}, "
        f"loops open by {np.abs(chain.closure_gap(q)).max():.0e} m"
    )
