"""Every example runs as it stands and is listed in the index; notebooks show results and are stored without them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("notebooks/*.ipynb"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_an_example_runs_and_writes_into_the_folder_given_only(script: Path, tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "given", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    done = subprocess.run(
        [sys.executable, script, folder], cwd=elsewhere, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert (folder / f"{script.stem}.png").stat().st_size > 0
    assert not list(elsewhere.iterdir())


def test_the_index_is_complete() -> None:
    index = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert SCRIPTS
    for script in SCRIPTS:
        assert f"[{script.name}]({script.name})" in index


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("default")  # those of the client and its sockets; cells have filters of their own
def test_a_notebook_runs_and_its_results_show_themselves(path: Path, tmp_path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [output for output in shown if output.get("name") == "stderr" and "compiling" not in output["text"]]
    kinds = {kind for output in shown for kind in output.get("data", {})}
    assert {"image/png", "text/html"} <= kinds
    assert not list(tmp_path.iterdir())


def test_notebooks_are_few_and_stored_without_outputs() -> None:
    assert 0 < len(NOTEBOOKS) <= 5
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        assert cells[0].cell_type == "markdown"
        assert all(not cell.outputs and cell.execution_count is None for cell in cells if cell.cell_type == "code")
