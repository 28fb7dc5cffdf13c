"""Kinds of singularity of a manipulator or a stage, and when a matrix is singular to rounding."""

from __future__ import annotations

import enum

import numpy as np
import numpy.typing as npt

from spm_pin.support.arguments import BoolArray

SINGULAR = 64.0 * float(np.finfo(np.float64).eps)
"""A matrix is singular to rounding where its smallest singular value is at most this times its largest.

A unit vector computed from joint positions is off by a few eps, and so is an arm (b_i - p)/d. Six rows of two
such parts, of coordinates a few times d, make a matrix off by some 10 √12 eps < 64 eps in the Frobenius norm:
a smaller singular value may as well be zero.
"""


class SingularityKind(enum.IntFlag):
    """Kinds of singularity; a configuration can be of several."""

    REGULAR = 0
    INVERSE = 1
    FORWARD = 2
    CONSTRAINT = 4
    LEG = 8

    def __str__(self) -> str:
        return " and ".join(str(kind.name).lower() for kind in SingularityKind if kind & self) or "regular"


def kinds_text(kinds: npt.NDArray[np.int8], exists: BoolArray) -> str:
    """Return the kind of a state, or how many of a batch exist and are of each kind."""
    if not kinds.shape:
        return str(SingularityKind(int(kinds))) if exists else "does not exist"
    counts = [f"{np.count_nonzero(kinds & kind)} {kind}" for kind in SingularityKind if (kinds & kind).any()]
    return f"{kinds.shape} states, {np.count_nonzero(exists)} exist, {', '.join(counts) or 'all regular'}"
