"""Figures of results, and files that figures are written in."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from error_fields import with_fields
from matplotlib.figure import Figure

import spm_pin as spm
from spm_pin.crosscheck import Paper, compare_methods
from spm_pin.crosscheck.paper.jacobian import Table5Mistakes
from spm_pin.design import DesignProblem, Designs, Front
from spm_pin.display import draw, reach_figure
from spm_pin.display.figures import agreement_figure, front_figure
from spm_pin.display.rendering import VIEW, camera_axes
from spm_pin.display.writing import new_figure, save_figure
from spm_pin.errors import ArgumentError

MACHINE = spm.Manipulator.paper()


@pytest.mark.parametrize("ending", ["pdf", "svg"])
def test_texts_of_a_vector_file_are_texts(tmp_path: Path, ending: str) -> None:
    figure = new_figure(8.0, 4.0)
    figure.add_subplot().set(xlabel="length", title="title")
    content = save_figure(figure, tmp_path / f"figure.{ending}").read_bytes()
    if ending == "pdf":
        assert b"/FontFile2" in content
        assert b"/Type3" not in content
    else:
        assert re.search(rb"<text[^>]*font-size: 10px[^>]*>length</text>", content)


def test_each_pair_has_a_bar_as_long_as_its_share_of_the_tolerance() -> None:
    wrong = Paper(MACHINE, mistakes=Table5Mistakes(printed_lever_arm=True))
    report = compare_methods(MACHINE, poses=4, methods=["closed-form", wrong])
    figure = agreement_figure(report)
    (ax,) = figure.axes
    ends = {round(bar.get_y() + 0.5 * bar.get_height()): bar.get_x() + bar.get_width() for bar in ax.patches}
    np.testing.assert_allclose([ends[k] for k in sorted(ends)], [p.ratio for p in report.differences], rtol=1e-3)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["closed form – paper"] * 3
    # The line of the tolerance is inside, and so are the bars beyond it.
    (low, high), longest = ax.get_xlim(), max(ends.values())
    assert low < 1.0 < longest < high
    assert report.verdict in figure.get_suptitle()


@pytest.mark.parametrize("suffix", [".svg", ".pdf", ".PNG"])
def test_figures_are_written_the_same_each_time(tmp_path, suffix: str) -> None:
    figure = Figure(figsize=(2, 1))
    figure.add_subplot().plot([0.0, 1.0], [1.0, 0.0])
    first, second = (save_figure(figure, tmp_path / f"{k}{suffix}", dpi=30).read_bytes() for k in (1, 2))
    assert first == second
    assert first[:5] in (b"\x89PNG\r", b"<?xml", b"%PDF-")


def test_figures_that_cannot_be_written(tmp_path) -> None:
    with pytest.raises(ArgumentError, check=with_fields(argument="path", received=tmp_path / "fig.jpg")):
        save_figure(Figure(), tmp_path / "fig.jpg")
    for wrong in (None, Figure().add_subplot()):
        with pytest.raises(ArgumentError, check=with_fields(argument="figure", expected="a Figure")):
            save_figure(wrong, tmp_path / "figure.png")


def test_a_front_shows_its_machines_and_the_one_that_it_began_with() -> None:
    columns = {"volume": np.array([1.0, 2.0, 3.0]), "footprint": np.array([1.0, 1.5, 2.5])}
    three = Designs((MACHINE,) * 3, columns)
    one = Designs((MACHINE,), {name: column[:1] + 0.4 for name, column in columns.items()})
    problem = DesignProblem(MACHINE, {"stroke": (0.1, 0.3)}, {"volume": "max", "footprint": "min"})
    (ax,) = front_figure(Front(problem, three, three, one)).axes
    evaluated, front, start = ax.collections
    np.testing.assert_array_equal(evaluated.get_offsets(), np.stack([*columns.values()], axis=-1))
    np.testing.assert_array_equal(front.get_offsets(), evaluated.get_offsets())
    np.testing.assert_array_equal(start.get_offsets(), [[1.4, 1.4]])
    assert ax.get_xlabel() == "volume [m³\u00a0rad³], max"
    assert ax.get_ylabel() == "footprint [m²], min"


def test_a_stage_and_its_reach_are_drawn() -> None:
    stage = spm.Stage(0.35, 0.3, spm.RRS(crank=0.2, rod=0.4))
    state = spm.inverse_physical(stage, 0.45, tilt=0.1, azimuth=0.0)
    ax = draw(state)
    (image,) = ax.images
    left, right, low, high = image.get_extent()
    # The balls are in the picture, which has something there.
    for x, y in state.balls @ np.asarray(camera_axes(VIEW)[:2]).T:
        row, column = (high - y) / (high - low), (x - left) / (right - left)
        pixels = image.get_array()
        assert pixels[int(row * pixels.shape[0]), int(column * pixels.shape[1]), 3] > 0.9
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="configuration")):
        draw(spm.inverse_physical(stage, [0.4, 0.5]))
    reach = spm.workspace.reach(stage, [0.3, 0.45], directions=24)
    lines = reach_figure(reach).axes[0].lines
    np.testing.assert_allclose(lines[1].get_ydata()[:-1], np.degrees(reach.tilts[1]))
