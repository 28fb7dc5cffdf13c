"""Large batches worked on in portions, with a report of the progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from spm_pin.mechanism.arguments import FloatArray, Progress

_PORTION = 4096
"""Rows of a batch worked on together."""


def in_portions(
    function: Callable[..., tuple[Any, ...]],
    what: str,
    progress: Progress | None,
    first: FloatArray,
    *others: FloatArray | None,
) -> Iterator[Any]:
    """Call `function` with a portion of the rows of the arrays at a time; return each of its results, concatenated."""
    parts = [
        function(first[rows], *(None if array is None else array[rows] for array in others))
        for rows in portions(len(first), _PORTION, what, progress)
    ]
    return map(np.concatenate, zip(*parts, strict=True))


def portions(count: int, most: int, what: str, progress: Progress | None) -> Iterator[slice]:
    """Give slices of `most` rows that together are `count` rows, and report the progress; without rows an empty one."""
    for begin in range(0, max(count, 1), most):
        if progress is not None:
            progress(what, begin, count)
        yield slice(begin, min(begin + most, count))
    if progress is not None:
        progress(what, count, count)
