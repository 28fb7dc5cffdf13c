"""The control panel of a page: its widgets, their events, and the state as HTML, by `templates/panel.html`."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader

from spm_pin.display.viewer.model import SessionState, ViewerModel, reading_units
from spm_pin.display.viewer.robot_scene import LOAD, VIEWS, WARN
from spm_pin.display.viewer.stage_model import StageModel, StageState
from spm_pin.display.writing import fixed

State = SessionState | StageState
"""A state of either machine."""
_LAYERS = {
    "Other branches": ("ghosts", False),
    "Leg names": ("names", True),
    "Trail of o": ("trail", True),
    "Forces held": ("forces", False),
    "Gizmo": ("gizmo", True),
    "The paper's shell": ("shell", False),
    "Points reached": ("points", False),
}
"""Layers of the scene by label: name of the layer, and whether it is shown initially."""
_OF_ROBOTS = {"ghosts", "forces", "shell", "points"}
"""Layers that a stage alone does not have."""
_NONE = "–"
# viser derives the colour of its buttons from these: light ones on a dark page, and white text on both.
_BRAND = {False: (0, 54, 84), True: (0, 114, 178)}
_GREY, _STAGES = (128, 128, 128), ((0, 114, 178), (230, 159, 0))

Report = Callable[[str, Any], Coroutine[Any, Any, None]]


class Panel:
    """The widgets of one client of a `Viewer`, added to a `viser.GuiApi`.

    `report` is called with the name and the value of every event, `model` is the session's. On the `narrow` page of a
    phone the instruments have a tab of their own.
    """

    def __init__(self, gui: Any, viewer: Any, model: ViewerModel | StageModel, report: Report, *, narrow: bool) -> None:
        self.gui, self.model, self._report = gui, model, report
        machine, is_robot = viewer.start.machine, isinstance(model, ViewerModel)
        limits = machine.limits
        self.theme(viewer.dark)
        gui.main_panel.dock_right()
        self.status = gui.add_html("")
        options: dict[str, Any] = {"visible": False, "color": (200, 16, 46), "icon": "arrow-back-up"}
        self.back = self._add("button", "back", "Back to the reachable pose", **options)
        hint = "Or show the other branches as ghosts and click one"
        self.branch = self._add("dropdown", "branch", "Branch", [_NONE], hint=hint, visible=is_robot)
        self._add("button_group", "view", "View", tuple(VIEWS))
        if not narrow:
            self.instruments = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Pose"):
            self.angles = next(iter(model.conventions))
            self.pose_sliders = self._add_sliders("coordinate", model.conventions[self.angles])
            self._add("dropdown", "angles", "Angles", list(model.conventions), hint=model.hint)
            hint = "A leg within its limits is kept within them"
            self._add("checkbox", "hold", "Hold leg limits", True, visible=limits is not None, hint=hint)
            self._add("button", "reset", "Start pose", icon="home")
            if viewer.demo is not None:
                self._add("button", "play", "Demo motion", icon="player-play")
        with tabs.add_tab("Legs"):
            units = reading_units(machine)
            self._factors = np.array([unit.factor for unit in units])
            labels = [f"{leg} [{unit.name}]" for leg, unit in zip(machine.legs.names, units, strict=True)]
            self.leg_sliders = self._add_sliders("leg", labels)
        if narrow:
            with tabs.add_tab("Instruments"):
                self.instruments = gui.add_html("")
        with tabs.add_tab("Load"):
            zero = (0.0, 0.0, 0.0)
            self.force = self._add("vector3", "load", "Force [N]", zero, step=10.0, hint="Onto m at o, in {B}")
            self.moment = self._add("vector3", "load", "Moment [N m]", zero, step=10.0, hint="Onto m, in {B}")
            self.forces = gui.add_html("")
        with tabs.add_tab("Show"):
            is_bounded = limits is not None and bool(np.isfinite(limits.maximum).all())
            hidden = set() if is_robot else _OF_ROBOTS
            if not (is_bounded and machine.is_nominal):
                hidden = hidden | {"shell"}
            for label, (layer, shown) in _LAYERS.items():
                self._add("checkbox", "layer", label, shown, key=layer, visible=layer not in hidden)
            self._add("checkbox", "dark", "Dark page", viewer.dark)
        if viewer.recording is not None:
            duration = float(viewer.recording.times[-1])
            with tabs.add_tab("Path"):
                self._add("button", "play", "Play / pause", icon="player-play")
                self.time = self._add("slider", "time", "Time [s]", 0.0, duration, max(duration / 1000.0, 1e-6), 0.0)
                self.path_note = gui.add_html("")
        with tabs.add_tab("Share"):
            self._add("button", "png", "Save picture (PNG)", icon="photo")
            self._add("button", "json", "Save state (JSON)", icon="download")
            self.command = gui.add_text("Command", "", multiline=True)
            hint = "Joint values in Pinocchio's order [rad, m]" if is_robot else f"[{machine.legs.units[0]}]"
            self.q = gui.add_text(model.values_name, "", multiline=True, hint=hint)

    def theme(self, dark: bool) -> None:
        """Make the page dark or light."""
        self.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND[dark]
        )

    def _add(self, kind: str, event: str, label: str, *arguments: Any, key: Any = None, **options: Any) -> Any:
        """Add a widget of a kind, whose events are reported under a name, with its value or with `key` and value."""
        widget = getattr(self.gui, f"add_{kind}")(label, *arguments, **options)

        async def on_event(message: Any) -> None:
            # A value set by the server comes back as an event without a client.
            if message.client_id is not None:
                value = message.target.value
                if kind == "slider":
                    value = float(min(max(value, message.target.min), message.target.max))
                await self._report(event, value if key is None else (key, value))

        register = widget.on_click if kind.startswith("button") else widget.on_update
        register(on_event)
        return widget

    def _add_sliders(self, event: str, labels: Sequence[str]) -> list[Any]:
        steps = [0.001 if "[m]" in label else 0.1 for label in labels]
        return [self._add("slider", event, labels[k], 0.0, 1.0, steps[k], 0.0, key=k) for k in range(len(labels))]

    def show(self, state: State, moved: tuple[str, int]) -> None:
        """Show a state; the slider that the user moves, its kind and number, and values of its kind stay."""
        self.status.content = status(state, self.angles)
        self.instruments.content = instruments(state)
        self.forces.content = forces_table(state)
        self.back.visible = state.distance > 0.0
        labels = state.labels or (_NONE,)
        if tuple(self.branch.options) != labels:
            self.branch.options = labels
        self.branch.value = state.label or labels[0]
        # If angles are not unique, those of the state shown are kept.
        pose = self.model.coordinates(state.target if state.distance > 0.0 else state.shown.pose, self.angles)
        readings = state.shown.readings
        kinds = (
            ("coordinate", self.pose_sliders, pose, self.model.pose_ranges(self.angles)),
            ("leg", self.leg_sliders, readings * self._factors, self.model.reading_ranges() * self._factors[:, None]),
        )
        for kind, sliders, values, ranges in kinds:
            for k, (slider, value, (low, high)) in enumerate(zip(sliders, values, ranges, strict=True)):
                if (kind, k) != moved:
                    value = slider.value if kind == moved[0] else float(value)
                    _set_slider(slider, value, min(low, value), max(high, value))
        self.command.value = self.model.command()
        self.q.value = np.array2string(self.model.values() + 0.0, precision=9, separator=", ", max_line_width=60)

    def set_angles(self, angles: str) -> None:
        """Take another convention of the angles; `show` sets their values."""
        self.angles = angles
        for slider, name in zip(self.pose_sliders, self.model.conventions[angles], strict=True):
            slider.label = name

    def show_path(self, *lines: str) -> None:
        """Show lines of text below the path's controls."""
        self.path_note.content = note(*lines)


