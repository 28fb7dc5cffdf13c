"""`spm-pin certify` proves that limits have no singularities; `move` plans the fastest motion within limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from scipy.spatial.transform import RigidTransform
from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit, SixLegs, leg_option
from spm_pin.display.figures import certificate_figure, motion_figure
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.machine import Configuration, LegLimits, StageConfiguration
from spm_pin.proofs import Certificate, InverseCertificate, certify_inverse
from spm_pin.proofs import certify as prove
from spm_pin.support.arguments import FloatArray, IntArray
from spm_pin.workspace import JointLimits

if TYPE_CHECKING:
    from spm_pin.motion import MotionPlan
    from spm_pin.multibody.trajectory import JointTrajectory

NAMES: dict[str, str | tuple[str, ...]] = {
    "start": ("--from-translation", "--from"),
    "goal": ("--to-translation", "--to"),
    "leg_forces, leg_accelerations": "--leg-force, --leg-acceleration",
    "mass": "--payload",
    **{f"leg_{name}s": f"--leg-{name}" for name in ("rate", "acceleration", "force", "jerk")},
    **dict.fromkeys(("minimum", "maximum"), "--limits"),
}

_Ends = tuple[float, float] | None
Boxes = Annotated[int, Option(min=1, help="Boxes to look at in each stage, at most.")]
LengthError = Annotated[float, Option(help="Errors of pivots, balls, readings to prove it for, in --unit.")]
AngleError = Annotated[float, Option(help="Errors of the revolute axes to prove it for, in radians.")]


def largest_of(help_text: str) -> Any:
    """Return a command-line option for an upper limit: one number, or one for each leg, separated by commas."""
    return Option(metavar="X", help=f"Largest {help_text}")


def _degrees(help_text: str) -> Any:
    return Option(metavar="MIN MAX", help=help_text)


@outputs.name_options(
    limits="--min, --max", boxes="--boxes", length_error="--length-error", angle_error="--angle-error"
)
def certify(
    minimum: Annotated[
        float | None, Option("--min", help="Minimum reading of all six legs, in --unit, for cranks in degrees.")
    ] = None,
    maximum: Annotated[float | None, Option("--max", help="Largest reading of all six legs, as --min.")] = None,
    boxes: Boxes = 300_000,
    length_error: LengthError = 0.0,
    angle_error: AngleError = 0.0,
    inverse: Annotated[
        bool, Option("--inverse", help="Also inverse singularities: a bound of |det K|, or a singular state.")
    ] = False,
    out: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) of the boxes to write.")] = None,
    unit: Annotated[
        LengthUnit, Option(help="Unit of the typed lengths; results are in metres and radians.")
    ] = LengthUnit.M,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Prove that there is no forward singularity within leg limits, so that six readings determine the configuration.

    Example: spm-pin certify --min 1.1 --max 1.5

    Without --min and --max the limits are the machine's. The exit code is 0 if the proof succeeds, 1 if a singular
    configuration was found or boxes were left undecided. --out needs the extra "plots". For the file of a calibrated
    machine it is proved for all machines that are as close to the nominal one.
    """
    dimensions = options.read_machine(machine_file)
    if (minimum is None) != (maximum is None):
        raise GeometryError("--min and --max", "both or neither", "one of them")
    if inverse and (length_error or angle_error or not dimensions.is_nominal):
        cause = "A bound of |det K| is proved for one nominal machine only"
        raise GeometryError("--inverse", "no errors of the machine", "errors as well", cause)
    limits = other = None
    if minimum is not None and maximum is not None:
        limits = LegLimits(*options.Readings(dimensions, unit).read_limits("--max", minimum, maximum))
    errors = {"length_error": length_error / unit.per_metre, "angle_error": angle_error}
    with outputs.stderr.status("dividing the states of both stages"):
        certificate = prove(dimensions, limits, boxes=boxes, **errors)
        if inverse:
            other = certify_inverse(dimensions, certificate.limits, boxes=boxes, forward=certificate)
    report_certificate(certificate, other, out, json=json)


def report_certificate(
    certificate: Certificate, other: InverseCertificate | None, out: Path | None, *, json: bool
) -> None:
    """Print certificates, write a picture if `out` is given, and end with 1 if one does not hold."""
    outputs.write_figure(out, certificate_figure, certificate)
    if json:
        outputs.write_json(_content(certificate, other))
    else:
        texts = [certificate.explain()] + ([] if other is None else [other.explain()])
        outputs.print_lines("\n\n".join(texts).splitlines())
    if not (certificate.holds and (other is None or other.holds)):
        raise typer.Exit(1)


