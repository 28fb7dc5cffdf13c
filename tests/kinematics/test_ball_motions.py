"""Newton's steps of three balls remove the errors to first order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spm_pin.formulas import ball_motions
from spm_pin.formulas.circles import Circles
from spm_pin.formulas.leg_planes import StageLegs, upper_balls

RNG = np.random.default_rng(2)
AXES, PIVOTS = RNG.normal(size=(2, 3, 3)), RNG.normal(size=(2, 3, 3))
AXES /= np.linalg.norm(AXES, axis=-1, keepdims=True)
BALLS, WEIGHTS = RNG.normal(size=(2, 3, 3))
SQUARES = (1.0, 1.2, 0.9)


def rows(array: np.ndarray) -> Any:
    return tuple(map(tuple, array.tolist()))


def check_step(step: Any, errors: Callable[[Any], ball_motions.Errors]) -> None:
    """Check that the errors change along a step by what they are."""
    h = 1e-6
    behind, ahead = (np.array(errors(rows(BALLS + sign * h * np.array(step)))) for sign in (-1.0, 1.0))
    np.testing.assert_allclose((ahead - behind) / (2.0 * h), errors(rows(BALLS)), rtol=1e-7, atol=1e-7)


def test_the_step_to_a_pose() -> None:
    lower, upper = (StageLegs(rows(axes), rows(pivots)) for axes, pivots in zip(AXES, PIVOTS, strict=True))
    step = ball_motions.structure_step(rows(BALLS), lower, upper, rows(WEIGHTS), SQUARES)
    check_step(
        step,
        lambda b: ball_motions.structure_errors(b, upper_balls(b, rows(WEIGHTS)), lower, upper, SQUARES),
    )


def test_the_step_to_readings() -> None:
    stage = Circles(rows(AXES[0]), rows(PIVOTS[0]), (1.1, 0.9, 1.3), SQUARES)
    arms = BALLS - PIVOTS[0]
    directions = rows(arms / np.linalg.norm(arms, axis=1)[:, None])
    motions = ball_motions.ball_motions(rows(BALLS), directions, stage.axes)
    step = ball_motions.velocities(motions, ball_motions.stage_errors(rows(BALLS), stage))
    check_step(step, lambda b: ball_motions.stage_errors(b, stage))
