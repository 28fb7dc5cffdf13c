"""Derivatives from differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def extrapolated(central: Callable[[Any], Any], h: Any) -> Any:
    """Return a derivative from its central differences at h, h/2 and h/4, extrapolated twice: off by O(h⁶)."""
    d1, d2, d3 = (central(h / 2**k) for k in range(3))
    first, second = (4 * d2 - d1) / 3, (4 * d3 - d2) / 3
    return (16 * second - first) / 15
