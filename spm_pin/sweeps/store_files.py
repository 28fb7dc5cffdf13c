"""Files of a store: their errors, the lock, and the wait until they are on the disk."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

from spm_pin.errors import SpmError

__all__ = [
    "LOCK",
    "StoreError",
    "StoreLockedError",
    "as_store_error",
    "locked",
    "read_file",
    "require_file",
    "require_files",
    "synchronise",
]

LOCK = "sweep/lock"
"""The file by which a store is locked."""


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


def require_file(path: Path) -> None:
    """Raise `OSError` if a path is missing, or no regular file: to open a pipe may take for ever."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def require_files(path: Path) -> None:
    """Raise `OSError` if there is anything but folders and regular files in a store; readers open what they find."""
    folders = [str(path)]
    while folders:
        with os.scandir(folders.pop()) as scan:
            entries = list(scan)
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                folders.append(entry.path)
            elif not entry.is_file():
                with contextlib.suppress(FileNotFoundError):  # a draft that has just been renamed
                    require_file(Path(entry.path))


def read_file(path: Path) -> bytes:
    """Return the content of a regular file."""
    require_file(path)
    return path.read_bytes()


def synchronise(*paths: Path) -> None:
    """Wait until files, or the names in folders, are on the disk."""
    for path in paths:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def as_store_error(path: Path) -> Iterator[None]:
    """Turn an `OSError` into a `StoreError` that says where it happened."""
    try:
        yield
    except OSError as error:
        where = f" at {error.filename}" if error.filename and str(error.filename) != str(path) else ""
        reason = f"{(error.strerror or str(error)).lower()}{where}, on host {socket.gethostname()}"
        raise StoreError(str(path), reason) from error


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a store, a file in it, which the system releases however its holder ends."""
    from filelock import FileLock, Timeout

    file = path / LOCK
    lock = FileLock(file, fallback_to_soft=False)
    with as_store_error(path):
        if file.exists():
            require_file(file)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            reason = f"{_holder(file)} is at work on this store. Wait for it, or end it; what it did is kept"
            raise StoreLockedError(str(path), reason) from None
        except OSError as error:
            # A file system without locks; two processes would write the same bytes, each file as a whole.
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                raise
        file.write_text(json.dumps({"host": socket.gethostname(), "pid": os.getpid()}), encoding="utf-8")
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            file.write_text("", encoding="utf-8")
        lock.release()


def _holder(file: Path) -> str:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return f"process {content['pid']} on {content['host']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
