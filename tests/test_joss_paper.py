"""The paper in paper/: every number of its text is computed here, its references and figure exist, and it is short."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from uniqueness_slides import SLIDES, slide_pair

import spm_pin as spm
from spm_pin.crosscheck import Verdict, reproduce

pytestmark = pytest.mark.documents

ROOT = Path(__file__).parents[1]
_, _, TEXT = (ROOT / "paper/paper.md").read_text(encoding="utf-8").split("---\n", 2)
WORDS = " ".join(TEXT.split())


@pytest.fixture(scope="module")
def sentences() -> list[str]:
    """Return all phrases of the paper that have numbers, with the numbers computed."""
    machine = spm.Manipulator.paper()
    modes = spm.forward_displacement(machine, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    cells = [cell for cell in reproduce().cells if cell.table in range(1, 6)]
    agreeing = sum(cell.verdict is Verdict.SAME for cell in cells)
    limits = machine.limits.minimum[0], machine.limits.maximum[0]
    certificate = spm.certify(machine, machine.limits)
    assert certificate.holds
    assert slide_pair(*SLIDES).proved
    lower, upper = (np.floor(1000.0 * bound) / 1000.0 for bound in certificate.bounds)
    branches = len(spm.inverse_displacement(machine, modes.configurations.pose[:1]).labels)
    count = int(re.search(r'"--count", type=int, default=([\d_]+)', _source("scripts/certified_dataset.py"))[1])  # type: ignore[index]
    return [
        "A 3RPS-3SPR manipulator",
        f"up to {branches} branches",
        f"up to {len(modes.labels)} assembly modes",
        f"of the {len(cells)} cells of five printed tables",
        f"machine, {agreeing} agree with a recomputation in every digit",
        f"{modes.count} of the {len(modes.labels)} assembly modes are real",
        "the 3-RPS stage",
        f"the hips at {SLIDES[0]:g} and rods of {SLIDES[1]:g} radii",
        f"legs between {limits[0]:g} m and {limits[1]:g} m",
        rf"$|\det J_b| \ge {lower:.3f}\,d^3$ and $|\det J_c| \ge {upper:.3f}\,d^3$",
        f"A script writes {count} certified poses",
    ]


def _source(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_every_number_is_computed(sentences: list[str]) -> None:
    left = re.sub(r"\[@[^]]*\]", "", WORDS)
    for sentence in sentences:
        assert sentence in left, sentence
        left = left.replace(sentence, "", 1)
    assert re.findall(r"[^\s]*\d[^\s]*", left) == []
