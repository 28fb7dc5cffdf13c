"""Five robots with closed loops, read from MJCF files, moved by their actuators and drawn with their loops closed.

Needs `pip install ".[plots,mjcf]"`. Writes its picture into the given folder, or the current one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from spm_pin.loops import ClosedChain

MOVES = {"four_bar": [0.6], "five_bar": [0.3, 0.2], "ankle": [0.5, 0.3], "delta": [0.3, 0.1, -0.1]}
MOVES["stewart"] = [0.03, -0.02, 0.01, 0.02, -0.01, 0.03]

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
robots = Path(__file__).parent / "robots"
figure = plt.figure(figsize=(11, 2.9), layout="constrained")
for number, (name, move) in enumerate(MOVES.items(), start=1):
    chain = ClosedChain.from_mjcf(robots / f"{name}.xml")
    home = chain.close()
    q = chain.forward(home[chain.actuated_in_q] + move, near=home)
    gap = np.abs(chain.state(q).gap()).max()
    print(f"{chain.mobility(q)!r}\n{name}: loops open by {gap:.0e} m")
    model, data = chain.model, chain.model.createData()
    pin.framesForwardKinematics(model, data, q)
    # What each joint carries is drawn as a fan from its origin to the joints and closures that stand on it.
    tips = [(model.parents[j], data.oMi[j].translation) for j in range(1, model.njoints)]
    for anchor in (a for closure in chain.closures for a in (closure.first, closure.second)):
        frame = model.getFrameId(anchor.frame)
        tips.append((model.frames[frame].parentJoint, (data.oMf[frame] * anchor.placement).translation))
    ax = figure.add_subplot(1, len(MOVES), number, projection="3d")
    for joint, tip in tips:
        if joint:
            driven = model.names[joint] in chain.actuated
            ax.plot(*np.array([data.oMi[joint].translation, tip]).T, color="C1" if driven else "C0", lw=2)
    for closure in chain.closures:
        frame = model.getFrameId(closure.first.frame)
        ax.plot(*(data.oMf[frame] * closure.first.placement).translation, "o", color="k", ms=3)
    ax.set_title(name.replace("_", "-"), fontsize=10)
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.view_init(15, -65)
figure.savefig(folder / "17_any_closed_chain.png", dpi=160)
