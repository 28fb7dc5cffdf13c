"""The viewer's page in a browser: drags, clicks, warnings, two clients, disconnection."""

from __future__ import annotations

import asyncio
import gc
import itertools
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, drained, pixel, until, watched
from PIL import Image

import spm_pin as spm
from spm_pin.display.viewer import Recording, Viewer
from spm_pin.display.viewer.robot_scene import robot_points, solid_placements

pytestmark = pytest.mark.slow  # a browser without a graphics card

SIZE = {"width": 1000, "height": 640}
PIXELS = "?fixedDpr=1"  # else viser draws, and reports, fewer pixels where it is slow
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


@contextmanager
def opened(browser, viewer, **options):
    """Have a new page that is up to date, its session, and its errors; it is closed whatever comes."""
    before = {id(session) for session in viewer.sessions}
    page = browser.new_page(**{"viewport": SIZE, **options})
    try:
        page.set_default_timeout(90_000)
        errors = watched(page)
        page.goto(viewer.url + PIXELS)
        page.wait_for_selector('[data-spm="branch"]', state="attached", timeout=60_000)
        until(lambda: len(viewer.sessions) > len(before), "a session of its own", page=page)
        (session,) = [candidate for candidate in viewer.sessions if id(candidate) not in before]
        settled(page, session)
        until(lambda: session.player.time == 1.0 and not session.player.playing, "the end of its path", page=page)
        until(lambda: abs(session.model.state.shown.leg_lengths[1] - 1.25) < 1e-9, "its last point", page=page)
        assert "configurations of" in session.panel.path_note.content
        reset(page, session)
        yield page, session, errors
    finally:
        page.close()
        until(lambda: len(viewer.sessions) == len(before), "its session ended")


@pytest.fixture(scope="module")
def shared(browser, viewer):
    with opened(browser, viewer) as opened_client:
        yield opened_client


@pytest.fixture
def client(shared):
    """Have a page at the start pose without a load, and its session; the test must leave no error on it."""
    page, session, errors = shared
    reset(page, session)
    yield page, session
    assert not errors


def drawn(page):
    """Wait for five frames: seconds where the machine is slow and busy."""
    page.evaluate("""() => new Promise(done => {
        let frames = 5; const next = () => frames-- > 0 ? requestAnimationFrame(next) : done(); next(); })""")


def settled(page, session):
    """Wait until the camera that the page reports stays where the session put it, while frames are drawn."""
    last = []

    def still():
        camera = session.client.camera
        last.append((*camera.position, camera.image_width))
        drawn(page)
        page.wait_for_timeout(150)
        return len(last) > 4 and last[-1] == last[-4] and camera.image_width > 0

    until(still, "a camera at rest", page=page)


def send(session, name, value=None):
    """Let an event happen and wait until its work is done."""

    async def done():
        await session.report(name, value)
        await drained(session.queue)

    asyncio.run_coroutine_threadsafe(done(), session._loop).result(timeout=300.0)


def reset(page, session):
    session.model.load(np.zeros(6))
    send(session, "reset")
    page.wait_for_timeout(300)


def robot_pixels(session):
    """Where the page shows the robot's joints, and the size of its picture."""
    camera = session.client.camera
    points = robot_points(session.model.state.shown, 0.0)
    return np.array([pixel(camera, point) for point in points]), np.array([camera.image_width, camera.image_height])


def drag_gizmo(page, session, axis, distance):
    """Take the gizmo's arrow along an axis of m, and move it so far in the world [m]."""
    origin, rotation = session.gizmo.position, session.model.state.target.rotation.as_matrix()
    before = np.array(origin)
    for share in (0.85, 0.7, 0.95, 0.55):
        grip = origin + share * session.gizmo.scale * rotation[:, axis]
        start = pixel(session.client.camera, grip)
        end = pixel(session.client.camera, grip + distance * rotation[:, axis])
        page.mouse.move(*start)
        drawn(page)
        page.wait_for_timeout(250)
        page.mouse.down()
        page.mouse.move(*end, steps=4)
        drawn(page)
        page.wait_for_timeout(400)
        page.mouse.up()
        drawn(page)
        page.wait_for_timeout(400)
        if np.linalg.norm(session.gizmo.position - before) > 0.2 * abs(distance):
            return
    raise AssertionError("no arrow of the gizmo was hit")


def picture(page, name):
    PICTURES.mkdir(exist_ok=True)
    page.screenshot(path=PICTURES / name)


