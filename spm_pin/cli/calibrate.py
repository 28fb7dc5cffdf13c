"""`spm-pin calibrate`, the machine as built from measured poses and leg readings, and `tolerance`, what errors cost."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Argument, Option

from spm_pin.calibration import Calibration, identify, read_measurements
from spm_pin.calibration import tolerance as analyse
from spm_pin.calibration.error_model import parameter_scale
from spm_pin.cli import options, outputs
from spm_pin.display.figures import calibration_figure
from spm_pin.mechanism import LEGS, PARAMETERS


@outputs.name_options(loss="--loss", parameters="--identify", pose_noise="--pose-noise", length_noise="--length-noise")
def calibrate(
    measurements: Annotated[
        Path, Argument(metavar="CSV", help="Columns x y z \\[m], qx qy qz qw if measured, r_b1 to r_c3 \\[m].")
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
    length_noise: Annotated[float, Option(metavar="M", help="Standard deviation of the readings.")] = 1e-6,
    loss: Annotated[
        str, Option(help="linear refuses outliers; soft_l1, huber, cauchy give them less weight.")
    ] = "linear",
    geometry: options.GeometryFile = None,
    force: Annotated[bool, Option("--force", help="Write --out even where the measurements do not fit.")] = False,
    json: options.AsJson = False,
) -> None:
    """Identify the machine as built from measured poses and leg readings.

    Example: spm-pin calibrate measurements.csv --out machine.yaml

    Lengths are in metres, angles in radians. The quaternion is the rotation from {m} to {B}, scalar last. The file
    written can be given as --geometry to other commands. --figure needs the extra "plots".

    The exit code is 1, and no machine is written without --force, if a row does not belong to the others or residuals
    exceed three times what the noise explains.
    """
    dimensions = options.read_geometry(geometry)
    poses, readings = read_measurements(measurements)
    noise: dict[str, Any] = {"pose_noise": pose_noise, "length_noise": length_noise}
    found = identify(dimensions, poses, readings, parameters=identified, loss=loss, **noise)
    if json:
        machine = found.fitted.parameters, np.sqrt(np.diagonal(found.covariance))
        values, deviations = (dict(zip(PARAMETERS, array, strict=True)) for array in machine)
        sizes = {name: {"unit": unit, "before": a, "after": b} for name, unit, a, b in _sizes(found)}
        content = {"measurements": len(found.misfit), "identified": len(found.deviations), "rms": sizes}
        content |= {name: getattr(found, name) for name in ("status", "reason", "chi_square", "misfit")}
        content |= {"outliers": np.flatnonzero(found.outliers)}
        outputs.write_json(content | {"parameters": values, "standard_deviations": deviations})
    else:
        _report(found)
    outputs.write_figure(figure, calibration_figure, found)
    fits = found.status == "fits"
    if not fits:
        outputs.note(f"the measurements do not fit one machine: {found.reason}")
    if out is not None and (fits or force):
        found.fitted.to_yaml(out)
        outputs.note(f"wrote {out}")
    if not fits and not force:
        raise typer.Exit(1)


def _sizes(found: Calibration) -> list[tuple[str, str, float, float]]:
    """Return each compared quantity, its unit, and its root mean square before and after."""
    rows = []
    for name, unit, part in (("position", "mm", slice(3)), ("orientation", "mrad", slice(3, 6))):
        if found.before[:, part].size:
            sizes = [1e3 * np.sqrt((e[:, part] ** 2).sum(axis=-1).mean()) for e in (found.before, found.residuals)]
            rows.append((name, unit, float(sizes[0]), float(sizes[1])))
    return rows


def _report(found: Calibration) -> None:
    known, total = len(found.deviations), len(found.deviations) + len(found.unidentifiable)
    lines = [f"{known} of {total} combinations of parameters identified from {len(found.misfit)} measurements"]
    for name, unit, before, after in _sizes(found):
        errors = f"{before:.3g} {unit} before, {after:.3g} {unit} after"
        lines.append(f"{name} predicted from the readings, RMS error: {errors}")
    lines.append(f"residuals are {np.sqrt(found.chi_square):.2g} times what the noise given explains")
    scale = parameter_scale(found.fitted)
    worst = np.argsort(-np.abs(found.identifiable[-1]))[:2]
    apart = 1e3 * found.deviations[-1] * np.abs(found.identifiable[-1, worst] * scale[worst])
    units = ["mrad" if k % 9 < 2 else "mm" for k in worst]
    least = " and ".join(f"{PARAMETERS[k]} by {x:.2g} {u}" for k, x, u in zip(worst, apart, units, strict=True))
    lines.append(f"least known is the combination that moves {least} (standard deviation)")
    if found.outliers.any():
        rows = ", ".join(map(str, np.flatnonzero(found.outliers)))
        lines.append(f"outliers in the rows {rows} after the heading, from 0")
    outputs.print_lines(lines)
    nominal = found.fitted.nominal
    changes = (found.fitted.parameters - nominal.parameters).reshape(6, 9)
    names = [name.split(".")[1] for name in PARAMETERS[:9]]
    numbers = {name: lambda leg, k=k: outputs.significant(1e3 * changes[leg, k], 3) for k, name in enumerate(names)}
    columns = {"leg": lambda leg: LEGS[leg], **numbers}
    outputs.print_table("Differences from the nominal machine [mm, mrad]", columns, range(6))


Deviation = Annotated[float, Option(min=0.0, metavar="SIGMA", help="Standard deviation, in metres or radians.")]


@outputs.name_options(rng="--seed")
def tolerance(
    direction: Deviation = 1e-4,
    pivot: Deviation = 1e-4,
    ball: Deviation = 1e-4,
    offset: Deviation = 1e-4,
    by: Annotated[str, Option(help="What to rank: parameter, component, kind or leg.")] = "component",
    states: Annotated[int, Option(min=1, help="States to draw within the leg limits.")] = 60,
    samples: Annotated[int, Option(min=0, help="Random machines; 0 for first order alone.")] = 200,
    seed: Annotated[int, Option(min=0, help="Seed of states and machines.")] = 0,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Predict how far the platform is off if its dimensions are, and which tolerance pays.

    Example: spm-pin tolerance --direction 1e-4 --pivot 5e-5 --ball 5e-5 --offset 1e-5
    """
    table = {"direction": direction, "pivot": pivot, "ball": ball, "offset": offset}
    found = analyse(options.read_geometry(geometry), table, states, samples=samples, rng=seed)
    ranking = found.ranking(by)
    linear, sampled = found.rms, found.sampled_rms
    if json:
        sizes = {"rms": linear, "sampled_rms": sampled}
        named = {name: {"position": size[0], "angle": size[1]} for name, size in sizes.items()}
        outputs.write_json({"tolerances": table, **named, "shares": dict(ranking)})
        return
    lines = [f"RMS error of the platform at {states} states, to first order: {_text(linear)}"]
    if samples:
        lines.append(f"of {samples} random machines: {_text(sampled)}; 95 % within {_text(found.percentile())}")
    outputs.print_lines(lines)
    columns = {by: lambda row: str(row[0]), "share": lambda row: f"{row[1]:.1%}"}
    outputs.print_table("Shares of the variance of the position", columns, ranking[:20])


def _text(sizes: tuple[float, float]) -> str:
    return f"{1e3 * sizes[0]:.3g} mm and {1e3 * sizes[1]:.3g} mrad"
