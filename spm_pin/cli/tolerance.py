"""`spm-pin tolerance`: accuracy of the platform from tolerances of the dimensions."""

from __future__ import annotations

from typing import Annotated

import typer

from spm_pin.calibration import tolerance as analyse
from spm_pin.cli import options, outputs

Deviation = Annotated[float, typer.Option(min=0.0, metavar="SIGMA", help="Standard deviation, in metres or radians.")]


@outputs.name_options(rng="--seed")
def tolerance(
    direction: Deviation = 1e-4,
    pivot: Deviation = 1e-4,
    ball: Deviation = 1e-4,
    offset: Deviation = 1e-4,
    by: Annotated[str, typer.Option(help="What to rank: parameter, component, kind or leg.")] = "component",
    states: Annotated[int, typer.Option(min=1, help="States to draw within the leg limits.")] = 60,
    samples: Annotated[int, typer.Option(min=0, help="Random machines; 0 for first order alone.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of states and machines.")] = 0,
    geometry: options.AnyGeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Predict how far the platform is off if its dimensions are, and which tolerance pays.

    Example: spm-pin tolerance --direction 1e-4 --pivot 5e-5 --ball 5e-5 --offset 1e-5
    """
    table = {"direction": direction, "pivot": pivot, "ball": ball, "offset": offset}
    found = analyse(options.read_any_geometry(geometry), table, states, samples=samples, rng=seed)
    ranking = found.ranking(by)
    if json:
        linear, sampled = (dict(zip(("position", "angle"), x, strict=True)) for x in (found.rms, found.sampled_rms))
        outputs.write_json({"tolerances": table, "rms": linear, "sampled_rms": sampled, "shares": dict(ranking)})
        return
    lines = [f"RMS error of the platform at {states} states, to first order: {_text(found.rms)}"]
    if samples:
        usual, most = _text(found.sampled_rms), _text(found.percentile())
        lines.append(f"of {samples} random machines: {usual}; 95 % within {most}")
    outputs.print_lines(lines)
    rows = [[name, f"{share:.1%}"] for name, share in ranking[:20]]
    outputs.print_table("Shares of the variance of the position", [by, "share"], rows)


def _text(sizes: tuple[float, float]) -> str:
    return f"{1e3 * sizes[0]:.3g} mm and {1e3 * sizes[1]:.3g} mrad"
