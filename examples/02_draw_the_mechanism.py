"""Draw the paper's example pose, its reasonable configuration beside all real ones. Needs "spm-pin[plots]"."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.display.plots import draw

path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs/images/mechanism.png"
pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
branches = spm.inverse_displacement(spm.Geometry.paper(), pose)

figure = Figure(figsize=(7, 4.9))
draw(branches.physical(), ax=figure.add_axes((0, 0, 0.44, 1)))
for k, i in enumerate(np.flatnonzero(branches.exists)):
    place = (0.45 + 0.185 * (k % 3), 0.505 - 0.5 * (k // 3), 0.18, 0.45)
    ax = draw(branches[i], ax=figure.add_axes(place), labels=False)
    ax.set_title(branches.labels[i] + ", physical" * bool(branches.is_physical[i]), fontsize=9, pad=2)
figure.savefig(path, dpi=200)
picture = Image.open(path).convert("RGB")
picture.quantize(method=Image.Quantize.MAXCOVERAGE, kmeans=4).save(path, optimize=True)  # a third of the size
