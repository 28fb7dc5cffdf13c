"""`spm-pin certify`: leg limits proved free of forward singularities, or a singular configuration within them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.display.figures import certificate_figure
from spm_pin.errors import GeometryError
from spm_pin.mechanism import Configuration, LegLimits
from spm_pin.proofs import Certificate, InverseCertificate, certify_inverse
from spm_pin.proofs import certify as prove


@outputs.name_options(
    limits="--min, --max", boxes="--boxes", length_error="--length-error", angle_error="--angle-error"
)
def certify(
    minimum: Annotated[float | None, Option("--min", help="Shortest length of all six legs, in --unit.")] = None,
    maximum: Annotated[float | None, Option("--max", help="Longest length of all six legs, in --unit.")] = None,
    boxes: Annotated[int, Option(min=1, help="Boxes to look at in each stage, at most.")] = 300_000,
    length_error: Annotated[float, Option(help="Errors of pivots, balls, readings to prove it for, in --unit.")] = 0.0,
    angle_error: Annotated[float, Option(help="Errors of the revolute axes to prove it for, in radians.")] = 0.0,
    inverse: Annotated[
        bool, Option("--inverse", help="Ask for inverse singularities as well: a bound of |det K|, or a state.")
    ] = False,
    out: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) of the boxes to write.")] = None,
    style: outputs.PictureStyle = None,
    unit: Annotated[LengthUnit, Option(help="Unit of the lengths typed; the answer is in metres.")] = LengthUnit.M,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Prove that leg limits hold no forward singularity, so that six lengths mean one configuration.

    Example: spm-pin certify --min 1.1 --max 1.5

    Without --min and --max the limits are the geometry's. The exit code is 0 if the proof succeeds, 1 if a singular
    configuration was found or boxes were left undecided. --out needs the extra "plots". For the file of a machine as
    built it is proved for all machines that are as near to the nominal one.
    """
    dimensions = options.read_geometry(geometry)
    if (minimum is None) != (maximum is None):
        raise GeometryError("--min and --max", "both or neither", "one of them")
    if inverse and (length_error or angle_error or not dimensions.is_nominal):
        cause = "A bound of |det K| is proved for one nominal machine only"
        raise GeometryError("--inverse", "no errors of the machine", "errors as well", cause)
    limits = None
    if minimum is not None and maximum is not None:
        limits = LegLimits(minimum / unit.per_metre, maximum / unit.per_metre)
        options.note_unit("--max", maximum, unit, dimensions)
    with outputs.stderr.status("dividing the states of both stages"):
        certificate = prove(
            dimensions, limits, boxes=boxes, length_error=length_error / unit.per_metre, angle_error=angle_error
        )
        nominal = certificate.geometry
        other = certify_inverse(nominal, certificate.limits, boxes=boxes, forward=certificate) if inverse else None
    outputs.write_figure(out, style, certificate_figure, certificate)
    if json:
        outputs.write_json(_content(certificate, other))
    else:
        outputs.print_lines(certificate.explain().splitlines())
        outputs.print_lines([] if other is None else ["", *other.explain().splitlines()])
    if not (certificate.holds and (other is None or other.holds)):
        raise typer.Exit(1)


def _content(certificate: Certificate, other: InverseCertificate | None) -> dict[str, Any]:
    def state(witness: Configuration | None) -> dict[str, Any] | None:
        return None if witness is None else {"leg_lengths": witness.leg_lengths, "pose": witness.pose.as_matrix()}

    lower, upper = certificate.bounds
    content = {
        "holds": certificate.holds,
        "limits": {"minimum": certificate.limits.minimum, "maximum": certificate.limits.maximum},
        "errors": {"length": certificate.errors[0], "angle": certificate.errors[1]},
        "bounds": {"J_b": lower, "J_c": upper},
        "boxes": {
            name: {"examined": proof.boxes, "proved": len(proof.proved), "undecided": len(proof.undecided)}
            for name, proof in (("lower", certificate.lower), ("upper", certificate.upper))
        },
        "witness": state(certificate.witness),
    }
    if other is not None:
        measures = {name: getattr(other, name) for name in ("holds", "bound", "least")}
        content["inverse"] = {**measures, "undecided": len(other.undecided), "witness": state(other.witness)}
    return content
