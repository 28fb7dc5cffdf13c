"""Every example runs as it stands and is listed in the index; notebooks, which the site runs, are stored bare."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest

pytestmark = pytest.mark.documents

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
LONG = "12_pick_and_place", "14_calibrated_controller", "16_balance_a_ball"
NOTEBOOKS = sorted(EXAMPLES.glob("notebooks/*.ipynb"))


@pytest.mark.parametrize(
    "script",
    [pytest.param(x, marks=[pytest.mark.slow] if x.stem in LONG else [], id=x.name) for x in SCRIPTS],
)
def test_an_example_runs_and_writes_into_the_folder_given_only(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, elsewhere = tmp_path / "given", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    monkeypatch.setattr(sys, "argv", [str(script), str(folder)])
    try:
        runpy.run_path(str(script), run_name="__main__")
    finally:
        plt.close("all")
    assert (folder / f"{script.stem}.png").stat().st_size > 0
    assert not list(elsewhere.iterdir())


def test_the_index_is_complete() -> None:
    index = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert SCRIPTS
    for script in SCRIPTS:
        assert f"[{script.name}]({script.name})" in index


def test_notebooks_are_few_and_stored_without_outputs() -> None:
    assert 0 < len(NOTEBOOKS) <= 5
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        assert cells[0].cell_type == "markdown"
        assert all(not cell.outputs and cell.execution_count is None for cell in cells if cell.cell_type == "code")