def _set_slider(slider: Any, value: float, low: float, high: float) -> None:
    """Set a slider's value and ends, rounded to its step; the ends outwards."""
    step = float(slider.step)
    digits = 3 if step < 0.01 else 1
    slider.min = round(np.floor(low / step + 1e-6) * step, digits) + 0.0
    slider.max = round(max(np.ceil(high / step - 1e-6) * step, low + step), digits) + 0.0
    slider.value = round(value, digits) + 0.0


def status(state: State, convention: str = "X-Y-X") -> str:
    """Return the branch, the position with the angles in a convention, and the notices."""
    tags = ["physical" if state.is_physical else "not physical"]
    if state.shown.machine.limits is not None:
        tags.append("within limits" if not state.shown.limit_excess.any() else "beyond limits")
    notices = ("warning", "⚠", WARN, state.warnings), ("info", "ℹ", _GREY, state.notes)
    return str(_html().status(state.title, tags, state.pose_text(convention), notices))


def instruments(state: State) -> str:
    """Return the legs against their limits, and the distances from singularities."""
    legs, units = state.shown.machine.legs, reading_units(state.shown.machine)
    name = "Leg lengths" if legs.are_rps and not legs.offsets.any() else "Encoder readings"
    unit = f"in {' and '.join(dict.fromkeys(unit.name for unit in units))}"
    unit += ", between limits" * bool(state.shown.machine.limits)
    return str(_html().instruments(name, unit, WARN, _legs(state), state.measures))


