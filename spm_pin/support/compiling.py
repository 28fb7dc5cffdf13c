"""Compiling: what forces or forbids it, and its lock, which a fork waits for."""

import os
import threading

from spm_pin.errors import ArgumentError

ENVIRONMENT = "SPM_PIN_KERNELS"
"""Environment variable: "compiled" compiles every kernel when it is first called, "interpreted" none."""
# Held while Numba compiles: a child process that is forked meanwhile would wait for ever for Numba's own lock.
COMPILING = threading.RLock()

os.register_at_fork(before=COMPILING.acquire, after_in_parent=COMPILING.release, after_in_child=COMPILING.release)


def forced() -> str:
    """Return "compiled" or "interpreted" if the environment forces either, otherwise an empty text."""
    value = os.environ.get(ENVIRONMENT, "")
    if value not in ("", "compiled", "interpreted"):
        raise ArgumentError(ENVIRONMENT, "'compiled' or 'interpreted'", repr(value))
    return value
