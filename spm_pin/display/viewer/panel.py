"""The controls beside the picture. The session sets what they show; they report events and keep no state."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from operator import attrgetter
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
from spm_pin.mechanism.geometry import LEGS, Geometry

__all__ = ["Panel"]

_COORDINATES = ("x [m]", "y [m]", "z [m]", "α [°]", "β [°]", "λ [°]")
_DRIVES = {"platform pose": Drive.POSE, "leg lengths": Drive.LEGS}
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
        self.back = gui.add_button(
            "Back to the reachable pose", visible=False, color=(200, 16, 46), icon="arrow-back-up"
        )
        self._on(self.back.on_click, "back")
        self.branch = gui.add_dropdown("Branch", [_NONE], hint="Or show the other branches as ghosts and click one")
        self._on(self.branch.on_update, "branch")
        views = gui.add_button_group("View", tuple(VIEWS))
        self._on(views.on_click, "view")
        if not narrow:
            self.instruments = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Move"):
            self._add_motion(geometry, demo)
        if narrow:
            with tabs.add_tab("Readings"):
                self.instruments = gui.add_html("")
        with tabs.add_tab("Load"):
            self.force = gui.add_vector3("Force [N]", (0.0, 0.0, 0.0), step=10.0, hint="Onto m at o, in {B}")
            self.moment = gui.add_vector3("Moment [N m]", (0.0, 0.0, 0.0), step=10.0, hint="Onto m, in {B}")
            self._on(self.force.on_update, "load")
            self._on(self.moment.on_update, "load")
            self.forces = gui.add_html("")
        with tabs.add_tab("Show"):
            limits = geometry.limits
            self._add_layers(dark, limits is not None and bool(np.isfinite(limits.maximum).all()))
        if duration is not None:
            with tabs.add_tab("Path"):
                self._add_path(duration)
        with tabs.add_tab("Share"):
            self._add_export()

    def theme(self, dark: bool) -> None:
        """Make the page dark or light."""
        self.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND[dark]
        )

    def _on(self, register: Any, name: str, value: Callable[[Any], Any] = attrgetter("value")) -> None:
        """Report the events for which a widget registers callbacks, with the value of the widget."""

        async def happened(event: Any) -> None:
            # What the server assigns comes back as an event of no client.
            if event.client_id is not None:
                await self._report(name, value(event.target))

        register(happened)

    def _add_motion(self, geometry: Geometry, demo: bool) -> None:
        gui = self.gui
        self.drive = gui.add_dropdown("Drive", tuple(_DRIVES))
        self._on(self.drive.on_update, "drive", lambda widget: _DRIVES.get(widget.value, Drive.POSE))
        self.pose_folder = gui.add_folder(None)
        with self.pose_folder:
            self.pose_sliders = [self._slider(name, "coordinate", k) for k, name in enumerate(_COORDINATES)]
        self.leg_folder = gui.add_folder(None, visible=False)
        with self.leg_folder:
            self.leg_sliders = [self._slider(f"{leg} [m]", "leg", k) for k, leg in enumerate(LEGS)]
        self.hold = gui.add_checkbox(
            "Hold leg limits", True, visible=geometry.limits is not None, hint="Once within its limits it stays there"
        )
        self._on(self.hold.on_update, "hold")
        self._on(gui.add_button("Start pose", icon="home").on_click, "reset")
        if demo:
            self._on(gui.add_button("Demo motion", icon="player-play").on_click, "demo")

    def _slider(self, label: str, name: str, index: int) -> Any:
        slider = self.gui.add_slider(label, 0.0, 1.0, 0.1 if "°" in label else 0.001, 0.0)

        def clipped(widget: Any) -> tuple[int, float]:
            return index, float(min(max(widget.value, widget.min), widget.max))

        self._on(slider.on_update, name, clipped)
        return slider

    def _add_layers(self, dark: bool, limited: bool) -> None:
        for label, name, value, visible in (
            ("Other branches", "ghosts", False, True),
            ("Leg names", "names", True, True),
            ("Trail of o", "trail", True, True),
            ("Gizmo", "gizmo", True, True),
            ("Workspace shell", "shell", False, limited),
            ("Points reached", "points", False, True),
        ):
            box = self.gui.add_checkbox(label, value, visible=visible)
            self._on(box.on_update, "layer", lambda widget, name=name: (name, widget.value))  # type: ignore[misc]
        self._on(self.gui.add_checkbox("Dark page", dark).on_update, "dark")

    def _add_path(self, duration: float) -> None:
        gui = self.gui
        self._on(gui.add_button("Play / pause", icon="player-play").on_click, "play")
        self.time = gui.add_slider("Time [s]", 0.0, duration, max(duration / 1000.0, 1e-6), 0.0)
        self._on(self.time.on_update, "time", lambda widget: float(min(max(widget.value, 0.0), duration)))
        self.path_note = gui.add_html("")

    def _add_export(self) -> None:
        gui = self.gui
        for label, name, icon in (
            ("Save picture (PNG)", "png", "photo"),
            ("Save this view as a page (HTML)", "snapshot", "file-code"),
            ("Save state (JSON)", "json", "download"),
        ):
            self._on(gui.add_button(label, icon=icon).on_click, name)
        self.command = gui.add_text("Command", "", multiline=True)
        self.q = gui.add_text("q", "", multiline=True, hint="Joint values in Pinocchio's order [rad, m]")

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
        self.drive.value = next(name for name, value in _DRIVES.items() if value is drive)

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
