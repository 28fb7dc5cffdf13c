"""The viewer's page in a browser: dragged, clicked, warned, by two at once, and left."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, pixel, until, watched

import spm_pin as spm
from spm_pin.display.viewer import Viewer, save_snapshot
from spm_pin.display.viewer.recording import Recording
from spm_pin.display.viewer.state import Drive

pytestmark = pytest.mark.slow  # a browser without a graphics card

SIZE = {"width": 1000, "height": 640}
PICTURES = Path(__file__).parents[2] / ".artifacts"


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def viewer():
    legs = [[1.25, 1.2, 1.38, 1.25, 1.2, 1.45], [1.2, 1.25, 1.3, 1.3, 1.2, 1.4]]
    with Viewer(port=0, recording=Recording(np.array(legs), np.array([0.0, 1.0]))) as started:
        yield started


def opened(browser, viewer, **options):
    """Return a new page that is up to date, its session, and its errors."""
    before = {id(session) for session in viewer.sessions}
    page = browser.new_page(**{"viewport": SIZE, **options})
    errors = watched(page)
    page.goto(viewer.url)
    page.wait_for_selector('[data-spm="branch"]', state="attached", timeout=60_000)
    until(lambda: len(viewer.sessions) > len(before), "a session of its own", page=page)
    (session,) = [one for one in viewer.sessions if id(one) not in before]
    settled(page, session)
    return page, session, errors


@pytest.fixture(scope="module")
def client(browser, viewer):
    page, session, errors = opened(browser, viewer)
    yield page, session, errors
    page.close()


def settled(page, session):
    """Wait until the camera that the page reports is where the session put it and stays there."""
    last = []

    def still():
        camera = session.client.camera
        last.append((*camera.position, camera.image_width))
        page.wait_for_timeout(150)
        return len(last) > 4 and last[-1] == last[-4] and camera.image_width == page.viewport_size["width"]

    until(still, "a camera at rest", page=page)


def reset(page, session):
    session.model.hold_limits = True
    session.model.load(np.zeros(6))
    session._on_reset(None)
    page.wait_for_timeout(300)


def drag_gizmo(page, session, axis, distance):
    """Take the gizmo's arrow along an axis of m, and move it so far in the world [m]."""
    origin, rotation = session.gizmo.position, session.state.target.rotation.as_matrix()
    before = np.array(origin)
    for share in (0.85, 0.7, 0.95, 0.55):
        grip = origin + share * session.gizmo.scale * rotation[:, axis]
        start = pixel(session.client.camera, grip)
        end = pixel(session.client.camera, grip + distance * rotation[:, axis])
        page.mouse.move(*start)
        page.wait_for_timeout(250)
        page.mouse.down()
        page.mouse.move(*end, steps=4)
        page.wait_for_timeout(400)
        page.mouse.up()
        page.wait_for_timeout(400)
        if np.linalg.norm(session.gizmo.position - before) > 0.2 * abs(distance):
            return
    raise AssertionError("no arrow of the gizmo was hit")


def picture(page, name):
    PICTURES.mkdir(exist_ok=True)
    page.screenshot(path=PICTURES / name)


def test_the_page_shows_the_robot_and_its_instruments(client):
    page, session, errors = client
    assert page.inner_text('[data-spm="branch"]') == "TT+"
    assert page.inner_text('[data-spm="r_b3"]') == "1.400"
    assert page.query_selector('[data-spm="warning"]') is None
    assert page.evaluate("Math.max(...Array.from(document.querySelectorAll('canvas'), c => c.width))") > 500
    picture(page, "viewer.png")
    assert not errors
    assert session.client.camera.image_width == SIZE["width"]


def test_a_dragged_gizmo_moves_the_robot(client, viewer):
    page, session, errors = client
    reset(page, session)
    chain = spm.ClosedChain.from_urdf()
    before = session.state.shown.translation.copy()
    drag_gizmo(page, session, 2, -0.06)
    until(lambda: session.state.target.translation @ before != before @ before, "a new pose", page=page)
    page.wait_for_timeout(300)
    shown = session.state.shown
    assert np.linalg.norm(shown.translation - before) > 0.01
    # The joint values the page shows put Pinocchio's platform where the page's robot is.
    q = np.array(eval(session.panel.q.value.replace("\n", "")))
    np.testing.assert_allclose(chain.configuration(q).translation, shown.translation, atol=1e-6)
    positions, _ = session.config.robot.placements(session.config.robot.q(shown))
    np.testing.assert_allclose([handle.position for handle in session.scene._robot], positions, atol=1e-6)
    until(lambda: f"{shown.translation[0]:.3f}" in page.inner_text('[data-spm="pose"]'), "its numbers", page=page)
    assert not errors


