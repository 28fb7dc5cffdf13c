"""A peer: another program or method for the same task, and its preparation for timing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module, metadata
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Unavailable(Exception):  # noqa: N818  (a result, not an error)
    """Raised where a peer cannot be timed on this machine; the message gives the reason."""


@dataclass(frozen=True)
class Prepared:
    """A task prepared for a peer.

    Attributes
    ----------
    call : callable
        The timed call; returns the result in the peer's format.
    read : callable
        Converts that result into the common format of the task; not timed.
    """

    call: Callable[[], Any]
    read: Callable[[Any], Any]


@dataclass(frozen=True)
class Peer:
    """Another way to solve a task.

    Attributes
    ----------
    name : str
        Short, unique within the task.
    computes : str
        Description of what is timed.
    prepare : callable
        Makes a `Prepared` from the problems of the task; raises `Unavailable`.
    items : int
        Problems in one timed call: many for fast peers, few for slow ones.
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
