"""Robots as a `RobotDescription`: the manipulator of any geometry, or another one from a URDF and its closures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from spm_pin.description.as_built_tree import as_built_robot
from spm_pin.description.closures import read_closures
from spm_pin.description.expand import expand
from spm_pin.description.extended_urdf import ExtendedUrdf, read_extended_urdf
from spm_pin.description.read_urdf import read_urdf, urdf_description
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import Transmission
from spm_pin.description.tree import joint_values
from spm_pin.errors import DescriptionError
from spm_pin.mechanism import Configuration, Geometry
from spm_pin.mechanism.yaml_node import YamlNode


def manipulator(
    geometry: Geometry | None = None,
    *,
    prefix: str = "",
    states: Mapping[str, Configuration] | None = None,
) -> RobotDescription:
    """Return the manipulator of this package.

    Parameters
    ----------
    geometry : Geometry, optional
        By default the paper's.
    prefix : str
        Put before every name but those of the states.
    states : mapping of str to Configuration, optional
        Named states, of the same geometry.

    Raises
    ------
    DescriptionError
        If `prefix` cannot begin a name, or a state has other dimensions.
    ArgumentError
        If a state is a batch or does not exist.
    """
    geometry = Geometry.paper() if geometry is None else geometry
    robot = urdf_description(expand(geometry.nominal, prefix=prefix), read_closures(prefix=prefix))
    if not geometry.is_nominal:
        robot = as_built_robot(robot, geometry, prefix)
    values = {}
    for name, configuration in (states or {}).items():
        if configuration.geometry != geometry:
            raise DescriptionError("states", "the robot's geometry in all states", f"another one in {name}")
        values[name] = {prefix + joint: value for joint, value in joint_values(configuration).items()}
    return replace(robot, states=values)


def read_robot(
    urdf: str | Path,
    closures: str | Path | None = None,
    *,
    packages: Mapping[str, str | Path] | None = None,
) -> RobotDescription:
    """Read a robot from a URDF and, if given, a file of its closures.

    Parameters
    ----------
    urdf : str or Path
        Its spanning tree, a URDF file.
    closures : str or Path, optional
        A YAML file of closures, as `read_closures` or as `read_extended_urdf` takes it, besides those in the URDF. The
        motors of an Extended-URDF file are the robot's, in its order.
    packages : mapping of str to path, optional
        Folders of the packages that meshes are named in, as for `read_urdf`.

    Raises
    ------
    DescriptionError
        As those raise; if a frame or motor is none of the URDF's, the motors are not those of its transmissions, or
        the Extended-URDF file changes the type of a joint.
    """
    if closures is None:
        return read_urdf(urdf, packages=packages)
    if "closures" in YamlNode.read(Path(closures), "closures").keys:
        return read_urdf(urdf, read_closures(closures), packages=packages)
    extended = read_extended_urdf(closures)
    return _driven(read_urdf(urdf, extended.closures, packages=packages), extended, str(closures))


def _driven(robot: RobotDescription, extended: ExtendedUrdf, source: str) -> RobotDescription:
    """Return a robot with the motors of an Extended-URDF file."""
    if extended.joint_types:
        received = ", ".join(f"{joint} as {kind}" for joint, kind in extended.joint_types.items())
        cause = "Write such joints into the URDF, one degree of freedom each"
        raise DescriptionError(source, "joints that keep the type they have in the URDF", received, cause)
    existing = {transmission.joint: transmission for transmission in robot.transmissions}
    if existing and existing.keys() != set(extended.motors):
        other = ", ".join(sorted(existing.keys() ^ set(extended.motors)))
        raise DescriptionError(source, "the motors that the URDF's transmissions drive", f"a difference in {other}")
    new = {name: Transmission(f"{name}_transmission", name, f"{name}_motor") for name in extended.motors}
    return replace(robot, transmissions=tuple((existing or new)[name] for name in extended.motors))
