"""Output of the subcommands: text and tables on the console, and files, which are checked before the work."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from spm_pin.errors import ArgumentError, SpmError, require_extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Raise the error: Rich would exit with the code 1."""
        raise


# File names and messages may contain brackets and words between colons, which Rich reads as styles and emoji.
stdout = _Console(markup=False, highlight=False, emoji=False)
stderr = _Console(stderr=True, markup=False, highlight=False, emoji=False, soft_wrap=True)

_PRINTED_AS_ZERO = 1e-12
"""A number smaller than this fraction of its scale is printed as zero."""

P = ParamSpec("P")

_ASCII = {"─": "-", "│": "|", "²": "^2", "³": "^3", "°": " deg", "σ": "s", "ω": "w", "Δ": "d", "±": "+-", "·": "*"}
_ASCII |= {"×": "x", "•": "*", "→": "->", "≤": "<=", "≥": ">=", "…": "...", "–": "-", "√": "sqrt", "−": "-", "∞": "inf"}


def write_any_text() -> None:
    """Let stdout and stderr accept all texts: characters that their encoding lacks are replaced by ASCII."""

    def in_ascii(error: UnicodeError) -> tuple[str, int]:
        assert isinstance(error, UnicodeEncodeError)
        text = error.object[error.start : error.end]
        return "".join(_ASCII.get(character, "?") for character in text), error.end

    codecs.register_error("spm_pin", in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spm_pin")


def flush() -> None:
    """Write the rest of stdout; if that fails, raise `OSError` and discard further output."""
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
    """Print sentences on stdout, wrapped between words on a screen, but not in a pipe, nor if indented, to copy."""
    for line in lines:
        stdout.print(line, style=style, soft_wrap=not stdout.is_terminal or line.startswith("  "))


def note(text: str, style: str | None = None) -> None:
    """Print a line on stderr; if that is full, the line is lost."""
    with contextlib.suppress(OSError):
        stderr.print(text, style=style)


@contextlib.contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar on stderr, and yield a function of the step's name, the number done and the total."""
    columns = TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    # Without a terminal Rich would end with an empty line.
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_interactive) as bar:
        task = bar.add_task("", total=None)
        yield lambda step, done, total: bar.update(task, description=step, completed=done, total=total)


@dataclass(frozen=True)
class Table:
    """A table of a report: headings, and functions from a row to its text.

    The first column, and those with headings in `left`, are aligned to the left; an empty line separates rows of
    another `group`. A table without rows is not printed.
    """

    title: str
    columns: Mapping[str, Callable[[Any], str]]
    rows: Iterable[Any]
    left: Collection[str] = ()
    group: Callable[[Any], object] = lambda row: None
    style: Callable[[Any], str | None] = lambda row: None

    def print(self) -> None:
        """Print the table on stdout, without wrapping lines."""
        rows, headings = list(self.rows), list(self.columns)
        if not rows:
            return
        cells = [[text(row) for text in self.columns.values()] for row in rows]
        widths = [max(map(cell_len, column)) for column in zip(headings, *cells, strict=True)]

        def line(texts: Sequence[str], style: str | None = None) -> None:
            padded = []
            for k, text in enumerate(texts):
                space = " " * (widths[k] - cell_len(text))
                padded.append(text + space if k == 0 or headings[k] in self.left else space + text)
            stdout.print(" " + "  ".join(padded).rstrip(), style=style, soft_wrap=True)

        stdout.print(f"{self.title}\n", style="bold", soft_wrap=True)
        line(headings, "bold")
        stdout.print(" " + "─" * (sum(widths) + 2 * len(widths) - 2), soft_wrap=True)
        for number, (row, texts) in enumerate(zip(rows, cells, strict=True)):
            if number and self.group(row) != self.group(rows[number - 1]):
                stdout.print()
            line(texts, self.style(row))
        stdout.print()


Part = Table | tuple[str, str] | str
"""A table, a sentence with its style, or sentences."""


@dataclass(frozen=True)
class Report:
    """Result of a command: its content for --json, otherwise tables and sentences; and the exit code."""

    content: Any
    parts: Sequence[Part]
    code: int = 0

    def show(self, *, json: bool) -> None:
        """Print the report, and end with the exit code."""
        if json:
            write_json(self.content)
        for part in () if json else self.parts:
            if isinstance(part, Table):
                part.print()
            elif isinstance(part, tuple):
                print_lines([part[0]], part[1])
            else:
                print_lines(part.split("\n"))
        if self.code:
            raise typer.Exit(self.code)


def cannot_be_used(option: str, beside: str, cause: str = "") -> SpmError:
    """Return an error about options that exclude each other."""
    return SpmError(f"{option} cannot be used with {beside}" + f". {cause}" * bool(cause))


def significant(value: float, scale: float = 0.0, digits: int = 5) -> str:
    """Format with a number of significant digits; rounding errors compared with `scale` are printed as 0."""
    return "0" if abs(value) <= _PRINTED_AS_ZERO * scale else f"{value:.{digits}g}"


def file_option(help_text: str, endings: Sequence[str] = (), extra: str = "") -> Any:
    """Return an option for a file to write, which `check_output` checks before the work, and the extra it needs."""

    def check(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
        if path is not None:
            check_output(path, parameter.opts[0], endings)
            if extra:
                require_extra(extra)
        return path

    return typer.Option(metavar="FILE", help=help_text, callback=check)


def check_output(path: Path, option: str = "--out", endings: Sequence[str] = (), cause: str = "") -> None:
    """Raise `ArgumentError` if a file cannot be written later: its ending, its folder, its permissions."""
    if endings and path.suffix.lower() not in endings:
        raise ArgumentError(option, f"a file name ending in {', '.join(endings)}", path.name, cause)
    reason = ""
    # Folders that do not exist are created when the file is written.
    present = next(place for place in (path, *path.absolute().parents) if place.exists())
    # A file is replaced by another one in its folder.
    needed = [present, path.resolve().parent] if path.is_file() else [present]
    denied = [place for place in needed if not os.access(place, os.W_OK)]
    if path.is_dir():
        reason = "It is a directory"
    elif present != path and not present.is_dir():
        reason = f"{present} is not a directory"
    elif denied:
        reason = f"No permission to write {path if denied[0] == path else f'in {denied[0]}'}"
    if reason:
        raise ArgumentError(option, "a file that can be written", path, reason)


def write_text(text: str, path: Path | None) -> None:
    """Write a text file, with a note on stderr; without a path, print the text."""
    if path is None:
        typer.echo(text, nl=False)
        return
    from spm_pin.support.files import write_files

    write_files({path: text}, "--out")
    note(f"wrote {path}")


def write_json(content: Any, path: Path | None = None) -> None:
    """Print JSON of a result, or write it to a file, as `write_text`."""
    from spm_pin.display.writing import to_json

    write_text(to_json(content) + "\n", path)


def write_figure(path: Path | None, draw: Callable[P, Figure], *args: P.args, **kwargs: P.kwargs) -> None:
    """Draw a figure and write it; without a path, do nothing."""
    if path is not None:
        from spm_pin.display.writing import save_figure

        save_figure(draw(*args, **kwargs), path)
        note(f"wrote {path}")