def _content(certificate: Certificate, other: InverseCertificate | None) -> dict[str, Any]:
    def state(witness: Configuration | StageConfiguration | None) -> dict[str, Any] | None:
        return None if witness is None else {"readings": witness.readings, "pose": witness.pose.as_matrix()}

    names = ("stage",) if len(certificate.stages) == 1 else ("lower", "upper")
    content = {
        "holds": certificate.holds,
        "limits": {"minimum": certificate.limits.minimum, "maximum": certificate.limits.maximum},
        "errors": {"length": certificate.errors[0], "angle": certificate.errors[1]},
        "bounds": dict(zip(certificate.names, certificate.bounds, strict=True)),
        "boxes": {
            name: {"examined": proof.boxes, "proved": len(proof.proved), "undecided": len(proof.undecided)}
            for name, proof in zip(names, certificate.stages, strict=True)
        },
        "witness": state(certificate.witness),
    }
    if other is not None:
        measures = {name: getattr(other, name) for name in ("holds", "bound", "least")}
        content["inverse"] = {**measures, "undecided": len(other.undecided), "witness": state(other.witness)}
    return content


@outputs.name_options(**NAMES)
@options.takes_pose("start_pose", "from-", required=False)
@options.takes_pose("goal_pose", "to-", required=False)
def move(
    start: Annotated[
        SixLegs | None, leg_option("--from", "Readings at the start, in --unit, for cranks in degrees.")
    ] = None,
    goal: Annotated[SixLegs | None, leg_option("--to", "Readings at the end, as --from.")] = None,
    start_pose: RigidTransform | None = None,
    goal_pose: RigidTransform | None = None,
    via: Annotated[
        list[str] | None,
        Option(metavar="B1,B2,B3,C1,C2,C3", help="Readings to pass on the way, as --from; may be repeated, in order."),
    ] = None,
    limits: Annotated[
        tuple[str, str] | None,
        Option(
            metavar="MIN MAX", help="Limits of the readings, each one number or six, as --from; default: the machine's."
        ),
    ] = None,
    leg_rate: Annotated[str | None, largest_of("speed of a leg \\[m/s].")] = None,
    leg_acceleration: Annotated[str | None, largest_of("acceleration of a leg \\[m/s²].")] = None,
    leg_force: Annotated[str | None, largest_of("force of a leg, pushing or pulling \\[N].")] = None,
    leg_jerk: Annotated[str | None, largest_of("jerk of a leg \\[m/s³]: forces without jumps, slower.")] = None,
    twist: Annotated[_Ends, Option(metavar="V OMEGA", help="Speed limits of o \\[m/s] and turning \\[rad/s].")] = None,
    payload: Annotated[float, Option(help="Mass on the terminal platform, at o \\[kg].")] = 0.0,
    hip: Annotated[_Ends, _degrees("Angles of the revolute joints, from home, in degrees.")] = None,
    ball_x: Annotated[_Ends, _degrees("Angles of the ball joints about the legs' revolute axes, in degrees.")] = None,
    ball_y: Annotated[_Ends, _degrees("Angles of the ball joints about their middle axes.")] = None,
    ball_z: Annotated[_Ends, _degrees("Angles of the ball joints about the middle platform's normal.")] = None,
    clearance: Annotated[float | None, Option(help="Least distance of legs without a common joint, in --unit.")] = None,
    margin: Annotated[float, Option(help="Smallest |det J| of a stage over d³ on the way.")] = 0.05,
    straight: Annotated[bool, Option("--straight", help="Move o along a straight line only.")] = False,
    period: Annotated[float, Option(help="Time between the rows \\[s].")] = 2e-3,
    out: Annotated[Path | None, outputs.file_option("CSV of the motion to write.", (".csv",))] = None,
    plot: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) to write.")] = None,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    masses: options.MassesFile = None,
    json: options.AsJson = False,
) -> None:
    """Plan the fastest motion from one state to another, at rest at both ends.

    Example: spm-pin move --from 120 120 140 125 120 150 --to 140 120 120 120 150 125 --unit cm --leg-force 1500
    --leg-rate 0.5 --out motion.csv --plot motion.png

    A limit of force or of acceleration is required; X is one number for all legs, or six separated by commas. The CSV
    has the time, readings, pose and all joints in SI units; spm-pin view --path plays it. The exit code is 3 if no path
    was found, or if an end is out of reach. --plot needs the extra "plots".
    """
    dimensions = options.read_machine(machine_file)
    readings = options.Readings(dimensions, unit)
    first, last = (_end_state(*end, readings) for end in ((start, start_pose, "--from"), (goal, goal_pose, "--to")))
    allowed = dimensions.limits
    if limits is not None:
        shortest, longest = (options.leg_numbers(text, "--limits", 6, single=True) for text in limits)
        allowed = LegLimits(*readings.read_limits("--limits", shortest, longest))
    pairs = {"hip": hip, "ball_x": ball_x, "ball_y": ball_y, "ball_z": ball_z}
    angles = {name: (math.radians(pair[0]), math.radians(pair[1])) for name, pair in pairs.items() if pair is not None}
    joint_limits = JointLimits(**angles, clearance=None if clearance is None else clearance / unit.per_metre)
    typed = {"rate": leg_rate, "acceleration": leg_acceleration, "force": leg_force, "jerk": leg_jerk}
    files: dict[str, Any] = {"masses": masses, "out": out, "plot": plot}
    ways: dict[str, Any] = {"joint_limits": joint_limits, "margin": margin, "line": "poses" if straight else "legs"}
    timing: dict[str, Any] = {"twist": twist, "period": period, "payload": payload}
    move_machine(readings, [first, last], allowed, via or (), typed, ways=ways, timing=timing, **files, json=json)


