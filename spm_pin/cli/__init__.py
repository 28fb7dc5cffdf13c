"""The command `spm-pin`: one thin file per subcommand."""

import sys

__all__ = ["main"]


def main() -> None:
    """Run the command line; Ctrl-C ends every command with exit code 130, also while modules are imported."""
    try:
        from spm_pin.cli.application import run

        run()
        return
    except KeyboardInterrupt:
        pass
    except SystemExit as end:
        if end.code != 130:
            raise
    sys.stderr.write("interrupted\n")
    sys.exit(130)