def note(*lines: str) -> str:
    """Return lines of plain text."""
    return str(_html().note(lines))


@cache
def _html() -> Any:
    """Return the macros of the template."""
    loader = PackageLoader("spm_pin.display.viewer")
    return Environment(loader=loader, autoescape=True).get_template("panel.html").module


def _legs(state: State) -> Iterator[tuple[Any, ...]]:
    """Yield each leg's name, the share and colour of its bar, ticks, reading, and by how much it is beyond a limit."""
    machine, readings = state.shown.machine, state.shown.readings
    limits = machine.limits
    for k, (leg, reading, excess, unit) in enumerate(
        zip(machine.legs.names, readings, state.shown.limit_excess, reading_units(machine), strict=True)
    ):
        # The track is the allowed range with a tenth on either side, so that a leg beyond it is visible.
        low, high = (limits.minimum[k], limits.maximum[k]) if limits is not None else (0.0, np.inf)
        ticks = tuple(share for share, limit in ((0.1, low), (0.9, high)) if limit != 0.0 and np.isfinite(limit))
        if not np.isfinite([low, high]).all():
            low, high = 0.0, 1.25 * float(np.abs(readings[3 * (k // 3) : 3 * (k // 3) + 3]).max())
        share = float(np.clip(0.1 + 0.8 * (reading - low) / max(high - low, 1e-12), 0.0, 1.0))
        digits = 1 if unit.name == "°" else 0
        mark = f"⚠ {'+' if excess > 0.0 else '−'}{unit.difference(abs(excess), digits)}" if excess else ""
        yield leg, share, WARN if excess else _STAGES[k // 3], ticks, unit.text(reading), mark


def forces_table(state: State) -> str:
    """Return the leg forces that hold the load, as bars from the middle."""
    forces, machine_legs = state.forces, state.shown.machine.legs
    if forces is None:
        return note("⚠ The legs cannot hold every load here.")
    largest, legs = float(np.abs(forces).max()), []
    for leg, force in zip(machine_legs.names, forces, strict=True):
        share = 0.5 * abs(force) / largest if largest > 0.0 else 0.0
        side, sign = ("left", "▲") if force >= 0.0 else ("right", "▼")
        shown = fixed(force, 1) if abs(force) < 1e6 else f"{force:.3g}"
        legs.append((leg, share, side, shown, sign if abs(force) >= 5e-4 else ""))
    efforts = " and ".join(dict.fromkeys(kind.effort_unit for kind in machine_legs.kinds))
    return str(_html().forces(efforts, LOAD, legs))
