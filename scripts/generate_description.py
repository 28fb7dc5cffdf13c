"""Write the generated robot files of the description: `python scripts/generate_description.py`, in a checkout.

`spm.urdf`, `spm.srdf`, `spm.xml`, `spm.sdf` and `spm_closures.yaml` come from the xacro sources, from `config/*.yaml`
and, for the named states, from solving the paper's example. A test checks that the files kept in `urdf` are
what it writes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import spm_pin as spm
from spm_pin.crosscheck.paper.published import POSITION, TABLE_2, XYX_DEGREES
from spm_pin.description import extended_urdf_text, mjcf_text, sdf_text, srdf_text, urdf_text
from spm_pin.description.source_files import CLOSURES, EXTENDED_URDF, MESHES, MJCF, SDF, SRDF, URDF

FOLDER = Path(__file__).resolve().parents[1] / "urdf"

REFERENCE = "3"
"""Number of the solution that is also the state `reference`: the one the paper goes on with."""


def named_states() -> dict[str, spm.Configuration]:
    """Return the real solutions of the paper's example under their numbers there, recognised by b_2's Y of Table 2."""
    pose = spm.pose(0.01 * np.array(POSITION), xyx=np.deg2rad(XYX_DEGREES))
    branches = spm.inverse_displacement(spm.Manipulator.paper(), pose)
    states = {}
    for number, printed in enumerate(TABLE_2[1], start=1):
        if printed is None or printed.endswith("i"):
            continue
        metres = 0.01 * float(printed)
        (branch,) = (c for c in branches if abs(c.middle_joints[1, 1] - metres) < 1e-4)
        states[f"solution_{number}"] = branch
    return {"reference": states[f"solution_{REFERENCE}"], **states}


def generate() -> dict[str, str]:
    """Return the content of each generated file."""
    warning = f"Written by generate_description.py from {CLOSURES}, which is the place for changes."
    states = named_states()
    return {
        URDF: urdf_text(meshes=MESHES),
        SRDF: srdf_text(states),
        MJCF: mjcf_text(states=states, meshes=MESHES),
        SDF: sdf_text(meshes=MESHES),
        EXTENDED_URDF: f"# {warning}\n" + extended_urdf_text(),
    }


if __name__ == "__main__":
    for name, content in generate().items():
        (FOLDER / name).write_text(content, encoding="utf-8", newline="\n")
