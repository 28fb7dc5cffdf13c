"""The page "Your ball balancer": what it shows and offers, compared with the package, in a browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import balancer_page
import numpy as np
import pytest
from browser import chromium, until, watched

import spm_pin as spm
from spm_pin.export import stage_c_sources

pytestmark = pytest.mark.slow  # a browser without a graphics card

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/balancer.html"
SIZES = {
    "RRS": ([70, 95, 45, 105, -70, 85], 95.0),
    "PRS": ([120, 90, 150, 70], 150.0),
    "RPS": ([140, 110, 150, 240], 200.0),
}
"""Numbers typed [mm, °], and a height [mm]."""
INSIDE = [70, 95, 45, 105, 80, 240]
MACHINE = pytest.mark.parametrize(("kind", "inside"), [("PRS", False), ("RPS", False), ("RRS", True)])


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as found:
        yield found


@contextmanager
def opened(browser, **options) -> Iterator:
    """Have the page from the disk, which must load nothing else and have no errors."""
    page = browser.new_page(**{"viewport": {"width": 1000, "height": 800}, "accept_downloads": True, **options})
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    errors = watched(page)
    page.goto(PAGE.as_uri())
    until(lambda: page.locator("#balancer td").first.inner_text() != "", "readings", page=page)
    yield page
    assert not errors
    assert {url for url in requests if not url.startswith("blob:")} == {PAGE.as_uri()}
    page.close()


def enter(page, kind: str, numbers: list[float | str], *, inside: bool = False, **sliders: float) -> None:
    page.locator(f"#balancer input[value={kind}]").evaluate("it => it.click()")
    if kind == "RRS":
        page.locator(".balancer-knees input").set_checked(inside)
    for field, number in zip(page.locator(".balancer-numbers input").all(), numbers, strict=True):
        field.fill(str(number))
    for name, value in sliders.items():
        slider = page.locator(f"#balancer input[aria-label={name}]")
        slider.evaluate("(it, x) => { it.value = x; it.dispatchEvent(new Event('input')); }", value)


def stage_in_python(page) -> spm.Stage:
    """Return the stage of the lines that the page shows."""
    lines = page.locator(".balancer-python").text_content().splitlines()
    names: dict[str, spm.Stage] = {}
    exec("\n".join(lines[:-1]), names)
    return names["stage"]


def test_the_page_is_as_new_as_its_parts(tmp_path: Path) -> None:
    module = balancer_page.webassembly()
    if module is None:
        pytest.skip("needs the system packages clang and lld")
    balancer_page.main(tmp_path / "balancer.html")
    pages = [path.read_text(encoding="utf-8") for path in (tmp_path / "balancer.html", PAGE)]
    new, stored = (re.sub(r'"module":"[^"]*"', "", text) for text in pages)
    assert new == stored
    assert len(stored.encode()) < 60_000
    assert "http" not in stored.replace("http://www.w3.org/2000/svg", "")


@MACHINE
def test_readings_are_those_of_the_package(browser, kind: str, inside: bool) -> None:
    numbers, height = SIZES[kind]
    with opened(browser) as page:
        enter(page, kind, INSIDE if inside else numbers, inside=inside, tilt=14.0, azimuth=33.0, height=height)
        stage = stage_in_python(page)
        assert stage.kind.name == kind
        assert [1e3 * stage.base_radius, 1e3 * stage.platform_radius] == pytest.approx(numbers[:2])
        if kind == "RRS":
            assert stage.kind.sign == (1 if inside else -1)
            expected = np.deg2rad((INSIDE if inside else numbers)[4:])
            np.testing.assert_allclose([stage.limits.minimum[0], stage.limits.maximum[0]], expected)
        held = spm.inverse_physical(stage, 1e-3 * height, tilt=np.deg2rad(14.0), azimuth=np.deg2rad(33.0))
        cells = page.locator("#balancer td:nth-child(2)")
        exact = cells.evaluate_all("all => all.map((one) => Number(one.dataset.value))")
        np.testing.assert_allclose(exact, held.readings, rtol=0.0, atol=1e-12)
        factor = np.rad2deg(1.0) if stage.unit == "rad" else 1e3
        texts = [float(text.replace("−", "-")) for text in cells.all_inner_texts()]
        np.testing.assert_allclose(texts, factor * held.readings, rtol=0.0, atol=0.0051)
        check_copied_formula(page, stage, held)


def check_copied_formula(page, stage: spm.Stage, held: spm.Configuration) -> None:
    """Compare errors shown with those of balls at the plate's radius from a centre that stays."""
    outward, _ = stage.legs.planes
    down = -(held.normal[:2] * outward[:, :2]).sum(axis=-1)
    arms = np.column_stack([held.normal[2] * outward[:, :2], down])
    balls = stage.platform_radius * arms / np.linalg.norm(arms, axis=-1, keepdims=True) + [0.0, 0.0, held.height]
    off = np.linalg.norm(balls - held.balls, axis=-1)
    side = np.linalg.norm(balls - np.roll(balls, 1, axis=0), axis=-1) - np.sqrt(3.0) * stage.platform_radius
    shown = page.locator(".balancer-error").inner_text()
    numbers = [float(x) for x in re.findall(r"[\d.]+(?= mm|°)", shown)]
    arms = balls - stage.legs.pivots
    places = np.stack([(arms * axis).sum(axis=-1) for axis in stage.legs.planes], axis=-1)
    real = spm.forward_physical(stage, stage.legs.readings(places, stage.crank_middles))
    expected = [1e3 * off.max(), 1e3 * np.abs(side).max(), np.rad2deg(real.tilt), 1e3 * real.height]
    np.testing.assert_allclose(numbers, expected, rtol=0.0, atol=0.0051)
    labels = page.locator("#balancer .off").all_text_contents()
    np.testing.assert_allclose([float(x.split()[0]) for x in labels], 1e3 * off, rtol=0.0, atol=0.051)
    assert off.max() > 1e-3 * stage.platform_radius


