"""Headless Chromium, the end of a viewer's events, and the positions of a viewer's objects in its picture."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

# A software renderer: slow, but the same everywhere.
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@contextmanager
def chromium() -> Iterator:
    """Have a browser; skips where there is none."""
    from playwright.sync_api import sync_playwright

    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("needs the system package chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


def watched(page) -> list[str]:
    """Return a list to which the page's errors are added as they come."""
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    return errors


def until(holds: Callable[[], object], what: str, seconds: float = 120.0, page=None) -> None:
    """Wait until something holds; with a page, let it work meanwhile."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, f"not within {seconds:g} s: {what}"
        if page is not None:
            page.wait_for_timeout(50)
        else:
            time.sleep(0.05)


async def drained(queue) -> None:
    """Wait until nothing is left to do in an event queue of the viewer."""
    while queue._task is not None:
        await asyncio.shield(queue._task)


def pixel(camera, point) -> tuple[float, float]:
    """Return where a viser camera sees a point of the world, in pixels from the upper left."""
    x, y, z = Rotation.from_quat(camera.wxyz, scalar_first=True).inv().apply(np.asarray(point) - camera.position)
    focal = 0.5 * camera.image_height / np.tan(0.5 * camera.fov)
    return 0.5 * camera.image_width + focal * x / z, 0.5 * camera.image_height + focal * y / z
