"""What a peer is: something that answers the same question, and how to ask it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module, metadata
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["FloatArray", "Peer", "Prepared", "Unavailable", "required", "version"]

FloatArray = npt.NDArray[np.float64]


class Unavailable(Exception):  # noqa: N818  (it is an answer, not an error)
    """A peer cannot take part here; the message says why."""


@dataclass(frozen=True)
class Prepared:
    """A question made ready for a peer.

    Attributes
    ----------
    call : callable
        What is timed; returns the peer's own kind of answer.
    read : callable
        Turns that answer into the one all peers of the contest are compared by. Not timed.
    """

    call: Callable[[], Any]
    read: Callable[[Any], Any]


@dataclass(frozen=True)
class Peer:
    """One way to answer a question.

    Attributes
    ----------
    name : str
        Short, unique within its contest.
    computes : str
        What exactly is on the clock.
    prepare : callable
        From the problems of the contest to a `Prepared`; raises `Unavailable`.
    items : int
        Problems handed over in one timed call: as many as the fast ones need to show their speed, and few where one
        takes long.
    """

    name: str
    computes: str
    prepare: Callable[[Any], Prepared]
    items: int


def required(module: str, package: str) -> Any:
    """Import a module, or raise `Unavailable` naming the package it comes with."""
    try:
        return import_module(module)
    except ImportError as missing:
        raise Unavailable(f"{package} is not installed ({missing})") from missing


def version(package: str) -> str:
    """Return the installed version of a distribution, or "not installed"."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
