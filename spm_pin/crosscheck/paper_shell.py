"""The paper's workspace: 24 surfaces that enclose where the terminal platform can be, by Table 6 and its steps 1 to 5.

A sub-workspace fixes four legs at limits and lets two vary: it is one of the 240 square faces of the box of the limits.
Surfaces with a common edge, where a single leg varies, have its leg lengths and so their vertices in common: the shell
is closed by construction. It is not the whole boundary of what can be reached, see docs/theory/workspace.md.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spm_pin.crosscheck.paper import published
from spm_pin.errors import ArgumentError, GeometryError, SelectionError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.machine import LEGS, Configuration, LegLimits, Manipulator
from spm_pin.machine.manipulator import check_rps
from spm_pin.support.arguments import FloatArray, IntArray, first_offender, frozen, type_and_value, whole_number
from spm_pin.workspace.boundary import ClosedMesh
from spm_pin.workspace.state_set import finite_limits

FINEST = 2000
"""Increments of a varying leg, at most: 24 surfaces of four million vertices."""

SENSES = (1, -1, 1, -1, 1, 1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, 1, -1, -1, 1, -1, -1)
"""Senses in which the outlines of the surfaces are gone round: neighbours run along their edge in opposite ones.

Which side is then outwards is for the positions to say."""

ERRATA = {("St3", "r_b1"): "mmax", ("Sm3", "r_b3"): "min", ("Sm5", "r_b3"): "bmin~mmax"}
"""Misprinted cells of Table 6, by surface and leg, as printed. The stage's letter is missing or another; the column
has it. A missing "~" needs no mention: two limits in one cell can mean nothing else."""


class LegSetting(enum.Enum):
    """Setting of a leg in Table 6; the value is the text of the table."""

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
        """Return the increments above the minima (n + 1, n + 1, 6), in the order of the legs that vary."""
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
class Convergence:
    """The volume that meshes of growing resolution enclose, extrapolated.

    A mesh's error is a series in even powers of 1/n, so a polynomial in 1/n² through the values leads to its limit.
    """

    resolutions: tuple[int, ...]
    """Resolutions n of the meshes, growing."""
    volumes: tuple[float, ...]
    """Volumes that the meshes enclose [m³]."""

    @property
    def limit(self) -> float:
        """Volume extrapolated to infinitely fine meshes: the polynomial in 1/n² at 1/n = 0 [m³]."""
        return self._extrapolated(slice(None))

    @property
    def error(self) -> float:
        """Bound on the error of `limit`: its larger change if the coarsest or the finest mesh is left out [m³]."""
        return max(abs(self.limit - self._extrapolated(part)) for part in (slice(1, None), slice(None, -1)))

    @property
    def order(self) -> float:
        """Power of 1/n with which the error falls from the last mesh but one to the last; 2 in theory."""
        coarse, fine = (abs(volume - self.limit) for volume in self.volumes[-2:])
        if fine == 0.0:
            return float("inf")
        return float(np.log(coarse / fine) / np.log(self.resolutions[-1] / self.resolutions[-2]))

    def _extrapolated(self, part: slice) -> float:
        squares = 1.0 / np.array(self.resolutions[part], dtype=np.float64) ** 2
        return float(np.polyfit(squares, self.volumes[part], len(squares) - 1)[-1])


@dataclass(frozen=True)
class Shell(ClosedMesh):
    """The 24 surfaces of Table 6, joined to a mesh in {B}; made by `workspace_shell`. Faces lie patch by patch."""

    machine: Manipulator
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
    """Convergence of the volume with increasing resolution."""

    def __repr__(self) -> str:
        size = f"{len(self.vertices)} vertices, {len(self.faces)} faces"
        return f"<Shell: {len(self.patches)} patches, {size}, {self.volume:.4f} m³>"

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


def workspace_shell(machine: Manipulator, limits: LegLimits | None = None, *, resolution: int = 40) -> Shell:
    """Construct the paper's workspace: 24 surfaces of o, joined to one closed mesh.

    Parameters
    ----------
    machine : Manipulator
        The manipulator.
    limits : LegLimits, optional
        Leg limits; the machine's own if not given. They may differ from leg to leg.
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
    >>> shell = spm.crosscheck.workspace_shell(spm.Manipulator.paper())
    >>> len(shell.patches), shell.euler_characteristic, round(shell.volume, 3)
    (24, 2, 1.653)
    """
    limits = finite_limits(machine, limits)
    check_rps(machine, "the paper's 24 surfaces")
    if not machine.is_nominal:
        cause = "The paper's 24 surfaces are those of machine.nominal, or the file without its legs"
        raise GeometryError("machine", "a nominal machine", "a calibrated machine", cause)
    if min(limits.minimum) == 0.0:
        raise ArgumentError("limits", "a positive minimum for every leg", f"{limits.minimum} m")
    n = whole_number(resolution, "resolution", "a whole number of increments, at least 2", least=2, most=FINEST)
    rows = sub_workspaces()
    coarser = sorted({-(-n // 4), -(-n // 2)})
    volumes = []
    for m in (*coarser, n):
        lengths, grids = _joined(rows, limits, m)
        states = _assembled(machine, lengths)
        faces = np.concatenate([_lofted(grid, sign) for grid, sign in zip(grids, SENSES, strict=True)])
        volumes.append(ClosedMesh(states.translation, faces).volume)
    outward = 1 if volumes[-1] > 0.0 else -1
    vertices, faces = states.translation, frozen(faces[:, ::outward])
    areas = ClosedMesh(vertices, faces).face_areas.reshape(len(rows), -1).sum(axis=1)
    numbers = np.arange(len(faces)).reshape(len(rows), -1)
    patches = tuple(
        Patch(row.name, row.settings, frozen(grid), frozen(number), float(area))
        for row, grid, area, number in zip(rows, grids, areas, numbers, strict=True)
    )
    convergence = Convergence((*coarser, n), tuple(outward * volume for volume in volumes))
    return Shell(vertices, faces, machine, limits, n, patches, states, convergence)


def _joined(rows: Sequence[SubWorkspace], limits: LegLimits, n: int) -> tuple[FloatArray, IntArray]:
    """Return the leg lengths of all vertices (V, 6) [m], and which of them form each surface (24, n + 1, n + 1).

    Steps 1 to 3 and 5: four legs at limits, the two others from minimum to maximum by δr, for every row. What two rows
    have in common has the same increments, which are whole numbers, and is taken once.
    """
    steps = np.stack([row.increments(n) for row in rows])
    vertices, number = np.unique(steps.reshape(-1, 6), axis=0, return_inverse=True)
    share = vertices / n
    # Written so that both limits come out exactly.
    lengths = (1.0 - share) * limits.ends[0] + share * limits.ends[1]
    return lengths, number.reshape(steps.shape[:-1])


def _assembled(machine: Manipulator, lengths: FloatArray) -> Configuration:
    """Return the states with these leg lengths: what the paper's CAD mechanism solves in step 3."""
    states = forward_physical(machine, lengths)
    absent = ~states.exists
    if absent.any():
        first = ", ".join(f"{leg} = {x:g}" for leg, x in zip(LEGS, lengths[first_offender(absent)], strict=True))
        share = f"{np.count_nonzero(absent)} of {len(absent)} vertices without a physical configuration"
        cause = "Too short to join the platforms?" if absent.all() else "A narrower range would close the shell"
        expected = "leg limits between which the mechanism can be assembled"
        raise ArgumentError("limits", expected, f"{share}, as at {first} m", cause)
    return states


def _lofted(grid: IntArray, sign: int) -> IntArray:
    """Return triangles (2n², 3) between the curves c_j and c_j+1: step 4's loft, the same if legs are exchanged."""
    near, far, across, along = grid[:-1, :-1], grid[1:, 1:], grid[1:, :-1], grid[:-1, 1:]
    triangles = np.stack([near, across, far, near, far, along], axis=-1).reshape(-1, 3)
    return triangles[:, ::sign]
