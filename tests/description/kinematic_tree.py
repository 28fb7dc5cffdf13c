"""Forward kinematics of a URDF, read with the standard library alone, as reference for all readers."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.description import SRDF_PATH, URDF_PATH, Closure, actuated_joints

Array = npt.NDArray[np.float64]


def vector(text: str | None) -> Array:
    return np.array([float(word) for word in (text or "0 0 0").split()])


def origin(element: ElementTree.Element) -> Array:
    """Pose (4, 4) in the `<origin>` of an element; roll, pitch and yaw are about fixed axes."""
    found = element.find("origin")
    matrix = np.eye(4)
    if found is not None:
        matrix[:3, :3] = Rotation.from_euler("xyz", vector(found.get("rpy"))).as_matrix()
        matrix[:3, 3] = vector(found.get("xyz"))
    return matrix


@dataclass(frozen=True)
class Joint:
    name: str
    kind: str
    parent: str
    child: str
    placement: Array
    axis: Array
    limit: Mapping[str, float]

    def motion(self, value: float) -> Array:
        matrix = np.eye(4)
        if self.kind == "revolute":
            matrix[:3, :3] = Rotation.from_rotvec(value * self.axis).as_matrix()
        elif self.kind == "prismatic":
            matrix[:3, 3] = value * self.axis
        return matrix


class KinematicTree:
    def __init__(self, urdf: str) -> None:
        self.root = ElementTree.fromstring(urdf)
        self.links = {str(link.get("name")): link for link in self.root.findall("link")}
        self.joints = {joint.name: joint for joint in map(self._joint, self.root.findall("joint"))}
        children = {joint.child: joint for joint in self.joints.values()}
        assert len(children) == len(self.joints) == len(self.links) - 1, "not a tree"
        (self.base,) = self.links.keys() - children.keys()
        self._children = children

    @staticmethod
    def _joint(element: ElementTree.Element) -> Joint:
        kind, limit = str(element.get("type")), element.find("limit")
        return Joint(
            str(element.get("name")),
            kind,
            str(element.find("parent").get("link")),
            str(element.find("child").get("link")),
            origin(element),
            np.zeros(3) if kind == "fixed" else vector(element.find("axis").get("xyz")),
            {} if limit is None else {key: float(value) for key, value in limit.items()},
        )

    @property
    def moving(self) -> dict[str, Joint]:
        return {name: joint for name, joint in self.joints.items() if joint.kind != "fixed"}

    def frames(self, values: Mapping[str, float]) -> dict[str, Array]:
        """Pose (4, 4) of every link in the root link; a joint not named is at zero."""
        found = {self.base: np.eye(4)}

        def pose(link: str) -> Array:
            if link not in found:
                joint = self._children[link]
                found[link] = pose(joint.parent) @ joint.placement @ joint.motion(values.get(joint.name, 0.0))
            return found[link]

        return {link: pose(link) for link in self.links}

    def gap(self, values: Mapping[str, float], closures: Iterable[Closure]) -> float:
        """Largest distance [m] between the two frames of a closure."""
        frames = self.frames(values)
        ends = [(frames[c.frame_a][:3, 3], frames[c.frame_b][:3, 3]) for c in closures]
        assert len(ends) == 4
        return max(float(np.linalg.norm(a - b)) for a, b in ends)

    def random_values(self, rng: np.random.Generator) -> dict[str, float]:
        """Joint values anywhere in their ranges: the tree is open there, and every joint shows in its frames."""
        return {name: rng.uniform(j.limit["lower"], j.limit["upper"]) for name, j in self.moving.items()}


def named_states(srdf: str) -> dict[str, dict[str, float]]:
    return {
        str(state.get("name")): {str(j.get("name")): float(str(j.get("value"))) for j in state.findall("joint")}
        for state in ElementTree.fromstring(srdf).findall("group_state")
    }


def inertia(link: ElementTree.Element) -> tuple[float, Array, Array]:
    """Mass [kg], pose (4, 4) of the inertial frame in the link, and the inertia (3, 3) in that frame [kg m²]."""
    inertial = link.find("inertial")
    assert inertial is not None, "a link without inertia"
    assert inertial.find("origin") is not None, "an inertia without an origin"
    mass, moments = inertial.find("mass"), inertial.find("inertia")
    matrix = np.zeros((3, 3))
    for i, j in itertools.combinations_with_replacement(range(3), 2):
        matrix[i, j] = matrix[j, i] = float(str(moments.get("i" + "xyz"[i] + "xyz"[j])))
    return float(str(mass.get("value"))), origin(inertial), matrix


TREE = KinematicTree(Path(URDF_PATH).read_text(encoding="utf-8"))
STATES = named_states(Path(SRDF_PATH).read_text(encoding="utf-8"))
SLIDES = actuated_joints()
"""The shipped robot, and its named states."""