def test_the_page_shows_the_robot_and_its_instruments(client):
    page, session = client
    assert page.inner_text('[data-spm="branch"]') == "TT+"
    assert page.inner_text('[data-spm="r_b3"]') == "1.400"
    assert page.query_selector('[data-spm="warning"]') is None
    assert page.evaluate("Math.max(...Array.from(document.querySelectorAll('canvas'), c => c.width))") > 500
    picture(page, "viewer.png")
    # The panel stands beside the picture, not over it, and the robot fills the picture's height.
    seen, size = robot_pixels(session)
    assert size[0] < SIZE["width"] - 300
    assert ((seen > 0.0) & (seen < size)).all()
    assert np.ptp(seen[:, 1]) > 0.65 * size[1]
    assert not any(handle.visible for handle in session.scene._ghosts.values())


def test_a_dragged_gizmo_moves_the_robot(client, viewer):
    page, session = client
    chain = spm.ClosedChain.from_urdf()
    before = session.model.state.shown.translation.copy()
    drag_gizmo(page, session, 2, -0.06)
    until(lambda: session.model.state.target.translation @ before != before @ before, "a new pose", page=page)
    page.wait_for_timeout(300)
    shown = session.model.state.shown
    assert np.linalg.norm(shown.translation - before) > 0.01
    # The joint values the page shows put Pinocchio's platform where the page's robot is.
    q = np.array(eval(session.panel.q.value.replace("\n", "")))
    np.testing.assert_allclose(chain.state(q).configuration().translation, shown.translation, atol=1e-6)
    positions, _, _ = solid_placements(shown)
    np.testing.assert_allclose([handle.position for handle in session.scene._robot], positions, atol=1e-6)
    # The trail of o begins, and other sliders have the ranges around the new state.
    assert session.scene._trail.visible
    assert session.panel.pose_sliders[2].min < shown.translation[2] < session.panel.pose_sliders[2].max
    until(lambda: f"{shown.translation[0]:.3f}" in page.inner_text('[data-spm="pose"]'), "its numbers", page=page)


def test_a_clicked_ghost_is_selected(client):
    page, session = client
    send(session, "layer", ("ghosts", True))
    page.wait_for_timeout(1000)
    picture(page, "viewer_ghosts.png")
    solutions = session.model.state.solutions
    for label, leg in itertools.product(("FF+", "TF-", "FF-"), (0, 3, 1, 4, 2, 5)):
        point = 0.75 * solutions[label].leg_bases[leg] + 0.25 * solutions[label].balls[leg]
        page.mouse.move(*pixel(session.client.camera, point))
        page.wait_for_timeout(150)
        page.mouse.click(*pixel(session.client.camera, point))
        page.wait_for_timeout(400)
        if session.model.state.label != "TT+":
            break
    assert session.model.state.label in session.model.state.labels
    assert session.model.state.label != "TT+", "no ghost was hit"
    until(lambda: page.inner_text('[data-spm="branch"]') == session.model.state.label, "its name", page=page)
    np.testing.assert_allclose(session.model.state.shown.translation, session.viewer.start.translation, atol=1e-12)
    send(session, "layer", ("ghosts", False))
    page.get_by_role("tab", name="Share").click()
    with page.expect_download(timeout=60_000) as saved:
        page.get_by_role("button", name="Save picture (PNG)").click()
    with Image.open(saved.value.path()) as image:
        assert image.format == "PNG"
        assert np.asarray(image.convert("RGBA"))[..., 3].mean() > 5.0
    page.get_by_role("tab", name="Pose").click()


def test_a_drag_out_of_reach_warns_and_shows_the_nearest(client):
    page, session = client
    drag_gizmo(page, session, 2, 0.35)
    until(lambda: session.model.state.distance > 0.01, "a pose out of reach", page=page)
    page.wait_for_selector('[data-spm="warning"]')
    page.wait_for_timeout(300)
    assert "out of reach" in page.inner_text('[data-spm="warning"] >> nth=0')
    assert not session.model.state.shown.limit_excess.any()
    assert session.scene._wanted.visible
    picture(page, "viewer_out_of_reach.png")
    # The way back stands right below the warning.
    back = page.get_by_role("button", name="Back to the reachable pose")
    assert back.is_visible()
    back.click()
    until(lambda: session.model.state.distance == 0.0, "the target where the platform is", page=page)
    until(lambda: not back.is_visible(), "no way back where none is needed", page=page)
    assert not session.scene._wanted.visible


