"""Checks of errors by their fields: messages may be reworded."""

from collections.abc import Callable
from typing import Any


def with_fields(**fields: object) -> Callable[[Any], bool]:
    """Return the `check` of `pytest.raises` for an error with these fields."""
    return lambda error: all(getattr(error, name) == value for name, value in fields.items())
