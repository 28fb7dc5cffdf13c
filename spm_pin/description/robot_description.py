"""A robot: links, joints, closures, transmissions; readers return it and writers take it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.closures import Closure
from spm_pin.description.robot_parts import Joint, Link, Transmission
from spm_pin.errors import DescriptionError
from spm_pin.mechanism.arguments import FloatArray

ASSEMBLED = 1e-9
"""Largest gap [m] of a closure, and largest angle [rad] of a weld, at which a robot counts as assembled."""


@dataclass(frozen=True)
class RobotDescription:
    """A spanning tree and what closes and drives it.

    Raises
    ------
    DescriptionError
        If a name occurs twice or is that of nothing, the joints do not make a tree, a closure is there twice, or a
        state does not have a value for each moving joint. The error names the link, joint, frame or closure.
    """

    name: str
    """Name of the robot."""
    links: tuple[Link, ...]
    """The bodies."""
    joints: tuple[Joint, ...]
    """The joints, which make the links a tree with one root, the base."""
    closures: tuple[Closure, ...] = ()
    """Closures of loops, between links."""
    transmissions: tuple[Transmission, ...] = ()
    """The actuated joints, in the order of the actuators."""
    states: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named values of all moving joints; zero is a state without a name."""

    def __post_init__(self) -> None:
        for what in ("links", "joints", "closures", "transmissions"):
            _unique(what, [part.name for part in getattr(self, what)])
        self._check_tree()
        pairs: dict[frozenset[str], str] = {}
        for closure in self.closures:
            for frame in (closure.frame_a, closure.frame_b):
                if frame not in self.link:
                    cause = f"Named by the closure {closure.name}"
                    raise DescriptionError("closures", f"links of {self.name}", f"no link {frame!r}", cause)
            first = pairs.setdefault(closure.pair, closure.name)
            if first != closure.name:
                received = f"{closure.frame_a} and {closure.frame_b} in {first} and in {closure.name}"
                raise DescriptionError("closures", "each pair of frames once", received)
        moving = {joint.name for joint in self.joints if joint.moves}
        _unique("transmissions", [transmission.joint for transmission in self.transmissions], "joints driven")
        for transmission in self.transmissions:
            if transmission.joint not in moving:
                received = f"{transmission.joint!r} in {transmission.name}"
                raise DescriptionError("transmissions", f"moving joints of {self.name}", received)
        for name, values in self.states.items():
            if values.keys() != moving:
                wrong = f"{', '.join(sorted(moving ^ values.keys()))} missing or too much in {name}"
                raise DescriptionError("states", "a value for each moving joint", wrong)
            if not all(math.isfinite(value) for value in values.values()):
                raise DescriptionError("states", "finite joint values", f"another one in {name}")

    @cached_property
    def link(self) -> dict[str, Link]:
        """The links by name."""
        return {link.name: link for link in self.links}

    @cached_property
    def joint_to(self) -> dict[str, Joint]:
        """The joint that carries a link, by the link's name; none for the base."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def base(self) -> str:
        """Name of the root link."""
        (root,) = self.link.keys() - self.joint_to.keys()
        return root

    @cached_property
    def order(self) -> tuple[Joint, ...]:
        """The joints depth first, those that leave one link by name: Pinocchio's order when it reads a URDF."""
        leaving: dict[str, list[Joint]] = {}
        for joint in sorted(self.joints, key=lambda joint: joint.name, reverse=True):
            leaving.setdefault(joint.parent, []).append(joint)
        found: list[Joint] = []
        stack = list(leaving.get(self.base, ()))
        while stack:
            found.append(stack.pop())
            stack.extend(leaving.get(found[-1].child, ()))
        return tuple(found)

    @property
    def moving(self) -> tuple[Joint, ...]:
        """The joints with a degree of freedom, in the order of `order`: q of the exports."""
        return tuple(joint for joint in self.order if joint.moves)

    def frames(self, values: Mapping[str, float] | None = None) -> dict[str, FloatArray]:
        """Return the pose (4, 4) of each link in the base, at joint values by name; a joint not named is at zero."""
        foreign = (values or {}).keys() - {joint.name for joint in self.moving}
        if foreign:
            raise DescriptionError("values", f"moving joints of {self.name}", ", ".join(sorted(foreign)))
        found = {self.base: np.eye(4)}
        for joint in self.order:
            value = values.get(joint.name, 0.0) if values else 0.0
            found[joint.child] = found[joint.parent] @ joint.placement.matrix @ joint.motion(value)
        return found

    def carrier(self, link: str) -> tuple[str, FloatArray]:
        """Return the link that moves a link, itself or the one it is fixed to in the end, and its pose (4, 4) there."""
        pose = np.eye(4)
        while link in self.joint_to and not self.joint_to[link].moves:
            pose = self.joint_to[link].placement.matrix @ pose
            link = self.joint_to[link].parent
        return link, pose

    def open_closures(self, values: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the closures open by more than `ASSEMBLED` at joint values, zero if not given, and by how much."""
        frames = self.frames(values)
        gaps: dict[str, float] = {}
        for closure in self.closures:
            relative = np.linalg.inv(frames[closure.frame_a]) @ frames[closure.frame_b]
            gap = float(np.linalg.norm(relative[:3, 3]))
            if closure.kind == "weld":
                gap = max(gap, float(Rotation.from_matrix(relative[:3, :3]).magnitude()))
            if not gap <= ASSEMBLED:
                gaps[closure.name] = gap
        return gaps

    def _check_tree(self) -> None:
        for joint in self.joints:
            for end in (joint.parent, joint.child):
                if end not in self.link:
                    raise DescriptionError("joints", f"links of {self.name}", f"{end!r} in the joint {joint.name}")
        _unique("joints", [joint.child for joint in self.joints], "links carried")
        roots = [name for name in self.link if name not in self.joint_to]
        if len(roots) != 1:
            received = f"{len(roots)}: {', '.join(roots)}" if roots else "none: the joints run in a circle"
            raise DescriptionError("joints", "a tree with one root link", received)
        reached = {self.base, *(joint.child for joint in self.order)}
        if len(reached) < len(self.links):
            received = f"a circle through {', '.join(sorted(self.link.keys() - reached))}"
            raise DescriptionError("joints", "a tree", received, "A loop is cut, and closed by a closure")


def _unique(argument: str, names: Iterable[str], what: str = "names") -> None:
    seen: set[str] = set()
    for name in names:
        if name == "universe":
            raise DescriptionError(argument, "names other than 'universe', Pinocchio's of the root", repr(name))
        if name in seen:
            raise DescriptionError(argument, f"{what} that occur once", f"{name!r} twice")
        seen.add(name)
