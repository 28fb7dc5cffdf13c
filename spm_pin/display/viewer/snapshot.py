"""A page that needs no server and no network: the scene of one state, its numbers beside it."""

from __future__ import annotations

from html import escape
from pathlib import Path

from spm_pin.display.viewer.camera import FIELD_OF_VIEW, VIEWS, fit_camera, robot_points
from spm_pin.display.viewer.page_style import branded_html
from spm_pin.display.viewer.robot_meshes import RobotMeshes
from spm_pin.display.viewer.robot_scene import RobotScene
from spm_pin.display.viewer.state import Model, State
from spm_pin.display.viewer.state_export import command_line
from spm_pin.display.viewer.state_markup import forces_table, instruments, status
from spm_pin.display.viewer.viser_server import quiet_server
from spm_pin.mechanism.arguments import file_path, writing
from spm_pin.mechanism.configuration import Configuration

__all__ = ["save_snapshot", "snapshot_html"]

_CARD = """<style>
#spm-card{{position:fixed;top:0.8em;right:0.8em;width:min(24em,calc(100vw - 1.6em));box-sizing:border-box;z-index:10;
font-family:system-ui,sans-serif;border-radius:0.5em;background:{paper};color:{ink};box-shadow:0 0 0.8em #0004;
max-height:calc(100vh - 1.6em);overflow:auto}}
#spm-card summary{{padding:0.5em 0.7em;cursor:pointer;font-weight:600}}
#spm-card code{{display:block;padding:0.5em 0.7em 0.8em;font-size:0.72rem;overflow-wrap:anywhere;user-select:all}}
</style>
<details id="spm-card"><summary>{title}</summary>{body}<code>{command}</code></details>
<script>document.getElementById("spm-card").open = innerWidth > 0.58 * innerHeight + 800;</script>
"""


def snapshot_html(
    state: State, robot: RobotMeshes, *, dark: bool = False, geometry_file: Path | None = None, ghosts: bool = False
) -> str:
    """Return a state as a complete HTML page to be looked at from all sides; options as for `save_snapshot`."""
    with quiet_server("127.0.0.1", 0) as server:
        scene = RobotScene(server.scene, robot)
        scene.layers["ghosts"] = ghosts
        scene.show(state)
        position, look_at = fit_camera(robot_points(state.shown, 0.3 * scene.size), VIEWS["Home"], 0.5, border=0.02)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.position = tuple(position)
        server.initial_camera.look_at = tuple(look_at)
        page = branded_html(server.scene.as_html(dark_mode=dark))
    card = _CARD.format(
        paper="#25262b" if dark else "#ffffff",
        ink="#e6e6e6" if dark else "#1a1b1e",
        title=escape(f"3RPS-3SPR, {state.label or 'no isolated branch'}"),
        body=status(state) + instruments(state) + (forces_table(state) if state.wrench.any() else ""),
        command=escape(command_line(state.shown, geometry_file)),
    )
    end = page.rindex("</body>")
    return page[:end] + card + page[end:]


def save_snapshot(
    configuration: Configuration,
    path: str | Path,
    *,
    dark: bool = False,
    ghosts: bool = False,
    geometry_file: Path | None = None,
) -> Path:
    """Save a configuration as an HTML page that needs no server and no network.

    Parameters
    ----------
    configuration : Configuration
        A single configuration that exists.
    path : str or Path
        File to write, ending in ``.html``; one that exists is replaced. It is returned.
    dark, ghosts : bool
        A dark page; the other branches as ghosts.
    geometry_file : Path, optional
        Where the geometry came from, for the command line on the page.

    Raises
    ------
    ArgumentError
        If the suffix is another, or the file cannot be written.
    """
    path = file_path(path, suffixes=(".html", ".htm"))
    state, robot = Model(configuration).state, RobotMeshes(configuration.geometry)
    page = snapshot_html(state, robot, dark=dark, ghosts=ghosts, geometry_file=geometry_file)
    with writing(path):
        path.write_text(page, encoding="utf-8")
    return path
