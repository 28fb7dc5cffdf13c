"""Reading a URDF for a `ClosedChain`: its dimensions, and whether it is the description's tree at all."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.description.robot import check_inertials
from spm_pin.description.source_files import URDF, check_prefix, description_file, urdf_text
from spm_pin.description.tree import JOINTS, SLIDES
from spm_pin.errors import DescriptionError, GeometryError
from spm_pin.mechanism.arguments import FloatArray, check_instance, file_path
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_frames import home_lengths
from spm_pin.mechanism.leg_limits import LegLimits
from spm_pin.multibody.joint_layout import AGREEMENT, require_dimensions

LINKS = (
    *("base", "middle_platform", "terminal_platform"),
    *(end + i for i in "123" for end in ("base_a", "middle_b", "terminal_c")),
    *("middle_b2_upper", "middle_b3_upper"),
    *(f"leg_{leg}_tip" for leg in ("b1", "b2", "b3", "c1", "c2", "c3")),
)
"""The platforms, and the links that legs end at."""


def read_description(path: str | Path | None, geometry: Geometry | None, prefix: str) -> tuple[str, Geometry]:
    """Return the text of a URDF and its dimensions, as `ClosedChain.from_urdf` takes them, with its errors.

    Without `geometry`, the dimensions of a file are measured in the tree at zero; its limits are those of the slides,
    or none if these do not give the tree's home.
    """
    check_prefix(prefix)
    if geometry is not None:
        check_instance(geometry, Geometry, "geometry")
    if path is not None:
        return _read_file(file_path(path), geometry, prefix)
    paper = Geometry.paper()
    if (geometry or paper) == paper and prefix == "":
        return description_file(URDF).read_text(encoding="utf-8"), geometry or paper
    return urdf_text(geometry or paper, prefix=prefix), geometry or paper


def _read_file(path: Path, geometry: Geometry | None, prefix: str) -> tuple[str, Geometry]:
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
    links = [prefix + link for link in LINKS]
    absent = [link for link in links if not model.existFrame(link, pin.FrameType.BODY)]
    if absent:
        raise DescriptionError(str(path), "the links of the description", f"no {', '.join(absent)}")
    as_built = geometry is not None and not geometry.is_nominal
    if not as_built:
        measured = _measured(model, prefix, _placements(model, pin.neutral(model), links))
        geometry = geometry or measured
        require_dimensions(geometry, measured, "geometry", str(path))
    assert geometry is not None
    side = geometry.nominal.middle_side
    link, distance = _deviation(model, pin.buildModelFromXML(urdf_text(geometry, prefix=prefix)), links, side)
    if distance > AGREEMENT * side:
        if as_built:
            received = f"others: {link} is {distance:.1e} m off where all joints are turned"
            cause = "Another machine or calibration, or other nominal leg limits, which set the zero?"
            raise GeometryError("geometry", f"the dimensions of {path}", received, cause)
        cause = "Another joint axis, order or zero? Of a machine as built, pass its geometry, which has the offsets too"
        raise DescriptionError(str(path), "the tree of the description", f"{link} {distance:.1e} m off", cause)
    return text, geometry


def _placements(model: Any, q: FloatArray, links: list[str]) -> dict[str, FloatArray]:
    """Return the poses of links in {B}, (4, 4)."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return {link: data.oMf[model.getFrameId(link)].homogeneous for link in links}


def _measured(model: Any, prefix: str, zero: dict[str, FloatArray]) -> Geometry:
    """Return the dimensions of a tree at zero, with the limits of its slides if they give its home, else without."""

    def distance(a: str, b: str) -> float:
        return float(np.linalg.norm(zero[prefix + a][:3, 3] - zero[prefix + b][:3, 3]))

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


def _deviation(model: Any, expected: Any, links: list[str], side: float) -> tuple[str, float]:
    """Return the link whose frame in `model` is farthest from that in `expected`, and how far [m].

    Of a frame, its origin is compared and the points on its axes in the distance of the middle platform's side; all at
    one q with every joint away from zero, where each placement and each axis shows.
    """
    values = dict(zip(expected.names[1:], np.linspace(0.2, 0.9, expected.nq), strict=True))
    found, sought = (
        _placements(tree, np.array([values[name] for name in tree.names[1:]]), links) for tree in (model, expected)
    )
    lever = np.array([side] * 3 + [1.0])
    off = {link: float(np.abs((found[link] - sought[link]) * lever).max()) for link in links}
    return max(off.items(), key=lambda item: item[1])
