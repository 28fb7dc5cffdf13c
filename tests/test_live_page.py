"""The machine on the front page: the exported C in a browser, what it shows, and what stands there without it."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import live_page
import numpy as np
import pytest
from browser import chromium, until, watched
from export.c_poses import spread_poses
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.description.visuals import part_placements, visual_parts

pytestmark = pytest.mark.slow  # a browser without a graphics card

ROOT = Path(__file__).parents[1]
MACHINE = spm.Manipulator.paper()
BRANCHES = list(spm.machine.BRANCHES)


@pytest.fixture(scope="module")
def module() -> bytes:
    found = live_page.webassembly()
    if found is None:
        pytest.skip("needs the system packages clang and lld")
    return found


@pytest.fixture(scope="module")
def file(module: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page in a folder of its own, with the machine and the picture after it as on the front page."""
    folder = tmp_path_factory.mktemp("page") / "sub folder"
    folder.mkdir()
    (folder / "picture.png").write_bytes((ROOT / "docs/images/mechanism.png").read_bytes())
    body = f'<p>Text.</p>\n{live_page.fragment(module)}\n<p><img src="picture.png" alt=""></p>'
    (folder / "index.html").write_text(f'<!doctype html><meta charset="utf-8"><body>{body}</body>', encoding="utf-8")
    return folder / "index.html"


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as found:
        yield found


@contextmanager
def opened(browser, file: Path, script: str = "", **options) -> Iterator:
    """Have the page from the disk, which must load nothing else and have no errors."""
    page = browser.new_page(**{"reduced_motion": "reduce", **options})
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    errors = watched(page)
    if script:
        page.add_init_script(script)
    page.goto(file.as_uri())
    yield page
    assert not errors
    assert all(url.startswith((file.parent.as_uri(), ROOT.as_uri())) for url in requests)
    page.close()


@pytest.fixture(scope="module")
def page(browser, file: Path) -> Iterator:
    with opened(browser, file, viewport={"width": 800, "height": 700}) as found:
        until(lambda: found.locator("#live b.live-time").inner_text() != "a few", "a solution", page=found)
        yield found


def test_the_page_in_one_file_is_as_new_as_its_parts(module: bytes, tmp_path: Path) -> None:
    live_page.main(tmp_path / "live.html")
    # Compilers differ: of the module only its place is compared.
    pages = [path.read_text(encoding="utf-8") for path in (tmp_path / "live.html", ROOT / "docs/live.html")]
    new, stored = (re.sub(r'"module":"[^"]*"', "", text) for text in pages)
    assert new == stored
    assert "http" not in re.sub(r'xmlns="[^"]*"', "", stored)


def solved_in_python(page) -> spm.SolutionSet:
    """Return the branches that the Python shown on the page finds."""
    names: dict[str, spm.SolutionSet] = {}
    exec(page.locator("#live pre").text_content(), names)
    return names["branches"]


def check_what_is_shown(page) -> spm.SolutionSet:
    """Compare each branch that can be chosen with Python's, and the words in its place where there is none."""
    expected = solved_in_python(page)
    choices = page.locator(".live-branches label")
    notes = choices.locator("small").all_inner_texts()
    assert [note in ("real", "physical") for note in notes] == [bool(expected.exists[k]) for k in order(page)]
    physical = expected.physical()
    marked = [k for k, note in zip(order(page), notes, strict=True) if note == "physical"]
    assert len(marked) == int(bool(physical.exists))
    for k in marked:
        np.testing.assert_allclose(expected.leg_lengths[k], physical.leg_lengths, rtol=0.0, atol=1e-12)
    for k in np.flatnonzero(expected.exists):
        choose(page, BRANCHES[k])
        np.testing.assert_allclose(lengths_shown(page), expected.leg_lengths[k], rtol=0.0, atol=1e-12)
        texts = [float(text) for text in page.locator("#live data").all_inner_texts()]
        np.testing.assert_allclose(texts, expected.leg_lengths[k], rtol=0.0, atol=0.51e-4)
        check_solids(page, expected[int(k)])
    assert page.locator("#live table").is_visible() == bool(expected.exists.any())
    return expected


