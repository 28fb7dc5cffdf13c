"""`spm-pin forward`: the poses that six leg lengths allow."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit, SixLegs, leg_option
from spm_pin.display.figures import fixed
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical
from spm_pin.mechanism import Configuration, SolutionSet, Status


@outputs.name_options(leg_lengths="--legs", readings="--legs")
def forward(
    legs: Annotated[SixLegs, leg_option("--legs", "Leg lengths r_b1 to r_b3 and r_c1 to r_c3, in --unit.")],
    every: Annotated[bool, typer.Option("--all", help="Show every assembly mode, not only the physical one.")] = False,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Find the pose of the platform from the leg lengths.

    Example, the paper's: spm-pin forward --legs 120 120 140 125 120 150 --unit cm
    """
    lengths = np.array(legs) / unit.per_metre
    dimensions = options.read_geometry(geometry)
    physical = forward_physical(dimensions, lengths)
    # All modes are those of a machine as drawn; for one as built --all is refused.
    modes = forward_displacement(dimensions, lengths) if every or dimensions.is_nominal else _alone(physical)
    shown = {modes.labels[0]: physical} if physical.exists else {}
    if every:
        shown = {modes.labels[k]: modes.configurations[k] for k in np.flatnonzero(modes.exists)}
    home = modes.labels[0] if physical.exists else ""
    if json:
        states = [
            {
                "label": label,
                "translation": state.translation * unit.per_metre,
                "xyx": _angles(state),
                "rotation": state.rotation,
                "middle_joints": state.middle_joints * unit.per_metre,
                "physical": label == home,
                "residual": state.closure_residual * unit.per_metre,
            }
            for label, state in shown.items()
        ]
        outputs.write_json(options.status_content(modes, unit) | {"count": modes.count, "modes": states})
    else:
        if shown:
            _print_states(shown, home, unit, "Assembly modes" if every else "The physical configuration")
        remarks = [options.status_line(modes, "assembly modes")]
        if modes.status is Status.DEGENERATE:
            remarks += ["With these legs locked the platform can still move.", *options.pose_remarks(modes)]
        if modes.status is Status.UNREACHABLE:
            hint = options.unit_hint("--legs", max(legs), unit, dimensions)
            remarks.append(hint or "A stage cannot be closed with these leg lengths.")
        elif not physical.exists:
            remarks.append("No mode is reached from the symmetric home without a forward singularity.")
        outputs.print_lines(remarks)
    raise typer.Exit(options.exit_code(modes))


def _alone(physical: Configuration) -> SolutionSet:
    """Return the physical configuration as the only mode that is sought."""
    state = physical.rotation[None], physical.translation[None], physical.middle_joints[None]
    status = Status.OK if physical.exists else Status.UNREACHABLE
    return SolutionSet(Configuration.from_arrays(physical.geometry, *state), ("physical",), status)


def _angles(state: Configuration) -> list[float]:
    return [float(angle) for angle in state.pose.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)]


def _print_states(states: dict[str, Configuration], physical: str, unit: LengthUnit, title: str) -> None:
    # One digit more where there is room for it in 80 columns.
    finer = int(len(states) == 1)
    columns: dict[str, Any] = {"mode": str}
    columns |= {
        name: lambda label, k=k: unit.text(float(states[label].translation[k]), finer) for k, name in enumerate("XYZ")
    }
    columns |= {
        name: lambda label, k=k: fixed(_angles(states[label])[k], 3 + finer)
        for k, name in enumerate(("alpha", "beta", "lambda"))
    }
    columns[""] = lambda label: "physical" if label == physical else ""
    outputs.print_table(f"{title}: o in {unit}, X-Y-X in degrees", columns, states, left=[""])
