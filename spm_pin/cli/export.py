"""`spm-pin export`: the robot, or one of your own, in the format of another engine."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from spm_pin.cli.console import stderr
from spm_pin.cli.options import GeometryFile, read_geometry
from spm_pin.errors import ArgumentError

__all__ = ["export"]


class Format(enum.StrEnum):
    """What can be written."""

    URDF = "urdf"
    MJCF = "mjcf"
    SDF = "sdf"
    EXTENDED_URDF = "extended-urdf"
    SRDF = "srdf"


class Anchors(enum.StrEnum):
    """How MJCF says where a closure is."""

    BODIES = "bodies"
    SITES = "sites"


class Loops(enum.StrEnum):
    """How SDFormat closes loops."""

    JOINTS = "joints"
    DRAKE = "drake"


def export(
    format_: Annotated[Format, typer.Option("--format", help="What to write.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where to write; standard output if not given.")
    ] = None,
    prefix: Annotated[str, typer.Option(help="Put before every name, such as left_.")] = "",
    geometry: GeometryFile = None,
    urdf: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A robot of your own instead of this manipulator.")
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
    """Write the robot with its loops closed, in the format of another engine.

    urdf: Drake, Pinocchio, yourdfpy, PyBullet, ROS. mjcf: MuJoCo, Drake, Pinocchio. sdf: SDFormat. extended-urdf: the
    YAML file that closes a URDF's loops. srdf: groups and passive joints. What a format cannot say is an error.
    """
    from spm_pin.description.robots import manipulator, read_robot
    from spm_pin.description.srdf import srdf_text
    from spm_pin.description.writers.extended_urdf import sidecar_text
    from spm_pin.description.writers.mjcf import mjcf_text
    from spm_pin.description.writers.sdf import sdf_text
    from spm_pin.description.writers.urdf import urdf_text

    own, by = urdf is not None, f"with --format {format_.value}"
    for option, given, useless, when in (
        ("--ros-constraints", ros_constraints, format_ is not Format.URDF, by),
        ("--anchors", anchors, format_ is not Format.MJCF, by),
        ("--loops", loops, format_ is not Format.SDF, by),
        ("--urdf", urdf, format_ is Format.SRDF, by),
        ("--closures", closures, not own, "without --urdf"),
        ("--prefix", prefix, own, "with --urdf"),
        ("--geometry", geometry, own, "with --urdf"),
    ):
        if given and useless:
            raise ArgumentError(option, f"to be left out {when}", given)
    if format_ is Format.SRDF:
        _write(srdf_text({}, prefix=prefix), out)
        return
    robot = manipulator(read_geometry(geometry), prefix=prefix) if urdf is None else read_robot(urdf, closures)
    match format_:
        case Format.URDF:
            text = urdf_text(robot, ros_constraints=ros_constraints)
        case Format.MJCF:
            text = mjcf_text(robot, anchors=(anchors or Anchors.BODIES).value)
        case Format.SDF:
            text = sdf_text(robot, loops=(loops or Loops.JOINTS).value)
        case _:
            text = sidecar_text(robot)
    _write(text, out)


def _write(text: str, out: Path | None) -> None:
    if out is None:
        typer.echo(text, nl=False)
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ArgumentError("--out", "a file that can be written", out, str(error.strerror)) from error
    stderr.print(f"wrote {escape(str(out))}")
