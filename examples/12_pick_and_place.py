"""Pick and place with a load: where the platform cannot go straight, the legs lead it around, fast and smoothly.

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
machine, limits = chain.machine, spm.LegLimits(1.1, 1.5)

rest = spm.forward_physical(machine, [1.30, 1.30, 1.30, 1.30, 1.30, 1.30])
pick = spm.forward_physical(machine, [1.46, 1.16, 1.27, 1.32, 1.14, 1.47])
place = spm.forward_physical(machine, [1.23, 1.20, 1.15, 1.26, 1.21, 1.34])

# In these limits no state is forward singular: proved once, then true of every path.
certificate = spm.certify(machine, limits)
largest = {"leg_forces": 1500.0, "leg_rates": 0.6}
moves = [
    ("to the pick", rest, pick, None),
    ("with 20 kg", pick, place, Payload(20.0, centre=(0.0, 0.0, 0.15))),
    ("back", place, rest, None),
]

panels = ["leg [m]", "rate [m/s]", "force [N]"]
figure, axes = plt.subplot_mosaic(
    [[left, right] for left, right in zip(["way"] * 3 + ["straight"] * 3, np.repeat(panels, 2), strict=True)],
    figsize=(11.0, 6.8),
    width_ratios=(1.0, 1.5),
    layout="constrained",
)
colours = ["#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7"]
begin = 0.0
for name, start, goal, payload in moves:
    straight = spm.plan(machine, start, goal, limits, line="poses")
    plan = spm.plan(machine, start, goal, limits, certificate=certificate)
    fastest = spm.time_optimal(chain, plan, payload=payload, **largest)
    motion = spm.time_optimal(chain, plan, payload=payload, leg_jerks=60.0, **largest)
    seconds = f"{motion.times[-1]:.2f} s, {fastest.times[-1]:.2f} s if forces may jump"
    print(f"{name}: {plan}, {seconds}\n    the platform straight: {straight.reason}")
    columns = chain.leg_indices
    rows = chain.leg_lengths(motion.positions), motion.velocities[:, columns], motion.efforts[:, columns]
    for label, values in zip(panels, rows, strict=True):
        for leg, column in enumerate(values.T):
            axes[label].plot(begin + motion.times, column, color=colours[leg], ls="-" if leg < 3 else "--", lw=1.4)
        axes[label].set_ylabel(label)
        axes[label].axvline(begin + motion.times[-1], color="0.8", lw=0.8)
    middle = begin + motion.times[-1] / 2.0
    axes["leg [m]"].text(middle, 1.53, f"{name}, {motion.times[-1]:.2f} s", ha="center", fontsize=9)
    begin += float(motion.times[-1])
    o = plan.configurations().translation
    axes["way"].plot(o[:, 1], o[:, 2], color="black" if payload else "0.6", lw=2.0, label=name)

# What a straight line of the platform from the pick to the place would need.
share = np.linspace(0.0, 1.0, 200)
ends = spm.pose([pick.translation, place.translation], rotation=[pick.rotation, place.rotation])
line = spm.inverse_physical(machine, spm.PlatformPath([0.0, 1.0], ends)(share).pose)
outside = ~limits.contains(line.readings)
y, z = line.translation[:, 1], line.translation[:, 2]
axes["way"].plot(y, z, color="#c00000", ls=":", lw=1.6)
axes["way"].plot(np.where(outside, y, np.nan), z, color="#c00000", lw=1.6, label="straight, legs beyond their limits")
axes["way"].plot(*np.array([s.translation[1:] for s in (rest, pick, place)]).T, "ko", ms=5)
for s, text in ((rest, "rest"), (pick, "pick"), (place, "place")):
    axes["way"].annotate(text, s.translation[1:], xytext=(6, 6), textcoords="offset points", fontsize=9)
axes["way"].set(xlabel="y of o [m]", ylabel="z of o [m]", xlim=(-0.05, 0.95), ylim=(2.18, 2.62))
axes["way"].legend(fontsize=8, frameon=False, loc="lower left")
for leg, column in enumerate(line.readings.T):
    axes["straight"].plot(share, column, color=colours[leg], ls="-" if leg < 3 else "--", lw=1.4)
axes["straight"].axhspan(1.1, 1.5, color="0.93", zorder=0)
axes["straight"].set(xlabel="share of the straight line from pick to place", ylabel="leg it would need [m]")

axes["leg [m]"].set_ylim(1.08, 1.57)
for label, limit in (("rate [m/s]", 0.6), ("force [N]", 1500.0)):
    for sign in (1.0, -1.0):
        axes[label].axhline(sign * limit, color="0.5", ls=":")
    axes[label].sharex(axes["leg [m]"])
names = ["r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3"]
figure.legend(axes["leg [m]"].lines[:6], names, loc="outside upper right", ncols=6, frameon=False, fontsize=9)
axes["force [N]"].set_xlabel("time [s]")
figure.savefig(folder / "12_pick_and_place.png", dpi=160)

stiff = spm.stiffness(place, legs=2e7)
frequencies = chain.state(chain.joint_values(place)).natural_frequencies(stiff).frequencies
print("vibrations at the place, legs of 20 N/µm:", np.round(frequencies), "Hz")
