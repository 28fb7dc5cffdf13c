"""Reading a URDF for a `ClosedChain`, and whether it is the tree of a machine at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.description.robot import check_inertials
from spm_pin.description.source_files import URDF, check_prefix, description_file, urdf_text
from spm_pin.errors import DescriptionError, GeometryError
from spm_pin.mechanism.arguments import check_instance, file_path
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS
from spm_pin.multibody.constrained_model import AGREEMENT


def read_description(path: str | Path | None, geometry: Geometry | None, prefix: str) -> tuple[str, Geometry]:
    """Return the text of a URDF and its geometry, as `ClosedChain.from_urdf` takes them, with its errors."""
    check_prefix(prefix)
    machine = Geometry.paper() if geometry is None else check_instance(geometry, Geometry, "geometry")
    if machine == Geometry.paper() and prefix == "":
        expected = description_file(URDF).read_text(encoding="utf-8")
    else:
        expected = urdf_text(machine, prefix=prefix)
    if path is None:
        return expected, machine
    file = file_path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(file), "a readable URDF file", str(error)) from error
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        cause = "Not expanded yet? xacro writes the URDF" if file.suffix == ".xacro" else ""
        raise DescriptionError(str(file), "a URDF", str(error), cause) from error
    check_inertials(text, str(file))
    _check_tree(model, pin.buildModelFromXML(expected), str(file), machine.middle_side)
    return text, machine


def _check_tree(model: Any, expected: Any, path: str, side: float) -> None:
    """Raise `DescriptionError` unless both trees have the same joints, and links that move alike.

    Of a link, its origin is compared and the points on its axes in the distance of the middle platform's side; all at
    one q with every joint away from zero, where each placement and each axis shows.
    """
    links = [frame.name for frame in expected.frames if frame.type == pin.FrameType.BODY]
    joints, wanted = set(model.names), set(expected.names)
    missing = sorted(wanted - joints) + [name for name in links if not model.existFrame(name, pin.FrameType.BODY)]
    foreign = sorted(joints - wanted)
    cause = "The arguments geometry and prefix are those the file was written for, by default the paper's and none"
    if missing or foreign or model.nq != expected.nq:
        names = (f"{', '.join(names[:3]) or 'none'}{', …' * (len(names) > 3)}" for names in (missing, foreign))
        received = "{} missing, {} foreign, nq = {}".format(*names, model.nq)
        raise DescriptionError(path, "the joints and links of the description", received, cause)
    values = dict(zip(expected.names[1:], np.linspace(0.2, 0.9, expected.nq), strict=True))
    places = []
    for tree in (model, expected):
        data = tree.createData()
        pin.framesForwardKinematics(tree, data, np.array([values[name] for name in tree.names[1:]]))
        places.append(np.array([data.oMf[tree.getFrameId(link)].homogeneous for link in links]))
    off = np.abs((places[0] - places[1]) * [side, side, side, 1.0]).max(axis=(-1, -2))
    if off.max() > AGREEMENT * side:
        received = f"{links[int(off.argmax())]} {off.max():.1e} m off where all joints are turned"
        cause = f"Another joint axis, order or zero, which follows from the leg limits? {cause}"
        raise DescriptionError(path, "the tree of the description for this geometry", received, cause)


def check_same_machine(geometry: Geometry, expected: Geometry, argument: str, owner: str) -> None:
    """Raise `GeometryError` unless both have the same dimensions and legs; limits only choose the tree's zero."""
    dimensions, legs = ("base_radius", "platform_radius", "middle_side"), ("axes", "pivots", "balls", "offsets")
    for name in (*dimensions, *legs):
        received, wanted = (
            np.asarray(getattr(g if name in dimensions else g.legs, name)) for g in (geometry, expected)
        )
        apart, unit = np.abs(received - wanted), "rad" if name == "axes" else "m"
        if apart.max() > AGREEMENT * (1.0 if name == "axes" else expected.middle_side):
            if not apart.ndim:
                raise GeometryError(argument, f"the {name} of {owner}, {wanted:.9g} m", f"{received:.9g} m")
            leg = LEGS[int(apart.argmax()) * len(LEGS) // apart.size]
            difference = f"a machine that differs by {apart.max():.1e} {unit} in {leg}"
            raise GeometryError(argument, f"the {name} of {owner}", difference)
