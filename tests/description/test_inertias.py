"""Moments of inertia that no body has are refused where a URDF is given."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.errors import DescriptionError


@pytest.mark.parametrize("factors", [(-1.0, 1.0, 1.0), (-1.0, -1.0, -1.0)])
def test_negative_moments_are_refused(tmp_path: Path, factors: tuple[float, ...]) -> None:
    text, start = urdf_text(), urdf_text().index("<inertia ")
    for name, factor in zip(("ixx", "iyy", "izz"), factors, strict=True):
        text = text[:start] + re.sub(
            rf'({name}=")([^"]*)', lambda found, by=factor: f"{found[1]}{by * float(found[2])}", text[start:], count=1
        )
    file = tmp_path / "robot.urdf"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        spm.ClosedChain.from_urdf(file)
    assert caught.value.expected == "moments of inertia of which none is negative"
