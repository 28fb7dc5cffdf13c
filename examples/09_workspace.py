"""The paper's workspace as a closed surface, its volume, and what lies outside it.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import numpy as np

import spm_pin as spm
from spm_pin.display import shell_figure

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
machine = spm.Manipulator.paper()
shell = spm.crosscheck.workspace_shell(machine, resolution=20)
print(f"{len(shell.patches)} surfaces, closed: {shell.mesh.is_watertight}, V - E + F = {shell.euler_characteristic}")
print(f"volume {shell.volume:.6f} m³, to {shell.volume_error:.0e} m³")

legs = np.random.default_rng(0).uniform(1.10, 1.50, (20_000, 6))
positions = spm.forward_physical(machine, legs).translation
outside = ~shell.contains(positions)
print(f"{outside.mean():.2%} of random leg lengths lead outside: Table 6 is not the whole boundary")
print(f"the lowest of them at z = {positions[outside, 2].min():.3f} m")

shell_figure(shell, dpi=130).savefig(folder / "09_workspace.png", dpi=130)
