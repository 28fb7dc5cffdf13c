"""Calibrate a machine: choose the poses, measure them, identify its dimensions, and see what was gained.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
nominal = spm.Manipulator.paper()
random = np.random.default_rng(0)

# What tolerances of 0.1 mm and 0.1 mrad cost, and which of them matter.
table = {"direction": 1e-4, "pivot": 1e-4, "ball": 1e-4, "offset": 1e-4}
analysis = spm.calibration.tolerance(nominal, table, samples=100, rng=random)
print(analysis)
for name, share in analysis.ranking("component")[:4]:
    print(f"  {name}: {share:.0%} of the variance")

# Forty poses, chosen; measured with a laser tracker (10 µm, 10 µrad) on a machine nobody knows, encoders of 1 µm.
machine = nominal.perturbed(random, length=1e-4, angle=1e-4)
plan = spm.calibration.choose_poses(nominal, 40, rng=random)
poses = spm.forward_physical(machine, plan.readings).pose.as_matrix()
poses[:, :3, 3] += 1e-5 * random.standard_normal((40, 3))
poses[:, :3, :3] = Rotation.from_rotvec(1e-5 * random.standard_normal((40, 3))).as_matrix() @ poses[:, :3, :3]
readings = plan.readings + 1e-6 * random.standard_normal((40, 6))

found = spm.calibration.identify(nominal, poses, readings)
print(found)
found.machine.to_yaml(folder / "machine.yaml")

# Elsewhere in the workspace: the platform of the nominal machine and of the one identified, against the true one.
legs = random.uniform(nominal.limits.minimum, nominal.limits.maximum, (200, 6))
true = spm.forward_physical(machine, legs).translation
models = {"nominal": nominal, "identified": found.machine}
errors = {
    name: 1e6 * np.linalg.norm(spm.forward_physical(model, legs).translation - true, axis=-1)
    for name, model in models.items()
}
state = spm.forward_physical(found.machine, legs)
predicted = 1e6 * np.sqrt(np.trace(found.accuracy(state)[:, :3, :3], axis1=-2, axis2=-1))
for name, size in errors.items():
    print(f"position error of the {name} model at 200 other poses: {np.sqrt((size**2).mean()):.1f} µm RMS")

figure, (hist, cloud) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
bins = np.geomspace(1.0, 3000.0, 40)
for name, colour in (("nominal", "#d55e00"), ("identified", "#0072b2")):
    hist.hist(errors[name], bins, color=colour, alpha=0.85, label=f"model: {name}")
hist.set(xscale="log", xlabel="position error [µm]", ylabel="poses")
hist.legend(frameon=False)
cloud.plot(predicted, errors["identified"], ".", color="#0072b2")
most = 1.1 * max(predicted.max(), errors["identified"].max())
cloud.plot([0.0, most], [0.0, most], color="0.6", lw=0.8, label="error = prediction")
cloud.legend(frameon=False, loc="upper left")
cloud.set(xlabel="predicted RMS error [µm]", ylabel="error [µm]", xlim=(0.0, None), ylim=(0.0, None))
figure.savefig(folder / "11_calibration.png", dpi=160)
