"""The description's files, and the URDF that xacro makes of them for any geometry."""

from __future__ import annotations

import re
import tempfile
import threading
from pathlib import Path
from xml.etree import ElementTree

from spm_pin.description.masses import Masses, put_masses
from spm_pin.errors import DescriptionError, raised_as
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import as_bool, check_instance, writing
from spm_pin.mechanism.geometry import config_directory

# Names of files; `spm_pin.description` says what each is.
ENTRY = "spm.urdf.xacro"
URDF = "spm.urdf"
SRDF = "spm.srdf"
MJCF = "spm.xml"
SDF = "spm.sdf"
EXTENDED_URDF = "spm_closures.yaml"
CLOSURES = "config/closures.yaml"
"""The closures as this package reads them."""
MESHES = "meshes"
"""The folder of the solids that are drawn, OBJ files without unit: the URDF scales them."""

# xacro keeps its state in module globals.
_XACRO = threading.Lock()


def description_directory() -> Path:
    """Return the folder of the description: `urdf` in a checkout, `share/spm_description` in an installed package."""
    return config_directory().parent


def description_file(name: str) -> Path:
    """Return the path of one description file, by its path relative to the description's folder, such as `URDF`."""
    path = description_directory() / name
    if not path.is_file():
        raise DescriptionError("name", "a file of the description", str(path), "An incomplete installation?")
    return path


def copy_meshes(folder: Path) -> None:
    """Copy the meshes into the folder `MESHES` of a folder, for a file there that names them relative to itself.

    A file of the same name with another content is left as it is, and is a `DescriptionError`.
    """
    target = folder / MESHES
    for source in sorted((description_directory() / MESHES).iterdir()):
        copy, content = target / source.name, source.read_bytes()
        with raised_as(DescriptionError), writing(copy, "out"):
            if copy.exists() and copy.read_bytes() != content:
                cause = "Of another version? Move it away"
                raise DescriptionError("out", "no other meshes beside the file", str(copy), cause)
            target.mkdir(exist_ok=True)
            copy.write_bytes(content)


def check_prefix(prefix: str) -> None:
    """Raise `DescriptionError` unless `prefix` can begin a name in xacro, URDF, SRDF and YAML."""
    well_formed = isinstance(prefix, str) and re.fullmatch(r"([A-Za-z_][A-Za-z0-9_./-]*)?", prefix)
    # xacro turns these words into numbers and truth values, and so into other names.
    if not well_formed or prefix.lower() in ("inf", "infinity", "nan", "true", "false"):
        expected = "a name such as left_, of letters, digits and _ . / -, beginning with a letter"
        raise DescriptionError("prefix", expected, repr(prefix))


def urdf_text(
    geometry: Geometry | None = None,
    *,
    prefix: str = "",
    meshes: str | None = None,
    ros_constraints: bool = False,
    masses: Masses | None = None,
) -> str:
    """Return the URDF of a manipulator: its spanning tree, the loops closed by Drake's ball constraints.

    Parameters
    ----------
    geometry : Geometry, optional
        By default the paper's.
    prefix : str
        Before the name of every link, joint, transmission, actuator and material, so that robots can share a model.
    meshes : str
        The folder of the meshes as the URDF is to name it: ``"meshes"`` beside the URDF, or
        ``"package://spm_description/meshes"``. By default the absolute path of this installation's.
    ros_constraints : bool
        Close the loops by `<constraint>` as well, as proposed in https://github.com/ros/urdfdom/pull/264.
    masses : Masses, optional
        Of the machine's bodies, and a payload. By default assumed ones, in proportion to the machine's size.
    """
    import xacro

    check_prefix(prefix)
    as_bool(ros_constraints, "ros_constraints")
    if meshes is not None and (not isinstance(meshes, str) or not meshes.isprintable()):
        raise DescriptionError("meshes", "the folder of the meshes as text, or None", repr(meshes))
    machine = Geometry.paper() if geometry is None else check_instance(geometry, Geometry, "geometry")
    if masses is not None:
        check_instance(masses, Masses, "masses")
    with tempfile.TemporaryDirectory() as folder, _XACRO:
        path = Path(folder) / "geometry.yaml"
        machine.to_yaml(path)
        folder_of_meshes = (description_directory() / MESHES).as_posix() if meshes is None else meshes
        mappings = {"prefix": prefix, "geometry": str(path), "meshes": folder_of_meshes}
        expanded = xacro.process_file(str(description_file(ENTRY)), mappings=mappings)
    if masses is not None:
        put_masses(masses, expanded, prefix)
    # xacro's banner holds the path of this machine's copy; the source's own comment stays.
    while expanded.firstChild is not expanded.documentElement:
        expanded.removeChild(expanded.firstChild).unlink()
    banner = f" Expanded from {ENTRY}, which is the place for changes. "
    expanded.insertBefore(expanded.createComment(banner), expanded.documentElement)
    text = str(expanded.toprettyxml(indent="  "))
    return text.replace("</robot>", f"{_ros_constraints(text)}</robot>") if ros_constraints else text


def _ros_constraints(urdf: str) -> str:
    """Return Drake's closures of a URDF as the elements proposed for ROS."""
    lines = []
    for ball in ElementTree.fromstring(urdf).iter(DRAKE_BALL):
        a, b = (str(end.get("name")) for end in ball if end.get("name"))
        ends = (
            f'    <{end} link="{link}"/>\n    <{end}_origin xyz="0 0 0" rpy="0 0 0"/>'
            for end, link in (("parent", a), ("child", b))
        )
        lines += [f'  <constraint name="{a}_{b}" type="spherical_joint">', *ends, "  </constraint>"]
    return "\n".join([*lines, ""])


DRAKE_BALL = "{http://drake.mit.edu}ball_constraint"
"""Drake's element of a closure, as ElementTree names it."""
