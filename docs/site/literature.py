"""Claims of the literature recomputed: the tables of docs/theory/literature_checks.md, made when the site is built.

`python docs/site/literature.py` prints them. The states are composed from the two stages, so no solver of the package
takes part in making one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from assembly_mode_changes import Array, NonsingularChange, ProvedRange, nonsingular_changes, proved_ranges
from rank_strata import AXIS, Stratum, matrix_rank, strata
from stage_placement import MACHINE, SAMPLES, problems

import spm_pin as spm
from spm_pin.kinematics.singularity_analysis import singular_values

PAGE = Path(__file__).parents[1] / "theory/literature_checks.md"
FAMILIES = ("TT", "TF", "FT", "FF")


# The characteristic tetrahedron


@dataclass(frozen=True)
class Tetrahedron:
    """Determinant of the four planes over det K, for states of one family."""

    family: str
    states: int
    ratio: float
    deviation: float


def tetrahedron_determinants(configuration: spm.Configuration) -> tuple[Array, Array]:
    """Return the determinant of the tetrahedron's planes (...) and det K (...) [m³].

    The planes, rows of a 4 x 4 matrix: at each ball joint that of its two revolute axes, with their cross product for
    its normal; and that of the three ball joints, with a normal of length one, hence the factor 2 / (√3 d²).
    """
    joints, axes = configuration.middle_joints, configuration.machine.revolute_axes
    normals = np.cross(np.broadcast_to(axes, joints.shape), axes @ np.swapaxes(configuration.rotation, -1, -2))
    flat = np.cross(joints[..., 1, :] - joints[..., 0, :], joints[..., 2, :] - joints[..., 0, :])
    normals = np.concatenate([normals, flat[..., None, :] / np.linalg.norm(flat, axis=-1)[..., None, None]], axis=-2)
    points = np.concatenate([joints, joints[..., :1, :]], axis=-2)
    planes = np.concatenate([normals, -(normals * points).sum(axis=-1)[..., None]], axis=-1)
    return np.asarray(np.linalg.det(planes)), spm.kinematics.determinants(configuration)[..., 2]


def tetrahedron() -> list[Tetrahedron]:
    """Return the ratio of the tetrahedron's determinant and det K, in units of 2 / (√3 d²), for each family."""
    unit = 2.0 / (np.sqrt(3.0) * MACHINE.middle_side**2)
    found = []
    for family in FAMILIES:
        planes, structure = tetrahedron_determinants(
            problems.random_branches(MACHINE, family, SAMPLES, seed=0).configuration
        )
        ratios = planes / (unit * structure)
        found.append(Tetrahedron(family, len(ratios), float(np.median(ratios)), float(np.ptp(ratios))))
    return found


# Degrees of freedom


@dataclass(frozen=True)
class Freedoms:
    """Freedoms of the mechanism at a state, and those of its terminal platform."""

    state: str
    joints: int
    closures: int
    mechanism: int
    platform: int


def freedoms() -> list[Freedoms]:
    """Return the mobility from the rank of the closures in Pinocchio, and the rank of the platform's Jacobian."""
    chain = spm.ClosedChain.from_urdf()
    home = spm.forward_physical(MACHINE, [1.3] * 6)
    mirrored = problems.without_torsion(MACHINE, (AXIS, np.sin(0.2), 1.1), (AXIS, -np.sin(0.1), -1.2))
    states = {
        "solution 3 of the paper": spm.forward_physical(MACHINE, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50]),
        "both stages tilted about the revolute axis of leg 1": mirrored,
        "the symmetric home": home,
    }
    found = []
    for name, state in states.items():
        closures = matrix_rank(chain.state(chain.joint_values(state)).constraint_jacobian())
        platform = matrix_rank(spm.kinematics.platform_jacobian(state))
        found.append(Freedoms(name, 18, closures, 18 - closures, platform))
    return found


# Operation modes


@dataclass(frozen=True)
class Passage:
    """The lower stage passes from mode T to mode F: states before, at and after the half turn."""

    state: str
    families: str
    closure: float
    rank: int
    determinant: float


