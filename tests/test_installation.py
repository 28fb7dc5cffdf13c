"""Installed into a clean environment; the pinned versions, which every Python and platform supported can install."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLE = ["--translation", "68.89", "49.63", "225.3", "--xyx", "-11.08", "32.97", "-12.88", "--unit", "cm", "--json"]

BEYOND_LIMITS = 5
"""Code of this pose, whose legs are 1.3 mm beyond the limits."""


def run(*command: object, cwd: Path, code: int = 0) -> str:
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run([str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout


@pytest.mark.slow
def test_clean_installation(tmp_path: Path) -> None:
    # The wheel by way of the source distribution, so that both are complete.
    run(sys.executable, "-m", "build", "--outdir", tmp_path / "dist", ROOT, cwd=tmp_path)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    venv.create(tmp_path / "venv", with_pip=True)
    binaries = tmp_path / "venv" / "bin"
    run(binaries / "pip", "install", "--no-compile", "--constraint", ROOT / "constraints.txt", wheel, cwd=tmp_path)
    content = json.loads(run(binaries / "spm-pin", "inverse", *EXAMPLE, cwd=tmp_path, code=BEYOND_LIMITS))
    assert len(content["branches"]) == 6
    assert "105 of the 120" in run(binaries / "spm-pin", "reproduce", cwd=tmp_path)
    where = run(binaries / "python", "-c", "import spm_pin; print(spm_pin.__file__)", cwd=tmp_path)
    assert str(tmp_path) in where


PYTHONS = ("3.11", "3.14")
PLATFORMS = ("x86_64-manylinux_2_34", "aarch64-manylinux_2_34", "aarch64-apple-darwin")


@pytest.mark.slow
@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("python", PYTHONS)
def test_the_constraints_resolve_with_every_extra(python: str, platform: str, tmp_path: Path) -> None:
    uv = shutil.which("uv", path=str(Path(sys.executable).parent))
    assert uv is not None, "uv belongs to the extra dev"
    command = [uv, "pip", "compile", "--quiet", "--only-binary", ":all:", "--all-extras"]
    command += ["--python-version", python, "--python-platform", platform]
    command += ["--constraint", "constraints.txt", "pyproject.toml", "--output-file", str(tmp_path / "resolved.txt")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    unpinned = names(tmp_path / "resolved.txt") - names(ROOT / "constraints.txt")
    assert not unpinned


def names(requirements: Path) -> set[str]:
    """Return the normalised names of the packages that a file pins."""
    found = re.findall(r"^([\w.-]+)==", requirements.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower() for name in found}