def test_two_clients_at_once_and_one_that_goes(browser, viewer, client):
    page, session = client
    loop = viewer.server._event_loop

    def own_threads():
        # Pools start their threads as they need them, and keep them.
        pools = ("asyncio", "ThreadPoolExecutor")
        return sum(not thread.name.startswith(pools) for thread in threading.enumerate())

    def running():
        return any("spm_pin" in repr(task.get_coro()) for task in asyncio.all_tasks(loop))

    with opened(browser, viewer) as (other_page, other, other_errors):
        threads = own_threads()
        assert len(viewer.sessions) == 2
        send(other, "branch", "FF+")
        until(lambda: other_page.inner_text('[data-spm="branch"]') == "FF+", "the other's branch", page=other_page)
        assert session.model.state.label == "TT+"
        assert page.inner_text('[data-spm="branch"]') == "TT+"
        other.player._repeat = True  # a busy machine may take longer than the path's second to look
        asyncio.run_coroutine_threadsafe(other.report("play", None), other._loop).result(timeout=300.0)
        until(lambda: other.player.playing, "time to run")
        other_page.close()
        until(lambda: viewer.sessions == (session,), "one session less", page=page)
        until(lambda: not running(), "no task of it left", page=page)
        assert not other.player.playing
        assert own_threads() <= threads
        assert not other_errors


def test_the_demo_moves_until_it_is_touched(browser):
    with Viewer(port=0) as viewer:
        page = browser.new_page(viewport=SIZE)
        errors = watched(page)
        page.goto(viewer.url + PIXELS, timeout=90_000)
        until(lambda: viewer.sessions, "a session", page=page)
        (session,) = viewer.sessions
        start = viewer.start.translation
        until(lambda: np.linalg.norm(session.model.state.shown.translation - start) > 0.05, "a motion", page=page)
        send(session, "branch", session.model.state.label)
        assert not session.player.playing
        page.close()
        assert not errors
    with Viewer(viewer.start, port=0) as viewer:
        assert viewer.demo is None


def test_a_viewer_that_is_stopped_awaits_what_its_pages_still_do(browser, caplog):
    with Viewer(port=0) as viewer:
        page = browser.new_page(viewport=SIZE)
        page.goto(viewer.url + PIXELS, timeout=90_000)
        until(lambda: viewer.sessions, "a session", page=page)
        (session,) = viewer.sessions
        begun, moved = threading.Event(), []

        def slow():
            begun.set()
            threading.Event().wait(0.5)
            session._on_coordinate((0, session._coordinates[0] + 0.01))
            moved.append(True)

        viewer.server.get_event_loop().call_soon_threadsafe(session.queue.post, "slow", slow)
        assert begun.wait(300.0)
    assert moved
    gc.collect()
    assert "Task was destroyed" not in caplog.text
    page.close()


def test_the_platform_of_a_stage_is_dragged_and_its_servos_are_moved(browser):
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=np.radians([-35, 70]))
    with Viewer(stage, port=0) as viewer:
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(90_000)
        errors = watched(page)
        page.goto(viewer.url + PIXELS, timeout=90_000)
        until(lambda: viewer.sessions, "a session", page=page)
        (session,) = viewer.sessions
        settled(page, session)
        notice = page.locator(".mantine-Notification-closeButton")  # of software rendering, over the gizmo
        until(notice.count, "the notice", page=page)
        notice.first.click()
        assert page.inner_text('[data-spm="branch"]') == "Mode T"
        assert page.inner_text('[data-spm="r_2"]') == f"{np.degrees(viewer.start.readings[1]):.1f}°"
        drag_gizmo(page, session, 2, 0.012)
        until(lambda: session.model.state.shown.height > viewer.start.height + 0.008, "a higher platform", page=page)
        send(session, "coordinate", (1, 12.0))
        shown = session.model.state.shown
        assert np.degrees(shown.roll) == pytest.approx(12.0)
        positions, _, _ = solid_placements(shown)
        np.testing.assert_allclose([handle.position for handle in session.scene._robot], positions, atol=1e-9)
        until(lambda: "roll 12.0°" in page.inner_text('[data-spm="pose"]'), "its numbers", page=page)
        page.wait_for_timeout(500)
        picture(page, "viewer_stage.png")
        send(session, "leg", (0, 20.0))
        assert np.degrees(session.model.state.shown.readings[0]) == pytest.approx(20.0)
        send(session, "coordinate", (2, 40.0))
        page.wait_for_selector('[data-spm="warning"]')
        assert session.scene._wanted.visible
        assert not session.model.state.shown.limit_excess.any()
        page.get_by_role("button", name="Back to the reachable pose").click()
        until(lambda: session.model.state.distance == 0.0, "the target where the platform is", page=page)
        page.close()
        assert not errors
