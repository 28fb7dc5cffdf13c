"""Pick, pass a state above what is in the way, place: planned, then timed with and without the load.

Needs `pip install ".[motion,plots]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm
from spm_pin.motion import Payload

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
chain = spm.ClosedChain.from_urdf()
geometry, limits = chain.geometry, spm.LegLimits(1.1, 1.5)

rest = [1.30, 1.30, 1.30, 1.30, 1.30, 1.30]
pick = [1.45, 1.20, 1.25, 1.45, 1.15, 1.30]
over = [1.50, 1.45, 1.35, 1.50, 1.48, 1.40]
place = [1.20, 1.50, 1.25, 1.20, 1.45, 1.30]

# In these limits no state is forward singular: proved once, then true of every path.
certificate = spm.certify(geometry, limits)
legs = {"leg_forces": 1500.0, "leg_rates": 0.6}
load = Payload(20.0, centre=(0.0, 0.0, 0.15))

parts = [
    ("to the pick", spm.plan(geometry, rest, pick, limits, certificate=certificate), None),
    ("over, with 20 kg", spm.plan(geometry, pick, place, limits, via=[over], certificate=certificate), load),
    ("back", spm.plan(geometry, place, rest, limits, certificate=certificate), None),
]
figure, axes = plt.subplots(3, 1, figsize=(8.6, 7.2), sharex=True, layout="constrained")
colours = ["#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7"]
begin = 0.0
for name, plan, payload in parts:
    motion = spm.time_optimal(chain, plan, payload=payload, **legs)
    print(f"{name}: {plan}, {motion.times[-1]:.3f} s")
    columns = chain.leg_indices
    rows = chain.leg_lengths(motion.positions), motion.velocities[:, columns], motion.efforts[:, columns]
    for ax, values in zip(axes, rows, strict=True):
        for leg, column in enumerate(values.T):
            ax.plot(begin + motion.times, column, color=colours[leg], ls="-" if leg < 3 else "--", lw=1.4)
    axes[0].text(begin + motion.times[-1] / 2.0, 1.53, f"{name}, {motion.times[-1]:.2f} s", ha="center", fontsize=9)
    begin += float(motion.times[-1])
    for ax in axes:
        ax.axvline(begin, color="0.8", lw=0.8)
for ax, label in zip(axes, ("leg [m]", "rate [m/s]", "force [N]"), strict=True):
    ax.set_ylabel(label)
axes[0].set_ylim(top=1.57)
for sign in (1.0, -1.0):
    axes[1].axhline(sign * legs["leg_rates"], color="0.5", ls=":")
    axes[2].axhline(sign * legs["leg_forces"], color="0.5", ls=":")
names = ["r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3"]
figure.legend(axes[0].lines[:6], names, loc="outside upper center", ncols=6, frameon=False, fontsize=9)
axes[2].set_xlabel("time [s]")
figure.align_ylabels(axes)
figure.savefig(folder / "12_pick_and_place.png", dpi=160)

stiff = spm.stiffness(spm.forward_physical(geometry, place), legs=2e7)
frequencies = chain.natural_frequencies(chain.forward_kinematics(place), stiff).frequencies
print("vibrations at the place, legs of 20 N/µm:", np.round(frequencies), "Hz")