def move_machine(
    readings: options.Readings,
    ends: list[Any],
    limits: LegLimits | None,
    via: Sequence[str],
    typed: dict[str, str | None],
    *,
    ways: dict[str, Any],
    timing: dict[str, Any],
    masses: Path | None,
    out: Path | None,
    plot: Path | None,
    json: bool,
) -> None:
    """Plan the fastest motion of a machine, write and print it.

    `typed` are limits of the legs, `ways` arguments of `plan` and `timing` those of `time_optimal`.
    """
    from spm_pin.motion import Payload, plan, time_optimal
    from spm_pin.motion.paths import MotionLimits
    from spm_pin.multibody.chain import ClosedChain

    machine: Any = readings.machine
    count, payload = len(machine.legs.names), timing.pop("payload")
    passed = [readings.read("--via", options.leg_numbers(text, "--via", count)) for text in via]
    largest: dict[str, Any] = {
        f"leg_{name}s": options.leg_numbers(text, f"--leg-{name}", count, single=True)
        for name, text in typed.items()
        if text is not None
    }
    # What it refuses is refused before the search for a path.
    MotionLimits(machine.legs.names, **largest, twist=timing["twist"])
    certificate = prove(machine, limits) if limits is not None else None
    start, goal = ends
    planned = plan(machine, start, goal, limits, via=passed, certificate=certificate, **ways)
    if planned.path is None:
        outputs.note(f"no path: {planned.reason}")
        raise typer.Exit(3)
    chain = ClosedChain.from_urdf(machine=machine, masses=options.read_masses(masses, "forces"))
    load = Payload(payload) if payload else None
    motion = time_optimal(chain, planned, **largest, payload=load, **timing)
    if out is not None:
        motion.to_csv(out)
        outputs.note(f"wrote {out}")
    outputs.write_figure(plot, motion_figure, motion, motion.readings, limits, largest)
    if json:
        content = {"method": planned.method, "certified": planned.certified, "margin": planned.margin}
        outputs.write_json({**content, **motion.columns()})
    else:
        _report(planned, motion, chain.leg_indices, readings)


def _end_state(
    typed: SixLegs | None, pose: RigidTransform | None, option: str, readings: options.Readings
) -> FloatArray | RigidTransform:
    """Return the state at one end of the motion as an argument of `plan`: readings (6,) in SI, or a pose."""
    if (typed is None) == (pose is None):
        received = "neither" if pose is None else "both"
        raise ArgumentError(option, f"either readings, or a pose by {option}-translation and an orientation", received)
    return pose if pose is not None else readings.read(option, typed)


def _report(planned: MotionPlan, motion: JointTrajectory, legs: IntArray, readings: options.Readings) -> None:
    proved = ", proved to be free of forward singularities" if planned.certified else ""
    outputs.print_lines([f"{motion.times[-1]:.4g} s, {planned.method}{proved}"])
    names = readings.machine.legs.names
    shown, length, effort = motion.readings * readings.scale, readings.stages("m", "rad"), readings.stages("N", "N m")
    ends = {
        f"{name} [{readings.heading}]": lambda leg, k=k: readings.text(shown[k, leg], leg)
        for name, k in (("from", 0), ("to", -1))
    }
    kinds = {
        f"rate [{length}/s]": (motion.velocities, 3),
        f"acceleration [{length}/s²]": (motion.accelerations, 2),
        f"{readings.stages('force', 'torque')} [{effort}]": (motion.efforts, 1),
    }
    largest = {
        name: lambda leg, values=values, digits=digits: fixed(np.abs(values[:, legs[leg]]).max(), digits)
        for name, (values, digits) in kinds.items()
    }
    outputs.print_table("Legs", {"leg": lambda leg: names[leg], **ends, **largest}, range(len(names)))
