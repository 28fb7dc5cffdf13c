"""Draw the paper's example pose: the physical branch beside all real ones.

Needs `pip install ".[plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import spm_pin as spm
from spm_pin.display import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
branches = spm.inverse_displacement(spm.Manipulator.paper(), pose)

figure = Figure(figsize=(7, 4.9))
draw(branches.physical(), ax=figure.add_axes((0, 0, 0.44, 1)))
for k, i in enumerate(np.flatnonzero(branches.exists)):
    corner = (0.45 + 0.185 * (k % 3), 0.505 - 0.5 * (k // 3), 0.18, 0.45)
    ax = draw(branches[i], ax=figure.add_axes(corner), labels=False)
    ax.set_title(branches.labels[i] + ", physical" * bool(branches.is_physical[i]), fontsize=9, pad=2)
figure.savefig(folder / "02_draw_the_mechanism.png", dpi=200)
