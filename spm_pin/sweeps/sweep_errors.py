"""Errors of a sweep: one that stopped, and a store that cannot be read or written, or that is in use."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

from spm_pin.errors import SpmError

_UNREADABLE = (SpmError, LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""Exceptions raised while damaged contents of a store are read."""


class SweepError(SpmError):
    """A sweep that stopped; what it had done is kept.

    Attributes
    ----------
    store : str
        Path of the store.
    reason : str
        Why it stopped.
    done, total : int
        Chunks that are complete, and all chunks.
    """

    def __init__(self, store: str, reason: str, done: int, total: int) -> None:
        self.store = store
        self.reason = reason
        self.done = done
        self.total = total
        super().__init__(
            f"{reason}. {done} of {total} chunks are complete in {store} and stay so; "
            "the same sweep, started again, does the others"
        )


class StoreError(SpmError):
    """A store that cannot be read or written.

    Attributes
    ----------
    path : str
        The store.
    reason : str
        What failed, and on which host.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: {reason}")


class StoreLockedError(StoreError):
    """Another process is at work on a store."""


@contextlib.contextmanager
def as_store_error(path: Path, reading: str = "") -> Iterator[None]:
    """Turn an `OSError` into a `StoreError` that says where it happened.

    Where something is read, `reading` says what; the errors that its damaged contents raise become a `StoreError` too.
    """
    try:
        yield
    except StoreError:
        raise
    except OSError as error:
        where = f" at {error.filename}" if error.filename and str(error.filename) != str(path) else ""
        reason = f"{(error.strerror or str(error)).lower()}{where}, on host {socket.gethostname()}"
        raise StoreError(str(path), reason) from error
    except _UNREADABLE as error:
        if not reading:
            raise
        text = " ".join(str(error).split())[:200]
        reason = f"its {reading} cannot be read ({type(error).__name__}: {text}). Sweep into another folder"
        raise StoreError(str(path), reason) from error
