"""XML files of robots: the file, its elements and their numbers, with errors that say where."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from spm_pin.errors import DescriptionError
from spm_pin.support.arguments import FloatArray
from spm_pin.support.files import file_path


def read_source(source: Any, beginning: str, kind: str, argument: str = "source") -> tuple[str, str]:
    """Return the text of a file, or of a source that is a text itself, and a name for messages."""
    if isinstance(source, str) and (source.lstrip().startswith(beginning) or "\n" in source):
        return source, "text"
    path = file_path(source, argument, expected=f"{kind} or its text")
    try:
        return path.read_text(encoding="utf-8"), str(path)
    except (OSError, ValueError) as error:
        raise DescriptionError(str(path), f"{kind} or its text", str(error)) from None


def read_xml(source: Any, root: str, kind: str, argument: str = "source") -> tuple[Element, str]:
    """Return the root element of a file or text, and a name for messages; `drake:tag` is read as `drake_tag`."""
    text, where = read_source(source, "<", kind, argument)
    try:
        # Drake itself does not need its prefix to be declared.
        found = ElementTree.fromstring(text.replace("<drake:", "<drake_").replace("</drake:", "</drake_"))
    except (ElementTree.ParseError, ValueError) as error:
        line = getattr(error, "position", (0, 0))[0]
        raise DescriptionError(f"{where}:{line}" if line else where, "well-formed XML", str(error)) from None
    if found.tag != root:
        raise DescriptionError(where, f"{kind}, whose root is <{root}>", f"<{found.tag}>")
    return found, where


def name_of(node: Element, where: str, key: str = "name") -> str:
    """Return an attribute that must be there."""
    name = node.get(key)
    if not name:
        raise DescriptionError(where, f"an attribute {key!r} of <{node.tag}>", "none")
    return name


def numbers(text: str | None, count: int, where: str, default: Any = None, *, finite: bool = True) -> FloatArray:
    """Return `count` numbers of a text; the default if there is no text."""
    if (text is None or not text.strip()) and default is not None:
        return np.array(default, dtype=float).reshape(count)
    try:
        found = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        found = np.array([np.nan])
    if found.shape != (count,) or np.isnan(found).any() or (finite and np.isinf(found).any()):
        expected = f"{count} finite number{'s' if count > 1 else ''}" if finite else "a number"
        raise DescriptionError(where, expected, repr(text))
    return found


def number(text: str | None, where: str, default: float | None = None) -> float:
    """Return a number, which may be infinite; the default if there is no text."""
    return float(numbers(text, 1, where, default, finite=False)[0])


def unit_axis(text: str | None, where: str, default: Any) -> tuple[float, float, float]:
    """Return a direction as a unit vector."""
    axis = numbers(text, 3, where, default)
    if not axis.any():
        raise DescriptionError(where, "a direction", repr(text))
    # One that is exact already keeps its digits.
    x, y, z = axis if np.dot(axis, axis) == 1.0 else axis / np.linalg.norm(axis)
    return float(x), float(y), float(z)


def inertia_of(mass: float, moments: Any, placement: Any, where: str) -> Any:
    """Return a `pinocchio.Inertia` of a mass and of ixx, ixy, ixz, iyy, iyz, izz about its centre at `placement`."""
    if mass < 0.0:
        raise DescriptionError(where, "a mass that is not negative", f"{mass:g}")
    xx, xy, xz, yy, yz, zz = moments
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    tensor = placement.rotation @ tensor @ placement.rotation.T
    try:
        return pin.Inertia(mass, placement.translation, tensor)
    except RuntimeError:
        # Published files have moments that are negative by rounding or worse; Pinocchio's own reader takes them too.
        if mass == 0.0:
            return pin.Inertia.Zero()
        about_origin = tensor - mass * np.linalg.matrix_power(pin.skew(placement.translation), 2)
        lower = about_origin[[0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]]
        return pin.Inertia.FromDynamicParameters(np.array([mass, *(mass * placement.translation), *lower]))
