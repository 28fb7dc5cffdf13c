"""Take pictures of the viewer: `python docs/site/viewer_figures.py`. Needs the extras viewer and dev, Chromium."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from figures import IMAGES, MACHINE
from PIL import Image

import spm_pin as spm
from spm_pin.display import Viewer

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from browser import chromium, until

DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
PICTURES = {"desktop": (DESKTOP, False), "load": (DESKTOP, False), "phone": (PHONE, True), "stage": (DESKTOP, False)}
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=np.radians([-35, 70]))


def main() -> None:
    """Open a page for each picture."""
    state = spm.forward_physical(MACHINE, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    with chromium() as browser:
        for name, (size, dark) in PICTURES.items():
            tilted = spm.inverse_physical(BALANCER, 0.12, tilt=np.radians(12), azimuth=np.radians(60))
            with Viewer(tilted if name == "stage" else state, port=0, dark=dark) as viewer:
                page = browser.new_page(viewport=size)
                page.goto(f"{viewer.url}?fixedDpr=1")
                page.wait_for_selector('[data-spm="branch"]', state="attached", timeout=180_000)
                until(lambda: viewer.sessions, "a session", seconds=120.0, page=page)
                notice = page.locator(".mantine-Notification-closeButton")  # of software rendering
                until(notice.count, "the notice of software rendering", seconds=120.0, page=page)
                notice.evaluate_all("buttons => buttons.forEach(button => button.click())")
                if name == "load":
                    page.get_by_role("tab", name="Load").click(timeout=120_000)
                    (session,) = viewer.sessions
                    session.scene.show_workspace("shell", True)
                    session.panel.force.value = (0.0, 0.0, -500.0)
                    session._on_load(None)
                page.wait_for_timeout(6000)
                path = IMAGES / f"viewer_{name}.png"
                page.screenshot(path=path)
                picture = Image.open(path).convert("RGB")
                picture.quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=4).save(path, optimize=True)


if __name__ == "__main__":
    main()
