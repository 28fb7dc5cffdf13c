"""The command `spm-pin`: one thin file per subcommand."""

import sys

__all__ = ["main"]


def main() -> None:
    """Run the command line; Ctrl-C ends it with exit code 130, also while modules are imported."""
    try:
        from spm_pin.cli.application import run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