def lengths_shown(page) -> list[float]:
    return page.locator("#live data").evaluate_all("all => all.map((one) => Number(one.value))")


def order(page) -> list[int]:
    return [BRANCHES.index(x) for x in page.locator(".live-branches input").evaluate_all("a => a.map((x) => x.value)")]


def choose(page, value: str) -> None:
    page.locator(f'#live input[value="{value}"]').evaluate("it => it.click()")


def set_sliders(page, values) -> None:
    for k, value in enumerate(values):
        slider = page.locator("#live input[type=range]").nth(k)
        slider.evaluate("(it, x) => { it.value = x; it.dispatchEvent(new Event('input')); }", value)


def test_webassembly_finds_the_branches_of_the_package(page) -> None:
    rotation, position = spread_poses(MACHINE, 600, 1)
    script = "poses => poses.map((x) => document.getElementById('live').machine.inverse(x.slice(0, 9), x.slice(9)))"
    found = page.evaluate(script, np.hstack([rotation.reshape(-1, 9), position]).tolist())
    expected = spm.inverse_displacement(MACHINE, spm.pose(position, rotation=rotation))
    clear = (np.abs(expected.discriminants) > 1e-6).all(axis=-1)
    assert clear.mean() > 0.98
    assert np.array([answer["status"] for answer in found])[clear].tolist() == expected.status[clear].tolist()
    np.testing.assert_array_equal(np.array([answer["real"] for answer in found])[clear], expected.exists[clear])
    lengths = np.array([answer["lengths"] for answer in found], float)
    np.testing.assert_allclose(lengths[clear], expected.leg_lengths[clear], rtol=0.0, atol=1e-9)
    joints = np.array([answer["joints"] for answer in found], float).reshape(-1, 8, 3, 3)
    np.testing.assert_allclose(joints[clear], expected.configurations.middle_joints[clear], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("example", ["eight branches", "level", "out of reach"])
def test_an_example_shows_what_python_finds(page, example: str) -> None:
    page.get_by_role("button", name=example).click()
    expected = check_what_is_shown(page)
    status = page.locator(".live-status").inner_text()
    if example == "level":
        assert expected.status == spm.Status.DEGENERATE
        assert status == "Degenerate"
        assert "undetermined" in page.locator(".live-reason").inner_text()
    elif example == "out of reach":
        assert expected.status == spm.Status.UNREACHABLE
        assert status == "Out of reach"
    else:
        assert status == f"{int(expected.count)} of 8 branches are real"
    drawn = bool(expected.exists.any())
    until(lambda: page.locator(".live-handle").is_visible() == drawn, "the picture", page=page)


def test_sliders_of_the_pose_show_what_python_finds(page) -> None:
    choose(page, "pose")
    pose = [-0.328, 0.097, 2.517, -5.1, -14.3, 2.2]
    set_sliders(page, pose)
    expected = check_what_is_shown(page)
    assert expected.count > 0
    turned = Rotation.from_euler("xyz", pose[3:], degrees=True)
    held = expected.configurations[0].pose
    np.testing.assert_array_equal(held.translation, pose[:3])
    np.testing.assert_allclose(held.rotation.as_matrix(), turned.as_matrix(), atol=1e-15)


def check_solids(page, state) -> None:
    """Compare the places of the solids with those of the description."""
    found = page.evaluate("document.getElementById('live').machine.placements()")
    for matrix, part, placement in zip(found, visual_parts(MACHINE), part_placements(state), strict=False):
        points = live_page.mesh(part.mesh)[0]
        rows = np.array(matrix).reshape(4, 4)[:, :3]
        shown = points / np.abs(points).max() @ rows[:3] + rows[3]
        np.testing.assert_allclose(shown, part.vertices @ placement[:3, :3].T + placement[:3, 3], atol=1e-4)


def test_a_drag_changes_the_legs_least_and_comes_back_to_where_it_began(browser, file: Path) -> None:
    with opened(browser, file, viewport={"width": 800, "height": 700}) as page:
        until(page.locator(".live-handle").is_visible, "the handle", page=page)
        choose(page, "legs")
        before = solved_in_python(page).physical()
        text = page.locator("#live pre").text_content()
        x, y = handle(page)
        page.mouse.move(x, y)
        page.mouse.down()
        for across, down in ([80.0, 0.0], [0.0, 60.0], [-400.0, 300.0], [-80.0, 0.0]):
            page.mouse.move(x + across, y + down, steps=6)
            assert page.locator("#live pre").text_content() != text
            page.mouse.move(x, y, steps=6)
            assert page.locator("#live pre").text_content() == text
        page.mouse.move(x - 80.0, y, steps=3)
        page.mouse.up()
        # The view's directions to the right and up, at an azimuth of 15 degrees and an elevation of 25.
        view = Rotation.from_euler("ZY", [15.0, -25.0], degrees=True).as_matrix()[:, 1:].T
        found = solved_in_python(page).physical()
        least = minimize(
            lambda lengths: np.sum((lengths - before.leg_lengths) ** 2),
            before.leg_lengths,
            bounds=[(1.1, 1.5)] * 6,
            constraints={
                "type": "eq",
                "fun": lambda x: view @ (spm.forward_physical(MACHINE, x).translation - found.translation),
            },
            method="SLSQP",
            options={"ftol": 1e-12},
        )
        assert least.success
        np.testing.assert_allclose(found.leg_lengths, least.x, rtol=0.0, atol=3e-4)


def handle(page) -> np.ndarray:
    box = page.locator(".live-handle").bounding_box()
    return np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]])


