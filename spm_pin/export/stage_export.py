"""The kinematics of a stage alone in C99, for microcontrollers: one header, and a test program with known answers."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.export.c_texts import checked_prefix, common_values, machine_text, rendered, write_sources
from spm_pin.formulas.leg_constants import LIMIT_ROUNDING
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.kinematics import inverse_physical
from spm_pin.machine import Configuration, Stage
from spm_pin.support.arguments import FloatArray, check_instance
from spm_pin.workspace import home_height

_CASES, _TRIED = 12, (48, 4096)
"""Known answers, and states tried for them: few at first, for which no kernels are compiled."""
_TILT, _LIFT = 0.3, 0.15
"""Largest tilt [rad] of the known answers, and change of height in units of the platform's radius."""
_CLEAR = 0.2
"""Least slope of a leg, over its largest, in a known answer: far from where digits are lost."""


def stage_c_sources(stage: Stage, *, prefix: str = "stage_") -> dict[str, str]:
    """Return the C library of a stage: a header that needs nothing but `math.h`, and a test program.

    Parameters
    ----------
    stage : Stage
        The stage that is built in, nominal or calibrated. The functions take others too.
    prefix : str
        What all names begin with. Another one is put before the names of the files: `left_stage.h`.

    Returns
    -------
    dict of str
        The texts of `stage.h` and `stage_test.c` by their names.

    Notes
    -----
    Numbers are float, or double where `STAGE_DOUBLE` is defined. An `UnreachableError` is raised for a stage that does
    not hold its platform level at any height within its limits.
    """
    check_instance(stage, Stage, "stage")
    prefix = checked_prefix(prefix)
    numbers = stage_numbers(stage)
    file = "stage" if prefix == "stage_" else f"{prefix}stage"
    values = {
        **common_values(stage, prefix),
        "file": file,
        "guard": f"{file.upper()}_H",
        "limit_rounding": LIMIT_ROUNDING,
        "most_turned": MOST_TURNED,
        "kind": stage.kind.name,
        "numbers": numbers,
        "reals": partial(_reals, prefix=prefix.upper()),
        **_known_answers(stage, numbers[1]),
    }
    return {f"{file}.h": rendered("stage.h", values), f"{file}_test.c": rendered("stage_test.c", values)}


def write_stage_c(stage: Stage, directory: str | Path, *, prefix: str = "stage_") -> list[Path]:
    """Write what `stage_c_sources` returns into a directory, made if need be; all of it or nothing. Returns the paths.

    Files of the same names are replaced.
    """
    return write_sources(directory, lambda: stage_c_sources(stage, prefix=prefix))


def stage_numbers(stage: Stage) -> FloatArray:
    """Return the numbers of a `stage_geometry` (65,): `up`, the height at home, and twenty-one of each leg."""
    legs, kind = stage.legs, stage.kind
    angle = np.broadcast_to(getattr(kind, "direction", np.nan), 3)
    fixed = [np.broadcast_to(getattr(kind, name, 0.0), 3) for name in ("crank", "rod")]
    fixed += [np.nan_to_num(np.cos(angle)), np.nan_to_num(np.sin(angle))]
    fixed += [np.broadcast_to(getattr(kind, "sign", 0.0), 3), legs.offsets, *stage.reading_limits]
    fixed += [np.where(np.array(legs.units) == "rad", stage.crank_middles + legs.offsets, 0.0)]
    numbers = np.concatenate([legs.pivots, *legs.planes, legs.balls, np.stack(fixed, axis=-1)], axis=-1)
    return np.concatenate([[stage.kind.up, home_height(stage)], numbers.ravel()])


def stage_machine_sources(stage: Stage) -> dict[str, str]:
    """Return the numbers of a stage as a file, `stage_machine.txt`, and the C that reads it, `stage_read_machine.h`."""
    numbers = stage_numbers(stage)
    fields = {"up": numbers[:1], "home_height": numbers[1:2]}
    fields |= dict(zip(("leg_1", "leg_2", "leg_3"), numbers[2:].reshape(3, -1), strict=True))
    values = {
        **common_values(stage, "stage_"),
        "header": "stage.h",
        "fields": fields,
        "numbers": "&geometry->up",
        "is_machine": "stage_tilt(geometry, 0, 0, geometry->home_height, &state) == STAGE_OK\n"
        "            && stage_forward(geometry, state.readings, &state, &state) == STAGE_OK",
    }
    reader = rendered("read_machine.h", values)
    return {"stage_machine.txt": machine_text(values["machine_file"], fields), "stage_read_machine.h": reader}


def _reals(numbers: npt.ArrayLike, prefix: str) -> str:
    """Return numbers in C, of the type that the header has; its macros begin with the prefix."""

    def text(x: float) -> str:
        if math.isinf(x):
            return f"{prefix}NO_LIMIT" if x > 0.0 else f"-{prefix}NO_LIMIT"
        return str(int(x)) if x == int(x) else f"{prefix}R({x!r})"

    return ", ".join(text(float(x)) for x in np.ravel(numbers))


def _known_answers(stage: Stage, home: float) -> dict[str, Any]:
    """Return the tables of the test program: states about home, found by the package."""
    for count in _TRIED:
        states = _held_states(stage, home, count)
        if states.shape[0] == _CASES:
            break
    readings, size = states.readings, stage.base_radius + stage.platform_radius
    rows = np.concatenate([states.normal, states.translation[:, 2:], states.translation[:, :2], readings], axis=-1)
    return {
        "answers": rows,
        "size": float(size),
        "reading_size": float(max(np.abs(readings).max(), 1.0 if stage.unit == "rad" else size)),
    }


def _held_states(stage: Stage, home: float, count: int) -> Configuration:
    """Return up to `_CASES` states within the limits and far from singularities, of `count` drawn about home."""
    rng, share = np.random.default_rng(17), np.linspace(1.0, 0.0, count)
    tilt, azimuth = _TILT * share * rng.random(count), rng.uniform(-np.pi, np.pi, count)
    height = home + _LIFT * stage.platform_radius * share * rng.uniform(-1.0, 1.0, count)
    states = inverse_physical(stage, height, tilt=tilt, azimuth=azimuth)
    slopes = np.abs(stage.legs.slopes(states.places, states.readings)) / stage.legs.largest_slopes
    (low, high), readings = stage.reading_limits, states.readings
    good = states.exists & ((readings > low) & (readings < high) & (slopes > _CLEAR)).all(axis=-1)
    return states[np.flatnonzero(good)[:_CASES]]
