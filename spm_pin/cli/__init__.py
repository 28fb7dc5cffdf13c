"""The command `spm-pin`: its subcommands by subject, and their common options and outputs."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType


def main() -> None:
    """Run the command line and exit with its code: 130 after Ctrl-C at any moment, also during imports."""
    if not os.environ.get("COLUMNS", "").strip("0"):
        os.environ.pop("COLUMNS", None)  # an unknown width, with which Rich would print nothing
    interrupted, report_unraisable = False, sys.unraisablehook

    def interrupt(*_: object) -> None:
        # Libraries in C sometimes swallow the exception; the arrival of the signal decides.
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    def interrupt_again(unraisable: sys.UnraisableHookArgs) -> None:
        # An exception raised while a compiler calls Python is lost: raise it a little later.
        if isinstance(unraisable.exc_value, KeyboardInterrupt):
            main_thread = threading.main_thread().ident or 0
            threading.Timer(0.05, signal.pthread_kill, (main_thread, signal.SIGINT)).start()
        else:
            report_unraisable(unraisable)

    def quit_now(signum: int, frame: FrameType | None) -> None:
        os._exit(130)

    # A shell that starts a command in the background ignores Ctrl-C; keep that.
    handles_interrupts = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    code: str | int | None = 0
    try:
        if handles_interrupts:
            signal.signal(signal.SIGINT, interrupt)
            sys.unraisablehook = interrupt_again
        from spm_pin.cli.application import run

        code = run(lambda: interrupted)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        if handles_interrupts:
            signal.signal(signal.SIGINT, quit_now)
            sys.unraisablehook = report_unraisable
    if interrupted or code == 130:
        code = 130
        print("interrupted", file=sys.stderr, flush=True)
    sys.exit(code)
