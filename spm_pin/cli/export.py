"""`spm-pin export` and `urdf`: a machine in the format of another engine, or its kinematics in C; `write`: its file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from typer import Argument, Option

from spm_pin import description
from spm_pin.cli import outputs
from spm_pin.cli.options import Masses_, Prefix, read_masses
from spm_pin.cli.units import MachineInUnits
from spm_pin.description.masses import Masses
from spm_pin.errors import ArgumentError
from spm_pin.machine import Machine

Format = Literal["urdf", "mjcf", "sdf", "extended-urdf", "srdf", "c", "c-stage", "linuxcnc", "ros", "ros2"]
_OWN_OPTIONS: dict[str, set[str]] = {
    "urdf": {"ros_constraints", "masses", "prefix"},
    "mjcf": {"collisions", "actuators", "ball", "masses", "prefix"},
    "sdf": {"loops", "masses", "prefix"},
    "extended-urdf": {"prefix"},
    "srdf": {"prefix"},
    "c": {"masses", "prefix"},
    "ros": {"masses", "prefix"},
    "c-stage": {"prefix"},
    "linuxcnc": set(),
}
"""Options of some formats only, by format."""


def export(
    typed: MachineInUnits,
    format_: Annotated[Format | None, Argument(metavar="[FORMAT]", help="What to write.")] = None,
    option: Annotated[Format | None, Option("--format", help="The same, as an option.")] = None,
    out: Annotated[
        Path | None,
        Option(metavar="FILE", parser=outputs.file_name, help="File or folder to write; default: standard output."),
    ] = None,
    prefix: Prefix = None,
    masses: Masses_ = None,
    ros_constraints: Annotated[
        bool, Option("--ros-constraints", help="urdf: add the <constraint> elements proposed for ROS.")
    ] = False,
    collisions: Annotated[
        Literal["exact", "simple", "none"] | None,
        Option(help="mjcf: shapes that collide; simple has no cylinders, which MJX does not support with boxes."),
    ] = None,
    actuators: Annotated[
        Literal["motors", "servos"] | None,
        Option(help="mjcf: motors, the default for a robot, or servos, the default for a stage."),
    ] = None,
    ball: Annotated[bool, Option("--ball", help="mjcf: a ball on the platform of a stage.")] = False,
    loops: Annotated[
        Literal["joints", "drake"] | None, Option(help="sdf: close loops by joints, or by Drake's elements.")
    ] = None,
) -> None:
    """Write the machine with closed loops in the format of another engine, or its kinematics in C.

    Example: spm-pin export mjcf --out robot.xml

    Example: spm-pin stage export c-stage --base 80 --platform 90 --crank 50 --rod 110 --unit mm --out board

    urdf: Drake, Pinocchio, yourdfpy, PyBullet, ROS. mjcf: MuJoCo, Drake, Pinocchio. sdf: SDFormat. extended-urdf: the
    YAML file with the closures of a URDF. srdf: groups and passive joints. With --out, the meshes are copied beside the
    file, into a folder `meshes`. Files are in metres and radians.

    c: inverse and forward displacement, J_f, leg forces, weights and joint values in C99 for controllers, with a test
    program. linuxcnc: a configuration that simulates the machine, and the source of its kinematics
    module. ros or ros2: a ROS 2 package with the description, a node for joint states, a launch file and a controller;
    a stage follows the height and the normal of its poses.
    c-stage: one header in C99 for a microcontroller, for a stage, such as a ball balancer.
    """
    if (format_ is None) == (option is None):
        received = "none" if format_ is None else "two"
        raise ArgumentError("FORMAT", f"one of {', '.join(get_args(Format))}", received)
    chosen = str(format_ or option).replace("ros2", "ros")
    special: dict[str, Any] = {"ros_constraints": ros_constraints, "collisions": collisions}
    special |= {"loops": loops, "actuators": actuators, "ball": description.Ball() if ball else None}
    own, machine = _OWN_OPTIONS[chosen], typed.machine
    for name, value in (special | {"masses": masses, "prefix": prefix}).items():
        if value and name not in own:
            raise outputs.cannot_be_used(f"--{name.replace('_', '-')}", f"--format {chosen}")
    is_stage = machine.is_stage
    if chosen in ("c", "c-stage") and is_stage != (chosen == "c-stage"):
        kinds = ("a manipulator", "a stage: its file, or --base, --platform and so on")
        received = "a stage" if is_stage else "a manipulator" if typed.given else "none"
        cause = "For a stage see the format c-stage" if chosen == "c" else ""
        raise ArgumentError("--machine", f"{kinds[chosen == 'c-stage']}, for --format {chosen}", received, cause)
    bodies = read_masses(masses, "written") if "masses" in own else None
    if chosen not in ("c", "c-stage", "linuxcnc", "ros"):
        if out is not None:
            outputs.check_output(out)
        _write_model(chosen, out, machine, bodies, prefix or "", {name: special[name] for name in own & special.keys()})
        return
    if out is None:
        raise ArgumentError("--out", "the directory to write into", "none")
    from spm_pin import export as exporters

    if chosen == "linuxcnc":
        exporters.write_linuxcnc(machine, out)
        outputs.note(f"wrote a configuration of LinuxCNC into {out}")
    elif chosen == "ros":
        exporters.write_ros(machine, out, prefix=prefix or "", masses=bodies)
        outputs.note(f"wrote a ROS 2 package into {out}")
    else:
        named = {} if prefix is None else {"prefix": prefix}
        if is_stage:
            paths = exporters.write_stage_c(machine, out, **named)
        else:
            paths = exporters.write_c(machine, out, masses=bodies, **named)
        for path in paths:
            outputs.note(f"wrote {path}")


def write(
    out: Annotated[Path, outputs.file_option("YAML file to write.", (".yaml", ".yml"))], typed: MachineInUnits
) -> None:
    """Write a machine file for --machine of other commands.

    Example: spm-pin write --base 0.7 --platform 0.35 --middle 0.8 --limits 1.1 1.5 --out machine.yaml

    Example: spm-pin stage write --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --out stage.yaml
    """
    typed.machine.to_yaml(out)
    header = f"; spm-pin export c-stage --machine {out} writes its header for a microcontroller"
    outputs.note(f"wrote {out}{header * typed.machine.is_stage}")


def urdf(
    typed: MachineInUnits,
    out: Annotated[Path | None, outputs.file_option("File to write; default: standard output.")] = None,
    prefix: Prefix = None,
    masses: Masses_ = None,
) -> None:
    """Write the URDF: an open tree of joints, its loops closed by Drake's tags.

    Other loaders ignore those tags; `spm-pin export` writes closed robots for them. The tree of a nominal machine
    is assembled at zero. With --out, the meshes are copied beside the file, into a folder `meshes`, and named relative
    to it; Pinocchio finds them with package_dirs=".", the file's folder. A URDF on standard output names them by
    absolute paths.
    """
    _write_model("urdf", out, typed.machine, read_masses(masses, "written"), prefix or "", {})


def _write_model(
    chosen: str, path: Path | None, machine: Machine, masses: Masses | None, prefix: str, special: dict[str, Any]
) -> None:
    """Write a model; its meshes are copied into a folder beside its file."""
    without_meshes: dict[str, Any] = {"srdf": description.srdf_text, "extended-urdf": description.extended_urdf_text}
    if chosen in without_meshes:
        outputs.write_text(without_meshes[chosen](machine=machine, prefix=prefix), path)
        return
    write: Any = {"urdf": description.urdf_text, "mjcf": description.mjcf_text, "sdf": description.sdf_text}[chosen]
    # Meshes go beside a file; on standard output they have absolute paths.
    meshes = "meshes" if path is not None else None
    text = write(machine, prefix=prefix, meshes=meshes, masses=masses, **special)
    if path is not None:
        description.source_files.copy_meshes(path.parent)
    outputs.write_text(text, path)
    if path is not None and path.suffix == ".urdf":
        load = f'pinocchio.buildModelsFromUrdf("{path}", package_dirs="{path.parent}")'
        outputs.note(f"in Pinocchio: {load}, for the meshes")
