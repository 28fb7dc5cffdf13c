"""`spm-pin export` and `urdf`: the robot in the format of another engine, or its closed forms in C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from spm_pin.cli import options, outputs
from spm_pin.errors import ArgumentError

Format = Literal["urdf", "mjcf", "sdf", "extended-urdf", "srdf", "c"]
Anchors = Literal["bodies", "sites"]
Loops = Literal["joints", "drake"]


@outputs.name_options(directory="--out")
def export(
    format_: Annotated[Format | None, typer.Argument(metavar="[FORMAT]", help="What to write.")] = None,
    option: Annotated[Format | None, typer.Option("--format", help="The same, as an option.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", parser=outputs.file_name, help="Where to write; standard output if not given."),
    ] = None,
    prefix: Annotated[str | None, options.PREFIX] = None,
    geometry: options.GeometryFile = None,
    urdf: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Another robot instead of this manipulator.")
    ] = None,
    closures: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="What closes the loops of --urdf: an Extended-URDF file, or closures.yaml."),
    ] = None,
    ros_constraints: Annotated[
        bool, typer.Option("--ros-constraints", help="urdf: add the <constraint> elements proposed for ROS.")
    ] = False,
    anchors: Annotated[Anchors | None, typer.Option(help="mjcf: anchor closures in bodies, or in sites.")] = None,
    loops: Annotated[Loops | None, typer.Option(help="sdf: close loops by joints, or by Drake's elements.")] = None,
) -> None:
    """Write the robot with its loops closed, in the format of another engine, or its closed forms in C.

    urdf: Drake, Pinocchio, yourdfpy, PyBullet, ROS. mjcf: MuJoCo, Drake, Pinocchio. sdf: SDFormat. extended-urdf: the
    YAML file that closes a URDF's loops. srdf: groups and passive joints. What a format cannot say is an error. With
    --out, the manipulator's meshes are put beside the file, into a folder `meshes`.

    c: inverse and forward displacement, J_f and leg forces in C99 for controllers, with a test program.
    """
    from spm_pin.description.extended_urdf import extended_urdf_text
    from spm_pin.description.load_robot import manipulator, read_robot
    from spm_pin.description.paths import description_directory
    from spm_pin.description.srdf import srdf_text
    from spm_pin.description.write_mjcf import mjcf_text
    from spm_pin.description.write_sdf import sdf_text
    from spm_pin.description.write_urdf import urdf_text
    from spm_pin.symbolic import write_c

    if (format_ is None) == (option is None):
        received = "none" if format_ is None else "two"
        raise ArgumentError("FORMAT", f"one of {', '.join(get_args(Format))}", received)
    format_ = format_ or option
    foreign, by = urdf is not None, f"with --format {format_}"
    for name, value, useless, when in (
        ("--ros-constraints", ros_constraints, format_ != "urdf", by),
        ("--anchors", anchors, format_ != "mjcf", by),
        ("--loops", loops, format_ != "sdf", by),
        ("--urdf", urdf, format_ in ("srdf", "c"), by),
        ("--closures", closures, not foreign, "without --urdf"),
        ("--prefix", prefix, foreign, "with --urdf"),
        ("--geometry", geometry, foreign, "with --urdf"),
    ):
        if value and useless:
            raise ArgumentError(name, f"to be left out {when}", value)
    if format_ == "c":
        if out is None:
            raise ArgumentError("--out", "the directory to write into", "none")
        for path in write_c(options.read_geometry(geometry), out, prefix="spm_" if prefix is None else prefix):
            outputs.note(f"wrote {path}")
        return
    if out is not None:
        outputs.check_output(out)
    prefix = prefix or ""
    if format_ == "srdf":
        outputs.write_text(srdf_text({}, prefix=prefix), out)
        return
    robot = manipulator(options.read_geometry(geometry), prefix=prefix) if urdf is None else read_robot(urdf, closures)
    # Beside a file of this manipulator go its meshes; a text on standard output, or of another robot, has whole paths.
    beside = out is not None and urdf is None and format_ != "extended-urdf"
    folder = description_directory() if beside else None
    # A machine as built is not assembled at zero, which MuJoCo's bodies and SDFormat's joints ask for.
    apart = bool(robot.open_closures())
    match format_:
        case "urdf":
            text = urdf_text(robot, ros_constraints=ros_constraints, folder=folder)
        case "mjcf":
            text = mjcf_text(robot, anchors=anchors or ("sites" if apart else "bodies"), folder=folder)
        case "sdf":
            text = sdf_text(robot, loops=loops or ("drake" if apart else "joints"), folder=folder)
        case _:
            text = extended_urdf_text(robot)
    (outputs.write_model if beside else outputs.write_text)(text, out)


@outputs.name_options()
def urdf(
    out: Annotated[Path | None, outputs.file_option("Where to write; standard output if not given.")] = None,
    prefix: Annotated[str, options.PREFIX] = "",
    geometry: options.GeometryFile = None,
) -> None:
    """Write the URDF: an open tree of eighteen joints, assembled at zero, its four loops closed by Drake's tags.

    Other loaders pass over those tags; `spm-pin export` writes the closed robot for them. With --out, the meshes are
    put beside the file, into a folder `meshes`, and named relative to it; Pinocchio finds them if it is told the
    file's folder, package_dirs=".". A URDF on standard output names them by their whole paths.
    """
    from spm_pin.description.expand import expand
    from spm_pin.description.load_robot import manipulator
    from spm_pin.description.paths import MESHES, description_directory
    from spm_pin.description.write_urdf import urdf_text

    dimensions = options.read_geometry(geometry)
    if not dimensions.is_nominal:
        folder = description_directory() if out else None
        outputs.write_model(urdf_text(manipulator(dimensions, prefix=prefix), folder=folder), out)
    else:
        outputs.write_model(expand(dimensions, prefix=prefix, meshes=MESHES if out else None), out)
