"""The gallery of real machines: its picture, and its tables of what they reach and how far their programs are off.

`python docs/site/gallery.py` writes the tables into docs/howto/gallery.md; the picture is one of docs/site/figures.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.display import draw
from spm_pin.machine import PRS, RRS, Configuration, RealMachine, gallery
from spm_pin.workspace import ReachEnd

PAGE = Path(__file__).parents[1] / "howto/gallery.md"
MOST_TILT, SHARE = np.radians(20.0), 0.9
"""Formulas are compared with the rigid plate up to this tilt, and this share of what is reached in every direction."""
DIRECTIONS, TILTS = 72, 20
ABOVE = 0.02
"""Height of the balls of the haptic device above the origin of its program [m]."""

Array = npt.NDArray[np.float64]
Formula = Callable[[Configuration], Array]
"""Readings (n, 3) that a program commands for the states (n,)."""


# What the programs compute, each as a formula of its own in the stage's frame


def straight_lines(wanted: Configuration) -> Array:
    """Put each ball at the plate's radius from a centre that stays, where the plate meets the plane of its leg."""
    radius, up, rise = wanted.machine.platform_radius, wanted.normal[:, 2:], -_slopes(wanted)
    length = np.hypot(up, rise)
    return _readings(wanted, radius * up / length, radius * rise / length)


def straight_up(wanted: Configuration) -> Array:
    """Put each ball as high as it is on the plate, and straight above where it is on the level one."""
    radius, rise = wanted.machine.platform_radius, -_slopes(wanted)
    return _readings(wanted, np.full_like(rise, radius), radius * rise)


def third_leg_otherwise(wanted: Configuration) -> Array:
    """Put the balls where they are, but for the radius of the third, for which another expression stands."""
    nx, ny, nz = _turned(wanted.normal, 60.0)
    xx, c = nx**2, nz + 1.0
    third = (xx + 3.0 * nz * c) / (c - xx + (xx**2 - 3.0 * xx * ny**2) / (c * (c - xx)))
    shares = [*(1.0 - (xx + sign * np.sqrt(3.0) * nx * ny) / c for sign in (1.0, -1.0)), 0.5 * third - 0.5]
    radius = wanted.machine.platform_radius
    return _readings(wanted, radius * np.stack(shares, axis=-1), -radius * _slopes(wanted))


def about_the_centre_by_x(wanted: Configuration) -> Array:
    """Turn the plate about a centre that stays, with a twist, and take the radius of a ball from its x alone."""
    nx, ny, nz = _turned(wanted.normal, 30.0)
    roll, pitch = np.arctan2(-ny, nz), np.arcsin(nx)
    twist = np.arctan(-np.tan(roll) * np.tan(pitch))
    corners = _corners()
    balls = wanted.machine.platform_radius * _placed(Rotation.from_euler("XYZ", np.stack([roll, pitch, twist], -1)))
    return _readings(wanted, balls[..., 0] / corners[:, 0], balls[..., 2])


def about_the_centre(wanted: Configuration) -> Array:
    """Turn the plate about a centre that stays, roll before pitch; distances from pivots to balls are the readings."""
    nx, ny, nz = _turned(wanted.normal, 30.0)
    turn = Rotation.from_euler("YX", np.stack([np.arctan2(nx, nz), -np.arcsin(ny)], -1))
    balls = wanted.machine.platform_radius * _placed(turn)
    balls[..., 2] += wanted.height[:, None]
    return np.asarray(np.linalg.norm(balls - wanted.machine.base_radius * _corners(), axis=-1))


def balls_at_the_origin(wanted: Configuration) -> Array:
    """Shift the plate of pivots as if the fixed balls were at the height of the origin, 20 mm below where they are."""
    over = np.diag([1.0, -1.0, -1.0])  # the stage turned over: balls below, pivots above
    r = over @ np.swapaxes(wanted.rotation, -1, -2) @ over
    z = -(r @ over @ wanted.translation[..., None])[..., 2, 0] + ABOVE
    (ux, vx, wx), (uy, vy, wy), wz = r[:, 0].T, r[:, 1].T, r[:, 2, 2]
    b = wanted.machine.platform_radius
    x = (b * uy * (ux - 3.0 * vy) + 2.0 * z * wx) / (2.0 * wz)
    y = (b * ux * (vy - ux) + 2.0 * b * vx * uy + 2.0 * z * wy) / (2.0 * wz)
    pivots = wanted.machine.legs.pivots @ over @ np.swapaxes(r, -1, -2) + np.stack([x, y, z], -1)[:, None]
    return np.asarray(np.linalg.norm(pivots - wanted.machine.legs.balls @ over - [0.0, 0.0, ABOVE], axis=-1))