@MACHINE
def test_the_header_is_the_package_s(browser, kind: str, inside: bool, tmp_path: Path) -> None:
    with opened(browser) as page:
        enter(page, kind, INSIDE if inside else SIZES[kind][0], inside=inside)
        with page.expect_download() as download:
            page.locator(".balancer-header").click()
        assert download.value.suggested_filename == "stage.h"
        download.value.save_as(tmp_path / "stage.h")
        stage = stage_in_python(page)
    texts = (tmp_path / "stage.h").read_text(encoding="utf-8"), stage_c_sources(stage)["stage.h"]
    parts = [text.split("stage_machine = {")[1].split("\n};")[0] for text in texts]
    numbers = [[float(x) for x in re.findall(r"(?<![\w.])-?\d[\d.]*(?:e-?\d+)?", part)] for part in parts]
    np.testing.assert_allclose(*numbers, rtol=0.0, atol=1e-12)
    shapes = [re.sub(r"STAGE_R\([^)]*\)|-?\d+", "0", part) for part in parts]
    assert shapes[0] == shapes[1]
    codes = [
        re.sub(r"(Generated|Written) by .*", "", text).replace(part, "")
        for text, part in zip(texts, parts, strict=True)
    ]
    assert codes[0] == codes[1]


def test_a_drag_tilts_the_plate_towards_where_it_goes_and_stops_where_the_machine_does(browser) -> None:
    with opened(browser) as page:
        enter(page, "RRS", [*SIZES["RRS"][0][:4], -90, 90], tilt=0.0)

        def drag(across: float, down: float) -> None:
            box = page.locator("#balancer .plate").bounding_box()
            x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x + across, y + down, steps=8)
            page.mouse.up()

        drag(0.0, 30.0)
        normal = np.array(page.evaluate("document.getElementById('balancer').stage.shown().normal"))
        assert 0.05 < normal[:2] @ [np.cos(np.deg2rad(-75.0)), np.sin(np.deg2rad(-75.0))] < 0.5  # towards the reader
        drag(0.0, -900.0)
        tilt = page.evaluate("document.getElementById('balancer').stage.shown().tilt")
        stage = stage_in_python(page)
        azimuth = np.deg2rad(float(page.locator("#balancer input[aria-label=azimuth]").input_value()))
        tilts = tilt + np.array([-1e-3, 0.02])
        held = spm.inverse_physical(stage, spm.workspace.home_height(stage), tilt=tilts, azimuth=azimuth)
        assert held.exists[0]
        assert stage.limits.contains(held.readings).tolist() == [True, False]


def test_what_is_out_of_reach_is_said(browser) -> None:
    with opened(browser) as page:
        enter(page, "RRS", SIZES["RRS"][0], tilt=55.0)
        assert re.fullmatch(r"55\.0° is .*: shown is \d+\.\d°", page.locator(".balancer-status").inner_text())
        limits = SIZES["RRS"][0][4:]
        lengths = [70, 95, 5, 10], [0, 95, 45, 105], ["", 95, 45, 105], [0.07, 0.095, 0.045, 0.105]
        for numbers in (*([*x, *limits] for x in lengths), [70, 95, 45, 105, 85, -70]):
            enter(page, "RRS", SIZES["RRS"][0])
            enter(page, "RRS", numbers)
            assert "at no height" in page.locator(".balancer-status").inner_text()
            assert page.locator(".balancer-header").is_disabled()
            assert page.locator(".balancer-copy").is_disabled()
            assert page.locator("#balancer table").is_hidden()
