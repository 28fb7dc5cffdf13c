"""The pinned versions can be installed, wheels only, on every Python and platform that the package supports."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
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
