"""Arrays and integers by name as one argument of compiled functions."""

from __future__ import annotations

from typing import Any

import numpy as np


class PlainArrays:
    """Arrays and integers by name, as attributes: for compiled functions a table of pointers and shapes.

    Such an argument costs nothing to pass. Numba passes a tuple array by array, each counted as a reference wherever a
    function is called.
    """

    def __init__(self, fields: dict[str, Any]) -> None:
        self.__dict__.update(fields)
        self.fields = fields
        rows = [(x.ctypes.data, *x.shape, 0)[:3] if isinstance(x, np.ndarray) else (x, 0, 0) for x in fields.values()]
        self._table = np.array(rows)
        self.address = self._table.ctypes.data
