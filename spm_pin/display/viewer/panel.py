"""The controls beside the picture: told by the session what to show, they tell it of events and keep no state."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np

from spm_pin.display.viewer.state import Drive, State
from spm_pin.display.viewer.state_export import command_line, xyx_degrees
from spm_pin.display.viewer.state_markup import forces_table, instruments, note, status
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import LEGS, Geometry

__all__ = ["ANGLES", "POSITIONS", "Panel"]

POSITIONS, ANGLES = ("x", "y", "z"), ("α", "β", "λ")

Report = Callable[[str, Any], Coroutine[Any, Any, None]]


class Panel:
    """The widgets of one client.

    Parameters
    ----------
    gui : viser.GuiApi
        Where to add them.
    geometry : Geometry
        Sets the ranges of the sliders.
    report : coroutine function
        Told of every event: its name and its value.
    dark : bool
        Whether the page is dark at first.
    duration : float, optional
        Of the recorded path [s]; without one there is no tab for it.
    clouds : bool
        Whether there are leg limits, hence something to show of the workspace.
    """

    def __init__(
        self, gui: Any, geometry: Geometry, report: Report, *, dark: bool, duration: float | None, clouds: bool
    ) -> None:
        self.gui = gui
        self._report = report
        self.theme(dark)
        self.status = gui.add_html("")
        self.branch = gui.add_dropdown("Branch", ["–"], hint="Or click a ghost")
        self._on(self.branch, "branch")
        self.instruments = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Move"):
            self._add_motion(geometry)
        with tabs.add_tab("Load"):
            self.force = gui.add_vector3("Force [N]", (0.0, 0.0, 0.0), step=10.0, hint="Onto m at o, in {B}")
            self.moment = gui.add_vector3("Moment [N m]", (0.0, 0.0, 0.0), step=10.0, hint="Onto m, in {B}")
            self._on(self.force, "load")
            self._on(self.moment, "load")
            self.forces = gui.add_html("")
        with tabs.add_tab("Show"):
            self._add_view(dark, clouds)
        if duration is not None:
            with tabs.add_tab("Path"):
                self._add_path(duration)
        with tabs.add_tab("Share"):
            self._add_export()

    def theme(self, dark: bool) -> None:
        """Make the page dark or light."""
        self.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="large", brand_color=(0, 114, 178)
        )

    def _on(self, widget: Any, name: str, value: Callable[[Any], Any] | None = None) -> None:
        async def updated(event: Any) -> None:
            # What the server assigns comes back as an event of no client.
            if event.client_id is not None:
                await self._report(name, value(event.target) if value is not None else event.target.value)

        widget.on_update(updated)

    def _on_press(self, button: Any, name: str) -> None:
        async def pressed(_: Any) -> None:
            await self._report(name, None)

        button.on_click(pressed)

    def _add_motion(self, geometry: Geometry) -> None:
        gui, limits = self.gui, geometry.limits
        self.drive = gui.add_dropdown("Drive", ["platform pose", "leg lengths"])
        self._on(self.drive, "drive", lambda widget: Drive.LEGS if widget.value == "leg lengths" else Drive.POSE)
        longest = max(limits.maximum) if limits is not None else 3.0 * geometry.base_radius + geometry.middle_side
        reach = 2.2 * min(longest, 10.0 * geometry.base_radius)
        self.pose_folder = gui.add_folder(None)
        self.pose_sliders: list[Any] = []
        with self.pose_folder:
            for name in POSITIONS:
                low = 0.0 if name == "z" else -reach
                self.pose_sliders.append(gui.add_slider(f"{name} [m]", low, reach, 0.001, 0.0))
            for name in ANGLES:
                self.pose_sliders.append(gui.add_slider(f"{name} [°]", -180.0, 180.0, 0.1, 0.0))
        for k, slider in enumerate(self.pose_sliders):
            self._on(slider, "coordinate", _numbered(k))
        self.leg_folder = gui.add_folder(None, visible=False)
        self.leg_sliders: list[Any] = []
        with self.leg_folder:
            for k, leg in enumerate(LEGS):
                low, high = (limits.minimum[k], limits.maximum[k]) if limits is not None else (0.0, longest)
                low, high = max(low, 1e-3), high if np.isfinite(high) else longest
                self.leg_sliders.append(gui.add_slider(f"{leg} [m]", low, high, 0.001, low))
                self._on(self.leg_sliders[k], "leg", _numbered(k))
        self.hold = gui.add_checkbox(
            "Hold leg limits", True, visible=limits is not None, hint="Once within its limits the machine stays there"
        )
        self._on(self.hold, "hold")
        self.reset = gui.add_button("Back to the start")
        self._on_press(self.reset, "reset")

    def _add_view(self, dark: bool, clouds: bool) -> None:
        gui = self.gui
        for label, name, value, visible in (
            ("Ghosts of other branches", "ghosts", True, True),
            ("Labels", "labels", True, True),
            ("Gizmo", "gizmo_shown", True, True),
            ("Workspace shell", "shell", False, clouds),
            ("Reachable points", "points", False, clouds),
            ("Dark page", "dark", dark, True),
        ):
            self._on(gui.add_checkbox(label, value, visible=visible), name)

    def _add_path(self, duration: float) -> None:
        gui = self.gui
        self.play = gui.add_button("Play / pause")
        self._on_press(self.play, "play")
        self.time = gui.add_slider("Time [s]", 0.0, duration, max(duration / 1000.0, 1e-6), 0.0)
        self._on(self.time, "time")
        self.path_note = gui.add_html("")

    def _add_export(self) -> None:
        gui = self.gui
        self.command = gui.add_text("Command", "", multiline=True)
        self.q = gui.add_text("q", "", multiline=True, hint="Joint values in Pinocchio's order [rad, m]")
        for label, name in (("Download JSON", "json"), ("Download this view as HTML", "snapshot")):
            self._on_press(gui.add_button(label), name)

    def show(self, state: State, q: FloatArray, geometry_file: Any, *, moved: str = "") -> None:
        """Bring everything up to date, but for the sliders, "coordinate" or "leg", of which one is being moved."""
        self.status.content = status(state)
        self.instruments.content = instruments(state)
        self.forces.content = forces_table(state)
        labels = state.labels or ("–",)
        if tuple(self.branch.options) != labels:
            self.branch.options = labels
        self.branch.value = state.label or labels[0]
        position, angles = state.target.translation, _xyx(state)
        values = {"coordinate": [*position, *angles], "leg": list(state.readings.leg_lengths)}
        for kind, sliders in (("coordinate", self.pose_sliders), ("leg", self.leg_sliders)):
            for value, slider in zip(values[kind], sliders, strict=True):
                if kind != moved:
                    number = round(float(value), 3 if "[m]" in slider.label else 1)
                    slider.min, slider.max = min(slider.min, number), max(slider.max, number)
                    slider.value = number
        self.command.value = command_line(state.shown, geometry_file)
        self.q.value = np.array2string(q, precision=9, separator=", ", max_line_width=60)

    def show_path(self, *lines: str) -> None:
        """Show lines of text below the path's controls."""
        self.path_note.content = note(*lines)

    def show_drive(self, drive: Drive) -> None:
        """Show the sliders of what is driven."""
        self.pose_folder.visible = drive is Drive.POSE
        self.leg_folder.visible = drive is Drive.LEGS
        self.drive.value = "leg lengths" if drive is Drive.LEGS else "platform pose"

    @property
    def wrench(self) -> FloatArray:
        """The load as entered (6,) [N, N m]."""
        return np.array([*self.force.value, *self.moment.value], dtype=np.float64)


def _numbered(k: int) -> Callable[[Any], tuple[int, float]]:
    """Return a function that gives a widget's value with its number."""
    return lambda widget: (k, float(widget.value))


def _xyx(state: State) -> list[float]:
    if state.distance == 0.0:
        return xyx_degrees(state.shown)
    angles = state.target.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)
    return [float(angle) for angle in angles]
