"""Reading a URDF for a `ClosedChain`: its dimensions, and whether it is the description's tree at all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.description.expand import expand
from spm_pin.description.read_urdf import check_inertials
from spm_pin.description.tree import JOINTS, SLIDES
from spm_pin.errors import DescriptionError, GeometryError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry, LegLimits
from spm_pin.mechanism.joint_angles import home_lengths
from spm_pin.multibody.joint_layout import AGREEMENT, DIMENSIONS

__all__ = ["read_chain_urdf"]

PLATFORMS = ("base", "middle_platform", "terminal_platform")
ENDS = tuple(end + i for i in "123" for end in ("base_a", "middle_b", "terminal_c")) + tuple(
    f"leg_{leg}_tip" for leg in ("b1", "b2", "b3", "c1", "c2", "c3")
)
"""The links that legs end at."""


def read_chain_urdf(path: Path, geometry: Geometry | None, prefix: str) -> tuple[str, Geometry]:
    """Return the text of a URDF file and its dimensions.

    Parameters
    ----------
    path : Path
        The file.
    geometry : Geometry, optional
        What the file is expected to describe. By default its dimensions are measured in the tree at zero; its
        limits are those of the slides, or none if these do not give the tree's home.
    prefix : str
        Before the name of every link and joint.

    Raises
    ------
    DescriptionError
        If the file cannot be read, or is not the tree of the description for these dimensions: same joints, frames
        of the same names at the same places. Inertias, shapes and limits may differ, but inertias must be possible.
    GeometryError
        If its dimensions are not those of `geometry`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), "a readable URDF file", str(error)) from error
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        cause = "Not expanded yet? xacro writes the URDF" if path.suffix == ".xacro" else ""
        raise DescriptionError(str(path), "a URDF", str(error), cause) from error
    check_inertials(text, str(path))
    names = set(model.names) - {"universe"}
    expected = {prefix + joint for joint in JOINTS}
    if names != expected or model.nq != len(JOINTS):
        missing, foreign = sorted(expected - names), sorted(names - expected)
        received = f"{', '.join(missing) or 'none'} missing, {', '.join(foreign) or 'none'} foreign, nq = {model.nq}"
        what = f"the joints of the description, one degree of freedom each, with the prefix {prefix!r}"
        raise DescriptionError(str(path), what, received)
    links = [prefix + link for link in (*PLATFORMS, *ENDS)]
    absent = [link for link in links if not model.existFrame(link, pin.FrameType.BODY)]
    if absent:
        raise DescriptionError(str(path), "the links of the description", f"no {', '.join(absent)}")
    measured = _measured(model, prefix)
    geometry = geometry or measured
    for name in DIMENSIONS:
        size, found = getattr(geometry, name), getattr(measured, name)
        if abs(size - found) > AGREEMENT * found:
            raise GeometryError("geometry", f"the {name} of {path}, {found:.9g} m", f"{size:.9g} m")
    expected_model = pin.buildModelFromXML(expand(geometry, prefix=prefix))
    link, distance = _deviation(model, expected_model, links, geometry.middle_side)
    if distance > AGREEMENT * geometry.middle_side:
        cause = "Another joint axis, order or zero? The zero follows from the leg limits the URDF was made for"
        raise DescriptionError(str(path), "the tree of the description", f"{link} {distance:.1e} m off", cause)
    return text, geometry


def _placements(model: Any, q: FloatArray, links: Iterable[str]) -> dict[str, Any]:
    """Return the poses of links in {B} as pinocchio.SE3."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return {link: data.oMf[model.getFrameId(link)].copy() for link in links}


def _measured(model: Any, prefix: str) -> Geometry:
    """Return the dimensions of a tree at zero, with the limits of its slides if they give its home, else without."""
    found = _placements(model, pin.neutral(model), [prefix + link for link in (*PLATFORMS, *ENDS)])

    def distance(a: str, b: str) -> float:
        return float(np.linalg.norm(found[prefix + a].translation - found[prefix + b].translation))

    dimensions = (
        distance("base", "base_a1"),
        distance("terminal_platform", "terminal_c1"),
        distance("middle_b1", "middle_b2"),
    )
    home = np.repeat([distance("base_a1", "leg_b1_tip"), distance("terminal_c1", "leg_c1_tip")], 3)
    slides = [model.joints[model.getJointId(prefix + slide)].idx_q for slide in SLIDES]
    shortest = np.maximum(home + model.lowerPositionLimit[slides], 0.0)
    longest = home + model.upperPositionLimit[slides]
    with contextlib.suppress(GeometryError):
        limited = Geometry(*dimensions, LegLimits(shortest.tolist(), longest.tolist()))
        if np.allclose(home_lengths(limited), home[[0, 3]], rtol=AGREEMENT, atol=0.0):
            return limited
    return Geometry(*dimensions)


def _deviation(model: Any, expected: Any, links: Sequence[str], side: float) -> tuple[str, float]:
    """Return the link whose frame in `model` is farthest from that in `expected`, and how far [m].

    Of a frame, its origin is compared and the points at `side` [m] on its axes; all at one q with every joint away
    from zero, where each placement and each axis shows.
    """
    values = dict(zip(expected.names[1:], np.linspace(0.2, 0.9, expected.nq), strict=True))
    found, sought = (_placements(tree, _vector(tree, values), links) for tree in (model, expected))
    lever = np.array([side, side, side, 1.0])
    off = {a: float(np.abs((found[a].homogeneous - sought[a].homogeneous) * lever).max()) for a in links}
    worst = max(off, key=lambda link: off[link])
    return worst, off[worst]


def _vector(model: Any, values: Mapping[str, float]) -> FloatArray:
    q = np.empty(model.nq)
    for name, value in values.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q