def test_a_clicked_ghost_is_selected(client):
    page, session, errors = client
    reset(page, session)
    camera = session.client.camera
    tried = []
    for label in ("FF+", "TF-", "FF-"):
        state = session.state.solutions[label]
        hips = np.concatenate([state.geometry.base_joints, state.platform_joints])
        for leg in (0, 3, 1, 4, 2, 5):
            tried.append(label)
            page.mouse.move(*pixel(camera, 0.75 * hips[leg] + 0.25 * state.middle_joints[leg % 3]))
            page.wait_for_timeout(150)
            page.mouse.click(*pixel(camera, 0.75 * hips[leg] + 0.25 * state.middle_joints[leg % 3]))
            page.wait_for_timeout(400)
            if session.state.label != "TT+":
                break
        if session.state.label != "TT+":
            break
    assert session.state.label in session.state.labels
    assert session.state.label != "TT+", f"no ghost was hit: {tried}"
    until(lambda: page.inner_text('[data-spm="branch"]') == session.state.label, "its name", page=page)
    np.testing.assert_allclose(session.state.shown.translation, session.config.start.translation, atol=1e-12)
    # And back by the list of branches.
    page.locator(f'input[role=combobox][value="{session.state.label}"]').click()
    page.get_by_role("option", name="TT+").click()
    until(lambda: session.state.label == "TT+", "the branch chosen from the list", page=page)
    assert not errors


def test_a_drag_out_of_reach_warns_and_shows_the_nearest(client):
    page, session, errors = client
    reset(page, session)
    drag_gizmo(page, session, 2, 0.35)
    until(lambda: session.state.distance > 0.01, "a pose out of reach", page=page)
    page.wait_for_selector('[data-spm="warning"]')
    page.wait_for_timeout(300)
    assert "out of reach" in page.inner_text('[data-spm="warning"] >> nth=0')
    assert session.model.within_limits(session.state.shown)
    assert all(handle.visible for handle in session.scene._wanted)
    picture(page, "viewer_out_of_reach.png")
    assert not errors


def test_legs_load_and_path_drive_it_too(client):
    page, session, errors = client
    reset(page, session)

    async def events():
        await session.report("load", None)
        await session.report("drive", Drive.LEGS)
        await session.report("leg", (0, 1.25))
        await session.queue.drained()

    session.panel.force.value = (0.0, 0.0, -500.0)
    loop = session.client._viser_server._event_loop
    asyncio.run_coroutine_threadsafe(events(), loop).result(timeout=30.0)
    assert session.state.shown.leg_lengths[0] == pytest.approx(1.25)
    expected = spm.leg_forces(session.state.shown, [0, 0, -500, 0, 0, 0])
    np.testing.assert_allclose(session.state.readings.forces, expected)
    assert session.scene._arrows["push"].visible or session.scene._arrows["pull"].visible
    asyncio.run_coroutine_threadsafe(session.report("play", None), loop).result(timeout=30.0)
    until(lambda: session.player.time == 1.0 and not session.player.playing, "the end of the path", page=page)
    until(lambda: abs(session.state.shown.leg_lengths[1] - 1.25) < 1e-9, "its last point", page=page)
    assert "configurations of" in session.panel.path_note.content
    assert not session.gizmo.visible
    asyncio.run_coroutine_threadsafe(session.report("drive", Drive.POSE), loop).result(timeout=30.0)
    assert not errors


def test_two_clients_at_once_and_one_that_goes(browser, viewer, client):
    page, session, errors = client
    reset(page, session)
    loop = viewer.server._event_loop

    def running():
        tasks = [task for task in asyncio.all_tasks(loop) if "spm_pin" in repr(task.get_coro())]
        return len(tasks)

    other_page, other, other_errors = opened(browser, viewer)
    threads = threading.active_count()
    assert len(viewer.sessions) == 2
    asyncio.run_coroutine_threadsafe(other.report("branch", "FF+"), loop).result(timeout=30.0)
    until(lambda: other_page.inner_text('[data-spm="branch"]') == "FF+", "the other's branch", page=other_page)
    assert session.state.label == "TT+"
    assert page.inner_text('[data-spm="branch"]') == "TT+"
    asyncio.run_coroutine_threadsafe(other.report("play", None), loop).result(timeout=30.0)
    until(lambda: other.player.playing, "time to run", page=other_page)
    other_page.close()
    until(lambda: viewer.sessions == (session,), "one session less", page=page)
    until(lambda: not running(), "no task of it left", page=page)
    assert not other.player.playing
    assert threading.active_count() <= threads
    assert not errors
    assert not other_errors


def test_on_a_phone_and_in_the_dark(browser, viewer):
    page, session, errors = opened(browser, viewer, viewport={"width": 390, "height": 844})
    asyncio.run_coroutine_threadsafe(session.report("dark", True), viewer.server._event_loop).result(timeout=30.0)
    page.wait_for_timeout(1000)
    # Nothing is wider than the page.
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    picture(page, "viewer_phone_dark.png")
    page.close()
    assert not errors


def test_the_snapshot_needs_neither_server_nor_network(browser, tmp_path):
    path = save_snapshot(
        spm.forward_physical(spm.Geometry.paper(), [1.2, 1.2, 1.4, 1.25, 1.2, 1.5]), tmp_path / "a.html"
    )
    context = browser.new_context(viewport=SIZE, offline=True)
    page = context.new_page()
    errors, requests = watched(page), []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri())
    page.wait_for_selector("canvas")
    assert page.inner_text('#spm-card [data-spm="branch"]') == "TT+"
    assert "spm-pin inverse" in page.inner_text("#spm-card code")
    page.wait_for_timeout(3000)
    picture(page, "viewer_snapshot.png")
    context.close()
    assert not errors
    assert [url for url in requests if not url.startswith(("file:", "blob:", "data:"))] == []
