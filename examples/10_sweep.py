"""A map of the conditioning over leg lengths, written chunk by chunk: stopped or killed, the same call goes on.

Needs: "spm-pin[cluster]".
"""

import spm_pin as spm

if __name__ == "__main__":  # worker processes import this file
    legs = (1.10, 1.50, 101)
    grid = spm.sweeps.leg_grid(lower=[legs, legs, 1.30], upper=[1.25, 1.20, 1.40])
    found = spm.sweeps.run(spm.Geometry.paper(), grid, ["conditioning", "det_structure"], "map.zarr", workers=1)

    found = found.load()  # small enough for memory; Dask's arrays otherwise
    best = found.isel(found.conditioning.argmax(...))
    print(f"{found.conditioning.size} sets of leg lengths, {int(found.conditioning.notnull().sum())} of them assembled")
    print(f"best conditioned at r_b1 = {best.r_b1:.3f} m, r_b2 = {best.r_b2:.3f} m: {best.conditioning:.4f}")
    print(f"det K is positive in {(found.det_structure > 0).mean():.0%} of the map: a singular curve divides it")
