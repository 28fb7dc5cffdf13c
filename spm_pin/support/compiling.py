"""The lock of compiling, which a fork waits for."""

import os
import threading

COMPILING = threading.RLock()
"""Held while Numba compiles. A child process that is forked meanwhile would wait for ever for Numba's own lock."""

os.register_at_fork(before=COMPILING.acquire, after_in_parent=COMPILING.release, after_in_child=COMPILING.release)