SOLVES = "solves the equations of the rigid plate numerically"
PROGRAMS: dict[str, tuple[Formula | None, str]] = {
    "Ball-Balancer-V2": (
        third_leg_otherwise,
        "puts two balls where they are, and the third at nearly the right radius, by another expression",
    ),
    "3RRS-Balancing-Robot": (straight_lines, "puts each ball at the plate's radius from a centre that stays"),
    "Ball-Balancer": (straight_up, "puts each ball straight above where it is on the level plate"),
    "3RRS-ball-ballancing-platform": (
        about_the_centre_by_x,
        "turns about a centre that stays, with about twice the rigid plate's twist; takes a ball's radius from its x",
    ),
    "3-RPS heliostat": (None, f"{SOLVES}, five of them"),
    "3-RPS-Simulator": (about_the_centre, "turns about a centre that stays, so balls leave the planes of their legs"),
    "3PRS robot": (None, f"{SOLVES}, nine of them"),
    "3PRS neck brace": (None, "none of its own: the plate's twist is taken from a simulation"),
    "3-SPR haptic device": (balls_at_the_origin, "shifts the plate as if the balls stood at the origin, 20 mm lower"),
    "3RPS-3SPR": (None, "the rigid plates in closed form; [its tables, recomputed](../findings.md)"),
}
"""The formula of each program, None where it has none that is off; and what it does, in words."""


def _slopes(wanted: Configuration) -> Array:
    """Return the normals' components along the legs' radial directions, (n, 3)."""
    return np.asarray(wanted.normal[:, :2] @ spm.machine.legs.RADIAL[:, :2].T)


def _turned(normals: Array, degrees: float) -> Array:
    """Return the components (3, n) of normals in a program's frame, in which the legs stand that much farther."""
    return np.asarray(Rotation.from_euler("z", degrees, degrees=True).as_matrix() @ normals.T)


def _corners() -> Array:
    """Return the unit vectors to legs at 0, 120 and 240°, (3, 3)."""
    return np.asarray(Rotation.from_euler("z", [[0], [120], [240]], degrees=True).as_matrix()[..., 0])


def _placed(turn: Rotation) -> Array:
    return np.asarray(_corners() @ np.swapaxes(turn.as_matrix(), -1, -2))


def _readings(wanted: Configuration, radii: Array, rises: Array) -> Array:
    """Return the readings for balls (n, 3) at these radii, and so much above the plate's centre, by their legs."""
    places = np.stack([radii - wanted.machine.base_radius, wanted.height[:, None] + rises], axis=-1)
    return np.asarray(wanted.machine.kind.readings(places, wanted.machine.crank_middles))


# What is computed of each machine


@dataclass(frozen=True)
class FormulaError:
    """Largest differences of the plate from the one that a program wants."""

    tilt: float
    """Largest tilt of the comparison [rad]."""
    ball: float
    """Largest distance of a ball from where it should be [m]."""
    angle: float
    """Largest angle between the plate's normal and the one wanted [rad]."""


def formula_error(machine: RealMachine, formula: Formula) -> FormulaError:
    """Compare where the readings of a program lead with what it was asked for, over tilts in every direction."""
    stage = machine.stage
    reached = float(spm.workspace.reach(stage, machine.height, directions=DIRECTIONS).all_round[0])
    most = min(MOST_TILT, SHARE * reached)
    tilt, azimuth = np.meshgrid(np.linspace(0.0, most, TILTS + 1), np.linspace(0.0, 2.0 * np.pi, DIRECTIONS + 1))
    wanted = spm.inverse_physical(stage, machine.height, tilt=tilt.ravel(), azimuth=azimuth.ravel())
    actual = spm.forward_physical(stage, formula(wanted))
    assert actual.exists.all()
    ball = np.linalg.norm(actual.balls - wanted.balls, axis=-1).max()
    across, along = np.cross(actual.normal, wanted.normal), (actual.normal * wanted.normal).sum(axis=-1)
    return FormulaError(most, float(ball), float(np.arctan2(np.linalg.norm(across, axis=-1), along).max()))


