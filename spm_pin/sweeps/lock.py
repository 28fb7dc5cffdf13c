"""One process at a time on a store: a lock that the kernel lets go of when its holder dies."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from spm_pin.errors import SpmError

__all__ = ["StoreLockedError", "locked"]


class StoreLockedError(SpmError):
    """Another process is at work on a store.

    Attributes
    ----------
    store : str
        Path of the store.
    holder : str
        Who holds it, as far as known.
    """

    def __init__(self, store: str, holder: str) -> None:
        self.store = store
        self.holder = holder
        super().__init__(f"{store}: {holder} is at work on this store. Wait for it, or end it; what it did is kept")

    def __reduce__(self) -> tuple[type[StoreLockedError], tuple[str, str]]:
        return type(self), (self.store, self.holder)


@contextlib.contextmanager
def locked(store: Path) -> Iterator[None]:
    """Hold the lock of a store, the file of its name with ``.lock`` added.

    The lock is advisory, of the kind of ``flock``. No lock is ever stale: the kernel releases that of a process which
    ends, however it ends. On NFS it holds across hosts; on a file system without such locks, or with locks that each
    host keeps for itself, two hosts are not kept apart. They then do work twice, but no harm: chunks are replaced as
    a whole, by the same bytes.

    Raises
    ------
    StoreLockedError
        If another process holds it.
    OSError
        If the file cannot be written.
    """
    import fcntl

    path = store.with_name(f"{store.name}.lock")
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise StoreLockedError(str(store), _holder(descriptor)) from None
            except OSError as error:
                if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                    raise
            # Whoever held it before may have removed the file between the two calls above.
            if not _is_still(path, descriptor):
                continue
            os.ftruncate(descriptor, 0)
            os.write(descriptor, json.dumps({"host": socket.gethostname(), "pid": os.getpid()}).encode())
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
            return
        finally:
            os.close(descriptor)


def _is_still(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _holder(descriptor: int) -> str:
    try:
        content = json.loads(os.pread(descriptor, 4096, 0))
        return f"process {content['pid']} on {content['host']}"
    except (ValueError, KeyError, TypeError):
        return "another process"
