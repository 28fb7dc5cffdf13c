"""`spm-pin calibrate`, which identifies a machine from measurements and readings, and `spm-pin tolerance`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Argument, Option

from spm_pin.calibration import Calibration, Inclinations, MeasurementError, identify, read_measurements
from spm_pin.calibration import tolerance as analyse
from spm_pin.calibration.measurements import LEVEL_NOISE, TRACKER_NOISE
from spm_pin.cli import outputs
from spm_pin.cli.options import MachineFile, Picture, Seed, warnings_as_notes
from spm_pin.cli.outputs import Part, Report, Table
from spm_pin.cli.units import MachineInUnits
from spm_pin.display.figures import calibration_figure
from spm_pin.errors import ArgumentError
from spm_pin.support.motion_table import MotionTable


def calibrate(
    measurements: Annotated[
        Path,
        Argument(
            metavar="CSV",
            help="Columns x y z \\[m], qx qy qz qw if measured; or roll pitch \\[rad], height \\[m], or all three; and "
            "readings r_b1 to r_c3 (r_1 to r_3 for a stage) \\[m or rad].",
        ),
    ],
    typed: MachineInUnits,
    out: MachineFile = None,
    figure: Picture = None,
    parameters: Annotated[
        list[str] | None, Option("--identify", metavar="NAME", help="Such as offset or r_b1; repeatable. Default: all.")
    ] = None,
    pose_noise: Annotated[
        tuple[float, float] | None,
        Option(
            metavar="M RAD",
            help="Standard deviations of positions or heights, and of orientations or tilts; default: 1e-5 1e-5, "
            "of heights, roll and pitch 5e-4 2e-3.",
        ),
    ] = None,
    reading_noise: Annotated[float, Option(metavar="M", help="Standard deviation of readings \\[m or rad].")] = 1e-6,
    frames: Annotated[
        bool,
        Option("--frames", help="Estimate the frames too: of a tracker and its target, or of the base and an IMU."),
    ] = False,
    tolerances: Annotated[
        list[str] | None,
        Option(
            "--tolerance",
            metavar="SIGMA",
            help="Standard deviation of dimensions as made \\[m, rad]; or NAME=SIGMA, as for --identify; repeatable.",
        ),
    ] = None,
    loss: Annotated[str, Option(help="linear refuses outliers; soft_l1, huber, cauchy weigh them less.")] = "linear",
    force: Annotated[bool, Option("--force", help="Write --out even if the measurements do not fit.")] = False,
) -> Report:
    """Identify a machine from measured poses, or from tilts of an IMU and heights of a ruler, and leg readings.

    Example: spm-pin calibrate measurements.csv --out machine.yaml

    Example: spm-pin stage calibrate seen.csv --base 80 --platform 90 --crank 50 --rod 110 --unit mm --out stage.yaml

    Lengths are in metres, angles in radians, in the file and in JSON; --unit is that of the machine's dimensions alone.
    The quaternion is the rotation from {m} to {B}, scalar last. Cells of roll, pitch and height may be empty. Other
    commands take the written file as --machine. --figure needs the extra "plots".

    The exit code is 1, and no machine is written without --force, if a row does not fit the others, residuals
    exceed three times what the noise explains, or E, C or d differ by more than 4 % from the nominal ones. It is 1,
    without a machine to write, if the measurements are in another unit, in other columns or rows, or too few. It is 2
    if the file cannot be read.
    """
    machine = typed.machine
    with warnings_as_notes():
        poses, readings = read_measurements(measurements)
    if pose_noise is None:
        pose_noise = LEVEL_NOISE if isinstance(poses, Inclinations) else TRACKER_NOISE
    made = _read_tolerances(tolerances, typed.names) if tolerances else None
    noise: dict[str, Any] = {"pose_noise": pose_noise, "reading_noise": reading_noise, "tolerances": made}
    try:
        calibration = identify(machine, poses, readings, parameters=parameters, loss=loss, frames=frames, **noise)
    except MeasurementError as error:
        message = _with_lines(f"error: the measurements fit no machine: {error}", error.rows, measurements)
        outputs.note(message, "bold red")
        raise typer.Exit(1) from None
    outputs.write_figure(figure, calibration_figure, calibration)
    fits = calibration.status == "fits"
    if out is not None and (fits or force):
        calibration.fitted.to_yaml(out)
        outputs.note(f"wrote {out}")
    if not fits:
        which = "the nominal" if calibration.status == "another nominal" else "one"
        message = f"the measurements do not fit {which} machine: {calibration.reason}"
        outputs.note(_with_lines(message, calibration.reason_rows, measurements))
        if calibration.status == "misfit":
            metres, radians = pose_noise
            outputs.note(f"noise given: --pose-noise {metres:g} {radians:g} --reading-noise {reading_noise:g}")
    parts = _parts(calibration, measurements, has_tolerances=bool(tolerances))
    return Report(_content(calibration), parts, 0 if fits or force else 1)


def _content(calibration: Calibration[Any]) -> dict[str, Any]:
    values = dict(zip(calibration.fitted.parameter_names, calibration.fitted.parameters, strict=True))
    deviations = dict(zip(calibration.names, calibration.standard_deviations, strict=True))
    sizes = {name: {"unit": unit, "before": a, "after": b} for name, unit, a, b in _sizes(calibration)}
    content = {"measurements": len(calibration.misfit), "identified": len(calibration.deviations), "rms": sizes}
    names = ("status", "reason", "reason_rows", "chi_square", "misfit")
    content |= {name: getattr(calibration, name) for name in names}
    content |= {"outliers": np.flatnonzero(calibration.outliers)}
    content |= {name: getattr(calibration, name).as_matrix() for name in ("base", "target")}
    return content | {"parameters": values, "standard_deviations": deviations}


def _read_tolerances(typed: list[str], legs: Sequence[str]) -> dict[str, float]:
    """Return standard deviations by names: a number alone is of all legs, and later ones replace earlier ones."""
    table: dict[str, float] = {}
    for text in typed:
        name, _, number = text.rpartition("=")
        try:
            table |= dict.fromkeys([name] if name else legs, float(number))
        except ValueError:
            raise ArgumentError("--tolerance", "a number, or a name and a number, such as offset=0.05", text) from None
    return table


def _sizes(calibration: Calibration[Any]) -> list[tuple[str, str, float, float]]:
    """Return each compared quantity, its unit, m or rad, and its root mean square before and after."""
    rows = []
    for name, unit, *sizes in calibration.error_sizes:
        before, after = (float(np.sqrt(np.nanmean(size**2))) for size in sizes)
        rows.append((name, unit, before, after))
    return rows


def _with_lines(message: str, rows: Sequence[int], path: Path) -> str:
    """Return a message about rows of measurements, with the lines of their file on which these are."""
    if not rows:
        return message
    lines = MotionTable(path).lines
    many, numbers = "s" * (len(rows) > 1), ", ".join(str(lines[row]) for row in rows)
    return f"{message} (row{many} {', '.join(map(str, rows))}: line{many} {numbers} of {path.name})"


def _parts(calibration: Calibration[Any], measurements: Path, *, has_tolerances: bool) -> list[Part]:
    known, total = len(calibration.deviations), len(calibration.deviations) + len(calibration.unidentifiable)
    lines = [f"{known} of {total} combinations of parameters identified from {len(calibration.misfit)} measurements"]
    for name, unit, before, after in _sizes(calibration):
        errors = f"{1e3 * before:.3g} m{unit} before, {1e3 * after:.3g} m{unit} after"
        lines.append(f"{name} predicted from the readings, RMS error: {errors}")
    if np.isfinite(calibration.chi_square):
        lines.append(f"residuals are {np.sqrt(calibration.chi_square):.2g} times what the noise given explains")
    scale = np.where(np.array(calibration.units) == "rad", 1.0, calibration.fitted.ball_side)
    worst = np.argsort(-np.abs(calibration.identifiable[-1]))[:2]
    apart = 1e3 * calibration.deviations[-1] * np.abs(calibration.identifiable[-1, worst] * scale[worst])
    least = " and ".join(
        f"{calibration.names[k]} by {x:.2g} m{calibration.units[k]}" for k, x in zip(worst, apart, strict=True)
    )
    lines.append(f"the least accurate combination moves {least} (standard deviation)")
    if calibration.outliers.any():
        rows = np.flatnonzero(calibration.outliers).tolist()
        lines.append(_with_lines(f"{len(rows)} outlier{'s' * (len(rows) > 1)}", rows, measurements))
    if len(calibration.names) > len(calibration.fitted.parameters):
        frames_of = {"{B} in the frame of the measurements": calibration.base}
        frames_of["target or IMU on the platform"] = calibration.target
        for name, frame in frames_of.items():
            position = ", ".join(f"{x:.6g}" for x in frame.translation)
            turn = ", ".join(f"{x:.6g}" for x in frame.rotation.as_quat())
            lines.append(f"{name}: position {position} m, quaternion {turn}")
    fitted = calibration.fitted
    changes = fitted.parameters - fitted.nominal.parameters
    # Numbers below twice their standard deviation are in brackets; it is larger if the given noise is too small.
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
    parts: list[Part] = [*lines, Table("Differences from the nominal machine [mm, mrad]", columns, fitted.legs.names)]
    parts.append("(…) is below twice its standard deviation: not known by itself, but in combinations with others.")
    if not has_tolerances:
        parts.append("--tolerance SIGMA, how well the parts are made, keeps these near the nominal machine.")
    return parts


def _deviation(help_text: str) -> Any:
    return Option(min=0.0, metavar="SIGMA", help=f"Standard deviation of {help_text}")


def tolerance(
    typed: MachineInUnits,
    direction: Annotated[float, _deviation("the directions of revolute axes and slides \\[rad].")] = 1e-4,
    pivot: Annotated[float, _deviation("each coordinate of the pivots \\[m].")] = 1e-4,
    ball: Annotated[float, _deviation("each coordinate of the ball joints \\[m].")] = 1e-4,
    offset: Annotated[float, _deviation("the encoders' offsets \\[m], for RRS legs \\[rad].")] = 1e-4,
    rod: Annotated[float | None, _deviation("the rods \\[m]; default: 1e-4 for legs with rods.")] = None,
    crank: Annotated[float | None, _deviation("the cranks \\[m]; default: 1e-4 for legs with cranks.")] = None,
    by: Annotated[str, Option(help="Group of the ranking: parameter, component, kind or leg.")] = "component",
    states: Annotated[int, Option(min=1, help="Number of random states within the leg limits.")] = 60,
    samples: Annotated[int, Option(min=0, help="Number of random machines; 0 for first order only.")] = 200,
    rng: Seed = 0,
) -> Report:
    """Predict the accuracy of the platform for tolerances of the dimensions, and rank them.

    Example: spm-pin tolerance --direction 1e-4 --pivot 5e-5 --ball 5e-5 --offset 1e-5

    Example: spm-pin stage tolerance --machine balancer.yaml --pivot 2e-4 --offset 2e-3

    States are drawn within the limits of the readings, which the machine must have.
    """
    machine = typed.machine
    table = {"direction": direction, "pivot": pivot, "ball": ball, "offset": offset}
    for name, deviation in (("rod", rod), ("crank", crank)):
        if deviation is not None or any(x.endswith(f".{name}") for x in machine.parameter_names):
            table[name] = 1e-4 if deviation is None else deviation
    analysis = analyse(machine, table, states, samples=samples, rng=rng)
    ranking = analysis.ranking(by)
    sizes = {"rms": analysis.rms, "sampled_rms": analysis.sampled_rms}
    named = {name: dict(zip(("position", "angle"), size, strict=True)) for name, size in sizes.items()}
    lines = [f"RMS error of the platform at {states} states, to first order: {_text(analysis.rms)}"]
    if samples:
        spread = f"{_text(analysis.sampled_rms)}; 95 % within {_text(analysis.percentile())}"
        lines.append(f"of {samples} random machines: {spread}")
    columns = {by: lambda row: str(row[0]), "share": lambda row: f"{row[1]:.1%}"}
    shares = Table("Shares of the variance of the position", columns, ranking[:20])
    return Report({"tolerances": table, **named, "shares": dict(ranking)}, [*lines, shares])


def _text(sizes: tuple[float, float]) -> str:
    return f"{1e3 * sizes[0]:.3g} mm and {1e3 * sizes[1]:.3g} mrad"
