"""Installed into a clean environment, from the tree and from the wheel, away from the checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLE = ["--translation", "68.89", "49.63", "225.3", "--xyx", "-11.08", "32.97", "-12.88", "--unit", "cm", "--json"]


def run(*command: object, cwd: Path) -> str:
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run([str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tree", "wheel"])
def test_clean_installation(kind: str, tmp_path: Path) -> None:
    source: Path = ROOT
    if kind == "wheel":
        # Through the source distribution, so that it is complete too.
        run(sys.executable, "-m", "build", "--outdir", tmp_path / "dist", ROOT, cwd=tmp_path)
        (source,) = (tmp_path / "dist").glob("*.whl")
    venv.create(tmp_path / "venv", with_pip=True)
    bin_directory = tmp_path / "venv" / "bin"
    run(bin_directory / "pip", "install", "--constraint", ROOT / "constraints.txt", source, cwd=tmp_path)
    content = json.loads(run(bin_directory / "spm-pin", "inverse", *EXAMPLE, cwd=tmp_path))
    assert len(content["branches"]) == 6
    assert "105 of the 120" in run(bin_directory / "spm-pin", "reproduce", cwd=tmp_path)
    where = run(bin_directory / "python", "-c", "import spm_pin; print(spm_pin.__file__)", cwd=tmp_path)
    assert str(tmp_path) in where
