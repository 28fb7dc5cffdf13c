"""From measurements to the controller: calibrate a machine, export it as C, and follow a path with it.

Needs `pip install ".[plots,symbolic]"` and a C compiler. Writes its picture and what the commands write into the
given folder, or the current one.
"""

import subprocess
import sys
import sysconfig
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
sources = Path(__file__).parent / "controllers"
nominal = spm.Manipulator.paper()
random = np.random.default_rng(0)


def run(*command: object) -> str:
    """Run a program; return what it prints."""
    return subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True).stdout


def spm_pin(*arguments: object) -> str:
    """Run a command of the package."""
    return run(Path(sysconfig.get_path("scripts")) / "spm-pin", *arguments)


# Measure forty poses of a machine that nobody knows: laser tracker 10 µm and 10 µrad, encoders 1 µm.
machine = nominal.perturbed(random, length=1e-4, angle=1e-4)
readings = spm.calibration.choose_poses(nominal, 40, rng=random).leg_lengths
poses = spm.forward_physical(machine, readings)
position = poses.translation + 1e-5 * random.standard_normal((40, 3))
noise = Rotation.from_rotvec(1e-5 * random.standard_normal((40, 3)))
quaternion = (noise * Rotation.from_matrix(poses.rotation)).as_quat()
rows = np.hstack([position, quaternion, readings + 1e-6 * random.standard_normal((40, 6))])
header = "x,y,z,qx,qy,qz,qw,r_b1,r_b2,r_b3,r_c1,r_c2,r_c3"
np.savetxt(folder / "measurements.csv", rows, delimiter=",", header=header, comments="", fmt="%.9f")

# Calibrate, and export: the C once, and the numbers of three machines. The controller does not know the true one.
print(spm_pin("calibrate", folder / "measurements.csv", "--out", folder / "machine.yaml").split("Differences")[0])
machine.to_yaml(folder / "true.yaml")
spm_pin("export", "c", "--out", folder / "nominal")
for name in ("machine", "true"):
    spm_pin("export", "c", "--machine", folder / f"{name}.yaml", "--out", folder / name)
program, c = folder / "follow_path", folder / "nominal"
inputs = sources / "follow_path.c", c / "spm_kinematics.c"
run("cc", "-std=c99", "-O2", "-I", c, *inputs, "-lm", "-o", program)

# Ten thousand ticks along a closed path of 4 cm and 2°, on the nominal and on the identified model.
start = spm.forward_physical(nominal, [1.2, 1.3, 1.4, 1.2, 1.3, 1.4])
phase = np.linspace(0.0, 2.0 * np.pi, 10_000)[:, None]
position = start.translation + 0.02 * np.sin(phase * [1, 2, 3])
rotation = Rotation.from_rotvec(np.deg2rad(1.0) * np.sin(phase * [3, 1, 2])) * Rotation.from_matrix(start.rotation)
np.savetxt(folder / "poses.txt", np.hstack([rotation.as_matrix().reshape(-1, 9), position]), fmt="%.17g")
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for label, model, colour in (("before", "nominal", "#d55e00"), ("after", "machine", "#0072b2")):
    machines = (folder / name / "spm_machine.txt" for name in (model, "true"))
    errors = 1e6 * np.array(run(program, *machines, folder / "poses.txt").split(), dtype=float)
    print(
        f"platform error {label} calibration, {len(errors)} ticks: {np.sqrt((errors**2).mean()):.1f} µm RMS, "
        f"{errors.max():.1f} µm at most"
    )
    axes.plot(errors, color=colour, label=f"{label} calibration")
axes.set(yscale="log", xlabel="tick", ylabel="error of the platform [µm]")
axes.legend(frameon=False)
figure.savefig(folder / "14_calibrated_controller.png", dpi=160)
