"""Options that several subcommands take, and what they mean in SI."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Geometry, SolutionSet, pose

__all__ = [
    "AsJson",
    "Branches",
    "GeometryFile",
    "LengthUnit",
    "Translation",
    "Unit",
    "Xyx",
    "chosen",
    "read_geometry",
    "read_pose",
]


class LengthUnit(enum.StrEnum):
    """Units of length on the command line."""

    M = "m"
    CM = "cm"
    MM = "mm"

    @property
    def per_metre(self) -> float:
        """How many of it make a metre."""
        return {"m": 1.0, "cm": 100.0, "mm": 1000.0}[self.value]


Triple = tuple[float, float, float]
Translation = Annotated[Triple, typer.Option(metavar="X Y Z", help="Position of o in {B}, in --unit.")]
Xyx = Annotated[Triple, typer.Option(metavar="ALPHA BETA LAMBDA", help="The paper's X-Y-X Euler angles in degrees.")]
Unit = Annotated[LengthUnit, typer.Option(help="Unit of lengths, in and out.")]
GeometryFile = Annotated[
    Path | None,
    typer.Option("--geometry", metavar="FILE", help="YAML file of dimensions in metres; the paper's if not given."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


Branches = Annotated[
    list[str] | None, typer.Option("--branch", help="Branch, such as TT+; may be repeated. All real ones if not given.")
]


def read_geometry(path: Path | None) -> Geometry:
    """Return the geometry of `--geometry`, or the paper's."""
    return Geometry.paper() if path is None else Geometry.from_yaml(path)


def read_pose(translation: Triple, xyx: Triple, unit: LengthUnit) -> RigidTransform:
    """Return the pose of `--translation`, `--xyx` and `--unit`."""
    return pose(np.array(translation) / unit.per_metre, xyx=np.deg2rad(xyx))


def chosen(solutions: SolutionSet, labels: list[str] | None) -> list[str]:
    """Return the branches of `--branch`, or all real ones; raises `ArgumentError` where one is not real."""
    real = [label for label, exists in zip(solutions.labels, solutions.exists, strict=True) if exists]
    absent = [label for label in labels or () if label not in real]
    if absent:
        raise ArgumentError("--branch", f"real branches, here {', '.join(real) or 'none'}", ", ".join(absent))
    return real if labels is None else labels