def test_the_picture_stands_in_its_place(browser, file: Path) -> None:
    with opened(browser, file, "HTMLCanvasElement.prototype.getContext = () => null") as page:
        until(page.locator("img").is_visible, "the picture", page=page)
        assert page.locator("#live").is_hidden()
        page.goto((ROOT / "docs/live.html").as_uri())
        until(page.get_by_text("needs a browser with").is_visible, "what the page in one file needs", page=page)


def test_the_lines_of_the_how_to_make_a_module_that_solves(page, module: bytes, tmp_path: Path) -> None:
    text = (ROOT / "docs/howto/controller.md").read_text(encoding="utf-8")
    shell, script = (re.search(rf"```{kind}\n([^`]*(?:wasm|WebAssembly)[^`]*)```", text) for kind in ("sh", "js"))
    spm.export.write_c(MACHINE, tmp_path / "spm_c")
    subprocess.run(["sh", "-ec", shell[1]], cwd=tmp_path, check=True)
    assert (tmp_path / "wasm/math.h").read_bytes() == (ROOT / "docs/site/live/math.h").read_bytes()
    made = (tmp_path / "spm.wasm").read_bytes()
    assert len(made) < len(module)
    held = spm.inverse_physical(MACHINE, spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88])))
    arguments = [list(made), held.rotation.ravel().tolist(), held.translation.tolist()]
    prologue = "async ([given, rotation, position]) => { const bytes = new Uint8Array(given);"
    status, lengths = page.evaluate(f"{prologue} {script[1]} return [status, lengths]; }}", arguments)
    assert status == 0
    np.testing.assert_allclose(lengths, held.leg_lengths, rtol=0.0, atol=1e-13)


def test_without_a_compiler_the_front_page_keeps_its_picture(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", "")
    page = "# Start\n\nText.\n\n![A picture](picture.png)\n"
    assert live_page.with_machine(page) == page
    assert "wasm-ld" in capsys.readouterr().err
