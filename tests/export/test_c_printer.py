"""Numbers in exported C."""

from __future__ import annotations

import numpy as np

from spm_pin.export.c_printer import number


def test_numbers_that_are_not_finite_have_their_names() -> None:
    assert [number(x) for x in (0.1, -np.inf, np.inf, np.nan)] == ["0.1", "-INFINITY", "INFINITY", "NAN"]
