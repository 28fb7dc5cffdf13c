"""Masses of the links of a URDF: reading, checking, and replacement by those of a machine and its payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError, DescriptionError, raised_as
from spm_pin.support.arguments import FloatArray, check_instance, frozen, real_array, real_number, symmetric_matrices
from spm_pin.support.files import read_yaml
from spm_pin.support.pose import homogeneous

# Some readers of URDFs know Drake's elements by this prefix, not by its namespace.
ElementTree.register_namespace("drake", "http://drake.mit.edu")

_KEYS = {"mass", "centre", "inertia"}
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_PLATFORMS = "terminal_platform", "platform"
"""The link to which the payload is fixed, for a manipulator and for a stage."""
_LARGEST = 1e12
"""Largest mass [kg], moment of inertia [kg m²] and distance of a centre of mass [m] in a URDF."""

Numbers = tuple[float, ...]


class Placement(NamedTuple):
    """Placement of a frame in another: origin [m]; roll, pitch and yaw about the fixed x, y and z axes [rad]."""

    xyz: Numbers = (0.0, 0.0, 0.0)
    rpy: Numbers = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> Rotation:
        """The orientation."""
        return Rotation.from_euler("xyz", self.rpy)

    @property
    def matrix(self) -> FloatArray:
        """The homogeneous transform, shape (4, 4)."""
        return homogeneous(self.rotation.as_matrix(), np.array(self.xyz))


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass, centre of mass and inertia of a rigid body.

    Parameters
    ----------
    mass : float
        Mass [kg], not negative.
    centre : array_like, shape (3,)
        Centre of mass in the frame of the body, or of the body that carries it [m].
    inertia : array_like, shape (3, 3), optional
        Inertia about the centre of mass, in the axes of that frame [kg m²]; a point mass by default.
    """

    mass: float
    centre: npt.ArrayLike = (0.0, 0.0, 0.0)
    inertia: npt.ArrayLike = ((0.0,) * 3,) * 3

    def __post_init__(self) -> None:
        mass = real_number(self.mass, "mass", "a mass in kg, not negative", least=0.0)
        centre = real_array(self.centre, "centre", (3,), "the centre of mass in the body's frame in metres")
        inertia = symmetric_matrices(self.inertia, "inertia", 3, "about the centre of mass in kg m²")
        if centre.ndim != 1 or inertia.ndim != 2:
            raise ArgumentError("centre, inertia", "shapes (3,) and (3, 3)", f"{centre.shape} and {inertia.shape}")
        moments = np.linalg.eigvalsh(inertia)
        rounding = 1e-9 * abs(moments).max()
        if moments[0] < -rounding or moments[:2].sum() < moments[2] - rounding:
            expected = "principal moments of a body: none negative or above the sum of the other two"
            raise ArgumentError("inertia", expected, f"moments {moments}", "Is it about another point?")
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "centre", frozen(centre.copy()))
        object.__setattr__(self, "inertia", frozen(inertia.copy()))


@dataclass(frozen=True, eq=False)
class Masses:
    """Masses of links in place of the assumed ones of `config/inertials.yaml`, and a payload.

    Parameters
    ----------
    bodies : mapping of str to mapping
        Masses by the names of links without prefix, or patterns such as ``leg_*_rod``; the last match counts. Each has
        "mass" [kg], and may have "centre" (3,) [m] and "inertia" (3, 3) [kg m²], about the centre of mass, both in the
        link's frame. Other values are those of the assumed body, its inertia in proportion to the mass.
    payload : RigidBody, optional
        A body fixed to the terminal platform, in {m}, or to a stage's platform, in {n}.
    """

    bodies: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    payload: RigidBody | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.bodies, Mapping):
            raise ArgumentError("bodies", "a mapping of link names to masses", type(self.bodies).__name__)
        for name, body in self.bodies.items():
            if not isinstance(name, str):
                raise ArgumentError("bodies", "names of links as keys", repr(name))
            _read_body(body, f"bodies[{name}]")
        if self.payload is not None:
            check_instance(self.payload, RigidBody, "payload")

    @classmethod
    def from_yaml(cls, path: str | Path) -> Masses:
        """Read a YAML file with the keys `bodies` and `payload`, both optional."""
        with raised_as(DescriptionError):
            content = read_yaml(path)
        if not isinstance(content, dict) or set(content) - {"bodies", "payload"}:
            raise DescriptionError("", "a mapping with the keys bodies and payload", _keys(content), file=str(path))
        payload = content.get("payload")
        with raised_as(DescriptionError, file=str(path)):
            return cls(content.get("bodies") or {}, None if payload is None else _read_body(payload, "payload"))


def _read_body(body: Any, name: str) -> RigidBody:
    """Return the body of a mapping with the keys of `Masses.bodies`."""
    if not isinstance(body, Mapping) or "mass" not in body or set(body) - _KEYS:
        raise ArgumentError(name, "a mapping with mass, and optionally centre and inertia", _keys(body))
    try:
        return RigidBody(**body)
    except ArgumentError as error:
        raise error.replaced(argument=f"{name}.{error.argument}") from error


def _keys(content: Any) -> str:
    """Return the keys of a mapping, or the type of another value, for a message."""
    return ", ".join(map(str, content)) if isinstance(content, Mapping) else type(content).__name__


