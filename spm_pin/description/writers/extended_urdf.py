"""The Extended-URDF file beside a URDF."""

from __future__ import annotations

from collections.abc import Iterable

from spm_pin.description.closures import KINDS
from spm_pin.description.robot import RobotDescription

__all__ = ["sidecar_text"]


def sidecar_text(robot: RobotDescription) -> str:
    """Return closures and motors of a robot as an Extended-URDF file, to lie beside its URDF.

    Notes
    -----
    Layout of https://github.com/Gepetto/example-parallel-robots. The names of the closures have no place in it. No
    joint changes its type when loaded: `joint_name` and `joint_type` are empty.
    """
    pairs = ",\n  ".join(f"[{_names((closure.frame_a, closure.frame_b))}]" for closure in robot.closures)
    return (
        f"closed_loop: [\n  {pairs}\n]\n"
        f"type: [{_names(KINDS[closure.kind] for closure in robot.closures)}]\n"
        f"name_mot: [{_names(transmission.joint for transmission in robot.transmissions)}]\n"
        "joint_name: []\njoint_type: []\n"
    )


def _names(names: Iterable[str]) -> str:
    return ", ".join("'" + name.replace("'", "''") + "'" for name in names)
