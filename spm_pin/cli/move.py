"""`spm-pin certify` proves that limits have no singularities; `move` plans the fastest motion within limits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from typer import Option

from spm_pin.cli import outputs
from spm_pin.cli.options import OF_MANIPULATOR, Legs, Masses_, Picture, leg_numbers, read_masses
from spm_pin.cli.outputs import Report, Table
from spm_pin.cli.requests import Request
from spm_pin.cli.units import MachineInUnits
from spm_pin.display.figures import certificate_figure, motion_figure
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, GeometryError, UnreachableError, sentence
from spm_pin.proofs import Certificate, InverseCertificate, certify_inverse
from spm_pin.proofs import certify as prove
from spm_pin.support.arguments import IntArray
from spm_pin.workspace import JointLimits

if TYPE_CHECKING:
    from spm_pin.motion import MotionPlan
    from spm_pin.multibody.trajectory import JointTrajectory

_Ends = tuple[float, float] | None


def certify(
    typed: MachineInUnits,
    boxes: Annotated[int, Option(min=1, help="Maximum number of boxes in each stage.")] = 300_000,
    length_error: Annotated[float, Option(help="Errors of pivots, balls and readings, in --unit.")] = 0.0,
    angle_error: Annotated[float, Option(help="Errors of the revolute axes, in radians.")] = 0.0,
    inverse: Annotated[bool, Option("--inverse", help="Also inverse singularities."), OF_MANIPULATOR] = False,
    out: Picture = None,
) -> Report:
    """Prove that no forward singularity is within the leg limits, so that readings determine the configuration.

    Example: spm-pin certify --limits 1.1 1.5

    Example: spm-pin stage certify --base 80 --platform 90 --crank 50 --rod 110 --limits 0 50 --unit mm

    The exit code is 0 if the proof succeeds, 1 if a singular configuration was found or boxes were left undecided.
    --out needs the extra "plots". For the file of a calibrated machine it is proved for all machines that are as close
    to the nominal one. JSON is in metres and radians.
    """
    machine = typed.machine
    if inverse and (length_error or angle_error or not machine.is_nominal):
        cause = "A bound of |det K| is proved for one nominal machine only"
        raise GeometryError("--inverse", "a nominal machine, without dimensional errors", "errors as well", cause)
    other = None
    with outputs.stderr.status("dividing the states of the stages"):
        length = length_error / typed.unit.per_metre
        certificate = prove(machine, boxes=boxes, length_error=length, angle_error=angle_error)
        if inverse:
            other = certify_inverse(machine, certificate.limits, boxes=boxes, forward=certificate)
    outputs.write_figure(out, certificate_figure, certificate)
    texts = [certificate.explain()] + ([] if other is None else ["", other.explain()])
    holds = certificate.holds and (other is None or other.holds)
    return Report(_content(certificate, other), "\n".join(texts).splitlines(), 0 if holds else 1)


def _content(certificate: Certificate, other: InverseCertificate | None) -> dict[str, Any]:
    def state(witness: Any) -> dict[str, Any] | None:
        return None if witness is None else {"readings": witness.readings, "pose": witness.pose.as_matrix()}

    names = ("stage",) if len(certificate.stages) == 1 else ("lower", "upper")
    content = {
        "holds": certificate.holds,
        "unit": "m",
        "reading_units": certificate.machine.legs.units,
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


def _largest(option: str, help_text: str) -> Any:
    """Return an option for an upper limit: one number, or one for each leg, separated by commas."""
    return Option(option, metavar="X", help=f"Largest {help_text}")


def _range(help_text: str) -> Any:
    return Option(metavar="MIN MAX", help=f"Angles of {help_text}, in degrees.")


def move(
    typed: MachineInUnits,
    start: Annotated[Legs | None, "Readings at the start", "--from"] = None,
    goal: Annotated[Legs | None, "Readings at the end", "--to"] = None,
    start_pose: Annotated[Request | None, "from-"] = None,
    goal_pose: Annotated[Request | None, "to-"] = None,
    via: Annotated[
        list[str] | None,
        Option(metavar="READINGS", help="Readings to pass, separated by commas; repeatable, in order."),
    ] = None,
    leg_rates: Annotated[str | None, _largest("--leg-rate", "speed of a leg \\[m/s or rad/s].")] = None,
    leg_accelerations: Annotated[str | None, _largest("--leg-acceleration", "acceleration \\[m/s² or rad/s²].")] = None,
    leg_forces: Annotated[str | None, _largest("--leg-force", "force, pushing or pulling \\[N or N m].")] = None,
    leg_jerks: Annotated[str | None, _largest("--leg-jerk", "jerk \\[m/s³ or rad/s³]: no jumps of forces.")] = None,
    twist: Annotated[_Ends, Option(metavar="V OMEGA", help="Speed limits of o \\[m/s] and turning \\[rad/s].")] = None,
    mass: Annotated[float, Option("--payload", help="Mass on the platform, at o \\[kg].")] = 0.0,
    hip: Annotated[_Ends, _range("the passive revolute joints, from home")] = None,
    ball_x: Annotated[_Ends, _range("the ball joints about the legs' revolute axes")] = None,
    ball_y: Annotated[_Ends, _range("the ball joints about their middle axes")] = None,
    ball_z: Annotated[_Ends, _range("the ball joints about the platform's normal")] = None,
    clearance: Annotated[float | None, Option(help="Least distance of legs without a common joint, in --unit.")] = None,
    margin: Annotated[float, Option(help="Smallest |det J| of a stage over d³ on the way.")] = 0.05,
    straight: Annotated[bool, Option("--straight", help="Move o along a straight line only.")] = False,
    period: Annotated[float, Option(help="Time between the rows \\[s].")] = 2e-3,
    out: Annotated[Path | None, outputs.file_option("CSV of the motion to write.", (".csv",))] = None,
    plot: Picture = None,
    masses: Masses_ = None,
) -> Report:
    """Plan the fastest motion from one state to another, at rest at both ends.

    Example: spm-pin move --from 120 120 140 125 120 150 --to 140 120 120 120 150 125 --unit cm --leg-force 1500
    --leg-rate 0.5 --out motion.csv --plot motion.png

    Example: spm-pin stage move --base 80 --platform 90 --crank 50 --rod 110 --limits 0 50 --unit mm --from 20 20 20
    --to 10 35 25 --leg-rate 8 --leg-acceleration 100 --out motion.csv

    A limit of force or of acceleration is required; X is one number for all legs, or one for each, separated by commas.
    The CSV has the time, readings, pose and all joints in SI units, as has JSON; spm-pin view --path plays that of a
    manipulator. The exit code is 3 if no path was found, or if an end is out of reach. --plot needs the extra "plots".
    """
    from spm_pin.motion import Payload, plan, time_optimal
    from spm_pin.motion.paths import MotionLimits
    from spm_pin.multibody.chain import ClosedChain

    machine, count = typed.machine, len(typed.names)
    first, last = (_end_state(*end) for end in ((start, start_pose, "--from"), (goal, goal_pose, "--to")))
    pairs = {"hip": hip, "ball_x": ball_x, "ball_y": ball_y, "ball_z": ball_z}
    angles: dict[str, Any] = {name: np.radians(pair) for name, pair in pairs.items() if pair is not None}
    joint_limits = JointLimits(**angles, clearance=None if clearance is None else clearance / typed.unit.per_metre)
    passed = [typed.read("--via", leg_numbers(text, "--via", count)) for text in via or ()]
    allowed = {"leg_rates": leg_rates, "leg_accelerations": leg_accelerations}
    allowed |= {"leg_forces": leg_forces, "leg_jerks": leg_jerks}
    largest: dict[str, Any] = {
        name: leg_numbers(text, f"--{name.replace('_', '-')[:-1]}", count, single=True)
        for name, text in allowed.items()
        if text is not None
    }
    # What it refuses is refused before the search for a path.
    MotionLimits(typed.names, **largest, twist=twist)
    planned = plan(
        machine,
        first,
        last,
        via=passed,
        joint_limits=joint_limits,
        margin=margin,
        line="poses" if straight else "legs",
        certificate=prove(machine) if machine.limits is not None else None,
    )
    if planned.path is None:
        outputs.note(f"no path: {planned.reason}")
        raise typer.Exit(3)
    chain = ClosedChain.from_urdf(machine=machine, masses=read_masses(masses, "forces"))
    load = Payload(mass) if mass else None
    motion = time_optimal(chain, planned, **largest, payload=load, twist=twist, period=period)
    if out is not None:
        motion.to_csv(out)
        outputs.note(f"wrote {out}")
    outputs.write_figure(plot, motion_figure, motion, machine.limits, largest)
    content = {"method": planned.method, "certified": planned.certified, "margin": planned.margin}
    return Report({**content, **motion.columns()}, _motion_parts(planned, motion, chain.leg_indices, typed))


def _end_state(readings: Any, pose: Request | None, option: str) -> Any:
    """Return the state at one end of the motion as an argument of `plan`: readings in SI, or the state of a pose."""
    if (readings is None) == (pose is None):
        expected = f"either readings, or a pose by {option}-translation and an orientation"
        raise ArgumentError(option, expected, "neither" if pose is None else "both")
    if pose is None:
        return readings
    state = pose.physical()
    if not state.exists:
        cause = pose.hint() or sentence(state.missing_reason)
        raise UnreachableError(f"{option}-{pose.needed}", "a pose with a physical branch", "a pose without one", cause)
    return state


def _motion_parts(
    planned: MotionPlan, motion: JointTrajectory, legs: IntArray, typed: MachineInUnits
) -> list[Table | str]:
    proved = ", proved to be free of forward singularities" if planned.certified else ""
    shown, length, effort = motion.readings * typed.scale, typed.stages("m", "rad"), typed.stages("N", "N m")
    ends = {
        f"{name} [{typed.heading}]": lambda leg, k=k: typed.text(shown[k, leg], leg)
        for name, k in (("from", 0), ("to", -1))
    }
    kinds = {
        f"rate [{length}/s]": (motion.velocities, 3),
        f"acceleration [{length}/s²]": (motion.accelerations, 2),
        f"{typed.stages('force', 'torque')} [{effort}]": (motion.efforts, 1),
    }
    largest = {
        name: lambda leg, values=values, digits=digits: fixed(np.abs(values[:, legs[leg]]).max(), digits)
        for name, (values, digits) in kinds.items()
    }
    columns = {"leg": lambda leg: typed.names[leg], **ends, **largest}
    return [f"{motion.times[-1]:.4g} s, {planned.method}{proved}", Table("Legs", columns, range(len(typed.names)))]
