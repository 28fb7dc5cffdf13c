"""The description's files: the closures, and the URDF that xacro makes for any machine."""

from __future__ import annotations

import re
import tempfile
import threading
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import yaml

from spm_pin.description.masses import Masses, with_masses
from spm_pin.errors import DescriptionError, raised_as
from spm_pin.machine import Manipulator
from spm_pin.machine.joint_angles import home_readings
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.machine.manipulator import config_directory
from spm_pin.support.arguments import as_bool, check_instance
from spm_pin.support.files import write_files

# Names of files; `spm_pin.description` documents them.
ENTRY = "spm.urdf.xacro"
STAGE_ENTRY = "stage.urdf.xacro"
_SOURCES = {"spm": (ENTRY, "geometry", "closures"), "stage": (STAGE_ENTRY, "stage", "stage_closures")}
"""By `Machine.file_stem`: entry, its argument for the machine's file, and the key of the closures."""
URDF = "spm.urdf"
SRDF = "spm.srdf"
MJCF = "spm.xml"
SDF = "spm.sdf"
EXTENDED_URDF = "spm_closures.yaml"
CLOSURES = "config/closures.yaml"
"""The closures as this package reads them."""
MESHES = "meshes"
"""The folder of the meshes, OBJ files without unit, which the URDF scales."""

# xacro keeps its state in module globals.
_XACRO = threading.Lock()


def description_directory() -> Path:
    """Return the folder of the description: `urdf` in a checkout, `share/spm_description` in an installed package."""
    return config_directory().parent


def description_file(name: str) -> Path:
    """Return the path of one description file, by its path relative to the description's folder, such as `URDF`."""
    path = description_directory() / name
    if not path.is_file():
        raise DescriptionError("name", "a file of the description", str(path), "Is the installation incomplete?")
    return path


def copy_meshes(folder: Path) -> None:
    """Copy the meshes into the folder `MESHES` beside a file, which names them relative to itself.

    A file of the same name with other content is not changed, and raises a `DescriptionError`.
    """
    sources = sorted((description_directory() / MESHES).iterdir())
    meshes: dict[Path, str | bytes] = {folder / MESHES / source.name: source.read_bytes() for source in sources}
    for copy, content in meshes.items():
        if copy.is_file() and copy.read_bytes() != content:
            cause = "Is it of another version? Move it away"
            raise DescriptionError("out", "no other meshes beside the file", str(copy), cause)
    with raised_as(DescriptionError):
        write_files(meshes, "out")


def check_prefix(prefix: str) -> None:
    """Raise `DescriptionError` unless `prefix` can begin a name in xacro, URDF, SRDF and YAML."""
    well_formed = isinstance(prefix, str) and re.fullmatch(r"([A-Za-z_][A-Za-z0-9_./-]*)?", prefix)
    # xacro evaluates these words as numbers and truth values, which gives other names.
    if not well_formed or prefix.lower() in ("inf", "infinity", "nan", "true", "false"):
        expected = "a name such as left_, of letters, digits and _ . / -, beginning with a letter"
        raise DescriptionError("prefix", expected, repr(prefix))


@dataclass(frozen=True)
class Closure:
    """Two frames at a cut loop, whose origins coincide in a ball joint."""

    name: str
    """Name of the closure."""
    frame_a: str
    """Name of the first frame, a link of the URDF."""
    frame_b: str
    """Name of the second frame, a link of the URDF."""


def read_closures(machine: Machine | None = None, *, prefix: str = "") -> tuple[Closure, ...]:
    """Return the closures of the robot, or of a `Stage`, from `config/closures.yaml`; names begin with `prefix`."""
    check_prefix(prefix)
    _, _, key = _SOURCES[machine_or_paper(machine).file_stem]
    entries = yaml.safe_load(description_file(CLOSURES).read_text(encoding="utf-8"))[key]
    return tuple(Closure(**{key: prefix + name for key, name in entry.items()}) for entry in entries)


def machine_or_paper(machine: Machine | None) -> Machine:
    """Return the given machine, or the paper's."""
    return Manipulator.paper() if machine is None else check_machine(machine)


def urdf_text(
    machine: Machine | None = None,
    *,
    prefix: str = "",
    meshes: str | None = None,
    ros_constraints: bool = False,
    masses: Masses | None = None,
    root: bool = False,
) -> str:
    """Return the URDF of a machine: its spanning tree, with loops closed by Drake's ball constraints.

    Parameters
    ----------
    machine : Manipulator or Stage, optional
        The manipulator, by default the paper's, or a stage alone.
    prefix : str
        Prefix of the name of every link, joint, transmission, actuator and material, so that robots can share a model.
    meshes : str
        Folder of the meshes in the URDF: ``"meshes"`` beside the URDF, or
        ``"package://spm_description/meshes"``. By default the absolute path in this installation.
    ros_constraints : bool
        Close the loops by `<constraint>` as well, as proposed in https://github.com/ros/urdfdom/pull/264.
    masses : Masses, optional
        Masses of the machine's bodies, and a payload. By default assumed ones, in proportion to the machine's size.
    root : bool
        Begin with a link `root` without inertia, to which `base` is fixed: in ROS, KDL warns of a root link
        with inertia.
    """
    check_prefix(prefix)
    as_bool(ros_constraints, "ros_constraints")
    if meshes is not None and (not isinstance(meshes, str) or not meshes.isprintable()):
        raise DescriptionError("meshes", "the folder of the meshes as text, or None", repr(meshes))
    machine = machine_or_paper(machine)
    home_readings(machine)
    entry, argument, _ = _SOURCES[machine.file_stem]
    if masses is not None:
        check_instance(masses, Masses, "masses")
    folder_of_meshes = (description_directory() / MESHES).as_posix() if meshes is None else meshes
    text = _expanded(entry, argument, machine, prefix, folder_of_meshes, as_bool(root, "root"))
    if masses is not None:
        text = with_masses(text, masses, prefix)
    if ros_constraints:
        elements = "".join(map(_ros_constraint, read_closures(machine, prefix=prefix)))
        text = text.replace("</robot>", f"{elements}</robot>")
    # xacro's own banner contains the path of this machine's copy.
    return f'<?xml version="1.0" ?>\n<!-- Expanded from {entry}, which is the place for changes. -->\n{text}'


@lru_cache(maxsize=16)
def _expanded(entry: str, argument: str, machine: Machine, prefix: str, meshes: str, root: bool) -> str:
    """Return the text that xacro makes, which takes a fifth of a second."""
    import xacro

    with tempfile.TemporaryDirectory() as folder, _XACRO:
        path = Path(folder) / "machine.yaml"
        machine.to_yaml(path)
        mappings = {"prefix": prefix, argument: str(path), "meshes": meshes, "root": str(root).lower()}
        expanded = xacro.process_file(str(description_file(entry)), mappings=mappings)
    return str(expanded.documentElement.toprettyxml(indent="  "))


def _ros_constraint(closure: Closure) -> str:
    """Return a closure as the element proposed for ROS."""
    a, b = closure.frame_a, closure.frame_b
    return f"""  <constraint name="{a}_{b}" type="spherical_joint">
    <parent link="{a}"/>
    <parent_origin xyz="0 0 0" rpy="0 0 0"/>
    <child link="{b}"/>
    <child_origin xyz="0 0 0" rpy="0 0 0"/>
  </constraint>
"""
