"""Optimal control in CasADi: a loaded platform moves between two poses with the least leg forces.

Needs `pip install ".[plots]"`. Writes a picture into the given folder, or into the current one.
"""

import sys
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import spm_pin as spm

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
machine = spm.Manipulator.paper()
count, duration, mass, height = 40, 2.0, 80.0, 0.25  # intervals, s, kg, and m above the platform
step = duration / count

# What it is compared with, and begins from: the legs straight from length to length, with a smooth start and stop.
times = np.linspace(0.0, 1.0, count + 1)
first, last = np.array([[1.19, 1.43, 1.43, 1.39, 1.43, 1.23], [1.15, 1.44, 1.33, 1.14, 1.39, 1.24]])
straight = spm.forward_physical(machine, first + (last - first) * (3 * times**2 - 2 * times**3)[:, None])
guess = np.concatenate([straight.translation, straight.pose.rotation.as_euler("XYX")], axis=-1).T
label = "TT+"
assert np.allclose(spm.inverse_displacement(machine, straight.pose)[label].leg_lengths, straight.leg_lengths)
inverse, leg_forces = spm.casadi.inverse_branch(label, machine), spm.casadi.leg_forces(machine)

# Forces and lengths of one instant, from the coordinates y = (o, X-Y-X angles) and their accelerations.
y, acceleration = ca.SX.sym("y", 6), ca.SX.sym("a", 6)
(ca1, sa1), (cb, sb), (ca2, sa2) = ((ca.cos(y[k]), ca.sin(y[k])) for k in (3, 4, 5))
first_turn = ca.blockcat([[1, 0, 0], [0, ca1, -sa1], [0, sa1, ca1]])
second_turn = ca.blockcat([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
rotation = first_turn @ second_turn @ ca.blockcat([[1, 0, 0], [0, ca2, -sa2], [0, sa2, ca2]])
lengths, joints, discriminant, _ = inverse(rotation, y[:3])
# The load as a point mass on the platform's axis; its motion against o is left out.
weight = -mass * (acceleration[:3] + ca.vertcat(0.0, 0.0, 9.81))
wrench = ca.vertcat(weight, ca.cross(height * rotation[:, 2], weight))
forces = leg_forces(joints, rotation, y[:3], wrench)
instant = ca.Function("instant", [y, acceleration], [forces, lengths, discriminant])

problem = ca.Opti()
place, speed, push = problem.variable(6, count + 1), problem.variable(6, count + 1), problem.variable(6, count)
along, ahead = instant.map(count), (place[:, :-1] + step * speed[:, :-1] + step**2 / 2 * push)
force, length, margin = along(place[:, :-1], push)
problem.minimize(step * ca.sumsqr(force / 1e3) + 3e-3 * step * ca.sumsqr(push))
problem.subject_to(place[:, 1:] == ahead)
problem.subject_to(speed[:, 1:] == speed[:, :-1] + step * push)
problem.subject_to(problem.bounded(1.10, ca.vec(length), 1.50))
problem.subject_to(problem.bounded(-1.7, ca.vec(force) / 1e3, 1.7))  # kN, about what straight legs need
problem.subject_to(problem.bounded(-0.3, ca.vec(ca.diff(length, 1, 1)) / step, 0.3))
problem.subject_to(ca.vec(margin) >= 5e-4)  # away from where the branches meet
for column in (0, count):
    problem.subject_to(place[:, column] == guess[:, column])
    problem.subject_to(speed[:, column] == 0)
rates = np.gradient(guess, step, axis=-1)
rates[:, [0, -1]] = 0.0
straight_push = np.diff(rates, axis=-1) / step
for variable, values in ((place, guess), (speed, rates), (push, straight_push)):
    problem.set_initial(variable, values)
problem.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
solution = problem.solve()

found = np.asarray(solution.value(place))
runs = {
    "straight legs": [np.asarray(x) for x in along(guess[:, :-1], straight_push)],
    "least forces": [np.asarray(x) for x in along(found[:, :-1], solution.value(push))],
}
for name, (f, q, _) in runs.items():
    print(f"{name:12}: root mean square {np.sqrt((f**2).mean()):5.0f} N, largest {np.abs(f).max():5.0f} N, legs "
          f"{q.min():.3f} to {q.max():.3f} m")  # fmt: skip

# The package agrees: the lengths of the optimum lead back to its poses.
again = spm.forward_physical(machine, runs["least forces"][1].T)
print(f"poses come back to {np.abs(again.translation - found[:3, :-1].T).max():.0e} m")

figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, sharey="row", layout="constrained")
for column, (name, (f, q, _)) in zip(axes.T, runs.items(), strict=True):
    for leg in range(6):
        column[0].plot(step * np.arange(count), f[leg] / 1e3, label=spm.machine.LEGS[leg])
        column[1].plot(step * np.arange(count), q[leg])
    column[0].set_title(f"{name}: {np.sqrt((f**2).mean()) / 1e3:.2f} kN rms, {np.abs(f).max() / 1e3:.2f} kN at most")
    column[1].set_xlabel("time [s]")
    for limit in (1.10, 1.50):
        column[1].axhline(limit, color="0.6", lw=0.8, ls="--")
axes[0, 0].set_ylabel("leg force [kN]")
axes[1, 0].set_ylabel("leg length [m]")
axes[0, 1].legend(fontsize=8, ncols=2, frameon=False)
figure.savefig(folder / "13_least_leg_forces.png", dpi=160)
