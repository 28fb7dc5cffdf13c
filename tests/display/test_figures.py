"""Figures of results, and files that figures are written in."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

import spm_pin as spm
from spm_pin.crosscheck import Paper, compare_methods
from spm_pin.display.figures import agreement_figure, save_figure
from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.paper.jacobian import Table5Mistakes

GEOMETRY = spm.Geometry.paper()


def test_each_pair_has_a_bar_as_long_as_its_share_of_the_tolerance() -> None:
    wrong = Paper(GEOMETRY, mistakes=Table5Mistakes(printed_lever_arm=True))
    report = compare_methods(GEOMETRY, poses=4, methods=["closed-form", wrong])
    (ax,) = agreement_figure(report).axes
    ends = {round(bar.get_y() + 0.5 * bar.get_height()): bar.get_x() + bar.get_width() for bar in ax.patches}
    np.testing.assert_allclose([ends[k] for k in sorted(ends)], [p.ratio for p in report.differences], rtol=1e-3)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["closed form – paper"] * 3
    # The line of the tolerance is inside, and so are the bars beyond it.
    (low, high), longest = ax.get_xlim(), max(ends.values())
    assert low < 1.0 < longest < high
    assert report.verdict in ax.get_title(loc="left")


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    report = compare_methods(GEOMETRY, poses=1, methods=["closed-form"])
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match="plots"):
        agreement_figure(report)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_figures_are_written_the_same_each_time(tmp_path, suffix: str) -> None:
    figure = Figure(figsize=(2, 1))
    figure.add_subplot().plot([0.0, 1.0], [1.0, 0.0])
    first, second = (save_figure(figure, tmp_path / f"{k}{suffix}", dpi=30).read_bytes() for k in (1, 2))
    assert first == second
    assert first[:5] in (b"\x89PNG\r", b"<?xml", b"%PDF-")


@pytest.mark.parametrize(
    ("name", "says"),
    [("fig.jpg", ".png, .svg, .pdf, got 'fig.jpg'"), ("fig", "ending in .png"), ("no/where.png", "No such")],
)
def test_figures_that_cannot_be_written(tmp_path, name: str, says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as caught:
        save_figure(Figure(), tmp_path / name)
    assert caught.value.argument == "path"
