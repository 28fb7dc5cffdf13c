"""A map of the conditioning over leg lengths, written chunk by chunk: stopped or killed, the same call goes on.

Needs `pip install ".[cluster,plots]"`. Writes map.zarr and its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import spm_pin as spm

if __name__ == "__main__":  # worker processes import this file
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    legs = (1.10, 1.50, 101)
    grid = spm.sweeps.leg_grid(lower=[legs, legs, 1.30], upper=[1.25, 1.20, 1.40])
    found = spm.sweeps.run_sweep(
        spm.Manipulator.paper(), grid, ["conditioning", "det_structure"], folder / "map.zarr", workers=1
    )

    found = found.load()  # small enough for memory; Dask's arrays otherwise
    best = found.isel(found.conditioning.argmax(...))
    print(f"{found.conditioning.size} sets of leg lengths, {int(found.conditioning.notnull().sum())} of them assembled")
    print(f"best conditioned at r_b1 = {best.r_b1:.3f} m, r_b2 = {best.r_b2:.3f} m: {best.conditioning:.4f}")
    print(f"det K is positive in {(found.det_structure > 0).mean():.0%} of the map: a singular curve divides it")

    figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    values = found.transpose("r_b2", "r_b1")
    image = ax.pcolormesh(values.r_b1, values.r_b2, values.conditioning, cmap="cividis")
    ax.contour(values.r_b1, values.r_b2, values.det_structure, levels=[0.0], colors="white")
    ax.plot([], color="0.6", label="det K = 0")
    ax.legend(loc="lower left", framealpha=0.9)
    ax.set(xlabel="r_b1 [m]", ylabel="r_b2 [m]")
    figure.colorbar(image, ax=ax, label="conditioning of J_f")
    figure.savefig(folder / "10_sweep.png", dpi=160)
