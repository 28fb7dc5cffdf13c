"""A batch of environments: reset to assembled states by `spm.arrays`, then stepped in MuJoCo.

Needs `pip install ".[arrays,engines,plots]"`. Writes a picture into the given folder, or into the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import mujoco.rollout
import numpy as np

import spm_pin as spm
from spm_pin import arrays

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
machine = spm.Manipulator.paper()
environments, steps = 64, 200
model = mujoco.MjModel.from_xml_string(spm.description.mjcf_text(machine, collisions="none"))

# Random leg lengths within the limits; all eighteen joints follow.
rng = np.random.default_rng(0)
lengths = rng.uniform(machine.limits.minimum, machine.limits.maximum, (environments, 6))
states = arrays.forward_physical(machine, lengths)
order = [arrays.JOINTS.index(model.joint(k).name) for k in range(model.njnt)]
q = arrays.joint_values(machine, states)[:, order]

# The loops at reset: MuJoCo's own errors of its equality constraints.
data, gaps = mujoco.MjData(model), []
start = np.zeros((environments, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
for row, values in zip(start, q, strict=True):
    data.qpos[:] = values
    mujoco.mj_forward(model, data)
    mujoco.mj_getState(model, data, row, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    gaps.append(np.abs(data.efc_pos[: data.ne]).max())
print(f"the loops of {environments} environments are closed to {max(gaps):.0e} m at reset")
assert max(gaps) < 1e-6

# Random pushes of the legs, constant in each environment, stepped all at once.
control = np.tile(rng.uniform(-100.0, 100.0, (environments, 1, model.nu)), (1, steps, 1))
threads = [mujoco.MjData(model) for _ in range(2)]
history, _ = mujoco.rollout.rollout(model, threads, start, control)
slides = [1 + model.joint(f"leg_{leg}_slide").qposadr[0] for leg in ("b1", "b2", "b3", "c1", "c2", "c3")]  # after time
print(
    f"{environments * steps} steps; slides from {history[..., slides].min():.3f} to {history[..., slides].max():.3f} m"
)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
axes[0].semilogy(np.sort(gaps), ".")
axes[0].set(xlabel="environment", ylabel="largest loop error at reset [m]", ylim=(1e-17, 1e-5))
axes[0].axhline(1e-6, color="0.6", lw=0.8, ls="--")
axes[1].plot(history[:, :, 0].T, history[:, :, slides[0]].T, lw=0.6)
axes[1].set(xlabel="time [s]", ylabel="slide of leg r_b1 [m]")
figure.savefig(folder / "15_environments_in_mujoco.png", dpi=160)
