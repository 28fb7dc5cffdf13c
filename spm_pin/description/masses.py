"""Masses of a machine's bodies in place of the assumed ones of `config/inertials.yaml`, and a payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any
from xml.dom.minidom import Document, Element, parseString

import numpy as np
import numpy.typing as npt
import yaml
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError, DescriptionError, raised_as
from spm_pin.mechanism.arguments import (
    FloatArray,
    check_instance,
    file_path,
    frozen,
    real_array,
    real_number,
    symmetric_matrices,
)

_KEYS = {"mass", "centre", "inertia"}
_LINK = "terminal_platform"
"""The link that carries the payload; its frame is {m}."""


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass, centre of mass and inertia of a rigid body.

    Parameters
    ----------
    mass : float
        [kg], not negative.
    centre : array_like, shape (3,)
        Its centre of mass in the frame of the body that has it or carries it [m].
    inertia : array_like, shape (3, 3), optional
        About its centre of mass in the axes of that frame [kg m²]; a point mass by default.
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
            expected = "principal moments of a body: none negative or above the sum"
            raise ArgumentError("inertia", expected + " of the other two", f"moments {moments}", "About another point?")
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "centre", frozen(centre.copy()))
        object.__setattr__(self, "inertia", frozen(inertia.copy()))


@dataclass(frozen=True, eq=False)
class Masses:
    """Masses of links in place of the assumed ones, and a payload on the terminal platform.

    Parameters
    ----------
    bodies : mapping of str to mapping
        By the names of links without prefix, or patterns such as ``leg_*_rod``; the last that fits counts. Each has
        "mass" [kg], and may have "centre" (3,) [m] and "inertia" (3, 3) [kg m²], about the centre of mass, both in the
        link's frame. What is left out is that of the assumed body, its inertia in proportion to the mass.
    payload : RigidBody, optional
        Fixed to the terminal platform, in {m}.
    """

    bodies: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    payload: RigidBody | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.bodies, Mapping):
            raise ArgumentError("bodies", "a mapping of names to masses", type(self.bodies).__name__)
        for name, body in self.bodies.items():
            named = isinstance(name, str) and isinstance(body, Mapping)
            if not named or "mass" not in body or set(body) - _KEYS:
                received = ", ".join(map(str, body)) if isinstance(body, Mapping) else type(body).__name__
                raise ArgumentError(f"bodies[{name}]", "a mapping with mass, and perhaps centre and inertia", received)
            _read_body(body, f"bodies[{name}]")
        if self.payload is not None:
            check_instance(self.payload, RigidBody, "payload")

    @classmethod
    def from_yaml(cls, path: str | Path) -> Masses:
        """Read a YAML file with the keys `bodies` and `payload`, each of which may be left out."""
        with raised_as(DescriptionError):
            file = file_path(path)
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise DescriptionError(str(file), "a readable YAML file", reason) from error
        if not isinstance(content, dict) or set(content) - {"bodies", "payload"}:
            received = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
            raise DescriptionError(str(file), "a mapping with the keys bodies and payload", received)
        try:
            payload = content.get("payload")
            if payload is not None and (not isinstance(payload, dict) or set(payload) - _KEYS):
                raise ArgumentError("payload", "a mapping with mass, and perhaps centre and inertia", payload)
            return cls(content.get("bodies") or {}, None if payload is None else _read_body(payload, "payload"))
        except ArgumentError as error:
            raise DescriptionError(f"{file}: {error.argument}", error.expected, error.received, error.cause) from error


def put_masses(masses: Masses, urdf: Document, prefix: str) -> None:
    """Replace the inertials of a URDF."""
    links = {link.getAttribute("name").removeprefix(prefix): link for link in urdf.getElementsByTagName("link")}
    changed: dict[str, RigidBody] = {}
    for pattern, body in masses.bodies.items():
        fitting = [name for name in links if fnmatchcase(name, pattern)]
        if not fitting:
            raise DescriptionError("masses", "names of links in the URDF, such as leg_b1_rod", repr(pattern))
        for name in fitting:
            assumed = _inertial(links[name])
            share = float(body["mass"]) / assumed.mass if assumed.mass else 0.0
            inertia = body.get("inertia", share * np.asarray(assumed.inertia))
            changed[name] = RigidBody(body["mass"], body.get("centre", assumed.centre), inertia)
    if masses.payload is not None:
        platform = changed[_LINK] if _LINK in changed else _inertial(links[_LINK])
        changed[_LINK] = _joined(platform, masses.payload)
    for name, one in changed.items():
        _write(links[name], one)


def with_masses(urdf: str, masses: Masses, prefix: str) -> str:
    """Return the text of a URDF with other masses."""
    document = parseString(urdf)
    put_masses(masses, document, prefix)
    return str(document.toxml())


def _joined(body: RigidBody, other: RigidBody) -> RigidBody:
    """Return two bodies, given in the same frame, as one."""
    mass, centres = body.mass + other.mass, [np.asarray(one.centre) for one in (body, other)]
    centre = (body.mass * centres[0] + other.mass * centres[1]) / mass if mass else centres[0]
    inertia = np.zeros((3, 3))
    for one, place in zip((body, other), centres, strict=True):
        arm = place - centre
        inertia += np.asarray(one.inertia) + one.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return RigidBody(mass, centre, inertia)


def _read_body(body: Mapping[str, Any], name: str) -> RigidBody:
    try:
        return RigidBody(**body)
    except (ArgumentError, TypeError) as error:
        if isinstance(error, TypeError):
            raise ArgumentError(name, "a mapping with mass", ", ".join(body)) from error
        raise ArgumentError(f"{name}.{error.argument}", error.expected, error.received, error.cause) from error


def _numbers(element: Element, attribute: str, default: str) -> FloatArray:
    return np.array((element.getAttribute(attribute) or default).split(), dtype=np.float64)


def _children(link: Element) -> tuple[Element, Element, Element]:
    """Return the elements of a link's inertial: origin, mass and inertia."""
    (inertial,) = link.getElementsByTagName("inertial")
    if not inertial.getElementsByTagName("origin"):
        inertial.appendChild(Element("origin"))
    origin, mass, inertia = (inertial.getElementsByTagName(tag)[0] for tag in ("origin", "mass", "inertia"))
    return origin, mass, inertia


def _inertial(link: Element) -> RigidBody:
    """Return the body of a link, in the link's axes."""
    origin, mass, inertia = _children(link)
    turn = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0")).as_matrix()
    xx, xy, xz, yy, yz, zz = (float(inertia.getAttribute(key) or 0.0) for key in _ENTRIES)
    moments = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return RigidBody(float(mass.getAttribute("value")), _numbers(origin, "xyz", "0 0 0"), 0.5 * (moments + moments.T))


_ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def _write(link: Element, body: RigidBody) -> None:
    """Write the inertial of a link, its axes the principal ones, which all formats can express."""
    origin, mass, inertia = _children(link)
    moments, axes = np.linalg.eigh(np.asarray(body.inertia))
    axes *= np.sign(np.linalg.det(axes))
    turn = Rotation.from_matrix(axes).as_euler("xyz", suppress_warnings=True)
    origin.setAttribute("xyz", " ".join(map(repr, np.asarray(body.centre).tolist())))
    origin.setAttribute("rpy", " ".join(map(repr, turn.tolist())))
    mass.setAttribute("value", repr(body.mass))
    diagonal = dict(zip(("ixx", "iyy", "izz"), np.maximum(moments, 0.0).tolist(), strict=True))
    for key in _ENTRIES:
        inertia.setAttribute(key, repr(diagonal.get(key, 0.0)))
