"""The command `spm-pin`: its subcommands, exit codes, and the display of errors."""

from __future__ import annotations

import ast
import os
from collections.abc import Callable
from functools import cache, cached_property
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from spm_pin import __version__
from spm_pin.cli import outputs
from spm_pin.errors import SpmError, UnreachableError

EXIT_CODES = (
    "Exit codes: 0 success. 1 a comparison or a proof failed: methods disagree, a printed number is unexplained, there "
    "is a singularity within leg limits, measurements fit no machine or are in another unit. 2 the command is not "
    "valid as typed: an option, a file, a missing extra. 3 unreachable: no solution, no path, move to an end beyond "
    "the limits, design with no machine within the bounds. 4 degenerate: a continuous family of solutions; isolated "
    "solutions are shown. 5 beyond the limits: solutions are shown, but none is physical and within the "
    "leg limits. 70 a defect of spm-pin. 74 input or output failed: a full device, a closed pipe. 130 "
    "Ctrl-C, which ends every command, also view; crosscheck reports the poses done, sweep and design continue when "
    "started again."
)


app = typer.Typer(
    help="Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator and of its stages.",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


class _Command(TyperCommand):
    """A command whose function is imported only when its options are needed, not for a list of commands."""

    def __init__(self, name: str | None, *, callback: Callable[..., Any] | None = None, **settings: Any) -> None:
        super().__init__(name, **settings)
        self._load = callback
        # Both are made from the function.
        del self.params, self.callback

    @cached_property
    def _made(self) -> Any:
        assert self._load is not None
        single = typer.Typer(add_completion=False)
        single.command()(self._load())
        return get_command(single)

    @cached_property
    def params(self) -> Any:  # type: ignore[override]
        """The options and arguments."""
        return self._made.params

    @cached_property
    def callback(self) -> Any:  # type: ignore[override]
        """The function."""
        return self._made.callback

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the options, without a type for flags, which take no value."""
        params: list[Any] = super().get_params(ctx)
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the options; an error about a value shows the typed text and the expected number of values."""
        options: dict[str, Any] = {name: parameter for parameter in self.params for name in parameter.opts}
        typed: dict[Any, list[str]] = {}
        for place, text in enumerate(args):
            if text in options:
                typed[options[text]] = list(takewhile(lambda value: not value.startswith("--"), args[place + 1 :]))
        has_arguments = any(parameter.param_type_name == "argument" for parameter in self.params)
        for parameter, values in typed.items():
            if 1 < parameter.nargs != len(values) and not (has_arguments and len(values) > parameter.nargs):
                raise typer.BadParameter(_numbers_expected(parameter, values), ctx=ctx, param=parameter)
        try:
            return super().parse_args(ctx, list(args))
        except typer.BadParameter as error:
            wrong: Any = error.param
            if (values := typed.get(wrong, [])) and wrong.nargs > 1:
                error.message = _numbers_expected(wrong, values)
            elif values and values[0] not in error.message:
                error.message += f", got {values[0]}"
            raise

    def invoke(self, ctx: Any) -> Any:
        """Run the command; a closed pipe exits with 74, not with typer's 1, which is a failed comparison."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise typer.Exit(74) from None


def _numbers_expected(parameter: Any, values: list[str]) -> str:
    return f"expected {parameter.nargs} numbers, {parameter.metavar}, got {' '.join(values) or 'none'}"


_COMMANDS = {
    "crosscheck": ("demo", "reproduce", "crosscheck"),
    "states": ("inverse", "nearest", "forward", "singularities", "statics"),
    "draw": ("draw", "view"),
    "workspace": ("workspace", "reach"),
    "move": ("certify", "move"),
    "calibrate": ("calibrate", "tolerance"),
    "sweep": ("sweep", "design"),
    "export": ("write", "export"),
}
"""The commands, named like their functions, in the order of the help, by their files."""
_OF_OTHERS = {False: {"reach"}, True: {"demo", "reproduce", "workspace"}}
"""The commands that a manipulator, or a stage, does not have."""


def _add_commands(group: typer.Typer, *, of_stage: bool) -> None:
    """Add the commands of a kind of machine; the help has the examples for it."""
    for file, names in _COMMANDS.items():
        for name in names:
            if name in _OF_OTHERS[of_stage]:
                continue
            # Typer would keep the line breaks of the docstring and wrap them again in a narrower window.
            paragraphs = [" ".join(text.split()) for text in _docstrings(file)[name].split("\n\n")]
            kept = [text for text in paragraphs if "Example" not in text or (": spm-pin stage " in text) == of_stage]
            group.command(name, cls=_Command, help="\n\n".join(kept))(_loader(name, file, of_stage=of_stage))


def _loader(name: str, file: str, *, of_stage: bool) -> Callable[[], Callable[..., None]]:
    """Return a function that imports a command, under the command's name."""

    def load() -> Callable[..., None]:
        from spm_pin.cli.options import make_command

        return make_command(getattr(import_module(f"spm_pin.cli.{file}"), name), of_stage=of_stage)

    load.__name__ = name
    return load


@cache
def _docstrings(file: str) -> dict[str, str]:
    """Return the docstrings of the functions in a file, without importing it."""
    module = ast.parse(Path(__file__).with_name(f"{file}.py").read_bytes())
    return {part.name: ast.get_docstring(part) or "" for part in module.body if isinstance(part, ast.FunctionDef)}


_stage = typer.Typer(
    help="Most of these commands for a stage (ball balancer, tripod head, mirror mount), and reach for its workspace.",
    no_args_is_help=True,
)
_add_commands(_stage, of_stage=True)
app.add_typer(_stage, name="stage")
_add_commands(app, of_stage=False)


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(f"spm-pin {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Show the version."),
) -> None:
    del version


def run(was_interrupted: Callable[[], bool]) -> str | int | None:
    """Run the command line and return its exit code; an error is one line on stderr.

    A traceback is shown only if SPM_PIN_TRACEBACK is set. Errors caused by an interrupt are not shown.
    """
    outputs.write_any_text()
    try:
        try:
            app()
        except SystemExit as end:
            return end.code
        finally:
            # Flush here, where an error of a full device can still be shown.
            outputs.flush()
    except SpmError as error:
        outputs.note(f"error: {error}", "bold red")
        return 3 if isinstance(error, UnreachableError) else 2
    except Exception as error:
        if was_interrupted():
            return 130
        if os.environ.get("SPM_PIN_TRACEBACK"):
            raise
        if isinstance(error, OSError):
            if not isinstance(error, BrokenPipeError):  # the reader has closed the pipe on purpose
                outputs.note(f"error: input or output failed: {error}", "bold red")
            return 74
        outputs.note(f"error: {type(error).__name__}: {error}", "bold red")
        outputs.note("This is a defect of spm-pin. With SPM_PIN_TRACEBACK=1 in the environment it shows where.")
        return 70
    return 0
