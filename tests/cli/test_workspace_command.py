"""`spm-pin workspace`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cli.running import run
from PIL import Image

import spm_pin as spm
from spm_pin.workspace.paper_shell import workspace_shell

FEW = ["workspace", "--resolution", "6"]


def test_workspace_prints_the_patches_the_volume_and_its_convergence() -> None:
    done = run("workspace", "--limits", "110", "150", "--unit", "cm", "--resolution", "20")
    assert done.returncode == 0, done.stderr
    out = done.stdout
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line.strip().startswith("S")}
    assert len(rows) == 24
    assert rows["St3"][:6] == ["max", "min~max", "min~max", "max", "max", "max"]
    assert float(rows["St1"][6]) == pytest.approx(8473.9, rel=1e-2)
    assert "legs from 110 to 150 cm" in out
    assert "V - E + F = 9602 - 28800 + 19200 = 2" in out
    assert "misprints read: r_b1 of St3, r_b3 of Sm3, r_b3 of Sm5" in out
    (volume,) = [line for line in out.splitlines() if line.startswith("volume")]
    _, value, _, error, unit = volume.split()
    assert float(value) == pytest.approx(1.653e6, rel=1e-3)
    assert float(error) < 100.0
    assert unit == "cm³"
    assert "…" not in out, "nothing is cut off at 80 columns"


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0)])
def test_json_in_every_unit(unit: str, factor: float) -> None:
    limits = [f"{1.1 * factor:g}", f"{1.4 * factor:g}"]
    content = json.loads(run(*FEW, "--limits", *limits, "--unit", unit, "--json").stdout)
    shell = workspace_shell(spm.Geometry.paper(), spm.LegLimits(1.1, 1.4), resolution=6)
    assert content["unit"] == unit
    assert content["euler_characteristic"] == 2
    np.testing.assert_allclose(content["limits"]["maximum"], 1.4 * factor)
    assert content["volume"] == pytest.approx(shell.volume * factor**3, rel=1e-9)
    assert content["area"] == pytest.approx(shell.area * factor**2, rel=1e-9)
    assert [step["resolution"] for step in content["convergence"]] == [2, 3, 6]
    assert content["patches"][1]["settings"]["r_b3"] == "min~max"


def test_the_ending_of_the_file_selects_the_mesh_format(tmp_path: Path) -> None:
    """Which endings there are is tested with the function that writes."""
    done = run(*FEW, "--out", str(tmp_path / "SHELL.STL"))
    assert done.returncode == 0, done.stderr
    assert f"wrote {tmp_path / 'SHELL.STL'}" in "".join(done.stderr.splitlines())
    mesh = trimesh.load_mesh(tmp_path / "SHELL.STL")
    assert mesh.is_watertight
    assert mesh.bounds[1, 2] == pytest.approx(2.9777, abs=1e-3)


def test_out_draws_the_shell_or_its_sections(tmp_path: Path) -> None:
    views, cuts = tmp_path / "fig2.png", tmp_path / "sections.png"
    assert run(*FEW, "--out", str(views)).returncode == 0
    done = run(*FEW, "--sections", "--samples", "2000", "--out", str(cuts))
    assert done.returncode == 0, done.stderr
    sizes = []
    for path in (views, cuts):
        with Image.open(path) as picture:
            sizes.append(picture.size)
    assert sizes[0] == (1350, 1110)
    assert sizes[1][0] == 1530


def test_limits_from_the_geometrys_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    text = "base_radius: 0.7\nplatform_radius: 0.35\nmiddle_side: 0.8\n"
    path.write_text(text, encoding="utf-8")
    done = run(*FEW, "--geometry", str(path))
    assert done.returncode == 2
    assert done.message.startswith("error: --limits: ")
    assert "the geometry has none" in done.message
    pairs = {leg: "[1.1, 1.5]" if leg.startswith("r_b") else "[1.2, 1.4]" for leg in spm.mechanism.LEGS}
    limits = ", ".join(f"{leg}: {pair}" for leg, pair in pairs.items())
    path.write_text(f"{text}leg_limits: {{{limits}}}\n", encoding="utf-8")
    assert "legs from 1.1, 1.1, 1.1, 1.2, 1.2, 1.2 to 1.5, 1.5, 1.5, 1.4, 1.4, 1.4 m" in run(
        *FEW, "--geometry", str(path)
    ).stdout.replace("\n", " ")
