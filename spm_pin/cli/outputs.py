"""Output of the subcommands: text and tables on the console, and files, checked with their extras before the work."""

from __future__ import annotations

import codecs
import contextlib
import functools
import io
import math
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import typer
from rich.cells import cell_len
from rich.console import Console

from spm_pin.display.figures import FORMATS, save_figure, to_json
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism.arguments import writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Without markup: file names and messages may contain brackets, which Rich would take for styles.
stdout = Console(markup=False, highlight=False)
stderr = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)

_ROUNDING = 1e-12
"""A number smaller than this share of its scale is printed as zero."""

P = ParamSpec("P")
R = TypeVar("R")
Row = TypeVar("Row")


_ASCII = {"─": "-", "│": "|", "²": "^2", "³": "^3", "°": " deg", "σ": "s", "ω": "w", "Δ": "d", "±": "+-", "·": "*"}
_ASCII |= {"×": "x", "•": "*", "→": "->", "≤": "<=", "≥": ">=", "…": "...", "–": "-", "√": "sqrt", "−": "-", "∞": "inf"}


def write_any_text() -> None:
    """Let stdout and stderr take every text: what their encoding does not have is written in ASCII."""

    def in_ascii(error: UnicodeError) -> tuple[str, int]:
        assert isinstance(error, UnicodeEncodeError)
        text = error.object[error.start : error.end]
        return "".join(_ASCII.get(character, "?") for character in text), error.end

    codecs.register_error("spm_pin", in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spm_pin")


def flush() -> None:
    """Write what stdout still holds; if that fails, raise `OSError`, and let nothing more be written."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        # Python writes the rest when it ends, and would fail again.
        with Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise


def print_lines(lines: Iterable[str], style: str | None = None) -> None:
    """Print sentences on stdout, wrapped between words on a screen and not at all in a pipe."""
    for line in lines:
        stdout.print(line, style=style, soft_wrap=not stdout.is_terminal)


def note(text: str, style: str | None = None) -> None:
    """Print a line on stderr, beside the results; where that is full there is no place left to say so."""
    with contextlib.suppress(OSError):
        stderr.print(text, style=style)


def print_table(
    title: str,
    columns: Mapping[str, Callable[[Row], str]],
    rows: Iterable[Row],
    *,
    left: Collection[str] = (),
    group: Callable[[Row], object] = lambda row: None,
    style: Callable[[Row], str | None] = lambda row: None,
) -> None:
    """Print a table on stdout whose cells are never cut: `columns` are headings and the text of each for a row.

    In a pipe a line is as long as it needs to be. On a screen, columns that do not fit follow in further blocks below,
    each beginning with the first column. That column is aligned to the left, and so are those with headings in `left`;
    an empty line separates rows of another `group`.
    """
    rows, headings = list(rows), list(columns)
    cells = [[text(row) for text in columns.values()] for row in rows]
    widths = [max(cell_len(cell) for cell in column) for column in zip(headings, *cells, strict=True)]
    screen = stdout.width if stdout.is_terminal else math.inf
    blocks = [[0]]
    for k in range(1, len(headings)):
        if len(blocks[-1]) > 1 and sum(widths[c] + 2 for c in (*blocks[-1], k)) > screen:
            blocks.append([0])
        blocks[-1].append(k)

    def line(texts: Sequence[str], block: list[int], style: str | None = None) -> None:
        padded = []
        for k in block:
            space = " " * (widths[k] - cell_len(texts[k]))
            padded.append(texts[k] + space if k == 0 or headings[k] in left else space + texts[k])
        stdout.print(" " + "  ".join(padded).rstrip(), style=style, soft_wrap=True)

    stdout.print(title, style="bold", soft_wrap=True)
    for block in blocks:
        stdout.print()
        line(headings, block, "bold")
        stdout.print(" " + "─" * (sum(widths[k] + 2 for k in block) - 2), soft_wrap=True)
        for number, (row, texts) in enumerate(zip(rows, cells, strict=True)):
            if number and group(row) != group(rows[number - 1]):
                stdout.print()
            line(texts, block, style(row))
    stdout.print()


def significant(value: float, scale: float = 0.0, digits: int = 5) -> str:
    """Format with a number of significant digits; what is rounding beside `scale` is 0."""
    return "0" if abs(value) <= _ROUNDING * scale else f"{value:.{digits}g}"


def file_name(text: str) -> Path:
    """Read the value of an option that names a file or a directory."""
    if not text:
        raise typer.BadParameter("expected a file or a directory, got an empty name")
    return Path(text)


def file_option(help_text: str, endings: Sequence[str] = (), extra: str = "") -> Any:
    """Return an option of a file to write, checked before the work by `check_output`, and the extra that it needs."""

    def check(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
        if path is not None:
            check_output(path, parameter.opts[0], endings)
            if extra:
                require_extra(extra)
        return path

    return typer.Option(metavar="FILE", help=help_text, parser=file_name, callback=check)


def picture_option(help_text: str) -> Any:
    """Return an option of a picture to write, as `file_option`."""
    return file_option(help_text, FORMATS, "plots")


def check_output(path: Path, option: str = "--out", endings: Sequence[str] = (), cause: str = "") -> None:
    """Raise `ArgumentError` if a file cannot be written later: its ending, its folder, its permissions.

    Without `endings` any is allowed; `cause` is added to the message about them.
    """
    if endings and path.suffix.lower() not in endings:
        raise ArgumentError(option, f"a file name ending in {', '.join(endings)}", path.name, cause)
    reason = ""
    if path.is_dir():
        reason = "It is a directory"
    elif not path.parent.is_dir():
        reason = f"There is no directory {path.parent}"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        reason = f"No permission to write {path if path.exists() else f'in {path.parent}'}"
    if reason:
        raise ArgumentError(option, "a file that can be written", path, reason)


def write_text(text: str, path: Path | None) -> None:
    """Write a text file and say so on stderr; without a path, print the text; raises `ArgumentError` if it cannot."""
    if path is None:
        typer.echo(text, nl=False)
        return
    with writing(path, "--out"):
        path.write_text(text, encoding="utf-8")
    note(f"wrote {path}")


def write_model(text: str, path: Path | None) -> None:
    """Write a model as `write_text` does, and the meshes into a folder beside its file; raises as `copy_meshes`."""
    from spm_pin.description.source_files import copy_meshes

    if path is not None:
        copy_meshes(path.parent)
    write_text(text, path)
    if path is not None and path.suffix == ".urdf":
        note(f'in Pinocchio: pinocchio.buildModelsFromUrdf("{path}", package_dirs="{path.parent}"), for the meshes')


def write_json(content: Any, path: Path | None = None) -> None:
    """Print JSON of a result, or write it to a file, as `write_text`."""
    write_text(to_json(content) + "\n", path)


def write_figure(path: Path | None, draw: Callable[P, Figure], *args: P.args, **kwargs: P.kwargs) -> None:
    """Draw a figure and write it; without a path, do nothing."""
    if path is not None:
        save_figure(draw(*args, **kwargs), path)
        note(f"wrote {path}")


def name_options(**options: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a command so that its errors name the options typed, not the arguments of the functions it calls.

    An argument with the name of a parameter that was given is that option. `options` are the others, such as
    ``"--out"``, by the argument's name. Errors in a file, which name the file, get the option before.
    """

    def decorate(command: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(command)
        def run(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                return command(*args, **kwargs)
            except ArgumentError as error:
                argument, bracket, index = error.argument.partition("[")
                option = options.get(argument)
                if option is None and kwargs.get(argument) is not None:
                    option = f"--{argument.replace('_', '-')}"
                for name, value in kwargs.items():
                    if isinstance(value, Path) and error.argument.partition(":")[0] == str(value):
                        option, bracket, index = f"--{name}: {error.argument}", "", ""
                if option is None:
                    raise
                raise type(error)(option + bracket + index, error.expected, error.received, error.cause) from error

        return run

    return decorate
