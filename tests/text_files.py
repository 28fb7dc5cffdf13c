"""Text files for tests of readers, and the message about one that is refused."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from spm_pin.errors import DescriptionError, SpmError


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def assert_refused(read: Callable[[Path], object], path: Path, line: int | None, said: str) -> None:
    """The error names the file, the line where there is one, and what was expected, also when it was pickled."""
    with pytest.raises(DescriptionError) as caught:
        read(path)
    assert isinstance(caught.value, SpmError)
    message = str(caught.value)
    assert said in message
    assert message.startswith(f"{path}:{line}: " if line else f"{path}: ")
    assert str(pickle.loads(pickle.dumps(caught.value))) == message
