"""The command line run in this process."""

from __future__ import annotations

import io
import signal
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from unittest.mock import patch

from spm_pin.cli import main

COMMAND = [sys.executable, "-c", "from spm_pin.cli import main; main()"]
"""The command line as a process of its own."""
POSE = ["--translation", "68.89", "49.63", "225.3", "--xyx", "-11.08", "32.97", "-12.88"]
LEGS = ["--legs", "120", "120", "140", "125", "120", "150"]
"""The paper's example in centimetres."""


@dataclass
class Done:
    """Exit code and outputs of a command."""

    returncode: int
    stdout: str
    stderr: str

    @property
    def output(self) -> str:
        """Return what is on stdout, then what is on stderr."""
        return self.stdout + self.stderr

    @property
    def message(self) -> str:
        """Return what is on stderr in one line, without the frames that typer draws."""
        return " ".join(self.stderr.replace("│", " ").split())


def run(*arguments: object, encoding: str = "utf-8") -> Done:
    """Run `spm-pin` with arguments, and a stdout of an encoding."""
    out, err = io.TextIOWrapper(io.BytesIO(), encoding, newline="", write_through=True), io.StringIO()
    code = 0
    handler = signal.getsignal(signal.SIGINT)
    with patch.object(sys, "argv", ["spm-pin", *map(str, arguments)]), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        finally:
            signal.signal(signal.SIGINT, handler)
    return Done(code, out.buffer.getvalue().decode(encoding), err.getvalue())
