"""The command `spm-pin`: one thin file per subcommand."""

from __future__ import annotations

import sys

import typer

from spm_pin import __version__
from spm_pin.cli.console import stderr
from spm_pin.cli.crosscheck import crosscheck
from spm_pin.cli.draw import draw
from spm_pin.cli.export import export
from spm_pin.cli.forward import forward
from spm_pin.cli.inverse import inverse
from spm_pin.cli.reproduce import reproduce
from spm_pin.cli.singularities import singularities
from spm_pin.cli.statics import statics
from spm_pin.cli.sweep import sweep
from spm_pin.cli.urdf import urdf
from spm_pin.cli.view import view
from spm_pin.cli.workspace import workspace
from spm_pin.errors import SpmError

__all__ = ["app", "main"]

app = typer.Typer(
    help="Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command()(inverse)
app.command()(forward)
app.command()(reproduce)
app.command()(crosscheck)
app.command()(singularities)
app.command()(statics)
app.command()(urdf)
app.command()(draw)
app.command()(view)
app.command()(export)
app.command()(workspace)
app.command()(sweep)


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"spm-pin {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Show the version."),
) -> None:
    del version


def main() -> None:
    """Run the command line; an error of ours is one line on stderr and exit code 2."""
    try:
        app()
    except SpmError as error:
        stderr.print(f"[bold red]error:[/] {error}", highlight=False)
        sys.exit(2)
    except KeyboardInterrupt:
        stderr.print("interrupted")
        sys.exit(130)
