"""The paper's workspace: 24 surfaces that enclose where the terminal platform can be, by Table 6 and its steps 1 to 5.

A sub-workspace fixes four legs at limits and lets two vary: it is one of the 240 square faces of the box of the limits.
Surfaces with a common edge, where a single leg varies, have its leg lengths and so their vertices in common: the shell
is closed by construction. It is not the whole boundary of what can be reached, see docs/theory/workspace.md.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError, GeometryError, SelectionError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism import LEGS, Configuration, Geometry, LegLimits, notebook
from spm_pin.mechanism.arguments import (
    FloatArray,
    IntArray,
    check_instance,
    first_offender,
    frozen,
    type_and_value,
    whole_number,
)
from spm_pin.paper import published
from spm_pin.workspace.closed_mesh import ClosedMesh, Convergence, enclosed_volume

FINEST = 2000
"""Increments of a varying leg, at most: 24 surfaces of four million vertices."""

SENSES = (1, -1, 1, -1, 1, 1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, 1, -1, -1, 1, -1, -1)
"""Senses in which the outlines of the surfaces are gone round: neighbours run along their edge in opposite ones.

Which side is then outwards is for the positions to say."""

ERRATA = {("St3", "r_b1"): "mmax", ("Sm3", "r_b3"): "min", ("Sm5", "r_b3"): "bmin~mmax"}
"""Misprinted cells of Table 6, by surface and leg, as printed. The stage's letter is missing or another; the column
has it. A missing "~" needs no mention: two limits in one cell can mean nothing else."""


class LegSetting(enum.Enum):
    """LegSetting of a leg in Table 6; the value is the text of the table."""

    MINIMUM = "min"
    MAXIMUM = "max"
    VARIES = "min~max"


@dataclass(frozen=True)
class SubWorkspace:
    """A row of Table 6."""

    name: str
    """The paper's name: St1 to St3, Sc1 to Sc9, Sm1 to Sm9, Sl1 to Sl3."""
    settings: tuple[LegSetting, ...]
    """The setting of each leg, in the order of `LEGS`; two legs vary."""

    @property
    def family(self) -> str:
        """The name without its number: St, Sc, Sm or Sl."""
        return self.name.rstrip("0123456789")

    @property
    def varying(self) -> tuple[int, int]:
        """The two legs that vary, counted as in `LEGS`."""
        first, second = (leg for leg, setting in enumerate(self.settings) if setting is LegSetting.VARIES)
        return first, second

    def increments(self, resolution: int) -> IntArray:
        """Return the increments of the six legs above their minima, (resolution + 1, resolution + 1, 6).

        The first varying leg changes along the first axis, the other along the second.
        """
        fixed = {LegSetting.MINIMUM: 0, LegSetting.MAXIMUM: resolution, LegSetting.VARIES: 0}
        steps = np.empty((resolution + 1, resolution + 1, 6), dtype=np.intp)
        steps[:] = [fixed[setting] for setting in self.settings]
        first, second = self.varying
        steps[..., first] = np.arange(resolution + 1)[:, None]
        steps[..., second] = np.arange(resolution + 1)
        return steps


def sub_workspaces() -> tuple[SubWorkspace, ...]:
    """Return the rows of Table 6."""
    return tuple(SubWorkspace(name, tuple(map(_setting, cells))) for name, *cells in published.TABLE_6)


def _setting(cell: str) -> LegSetting:
    """Return the setting in a cell of the table: the limit is legible, whatever letter stands before it."""
    first, *last = cell.replace("~", " ").split()
    return LegSetting.VARIES if last else LegSetting(first[-3:])


@dataclass(frozen=True)
class Patch(SubWorkspace):
    """One of the 24 surfaces: a row of Table 6, and its part of the shell's mesh; arrays are read-only."""

    grid: IntArray
    """Vertices of the shell's mesh, shape (n + 1, n + 1); the first varying leg grows along the first axis, the second
    along the other."""
    faces: IntArray
    """Faces of the shell's mesh, shape (2n²,)."""
    area: float
    """Area of those faces [m²]."""


@dataclass(frozen=True)
class Shell(ClosedMesh):
    """The 24 surfaces of Table 6, joined to a mesh in {B}; made by `workspace_shell`. Faces lie patch by patch."""

    geometry: Geometry
    """The manipulator."""
    limits: LegLimits
    """The leg limits."""
    resolution: int
    """Increments δr of a varying leg from its minimum to its maximum."""
    patches: tuple[Patch, ...]
    """In the order of Table 6."""
    configuration: Configuration
    """The state at each vertex of the mesh, shape (V,)."""
    convergence: Convergence
    """How the volume converges as the resolution grows."""

    def __repr__(self) -> str:
        size = f"{len(self.vertices)} vertices, {len(self.faces)} faces"
        return f"<Shell: {len(self.patches)} patches, {size}, {self.volume:.4f} m³>"

    def _repr_html_(self) -> str:
        rows = [(patch.name, f"{patch.area:.4f}") for patch in self.patches]
        return notebook.table(repr(self), ("patch", "area [m²]"), rows)

    def plot(self) -> Any:
        """Return a matplotlib figure of the shell from four sides, after the paper's Fig. 2."""
        return notebook.plot("shell_figure", self)

    def __getitem__(self, name: str) -> Patch:
        for patch in self.patches:
            if patch.name == name:
                return patch
        expected = f"a patch: {', '.join(patch.name for patch in self.patches)}"
        raise SelectionError("name", expected, type_and_value(name))

    @property
    def volume(self) -> float:
        """Volume enclosed by the surfaces [m³], extrapolated from meshes; where they go round twice it counts twice."""
        return self.convergence.limit

    @property
    def volume_error(self) -> float:
        """Estimate of the error of `volume` [m³]."""
        return self.convergence.error


