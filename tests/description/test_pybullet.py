"""PyBullet reads the URDF; its closures are made from the description's pairs, at the centres of mass.

It hands poses over in single precision, at 2.6 m: what the other engines hold to 1e-12 is known to 1e-6 here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

pybullet = pytest.importorskip("pybullet")


@pytest.mark.documents
def test_the_page_says_how() -> None:
    page = Path(__file__).parents[2] / "docs" / "howto" / "load_elsewhere.md"
    (block,) = re.findall(r"```\n(import pybullet.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict[str, Any] = {}
    try:
        exec(block, names)
        assert pybullet.getNumConstraints() == 4
        for joint in pybullet.getConstraintUniqueId(0), pybullet.getConstraintUniqueId(3):
            assert pybullet.getConstraintInfo(joint)[0] == names["robot"]
    finally:
        pybullet.disconnect()
