"""Follow the machine along a path of leg lengths, and see what it meets.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
machine = spm.Manipulator.paper()
legs = np.array(
    [[1.20, 1.20, 1.40, 1.25, 1.20, 1.45], [1.45, 1.15, 1.30, 1.20, 1.50, 1.35], [1.10, 1.35, 1.60, 1.30, 1.40, 1.20]]
)
path = spm.follow(machine, legs)

print(f"{len(path.parameters)} steps in mode {path.labels[0]}, to the end: {path.complete}")
for event in path.events:
    print(f"at {event.parameter:.9f}: {event.kind}, {event.detail}")

figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
ax.semilogy(path.parameters, spm.singularities(path.configurations).sigma[:, 2], "k")
for event in path.events:
    singular = event.kind is spm.kinematics.EventKind.INVERSE_SINGULARITY
    ax.axvline(event.parameter, color="C3" if singular else "C1", ls="-" if singular else ":", label=str(event.kind))
handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
ax.legend(handles.values(), handles.keys(), frameon=False)
ax.set(xlabel="parameter of the path", ylabel="smallest singular value of K")
figure.savefig(folder / "04_follow_a_path.png", dpi=160)
