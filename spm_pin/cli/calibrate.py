"""`spm-pin calibrate`, the machine as built from measured poses and leg readings, and `tolerance`, what errors cost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Argument, Option

from spm_pin.calibration import Calibration, MeasurementError, identify, read_measurements
from spm_pin.calibration import tolerance as analyse
from spm_pin.cli import options, outputs
from spm_pin.display.figures import calibration_figure
from spm_pin.machine import LEGS
from spm_pin.support.motion_table import MotionTable


@outputs.name_options(
    loss="--loss",
    parameters="--identify",
    pose_noise="--pose-noise",
    reading_noise="--reading-noise",
    tolerances="--tolerance",
)
def calibrate(
    measurements: Annotated[
        Path, Argument(metavar="CSV", help="Columns x y z \\[m], qx qy qz qw if measured, r_b1 to r_c3 \\[m or rad].")
    ],
    out: Annotated[Path | None, outputs.file_option("YAML file of the machine to write.", (".yaml", ".yml"))] = None,
    figure: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) of the errors to write.")] = None,
    identified: Annotated[
        list[str] | None,
        Option("--identify", metavar="NAME", help="Parameters, such as offset or r_b1; may be repeated. All if not."),
    ] = None,
    pose_noise: Annotated[
        tuple[float, float], Option(metavar="M RAD", help="Standard deviations of positions and orientations.")
    ] = (1e-5, 1e-5),
    reading_noise: Annotated[
        float, Option(metavar="M", help="Standard deviation of the readings, of RRS legs in radians.")
    ] = 1e-6,
    frames: Annotated[
        bool, Option("--frames", help="Poses are a target's as a tracker sees them: estimate both frames too.")
    ] = False,
    tolerance: Annotated[
        float | None,
        Option(
            metavar="SIGMA", help="Standard deviation of all dimensions as made, in metres and radians; unknown if not."
        ),
    ] = None,
    loss: Annotated[
        str, Option(help="linear refuses outliers; soft_l1, huber, cauchy give them less weight.")
    ] = "linear",
    machine_file: options.MachineFile = None,
    force: Annotated[bool, Option("--force", help="Write --out even where the measurements do not fit.")] = False,
    json: options.AsJson = False,
) -> None:
    """Identify the machine as built from measured poses and leg readings.

    Example: spm-pin calibrate measurements.csv --out machine.yaml

    Lengths are in metres, angles in radians. The quaternion is the rotation from {m} to {B}, scalar last. The file
    written can be given as --machine to other commands. --figure needs the extra "plots".

    The exit code is 1, and no machine is written without --force, if a row does not belong to the others, residuals
    exceed three times what the noise explains, or E, C or d come out more than 4 % from the nominal ones. It is 1, and
    there is no machine to write, if the measurements are in another unit, in other columns or rows, or too few. It is 2
    if the file cannot be read.
    """
    dimensions = options.read_machine(machine_file)
    with options.warnings_as_notes():
        poses, readings = read_measurements(measurements)
    noise: dict[str, Any] = {"pose_noise": pose_noise, "reading_noise": reading_noise, "frames": frames}
    noise["tolerances"] = None if tolerance is None else dict.fromkeys(LEGS, tolerance)
    try:
        calibration = identify(dimensions, poses, readings, parameters=identified, loss=loss, **noise)
    except MeasurementError as error:
        message = _with_lines(f"error: the measurements fit no machine: {error}", error.rows, measurements)
        outputs.note(message, "bold red")
        raise typer.Exit(1) from None
    outputs.write_figure(figure, calibration_figure, calibration)
    fits = calibration.status == "fits"
    if out is not None and (fits or force):
        calibration.fitted.to_yaml(out)
        outputs.note(f"wrote {out}")
    if json:
        values = dict(zip(calibration.fitted.parameter_names, calibration.fitted.parameters, strict=True))
        deviations = dict(zip(calibration.names, calibration.standard_deviations, strict=True))
        sizes = {name: {"unit": unit, "before": a, "after": b} for name, unit, a, b in _sizes(calibration)}
        content = {"measurements": len(calibration.misfit), "identified": len(calibration.deviations), "rms": sizes}
        names = ("status", "reason", "reason_rows", "chi_square", "misfit")
        content |= {name: getattr(calibration, name) for name in names}
        content |= {"outliers": np.flatnonzero(calibration.outliers)}
        content |= {name: getattr(calibration, name).as_matrix() for name in ("base", "target")}
        outputs.write_json(content | {"parameters": values, "standard_deviations": deviations})
    else:
        _report(calibration, measurements, tolerance)
    if not fits:
        which = "the nominal" if calibration.status == "another nominal" else "one"
        message = f"the measurements do not fit {which} machine: {calibration.reason}"
        outputs.note(_with_lines(message, calibration.reason_rows, measurements))
        if calibration.status == "misfit":
            metres, radians = pose_noise
            outputs.note(f"noise given: --pose-noise {metres:g} {radians:g} --reading-noise {reading_noise:g}")
        if not force:
            raise typer.Exit(1)


def _sizes(calibration: Calibration) -> list[tuple[str, str, float, float]]:
    """Return each compared quantity, its unit, and its root mean square before and after."""
    rows = []
    for name, unit, part in (("position", "mm", slice(3)), ("orientation", "mrad", slice(3, 6))):
        if calibration.before[:, part].size:
            errors = calibration.before[:, part], calibration.residuals[:, part]
            before, after = (1e3 * float(np.sqrt((e**2).sum(axis=-1).mean())) for e in errors)
            rows.append((name, unit, before, after))
    return rows


def _with_lines(message: str, rows: Sequence[int], path: Path) -> str:
    """Return a message about rows of measurements, with the lines of their file on which these are."""
    if not rows:
        return message
    lines = MotionTable(path).lines
    many, numbers = "s" * (len(rows) > 1), ", ".join(str(lines[row]) for row in rows)
    return f"{message} (row{many} {', '.join(map(str, rows))}: line{many} {numbers} of {path.name})"


def _report(calibration: Calibration, measurements: Path, tolerance: float | None) -> None:
    known, total = len(calibration.deviations), len(calibration.deviations) + len(calibration.unidentifiable)
    lines = [f"{known} of {total} combinations of parameters identified from {len(calibration.misfit)} measurements"]
    for name, unit, before, after in _sizes(calibration):
        errors = f"{before:.3g} {unit} before, {after:.3g} {unit} after"
        lines.append(f"{name} predicted from the readings, RMS error: {errors}")
    if np.isfinite(calibration.chi_square):
        lines.append(f"residuals are {np.sqrt(calibration.chi_square):.2g} times what the noise given explains")
    scale = np.where(np.array(calibration.units) == "rad", 1.0, calibration.fitted.middle_side)
    worst = np.argsort(-np.abs(calibration.identifiable[-1]))[:2]
    apart = 1e3 * calibration.deviations[-1] * np.abs(calibration.identifiable[-1, worst] * scale[worst])
    least = " and ".join(
        f"{calibration.names[k]} by {x:.2g} m{calibration.units[k]}" for k, x in zip(worst, apart, strict=True)
    )
    lines.append(f"least known is the combination that moves {least} (standard deviation)")
    if calibration.outliers.any():
        rows = np.flatnonzero(calibration.outliers).tolist()
        lines.append(_with_lines(f"{len(rows)} outlier{'s' * (len(rows) > 1)}", rows, measurements))
    if len(calibration.names) > len(calibration.fitted.parameters):
        for name, frame in (("{B} from the tracker", calibration.base), ("the target in {m}", calibration.target)):
            position = ", ".join(f"{x:.6g}" for x in frame.translation)
            turn = ", ".join(f"{x:.6g}" for x in frame.rotation.as_quat())
            lines.append(f"{name}: position {position} m, quaternion {turn}")
    outputs.print_lines(lines)
    fitted = calibration.fitted
    changes = fitted.parameters - fitted.nominal.parameters
    # In brackets what is smaller than twice its standard deviation, which is larger where the noise given is too small.
    spread = 2.0 * np.sqrt(np.fmax(calibration.chi_square, 1.0))
    texts = {
        name: f"({text})" if abs(change) < spread * deviation else text
        for name, change, deviation in zip(
            fitted.parameter_names, changes, calibration.standard_deviations, strict=False
        )
        for text in [outputs.significant(1e3 * change, 3)]
    }
    components = dict.fromkeys(name.partition(".")[2] for name in texts)
    columns: dict[str, Any] = {"leg": str}
    columns |= {part: lambda leg, part=part: texts.get(f"{leg}.{part}", "") for part in components}
    outputs.print_table("Differences from the nominal machine [mm, mrad]", columns, LEGS)
    lines = ["(…) is smaller than twice its standard deviation: not known by itself, but in combinations with others."]
    if tolerance is None:
        lines.append("--tolerance SIGMA, how well the parts are made, keeps these near the nominal machine.")
    outputs.print_lines(lines)


def _deviation(help_text: str) -> Any:
    return Option(min=0.0, metavar="SIGMA", help=f"Standard deviation of {help_text}")


@outputs.name_options(rng="--seed")
def tolerance(
    direction: Annotated[float, _deviation("the directions of revolute axes and slides, in radians.")] = 1e-4,
    pivot: Annotated[float, _deviation("each coordinate of the pivots, in metres.")] = 1e-4,
    ball: Annotated[float, _deviation("each coordinate of the ball joints, in metres.")] = 1e-4,
    offset: Annotated[float, _deviation("the encoders' offsets, in metres, of RRS legs in radians.")] = 1e-4,
    rod: Annotated[float | None, _deviation("the rods, in metres; 1e-4 of legs that have them.")] = None,
    crank: Annotated[float | None, _deviation("the cranks, in metres; 1e-4 of legs that have them.")] = None,
    by: Annotated[str, Option(help="What to rank: parameter, component, kind or leg.")] = "component",
    states: Annotated[int, Option(min=1, help="States to draw within the leg limits.")] = 60,
    samples: Annotated[int, Option(min=0, help="Random machines; 0 for first order alone.")] = 200,
    seed: Annotated[int, Option(min=0, help="Seed of states and machines.")] = 0,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Predict how far the platform is off if its dimensions are, and which tolerance pays.

    Example: spm-pin tolerance --direction 1e-4 --pivot 5e-5 --ball 5e-5 --offset 1e-5
    """
    machine = options.read_machine(machine_file)
    table = {"direction": direction, "pivot": pivot, "ball": ball, "offset": offset}
    for name, deviation in (("rod", rod), ("crank", crank)):
        if deviation is not None or any(x.endswith(f".{name}") for x in machine.parameter_names):
            table[name] = 1e-4 if deviation is None else deviation
    analysis = analyse(machine, table, states, samples=samples, rng=seed)
    ranking = analysis.ranking(by)
    linear, sampled = analysis.rms, analysis.sampled_rms
    if json:
        sizes = {"rms": linear, "sampled_rms": sampled}
        named = {name: {"position": size[0], "angle": size[1]} for name, size in sizes.items()}
        outputs.write_json({"tolerances": table, **named, "shares": dict(ranking)})
        return
    lines = [f"RMS error of the platform at {states} states, to first order: {_text(linear)}"]
    if samples:
        lines.append(f"of {samples} random machines: {_text(sampled)}; 95 % within {_text(analysis.percentile())}")
    outputs.print_lines(lines)
    columns = {by: lambda row: str(row[0]), "share": lambda row: f"{row[1]:.1%}"}
    outputs.print_table("Shares of the variance of the position", columns, ranking[:20])


def _text(sizes: tuple[float, float]) -> str:
    return f"{1e3 * sizes[0]:.3g} mm and {1e3 * sizes[1]:.3g} mrad"
