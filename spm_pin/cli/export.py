"""`spm-pin export` and `urdf`: a robot or a stage in the format of another engine, or its kinematics in C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from typer import Argument, Option

from spm_pin import description
from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.cli.stage_options import takes_stage
from spm_pin.description.masses import Masses
from spm_pin.errors import ArgumentError
from spm_pin.machine import Machine, Stage

Format = Literal["urdf", "mjcf", "sdf", "extended-urdf", "srdf", "c", "c-stage", "linuxcnc", "ros", "ros2"]
_OWN_OPTIONS: dict[str, set[str]] = {
    "urdf": {"ros_constraints", "masses", "stage"},
    "mjcf": {"anchors", "collisions", "actuators", "ball", "masses", "stage"},
    "sdf": {"loops", "masses", "stage"},
    "extended-urdf": {"stage"},
    "srdf": {"stage"},
    "c": {"masses"},
    "ros": {"masses"},
    "c-stage": {"stage"},
    "linuxcnc": {"stage"},
}
"""Options of some formats only, by format."""


@outputs.name_options(directory="--out")
@takes_stage(required=False)
def export(
    format_: Annotated[Format | None, Argument(metavar="[FORMAT]", help="What to write.")] = None,
    option: Annotated[Format | None, Option("--format", help="The same, as an option.")] = None,
    out: Annotated[
        Path | None,
        Option(metavar="FILE", parser=outputs.file_name, help="File or folder to write; default: standard output."),
    ] = None,
    prefix: Annotated[str | None, options.PREFIX] = None,
    machine_file: options.MachineFile = None,
    stage: Stage | None = None,
    unit: Annotated[LengthUnit, Option(help="Unit of the stage's dimensions; files are in metres.")] = LengthUnit.M,
    masses: options.MassesFile = None,
    ros_constraints: Annotated[
        bool, Option("--ros-constraints", help="urdf: add the <constraint> elements proposed for ROS.")
    ] = False,
    anchors: Annotated[
        Literal["bodies", "sites"] | None,
        Option(help="mjcf: anchor closures in bodies, or in sites, which Drake ignores."),
    ] = None,
    collisions: Annotated[
        Literal["exact", "simple", "none"] | None,
        Option(help="mjcf: shapes that collide; simple has no cylinders, which MJX does not support with boxes."),
    ] = None,
    actuators: Annotated[
        Literal["motors", "servos"] | None,
        Option(help="mjcf: motors, the default for a robot, or servos, the default for a stage."),
    ] = None,
    ball: Annotated[bool, Option("--ball", help="mjcf: a ball on the platform of a --stage.")] = False,
    loops: Annotated[
        Literal["joints", "drake"] | None, Option(help="sdf: close loops by joints, or by Drake's elements.")
    ] = None,
) -> None:
    """Write the robot or a stage with closed loops in the format of another engine, or its kinematics in C.

    urdf: Drake, Pinocchio, yourdfpy, PyBullet, ROS. mjcf: MuJoCo, Drake, Pinocchio. sdf: SDFormat. extended-urdf: the
    YAML file with the closures of a URDF. srdf: groups and passive joints. With --out, the meshes are copied beside the
    file, into a folder `meshes`. With --stage, or --base and so on, these files describe a stage alone.

    c: inverse and forward displacement, J_f, leg forces, weights and joint values in C99 for controllers, with a test
    program. linuxcnc: a configuration that simulates the machine, or a stage alone, and the source of its kinematics
    module. ros or ros2: a ROS 2 package with the description, a node for joint states, a launch file and a controller.
    c-stage: one header in C99 for a microcontroller, for a stage alone, such as a ball balancer.
    """
    if (format_ is None) == (option is None):
        received = "none" if format_ is None else "two"
        raise ArgumentError("FORMAT", f"one of {', '.join(get_args(Format))}", received)
    chosen = str(format_ or option).replace("ros2", "ros")
    special: dict[str, Any] = {"ros_constraints": ros_constraints, "anchors": anchors, "collisions": collisions}
    special |= {"loops": loops, "actuators": actuators, "ball": description.Ball() if ball else None}
    own = _OWN_OPTIONS.get(chosen, set())
    for name, value in (special | {"masses": masses, "stage": stage}).items():
        if value and name not in own:
            cause = "c-stage writes that of a stage" if (chosen, name) == ("c", "stage") else ""
            raise ArgumentError(f"--{name.replace('_', '-')}", f"no such option with --format {chosen}", value, cause)
    if machine_file is not None and (stage is not None or chosen == "c-stage"):
        raise ArgumentError("--machine", "no such option with a stage", machine_file, "The file of a --stage?")
    if stage is None and chosen == "c-stage":
        raise ArgumentError("--stage", "a stage: its file, or --base, --platform and so on", "none")
    if ball and stage is None:
        raise ArgumentError("--ball", "a --stage for it to roll on", "none")
    model = options.read_machine(machine_file) if stage is None else stage
    bodies = options.read_masses(masses, "written") if "masses" in own else None
    if chosen not in ("c", "c-stage", "linuxcnc", "ros"):
        if out is not None:
            outputs.check_output(out)
        _write_model(chosen, out, model, bodies, prefix or "", {name: special[name] for name in own & special.keys()})
        return
    if out is None:
        raise ArgumentError("--out", "the directory to write into", "none")
    from spm_pin import export as exporters

    if chosen == "linuxcnc":
        if prefix:
            raise ArgumentError("--prefix", "no such option with --format linuxcnc", prefix)
        exporters.write_linuxcnc(model, out)
        outputs.note(f"wrote a configuration of LinuxCNC into {out}")
        return
    if isinstance(model, Stage):
        paths = exporters.write_stage_c(model, out, prefix="stage_" if prefix is None else prefix)
    elif chosen == "ros":
        exporters.write_ros(model, out, prefix=prefix or "", masses=bodies)
        outputs.note(f"wrote a ROS 2 package into {out}")
        return
    else:
        paths = exporters.write_c(model, out, prefix="spm_" if prefix is None else prefix, masses=bodies)
    for path in paths:
        outputs.note(f"wrote {path}")


@outputs.name_options()
def urdf(
    out: Annotated[Path | None, outputs.file_option("File to write; default: standard output.")] = None,
    prefix: Annotated[str, options.PREFIX] = "",
    machine_file: options.MachineFile = None,
    masses: options.MassesFile = None,
) -> None:
    """Write the URDF: an open tree of eighteen joints, its four loops closed by Drake's tags.

    Other loaders ignore those tags; `spm-pin export` writes closed robots for them. The tree of a nominal machine
    is assembled at zero. With --out, the meshes are copied beside the file, into a folder `meshes`, and named relative
    to it; Pinocchio finds them with package_dirs=".", the file's folder. A URDF on standard output names them by
    absolute paths.
    """
    machine, bodies = options.read_machine(machine_file), options.read_masses(masses, "written")
    _write_model("urdf", out, machine, bodies, prefix, {})


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
