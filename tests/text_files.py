"""Text files for tests of readers."""

from __future__ import annotations

from pathlib import Path


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path
