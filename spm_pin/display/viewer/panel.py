"""The control panel of a page: its widgets, their events, and what they show."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.display.viewer.camera import VIEWS
from spm_pin.display.viewer.robot_scene import assign
from spm_pin.display.viewer.slider_ranges import pose_coordinates
from spm_pin.display.viewer.state import Drive, State
from spm_pin.display.viewer.state_export import command_line
from spm_pin.display.viewer.state_markup import forces_table, instruments, note, status
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS

_COORDINATES = ("x [m]", "y [m]", "z [m]", "α [°]", "β [°]", "λ [°]")
_LAYERS = {
    "Other branches": ("ghosts", False),
    "Leg names": ("names", True),
    "Trail of o": ("trail", True),
    "Gizmo": ("gizmo", True),
    "Workspace shell": ("shell", False),
    "Points reached": ("points", False),
}
"""Layers of the scene by their labels: name of the layer, and whether it is shown at first."""
_EXPORTS = {
    "Save picture (PNG)": ("png", "photo"),
    "Save this view as a page (HTML)": ("snapshot", "file-code"),
    "Save state (JSON)": ("json", "download"),
}
"""Files to save: names of the events, and icons."""
_NONE = "–"

# viser makes the colour of its buttons from these: light ones on a dark page, and white text on both.
_BRAND = {False: (0, 54, 84), True: (0, 114, 178)}

Report = Callable[[str, Any], Coroutine[Any, Any, None]]


class Panel:
    """The widgets of one client, added to a `viser.GuiApi`.

    The coroutine function `report` is called with the name and the value of every event. Without the `duration` of a
    recorded path [s] there is no tab for it; on the `narrow` page of a phone the instruments have a tab of their own.
    """

    def __init__(
        self,
        gui: Any,
        geometry: Geometry,
        report: Report,
        *,
        dark: bool,
        duration: float | None,
        demo: bool,
        narrow: bool,
    ) -> None:
        self.gui = gui
        self._report = report
        self.theme(dark)
        gui.main_panel.dock_right()
        self.status = gui.add_html("")
        self.back = self._add(
            "button", "back", "Back to the reachable pose", visible=False, color=(200, 16, 46), icon="arrow-back-up"
        )
        self.branch = self._add(
            "dropdown", "branch", "Branch", [_NONE], hint="Or show the other branches as ghosts and click one"
        )
        self._add("button_group", "view", "View", tuple(VIEWS))
        if not narrow:
            self.instruments = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Move"):
            self._add_motion(geometry, demo)
        if narrow:
            with tabs.add_tab("Readings"):
                self.instruments = gui.add_html("")
        with tabs.add_tab("Load"):
            zero = (0.0, 0.0, 0.0)
            self.force = self._add("vector3", "load", "Force [N]", zero, step=10.0, hint="Onto m at o, in {B}")
            self.moment = self._add("vector3", "load", "Moment [N m]", zero, step=10.0, hint="Onto m, in {B}")
            self.forces = gui.add_html("")
        with tabs.add_tab("Show"):
            limited = geometry.limits is not None and bool(np.isfinite(geometry.limits.maximum).all())
            for label, (layer, shown) in _LAYERS.items():
                self._add("checkbox", "layer", label, shown, key=layer, visible=limited or layer != "shell")
            self._add("checkbox", "dark", "Dark page", dark)
        if duration is not None:
            with tabs.add_tab("Path"):
                self._add("button", "play", "Play / pause", icon="player-play")
                self.time = self._add("slider", "time", "Time [s]", 0.0, duration, max(duration / 1000.0, 1e-6), 0.0)
                self.path_note = gui.add_html("")
        with tabs.add_tab("Share"):
            for label, (name, icon) in _EXPORTS.items():
                self._add("button", name, label, icon=icon)
            self.command = gui.add_text("Command", "", multiline=True)
            self.q = gui.add_text("q", "", multiline=True, hint="Joint values in Pinocchio's order [rad, m]")

    def theme(self, dark: bool) -> None:
        """Make the page dark or light."""
        self.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND[dark]
        )

    def _add(self, kind: str, event: str, label: str, *arguments: Any, key: Any = None, **options: Any) -> Any:
        """Add a widget of a kind, whose events are reported under a name, with its value or with `key` and value."""
        widget = getattr(self.gui, f"add_{kind}")(label, *arguments, **options)

        async def happened(message: Any) -> None:
            # What the server assigns comes back as an event of no client.
            if message.client_id is not None:
                value = message.target.value
                if kind == "slider":
                    value = float(min(max(value, message.target.min), message.target.max))
                await self._report(event, value if key is None else (key, value))

        register = widget.on_click if kind.startswith("button") else widget.on_update
        register(happened)
        return widget

    def _add_motion(self, geometry: Geometry, demo: bool) -> None:
        self.drive = self._add("dropdown", "drive", "Drive", tuple(map(str, Drive)))
        self.pose_folder = self.gui.add_folder(None)
        with self.pose_folder:
            self.pose_sliders = [self._add_slider(name, "coordinate", k) for k, name in enumerate(_COORDINATES)]
        self.leg_folder = self.gui.add_folder(None, visible=False)
        with self.leg_folder:
            self.leg_sliders = [self._add_slider(f"{leg} [m]", "leg", k) for k, leg in enumerate(LEGS)]
        limited = geometry.limits is not None
        hint = "A leg within its limits is kept within them"
        self._add("checkbox", "hold", "Hold leg limits", True, visible=limited, hint=hint)
        self._add("button", "reset", "Start pose", icon="home")
        if demo:
            self._add("button", "demo", "Demo motion", icon="player-play")

    def _add_slider(self, label: str, event: str, index: int) -> Any:
        return self._add("slider", event, label, 0.0, 1.0, 0.1 if "°" in label else 0.001, 0.0, key=index)

    def show(
        self,
        state: State,
        q: FloatArray,
        ranges: tuple[FloatArray, FloatArray],
        geometry_file: Path | None,
        moved: tuple[str, int] = ("", 0),
    ) -> None:
        """Show a state and its joint values q (18,); the sliders of pose and legs go over `ranges`, each (6, 2).

        The slider that the user moves, ``"coordinate"`` or ``"leg"`` and which of them, is left alone; so are the
        values of the others of its kind.
        """
        self.status.content = status(state)
        self.instruments.content = instruments(state)
        self.forces.content = forces_table(state)
        assign(self.back, "visible", state.distance > 0.0 and state.drive is Drive.POSE)
        labels = state.labels or (_NONE,)
        if tuple(self.branch.options) != labels:
            self.branch.options = labels
        assign(self.branch, "value", state.label or labels[0])
        # At X-Y-X angles that are not unique, those of the state that is shown.
        pose = pose_coordinates(state.target if state.distance > 0.0 else state.shown.pose)
        kinds = (("coordinate", self.pose_sliders, pose), ("leg", self.leg_sliders, state.shown.leg_lengths))
        for (kind, sliders, values), ends in zip(kinds, ranges, strict=True):
            for k, (slider, value, (low, high)) in enumerate(zip(sliders, values, ends, strict=True)):
                if (kind, k) != moved:
                    value = slider.value if kind == moved[0] else float(value)
                    _set_slider(slider, value, min(low, value), max(high, value))
        self.command.value = command_line(state.shown, geometry_file)
        self.q.value = np.array2string(q + 0.0, precision=9, separator=", ", max_line_width=60)

    def show_path(self, *lines: str) -> None:
        """Show lines of text below the path's controls."""
        self.path_note.content = note(*lines)

    def show_drive(self, drive: Drive) -> None:
        """Show the sliders of what is driven."""
        self.pose_folder.visible = drive is Drive.POSE
        self.leg_folder.visible = drive is Drive.LEGS
        self.drive.value = str(drive)

    @property
    def wrench(self) -> FloatArray:
        """The load as entered (6,) [N, N m]."""
        return np.array([*self.force.value, *self.moment.value], dtype=np.float64)


def _set_slider(slider: Any, value: float, low: float, high: float) -> None:
    """Set a slider's value and ends, rounded to its step; the ends outwards."""
    step = float(slider.step)
    digits = 3 if step < 0.01 else 1
    assign(slider, "min", round(np.floor(low / step + 1e-6) * step, digits) + 0.0)
    assign(slider, "max", round(max(np.ceil(high / step - 1e-6) * step, low + step), digits) + 0.0)
    assign(slider, "value", round(value, digits) + 0.0)
