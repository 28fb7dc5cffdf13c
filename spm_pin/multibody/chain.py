"""The mechanism as a Pinocchio model whose loops are closed by constraints."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.description.closures import Closure, read_closures
from spm_pin.description.expand import expand
from spm_pin.description.paths import URDF, description_directory, description_file
from spm_pin.description.srdf import srdf_text
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.geometry import Geometry
from spm_pin.multibody.chain_paths import ChainPaths
from spm_pin.multibody.closures import ClosureConstraints
from spm_pin.multibody.loading import read_urdf
from spm_pin.multibody.mounting import MountedChain, joined, wrapped
from spm_pin.multibody.placement import Placement

__all__ = ["ClosedChain"]


class ClosedChain(ChainPaths):
    """The spanning tree of the description in Pinocchio, and the closures that make it the mechanism; read-only.

    Made by `from_urdf`. {B} is the link `base` and Pinocchio's universe. Methods take q, joint values [rad, m] in the
    order of `joint_names`, of one state or of a batch (..., 18), and raise `ArgumentError` if it has another shape, is
    not finite, or gives a leg a negative length. They keep nothing between calls: each makes its own `pinocchio.Data`,
    unless it is handed a `workspace`, which saves time. Pinocchio answers one state at a time, so that a batch takes
    as long as its members; the closed form is the way to millions.

    Parameters
    ----------
    urdf : str
        Text of the description expanded for `geometry` and `prefix`; not checked here.
    geometry : Geometry
        Its dimensions, and the limits that set its zero.
    prefix : str
        Before the name of every link and joint.
    """

    def __init__(self, urdf: str, geometry: Geometry, *, prefix: str = "") -> None:
        self._urdf = urdf
        self._geometry = geometry
        self._prefix = prefix
        self._model = pin.buildModelFromXML(urdf)
        self._closures = read_closures(prefix=prefix)
        self._constraints = ClosureConstraints(self._model, self._closures)
        self._placement = Placement(self._model, geometry, prefix)

    @classmethod
    def from_urdf(
        cls, path: str | Path | None = None, geometry: Geometry | None = None, *, prefix: str = ""
    ) -> ClosedChain:
        """Make a chain from the package's description, or from a URDF file expanded from it.

        Parameters
        ----------
        path : str or Path, optional
            A URDF of the description's tree, perhaps with other inertias, shapes and limits. The closures are the
            description's. By default the description itself, expanded for `geometry`.
        geometry : Geometry, optional
            The dimensions. By default those of the file, without a file the paper's.
        prefix : str
            Before the name of every link and joint: put there, or found in the file.

        Raises
        ------
        DescriptionError
            If the file cannot be read or is not the description's tree, or `prefix` cannot begin a name.
        GeometryError
            If the dimensions of the file are not those of `geometry`.
        """
        if geometry is not None and not isinstance(geometry, Geometry):
            raise ArgumentError("geometry", "a Geometry", type(geometry).__name__)
        if path is not None:
            return cls(*read_urdf(Path(path), geometry, prefix), prefix=prefix)
        paper = Geometry.paper()
        geometry = geometry or paper
        shipped = geometry == paper and prefix == ""
        text = description_file(URDF).read_text(encoding="utf-8") if shipped else expand(geometry, prefix=prefix)
        return cls(text, geometry, prefix=prefix)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return _rebuilt, (self._urdf, self._geometry, self._prefix)

    def __repr__(self) -> str:
        named = f" {self._prefix!r}" if self._prefix else ""
        return f"<ClosedChain{named}: {self._model.nq} joints, {len(self._closures)} closures, {self._geometry}>"

    @property
    def model(self) -> Any:
        """The spanning tree, a `pinocchio.Model`; do not change it."""
        return self._model

    @property
    def closures(self) -> tuple[Closure, ...]:
        """Where the tree is closed; the order of all that counts closures."""
        return self._closures

    @property
    def geometry(self) -> Geometry:
        """Dimensions and leg limits."""
        return self._geometry

    @property
    def leg_indices(self) -> npt.NDArray[np.intp]:
        """Where the slides of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 are in q, shape (6,)."""
        return self._placement.legs.copy()

    def joint_indices(self, *names: str) -> npt.NDArray[np.intp]:
        """Return where joints, named as in the URDF, are in q and in joint velocities, shape (n,).

        Raises
        ------
        ArgumentError
            If the chain has no joint of such a name.
        """
        return self._placement.indices(*(name.removeprefix(self._prefix) for name in names))

    @cached_property
    def visual_model(self) -> Any:
        """What is seen, a `pinocchio.GeometryModel`."""
        return pin.buildGeomFromUrdfString(
            self._model, self._urdf, pin.GeometryType.VISUAL, package_dirs=str(description_directory())
        )

    @cached_property
    def collision_model(self) -> Any:
        """What collides, a `pinocchio.GeometryModel`; the pairs leave out what touches by design."""
        shapes = pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.COLLISION)
        shapes.addAllCollisionPairs()
        pin.removeCollisionPairsFromXML(self._model, shapes, srdf_text({}, prefix=self._prefix))
        return shapes

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of the tree, which knows nothing of the closures."""
        return pin.RobotWrapper(self._model, self.collision_model, self.visual_model)

    def mounted_on(self, other: Any, frame: str, placement: Any = None) -> MountedChain:
        """Return this chain carried by another robot, as an arm carries a tool.

        Parameters
        ----------
        other : pinocchio.Model or pinocchio.RobotWrapper
            The robot that carries; its base stays where it is.
        frame : str
            A frame of it, such as `tool0`.
        placement : pinocchio.SE3, optional
            Of {B} in that frame; by default they coincide.

        Returns
        -------
        MountedChain
            Both in one model, the loops closed.

        Raises
        ------
        ArgumentError
            If an argument is malformed, or both robots have a link, joint or frame of the same name: `from_urdf` takes
            a prefix.
        """
        robot = wrapped(other)
        return self._mounted(robot.model, joined(robot, self.robot_wrapper(), frame, placement))

    def carrying(self, other: Any, frame: str = "terminal_platform", placement: Any = None) -> MountedChain:
        """Return this chain with another robot on it.

        Parameters
        ----------
        other : pinocchio.Model or pinocchio.RobotWrapper
            The robot that is carried; its universe is fixed to the frame.
        frame : str
            A link of the chain, without prefix.
        placement : pinocchio.SE3, optional
            Of the robot's universe in that frame; by default they coincide.

        Returns
        -------
        MountedChain
            As of `mounted_on`, with the same errors.
        """
        robot = wrapped(other)
        return self._mounted(robot.model, joined(self.robot_wrapper(), robot, f"{self._prefix}{frame}", placement))

    def _mounted(self, other: Any, both: tuple[Any, Any, Any]) -> MountedChain:
        return MountedChain(self, self._placement, self._constraints, other, both)


def _rebuilt(urdf: str, geometry: Geometry, prefix: str) -> ClosedChain:
    return ClosedChain(urdf, geometry, prefix=prefix)
