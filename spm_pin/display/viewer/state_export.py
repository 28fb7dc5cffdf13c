"""A session's state in forms that leave the page: a command line, data, and a page that needs no server."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.crosscheck.random_poses import command
from spm_pin.display.viewer.camera import FIELD_OF_VIEW, VIEWS, fit_camera, robot_points
from spm_pin.display.viewer.robot_meshes import RobotMeshes
from spm_pin.display.viewer.robot_scene import RobotScene
from spm_pin.display.viewer.slider_ranges import pose_coordinates
from spm_pin.display.viewer.state import State, StateMachine
from spm_pin.display.viewer.state_markup import forces_table, instruments, status
from spm_pin.display.viewer.viser_server import branded_html, start, stop
from spm_pin.kinematics.singularity_analysis import SingularityKind
from spm_pin.mechanism import LEGS, Configuration
from spm_pin.mechanism.arguments import file_path, writing
from spm_pin.mechanism.geometry_files import as_data
from spm_pin.multibody.chain import ClosedChain

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


def command_line(configuration: Configuration, geometry_file: Path | None = None) -> str:
    """Return the `spm-pin inverse` that finds all branches of a single configuration's pose, to float64's digits."""
    values = pose_coordinates(configuration.pose)
    return command(values[:3], values[3:], None if geometry_file is None else str(geometry_file))


def content(state: State, chain: ClosedChain, geometry_file: Path | None = None) -> dict[str, Any]:
    """Return the state as data for `spm_pin.display.json_text.to_json`, in metres, radians and newtons."""
    shown, readings = state.shown, state.readings
    found = readings.singularities
    measures = {name: getattr(found, name) for name in ("sigma", "condition", "scaled_determinants")}
    measures["leg_travel"] = readings.travel
    return {
        "geometry": {"leg_limits": None, **as_data(shown.geometry)},
        "branch": state.label or None,
        "pose": shown.pose.as_matrix(),
        "translation": shown.translation,
        "xyx": np.deg2rad(pose_coordinates(shown.pose)[3:]),
        "reached": state.distance == 0.0,
        "leg_lengths": dict(zip(LEGS, shown.leg_lengths, strict=True)),
        "middle_joints": shown.middle_joints,
        "closure_residual": shown.closure_residual,
        "q": dict(zip(chain.joint_names, chain.joint_values(shown), strict=True)),
        "physical": readings.physical,
        "singularity": {
            "kind": str(SingularityKind(int(found.kind))),
            **{name: dict(zip(("J_b", "J_c", "K"), values, strict=True)) for name, values in measures.items()},
        },
        "wrench": state.wrench,
        "leg_forces": None if readings.forces is None else dict(zip(LEGS, readings.forces, strict=True)),
        "command": command_line(shown, geometry_file),
    }


def snapshot_html(
    state: State, robot: RobotMeshes, *, dark: bool = False, geometry_file: Path | None = None, ghosts: bool = False
) -> str:
    """Return a state as a complete HTML page to be looked at from all sides; options as for `save_snapshot`."""
    server = start("127.0.0.1", 0)
    try:
        scene = RobotScene(server.scene, robot)
        scene.layers["ghosts"] = ghosts
        scene.show(state)
        position, look_at = fit_camera(robot_points(state.shown, 0.3 * scene.size), VIEWS["Home"], 0.5, border=0.02)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.position = tuple(position)
        server.initial_camera.look_at = tuple(look_at)
        page = branded_html(server.scene.as_html(dark_mode=dark))
    finally:
        stop(server)
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
    state, robot = StateMachine(configuration).state, RobotMeshes(configuration.geometry)
    page = snapshot_html(state, robot, dark=dark, ghosts=ghosts, geometry_file=geometry_file)
    with writing(path):
        path.write_text(page, encoding="utf-8")
    return path
