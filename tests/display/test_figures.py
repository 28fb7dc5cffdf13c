"""Figures of results, and files that figures are written in."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import spm_pin as spm
from spm_pin.crosscheck import Paper, compare_methods
from spm_pin.design import DesignProblem, Designs, Front
from spm_pin.display.figures import agreement_figure, front_figure
from spm_pin.display.plots import save_picture
from spm_pin.display.writing import DARK, Style, legend_below, new_figure, save_figure, write_name
from spm_pin.errors import ArgumentError
from spm_pin.motion import plan, time_optimal
from spm_pin.multibody.chain import ClosedChain
from spm_pin.paper.jacobian import Table5Mistakes

GEOMETRY = spm.Geometry.paper()


@pytest.mark.parametrize("ending", ["pdf", "svg"])
def test_a_figure_for_print_has_its_size_its_fonts_and_its_background(tmp_path: Path, ending: str) -> None:
    figure = new_figure(8.0, 4.0)
    figure.add_subplot().set(xlabel="length", title="title")
    path = save_figure(figure, tmp_path / f"figure.{ending}", style=Style.from_text("90mm, 8pt, dark"))
    content = path.read_bytes()
    if ending == "pdf":
        width, height = map(float, re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+)", content).groups())
        assert (width, height) == pytest.approx((90.0 / 25.4 * 72.0, 45.0 / 25.4 * 72.0))
        assert b"/FontFile2" in content
        assert b"/Type3" not in content
    else:
        assert re.search(rb"<text[^>]*font-size: 8px[^>]*>length</text>", content)
        assert DARK.encode() in content
        assert b"#000000" not in content


SIZE = r"expected a width from 25\.4 to 1016 mm, got 9000 mm"


@pytest.mark.parametrize(
    ("text", "says"), [*((x, "style") for x in ("90", "90x60pt", "8 pt", "0mm", "bright", "2dpi")), ("9000mm", SIZE)]
)
def test_a_style_that_says_nothing_is_refused_in_the_unit_typed(text: str, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        Style.from_text(text)


def test_the_width_of_a_printed_picture_is_that_of_its_size_and_resolution(tmp_path: Path) -> None:
    state = spm.forward_physical(spm.Geometry.paper(), [1.2, 1.2, 1.4, 1.25, 1.2, 1.5])
    path = save_picture(state, tmp_path / "picture.png", style=Style(width=2.0, dpi=150.0, font_size=7.0))
    with Image.open(path) as picture:
        assert picture.width == 300
    with pytest.raises(ArgumentError, match="height"):
        save_picture(state, path, style=Style(width=2.0, height=2.0))


def test_texts_and_legend_of_a_narrow_figure_are_broken_and_cover_nothing() -> None:
    figure = two_panels()
    Style.from_text("90mm,8pt").apply(figure)
    figure.draw_without_rendering()
    titles = [ax.title.get_window_extent() for ax in figure.axes]
    (legend,) = figure.legends
    assert "\n" in figure.axes[0].get_title()
    assert not titles[0].overlaps(titles[1])
    assert legend.get_window_extent().width <= figure.bbox.width
    assert [text.get_text() for text in legend.get_texts()] == [f"curve number {k}" for k in range(6)]
    # Too small for them, a size that is enough is named.
    with pytest.raises(ArgumentError, match=r"such as (\d+)mm, got 30 mm") as refused:
        Style.from_text("30mm,14pt").apply(two_panels())
    enough = refused.value.expected.split()[-1]
    Style.from_text(f"{enough},14pt").apply(figure := two_panels())
    assert figure.get_size_inches()[0] == pytest.approx(float(enough.removesuffix("mm")) / 25.4)


def test_a_narrow_figure_becomes_higher_where_its_numbers_would_cover_one_another() -> None:
    def bars() -> Figure:
        figure = new_figure(8.0, 3.0, layout="constrained")
        figure.add_subplot().barh([f"row {k}" for k in range(16)], range(16))
        return figure

    figure = bars()
    Style.from_text("89mm,8pt").apply(figure)
    width, height = figure.get_size_inches()
    assert width == pytest.approx(89.0 / 25.4)
    assert height > 3.0 / 8.0 * width
    figure.draw_without_rendering()
    boxes = [label.get_window_extent() for label in figure.axes[0].get_yticklabels()]
    assert not any(box.overlaps(following) for box, following in pairwise(boxes))
    with pytest.raises(ArgumentError, match=r"a size for this figure, such as \d+x\d+mm, got 89 mm"):
        Style.from_text("89x33mm,8pt").apply(bars())


def test_names_that_would_cover_another_are_left_out_of_a_small_figure() -> None:
    figure = new_figure(6.0, 4.0, layout="constrained")
    ax = figure.add_subplot()
    for place, name in (((0.5, 0.5), "first"), ((0.52, 0.5), "second"), ((0.1, 0.1), "third")):
        write_name(ax, place, name, 9.0, "black", 0.3)
    Style.from_text("80mm").apply(figure)
    assert [text.get_text() for text in ax.texts if text.get_visible()] == ["first", "first", "third", "third"]


@pytest.mark.parametrize("name", ["path", "motion", "certificate", "agreement"])
def test_a_legend_lies_within_its_figure(name: str) -> None:
    figure = FIGURES[name]()
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert all(figure.bbox.contains(*corner) for corner in (box.min, box.max))


def motion() -> Figure:
    chain = ClosedChain.from_urdf(geometry=GEOMETRY)
    home, end = [1.2, 1.2, 1.4, 1.25, 1.2, 1.5], [1.21, 1.2, 1.4, 1.25, 1.2, 1.5]
    planned = plan(GEOMETRY, home, end, spm.LegLimits(1.0, 1.6))
    return time_optimal(chain, planned, leg_accelerations=1.0).plot()


PATH = [[1.2, 1.2, 1.4, 1.25, 1.2, 1.45], [1.45, 1.15, 1.3, 1.2, 1.5, 1.35], [1.1, 1.35, 1.6, 1.3, 1.4, 1.2]]
FIGURES = {
    "path": lambda: spm.follow(GEOMETRY, PATH).plot(),
    "motion": motion,
    "certificate": lambda: spm.certify(GEOMETRY, spm.LegLimits(1.2, 1.25)).plot(),
    "agreement": lambda: agreement_figure(compare_methods(GEOMETRY, poses=1, methods=["closed-form", "paper"])),
}
"""Figures of results by their names."""


def two_panels() -> Figure:
    figure = new_figure(9.0, 4.6, layout="constrained")
    for ax in figure.subplots(1, 2):
        for k in range(6):
            ax.plot([k, 1 - k], label=f"curve number {k}")
        ax.set_title("a title that is longer than a panel is wide")
    legend_below(figure)
    return figure


def test_each_pair_has_a_bar_as_long_as_its_share_of_the_tolerance() -> None:
    wrong = Paper(GEOMETRY, mistakes=Table5Mistakes(printed_lever_arm=True))
    report = compare_methods(GEOMETRY, poses=4, methods=["closed-form", wrong])
    figure = agreement_figure(report)
    (ax,) = figure.axes
    ends = {round(bar.get_y() + 0.5 * bar.get_height()): bar.get_x() + bar.get_width() for bar in ax.patches}
    np.testing.assert_allclose([ends[k] for k in sorted(ends)], [p.ratio for p in report.differences], rtol=1e-3)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["closed form – paper"] * 3
    # The line of the tolerance is inside, and so are the bars beyond it.
    (low, high), longest = ax.get_xlim(), max(ends.values())
    assert low < 1.0 < longest < high
    assert report.verdict in figure.get_suptitle()


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_figures_are_written_the_same_each_time(tmp_path, suffix: str) -> None:
    figure = Figure(figsize=(2, 1))
    figure.add_subplot().plot([0.0, 1.0], [1.0, 0.0])
    first, second = (save_figure(figure, tmp_path / f"{k}{suffix}", dpi=30).read_bytes() for k in (1, 2))
    assert first == second
    assert first[:5] in (b"\x89PNG\r", b"<?xml", b"%PDF-")


@pytest.mark.parametrize(("name", "says"), [("fig.jpg", ".png, .svg, .pdf, got 'fig.jpg'"), ("fig", "ending in .png")])
def test_figures_that_cannot_be_written(tmp_path, name: str, says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as caught:
        save_figure(Figure(), tmp_path / name)
    assert caught.value.argument == "path"


def test_a_front_shows_its_machines_and_the_one_that_it_began_with() -> None:
    columns = {"volume": np.array([1.0, 2.0, 3.0]), "footprint": np.array([1.0, 1.5, 2.5])}
    three = Designs((GEOMETRY,) * 3, columns)
    one = Designs((GEOMETRY,), {name: column[:1] + 0.4 for name, column in columns.items()})
    problem = DesignProblem(GEOMETRY, {"stroke": (0.1, 0.3)}, {"volume": "max", "footprint": "min"})
    (ax,) = front_figure(Front(problem, three, three, one)).axes
    evaluated, front, start = ax.collections
    np.testing.assert_array_equal(evaluated.get_offsets(), np.stack([*columns.values()], axis=-1))
    np.testing.assert_array_equal(front.get_offsets(), evaluated.get_offsets())
    np.testing.assert_array_equal(start.get_offsets(), [[1.4, 1.4]])
    assert ax.get_xlabel() == "volume [m³\u00a0rad³], max"
    assert ax.get_ylabel() == "footprint [m²], min"
