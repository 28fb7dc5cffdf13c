"""What the subcommands share: where they print, and files they write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from spm_pin.errors import ArgumentError

__all__ = ["new_table", "stderr", "stdout", "to_json", "write_json"]

stdout = Console(soft_wrap=False)
stderr = Console(stderr=True, soft_wrap=True)


def new_table(title: str) -> Table:
    """Return an empty table in the house's style, light enough to fit 80 columns."""
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))


def to_json(content: Any) -> str:
    """Return JSON text; NaN is not JSON, so whoever calls says None."""
    return json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)


def write_json(content: Any, path: Path) -> None:
    """Write a JSON file.

    Raises
    ------
    ArgumentError
        If the file cannot be written.
    """
    try:
        path.write_text(to_json(content) + "\n", encoding="utf-8")
    except OSError as error:
        raise ArgumentError("--json", "a file that can be written", path, str(error.strerror)) from error
    stderr.print(f"wrote {escape(str(path))}")