def workspace_shell(geometry: Geometry, limits: LegLimits | None = None, *, resolution: int = 40) -> Shell:
    """Construct the paper's workspace: 24 surfaces of o, joined to one closed mesh.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given. They may differ from leg to leg.
    resolution : int
        Increments δr of a varying leg from its minimum to its maximum, at least 2; the mesh has 24 resolution² + 2
        vertices.

    Returns
    -------
    Shell
        The mesh in {B} [m], its patches, its volume, and which points it contains.

    Notes
    -----
    Section "Workspace analysis" and Table 6 of the paper, whose misprints are named in `ERRATA`, in the physical mode.

    Examples
    --------
    >>> import spm_pin as spm
    >>> shell = spm.workspace.workspace_shell(spm.Geometry.paper())
    >>> len(shell.patches), shell.euler_characteristic, round(shell.volume, 3)
    (24, 2, 1.653)
    """
    if not check_instance(geometry, Geometry, "geometry").is_nominal:
        cause = "The paper's 24 surfaces are those of the drawing: geometry.nominal, or the file without its legs"
        raise GeometryError("geometry", "a machine as drawn", "one as built", cause)
    limits = _read_limits(geometry, limits)
    n = whole_number(resolution, "resolution", "a whole number of increments, at least 2", least=2, most=FINEST)
    rows = sub_workspaces()
    coarser = sorted({-(-n // 4), -(-n // 2)})
    volumes = []
    for m in (*coarser, n):
        lengths, grids = _joined(rows, limits, m)
        states = _assembled(geometry, limits, lengths)
        faces = np.concatenate([_lofted(grid, sign) for grid, sign in zip(grids, SENSES, strict=True)])
        volumes.append(enclosed_volume(states.translation, faces))
    outward = 1 if volumes[-1] > 0.0 else -1
    vertices, faces = states.translation, frozen(faces[:, ::outward])
    areas = ClosedMesh(vertices, faces).face_areas.reshape(len(rows), -1).sum(axis=1)
    numbers = np.arange(len(faces)).reshape(len(rows), -1)
    patches = tuple(
        Patch(row.name, row.settings, frozen(grid), frozen(number), float(area))
        for row, grid, area, number in zip(rows, grids, areas, numbers, strict=True)
    )
    convergence = Convergence((*coarser, n), tuple(outward * volume for volume in volumes))
    return Shell(vertices, faces, geometry, limits, n, patches, states, convergence)


def _joined(rows: Sequence[SubWorkspace], limits: LegLimits, n: int) -> tuple[FloatArray, IntArray]:
    """Return the leg lengths of all vertices (V, 6) [m], and which of them form each surface (24, n + 1, n + 1).

    Steps 1 to 3 and 5: four legs at limits, the two others from minimum to maximum by δr, for every row. What two rows
    have in common has the same increments, which are whole numbers, and is taken once.
    """
    steps = np.stack([row.increments(n) for row in rows])
    vertices, number = np.unique(steps.reshape(-1, 6), axis=0, return_inverse=True)
    share = vertices / n
    # Written so that both limits come out exactly.
    lengths = (1.0 - share) * np.array(limits.minimum) + share * np.array(limits.maximum)
    return lengths, number.reshape(steps.shape[:-1])


def _assembled(geometry: Geometry, limits: LegLimits, lengths: FloatArray) -> Configuration:
    """Return the states with these leg lengths: what the paper's CAD mechanism solves in step 3."""
    states = forward_physical(geometry, lengths)
    absent = ~states.exists
    if not absent.any():
        return states
    expected = "leg limits between which the mechanism can be assembled"
    if absent.all():
        lower, upper = (max(legs) for legs in (limits.maximum[:3], limits.maximum[3:]))
        stages = ("lower", geometry.base_radius, lower), ("upper", geometry.platform_radius, upper)
        for stage, radius, longest in stages:
            gap = abs(radius - geometry.middle_radius)
            if longest <= gap:
                legs = f"{stage} legs of at most {longest:g} m to span {gap:g} m"
                raise ArgumentError("limits", expected, legs, "This geometry has no symmetric home within them")
        raise ArgumentError("limits", expected, "limits at which no surface has a physical configuration")
    first = ", ".join(f"{leg} = {x:g}" for leg, x in zip(LEGS, lengths[first_offender(absent)], strict=True))
    share = f"{np.count_nonzero(absent)} of {len(absent)} vertices without a physical configuration, as at {first} m"
    raise ArgumentError("limits", expected, share, "A narrower range would close the shell")


def _lofted(grid: IntArray, sign: int) -> IntArray:
    """Return triangles (2n², 3) between the curves c_j and c_j+1: step 4's loft.

    Squares are divided from both legs short to both long, which no exchange of legs changes.
    """
    near, far, across, along = grid[:-1, :-1], grid[1:, 1:], grid[1:, :-1], grid[:-1, 1:]
    triangles = np.stack([near, across, far, near, far, along], axis=-1).reshape(-1, 3)
    return triangles[:, ::sign]


def _read_limits(geometry: Geometry, limits: LegLimits | None) -> LegLimits:
    box = geometry.limits if limits is None else limits
    expected = "LegLimits with a positive minimum and a finite maximum for every leg, in metres"
    if box is None:
        raise GeometryError("limits", expected, "None, and the geometry has none", "A workspace needs limits")
    if not isinstance(box, LegLimits):
        raise GeometryError("limits", expected, repr(limits), "Use LegLimits(minimum, maximum)")
    for leg, low, high in zip(LEGS, box.minimum, box.maximum, strict=True):
        if not (low > 0.0 and np.isfinite(high)):
            raise GeometryError("limits", expected, f"[{low:g}, {high:g}] for {leg}")
    return box