def passages() -> list[Passage]:
    """Return states along a motion of the lower stage through a half turn: x0 falls to zero, then x3 rises."""
    azimuth, upper = 0.7, (1.9, np.sin(0.2), -1.2)
    states = {
        "x0 = 0.2": ("TT", np.sqrt(1.0 - 0.2**2)),
        "x0 = x3 = 0": ("TT", 1.0),
        "x3 = 0.2": ("FT", np.sqrt(1.0 - 0.2**2)),
    }
    found = []
    for name, (family, half_sine) in states.items():
        state = problems.without_torsion(MACHINE, (azimuth, half_sine, 1.1), upper, family)
        values = singular_values(_lower_structure(state))
        mean_radius = (state.middle_joints * MACHINE.radial_directions).sum(axis=-1).mean()
        mode = "T or F" if abs(mean_radius) < 1e-12 else "T" if mean_radius > 0.0 else "F"
        determinant = float(spm.singularities(state).scaled_determinants[0])
        rank = int((values > 1e-12).sum())
        found.append(Passage(name, mode, float(state.closure_residual), rank, determinant))
    return found


def _lower_structure(state: spm.Configuration) -> Array:
    """Return K_b (3, 6), the wrenches of the lower stage's revolute joints."""
    arms = (state.middle_joints - state.middle_joints.mean(axis=0)) / MACHINE.middle_side
    return np.concatenate([MACHINE.revolute_axes, np.cross(arms, MACHINE.revolute_axes)], axis=-1)


def self_motion(steps: int = 200) -> tuple[Array, Array]:
    """Return leg lengths (2, N, 3) along a self-motion in units of r, in mode T and in mode F, and p = sin²(tilt / 2).

    Hips at E = 0.75 r as in the paper's upper stage, one leg 3E long, the others √(3(r² - E²)); from the half turn at
    which both modes meet. With ψ counted from the axis of the odd leg, p = (1 ± 2E/r) / (1 ± 2 cos 2ψ).
    """
    e, r = MACHINE.platform_radius / MACHINE.middle_radius, MACHINE.middle_radius
    psi = 0.5 * np.arccos(e) * np.linspace(1.0, 0.0, steps)
    lengths, tilts = [], []
    for mode, sign in (("T", 1.0), ("F", -1.0)):
        p = np.minimum((1.0 + sign * 2.0 * e) / (1.0 + sign * 2.0 * np.cos(2.0 * psi)), 1.0)
        # Leg 2 is the odd one: the axis of its revolute joint has the azimuth 180°.
        joints = problems.corners(MACHINE, problems.stage(mode, np.pi + psi, np.sqrt(p), 0.0, r)) / r
        joints = joints - e * MACHINE.radial_directions
        joints[..., 2] -= joints[:, 1:2, 2]  # leg 2 lies flat across the base
        lengths.append(np.linalg.norm(joints, axis=-1))
        tilts.append(p)
    return np.stack(lengths), np.stack(tilts)


# Tables


def tables() -> dict[str, str]:
    """Return the tables of the page by name, in Markdown."""
    lengths, p = self_motion()
    spread = float(np.ptp(lengths, axis=(0, 1)).max())
    tilts = np.degrees(2.0 * np.arcsin(np.sqrt(p)))
    motion = (
        f"Largest change of a leg along both halves: {spread:.0e} r. The tilt goes from {tilts[0, -1]:.1f}° in mode T "
        f"to {tilts[0, 0]:.1f}° and on to {tilts[1, -1]:.1f}° in mode F.\n"
    )
    ends = "legs [r], ends apart [r], lengths differ by [r], boxes, proved: \\|D\\| / r⁶ at least"
    return {
        "tetrahedron": _table("family, states, ratio, largest difference of two ratios", tetrahedron()),
        "strata": _table("states, rank of K, dimension, bound, infinitesimal, finite", strata()),
        "freedoms": _table("state, joints, rank of the closures, mechanism, platform", freedoms()),
        "passages": _table("state, mode, closure residual [m], rank of K_b, det J_b / d³", passages()),
        "self_motion": motion,
        "ranges": _table("from E/r, to, boxes", proved_ranges()),
        "cuspidal": _table(f"stage, E/r, {ends}", nonsingular_changes(MACHINE)),
    }


def with_tables(page: str) -> str:
    """Return the text of a page with its comments `table: name` replaced by the tables."""
    found = tables()
    return re.sub(r"<!-- table: (\w+) -->", lambda match: found[match[1]], page)


def _table(
    headings: str, rows: Sequence[Tetrahedron | Stratum | Freedoms | Passage | NonsingularChange | ProvedRange]
) -> str:
    titles = headings.split(", ")
    lines = [f"| {' | '.join(titles)} |", f"|{'---|' * len(titles)}"]
    for row in rows:
        values = [getattr(row, field.name) for field in fields(row)]
        lines.append(f"| {' | '.join(f'{v:.3g}' if isinstance(v, float) else str(v) for v in values)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    for name, text in tables().items():
        print(f"{name}\n{text}")