def nearest_singularity(stage: spm.Stage, height: float) -> tuple[float, ReachEnd]:
    """Return the least tilt at a height at which a stage without limits is singular [rad], and of which sort it is."""
    found = spm.workspace.reach(replace(stage, limits=None), height, directions=360)
    k = int(found.tilts[0].argmin())
    return float(found.tilts[0, k]), ReachEnd(found.ends[0, k])


# The page


def tables() -> str:
    """Return the tables of the page, and the list of sources."""
    machines = gallery()
    lines = [
        "| machine | | dimensions [mm] | level, from … to … [mm] | at [mm] | tilts all round | nearest singularity |",
        "|---|---|---|---|---:|---:|---|",
    ]
    for name, machine in machines.items():
        for title, kind, stage in zip((name, ""), machine.architecture.split(" and "), machine.stages, strict=False):
            low, high = spm.workspace.height_range(stage)
            tilt = np.degrees(spm.workspace.reach(stage, machine.height).all_round[0])
            least, end = nearest_singularity(stage, machine.height)
            highest = "no end" if high > stage.size and stage.limits is None else f"{1e3 * high:.0f}"
            cells = [title, kind, _dimensions(stage), f"{1e3 * max(low, 0.0):.0f} … {highest}"]
            cells += [f"{1e3 * machine.height:.0f}", f"{tilt:.1f}°", f"{end}, {np.degrees(least):.1f}°"]
            lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "| machine | what its program computes | a ball is off by | the normal | at tilts up to |"]
    lines += ["|---|---|---:|---:|---:|"]
    for name, machine in machines.items():
        formula, words = PROGRAMS[name]
        cells = ["", "", ""]
        if formula is not None:
            error = formula_error(machine, formula)
            cells = [f"{1e3 * error.ball:.2g} mm", f"{np.degrees(error.angle):.2g}°", f"{np.degrees(error.tilt):.1f}°"]
        lines.append(f"| {name} | {words} | {' | '.join(cells)} |")
    lines += ["", "| machine | numbers from | assumed |", "|---|---|---|"]
    lines += [f"| {name} | {_linked(machine.source)} | {machine.assumed} |" for name, machine in machines.items()]
    return "\n".join(lines) + "\n"


def _linked(source: str) -> str:
    return re.sub(r"^([\w.-]+/[\w.-]+),", r"[\1](https://github.com/\1),", source)


def _dimensions(stage: spm.Stage) -> str:
    kind = stage.kind
    text = f"base {1e3 * stage.base_radius:.4g}, plate {1e3 * stage.platform_radius:.4g}"
    if isinstance(kind, RRS):
        text += f", crank {1e3 * kind.numbers[0, 0]:.4g}"
    if isinstance(kind, RRS | PRS):
        rods = dict.fromkeys(np.atleast_1d(np.asarray(kind.rod)).tolist())
        text += f", rod {' and '.join(f'{1e3 * rod:.5g}' for rod in rods)}"
    return text


def with_tables(text: str) -> str:
    """Return the page's text with its tables computed anew."""
    return re.sub(r"(<!-- tables -->\n\n).*", lambda match: match[1] + tables(), text, flags=re.DOTALL)


def picture() -> Figure:
    """Draw the machines side by side, tilted by 10° or half of what they reach."""
    figure = Figure(figsize=(8.5, 4.2))
    axes = figure.subplots(2, 5, gridspec_kw={"left": 0.0, "right": 1.0, "bottom": 0.0, "top": 0.9, "wspace": 0.05})
    for ax, (name, entry) in zip(axes.flat, gallery().items(), strict=True):
        if len(entry.stages) == 2:
            machine = spm.Manipulator.of_stages(*entry.stages)
            state: spm.Configuration = spm.forward_physical(machine, [1.2, 1.25, 1.3, 1.3, 1.25, 1.2])
        else:
            tilt = min(np.radians(10.0), spm.workspace.reach(entry.stage, entry.height).all_round[0] / 2.0)
            state = spm.inverse_physical(entry.stage, entry.height, tilt=tilt, azimuth=0.5)
        draw(state, ax=ax, labels=False)
        ax.axis("off")
        ax.set_title(name.replace("-ball-", "-ball-\n"), fontsize=8)
    return figure


def main() -> None:
    """Write the tables."""
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