def with_masses(urdf: str, masses: Masses, prefix: str) -> str:
    """Return the text of a URDF with other masses."""
    root = ElementTree.fromstring(urdf, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
    links = {str(link.get("name")).removeprefix(prefix): link for link in root.iter("link")}
    links.pop("root", None)  # ROS requires that it has no mass
    changed: dict[str, RigidBody] = {}
    for pattern, body in masses.bodies.items():
        fitting = [name for name in links if fnmatchcase(name, pattern)]
        if not fitting:
            raise DescriptionError("masses", "names of links in the URDF, such as leg_b1_rod", repr(pattern))
        for name in fitting:
            assumed = _body(links[name])
            share = float(body["mass"]) / assumed.mass if assumed.mass else 0.0
            inertia = body.get("inertia", share * np.asarray(assumed.inertia))
            changed[name] = RigidBody(body["mass"], body.get("centre", assumed.centre), inertia)
    if masses.payload is not None:
        platform = next(name for name in _PLATFORMS if name in links)
        changed[platform] = _joined(changed.get(platform) or _body(links[platform]), masses.payload)
    for name, body_ in changed.items():
        _write(links[name], body_)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _joined(body: RigidBody, other: RigidBody) -> RigidBody:
    """Return two bodies, given in the same frame, as one."""
    mass, centres = body.mass + other.mass, [np.asarray(one.centre) for one in (body, other)]
    centre = (body.mass * centres[0] + other.mass * centres[1]) / mass if mass else centres[0]
    inertia = np.zeros((3, 3))
    for one, place in zip((body, other), centres, strict=True):
        arm = place - centre
        inertia += np.asarray(one.inertia) + one.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return RigidBody(mass, centre, inertia)


def numbers(node: Any, key: str, default: str = "") -> Numbers:
    """Return the numbers in an attribute of an element."""
    return tuple(map(float, node.get(key, default).split()))


def read_placement(node: Element) -> Placement:
    """Return the placement in the `<origin>` of an element, or the identity."""
    origin = node.find("origin")
    return Placement() if origin is None else Placement(*(numbers(origin, key, "0 0 0") for key in ("xyz", "rpy")))


def read_inertial(inertial: Element) -> tuple[float, Placement, FloatArray]:
    """Return the mass, the inertial frame and the moments of inertia (3, 3) about its axes."""
    (mass,) = numbers(inertial.find("mass"), "value")
    xx, xy, xz, yy, yz, zz = (numbers(inertial.find("inertia"), key)[0] for key in _MOMENTS)
    return mass, read_placement(inertial), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _body(link: Element) -> RigidBody:
    """Return the body of a link, in the link's axes; without an inertial its mass is zero."""
    inertial = link.find("inertial")
    if inertial is None:
        return RigidBody(0.0)
    mass, placement, moments = read_inertial(inertial)
    turn = placement.rotation.as_matrix()
    turned = turn @ moments @ turn.T
    return RigidBody(mass, placement.xyz, 0.5 * (turned + turned.T))


def _write(link: Element, body: RigidBody) -> None:
    """Replace the inertial of a link; its axes are the principal axes, which all formats can express."""
    for old in link.findall("inertial"):
        link.remove(old)
    moments, axes = np.linalg.eigh(np.asarray(body.inertia))
    axes *= np.sign(np.linalg.det(axes))
    turn = Rotation.from_matrix(axes).as_euler("xyz", suppress_warnings=True)
    inertial = SubElement(link, "inertial")
    places = {"xyz": np.asarray(body.centre), "rpy": turn}
    SubElement(inertial, "origin", {key: " ".join(map(repr, place.tolist())) for key, place in places.items()})
    SubElement(inertial, "mass", value=repr(body.mass))
    diagonal = dict(zip(("ixx", "iyy", "izz"), np.maximum(moments, 0.0).tolist(), strict=True))
    SubElement(inertial, "inertia", {key: repr(diagonal.get(key, 0.0)) for key in _MOMENTS})


def check_inertials(urdf: str, source: str) -> None:
    """Check masses and moments of inertia of a URDF's text, and that no joint has the name of a link.

    Pinocchio keeps both kinds of names in one list, and reads a mass of NaN as no mass. Errors call the text `source`.
    """
    root = ElementTree.fromstring(urdf)
    links = {str(link.get("name")): link.find("inertial") for link in root.iter("link")}
    for joint in root.findall("joint"):
        if joint.get("name") in links:
            cause = "Pinocchio keeps both in one list"
            raise DescriptionError(source, "names of joints that no link has", repr(joint.get("name")), cause)
    for name, inertial in links.items():
        if inertial is not None:
            _check_inertial(inertial, f"{source}, link {name}")


@raised_as(DescriptionError)
def _check_inertial(inertial: Element, place: str) -> None:
    try:
        mass, (centre, _), moments = read_inertial(inertial)
    except (AttributeError, ValueError, IndexError) as error:
        raise DescriptionError(place, "a <mass> and an <inertia> of numbers", str(error)) from error
    real_number(mass, place, f"a mass from 0 to {_LARGEST:g} kg", least=0.0, most=_LARGEST)
    if not np.all(np.abs([*centre, *moments.ravel()]) <= _LARGEST):
        expected = f"moments of inertia [kg m²] and a centre of mass [m] of at most {_LARGEST:g}"
        raise DescriptionError(place, expected, f"{moments.tolist()} and {centre}")
    least, largest = np.linalg.eigvalsh(moments)[[0, -1]]
    # A negligible violation comes from an exporter's rounding.
    if least < -1e-9 * largest or largest < 0.0:
        cause = "Products of inertia with the wrong sign, or not about the centre of mass?"
        raise DescriptionError(place, "moments of inertia of which none is negative", f"principal {least:g}", cause)
