"""`spm-pin export`: a machine in the format of another engine, or its kinematics in C; `write`: its file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option

from spm_pin import description
from spm_pin.cli import outputs
from spm_pin.cli.options import Masses_, Prefix, read_masses
from spm_pin.cli.units import MachineInUnits
from spm_pin.errors import ArgumentError
from spm_pin.machine import Machine

Format = Literal["urdf", "mjcf", "sdf", "extended-urdf", "srdf", "c", "c-stage", "linuxcnc", "ros", "ros2"]
_MODELS: dict[str, Any] = {
    "urdf": description.urdf_text,
    "mjcf": description.mjcf_text,
    "sdf": description.sdf_text,
    "extended-urdf": description.extended_urdf_text,
    "srdf": description.srdf_text,
}
"""Functions that write models, which take the options of their own."""
_WITH_BODIES = "urdf", "mjcf", "sdf", "c", "ros"
_OWN = {
    "urdf": ("ros_constraints",),
    "mjcf": ("collisions", "actuators", "ball"),
    "sdf": ("loops",),
}
"""Options of one format only."""


def export(
    typed: MachineInUnits,
    format_: Annotated[Format, Argument(metavar="FORMAT", help="What to write.")],
    out: Annotated[Path | None, Option(metavar="FILE", help="File or folder; default: standard output.")] = None,
    prefix: Prefix = None,
    masses: Masses_ = None,
    ros_constraints: Annotated[bool, Option("--ros-constraints", help="urdf: <constraint> elements for ROS.")] = False,
    collisions: Annotated[
        Literal["exact", "simple", "none"] | None, Option(help="mjcf: shapes that collide; simple for MJX.")
    ] = None,
    actuators: Annotated[
        Literal["motors", "servos"] | None, Option(help="mjcf: default: motors of a robot, servos of a stage.")
    ] = None,
    ball: Annotated[bool, Option("--ball", help="mjcf: a ball on the platform of a stage.")] = False,
    loops: Annotated[Literal["joints", "drake"] | None, Option(help="sdf: joints, or Drake's elements.")] = None,
) -> None:
    """Write the machine with closed loops in the format of another engine, or its kinematics in C.

    Example: spm-pin export mjcf --out robot.xml

    Example: spm-pin stage export c-stage --base 80 --platform 90 --crank 50 --rod 110 --unit mm --out board

    urdf: an open tree of joints, for a nominal machine assembled at zero, its loops closed by Drake's tags, which
    Pinocchio, yourdfpy, PyBullet and ROS ignore. mjcf: MuJoCo, Drake, Pinocchio. sdf: SDFormat. extended-urdf: the
    YAML file with the closures of a URDF. srdf: groups and passive joints. With --out, the meshes are copied beside the
    file, into a folder `meshes`. Files are in metres and radians.

    c: inverse and forward displacement, J_f, leg forces, weights and joint values in C99 for controllers, with a test
    program. linuxcnc: a configuration that simulates the machine, and the source of its kinematics
    module. ros or ros2: a ROS 2 package with the description, a node for joint states, a launch file and a controller;
    a stage follows the height and the normal of its poses.
    c-stage: one header in C99 for a microcontroller, for a stage, such as a ball balancer.
    """
    chosen, machine = format_.replace("ros2", "ros"), typed.machine
    special: dict[str, Any] = {"ros_constraints": ros_constraints, "collisions": collisions, "actuators": actuators}
    special |= {"ball": description.Ball() if ball else None, "loops": loops}
    typed_too = [name for name, value in special.items() if value and name not in _OWN.get(chosen, ())]
    typed_too += ["masses"] * (masses is not None and chosen not in _WITH_BODIES)
    typed_too += ["prefix"] * (prefix is not None and chosen == "linuxcnc")
    if typed_too:
        raise outputs.cannot_be_used(f"--{typed_too[0].replace('_', '-')}", chosen)
    if chosen in ("c", "c-stage") and machine.is_stage != (chosen == "c-stage"):
        kinds = ("a manipulator", "a stage: its file, or --base, --platform and so on")
        received = "a stage" if machine.is_stage else "a manipulator" if typed.given else "none"
        raise ArgumentError("--machine", f"{kinds[chosen == 'c-stage']}, for {chosen}", received)
    bodies: dict[str, Any] = {"masses": read_masses(masses, "written")} if chosen in _WITH_BODIES else {}
    named: dict[str, Any] = {} if prefix is None else {"prefix": prefix}
    if chosen in _MODELS:
        if out is not None:
            outputs.check_output(out)
        _write_model(chosen, out, machine, **named, **bodies, **{name: special[name] for name in _OWN.get(chosen, ())})
        return
    if out is None:
        raise ArgumentError("--out", "the directory to write into", "none")
    from spm_pin import export as exporters

    if chosen == "linuxcnc":
        exporters.write_linuxcnc(machine, out)
    elif chosen == "ros":
        exporters.write_ros(machine, out, **named, **bodies)
    elif chosen == "c":
        exporters.write_c(machine, out, **named, **bodies)
    else:
        exporters.write_stage_c(machine, out, **named)
    outputs.note(f"wrote {chosen} into {out}")


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


def _write_model(chosen: str, path: Path | None, machine: Machine, **options: Any) -> None:
    """Write a model; its meshes are copied into a folder beside its file, named by absolute paths on stdout."""
    if chosen in ("urdf", "mjcf", "sdf"):
        options["meshes"] = None if path is None else "meshes"
    text = _MODELS[chosen](machine=machine, **options)
    if path is not None and "meshes" in options:
        description.source_files.copy_meshes(path.parent)
    outputs.write_text(text, path)
    if path is not None and path.suffix == ".urdf":
        load = f'pinocchio.buildModelsFromUrdf("{path}", package_dirs="{path.parent}")'
        outputs.note(f"in Pinocchio: {load}, for the meshes")
