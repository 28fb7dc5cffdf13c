"""Numbers in the cells of a CSV file."""

from pathlib import Path

import pytest

from spm_pin.errors import ArgumentError
from spm_pin.support.motion_table import MotionTable


def test_digits_grouped_by_underscores_are_no_number(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("x,y\n1,2\n3,1_2\n", encoding="utf-8")
    table = MotionTable(path)
    assert table.columns(["x"]).tolist() == [[1.0], [3.0]]
    with pytest.raises(ArgumentError):
        table.columns(["y"])
